//! The fault drill, in one go and with pitches going on: cameras killed, cut off, slowed and frozen, the disk full, the
//! reader of the pitches standing still, a broken configuration, a second camera with the serial number of another, and at
//! last the daemon itself killed in mid-pitch. All in namespaces of its own. No pitch that two healthy cameras saw may be
//! lost, and none may be wrong.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may")]

mod lab;
#[path = "lab/thrown.rs"]
mod thrown;

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use lab::{Lab, Reaped, unix_s};
use pitchd::export::results::read_pitches;
use pitchd::time::{HostClock, SystemClock};
use thrown::{CAMERAS, Thrown, session};

/// The namespace of a camera that should not be there.
const TWIN: usize = 3;
/// The session is shown again every so many seconds: two pitches.
const EVERY_S: f64 = 4.5;

struct Drill {
    lab: Lab,
    folder: PathBuf,
    /// Unix time at which the session first begins.
    start_s: f64,
    log: PathBuf,
    daemon: Reaped,
}

fn emulator(lab: &Lab, (folder, start_s): (&Path, f64), k: usize, faults: &str) -> Reaped {
    let (id, address) = (CAMERAS[k], Lab::address(k));
    let (session, start, every) = (
        folder.join("session"),
        format!("{start_s:.3}"),
        EVERY_S.to_string(),
    );
    let arguments = [
        "emulate",
        session.to_str().unwrap(),
        "--camera",
        id,
        "--address",
        &address,
        "--start-at",
        &start,
        "--every",
        &every,
        "--faults",
        faults,
    ];
    let file = |end: &str| folder.join(format!("{id}.{end}"));
    let urgent = (lab.camera(k), Some(30));
    Reaped(Lab::start(
        (&urgent.0, urgent.1),
        &arguments,
        &file("out"),
        &file("log"),
    ))
}

fn say(emulator: &mut Reaped, line: &str) {
    let pipe = emulator.0.stdin.as_mut().unwrap();
    writeln!(pipe, "{line}").unwrap();
}

fn signal(child: &Reaped, name: &str) {
    let id = child.0.id().to_string();
    assert!(Command::new("kill").args([name, &id]).status().unwrap().success());
}

/// A disk of three megabytes; where this machine does not allow that, a file where the folder should be.
struct SmallDisk(Option<PathBuf>);

impl SmallDisk {
    fn new(folder: &Path) -> Self {
        let path = folder.join("recordings");
        std::fs::create_dir(&path).unwrap();
        let mounted = Command::new("mount")
            .args(["-t", "tmpfs", "-o", "size=3m", "tmpfs"])
            .arg(&path)
            .status();
        if mounted.is_ok_and(|s| s.success()) {
            return Self(Some(path));
        }
        lab::skip("a small disk (mount -t tmpfs); the folder is a file instead");
        std::fs::remove_dir(&path).unwrap();
        std::fs::write(&path, "x").unwrap();
        Self(None)
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        if let Some(path) = &self.0 {
            let _ = Command::new("umount").arg(path).status();
        }
    }
}

fn configure(folder: &Path) {
    let mut config = "rig = \"rig.toml\"\nresults = \"results\"\n[calibrate]\nfirst_pitches = 3\nwindow_pitches = 8\n\
                      every_pitches = 4\n[record]\nmode = \"clips\"\nfolder = \"recordings\"\nmemory_mib = 64\n"
        .to_owned();
    for (k, id) in CAMERAS.iter().enumerate() {
        // The last is known by its serial number alone, wherever it is.
        let which = match k {
            2 => "serial = \"EMU-far\"".to_owned(),
            _ => format!("address = \"{}\"", Lab::address(k)),
        };
        config +=
            &format!("[[camera]]\nid = \"{id}\"\n{which}\npacket_size = 8000\nrealtime_priority = 20\n");
    }
    std::fs::write(folder.join("pitchd.toml"), config).unwrap();
}

impl Drill {
    fn text(&self) -> String {
        std::fs::read_to_string(&self.log).unwrap()
    }

