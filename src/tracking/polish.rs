//! The free flight in a track: points off its smooth path go, and with them what the hand and the glove add.

use nalgebra::Vector2;

use super::curve::{Sample, Stiffness};
use super::depth::{Depth, DepthCurve};
use crate::scene::{Track, TrackPoint};

/// A centroid that was not refined (variance per axis above this, px²) may be off by so much, pixels.
const UNREFINED: (f64, f64) = (0.04, 0.8);
/// A point further than this many σ from the smooth path is not the ball.
const OUTLIER_SIGMAS: f64 = 5.0;
/// Departure of centroids from the smooth path beyond their covariance, pixels.
pub const CENTROID_FLOOR_PX: f64 = 0.5;
/// So many points in a row off the path part it: the smooth curve went through the hand and left out the ball.
const PARTED_BY: usize = 4;
/// Points that the growth of a piece looks back on, how far off the next may be, and how many may be missing.
const GROW_BACK: usize = 30;
const GROW_SIGMAS: f64 = 3.0;
const GROW_STRAYS_MAX: usize = 12;
/// So few points beyond a gap at the end of a grown piece are there by chance.
const STRAGGLERS_MAX: usize = 3;

/// Drops points off the smooth path, worst first; what is left is the ball in free flight.
///
/// `floor_px` is the departure allowed beyond the covariance. Called again after the centres were refined: with
/// their small covariance the ends in the hand and in the glove show. `None` when nothing is left.
pub fn polish(track: &Track, floor_px: f64) -> Option<Track> {
    let epoch = track.points.first()?.stamped.nanos();
    let samples: Vec<Sample> = track.points.iter().map(|p| sample(p, epoch, floor_px)).collect();
    let ball = Ball {
        depth: Depth::of(&samples),
        samples: &samples,
        floor_px,
    };
    let mut kept = ball.smooth((0..samples.len()).collect())?;
    if let Some(piece) = longest_piece(&kept) {
        kept = ball.smooth(piece)?;
        ball.grow(&mut kept);
        kept = ball.smooth(kept)?;
    }
    Some(Track {
        camera: track.camera.clone(),
        track: track.track,
        points: kept
            .iter()
            .filter_map(|i| track.points.get(*i).copied())
            .collect(),
    })
}

/// A ball in its frames, of which some are kept.
struct Ball<'a> {
    samples: &'a [Sample],
    depth: Depth,
    floor_px: f64,
}

impl Ball<'_> {
    /// The points left on one smooth curve when those off it are dropped, worst first.
    fn smooth(&self, mut kept: Vec<usize>) -> Option<Vec<usize>> {
        loop {
            let on = self.samples_of(&kept);
            let degree = match on.len() {
                0..4 => return None,
                4..10 => 2,
                10..24 => 3,
                24..50 => 4,
                _ => 5,
            };
            let curve = self.fit(&on, degree)?;
            let worst = on
                .iter()
                .map(|s| self.excess(s, &curve))
                .enumerate()
                .max_by(|a, b| a.1.total_cmp(&b.1))?;
            if worst.1 <= OUTLIER_SIGMAS {
                return Some(kept);
            }
            kept.remove(worst.0);
        }
    }

    fn samples_of(&self, kept: &[usize]) -> Vec<Sample> {
        kept.iter()
            .filter_map(|i| self.samples.get(*i).copied())
            .collect()
    }

    fn fit(&self, samples: &[Sample], degree: usize) -> Option<DepthCurve> {
        let stiffness = Stiffness {
            degree,
            acceleration_sigma: f64::INFINITY,
        };
        self.depth.fit(samples, stiffness)
    }

    /// Distance from the curve in σ.
    fn excess(&self, sample: &Sample, curve: &DepthCurve) -> f64 {
        let miss: Vector2<f64> = sample.position_px - curve.position(sample.t);
        let allowed = sample.variance_px2.sqrt();
        let refined_px2 = UNREFINED.0 + self.floor_px * self.floor_px;
        if self.floor_px < CENTROID_FLOOR_PX && sample.variance_px2 > refined_px2 {
            return miss.norm() / allowed.min(UNREFINED.1 / OUTLIER_SIGMAS);
        }
        miss.norm() / allowed
    }

    /// Adds the points before and after a piece that go on where it ends.
    fn grow(&self, kept: &mut Vec<usize>) {
        let (Some(first), Some(last)) = (kept.first().copied(), kept.last().copied()) else {
            return;
        };
        self.grow_end(kept, last + 1..self.samples.len());
        kept.reverse();
        self.grow_end(kept, (0..first).rev());
        kept.reverse();
    }

    fn grow_end(&self, kept: &mut Vec<usize>, next: impl Iterator<Item = usize>) {
        let before = kept.len();
        let mut strays = 0;
        for index in next {
            let from = kept.len().saturating_sub(GROW_BACK);
            let near = self.samples_of(kept.get(from..).unwrap_or(&[]));
            let Some((curve, sample)) = self.fit(&near, 3).zip(self.samples.get(index)) else {
                break;
            };
            let unsure = (1.0 + curve.variance_px2(sample.t) / sample.variance_px2).sqrt();
            if self.excess(sample, &curve) < GROW_SIGMAS * unsure {
                kept.push(index);
                strays = 0;
            } else {
                strays += 1;
                if strays > GROW_STRAYS_MAX {
                    break;
                }
            }
        }
        let tail = kept
            .len()
            .saturating_sub(STRAGGLERS_MAX + 1)
            .max(before.saturating_sub(1));
        let gap = kept
            .get(tail..)
            .unwrap_or(&[])
            .windows(2)
            .position(|pair| matches!(pair, [a, b] if a.abs_diff(*b) > PARTED_BY));
        if let Some(gap) = gap {
            kept.truncate(tail + gap + 1);
        }
    }
}

