//! `pitchd solve` and `replay`, run as a person would: pitches against truth, and what damage and mistakes do.

#![allow(clippy::unwrap_used, clippy::panic)]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;

const SCENARIO: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/config/scenario/three.toml");
const RECORDING: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/recordings/bullpen");

struct Place {
    folder: tempfile::TempDir,
}

impl Place {
    fn new() -> Self {
        Self {
            folder: tempfile::tempdir().unwrap(),
        }
    }
    /// Simulated tracks of three cameras in `scene/`.
    fn with_tracks() -> Self {
        let place = Self::new();
        let made = place.pitchd(&["simulate", SCENARIO, "--out", "scene"]);
        assert!(made.status.success(), "{}", stderr(&made));
        place
    }
    /// A copy of the bundled recording in `session/`.
    fn with_session() -> Self {
        let place = Self::new();
        fs::create_dir(place.path("session")).unwrap();
        for file in fs::read_dir(RECORDING).unwrap() {
            let file = file.unwrap();
            fs::copy(file.path(), place.path("session").join(file.file_name())).unwrap();
        }
        place
    }
    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }
    fn pitchd(&self, arguments: &[&str]) -> Output {
        Command::new(env!("CARGO_BIN_EXE_pitchd"))
            .current_dir(self.folder.path())
            .args(arguments)
            .output()
            .unwrap()
    }
    fn solve(&self) -> Output {
        self.pitchd(&[
            "solve",
            "scene/tracks",
            "--rig",
            "scene/rig.toml",
            "--out",
            "result",
        ])
    }
    fn replay(&self) -> Output {
        self.pitchd(&["replay", "session", "--out", "result"])
    }
    fn pitches(&self) -> Vec<Value> {
        let text = fs::read_to_string(self.path("result/pitches.jsonl")).unwrap();
        text.lines()
            .map(|line| serde_json::from_str(line).unwrap())
            .collect()
    }
    /// Changes a text file.
    fn edit(&self, name: &str, change: impl Fn(&str) -> String) {
        let path = self.path(name);
        let changed = change(&fs::read_to_string(&path).unwrap());
        fs::write(path, changed).unwrap();
    }
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Failed with exit code 1, without a panic, and the message names every one of `culprits`.
fn assert_names(output: &Output, culprits: &[&str]) {
    let told = stderr(output);
    assert_eq!(output.status.code(), Some(1), "{told}");
    assert!(!told.contains("panicked"), "{told}");
    for culprit in culprits {
        assert!(told.contains(culprit), "`{culprit}` is not in: {told}");
    }
}

fn numbers(value: &Value) -> Vec<f64> {
    value
        .as_array()
        .unwrap()
        .iter()
        .map(|v| v.as_f64().unwrap())
        .collect()
}

#[test]
fn tracks_become_pitches_that_agree_with_the_truth() {
    let place = Place::with_tracks();
    let solved = place.solve();
    assert!(solved.status.success(), "{}", stderr(&solved));
    let score = place.pitchd(&["evaluate", "result", "scene/truth", "--json"]);
    assert!(score.status.success(), "{}", stderr(&score));
    let score: Value = serde_json::from_slice(&score.stdout).unwrap();
    assert_eq!(score["found"], score["pitches"], "{score}");
    assert_eq!(score["false_pitches"], serde_json::json!([]), "{score}");
    let axes = score["axes"].as_array().unwrap();
    let plate: Vec<_> = axes
        .iter()
        .filter(|a| a["quantity"].as_str().unwrap().starts_with("plate"))
        .collect();
    assert_eq!(plate.len(), 4);
    for axis in plate {
        assert!(axis["mean_absolute"].as_f64().unwrap() < 4.0, "mm: {axis}");
    }
    for delay in score["delays"].as_array().unwrap() {
        assert!(delay["error_frames"].as_f64().unwrap().abs() < 0.03, "{delay}");
    }
    for file in [
        "pitches.csv",
        "calibration.json",
        "report.html",
        "tracks/first.csv",
    ] {
        assert!(place.path("result").join(file).is_file(), "{file}");
    }
}

