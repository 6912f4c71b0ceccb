//! Live = replay: a recording through emulated cameras, real UDP and `run` gives the pitches that `replay` gives.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may")]

mod lab;

use std::path::Path;
use std::process::Command;
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

fn replay(session: &Path, out: &Path) {
    let status = Command::new(env!("CARGO_BIN_EXE_pitchd"))
        .args([Path::new("replay"), session, Path::new("--out"), out])
        .output()
        .unwrap();
    assert!(
        status.status.success(),
        "{}",
        String::from_utf8_lossy(&status.stderr)
    );
}

/// Runs the daemon against two emulated cameras until it has published all pitches, then ends it by SIGTERM. Their clocks
/// are their own, or the network's (PTP).
fn live(lab: &Lab, path: &Path, folder: &Path, ptp: bool) -> String {
    let _ = std::fs::remove_dir_all(folder.join("live"));
    let session = SessionReader::open(path).unwrap();
    std::fs::write(folder.join("rig.toml"), session.rig_toml().unwrap()).unwrap();
    let mut config = "rig = \"rig.toml\"\nresults = \"live\"\n".to_owned();
    for (k, id) in CAMERAS.iter().enumerate() {
        config += &format!(
            "[[camera]]\nid = \"{id}\"\naddress = \"{}\"\npacket_size = 8000\nbuffers = 256\n\
             realtime_priority = 20\nptp = {ptp}\n",
            Lab::address(k)
        );
    }
    std::fs::write(folder.join("pitchd.toml"), config).unwrap();
    let begin = format!("{:.3}", unix_s() + 4.5);
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
            ];
            let (out, log) = (folder.join(format!("{id}.out")), folder.join(format!("{id}.log")));
            Reaped(Lab::start((&lab.camera(k), Some(30)), &arguments, &out, &log))
        })
        .collect();
    let log = folder.join("log");
    let mut daemon = lab.daemon(folder, (&folder.join("out"), &log));
    let published = folder.join("live/pitches.jsonl");
    let until = Instant::now() + Duration::from_secs(60);
    while std::fs::read_to_string(&published)
        .unwrap_or_default()
        .lines()
        .count()
        < 4
    {
        let text = std::fs::read_to_string(&log).unwrap();
        assert!(Instant::now() < until, "not four pitches:\n{text}");
        std::thread::sleep(Duration::from_millis(100));
    }
    let status = Command::new("kill")
        .args(["-TERM", &daemon.0.id().to_string()])
        .status()
        .unwrap();
    assert!(status.success());
    let status = daemon.0.wait().unwrap();
    let text = std::fs::read_to_string(&log).unwrap();
    assert!(status.success(), "{text}");
    text
}

/// The same centres. Stamps differ by the clock model's microseconds, and a fit that knows how far the ball moves during
/// an exposure follows them.
fn same_points(live: &[Track], replayed: &[Track]) {
    assert_eq!(live.len(), replayed.len(), "tracks");
    let (mut compared, mut worst_px) = (0, 0.0_f64);
    for (live, replayed) in live.iter().zip(replayed) {
        let name = format!("{} track {}", replayed.camera, replayed.track);
        assert_eq!(live.camera, replayed.camera);
        assert_eq!(live.points.len(), replayed.points.len(), "{name}");
        for (a, b) in live.points.iter().zip(&replayed.points) {
            let apart = (a.pixel.vector() - b.pixel.vector()).norm();
            worst_px = worst_px.max(apart);
            compared += 1;
        }
    }
    println!("{compared} centres, {worst_px:.4} px apart at most");
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

#[test]
fn live_is_replay() {
    let lab = match Lab::new('l', CAMERAS.len()) {
        Ok(lab) => lab,
        Err(why) => return lab::skip(&format!("network namespaces: {why}")),
    };
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let session = folder.join("session");
    without_pauses(&session);
    replay(&session, &folder.join("replay"));
    let tracks = |name: &str| read_track_folder(&folder.join(name).join("tracks")).unwrap();
    let pitches = |name: &str| read_pitches(&folder.join(name).join("pitches.jsonl")).unwrap();
    // Stamps of clocks that follow the network's fit each other exactly. Those of free-running cameras are as good as the
    // host's arrivals: on two busy cores two clocks are some 5 µs off each other, 0.2 mm of flight, where the points of
    // this noise-free recording are good to 0.01 px. Seen: 0.01 to 0.8 sigma.
    for (ptp, sigmas_max) in [(true, 0.1), (false, 1.0)] {
        println!("clocks of {}", if ptp { "the network" } else { "their own" });
        // A frame that this host lost (it stood still) is a track with a hole: that run proves nothing.
        let whole = (0..3).any(|_| {
            let log = live(&lab, &session, folder, ptp);
            assert_eq!(
                log.matches("stamped by the network's clock").count(),
                if ptp { CAMERAS.len() } else { 0 }
            );
            let lines = log.lines().filter(|l| l.starts_with("pitchd: "));
            lines
                .inspect(|l| println!("{l}"))
                .filter(|l| l.contains(" 0 missing "))
                .count()
                == CAMERAS.len()
        });
        assert!(whole, "frames were missing three times");
        same_points(&tracks("live"), &tracks("replay"));
        same_numbers(&pitches("live"), &pitches("replay"), sigmas_max);
    }
}
