//! 2-D tracks: one ball over time in one camera.

use nalgebra::Matrix2;

use super::CameraId;
use crate::geometry::Pixel;
use crate::time::StampedMidpoint;

/// One point of a track.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackPoint {
    /// Frame number.
    pub frame: u64,
    /// Exposure midpoint by this camera's stamps.
    pub stamped: StampedMidpoint,
    /// Centre of the ball, distorted pixels.
    pub pixel: Pixel,
    /// Covariance, px²; `None` where the file does not say (then estimated from residuals).
    pub covariance_px2: Option<Matrix2<f64>>,
}

/// The points of one ball in one camera, by rising stamp. Track numbers of different cameras need not agree.
#[derive(Debug, Clone, PartialEq)]
pub struct Track {
    /// The camera that saw it.
    pub camera: CameraId,
    /// Number, unique within the camera.
    pub track: u32,
    /// At least one point.
    pub points: Vec<TrackPoint>,
}

impl Track {
    /// First and last stamp; `None` for an empty track.
    pub fn span(&self) -> Option<(StampedMidpoint, StampedMidpoint)> {
        Some((self.points.first()?.stamped, self.points.last()?.stamped))
    }
}
