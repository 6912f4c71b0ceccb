//! Tracks in, delays and poses out.

pub mod association;
pub mod error;
pub mod relative_pose;
pub mod resection;

pub use error::CalibrationError;

use crate::scene::{CameraId, Track};

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
