//! The paper's recipe on simulated sessions, and its detector beside ours.
#![allow(clippy::unwrap_used)]

use std::process::{Command, Output};

use pitchd::calibration::kim2019::search::Optimizer;
use pitchd::calibration::kim2019::trajectory::TrajectoryModel;
use pitchd::calibration::kim2019::{Kim2019Options, calibrate_session};
use pitchd::scene::WorldFrame;
use pitchd::simulation::{DetectionNoise, Layout, Scenario, simulate_tracks};
use serde_json::Value;

#[test]
fn f2_finds_delays_and_world_and_f1_is_worse() {
    for layout in [Layout::TwoOpposite, Layout::Three] {
        let scenario = Scenario::stock(layout, &[1.3, -0.7], 6)
            .with_seed(3)
            .with_detection(DetectionNoise::gaussian(0.2));
        let s = simulate_tracks(&scenario).unwrap();
        let mut delay_errors = Vec::new();
        for trajectory in [TrajectoryModel::PAPER, TrajectoryModel::Quadratic] {
            for optimizer in [Optimizer::NelderMead, Optimizer::QuasiNewton] {
                let options = Kim2019Options {
                    trajectory,
                    optimizer,
                    stride: 2,
                    ..Kim2019Options::default()
                };
                let clock = std::time::Instant::now();
                let found = calibrate_session(&s.rig, &s.tracks, &options).unwrap();
                let c = &found.calibration;
                assert_eq!(c.world, WorldFrame::HomePlate);
                // F1's poses leave flights that are no pitch; F2's do not.
                if trajectory == TrajectoryModel::PAPER {
                    assert_eq!(found.flights.len(), 6, "{:?}", found.unsolved);
                }
                let error =
                    |i: usize| (c.cameras[i].capture_delay_s - s.truth.cameras[i].capture_delay_s) * 175.0;
                let centre = |i: usize| {
                    (c.cameras[i].camera_from_world.centre_m()
                        - s.truth.cameras[i].camera_from_world.centre_m())
                    .norm()
                };
                let worst = (1..c.cameras.len()).map(|i| error(i).abs()).fold(0.0, f64::max);
                println!(
                    "{layout:?} {trajectory:?} {optimizer:?}: {worst:.4} frame, centres {:.3} {:.3} m, {} evaluations, {:.2?}",
                    centre(0),
                    centre(1),
                    c.cost_trace.len(),
                    clock.elapsed()
                );
                if trajectory == TrajectoryModel::PAPER {
                    // The high home camera sees the ball come at it: its delay is the weak one.
                    assert!(
                        worst < if layout == Layout::Three { 0.2 } else { 0.05 },
                        "{worst}"
                    );
                    assert!(centre(1) < 0.3);
                }
                delay_errors.push(worst);
            }
        }
        assert!(delay_errors[2] > delay_errors[0]);
    }
}

fn pitchd(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_pitchd"))
        .args(arguments)
        .output()
        .unwrap()
}

#[test]
fn peaks_are_scored_beside_fitted_balls() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("two.toml");
    let three = concat!(env!("CARGO_MANIFEST_DIR"), "/config/scenario/three.toml");
    let text = std::fs::read_to_string(three).unwrap();
    // The first two pitches.
    let (end, _) = text.match_indices("[[pitch]]").nth(2).unwrap();
    std::fs::write(&path, &text[..end]).unwrap();
    let path = path.to_str().unwrap();
    let score = |detector: &[&str]| {
        let scored = [
            "evaluate",
            "detection",
            "--scenario",
            path,
            "--camera",
            "first",
            "--json",
        ];
        let output = pitchd(&[&scored, detector].concat());
        assert!(
            output.status.success(),
            "{}",
            String::from_utf8_lossy(&output.stderr)
        );
        let scores: Value = serde_json::from_slice(&output.stdout).unwrap();
        println!("{detector:?} {scores}");
        let number = |value: &Value| value.as_f64().unwrap();
        let one = &scores[0];
        [
            number(&one["recall"]),
            number(&one["bias_px"][1]),
            number(&one["normalised_square"]),
        ]
    };
    let (peaks, balls) = (score(&["--detector", "kim2019"]), score(&["--detector", "ball"]));
    assert_eq!(score(&[]), balls, "it is the default");
    assert!(balls[0] > 0.995 && balls[1].abs() < 0.03, "{balls:?}");
    // Lit from above, seen from the side: up to two thirds of the radius, every ball the same way, and its sigma says so.
    assert!(
        (0.3..1.0).contains(&peaks[0]) && peaks[1].abs() > 1.0,
        "{peaks:?}"
    );
    assert!((0.3..3.0).contains(&peaks[2]), "{peaks:?}");
}

#[test]
fn a_detector_that_is_none_is_refused_with_those_that_are() {
    let session = concat!(env!("CARGO_MANIFEST_DIR"), "/recordings/bullpen");
    let unknown = pitchd(&["replay", session, "--detector", "peak"]);
    let told = String::from_utf8_lossy(&unknown.stderr).into_owned();
    assert_eq!(unknown.status.code(), Some(2), "{told}");
    assert!(
        told.contains("ball, kim2019") && told.contains("--detector"),
        "{told}"
    );
    let searched = pitchd(&[
        "evaluate",
        "detection",
        "result",
        "truth",
        "--detector",
        "kim2019",
    ]);
    let told = String::from_utf8_lossy(&searched.stderr).into_owned();
    assert_eq!(searched.status.code(), Some(1), "{told}");
    assert!(
        told.contains("--detector") && told.contains("--scenario"),
        "{told}"
    );
}

#[test]
fn the_catcher_takes_the_peaks_of_the_bundled_recording() {
    let folder = tempfile::tempdir().unwrap();
    let session = concat!(env!("CARGO_MANIFEST_DIR"), "/recordings/bullpen");
    let out = folder.path().join("result");
    let replayed = pitchd(&[
        "replay",
        session,
        "--detector",
        "kim2019",
        "--out",
        out.to_str().unwrap(),
    ]);
    let told = String::from_utf8_lossy(&replayed.stderr).into_owned();
    assert_eq!(replayed.status.code(), Some(1), "{told}");
    assert!(told.contains("nothing to calibrate from"), "{told}");
}