#[test]
fn results_of_the_same_tracks_are_the_same_to_the_last_bit() {
    let place = Place::with_tracks();
    assert!(place.solve().status.success());
    let first = fs::read(place.path("result/pitches.jsonl")).unwrap();
    assert!(place.solve().status.success());
    assert_eq!(first, fs::read(place.path("result/pitches.jsonl")).unwrap());
}

#[test]
fn mistakes_in_the_rig_are_named() {
    let place = Place::with_tracks();
    let rig = fs::read_to_string(place.path("scene/rig.toml")).unwrap();
    let cases = [
        (
            "frame_rate_hz",
            "frame_rate_hx",
            vec!["rig.toml:", "frame_rate_hx", "did you mean `frame_rate_hz`"],
        ),
        (
            "id = \"third\"",
            "id = \"fourth\"",
            vec!["camera `third`", "not in the rig", "fourth"],
        ),
        (
            "id = \"third\"",
            "id = \"first\"",
            vec!["two cameras are called `first`"],
        ),
        (
            "width_px = 2048",
            "width_px = 1024",
            vec!["rig.toml:", "outside the 1024×"],
        ),
    ];
    for (from, to, culprits) in cases {
        assert!(rig.contains(from), "{from} is not in {rig}");
        fs::write(place.path("scene/rig.toml"), rig.replace(from, to)).unwrap();
        assert_names(&place.solve(), &culprits);
    }
}

#[test]
fn mistakes_in_a_track_file_are_named_with_their_line() {
    let place = Place::with_tracks();
    let good = fs::read_to_string(place.path("scene/tracks/first.csv")).unwrap();
    let field_of_line_6 = |field: usize, text: &str| {
        let mut lines: Vec<String> = good.lines().map(str::to_owned).collect();
        let mut fields: Vec<&str> = lines[5].split(',').collect();
        fields[field] = text;
        lines[5] = fields.join(",");
        lines.join("\n")
    };
    let cases = [
        (field_of_line_6(1, "abc"), vec!["first.csv:6", "frame", "abc"]),
        (
            field_of_line_6(2, "99999999999999999999"),
            vec!["first.csv:6", "timestamp_ns"],
        ),
        (field_of_line_6(3, "nan"), vec!["first.csv:6", "x_px"]),
        (
            good.replace("timestamp_ns", "time"),
            vec!["first.csv", "no column `timestamp_ns`"],
        ),
        (String::new(), vec!["first.csv"]),
    ];
    for (text, culprits) in cases {
        fs::write(place.path("scene/tracks/first.csv"), text).unwrap();
        assert_names(&place.solve(), &culprits);
    }
}

#[test]
fn an_absent_camera_costs_its_share_only() {
    let place = Place::with_tracks();
    fs::remove_file(place.path("scene/tracks/first.csv")).unwrap();
    let without_reference = place.solve();
    let told = stderr(&without_reference);
    assert!(without_reference.status.success(), "{told}");
    assert!(
        told.contains("camera first, the reference, has no track"),
        "{told}"
    );
    let pitches = place.pitches();
    assert!(pitches.len() >= 6, "{}", pitches.len());
    assert!(
        pitches
            .iter()
            .all(|p| p["cameras"].as_array().unwrap().len() == 2)
    );
    fs::remove_file(place.path("scene/tracks/third.csv")).unwrap();
    assert_names(&place.solve(), &["only camera", "a calibration needs two"]);
}

fn qualities(pitches: &[Value]) -> Vec<&str> {
    pitches.iter().map(|p| p["quality"].as_str().unwrap()).collect()
}

#[test]
fn a_calibration_of_other_cameras_makes_poor_pitches() {
    let place = Place::with_tracks();
    assert!(place.solve().status.success());
    let with = |calibration: &str| {
        let output = place.pitchd(&[
            "solve",
            "scene/tracks",
            "--rig",
            "scene/rig.toml",
            "--calibration",
            calibration,
            "--out",
            "result",
        ]);
        (output, place.pitches())
    };
    // As it was: good.
    fs::copy(place.path("result/calibration.json"), place.path("right.json")).unwrap();
    let (output, pitches) = with("right.json");
    assert!(output.status.success());
    assert!(qualities(&pitches).iter().all(|q| *q == "good"));
    // One camera kicked by 40 cm.
    let mut moved: Value = serde_json::from_slice(&fs::read(place.path("right.json")).unwrap()).unwrap();
    let t = &mut moved["cameras"][1]["camera_from_world"]["translation_m"][0];
    *t = (t.as_f64().unwrap() + 0.4).into();
    fs::write(place.path("moved.json"), moved.to_string()).unwrap();
    let (output, pitches) = with("moved.json");
    assert!(
        qualities(&pitches).iter().all(|q| *q != "good"),
        "{}",
        stderr(&output)
    );
    assert!(stderr(&output).contains("landmark clicks"), "{}", stderr(&output));
    // Half a covariance.
    moved["covariance"].as_array_mut().unwrap().pop();
    fs::write(place.path("short.json"), moved.to_string()).unwrap();
    assert_names(&with("short.json").0, &["short.json", "covariance is not"]);
}

