//! Balls that are expected in a frame, and looked for there.

use super::blobs::Images;
use super::candidates::{apart, look_at};
use super::detector::Detector;
use super::finds::{Behind, Found};
use super::kernel::{TILE_HEIGHT_PX, TILE_WIDTH_PX};
use crate::geometry::Pixel;
use crate::scene::FrameStamp;

/// Most expected balls of one frame.
const EXPECTED_MAX: usize = 16;

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

impl Detector {
    /// Weak candidates where balls are expected. Branches of one path expect nearly the same: one look serves them all.
    pub(super) fn look_where_expected(&mut self, images: &Images<'_>, stamp: FrameStamp) {
        let mut distinct = 0;
        for index in 0..self.expected.len() {
            let (before, rest) = self.expected.split_at(index);
            let Some(expected) = rest.first() else { break };
            if before.iter().any(|other| other.is_like(expected)) {
                continue;
            }
            distinct += 1;
            if distinct > EXPECTED_MAX {
                break;
            }
            let sigma = self.scan.noise.difference_sigma(
                expected.centre.y.max(0.0) as usize / TILE_HEIGHT_PX,
                expected.centre.x.max(0.0) as usize / TILE_WIDTH_PX,
            );
            if let Some(found) = look_at(images, expected, sigma, &self.config, stamp)
                && self.found.all().all(|other| apart(&other.detection, &found.0))
            {
                self.found.push(Found {
                    detection: found.0,
                    blob: found.1,
                    behind: Behind::Far,
                    expected: true,
                });
            }
        }
    }
}
