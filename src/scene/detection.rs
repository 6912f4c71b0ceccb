//! Detections: where a ball may be in one frame.

use nalgebra::Matrix2;

use crate::geometry::Pixel;
use crate::time::StampedMidpoint;

/// One ball candidate of one frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Detection {
    /// Frame number.
    pub frame: u64,
    /// Exposure midpoint by the stamps.
    pub stamped: StampedMidpoint,
    /// Geometric centre of the ball at the exposure midpoint, distorted pixels.
    pub centre: Pixel,
    /// Covariance of the centre, px².
    pub covariance_px2: Matrix2<f64>,
    /// Ball radius seen or assumed, pixels.
    pub radius_px: f64,
    /// Vector from the blur streak's start to its end, pixels (sign unknown from one frame).
    pub streak_px: [f64; 2],
    /// Contrast over the local noise: larger is surer.
    pub strength: f64,
}
