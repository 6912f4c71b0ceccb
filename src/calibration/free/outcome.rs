//! The solution in the project's nouns: calibration, trajectory, warnings, or a refusal with numbers.

use nalgebra::Point3;

use super::finish::Solution;
use super::pace::Pace;
use super::{CameraFit, FreeOutcome, Gathered, TrajectorySample};
use crate::scene::{
    Calibration, CalibrationMethod, CameraCalibration, Parameter, ParameterKind, Rig, WorldFrame,
};
use crate::time::NANOS_PER_SECOND;

/// Warned of when less than one point in this many takes part.
const FEW_SHARED: usize = 5;
/// Delay sigma above which a warning says so, seconds.
const WEAK_DELAY_S: f64 = 0.02;

pub(super) fn outcome(rig: &Rig, gathered: &Gathered, solution: &Solution) -> FreeOutcome {
    let mut warnings = gathered.warnings.clone();
    // Back from the session's seconds to the cameras'.
    let Pace(pace) = gathered.pace;
    let (mut cameras, mut fits) = (vec![], vec![]);
    for (index, &in_rig) in gathered.in_rig.iter().enumerate() {
        let setup = &rig.cameras[in_rig];
        let Some(state) = &solution.state.cameras[index] else {
            warnings.push(format!(
                "camera {}: its points fit no place and delay near the rough offset, left out",
                setup.id
            ));
            continue;
        };
        let (kept, outliers, rms_px) = solution.residuals(index, state);
        fits.push(CameraFit {
            camera: setup.id.clone(),
            kept,
            outliers,
        });
        let sigma_s = solution.sigma(index, ParameterKind::CaptureDelay) / pace;
        if sigma_s > WEAK_DELAY_S {
            warnings.push(format!(
                "camera {}: delay known to {sigma_s:.3} s only (1σ)",
                setup.id
            ));
        }
        let view = &gathered.session.views[index];
        let (used, all) = (kept + outliers, view.sightings.len());
        if used < all / FEW_SHARED {
            warnings.push(format!(
                "camera {}: another camera sees the thing at the same time in only {used} of its {all} points",
                setup.id
            ));
        }
        cameras.push(CameraCalibration {
            id: setup.id.clone(),
            camera_from_world: state.pose,
            capture_delay_s: state.delay_s / pace,
            capture_delay_sigma_s: sigma_s,
            clock_skew_ppm: state.skew_ppm,
            skew_epoch_ns: gathered.epoch_ns + (view.epoch_s / pace * NANOS_PER_SECOND).round() as i64,
            network_clock: false,
            readout_s: state.readout_s / pace,
            intrinsics: state.lens,
            width_px: setup.width_px,
            height_px: setup.height_px,
            reprojection_rms_px: rms_px,
            points: kept,
            noise_sigma_px: state.noise,
            jitter_sigma_s: 0.0,
        });
    }
    let explained = gathered.session.explained(&solution.state);
    let calibration = Calibration {
        version: 1,
        method: CalibrationMethod::Joint,
        reference: rig.reference_camera().id.clone(),
        world: WorldFrame::ReferenceCamera,
        cameras,
        parameters: solution
            .columns
            .iter()
            .map(|c| Parameter {
                camera: rig.cameras[gathered.in_rig[c.camera]].id.clone(),
                kind: c.kind,
            })
            .collect(),
        covariance: covariance(solution, pace),
        condition: solution.condition,
        variance_factor: solution.redundancy,
        pitches_used: vec![],
        warnings,
        cost_trace: vec![],
    };
    FreeOutcome {
        trajectory: trajectory(rig, gathered, solution),
        calibration,
        cameras: fits,
        shared_s: solution.support.shared_s() / pace,
        explained_share: explained.least().map_or(0.0, |(_, share)| share),
    }
}

/// Covariance of the unknowns, times in the cameras' seconds.
fn covariance(solution: &Solution, pace: f64) -> Vec<Vec<f64>> {
    let unit = |k: usize| match solution.columns[k].kind {
        ParameterKind::CaptureDelay | ParameterKind::Readout => 1.0 / pace,
        _ => 1.0,
    };
    let all = &solution.covariance;
    (0..all.nrows())
        .map(|r| {
            (0..all.ncols())
                .map(|c| unit(r) * unit(c) * all[(r, c)])
                .collect()
        })
        .collect()
}

/// The motion at the reference camera's frames, its own or (where it sees nothing) counted on from them.
fn trajectory(rig: &Rig, gathered: &Gathered, solution: &Solution) -> Vec<TrajectorySample> {
    let period_s = gathered.pace.0 / rig.reference_camera().frame_rate_hz;
    let own = &gathered.session.views[gathered.reference].sightings;
    let mut samples = vec![];
    for &(begin_s, end_s) in &solution.support.shared {
        let mut t_s = begin_s;
        while t_s <= end_s {
            let next = own.partition_point(|s| s.stamped_s < t_s - 0.5 * period_s);
            // Onto the nearest frame: the reference's τ is 0, so that its stamps are true times.
            let anchor = own.get(next).or_else(|| own.last()).map_or(t_s, |s| s.stamped_s);
            let frame_s = anchor - ((anchor - t_s) / period_s).round() * period_s;
            samples.push(sample(gathered, solution, frame_s));
            t_s = frame_s + period_s;
        }
    }
    samples
}

fn sample(gathered: &Gathered, solution: &Solution, t_s: f64) -> TrajectorySample {
    let position: Point3<f64> = solution.state.spline.position(t_s);
    let covariance = solution.position_covariance(t_s);
    TrajectorySample {
        time_ns: gathered.epoch_ns + (t_s / gathered.pace.0 * NANOS_PER_SECOND).round() as i64,
        position_m: position.coords.into(),
        sigma_m: std::array::from_fn(|k| covariance[(k, k)].max(0.0).sqrt()),
        cameras: solution.support.seeing(t_s),
    }
}

impl Solution {
    /// 1σ of one unknown; 0 for one that is held.
    fn sigma(&self, camera: usize, kind: ParameterKind) -> f64 {
        self.columns
            .iter()
            .position(|c| c.camera == camera && c.kind == kind)
            .map_or(0.0, |k| self.covariance[(k, k)].max(0.0).sqrt())
    }
}
