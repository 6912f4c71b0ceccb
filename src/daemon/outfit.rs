//! Settings of a camera's eye: what the rig says, and which way pitches go by the pose that is known before any pitch.

use super::plates::still_of;
use crate::calibration::resection::resect_camera;
use crate::detection::Still;
use crate::eye::EyeConfig;
use crate::geometry::Pose;
use crate::scene::{Calibration, CameraId, CameraSetup, Motion, Rig, WorldFrame};
use crate::tracking::{pitch_radii, pitch_way};

/// What is wanted of a camera's frames.
pub struct Wanted {
    /// Balls.
    pub eye: EyeConfig,
    /// A still of home plate.
    pub still: Option<Still>,
}

impl Wanted {
    /// Of a camera of the rig; `known` is a calibration that is there already.
    pub fn of(rig: &Rig, camera: &CameraId, known: Option<&Calibration>) -> Self {
        Self {
            eye: eye_of(rig, camera, known),
            still: still_of(rig, camera),
        }
    }
}

/// The settings for a camera of the rig; `known` is a calibration that is there already.
fn eye_of(rig: &Rig, camera: &CameraId, known: Option<&Calibration>) -> EyeConfig {
    let mut eye = EyeConfig::of_rig(rig, camera);
    if rig.site.motion == Motion::Flight
        && let Some(setup) = rig.camera(camera)
    {
        let poses = poses_of(setup, known);
        let mut ways = poses
            .iter()
            .map(|pose| pitch_way(pose, &setup.intrinsics, rig.site.field));
        // Landmarks that allow two poses: both must agree.
        let first = ways.next().flatten();
        let agrees = |a: [f64; 2], b: [f64; 2]| a[0] * b[0] + a[1] * b[1] > 0.9;
        eye.tracker.pitch_way =
            first.filter(|way| ways.all(|other| other.is_some_and(|other| agrees(*way, other))));
        let radii = poses
            .iter()
            .map(|pose| pitch_radii(pose, &setup.intrinsics, rig.site.field));
        // Of several poses any may be right.
        eye.tracker.ball_radius_px = radii.collect::<Option<Vec<_>>>().and_then(|all| {
            let of_both = |[a, b]: [f64; 2], [c, d]: [f64; 2]| [f64::min(a, c), f64::max(b, d)];
            all.into_iter().reduce(of_both)
        });
    }
    eye
}

/// Poses a camera may have.
fn poses_of(setup: &CameraSetup, known: Option<&Calibration>) -> Vec<Pose> {
    let calibrated = known
        .filter(|c| c.world == WorldFrame::HomePlate)
        .and_then(|c| c.camera(&setup.id));
    if let Some(camera) = calibrated {
        return vec![camera.camera_from_world];
    }
    let resections = resect_camera(setup).unwrap_or_default();
    resections.iter().map(|resection| resection.pose).collect()
}
