//! Balls that are expected in a frame.

use crate::geometry::Pixel;

/// Balls expected nearer than this to each other are one, pixels.
const EXPECTED_ALIKE_PX: f64 = 1.0;

/// Where a ball should be in a frame, by its track or by the other cameras.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExpectedBall {
    /// Centre, distorted pixels.
    pub centre: Pixel,
    /// How far off it may be, pixels.
    pub reach_px: f64,
    /// Its radius, pixels.
    pub radius_px: f64,
}

impl ExpectedBall {
    /// Whether looking for one finds the other.
    pub(super) fn is_like(&self, other: &Self) -> bool {
        let off = self.centre.vector() - other.centre.vector();
        off.norm() < EXPECTED_ALIKE_PX && self.reach_px + EXPECTED_ALIKE_PX >= other.reach_px
    }
}