#[test]
fn a_field_that_is_not_the_one_filmed_is_doubted() {
    let place = Place::with_tracks();
    place.edit("scene/rig.toml", |rig| {
        rig.replace("\"professional\"", "\"youth_60_46\"")
    });
    let solved = place.solve();
    let told = stderr(&solved);
    assert!(!told.contains("panicked"), "{told}");
    if solved.status.success() {
        assert!(told.contains("is `field` the right one"), "{told}");
        assert!(qualities(&place.pitches()).iter().all(|q| *q != "good"));
    }
}

#[test]
fn one_number_for_all_balls_of_a_camera_is_several_tracks() {
    let place = Place::with_tracks();
    assert!(place.solve().status.success());
    let apart = place.pitches();
    place.edit("scene/tracks/third.csv", |text| {
        let renumbered = text
            .lines()
            .enumerate()
            .map(|(i, line)| match line.split_once(',') {
                Some((_, rest)) if i > 0 => format!("0,{rest}\n"),
                _ => format!("{line}\n"),
            });
        renumbered.collect()
    });
    let solved = place.solve();
    assert!(solved.status.success(), "{}", stderr(&solved));
    let together = place.pitches();
    assert_eq!(together.len(), apart.len());
    for (a, b) in apart.iter().zip(&together) {
        assert_eq!(a["plate_front_m"], b["plate_front_m"]);
    }
}

#[test]
fn a_reader_that_goes_away_is_no_failure() {
    let place = Place::with_tracks();
    let mut child = Command::new(env!("CARGO_BIN_EXE_pitchd"))
        .current_dir(place.folder.path())
        .args([
            "solve",
            "scene/tracks",
            "--rig",
            "scene/rig.toml",
            "--out",
            "result",
            "--json",
        ])
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    assert_eq!(place.pitches().len(), 8);
}

#[test]
fn a_repair_counts_what_is_lost_and_a_replay_still_tells() {
    let place = Place::with_session();
    let path = place.path("session/third.0002.mcap");
    cut(&path, 0.5);
    let read = place.pitchd(&["info", "session", "--verify", "--json"]);
    let damage: Value = serde_json::from_slice(&read.stdout).unwrap();
    let lost = damage["damage"][0]["frames_lost"].as_u64().unwrap();
    assert!(lost > 10, "{damage}");
    let count = format!("{lost} lost");
    assert_names(&place.pitchd(&["info", "session"]), &["1 file is damaged"]);
    let mended = place.pitchd(&["recover", "session"]);
    assert_names(&mended, &[&format!("{lost} frames are lost")]);
    let replayed = place.replay();
    assert!(replayed.status.success(), "{}", stderr(&replayed));
    assert!(stderr(&replayed).contains(&count), "{}", stderr(&replayed));
}

#[test]
fn the_bundled_recording_gives_its_four_pitches() {
    let place = Place::with_session();
    let replayed = place.replay();
    assert!(replayed.status.success(), "{}", stderr(&replayed));
    let pitches = place.pitches();
    assert_eq!(pitches.len(), 4);
    for pitch in &pitches {
        assert_eq!(pitch["quality"], "good", "{pitch}");
        assert_eq!(pitch["cameras"].as_array().unwrap().len(), 2);
    }
    // A second look with the calibration just made finds the same pitches.
    let again = place.pitchd(&[
        "replay",
        "session",
        "--calibration",
        "result/calibration.json",
        "--out",
        "again",
    ]);
    assert!(again.status.success(), "{}", stderr(&again));
    let text = fs::read_to_string(place.path("again/pitches.jsonl")).unwrap();
    let same: Vec<Value> = text.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    assert_eq!(same.len(), 4);
    for (a, b) in pitches.iter().zip(&same) {
        let sigma = numbers(&a["sigma"]["plate_front_m"]);
        let (a, b) = (numbers(&a["plate_front_m"]), numbers(&b["plate_front_m"]));
        for i in 0..2 {
            assert!((a[i] - b[i]).abs() < 0.5 * sigma[i], "{a:?} {b:?} {sigma:?}");
        }
    }
}

