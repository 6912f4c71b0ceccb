//! Live = replay: a recording through emulated cameras, real UDP and `run` gives the pitches that `replay` gives.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may")]

mod lab;

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use lab::{Lab, Reaped, unix_s};
use pitchd::export::results::read_pitches;
use pitchd::recording::{
    CameraGeometry, RecordedFrame, SessionOptions, SessionReader, SessionWriter, read_track_folder,
};
use pitchd::scene::{CameraId, Pitch, Track};
use pitchd::time::StampedMidpoint;

const BUNDLED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/recordings/bullpen");
const CAMERAS: [&str; 2] = ["first", "third"];

/// Seconds before the first clip, in which the clocks settle, and the longest pause between clips.
const LEAD_S: f64 = 14.0;
const PAUSE_S: f64 = 1.5;

/// The bundled recording has four short clips; cameras never stop. Here every pause is filled with the clip's first two
/// frames in turn (no ball, the true noise), and cut short.
fn without_pauses(folder: &Path) {
    let bundled = SessionReader::open(Path::new(BUNDLED)).unwrap();
    let options = SessionOptions {
        rig_toml: bundled.rig_toml().unwrap().to_owned(),
        ..SessionOptions::default()
    };
    let mut session = SessionWriter::create(folder, options).unwrap();
    let period_ns = 12_500_000;
    // Every clip begins at the same shift for both cameras: by the clip's number, from the first camera's stamps.
    let mut shifts: Vec<i64> = Vec::new();
    for id in CAMERAS {
        let id = CameraId::new(id).unwrap();
        let frames: Vec<RecordedFrame> = bundled.frames(&id).unwrap().collect();
        let stamp = |f: &RecordedFrame| f.frame.stamp.stamped.nanos();
        let clips: Vec<&[RecordedFrame]> = frames
            .chunk_by(|a, b| stamp(b) - stamp(a) < 300_000_000)
            .collect();
        assert_eq!(clips.len(), 4);
        let geometry = CameraGeometry {
            width_px: frames[0].frame.width_px,
            height_px: frames[0].frame.height_px,
        };
        let mut camera = session.camera(&id, geometry).unwrap();
        let mut last_ns = stamp(&frames[0]) - (1e9 * LEAD_S) as i64;
        let mut number = 0;
        let mut write = |source: &RecordedFrame, stamp_ns: i64| {
            let mut made = source.clone();
            number += 1;
            made.frame.stamp.frame = number;
            made.frame.stamp.stamped = StampedMidpoint::from_nanos(stamp_ns);
            camera.write(&made).unwrap();
        };
        for (k, clip) in clips.iter().enumerate() {
            if shifts.len() <= k {
                let pause_ns = if k == 0 { LEAD_S } else { PAUSE_S } * 1e9;
                shifts.push(last_ns + pause_ns as i64 - stamp(&clip[0]));
            }
            let begin_ns = stamp(&clip[0]) + shifts[k];
            let quiet = (begin_ns - last_ns) / period_ns - 1;
            for back in (1..=quiet).rev() {
                write(&clip[(back % 2) as usize], begin_ns - back * period_ns);
            }
            for frame in *clip {
                write(frame, stamp(frame) + shifts[k]);
            }
            last_ns = stamp(clip.last().unwrap()) + shifts[k];
        }
        for k in 1..80 {
            write(&clips[3][(k % 2) as usize], last_ns + k * period_ns);
        }
        camera.finish().unwrap();
    }
    session.finish().unwrap();
}

fn replay(session: &Path, out: &Path, known: Option<&Path>) {
    let known = known
        .into_iter()
        .flat_map(|file| [Path::new("--calibration"), file]);
    let status = Command::new(env!("CARGO_BIN_EXE_pitchd"))
        .args([Path::new("replay"), session, Path::new("--out"), out])
        .args(known)
        .output()
        .unwrap();
    assert!(
        status.status.success(),
        "{}",
        String::from_utf8_lossy(&status.stderr)
    );
}

