//! The free flight in a track: points off its smooth path go, and with them what the hand and the glove add.

use nalgebra::Vector2;

use super::curve::{Curve, Sample, Stiffness};
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
/// How much further off a ball may be at its end than at its begin: a camera behind home, beside the way, behind the mound.
const DEPTH_RATIOS: [f64; 7] = [0.16, 0.25, 0.4, 0.64, 1.0, 1.6, 2.5];
/// Degree of the curve that chooses among them.
const EVEN_DEGREE: usize = 3;
/// So few points beyond a gap at the end of a grown piece are there by chance.
const STRAGGLERS_MAX: usize = 3;

/// Drops points off the smooth path, worst first; what is left is the ball in free flight.
///
/// `floor_px` is the departure allowed beyond the covariance. Called again after the centres were refined: with
/// their small covariance the ends in the hand and in the glove show. `None` when nothing is left.
pub fn polish(track: &Track, floor_px: f64) -> Option<Track> {
    let epoch = track.points.first()?.stamped.nanos();
    let samples: Vec<Sample> = track.points.iter().map(|p| sample(p, epoch, floor_px)).collect();
    let samples = in_even_time(&samples, floor_px);
    let mut kept = smooth(&samples, (0..samples.len()).collect(), floor_px)?;
    if let Some(piece) = longest_piece(&kept) {
        kept = smooth(&samples, piece, floor_px)?;
        grow(&samples, &mut kept, floor_px);
        kept = smooth(&samples, kept, floor_px)?;
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

/// The samples in a time in which a ball that comes near or goes far moves evenly. Seen at a depth that changes as 1 + (r − 1)τ,
/// τ from 0 to 1, a straight even flight is a straight line in τ / (1 + (r − 1)τ), where no polynomial of time follows it
/// to its near end. The ratio of depths is that of [`DEPTH_RATIOS`] whose curve is nearest to the samples.
fn in_even_time(samples: &[Sample], floor_px: f64) -> Vec<Sample> {
    let span = samples.first().zip(samples.last());
    let Some((begin, length)) = span.map(|(first, last)| (first.t, last.t - first.t)) else {
        return Vec::new();
    };
    let even = |ratio: f64| -> Vec<Sample> {
        let tau = |t: f64| (t - begin) / length.max(f64::MIN_POSITIVE);
        let warp = |t: f64| tau(t) / (1.0 + (ratio - 1.0) * tau(t));
        samples.iter().map(|s| Sample { t: warp(s.t), ..*s }).collect()
    };
    let cost = |samples: &[Sample]| {
        let curve = fit(samples, EVEN_DEGREE)?;
        let costs = samples
            .iter()
            .map(|s| excess(s, &curve, floor_px).min(OUTLIER_SIGMAS).powi(2));
        Some(costs.sum::<f64>())
    };
    let costed = DEPTH_RATIOS.iter().map(|ratio| even(*ratio));
    let costed = costed.filter_map(|samples| Some((cost(&samples)?, samples)));
    let best = costed.min_by(|a, b| a.0.total_cmp(&b.0));
    best.map_or_else(|| samples.to_vec(), |(_, samples)| samples)
}

/// The points left on one smooth curve when those off it are dropped, worst first.
fn smooth(samples: &[Sample], mut kept: Vec<usize>, floor_px: f64) -> Option<Vec<usize>> {
    loop {
        let on: Vec<Sample> = kept.iter().filter_map(|i| samples.get(*i).copied()).collect();
        let degree = match on.len() {
            0..4 => return None,
            4..10 => 2,
            10..24 => 3,
            24..50 => 4,
            _ => 5,
        };
        let curve = fit(&on, degree)?;
        let worst = on
            .iter()
            .map(|s| excess(s, &curve, floor_px))
            .enumerate()
            .max_by(|a, b| a.1.total_cmp(&b.1))?;
        if worst.1 <= OUTLIER_SIGMAS {
            return Some(kept);
        }
        kept.remove(worst.0);
    }
}

fn fit(samples: &[Sample], degree: usize) -> Option<Curve> {
    let stiffness = Stiffness {
        degree,
        acceleration_sigma: f64::INFINITY,
    };
    Curve::fit(samples, stiffness)
}

/// Distance from the curve in σ.
fn excess(sample: &Sample, curve: &Curve, floor_px: f64) -> f64 {
    let miss: Vector2<f64> = sample.position_px - curve.position(sample.t);
    let allowed = sample.variance_px2.sqrt();
    if floor_px < CENTROID_FLOOR_PX && sample.variance_px2 > UNREFINED.0 + floor_px * floor_px {
        return miss.norm() / allowed.min(UNREFINED.1 / OUTLIER_SIGMAS);
    }
    miss.norm() / allowed
}

/// The longest piece where what was dropped parts the rest; `None`: it is one piece.
fn longest_piece(kept: &[usize]) -> Option<Vec<usize>> {
    let pieces = kept.chunk_by(|a, b| b - a <= PARTED_BY);
    let longest = pieces.max_by_key(|piece| piece.len())?;
    (longest.len() < kept.len()).then(|| longest.to_vec())
}

/// Adds the points before and after a piece that go on where it ends.
fn grow(samples: &[Sample], kept: &mut Vec<usize>, floor_px: f64) {
    let (Some(first), Some(last)) = (kept.first().copied(), kept.last().copied()) else {
        return;
    };
    grow_end(samples, kept, last + 1..samples.len(), floor_px);
    kept.reverse();
    grow_end(samples, kept, (0..first).rev(), floor_px);
    kept.reverse();
}

fn grow_end(samples: &[Sample], kept: &mut Vec<usize>, next: impl Iterator<Item = usize>, floor_px: f64) {
    let before = kept.len();
    let mut strays = 0;
    for index in next {
        let from = kept.len().saturating_sub(GROW_BACK);
        let near: Vec<Sample> = kept
            .iter()
            .skip(from)
            .filter_map(|i| samples.get(*i).copied())
            .collect();
        let Some((curve, sample)) = fit(&near, 3).zip(samples.get(index)) else {
            break;
        };
        let unsure = (1.0 + curve.variance_px2(sample.t) / sample.variance_px2).sqrt();
        if excess(sample, &curve, floor_px) < GROW_SIGMAS * unsure {
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
        assert_eq!(polished.points, track.points);
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
