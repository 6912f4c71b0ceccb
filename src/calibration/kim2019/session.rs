//! From tracks to a published calibration and flights by the paper's recipe.

use super::{Kim2019Options, calibrate};
use crate::calibration::association::{AssociationOptions, associate};
use crate::calibration::recipe::{CalibrationOutcome, solve_the_rest};
use crate::calibration::{CalibrationError, PitchTracks};
use crate::scene::{Calibration, CalibrationMethod, CameraCalibration, Rig, Track};

/// Associates, calibrates by [`calibrate`] and solves every pitch's flight with the result.
///
/// # Errors
/// As [`calibrate`].
pub fn calibrate_session(
    rig: &Rig,
    tracks: &[Track],
    options: &Kim2019Options,
) -> Result<CalibrationOutcome, CalibrationError> {
    let pitches = associate(rig, tracks, &AssociationOptions::default()).pitches;
    let solution = calibrate(rig, &pitches, options)?;
    let stamp_ns = pitches
        .iter()
        .flat_map(|p| &p.tracks)
        .filter_map(Track::span)
        .map(|s| s.0.nanos())
        .min()
        .unwrap_or(0);
    let mut cameras = Vec::new();
    for (c, setup) in rig.cameras.iter().enumerate() {
        let Some(pose) = solution.poses[c] else {
            continue;
        };
        let points = pitches
            .iter()
            .flat_map(|p| p.of(&setup.id))
            .map(|t| t.points.len())
            .sum();
        cameras.push(CameraCalibration {
            id: setup.id.clone(),
            camera_from_world: pose,
            capture_delay_s: solution.capture_delay_s[c],
            capture_delay_sigma_s: 0.0,
            clock_skew_ppm: 0.0,
            skew_epoch_ns: stamp_ns,
            network_clock: false,
            readout_s: 0.0,
            intrinsics: setup.intrinsics,
            width_px: setup.width_px,
            height_px: setup.height_px,
            reprojection_rms_px: solution.rms_px[c],
            points,
            noise_sigma_px: solution.misfit_px / (0.5 * std::f64::consts::PI).sqrt(),
            jitter_sigma_s: 0.0,
        });
    }
    let mut warnings = solution.notes.clone();
    warnings.push("kim2019 has no uncertainty: its sigmas are 0, which means not estimated".to_owned());
    let usable = |p: &PitchTracks| p.cameras_seen() >= 2;
    let mut outcome = CalibrationOutcome {
        calibration: Calibration {
            version: 1,
            method: CalibrationMethod::Kim2019,
            reference: rig.reference_camera().id.clone(),
            world: solution.world,
            cameras,
            parameters: Vec::new(),
            covariance: Vec::new(),
            condition: 0.0,
            variance_factor: 0.0,
            pitches_used: (1u32..)
                .zip(&pitches)
                .filter(|(_, p)| usable(p))
                .map(|(n, _)| n)
                .collect(),
            warnings,
            cost_trace: solution.cost_trace,
        },
        pitches,
        flights: Vec::new(),
        unsolved: Vec::new(),
        wrong_tracks: Vec::new(),
    };
    solve_the_rest(rig, &mut outcome);
    restate_rms(&mut outcome);
    Ok(outcome)
}

/// Reprojection error as every method states it: of the solved flights' kept points. The paper's own is of its
/// triangulated points, each free in space.
fn restate_rms(outcome: &mut CalibrationOutcome) {
    for camera in &mut outcome.calibration.cameras {
        let (mut kept, mut square) = (0, 0.0);
        let fits = outcome.flights.iter().flat_map(|f| &f.flight.tracks);
        for fit in fits.filter(|t| t.camera == camera.id) {
            kept += fit.kept;
            square += fit.kept as f64 * fit.rms_px * fit.rms_px;
        }
        if kept > 0 {
            camera.reprojection_rms_px = (square / kept as f64).sqrt();
            camera.points = kept;
        }
    }
}
