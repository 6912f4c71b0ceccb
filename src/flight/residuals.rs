//! Predicted − observed pixel of every point of a solved flight.

use super::outcome::SolvedFlight;
use crate::scene::{Calibration, CameraId, Track};

/// One point's residual.
#[derive(Debug, Clone, PartialEq)]
pub struct PointResidual {
    /// Camera.
    pub camera: CameraId,
    /// Frame number in that camera.
    pub frame: u64,
    /// True time, seconds after the flight's epoch.
    pub time_s: f64,
    /// Predicted − observed, columns, pixels.
    pub dx_px: f64,
    /// Predicted − observed, rows, pixels.
    pub dy_px: f64,
    /// Whether the point was kept.
    pub kept: bool,
}

/// Residuals of the tracks a flight was solved from, in the order given; points of cameras the calibration
/// does not have, and points behind a camera, have none.
pub fn residuals(calibration: &Calibration, flight: &SolvedFlight, tracks: &[Track]) -> Vec<PointResidual> {
    let path = &flight.trajectory;
    let mut all = Vec::new();
    for track in tracks {
        let Some(camera) = calibration.camera(&track.camera) else {
            continue;
        };
        let fit = flight
            .tracks
            .iter()
            .find(|f| f.camera == track.camera && f.track == track.track);
        let timing = camera.timing();
        for (i, point) in track.points.iter().enumerate() {
            let time_s = timing.true_seconds(point.stamped, point.pixel.y, path.epoch_ns());
            let seen = camera.camera_from_world.transform(&path.position_m(time_s));
            let Ok(predicted) = camera.intrinsics.project(&seen) else {
                continue;
            };
            all.push(PointResidual {
                camera: track.camera.clone(),
                frame: point.frame,
                time_s,
                dx_px: predicted.x - point.pixel.x,
                dy_px: predicted.y - point.pixel.y,
                kept: fit.and_then(|f| f.kept_points.get(i)).copied().unwrap_or(false),
            });
        }
    }
    all
}
