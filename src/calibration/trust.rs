//! What is doubtful about a calibration as a whole, and so about every pitch solved with it.

use crate::scene::{Calibration, CameraSetup, Landmark, PitchQuality, Rig, WorldFrame};

/// A click farther than this from where the calibration has its landmark tells of a mistake, in its own sigmas.
const FAR_SIGMAS: f64 = 5.0;
/// With more than this share of clicks far off, something is wrong with the rig rather than with a click.
const FAR_SHARE: f64 = 0.2;
/// From here on the calibration rests on a minority of the clicks.
const MOST_SHARE: f64 = 0.5;

/// The doubts, each with the best quality a pitch can then have.
pub fn doubts(rig: &Rig, calibration: &Calibration) -> Vec<(PitchQuality, String)> {
    let mut doubts = Vec::new();
    if calibration.parameters.is_empty() {
        let told = "its sigmas leave out the cameras' own error, which the calibration does not tell";
        doubts.push((PitchQuality::Degraded, told.to_owned()));
    }
    if calibration.world == WorldFrame::HomePlate {
        doubts.extend(clicks_far_off(rig, calibration));
    }
    doubts
}

fn clicks_far_off(rig: &Rig, calibration: &Calibration) -> Option<(PitchQuality, String)> {
    let off: Vec<f64> = rig
        .cameras
        .iter()
        .flat_map(|setup| setup.landmarks.iter().map(move |landmark| (setup, landmark)))
        .filter_map(|(setup, landmark)| sigmas_off(calibration, setup, landmark))
        .collect();
    let far = off.iter().filter(|sigmas| **sigmas > FAR_SIGMAS).count();
    let share = far as f64 / off.len().max(1) as f64;
    (share > FAR_SHARE).then(|| {
        let quality = if share > MOST_SHARE {
            PitchQuality::Poor
        } else {
            PitchQuality::Degraded
        };
        let told = format!(
            "{far} of {} landmark clicks lie more than {FAR_SIGMAS} sigmas from where the calibration has them: \
             is `field` the right one, are lens and camera positions, has a camera moved?",
            off.len()
        );
        (quality, told)
    })
}

/// How far a click lies from its landmark's image, in sigmas; `None` for a camera that is not calibrated.
fn sigmas_off(calibration: &Calibration, setup: &CameraSetup, landmark: &Landmark) -> Option<f64> {
    let camera = calibration.camera(&setup.id)?;
    let seen = camera.camera_from_world.transform(&landmark.position.world_m);
    // What the calibration has behind the camera is as far off as can be.
    let Ok(image) = camera.intrinsics.project(&seen) else {
        return Some(f64::INFINITY);
    };
    let off_px = (image.x - landmark.pixel.x).hypot(image.y - landmark.pixel.y);
    let ground_px = camera.intrinsics.fx_px * landmark.position.world_sigma_m / seen.z;
    Some(off_px / landmark.sigma_px.hypot(ground_px))
}