/// How the daemon is run.
#[derive(Clone, Copy)]
struct Round {
    /// Whether the cameras' clocks are the network's (PTP), or their own.
    ptp: bool,
    /// How the cameras send their pixels.
    formats: [&'static str; 2],
    /// Whether it begins with the calibration that the last run has made.
    calibrated: bool,
    /// SIGTERM comes so many seconds after the session's begin; `None`: when all pitches are published.
    told_after_s: Option<f64>,
}

/// SIGTERM so long before the last ball's plate: it flies for another 0.2 s, and its path ends later still.
const BEFORE_PLATE_S: f64 = 0.2;

/// From the session's begin to 0.2 s before its last ball is at the plate.
fn in_mid_pitch_s(session: &SessionReader, pitches: &[Pitch]) -> f64 {
    let begin_ns = CAMERAS.iter().map(|id| {
        let mut frames = session.frames(&CameraId::new(id).unwrap()).unwrap();
        frames.next().unwrap().frame.stamp.stamped.nanos()
    });
    let plate_ns = pitches.iter().map(|p| p.plate_time_ns).max().unwrap();
    1e-9 * (plate_ns - begin_ns.min().unwrap()) as f64 - BEFORE_PLATE_S
}

/// The pitches that are published so far.
fn published(folder: &Path) -> usize {
    let text = std::fs::read_to_string(folder.join("live/pitches.jsonl"));
    text.unwrap_or_default().lines().count()
}

/// Runs the daemon against two emulated cameras until it is time, then ends it by SIGTERM. In mid-pitch the cameras are
/// known by their names, and each one's address is the other's: they are sought, and found.
fn live(lab: &Lab, path: &Path, folder: &Path, round: Round) -> String {
    let made = folder.join("live/calibration.json");
    if round.calibrated && made.exists() {
        std::fs::rename(made, folder.join("known.json")).unwrap();
    }
    let _ = std::fs::remove_dir_all(folder.join("live"));
    let session = SessionReader::open(path).unwrap();
    std::fs::write(folder.join("rig.toml"), session.rig_toml().unwrap()).unwrap();
    let mut config = "rig = \"rig.toml\"\nresults = \"live\"\n".to_owned();
    if round.calibrated {
        config += "calibration = \"known.json\"\n";
    }
    for (k, id) in CAMERAS.iter().enumerate() {
        let which = match round.told_after_s {
            None => format!("address = \"{}\"", Lab::address(k)),
            Some(_) => format!("address = \"{}\"\nuser_name = \"{id}\"", Lab::address(1 - k)),
        };
        config += &format!(
            "[[camera]]\nid = \"{id}\"\n{which}\npacket_size = 8000\nbuffers = 256\n\
             realtime_priority = 20\nptp = {}\npixel_format = \"{}\"\n",
            round.ptp, round.formats[k]
        );
    }
    std::fs::write(folder.join("pitchd.toml"), config).unwrap();
    let begin_s = unix_s() + 4.5;
    let begin = format!("{begin_s:.3}");
    let _emulators: Vec<Reaped> = CAMERAS
        .iter()
        .enumerate()
        .map(|(k, id)| {
            let address = Lab::address(k);
            let arguments = [
                "emulate",
                path.to_str().unwrap(),
                "--camera",
                id,
                "--address",
                &address,
                "--start-at",
                &begin,
                "--between",
                "silent",
                "--pixel-format",
                round.formats[k],
            ];
            let (out, log) = (folder.join(format!("{id}.out")), folder.join(format!("{id}.log")));
            Reaped(Lab::start((&lab.camera(k), Some(30)), &arguments, &out, &log))
        })
        .collect();
    let log = folder.join("log");
    let mut daemon = lab.daemon(folder, (&folder.join("out"), &log));
    let until = Instant::now() + Duration::from_secs(60);
    let is_time = || match round.told_after_s {
        None => published(folder) == 4,
        Some(after_s) => unix_s() >= begin_s + after_s,
    };
    while !is_time() {
        let text = std::fs::read_to_string(&log).unwrap();
        assert!(Instant::now() < until, "not four pitches:\n{text}");
        std::thread::sleep(Duration::from_millis(10));
    }
    let published_before = published(folder);
    let status = Command::new("kill")
        .args(["-TERM", &daemon.0.id().to_string()])
        .status()
        .unwrap();
    assert!(status.success());
    let status = daemon.0.wait().unwrap();
    let text = std::fs::read_to_string(&log).unwrap();
    assert!(status.success(), "{text}");
    println!(
        "{published_before} pitches when it was told to end, {} at its end",
        published(folder)
    );
    assert!(
        round.told_after_s.is_none() || published_before < 4,
        "the ball had landed"
    );
    text
}

/// The same centres. Stamps differ by the clock model's microseconds, and a fit that knows how far the ball moves during
/// an exposure follows them.
fn same_points(live: &[Track], replayed: &[Track]) {
    assert_eq!(live.len(), replayed.len(), "tracks");
    let (mut compared, mut worst_px, mut worst_ns) = (0, 0.0_f64, 0);
    for (live, replayed) in live.iter().zip(replayed) {
        let name = format!("{} track {}", replayed.camera, replayed.track);
        assert_eq!(live.camera, replayed.camera);
        assert_eq!(live.points.len(), replayed.points.len(), "{name}");
        // Both by one line over the whole ball, whatever each line is: no point keeps the stamp of its arrival.
        let offsets = live.points.iter().zip(&replayed.points);
        let offsets = offsets.map(|(a, b)| a.stamped.nanos() - b.stamped.nanos());
        let (least, most) = offsets.fold((i64::MAX, i64::MIN), |(l, m), o| (l.min(o), m.max(o)));
        worst_ns = worst_ns.max(most - least);
        assert!(most - least < 50_000, "{name}: stamps {} ns apart", most - least);
        for (a, b) in live.points.iter().zip(&replayed.points) {
            let apart = (a.pixel.vector() - b.pixel.vector()).norm();
            assert!(apart < 0.01, "{name} frame {}: {apart} px apart", b.frame);
            worst_px = worst_px.max(apart);
            compared += 1;
        }
    }
    println!("{compared} centres, {worst_px:.4} px apart at most; stamps of a ball {worst_ns} ns");
    assert!(compared > 200, "{compared} points");
}

/// Every number within so many of its sigmas.
fn same_numbers(live: &[Pitch], replayed: &[Pitch], sigmas_max: f64) {
    assert_eq!((live.len(), replayed.len()), (4, 4));
    let mut wrong = Vec::new();
    for (a, b) in live.iter().zip(replayed) {
        let mut pairs = vec![(
            a.release_speed_mps,
            b.release_speed_mps,
            b.sigma.release_speed_mps,
            "speed",
        )];
        for k in 0..2 {
            pairs.push((
                a.plate_front_m[k],
                b.plate_front_m[k],
                b.sigma.plate_front_m[k],
                "plate",
            ));
        }
        for (x, y, sigma, what) in pairs {
            let apart = (x - y) / sigma;
            println!("pitch {} {what}: {apart:.3} sigma", b.pitch);
            if apart.abs() >= sigmas_max {
                wrong.push(format!(
                    "pitch {} {what}: {x} live, {y} replayed, sigma {sigma}",
                    b.pitch
                ));
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:?}");
}

/// Every test needs the whole machine.
static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

/// Network namespaces, and the recording replayed in a folder of its own: its session is `session`, its results `replay`.
struct Stage {
    lab: Lab,
    folder: tempfile::TempDir,
    _alone: MutexGuard<'static, ()>,
}

impl Stage {
    /// `None`: the test is skipped.
    fn new(tag: char) -> Option<Self> {
        let alone = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
        let lab = match Lab::new(tag, CAMERAS.len()) {
            Ok(lab) => lab,
            Err(why) => {
                lab::skip(&format!("network namespaces: {why}"));
                return None;
            }
        };
        let folder = tempfile::tempdir().unwrap();
        let session = folder.path().join("session");
        without_pauses(&session);
        replay(&session, &folder.path().join("replay"), None);
        Some(Self {
            lab,
            folder,
            _alone: alone,
        })
    }

    fn session(&self) -> PathBuf {
        self.folder.path().join("session")
    }

    fn tracks(&self, name: &str) -> Vec<Track> {
        read_track_folder(&self.folder.path().join(name).join("tracks")).unwrap()
    }

    fn pitches(&self, name: &str) -> Vec<Pitch> {
        read_pitches(&self.folder.path().join(name).join("pitches.jsonl")).unwrap()
    }

    /// Runs the daemon until no frame is lost. A frame that this host lost (it stood still) is a track with a hole: that
    /// run proves nothing.
    fn run(&self, round: Round) {
        let whole = (0..3).any(|_| {
            let log = live(&self.lab, &self.session(), self.folder.path(), round);
            assert_eq!(
                log.matches("stamped by the network's clock").count(),
                if round.ptp { CAMERAS.len() } else { 0 }
            );
            let lines = log.lines().filter(|l| l.starts_with("pitchd: "));
            lines
                .inspect(|l| println!("{l}"))
                .filter(|l| l.contains(" 0 missing "))
                .count()
                == CAMERAS.len()
        });
        assert!(whole, "frames were missing three times");
    }
}

#[test]
fn live_is_replay() {
    let Some(stage) = Stage::new('l') else { return };
    // Stamps of clocks that follow the network's fit each other exactly. Those of free-running cameras are as good as the
    // host's arrivals, some 5 µs (15 on a busy machine) off from ball to ball: 0.01 to 0.04 px, where the points of this
    // noise-free recording are good to 0.01 px and its plates are told by no more than four balls. DESIGN.md, Clocks, has
    // what that moves: 0.5 sigma by 5 µs, 2 by 15.
    // The recording has eight bits; packed cameras send them as the upper ones of ten and twelve.
    let packed = ["Mono12p", "Mono10Packed"];
    for (ptp, sigmas_max, formats) in [(true, 0.1, ["Mono8"; 2]), (false, 3.0, packed)] {
        println!(
            "clocks of {}, {formats:?}",
            if ptp { "the network" } else { "their own" }
        );
        stage.run(Round {
            ptp,
            formats,
            calibrated: false,
            told_after_s: None,
        });
        same_points(&stage.tracks("live"), &stage.tracks("replay"));
        same_numbers(&stage.pitches("live"), &stage.pitches("replay"), sigmas_max);
    }
}

/// With a calibration from the beginning cameras tell each other where the ball will be, and how large it is: live when the
/// news has come, in a replay in step.
#[test]
fn what_cameras_tell_each_other_live_they_tell_in_a_replay() {
    let Some(stage) = Stage::new('t') else { return };
    for calibrated in [false, true] {
        stage.run(Round {
            ptp: true,
            formats: ["Mono8"; 2],
            calibrated,
            told_after_s: None,
        });
    }
    let folder = stage.folder.path();
    let known = folder.join("replay/calibration.json");
    replay(&stage.session(), &folder.join("replay-known"), Some(&known));
    same_points(&stage.tracks("live"), &stage.tracks("replay-known"));
    same_numbers(&stage.pitches("live"), &stage.pitches("replay-known"), 0.5);
}

/// SIGTERM while the last ball flies, with which the first calibration is to be made: nothing is published yet, and
/// everything is at the end, that ball followed to its end and with the numbers of the replay.
#[test]
fn a_ball_in_flight_at_sigterm_is_followed_to_its_end() {
    let Some(stage) = Stage::new('e') else { return };
    let replayed = stage.pitches("replay");
    let session = SessionReader::open(&stage.session()).unwrap();
    stage.run(Round {
        ptp: true,
        formats: ["Mono8"; 2],
        calibrated: false,
        told_after_s: Some(in_mid_pitch_s(&session, &replayed)),
    });
    // The last frames that its path could have had are not waited for: it may end a point or two sooner or later.
    let points = |name: &str| {
        let tracks = stage.tracks(name).into_iter();
        tracks.map(|t| (t.camera, t.points.len())).collect::<Vec<_>>()
    };
    let (live, replayed_points) = (points("live"), points("replay"));
    println!("{live:?} live, {replayed_points:?} replayed");
    assert_eq!(live.len(), replayed_points.len(), "tracks");
    for (live, replayed) in live.iter().zip(&replayed_points) {
        assert!(
            live.0 == replayed.0 && live.1 + 3 >= replayed.1,
            "{live:?} of {replayed:?}"
        );
    }
    same_numbers(&stage.pitches("live"), &replayed, 1.0);
}
