//! A solved flight: path, covariance, and what became of every point.

use std::collections::BTreeSet;

use nalgebra::DMatrix;

use super::equations::{Loss, Sighting};
use super::sighting::{CameraModel, Sight};
use super::solve::FlightState;
use super::trajectory::{FLIGHT_PARAMETERS, Trajectory};
use crate::scene::{CameraId, Track};

/// What one camera's track came to.
#[derive(Debug, Clone, PartialEq)]
pub struct TrackFit {
    /// Camera.
    pub camera: CameraId,
    /// Track number within the camera.
    pub track: u32,
    /// Points kept.
    pub kept: usize,
    /// Points left out.
    pub outliers: usize,
    /// Root mean square norm of the 2-D residuals kept, pixels.
    pub rms_px: f64,
    /// Per point of the track, whether it was kept.
    pub kept_points: Vec<bool>,
}

/// A flight with its uncertainty.
#[derive(Debug, Clone, PartialEq)]
pub struct SolvedFlight {
    /// The flight; valid over its span (release to plate in the home-plate frame) and a little beyond.
    pub trajectory: Trajectory,
    /// Covariance of `trajectory.parameters()`, the calibration's uncertainty included where it is known.
    pub covariance: DMatrix<f64>,
    /// Size of the residual acceleration that was chosen, m/s²: large for a knuckleball.
    pub acceleration_sigma_mps2: f64,
    /// True times of the first and last point kept, seconds after the trajectory's epoch.
    pub observed_s: (f64, f64),
    /// Per track, in the order given.
    pub tracks: Vec<TrackFit>,
    /// Sum of squared whitened residuals of the kept points over their number less the unknowns they
    /// determine: about 1 when the sigmas are honest.
    pub variance_factor: f64,
}

impl SolvedFlight {
    /// Cameras with points on the flight, each once, by name.
    pub fn cameras(&self) -> Vec<CameraId> {
        let kept = self.tracks.iter().filter(|t| t.kept > 0);
        let ids: BTreeSet<CameraId> = kept.map(|t| t.camera.clone()).collect();
        ids.into_iter().collect()
    }

    /// Points kept over all cameras.
    pub fn kept(&self) -> usize {
        self.tracks.iter().map(|t| t.kept).sum()
    }

    /// Points left out over all cameras.
    pub fn outliers(&self) -> usize {
        self.tracks.iter().map(|t| t.outliers).sum()
    }

    /// Root mean square norm of the 2-D residuals kept, pixels.
    pub fn rms_px(&self) -> f64 {
        let sum: f64 = self
            .tracks
            .iter()
            .map(|t| t.kept as f64 * t.rms_px * t.rms_px)
            .sum();
        (sum / self.kept().max(1) as f64).sqrt()
    }
}

/// Counts and residuals per track; the covariance is left zero.
pub fn summarise(
    cameras: &[CameraModel],
    tracks: &[Track],
    sightings: &[Sighting],
    state: &FlightState,
    loss: Loss,
) -> SolvedFlight {
    let mut fits: Vec<TrackFit> = tracks
        .iter()
        .map(|t| TrackFit {
            camera: t.camera.clone(),
            track: t.track,
            kept: 0,
            outliers: 0,
            rms_px: 0.0,
            kept_points: Vec::with_capacity(t.points.len()),
        })
        .collect();
    let mut observed = (f64::INFINITY, f64::NEG_INFINITY);
    let mut sum_d2 = 0.0;
    for s in sightings {
        let camera = &cameras[s.camera];
        let Some(fit) = fits.get_mut(s.track) else {
            continue;
        };
        let sight = Sight::new(camera, &s.point, &state.trajectory).ok();
        let kept = sight.as_ref().filter(|sight| loss.apply(sight.distance2).1 > 0.5);
        fit.kept_points.push(kept.is_some());
        let Some(sight) = kept else {
            fit.outliers += 1;
            continue;
        };
        fit.kept += 1;
        fit.rms_px += sight.residual_px.norm_squared();
        sum_d2 += sight.distance2;
        let epoch_ns = state.trajectory.epoch_ns();
        let t = camera
            .timing
            .true_seconds(s.point.stamped, s.point.pixel.y, epoch_ns);
        observed = (observed.0.min(t), observed.1.max(t));
    }
    for fit in &mut fits {
        fit.rms_px = (fit.rms_px / fit.kept.max(1) as f64).sqrt();
    }
    let kept: usize = fits.iter().map(|f| f.kept).sum();
    // Position, velocity, drag and two transverse forces: what the points of a rigid flight determine.
    let freedom = (2.0 * kept as f64 - 9.0).max(1.0);
    SolvedFlight {
        trajectory: state.trajectory.clone(),
        covariance: DMatrix::zeros(FLIGHT_PARAMETERS, FLIGHT_PARAMETERS),
        acceleration_sigma_mps2: state.prior.acceleration_sigma_mps2,
        observed_s: if kept > 0 {
            observed
        } else {
            state.trajectory.span_s()
        },
        tracks: fits,
        variance_factor: sum_d2 / freedom,
    }
}
