//! Balls that are expected in a frame, and looked for there.

use super::blobs::Images;
use super::candidates::{apart, look_at};
use super::detector::Detector;
use super::finds::{Behind, Found};
use super::kernel::{TILE_HEIGHT_PX, TILE_WIDTH_PX};
use super::regions::RegionNoise;
use crate::geometry::Pixel;
use crate::scene::{Detection, FrameStamp};

/// Most expected balls of one frame.
const EXPECTED_MAX: usize = 16;
/// Most of those that were missed, the likeliest, of which a cut-out is kept: it is as large as two of a candidate.
const MISSED_MAX: usize = 4;

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

/// Those that are not like one before.
fn distinct(expected: &[ExpectedBall]) -> impl Iterator<Item = &ExpectedBall> {
    expected.iter().enumerate().filter_map(|(index, ball)| {
        let mut before = expected.iter().take(index);
        (!before.any(|other| other.is_like(ball))).then_some(ball)
    })
}

impl Detector {
    /// Weak candidates where balls are expected. Branches of one path expect nearly the same: one look serves them all.
    pub(super) fn look_where_expected(&mut self, images: &Images<'_>, stamp: FrameStamp) {
        for expected in distinct(&self.expected).take(EXPECTED_MAX) {
            let sigma = sigma_at(&self.scan.noise, expected);
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

    /// Keeps what is seen where the likeliest balls are expected and nothing was found: before an edge, or as bright as what is
    /// behind it, a ball may be there that only the second look can tell.
    pub(super) fn keep_where_missed(&mut self, images: &Images<'_>, stamp: FrameStamp) {
        let missed = |expected: &&ExpectedBall| {
            let off_px = |found: &Detection| (found.centre.vector() - expected.centre.vector()).norm();
            let near_px = expected.reach_px.max(expected.radius_px);
            self.detections.iter().all(|found| off_px(found) > near_px)
        };
        for expected in distinct(&self.expected).filter(missed).take(MISSED_MAX) {
            let sigma = sigma_at(&self.scan.noise, expected);
            self.patches.keep_expected(images, expected, (stamp, sigma));
        }
    }
}

/// σ of a frame difference where a ball is expected, levels.
fn sigma_at(noise: &RegionNoise, expected: &ExpectedBall) -> f32 {
    noise.difference_sigma(
        expected.centre.y.max(0.0) as usize / TILE_HEIGHT_PX,
        expected.centre.x.max(0.0) as usize / TILE_WIDTH_PX,
    )
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;

    use super::*;
    use crate::detection::painter::Canvas;
    use crate::detection::{Answers, DetectorConfig};

    /// Expects a ball at so many places in every frame.
    struct Expecting(u64);

    fn place(number: u64) -> Vector2<f64> {
        Vector2::new(40.0 + 40.0 * number as f64, 60.0)
    }

    impl Answers for Expecting {
        fn expect(&mut self, _: FrameStamp, expected: &mut Vec<ExpectedBall>) {
            expected.extend((0..self.0).map(|number| ExpectedBall {
                centre: Pixel::new(place(number).x, place(number).y),
                reach_px: 3.0,
                radius_px: 3.0,
            }));
        }

        fn answer(&mut self, _: FrameStamp, _: &[Detection]) {}
    }

    #[test]
    fn a_place_where_a_ball_is_expected_and_not_found_is_kept() {
        for (expected, kept) in [(0, 0), (1, 1), (9, MISSED_MAX)] {
            let stand = Canvas::stand(400, 120, 3, 20.0);
            let mut detector = Detector::new(DetectorConfig::default(), 400, 120);
            let frames: Vec<_> = (0..40).map(|number| stand.frame(number, 175.0, 1.0)).collect();
            for frame in &frames {
                detector.detect(frame, &mut Expecting(expected)).unwrap();
            }
            let stamped = frames[20].stamp.stamped;
            let around = |number| detector.patches.around(stamped, place(number), 15.0);
            let places: Vec<u64> = (0..9).filter(|number| around(*number).is_some()).collect();
            assert_eq!(places, (0..kept as u64).collect::<Vec<_>>(), "of {expected}");
        }
    }
}
