//! The whole estimate on synthetic scenes, from rough offsets to trajectory, against the truth.

use nalgebra::{Point3, Vector3};

use super::synthetic::{Scene, Truth};
use super::{FreeOptions, FreeOutcome, LensSigma, calibrate};
use crate::calibration::CalibrationError;
use crate::scene::{DistanceMeasurement, Rig, Track};
use crate::simulation::{DetectionNoise, Layout, Scenario, simulate_tracks};
use crate::time::StampedMidpoint;

const EXACT_LENS: LensSigma = LensSigma {
    focal_relative: 0.0,
    principal_px: 0.0,
    radial: 0.0,
};

fn options() -> FreeOptions {
    FreeOptions {
        lens: EXACT_LENS,
        ..FreeOptions::default()
    }
}

/// τ of the truth at the stamp where the estimate states it.
fn delay_at(truth: &Truth, camera: usize, stamp_ns: i64) -> f64 {
    let stamped = StampedMidpoint::from_nanos(stamp_ns);
    let row = f64::from(truth.timings[camera].height_px) / 2.0 - 0.5;
    -truth.timings[camera].true_seconds(stamped, row, stamp_ns)
}

/// Root mean square 3-D distance, metres, in the reference camera's axes with the scale of the first baseline.
fn trajectory_rms(outcome: &FreeOutcome, truth: &Truth) -> f64 {
    let baseline = (truth.poses[1].centre_m() - truth.poses[0].centre_m()).norm();
    let own = (outcome.calibration.cameras[1].camera_from_world.centre_m() - Point3::origin()).norm();
    let mut squares = 0.0;
    for sample in &outcome.trajectory {
        let t_s = sample.time_ns as f64 * 1e-9;
        let seen = truth.poses[0].transform(&truth.position(t_s));
        squares += (Vector3::from(sample.position_m) * (baseline / own) - seen).norm_squared();
    }
    (squares / outcome.trajectory.len() as f64).sqrt()
}

fn assert_delays(outcome: &FreeOutcome, truth: &Truth, label: &str) {
    for (k, camera) in outcome.calibration.cameras.iter().enumerate() {
        let miss = camera.capture_delay_s - delay_at(truth, k, camera.skew_epoch_ns);
        let bound = 4.0 * camera.capture_delay_sigma_s + 1e-6;
        assert!(
            miss.abs() < bound && miss.abs() < 0.01,
            "{label}, {}: τ off by {miss} s, 4σ {bound}",
            camera.id
        );
    }
}

#[test]
fn three_cameras_from_offsets_a_second_off() {
    let mut checked = 0;
    for seed in [11, 12, 13] {
        let scene = Scene {
            outliers: 0.03,
            integer: true,
            ..Scene::drone(seed)
        };
        let (rig, tracks, truth) = scene.make(1.0);
        let outcome = calibrate(&rig, &tracks, &options()).unwrap();
        assert_eq!(
            outcome.calibration.cameras.len(),
            3,
            "{:?}",
            outcome.calibration.warnings
        );
        assert_delays(&outcome, &truth, &format!("seed {seed}"));
        let rms = trajectory_rms(&outcome, &truth);
        assert!(rms < 0.1, "seed {seed}: {rms} m");
        assert!(
            outcome.trajectory.len() > 1500,
            "{} samples",
            outcome.trajectory.len()
        );
        checked += 1;
    }
    assert_eq!(checked, 3);
}

fn six_cameras() -> (Rig, Vec<Track>, Truth) {
    let scene = Scene {
        outliers: 0.1,
        misses: 0.3,
        duration_s: 40.0,
        clocks: vec![
            (25.0, 0.0, 0.0, 0.02),
            (29.97, 12.5, 300.0, 0.018),
            (59.94, -31.25, -40.0, 0.0),
            (50.0, 2.75, 20.0, 0.015),
            (29.84, 0.3, 800.0, 0.0),
            (23.976, 8.0, -100.0, 0.02),
        ],
        ..Scene::drone(21)
    };
    scene.make(1.0)
}

#[test]
fn six_cameras_with_outliers_misses_and_a_measured_distance() {
    let (mut rig, tracks, truth) = six_cameras();
    let distance_m = (truth.poses[2].centre_m() - truth.poses[4].centre_m()).norm();
    rig.distances.push(DistanceMeasurement {
        between: (rig.cameras[2].id.clone(), rig.cameras[4].id.clone()),
        distance_m,
        sigma_m: 0.001,
    });
    let outcome = calibrate(&rig, &tracks, &options()).unwrap();
    assert_eq!(
        outcome.calibration.cameras.len(),
        6,
        "{:?}",
        outcome.calibration.warnings
    );
    assert_delays(&outcome, &truth, "six cameras");
    let centre = |k: usize| outcome.calibration.cameras[k].camera_from_world.centre_m();
    assert!(((centre(2) - centre(4)).norm() - distance_m).abs() < 0.01);
    assert!(trajectory_rms(&outcome, &truth) < 0.1);
    for k in 0..6 {
        let (found, wanted) = (
            outcome.calibration.cameras[k].readout_s,
            truth.timings[k].readout_s,
        );
        assert!(
            (found - wanted).abs() < 0.006,
            "camera {k}: readout {found} for {wanted}"
        );
    }
}

/// Half a second at a time, at twenty times a drone's speed in the image.
#[test]
fn pitches_calibrate_as_any_motion_does() {
    let delays = [0.73, -1.31];
    let scenario = Scenario::stock(Layout::Three, &delays, 8).with_detection(DetectionNoise::gaussian(0.3));
    let simulated = simulate_tracks(&scenario).unwrap();
    let outcome = calibrate(&simulated.rig, &simulated.tracks, &FreeOptions::default()).unwrap();
    let calibration = &outcome.calibration;
    assert_eq!(calibration.cameras.len(), 3, "{:?}", calibration.warnings);
    for (camera, truth) in calibration.cameras.iter().zip(&simulated.truth.cameras) {
        let miss_frames = (camera.capture_delay_s - truth.capture_delay_s) * 175.0;
        assert!(
            miss_frames.abs() < 0.15,
            "{}: off by {miss_frames} frame",
            camera.id
        );
        assert!(camera.capture_delay_sigma_s * 175.0 < 0.1);
    }
    assert!((2.0..6.0).contains(&outcome.shared_s), "{}", outcome.shared_s);
}

#[test]
fn cameras_that_see_different_things_are_refused() {
    let (rig, mut tracks, _) = Scene::drone(31).make(0.5);
    let (_, others, _) = Scene::drone(32).make(0.5);
    let (_, thirds, _) = Scene::drone(33).make(0.5);
    tracks[1] = others[1].clone();
    tracks[2] = thirds[2].clone();
    let refused = calibrate(&rig, &tracks, &options());
    assert!(
        matches!(refused, Err(CalibrationError::NoCommonMotion { .. })),
        "{:?}",
        refused.map(|o| (o.explained_share, o.calibration.cameras))
    );
}

#[test]
fn too_little_is_a_typed_error() {
    let (rig, tracks, _) = Scene::drone(1).make(0.0);
    assert!(matches!(
        calibrate(&rig, &[], &options()),
        Err(CalibrationError::NoTracks)
    ));
    let alone = calibrate(&rig, &tracks[..1], &options());
    assert!(matches!(alone, Err(CalibrationError::OneCamera { .. })));
}
