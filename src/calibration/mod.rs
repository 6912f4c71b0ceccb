//! Tracks in, delays and poses out.

pub mod association;
pub mod curves;
pub mod error;
pub mod path;
pub mod relative_pose;
pub mod resection;

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
    /// τ per rig camera, seconds; 0 for the reference.
    pub capture_delay_s: Vec<f64>,
    /// Coordinates of the poses.
    pub world: WorldFrame,
    /// Robust reprojection error of the hypothesis, pixels: ranks hypotheses.
    pub score_px: f64,
}
