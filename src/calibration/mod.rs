//! Tracks in, delays and poses out.

pub mod association;
mod ball_world;
pub mod curves;
mod delay_search;
pub mod error;
pub mod free;
pub mod initial;
pub mod joint;
pub mod kim2019;
pub mod matching;
mod metric;
pub mod path;
mod polish;
pub mod recipe;
pub mod relative_pose;
pub mod resection;
mod self_calibration;
mod sweep;
pub mod trust;
mod two_view;

pub use error::CalibrationError;

use crate::geometry::Pose;
use crate::scene::{CameraId, Track, WorldFrame};

/// The tracks of one pitch, of at least one camera; a camera may own several pieces.
#[derive(Debug, Clone, PartialEq)]
pub struct PitchTracks {
    /// In no particular order.
    pub tracks: Vec<Track>,
}

impl PitchTracks {
    /// The pieces one camera saw.
    pub fn of<'a>(&'a self, camera: &'a CameraId) -> impl Iterator<Item = &'a Track> + 'a {
        self.tracks.iter().filter(move |t| t.camera == *camera)
    }

    /// Number of different cameras with at least one point.
    pub fn cameras_seen(&self) -> usize {
        let seen: std::collections::BTreeSet<_> = self
            .tracks
            .iter()
            .filter(|t| !t.points.is_empty())
            .map(|t| &t.camera)
            .collect();
        seen.len()
    }
}

/// One hypothesis of where the cameras are and how late their stamps run.
#[derive(Debug, Clone, PartialEq)]
pub struct InitialEstimate {
    /// Per rig camera; `None`: this camera could not be placed.
    pub poses: Vec<Option<Pose>>,
    /// τ per rig camera, seconds, at `skew_epoch_ns`; 0 for the reference.
    pub capture_delay_s: Vec<f64>,
    /// Clock skew per rig camera, ppm; 0 for the reference, and where the session is too short to tell.
    pub clock_skew_ppm: Vec<f64>,
    /// Stamp (of the camera itself) at which its τ is stated, nanoseconds.
    pub skew_epoch_ns: Vec<i64>,
    /// Coordinates of the poses.
    pub world: WorldFrame,
    /// Robust reprojection error of the hypothesis, pixels: ranks hypotheses.
    pub score_px: f64,
    /// What a person must know: landmarks left out by name, cameras that could not be placed, what fixed the scale.
    pub notes: Vec<String>,
}
