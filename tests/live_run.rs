//! `pitchd run` as a person or systemd starts it, against emulated cameras on loopback addresses.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may")]

mod lab;

use std::io::Read;
use std::net::Ipv4Addr;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use lab::Reaped;
use pitchd::emulation::{Drill, Emulator, EmulatorOptions, ScriptShape, pattern};
use pitchd::recording::SessionReader;
use pitchd::scene::{CameraId, Frame};

const SHAPE: ScriptShape = ScriptShape {
    width_px: 320,
    height_px: 160,
    rate_hz: 40.0,
    exposure_s: 0.001,
};

fn emulator(last: u8, serial: &str) -> Emulator {
    let options = EmulatorOptions::new(Ipv4Addr::new(127, 0, 93, last), serial);
    Emulator::start(&options, SHAPE, pattern(SHAPE)).unwrap()
}

fn rig(folder: &Path, cameras: &[(&str, u8)]) {
    let camera = |id: &str| {
        format!(
            "[[camera]]\nid = \"{id}\"\nwidth_px = 320\nheight_px = 160\nframe_rate_hz = 40.0\n[camera.intrinsics]\n\
             fx_px = 300.0\nfy_px = 300.0\ncx_px = 159.5\ncy_px = 79.5\n"
        )
    };
    let rig: String = cameras.iter().map(|(id, _)| camera(id)).collect();
    std::fs::write(folder.join("rig.toml"), rig).unwrap();
    let connection = |(id, last): &(&str, u8)| {
        format!(
            "[[camera]]\nid = \"{id}\"\naddress = \"127.0.93.{last}\"\npacket_size = 1500\nrealtime_priority = 0\nbuffers = 16\n"
        )
    };
    let config: String = cameras.iter().map(connection).collect();
    std::fs::write(
        folder.join("pitchd.toml"),
        format!("rig = \"rig.toml\"\nresults = \"results\"\n{config}"),
    )
    .unwrap();
}

fn record_continuously(folder: &Path) {
    let config = std::fs::read_to_string(folder.join("pitchd.toml")).unwrap();
    let record = "[record]\nmode = \"continuous\"\nfolder = \"recordings\"\nmemory_mib = 64\n";
    let (head, cameras) = config.split_at(config.find("[[camera]]").unwrap());
    std::fs::write(folder.join("pitchd.toml"), format!("{head}{record}{cameras}")).unwrap();
}

fn start(folder: &Path) -> Child {
    Command::new(env!("CARGO_BIN_EXE_pitchd"))
        .args(["-v", "run", "--status-every", "0.2", "--config"])
        .arg(folder.join("pitchd.toml"))
        .stdout(Stdio::piped())
        .stderr(Stdio::from(std::fs::File::create(folder.join("log")).unwrap()))
        .spawn()
        .unwrap()
}

fn log(folder: &Path) -> String {
    std::fs::read_to_string(folder.join("log")).unwrap()
}

/// Waits until the log, from `from` on, has all of `wanted`; answers the log's length then.
fn wait_for(folder: &Path, from: usize, wanted: &[&str]) -> usize {
    let until = Instant::now() + Duration::from_secs(60);
    loop {
        let log = log(folder);
        if wanted.iter().all(|w| log[from..].contains(w)) {
            return log.len();
        }
        assert!(Instant::now() < until, "no {wanted:?} in:\n{}", &log[from..]);
        std::thread::sleep(Duration::from_millis(50));
    }
}

fn signal(child: &Child, name: &str) {
    let status = Command::new("kill")
        .args([name, &child.id().to_string()])
        .status()
        .unwrap();
    assert!(status.success());
}