/// Cuts a file to `share` of its length.
fn cut(path: &Path, share: f64) {
    let bytes = fs::read(path).unwrap();
    let kept = (bytes.len() as f64 * share) as usize;
    fs::write(path, &bytes[..kept]).unwrap();
}

#[test]
fn a_truncated_session_gives_what_can_be_read_and_says_what_is_lost() {
    for share in [0.9, 0.37] {
        let place = Place::with_session();
        cut(&place.path("session/first.0003.mcap"), share);
        assert_names(&place.replay(), &["first.0003.mcap", "lost", "camera first"]);
        assert!(place.pitches().len() >= 3);
    }
}

#[test]
fn without_a_calibration_tracks_are_kept_and_losses_told() {
    let place = Place::with_session();
    for part in 0..4 {
        fs::remove_file(place.path(&format!("session/third.000{part}.mcap"))).unwrap();
    }
    cut(&place.path("session/first.0003.mcap"), 0.5);
    assert_names(
        &place.replay(),
        &[
            "first.0003.mcap",
            "lost",
            "camera first",
            "a calibration needs two",
        ],
    );
    let tracks = fs::read_to_string(place.path("result/tracks/first.csv")).unwrap();
    assert!(tracks.lines().count() > 100, "{} rows", tracks.lines().count());
    assert!(!place.path("result/pitches.jsonl").exists());
}

#[test]
fn flipped_bytes_cost_their_frames_only() {
    let place = Place::with_session();
    let path = place.path("session/third.0001.mcap");
    let mut bytes = fs::read(&path).unwrap();
    let length = bytes.len();
    for k in 1..6 {
        bytes[k * length / 7] ^= 0x10;
    }
    fs::write(&path, bytes).unwrap();
    assert_names(&place.replay(), &["third.0001.mcap", "frame"]);
    assert!(place.pitches().len() >= 3);
}

#[test]
fn a_session_without_its_index_is_read_all_the_same() {
    let place = Place::with_session();
    fs::remove_file(place.path("session/session.mcap")).unwrap();
    assert_names(&place.replay(), &["session.mcap", "missing"]);
    assert_eq!(place.pitches().len(), 4);
}

#[test]
fn sessions_that_do_not_fit_the_rig_are_refused_by_name() {
    let place = Place::with_session();
    let simulated = place.pitchd(&["simulate", SCENARIO, "--out", "scene"]);
    assert!(simulated.status.success());
    let other = place.pitchd(&["replay", "session", "--rig", "scene/rig.toml", "--out", "result"]);
    assert_names(&other, &["camera `first`", "1056×136", "2048×1024"]);
    place.edit("scene/rig.toml", |rig| rig.replace("\"first\"", "\"elsewhere\""));
    let stranger = place.pitchd(&["replay", "session", "--rig", "scene/rig.toml", "--out", "result"]);
    assert_names(&stranger, &["camera `first`", "not in the rig", "elsewhere"]);
    fs::create_dir(place.path("empty")).unwrap();
    assert_names(
        &place.pitchd(&["replay", "empty"]),
        &["empty: is empty, not a session"],
    );
    assert_names(
        &place.pitchd(&["replay", "nowhere"]),
        &["nowhere: there is no such folder"],
    );
}

#[test]
fn a_wrong_flag_suggests_the_right_one() {
    let place = Place::new();
    for (arguments, tip) in [
        (vec!["replay", "x", "--calibratoin", "y"], "'--calibration'"),
        (vec!["solv"], "'solve'"),
        (vec!["import", "x", "--compres", "png"], "'--compress'"),
    ] {
        let output = place.pitchd(&arguments);
        assert_eq!(output.status.code(), Some(2));
        assert!(stderr(&output).contains(tip), "{}", stderr(&output));
    }
}