/// The longest piece where what was dropped parts the rest; `None`: it is one piece.
fn longest_piece(kept: &[usize]) -> Option<Vec<usize>> {
    let pieces = kept.chunk_by(|a, b| b - a <= PARTED_BY);
    let longest = pieces.max_by_key(|piece| piece.len())?;
    (longest.len() < kept.len()).then(|| longest.to_vec())
}

fn sample(point: &TrackPoint, epoch: i64, floor_px: f64) -> Sample {
    let variance = point.covariance_px2.map_or(0.25, |c| 0.5 * c.trace());
    Sample {
        t: point.stamped.seconds_since(epoch),
        position_px: point.pixel.vector(),
        variance_px2: variance + floor_px * floor_px,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pixel;
    use crate::scene::CameraId;
    use crate::time::StampedMidpoint;

    /// A slow ball of 120 frames seen from behind home, from the 15th frame on free, before in a hand on its circle.
    fn thrown(off: impl Fn(usize) -> f64) -> Track {
        let at = |i: usize| {
            let t = i as f64 - 15.0;
            let free = Pixel::new(1044.0 - 0.4 * t - 0.001 * t * t, 261.0 + 1.05 * t + 0.019 * t * t);
            let hand = if t < 0.0 {
                0.8 * t * t / (1.0 - 0.25 * t)
            } else {
                0.0
            };
            Pixel::new(free.x + hand, free.y + 0.5 * hand + off(i))
        };
        Track {
            camera: CameraId::new("home").unwrap(),
            track: 1,
            points: (0..120)
                .map(|i| TrackPoint {
                    frame: i as u64,
                    stamped: StampedMidpoint::from_seconds_since(0, i as f64 / 175.0),
                    pixel: at(i),
                    covariance_px2: Some(nalgebra::Matrix2::identity() * 0.001),
                })
                .collect(),
        }
    }

    #[test]
    fn the_hand_goes_and_the_first_frames_of_the_ball_stay() {
        let polished = polish(&thrown(|_| 0.0), 0.2).unwrap();
        let first = polished.points.first().unwrap().frame;
        assert!((14..=15).contains(&first), "begins at {first}");
        assert_eq!(polished.points.len() as u64, 120 - first);
    }

    /// A slow ball that comes at a camera behind home: from 24 m off to 5 m in 97 frames, 1800 px focal length.
    #[test]
    fn a_ball_that_comes_near_is_one_flight_to_its_end() {
        let mut track = thrown(|_| 0.0);
        track.points.truncate(97);
        for (i, point) in track.points.iter_mut().enumerate() {
            let t = i as f64 / 175.0;
            let depth_m = 24.0 - 34.5 * t;
            let (side_m, down_m) = (0.2 - 0.5 * t, -1.2 + 1.5 * t + 4.9 * t * t);
            point.pixel = Pixel::new(
                1000.0 + 1800.0 * side_m / depth_m,
                400.0 + 1800.0 * down_m / depth_m,
            );
        }
        let polished = polish(&track, 0.05).unwrap();
        assert_eq!(polished.points.len(), track.points.len());
    }

    #[test]
    fn a_stretch_drawn_aside_does_not_cost_what_follows() {
        let aside = |i: usize| if (40..48).contains(&i) { 4.0 } else { 0.0 };
        let polished = polish(&thrown(aside), 0.2).unwrap();
        let frames: Vec<u64> = polished.points.iter().map(|p| p.frame).collect();
        assert!(frames.iter().all(|f| !(40..48).contains(f)), "{frames:?}");
        assert!(frames.contains(&39) && frames.contains(&48), "{frames:?}");
        assert!(frames.contains(&20) && frames.contains(&119), "{frames:?}");
    }
}