    /// Waits until the log, from now on, has all of `wanted`.
    fn wait(&self, from: usize, wanted: &[&str]) -> usize {
        let until = Instant::now() + Duration::from_secs(40);
        loop {
            let log = self.text();
            if wanted.iter().all(|w| log[from..].contains(w)) {
                return log.len();
            }
            assert!(Instant::now() < until, "no {wanted:?} in:\n{}", &log[from..]);
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    fn now(&self) -> usize {
        self.text().len()
    }

    /// The plate times of all pitches thrown within a span of Unix times.
    fn thrown<'a>(&self, thrown: &'a [Thrown], (from_s, until_s): (f64, f64)) -> Vec<(f64, &'a Thrown)> {
        let rounds = (0..200).flat_map(|round| thrown.iter().map(move |t| (f64::from(round), t)));
        let times = rounds.map(|(round, t)| (self.start_s + EVERY_S * round + t.after_s, t));
        times.filter(|(at, _)| (from_s..until_s).contains(at)).collect()
    }

    /// Every fault but the last; the disk is full and the reader stands still all the while.
    fn faults(&self, [first, third, far]: [&mut Reaped; 3]) {
        // kill -9, and back with a clock that began elsewhere.
        let at = self.now();
        third.0.kill().unwrap();
        third.0.wait().unwrap();
        let at = self.wait(at, &["lost: it does not answer"]);
        *third = emulator(&self.lab, (&self.folder, self.start_s), 1, "clock_offset_s=50");
        let at = self.wait(at, &["third Streaming"]);

        // The cable is cut for ten seconds.
        self.lab.on_host("link set cam1 down");
        std::thread::sleep(Duration::from_secs(10));
        self.wait(at, &["lost: it does not answer"]);
        let at = self.now();
        self.lab.on_host("link set cam1 up");
        let at = self.wait(at, &["third Streaming"]);

        // A lossy and reordering network loses few frames and no camera; a freeze is not a loss.
        say(first, "faults loss=0.01,reorder=0.05,reorder_ms=5");
        std::thread::sleep(Duration::from_secs_f64(EVERY_S));
        say(first, "faults loss=0,reorder=0,reorder_ms=0");
        say(third, "freeze 3");
        let at = self.wait(at, &["third Degraded"]);
        let at = self.wait(at, &["third Streaming"]);

        self.twin(far);

        // A broken configuration changes nothing; nor does one that gives two cameras one device. A good one does.
        let path = self.folder.join("pitchd.toml");
        let good = std::fs::read_to_string(&path).unwrap();
        for (text, answer) in [
            (
                format!("{good}\nserail = 1\n"),
                "reload refused, nothing has changed",
            ),
            (
                good.replace(&Lab::address(1), &Lab::address(0)),
                "reload refused, nothing has changed",
            ),
            (
                good.replace("every_pitches = 4", "every_pitches = 5"),
                "in use at once: calibrate.every_pitches",
            ),
        ] {
            std::fs::write(&path, text).unwrap();
            let from = self.now();
            signal(&self.daemon, "-HUP");
            self.wait(from, &[answer]);
        }
        self.wait(at, &["first Streaming", "third Streaming", "far Streaming"]);
    }

    /// A second camera with the last one's serial number: nobody minds while the true one streams. When that is to be
    /// found again, two answer, and neither is guessed at until the false one is gone.
    fn twin(&self, far: &mut Reaped) {
        let address = Lab::address(TWIN);
        let arguments = [
            "emulate",
            "pattern:1056x176",
            "--rate",
            "80",
            "--camera",
            "far",
            "--address",
            &address,
        ];
        let file = |end: &str| self.folder.join(format!("twin.{end}"));
        let namespace = self.lab.camera(TWIN);
        let twin = Lab::start((&namespace, Some(30)), &arguments, &file("out"), &file("log"));
        let twin = Reaped(twin);
        let at = self.now();
        std::thread::sleep(Duration::from_secs(1));
        let at = self.wait(at, &["far Streaming"]);
        say(far, "reboot 0.3");
        let places = format!("{} and {address}", Lab::address(2));
        let at = self.wait(
            at,
            &[
                "2 cameras answer to serial EMU-far",
                &places,
                "give `address` too",
            ],
        );
        drop(twin);
        self.wait(at, &["far Streaming"]);
    }

    /// Kills the daemon while a ball flies and starts it again; answers when it was killed and streams again, Unix time.
    fn kill_in_mid_pitch(&mut self, thrown: &[Thrown]) -> (f64, f64) {
        let now_s = unix_s();
        let (next_s, _) = self.thrown(thrown, (now_s + 0.5, now_s + 20.0))[0];
        std::thread::sleep(Duration::from_secs_f64(next_s - 0.2 - now_s));
        signal(&self.daemon, "-KILL");
        self.daemon.0.wait().unwrap();
        let killed_s = unix_s();
        self.log = self.folder.join("log2");
        self.daemon = self
            .lab
            .daemon(&self.folder, (&self.folder.join("out2"), &self.log));
        self.wait(0, &["going on with the last calibration"]);
        self.wait(0, &["first Streaming", "third Streaming", "far Streaming"]);
        (killed_s, unix_s())
    }
}

/// The number before `word` in the last line about a camera, while it runs or at its end.
fn number(log: &str, camera: &str, word: &str) -> u64 {
    let (ended, running) = (format!("pitchd: {camera} "), format!("{camera} Streaming: "));
    let about = |l: &&str| l.starts_with(&ended) || l.contains(&running);
    let line = log.lines().rev().find(about).unwrap();
    let before = line.split(word).next().unwrap();
    before.split_whitespace().next_back().unwrap().parse().unwrap()
}

/// Four times a camera fell silent (killed, cut off, frozen, power-cycled): each is told of within a second of its last
/// frame, by the daemon's own words.
fn told_within_a_second(log: &str) {
    let told = log.lines().filter_map(|line| {
        let digits = line.split("silent_ms=").nth(1)?;
        let digits: String = digits.chars().take_while(char::is_ascii_digit).collect();
        Some((digits.parse::<u32>().unwrap(), line))
    });
    let told: Vec<_> = told.collect();
    println!(
        "silent before it was told: {:?} ms",
        told.iter().map(|t| t.0).collect::<Vec<_>>()
    );
    assert_eq!(told.len(), 4, "{log}");
    assert_eq!(
        told.iter().filter(|t| t.1.contains("sends no frames")).count(),
        1,
        "{log}"
    );
    for (silent_ms, line) in told {
        assert!(silent_ms <= 1000, "{line}");
    }
}

#[test]
fn pitches_go_on_through_every_fault() {
    let lab = match Lab::new('d', CAMERAS.len() + 1) {
        Ok(lab) => lab,
        Err(why) => return lab::skip(&format!("network namespaces: {why}")),
    };
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let thrown = session(folder);
    let _disk = SmallDisk::new(folder);
    configure(folder);
    let start_s = unix_s() + 2.0;
    let mut first = emulator(&lab, (folder, start_s), 0, "");
    let mut third = emulator(&lab, (folder, start_s), 1, "clock_offset_s=1000,skew_ppm=30");
    let mut far = emulator(&lab, (folder, start_s), 2, "skew_ppm=-20");
    // Standard output is a pipe whose reader will stand still.
    let (out, log) = (folder.join("out"), folder.join("log"));
    assert!(Command::new("mkfifo").arg(&out).status().unwrap().success());
    let reader = Command::new("cat").arg(&out).stdout(Stdio::null()).spawn();
    let reader = Reaped(reader.unwrap());
    let daemon = lab.daemon(folder, (&out, &log));
    let mut drill = Drill {
        lab,
        folder: folder.to_owned(),
        start_s,
        log,
        daemon,
    };
    drill.wait(0, &["first Streaming", "third Streaming", "far Streaming"]);
    let streaming_s = unix_s();
    drill.wait(0, &["a calibration is in use"]);
    signal(&reader, "-STOP");
    drill.faults([&mut first, &mut third, &mut far]);
    let before = drill.text();
    let (killed_s, again_s) = drill.kill_in_mid_pitch(&thrown);
    println!("streaming again {:.1} s after kill -9", again_s - killed_s);
    std::thread::sleep(Duration::from_secs_f64(3.0 + 1.2 * EVERY_S));
    let ended_s = unix_s();
    signal(&drill.daemon, "-TERM");
    let status = drill.daemon.0.wait().unwrap();
    let log = drill.text();
    assert!(status.success(), "{log}");
    signal(&reader, "-CONT");

    assert!(before.contains("not recorded; pitches go on"), "{before}");
    let states = log.lines().filter(|l| l.starts_with("pitchd: "));
    println!("{}", states.collect::<Vec<_>>().join("\n"));
    assert!(again_s - killed_s < 5.0, "{} s", again_s - killed_s);
    told_within_a_second(&before);
    // The reader stood still from before the first fault: its lines were dropped, and nothing else noticed.
    let untaken = before.lines().rev().find_map(|l| {
        l.split(" lines not taken")
            .next()?
            .rsplit(' ')
            .next()?
            .parse::<u32>()
            .ok()
    });
    println!("{untaken:?} lines not taken");
    assert!(
        untaken.is_some_and(|n| n > 0),
        "the reader did not stand in the way:\n{before}"
    );
    let status = before
        .lines()
        .rev()
        .find(|l| l.contains("first Streaming: "))
        .unwrap();
    assert!(status.contains("lost 0 times"), "{status}");
    // A host that stands still for half a second drops frames, by itself; another camera's faults drop none.
    let (dropped, all) = (
        number(&before, "first", " dropped"),
        number(&before, "first", " frames"),
    );
    assert!(100 * dropped <= all, "{status}");
    let (frames, processed) = (
        number(&log, "first", " frames"),
        number(&log, "first", " processed"),
    );
    assert_eq!(frames, processed + number(&log, "first", " dropped"), "{log}");

    let pitches = read_pitches(&folder.join("results/pitches.jsonl")).unwrap();
    let to_unix_s = unix_s() - 1e-9 * SystemClock.monotonic().nanos() as f64;
    // A pitch that flies as the daemon is told to end is finished.
    let all = drill.thrown(&thrown, (streaming_s - 5.0, ended_s + 2.0));
    let mut seen = vec![0; all.len()];
    for (k, pitch) in pitches.iter().enumerate() {
        assert_eq!(pitch.pitch as usize, k + 1, "numbers go on");
        let at_s = to_unix_s + 1e-9 * pitch.plate_time_ns as f64;
        let (which, (thrown_s, truth)) = all
            .iter()
            .enumerate()
            .min_by(|a, b| (a.1.0 - at_s).abs().total_cmp(&(b.1.0 - at_s).abs()))
            .unwrap();
        let off = [0, 1].map(|k| pitch.plate_front_m[k] - truth.plate_m[k]);
        let speed_off = pitch.release_speed_mps - truth.speed_mps;
        println!(
            "pitch {}: {:.0} ms, {:.0} and {:.0} mm, {:.2} m/s off, {:?}",
            pitch.pitch,
            1e3 * (at_s - thrown_s),
            1e3 * off[0],
            1e3 * off[1],
            speed_off,
            pitch.points
        );
        assert!((at_s - thrown_s).abs() < 0.1, "no pitch was thrown then");
        assert!(
            off.iter().all(|o| o.abs() < 0.08) && speed_off.abs() < 1.0,
            "{pitch:?}"
        );
        seen[which] += 1;
    }
    // A camera's clock is not known in its first two seconds; a pitch at the very end may still be in the making.
    let healthy = [
        (streaming_s + 3.0, killed_s - 1.0),
        (again_s + 3.0, ended_s - 1.0),
    ];
    let mut due = 0;
    for (count, (at_s, _)) in seen.iter().zip(&all) {
        let wanted = healthy.iter().any(|(from, until)| (*from..*until).contains(at_s));
        due += usize::from(wanted);
        assert!(*count <= 1, "a pitch was published twice");
        assert!(
            *count == 1 || !wanted,
            "the pitch at {:.1} s was lost:\n{before}",
            at_s - streaming_s
        );
    }
    println!("{due} pitches were due, {} are there", pitches.len());
    assert!(due >= 12, "{due}");
}
