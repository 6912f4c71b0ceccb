//! The fault drill, in one go: cameras killed, cut off, slowed and doubled while the daemon runs, in namespaces.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may")]

mod lab;

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use lab::{Lab, Reaped};

const CAMERAS: [&str; 2] = ["first", "third"];

struct Drill {
    lab: Lab,
    folder: PathBuf,
    daemon: Reaped,
}

fn emulator(lab: &Lab, folder: &Path, k: usize, faults: &str) -> Reaped {
    let (id, address) = (CAMERAS[k], Lab::address(k));
    let arguments = [
        "emulate",
        "pattern:320x160",
        "--rate",
        "40",
        "--camera",
        id,
        "--address",
        &address,
        "--faults",
        faults,
    ];
    let file = |end: &str| folder.join(format!("{id}.{end}"));
    Reaped(Lab::start(
        (&lab.camera(k), None),
        &arguments,
        &file("out"),
        &file("log"),
    ))
}

fn say(emulator: &mut Reaped, line: &str) {
    let pipe = emulator.0.stdin.as_mut().unwrap();
    writeln!(pipe, "{line}").unwrap();
}

impl Drill {
    fn start(lab: Lab, folder: &Path) -> Self {
        let (mut rig, mut config) = (
            String::new(),
            "rig = \"rig.toml\"\nresults = \"results\"\n[record]\nmode = \"continuous\"\nfolder = \"no-folder\"\n"
                .to_owned(),
        );
        // The recordings' folder is a file: a disk that is gone.
        std::fs::write(folder.join("no-folder"), "x").unwrap();
        for (k, id) in CAMERAS.iter().enumerate() {
            rig += &format!(
                "[[camera]]\nid = \"{id}\"\nwidth_px = 320\nheight_px = 160\nframe_rate_hz = 40.0\n\
                 [camera.intrinsics]\nfx_px = 600.0\nfy_px = 600.0\ncx_px = 319.5\ncy_px = 159.5\n"
            );
            config += &format!(
                "[[camera]]\nid = \"{id}\"\naddress = \"{}\"\npacket_size = 8000\nrealtime_priority = 0\n",
                Lab::address(k)
            );
        }
        std::fs::write(folder.join("rig.toml"), rig).unwrap();
        std::fs::write(folder.join("pitchd.toml"), config).unwrap();
        let path = folder.join("pitchd.toml");
        let arguments = [
            "-v",
            "run",
            "--status-every",
            "0.2",
            "--config",
            path.to_str().unwrap(),
        ];
        let (out, log) = (folder.join("out"), folder.join("log"));
        let daemon = Reaped(Lab::start((&lab.host(), None), &arguments, &out, &log));
        Self {
            lab,
            folder: folder.to_owned(),
            daemon,
        }
    }

    fn log(&self) -> String {
        std::fs::read_to_string(self.folder.join("log")).unwrap()
    }

    /// Waits until the log, from now on, has all of `wanted`.
    fn wait(&self, from: usize, wanted: &[&str]) -> usize {
        let until = Instant::now() + Duration::from_secs(40);
        loop {
            let log = self.log();
            if wanted.iter().all(|w| log[from..].contains(w)) {
                return log.len();
            }
            assert!(Instant::now() < until, "no {wanted:?} in:\n{}", &log[from..]);
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    fn now(&self) -> usize {
        self.log().len()
    }

    fn signal(&self, name: &str) {
        let id = self.daemon.0.id().to_string();
        assert!(Command::new("kill").args([name, &id]).status().unwrap().success());
    }
}

/// The number before `word` in the last line about a camera.
fn number(log: &str, camera: &str, word: &str) -> u64 {
    let line = log
        .lines()
        .rev()
        .find(|l| l.starts_with(&format!("pitchd: {camera}")))
        .unwrap();
    let before = line.split(word).next().unwrap();
    before.split_whitespace().next_back().unwrap().parse().unwrap()
}

#[test]
fn the_daemon_goes_on_through_every_fault() {
    let lab = match Lab::new('d', CAMERAS.len()) {
        Ok(lab) => lab,
        Err(why) => return println!("skipped: no network namespaces here: {why}"),
    };
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let mut first = emulator(&lab, folder, 0, "");
    let mut third = emulator(&lab, folder, 1, "clock_offset_s=1000");
    let mut drill = Drill::start(lab, folder);
    let at = drill.wait(
        0,
        &[
            "first Streaming",
            "third Streaming",
            "not recorded; pitches go on",
        ],
    );

    // kill -9, and back with a clock that began anew.
    third.0.kill().unwrap();
    third.0.wait().unwrap();
    let at = drill.wait(at, &["lost: it does not answer"]);
    third = emulator(&drill.lab, folder, 1, "");
    let at = drill.wait(at, &["third Streaming"]);

    // The cable is cut.
    drill.lab.on_host("link set cam1 down");
    let at = drill.wait(at, &["lost: it does not answer"]);
    drill.lab.on_host("link set cam1 up");
    let at = drill.wait(at, &["third Streaming"]);

    // A lossy and reordering network loses few frames and no camera; a freeze is not a loss.
    say(&mut first, "faults loss=0.01,reorder=0.05,reorder_ms=5");
    std::thread::sleep(Duration::from_secs(2));
    say(&mut first, "faults loss=0,reorder=0,reorder_ms=0");
    say(&mut third, "freeze 3");
    let at = drill.wait(at, &["third Degraded"]);
    let at = drill.wait(at, &["third Streaming"]);

    // A broken configuration changes nothing; nor does one that gives two cameras one device.
    let path = folder.join("pitchd.toml");
    let good = std::fs::read_to_string(&path).unwrap();
    for broken in [
        format!("{good}\nserail = 1\n"),
        good.replace(&Lab::address(1), &Lab::address(0)),
    ] {
        std::fs::write(&path, broken).unwrap();
        let from = drill.now();
        drill.signal("-HUP");
        drill.wait(from, &["reload refused, nothing has changed"]);
    }
    drill.wait(at, &["first Streaming", "third Streaming"]);

    drill.signal("-TERM");
    let status = drill.daemon.0.wait().unwrap();
    let log = drill.log();
    assert!(status.success(), "{log}");
    println!(
        "{}",
        log.lines()
            .filter(|l| l.starts_with("pitchd: "))
            .collect::<Vec<_>>()
            .join("\n")
    );
    // The healthy camera was never lost, and every missing frame has a number.
    assert!(
        log.contains("pitchd: first") && number(&log, "first", " times") == 0,
        "{log}"
    );
    assert_eq!(number(&log, "third", " times"), 2, "{log}");
    let (frames, processed) = (
        number(&log, "first", " frames"),
        number(&log, "first", " processed"),
    );
    let dropped = number(&log, "first", " dropped");
    assert_eq!(frames, processed + dropped, "{log}");
    assert!(
        processed > 100 && number(&log, "first", " missing") < frames / 10,
        "{log}"
    );
    // A loss is noticed after 0.6 s of silence and a question; a starved test machine may take twice as long.
    let silent: Vec<u64> = log
        .split("silent_ms")
        .skip(1)
        .map(|rest| {
            let digits = rest
                .trim_start_matches(|c: char| c != '=')
                .trim_start_matches('=');
            let digits: String = digits
                .chars()
                .skip_while(|c| !c.is_ascii_digit())
                .take_while(char::is_ascii_digit)
                .collect();
            digits.parse().unwrap()
        })
        .collect();
    println!("silent before they were called lost: {silent:?} ms");
    assert!(
        silent.len() == 2 && silent.iter().all(|ms| *ms < 2000),
        "{silent:?}"
    );
}