#[test]
fn the_daemon_outlives_its_cameras_and_ends_with_zero() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    rig(folder, &[("first", 1), ("third", 2)]);
    let first = emulator(1, "R1");
    let mut daemon = start(folder);
    // The second camera is not there yet, the first does not care.
    let at = wait_for(
        folder,
        0,
        &[
            "camera third: no answer from address 127.0.93.2",
            "first Streaming",
        ],
    );
    let third = emulator(2, "R2");
    let at = wait_for(folder, at, &["third Streaming"]);
    // Power off and on: lost, found, streaming, and the other never stops.
    third.drill(Drill::Reboot(Duration::from_secs(2)));
    let at = wait_for(folder, at, &["lost: it", "third Streaming"]);
    let losses = log(folder)[..at].matches("first Streaming").count();
    assert!(losses > 0);
    // A broken file changes nothing.
    let config = std::fs::read_to_string(folder.join("pitchd.toml")).unwrap();
    std::fs::write(folder.join("pitchd.toml"), format!("{config}\nserail = 1\n")).unwrap();
    signal(&daemon, "-HUP");
    let at = wait_for(folder, at, &["reload refused, nothing has changed"]);
    wait_for(folder, at, &["first Streaming", "third Streaming"]);
    signal(&daemon, "-TERM");
    let status = daemon.wait().unwrap();
    let log = log(folder);
    assert!(status.success(), "{log}");
    let last = log
        .lines()
        .rev()
        .find(|l| l.starts_with("pitchd: first"))
        .unwrap();
    assert!(
        last.contains("lost 0 times") && !last.contains(" 0 processed"),
        "{last}"
    );
    assert!(
        log.lines()
            .any(|l| l.starts_with("pitchd: third") && l.contains("lost 1 times")),
        "{log}"
    );
    assert!(first.counters().frames > 0);
    let mut out = String::new();
    daemon.stdout.take().unwrap().read_to_string(&mut out).unwrap();
    assert_eq!(out, "", "no ball, no pitch");
}

/// A camera that stands still when the daemon is told to end is not waited for, and what it sent before is kept.
#[test]
fn a_frozen_camera_holds_up_no_end() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    rig(folder, &[("first", 31), ("third", 32)]);
    record_continuously(folder);
    let _first = emulator(31, "S1");
    let frozen = Command::new(env!("CARGO_BIN_EXE_pitchd"))
        .args(["emulate", "pattern:320x160", "--rate", "40", "--camera", "third"])
        .args(["--address", "127.0.93.32"])
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .spawn();
    let mut frozen = Reaped(frozen.unwrap());
    let mut daemon = start(folder);
    wait_for(folder, 0, &["first Streaming", "third Streaming"]);
    std::thread::sleep(Duration::from_secs(1));
    let status = std::fs::read_to_string(format!("/proc/{}/status", daemon.id())).unwrap();
    assert!(lab::is_locked_or_said(&status, &log(folder)), "{status}");
    signal(&frozen.0, "-STOP");
    signal(&daemon, "-TERM");
    let told = Instant::now();
    let status = daemon.wait().unwrap();
    let took_s = told.elapsed().as_secs_f64();
    println!("ended {took_s:.2} s after SIGTERM");
    frozen.0.kill().unwrap();
    let log = log(folder);
    assert!(status.success() && took_s < 4.0, "{took_s} s:\n{log}");
    assert!(log.contains("does not answer"), "{log}");
    assert!(!log.contains("still at work"), "{log}");
    let session = std::fs::read_dir(folder.join("recordings")).unwrap().next();
    let session = session.unwrap().unwrap().path();
    for (id, frames) in frames_of_whole(&session) {
        assert!(frames.len() >= 30, "{id}: {} frames", frames.len());
    }
}

/// Every camera's frames of a recording that must be whole.
fn frames_of_whole(session: &Path) -> Vec<(&'static str, Vec<Frame>)> {
    let verified = pitchd(&["info", session.to_str().unwrap(), "--verify"]);
    let said = String::from_utf8_lossy(&verified.stderr);
    assert!(verified.status.success(), "{said}");
    let reader = SessionReader::open(session).unwrap();
    let cameras = ["first", "third"].into_iter();
    cameras
        .map(|id| {
            let frames = reader.frames(&CameraId::new(id).unwrap()).unwrap();
            (id, frames.map(|recorded| recorded.frame).collect())
        })
        .collect()
}

fn pitchd(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_pitchd"))
        .args(arguments)
        .output()
        .unwrap()
}

