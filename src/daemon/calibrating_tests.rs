//! Stills of home plate in the calibration worker: what they add to the clicks.

use crossbeam_channel::bounded;

use super::*;
use crate::daemon::plates::still_of;
use crate::detection::plate_middle;
use crate::scene::Frame;
use crate::simulation::{CameraRenderer, Scenario, Simulated, simulate_tracks};

const SCENARIO: &str = r#"
seed = 7
[landmarks]
sigma_px = 0.8
[detection]
sigma_px = 0.1
[render]
preset = "clean"
people = false
[[camera]]
id = "first"
width_px = 1000
height_px = 560
frame_rate_hz = 175.0
position_m = [20.1, 6.2, 3.3]
look_at_m = [0.0, 8.6, 0.9]
[camera.intrinsics]
fx_px = 870.0
fy_px = 870.0
cx_px = 500.0
cy_px = 280.0
distortion = [0.0, 0.0, 0.0, 0.0, 0.0]
[[camera]]
id = "home"
width_px = 1000
height_px = 560
frame_rate_hz = 175.0
position_m = [1.4, -15.5, 8.2]
look_at_m = [-0.1, 9.0, 0.6]
[camera.intrinsics]
fx_px = 1150.0
fy_px = 1150.0
cx_px = 500.0
cy_px = 280.0
distortion = [0.0, 0.0, 0.0, 0.0, 0.0]
[[pitch]]
start_s = 3.0
release_m = [-0.55, 16.6, 1.83]
speed_mps = 42.6
target_m = [0.1, 0.95]
[[pitch]]
start_s = 17.2
release_m = [-0.67, 16.65, 1.74]
speed_mps = 41.7
target_m = [-0.22, 0.55]
"#;

/// A still of every camera's first frames, as they are or made otherwise.
fn stills(scenario: &Scenario, rig: &Rig, made: impl Fn(Frame) -> Frame) -> Vec<(CameraId, Still)> {
    let stills = rig.cameras.iter().enumerate().map(|(index, camera)| {
        let mut still = still_of(rig, &camera.id).unwrap();
        let mut renderer = CameraRenderer::new(scenario, index).unwrap();
        let exposures: Vec<_> = renderer.exposures().take(10).collect();
        for exposure in &exposures {
            still.take(&made(renderer.frame(exposure)));
        }
        (camera.id.clone(), still)
    });
    stills.collect()
}

/// What the worker makes of the tracks after it was sent these stills.
fn calibrated(simulated: &Simulated, sent: Vec<(CameraId, Still)>) -> Calibration {
    let (stills_in, stills) = bounded(STILLS_QUEUE);
    let (requests_in, requests) = bounded(1);
    let (answers_in, answers) = bounded(1);
    sent.into_iter().for_each(|still| stills_in.send(still).unwrap());
    let request = CalibrationRequest {
        tracks: simulated.tracks.clone(),
        epochs: Epochs::new(),
        version: 3,
    };
    requests_in.send(request).unwrap();
    drop((requests_in, stills_in));
    calibrate(simulated.rig.clone(), (&requests, &stills), &answers_in);
    let answer = answers.try_recv().unwrap();
    let calibration = answer.calibration.unwrap_or_else(|| panic!("{}", answer.reason));
    assert_eq!(calibration.version, 3);
    calibration
}

/// How far from the truth each camera sees the middle of home plate by a calibration, pixels.
fn off_px(simulated: &Simulated, calibration: &Calibration) -> Vec<f64> {
    let truth = simulated.truth.cameras.iter();
    let off = truth.map(|truth| {
        let lens = &simulated.rig.camera(&truth.id).unwrap().intrinsics;
        let seen =
            |pose: &crate::geometry::Pose| lens.project(&pose.transform(&plate_middle())).unwrap().vector();
        let by = calibration.camera(&truth.id).unwrap();
        (seen(&by.camera_from_world) - seen(&truth.camera_from_world)).norm()
    });
    off.collect()
}

#[test]
fn a_still_with_the_plate_mends_the_clicks_and_one_without_changes_nothing() {
    let scenario = Scenario::from_str(SCENARIO).unwrap();
    let simulated = simulate_tracks(&scenario).unwrap();
    let by_clicks = calibrated(&simulated, Vec::new());

    let bare = stills(&scenario, &simulated.rig, |mut frame| {
        frame.pixels = std::sync::Arc::new(vec![120u8; frame.bytes().len()]);
        frame
    });
    assert_eq!(calibrated(&simulated, bare), by_clicks);

    let seen = stills(&scenario, &simulated.rig, |frame| frame);
    let with_plates = calibrated(&simulated, seen);
    let (before_px, after_px) = (off_px(&simulated, &by_clicks), off_px(&simulated, &with_plates));
    assert_eq!(after_px.len(), 2);
    for (before_px, after_px) in before_px.iter().zip(&after_px) {
        assert!(
            after_px < before_px && *after_px < 0.15,
            "{before_px} px, now {after_px} px"
        );
    }
}
