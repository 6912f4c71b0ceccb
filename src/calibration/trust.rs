//! What is doubtful about a calibration as a whole, and so about every pitch solved with it.

use nalgebra::{Matrix3, Vector3};

use super::resection::LANDMARKS_NEEDED;
use crate::scene::{Calibration, CameraSetup, Landmark, PitchQuality, Rig, WorldFrame};

/// A click farther than this from where the calibration has its landmark tells of a mistake, in its own sigmas.
const FAR_SIGMAS: f64 = 5.0;
/// With more than this share of clicks far off, something is wrong with the rig rather than with a click.
const FAR_SHARE: f64 = 0.2;
/// From here on the calibration rests on a minority of the clicks.
const MOST_SHARE: f64 = 0.5;

/// Landmarks nearer to one line than this share of their spread along it leave the turn about the line open: with four
/// within 9 cm of a line from plate to rubber, plates were wrong by ten of their sigmas; two clicks on each edge of
/// plate and rubber (a share of 0.03) are enough.
const LINE_SHARE: f64 = 0.015;

/// The doubts, each with the best quality a pitch can then have.
pub fn doubts(rig: &Rig, calibration: &Calibration) -> Vec<(PitchQuality, String)> {
    let mut doubts = Vec::new();
    if calibration.parameters.is_empty() {
        let told = "its sigmas leave out the cameras' own error, which the calibration does not tell";
        doubts.push((PitchQuality::Degraded, told.to_owned()));
    }
    if calibration.world == WorldFrame::HomePlate {
        doubts.extend(clicks_far_off(rig, calibration));
        doubts.extend(landmarks_on_a_line(rig, calibration));
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

fn landmarks_on_a_line(rig: &Rig, calibration: &Calibration) -> Option<(PitchQuality, String)> {
    let calibrated = rig.cameras.iter().filter(|c| calibration.camera(&c.id).is_some());
    let clicked: Vec<Vector3<f64>> = calibrated
        .flat_map(|c| &c.landmarks)
        .map(|l| l.position.world_m.coords)
        .collect();
    // Fewer make no world: positions of the cameras made this one.
    if clicked.len() < LANDMARKS_NEEDED {
        return None;
    }
    let (off_m, along_m) = off_and_along_a_line(&clicked);
    (off_m < LINE_SHARE * along_m).then(|| {
        let told = format!(
            "the clicked landmarks lie on one line (rms {:.1} cm off it, {along_m:.1} m along it), about which the whole \
             rig may be turned: click one to the side of it, a batter's box or a base",
            100.0 * off_m
        );
        (PitchQuality::Poor, told)
    })
}

/// Root mean square distance from the best line, and along it from the middle.
fn off_and_along_a_line(points: &[Vector3<f64>]) -> (f64, f64) {
    let n = points.len().max(1) as f64;
    let middle = points.iter().sum::<Vector3<f64>>() / n;
    let moments = points
        .iter()
        .map(|p| (p - middle) * (p - middle).transpose())
        .sum::<Matrix3<f64>>()
        / n;
    let along = moments.symmetric_eigenvalues().max().max(0.0);
    ((moments.trace() - along).max(0.0).sqrt(), along.sqrt())
}

/// How far a click lies from its landmark's image, in sigmas; `None` for a camera that is not calibrated.
fn sigmas_off(calibration: &Calibration, setup: &CameraSetup, landmark: &Landmark) -> Option<f64> {
    let camera = calibration.camera(&setup.id)?;
    let seen = camera.camera_from_world.transform(&landmark.position.world_m);
    // What the calibration has behind the camera is as far off as can be.
    let Ok(image) = camera.intrinsics.project(&seen) else {
        return Some(f64::INFINITY);
    };
    let off_px = image.vector() - landmark.pixel.vector();
    let ground_px = camera.intrinsics.fx_px * landmark.position.world_sigma_m / seen.z;
    let [x, y] = landmark.sigma_px.map(|sigma| sigma.hypot(ground_px));
    Some((off_px.x / x).hypot(off_px.y / y))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cross_of_known_arms_has_its_distances() {
        // Two points 2 m out along a line and two 0.3 m to its sides: rms over four √2 m along, 0.3/√2 m off.
        let direction = Vector3::new(0.6, 0.8, 0.0);
        let aside = Vector3::new(0.0, 0.0, 1.0);
        let centre = Vector3::new(5.0, -3.0, 1.0);
        let points = [
            centre + 2.0 * direction,
            centre - 2.0 * direction,
            centre + 0.3 * aside,
            centre - 0.3 * aside,
        ];
        let (off_m, along_m) = off_and_along_a_line(&points);
        assert!((off_m - 0.3 / 2f64.sqrt()).abs() < 1e-9 && (along_m - 2f64.sqrt()).abs() < 1e-9);
    }
}
