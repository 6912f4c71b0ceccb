//! What may be a ball: moments of a blob, or of the weak change where a ball is expected, as a detection.

use super::blobs::{Blob, Images};
use super::centroid::{Moments, strongest_near, window_moments};
use super::config::{DetectorConfig, is_searched};
use super::expected::ExpectedBall;
use crate::geometry::Pixel;
use crate::scene::{Detection, FrameStamp};

/// Pixels around a small blob that are looked at too.
const WINDOW_MARGIN_PX: f64 = 3.5;
/// An expected ball is believed from this many σ of a pixel's difference, as the mean over 3×3 pixels.
const EXPECTED_SIGMAS: f64 = 1.5;
/// Candidates nearer than this to each other are one, pixels.
const APART_PX: f64 = 2.5;

/// Whether two detections are not of the same ball.
pub fn apart(one: &Detection, other: &Detection) -> bool {
    (one.centre.vector() - other.centre.vector()).norm() > APART_PX
}

/// A detection, if the moments may be a ball's.
pub fn candidate(config: &DetectorConfig, stamp: FrameStamp, found: &Moments) -> Option<Detection> {
    let [smallest, largest] = config.radius_px;
    let streak = found.streak_px.norm();
    let fits = (smallest * 0.4..=largest).contains(&found.radius_px) && streak <= 5.0 * largest;
    let (x, y) = (found.centre_px.x, found.centre_px.y);
    // A look at an expected place is not bound to the tiles that were scanned.
    if !fits || !is_searched(&config.regions, &config.masks, (x, y)) {
        return None;
    }
    Some(Detection {
        frame: stamp.frame,
        stamped: stamp.stamped,
        centre: Pixel::new(x, y),
        covariance_px2: found.covariance_px2,
        radius_px: found.radius_px,
        streak_px: [found.streak_px.x, found.streak_px.y],
        strength: found.strength,
    })
}

/// Moments of a small blob and of what is around it: the side of a ball that the light leaves near the
/// background's level is too weak to be of the blob.
pub fn small_ball(images: &Images<'_>, blob: &Blob) -> Option<Moments> {
    let window_px = 0.5 * blob.side_px() as f64 + WINDOW_MARGIN_PX;
    window_moments(
        images,
        blob.middle_px(),
        window_px,
        f64::from(blob.difference_sigma),
    )
}

/// A weak ball where one is expected.
pub fn look_at(
    images: &Images<'_>,
    expected: &ExpectedBall,
    difference_sigma: f32,
    config: &DetectorConfig,
    stamp: FrameStamp,
) -> Option<(Detection, Blob)> {
    let (place, strength) = strongest_near(
        images,
        expected.centre.x,
        expected.centre.y,
        expected.reach_px.clamp(2.0, 16.0),
    )?;
    if strength < EXPECTED_SIGMAS * f64::from(difference_sigma) {
        return None;
    }
    let window_px = (1.5 * expected.radius_px + 2.0).clamp(4.0, 14.0);
    in_window(images, place, window_px, difference_sigma, (config, stamp))
}

/// A candidate from the change within a round window.
fn in_window(
    images: &Images<'_>,
    place: nalgebra::Vector2<f64>,
    window_px: f64,
    difference_sigma: f32,
    (config, stamp): (&DetectorConfig, FrameStamp),
) -> Option<(Detection, Blob)> {
    let moments = window_moments(images, place, window_px, f64::from(difference_sigma))?;
    let detection = candidate(config, stamp, &moments)?;
    let (x, y) = (detection.centre.x.max(0.0), detection.centre.y.max(0.0));
    let low = |value: f64| (value - window_px).max(0.0) as usize;
    let high = |value: f64, size: usize| ((value + window_px) as usize).min(size.saturating_sub(1));
    let blob = Blob {
        left: low(x),
        right: high(x, images.width_px),
        top: low(y),
        bottom: high(y, images.height_px),
        area_px: 0,
        place_sum: [0; 2],
        change_sum: 0,
        peak: 0,
        difference_sigma,
    };
    Some((detection, blob))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detection::painter::Canvas;
    use crate::detection::{Answers, Detector};

    /// Expects balls all over the picture, and counts what is found there.
    #[derive(Default)]
    struct Expecting {
        expected: usize,
        found: usize,
    }

    impl Answers for Expecting {
        fn expect(&mut self, stamp: FrameStamp, expected: &mut Vec<ExpectedBall>) {
            let places = (0..16u64).map(|k| ExpectedBall {
                centre: Pixel::new(
                    20.0 + 36.0 * k as f64,
                    20.0 + ((37 * k + 11 * stamp.frame) % 200) as f64,
                ),
                reach_px: 5.0,
                radius_px: 3.0,
            });
            expected.extend(places);
            self.expected += 16;
        }

        fn answer(&mut self, _stamp: FrameStamp, detections: &[Detection]) {
            self.found += detections.len();
        }
    }

    #[test]
    fn where_a_ball_is_expected_noise_is_none() {
        for noise in [0.5, 1.5, 4.0] {
            let stand = Canvas::stand(640, 240, 3, 40.0);
            let mut detector = Detector::new(DetectorConfig::default(), 640, 240);
            let mut answers = Expecting::default();
            for number in 0..200 {
                detector
                    .detect(&stand.frame(number, 175.0, noise), &mut answers)
                    .unwrap();
            }
            detector.flush(&mut answers);
            let Expecting { expected, found } = answers;
            println!("noise of {noise}: {found} candidates at {expected} places");
            assert!(expected > 3000 && found <= expected / 1000);
        }
    }

    #[test]
    fn an_expected_ball_outside_the_regions_is_none() {
        let region = |x_px| crate::scene::PixelRect {
            x_px,
            y_px: 0,
            width_px: 320,
            height_px: 240,
        };
        let found = |regions: Vec<crate::scene::PixelRect>| {
            let config = DetectorConfig {
                regions,
                ..DetectorConfig::default()
            };
            let stand = Canvas::stand(640, 240, 3, 40.0);
            let mut detector = Detector::new(config, 640, 240);
            let mut answers = Expecting::default();
            for number in 0..200u64 {
                let mut canvas = stand.clone();
                // At one of the expected places, in the left half.
                canvas.ball(&crate::detection::painter::Ball {
                    centre: [20.0 + 36.0 * 4.0, 20.0 + ((37 * 4 + 11 * number) % 200) as f64],
                    streak: [0.0, 0.0],
                    radius: 3.0,
                    light: 190.0,
                    shade: 60.0,
                    to_light: [0.2, -1.0, -0.4],
                });
                detector
                    .detect(&canvas.frame(number, 175.0, 1.5), &mut answers)
                    .unwrap();
            }
            detector.flush(&mut answers);
            answers.found
        };
        assert!(found(vec![]) > 150 && found(vec![region(0)]) > 150);
        assert_eq!(found(vec![region(320)]), 0);
    }
}