#[test]
fn cameras_and_check_say_what_is_there() {
    let folder = tempfile::tempdir().unwrap();
    rig(folder.path(), &[("first", 11), ("third", 12)]);
    let _first = emulator(11, "C11");
    let listed = pitchd(&["cameras", "--json", "--address", "127.0.93.11"]);
    let rows: serde_json::Value = serde_json::from_slice(&listed.stdout).unwrap();
    assert_eq!(
        (rows[0]["serial"].as_str(), rows[0]["in_use"].as_bool()),
        (Some("C11"), Some(false))
    );
    assert!(!pitchd(&["cameras", "--address", "127.0.93.99"]).status.success());

    let config = folder.path().join("pitchd.toml");
    let checked = pitchd(&["check", "--json", "--config", config.to_str().unwrap()]);
    assert_eq!(checked.status.code(), Some(1), "one camera is missing");
    let lines: serde_json::Value = serde_json::from_slice(&checked.stdout).unwrap();
    let verdict = |what: &str| {
        let found = lines.as_array().unwrap().iter().find(|l| l["what"] == what);
        found.map(|l| l["verdict"].as_str().unwrap().to_owned())
    };
    let found = |what: &str| {
        let found = lines.as_array().unwrap().iter().find(|l| l["what"] == what);
        found.map(|l| l["found"].as_str().unwrap().to_owned()).unwrap()
    };
    assert_eq!(
        verdict("camera first").as_deref(),
        Some("ok"),
        "{}",
        found("camera first")
    );
    assert!(
        found("camera first").contains("40.0 Hz"),
        "{}",
        found("camera first")
    );
    assert_eq!(verdict("camera third").as_deref(), Some("fail"));
    assert!(verdict("socket buffers (net.core.rmem_max)").is_some());
}

/// Everything recorded by a daemon that is killed is there up to its last second, and whole after `pitchd recover`.
#[test]
fn a_killed_daemons_recording_is_whole_up_to_its_last_second() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    rig(folder, &[("first", 21), ("third", 22)]);
    record_continuously(folder);
    let _cameras = (emulator(21, "K1"), emulator(22, "K2"));
    let mut daemon = start(folder);
    let recorded = |folder: &Path| {
        let mut sessions = std::fs::read_dir(folder.join("recordings")).into_iter().flatten();
        sessions.next().map(|s| s.unwrap().path())
    };
    let at = wait_for(folder, 0, &["first Streaming", "third Streaming"]);
    let session = loop {
        if let Some(session) = recorded(folder) {
            break session;
        }
        std::thread::sleep(Duration::from_millis(20));
    };
    std::thread::sleep(Duration::from_millis(5300));
    wait_for(folder, at, &["third Streaming"]);
    daemon.kill().unwrap();
    daemon.wait().unwrap();
    let seen = |id: &str| -> u64 {
        let log = log(folder);
        let line = log
            .lines()
            .rev()
            .find(|l| l.contains(&format!("{id} Streaming: ")))
            .unwrap();
        let number = line.split("Streaming: ").nth(1).unwrap();
        number.split(' ').next().unwrap().parse().unwrap()
    };
    let path = session.to_str().unwrap();
    assert!(!pitchd(&["info", path]).status.success(), "it was killed");
    let mended = pitchd(&["recover", path]);
    println!("{}", String::from_utf8_lossy(&mended.stdout));
    for (id, frames) in frames_of_whole(&session) {
        let numbers: Vec<u64> = frames.iter().map(|f| f.stamp.frame).collect();
        println!(
            "{id}: {} frames, the last is {:?}, {} were seen",
            frames.len(),
            numbers.last(),
            seen(id)
        );
        assert!(
            numbers.windows(2).all(|pair| pair[1] == pair[0] + 1),
            "{id}: a frame is missing: {numbers:?}"
        );
        // 40 Hz: a flush a second, and what was on its way to the disk.
        let last = *numbers.last().unwrap();
        assert!(last + 60 >= seen(id), "{id}: {last} of {}", seen(id));
        let expected: Vec<_> = pattern(SHAPE).take(16).map(|f| f.pixels).collect();
        assert!(
            frames
                .iter()
                .all(|f| expected.iter().any(|e| e[..] == *f.bytes())),
            "{id}"
        );
    }
}
