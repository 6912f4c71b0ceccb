//! What happens when a path ends: back to the hand, outliers out, ends trimmed, shape judged.

use std::collections::VecDeque;
use std::ops::Range;

use super::config::TrackerConfig;
use super::curve::{Curve, Sample, Stiffness};
use super::depth::Depth;
use super::hypothesis::{Hypothesis, Point, gain, light_variance_px2, local_curve};
use super::open::point_of;
use super::polish::{CENTROID_FLOOR_PX, polish};
use super::shape::{TrackKind, TrackShape, TrackedBall};
use super::tracker::FramePoints;
use crate::scene::{CameraId, Track};

/// Points looked at when extending back.
const LOOK_AHEAD: usize = 10;
/// Points of the window from which free flight is grown.
const WINDOW: usize = 10;
/// Rms distance of a smooth window from a parabola, pixels (and 2 % of the speed).
const SMOOTH_RMS_PX: f64 = 0.6;
/// Parts of a path in which a stretch may begin to grow, and the share of the path's largest speed that it needs.
const PARTS: usize = 4;
const FAST_SHARE: f64 = 0.6;
/// Points that a stretch's growth looks back on, its gate in σ and at most in pixels.
const GROW_BACK: usize = 30;
const GROW_SIGMAS: f64 = 3.0;
const GROW_MAX_PX: f64 = 5.0;
/// Points taken off an end at once, and the rms distance from a smooth curve that is smooth enough, pixels.
const TRIM_STEP: usize = 2;
const TRIM_RMS_PX: f64 = 0.9;
/// Highest degree of that curve.
const DEGREE_MAX: usize = 5;
/// A stretch that is not smooth is tried at so many more places (more where it matters), then shorter by one part in so
/// many.
const TRIM_PLACES: usize = 6;
const FINE_PLACES: usize = 24;
/// Points before and after the smooth stretch that the polish decides about: in the shadow at the plate a centroid is drawn
/// aside for many frames.
const SPARED: [usize; 2] = [5, 12];
const TRIM_SHARE: usize = 16;
/// Last points left out before a path is followed on.
const LEFT_OUT: [usize; 3] = [0, 4, 8];
/// So few points after a gap of more than so many frames do not belong to a path.
const STRAGGLERS_MAX: usize = 3;
const STRAGGLER_GAP: f64 = 5.5;
/// This many points in a row far off the path end it, or this many a little off.
const STRAYS_MAX: usize = 4;
const NEAR_STRAYS_MAX: usize = 8;

/// The ball of a path, with the detections it took; `None` where it is none.
pub fn conclude(
    config: &TrackerConfig,
    camera: &CameraId,
    hypothesis: &Hypothesis,
    history: &VecDeque<FramePoints>,
) -> Option<(Vec<Point>, TrackedBall)> {
    let core = free_flight(&hypothesis.points)?;
    let all = extend(config, core, history);
    let (mut points, mut ball) = judged(config, camera, &all, DEGREE_MAX)?;
    if ball.kind == TrackKind::Rough {
        // So bent a curve went through the hand and the ball, or through the arm long before.
        let stiff = judged(config, camera, &all, DEGREE_MAX - 1);
        let whole = longest_without_gap(&all).and_then(|all| judged(config, camera, all, DEGREE_MAX));
        let others = [stiff, whole].into_iter().flatten();
        if let Some(other) = others.into_iter().find(|(_, ball)| ball.kind != TrackKind::Rough) {
            (points, ball) = other;
        }
    }
    ball.score = hypothesis.score;
    Some((points, ball))
}

/// The longest stretch of a path without a long gap, where it has one: what was before the gap may be something else.
fn longest_without_gap(points: &[Point]) -> Option<&[Point]> {
    let stretches = points.chunk_by(|a, b| (b.t - a.t).abs() <= STRAGGLER_GAP);
    let longest = stretches.max_by_key(|stretch| stretch.len())?;
    (longest.len() < points.len()).then_some(longest)
}

/// The part of a path that is smooth by curves of at most this degree, and what it looks like.
fn judged(
    config: &TrackerConfig,
    camera: &CameraId,
    all: &[Point],
    degree_max: usize,
) -> Option<(Vec<Point>, TrackedBall)> {
    let smooth = smooth_part(all, degree_max)?;
    // A bent begin takes places from the end: the polish decides about the next few at either end.
    let [before, after] = SPARED;
    let spared = smooth.start.saturating_sub(before)..(smooth.end + after).min(all.len());
    let (smooth, points) = (all.get(smooth)?, all.get(spared)?.to_vec());
    let polished = |points: &[Point]| {
        let track = Track {
            camera: camera.clone(),
            track: 0,
            points: points.iter().map(point_of).collect(),
        };
        polish(&track, CENTROID_FLOOR_PX)
    };
    let mut radii: Vec<f64> = smooth.iter().map(|p| p.detection.radius_px).collect();
    radii.sort_by(f64::total_cmp);
    let radius_px = radii.get(radii.len() / 2).copied()?;
    let shape = TrackShape::measure(&polished(smooth)?, radius_px)?;
    let kind = shape.kind(config);
    let track = polished(&points)?;
    if track.points.len() < config.points_min {
        return None;
    }
    Some((
        points,
        TrackedBall {
            track,
            kind,
            shape,
            score: 0.0,
        },
    ))
}

/// The longest smooth stretch around a fast smooth window: a path may have begun in the arm and may end in the glove.
/// Growth may stop where an edge of shadow displaces the centroids, so it begins at the fastest window of every part of the
/// path that is fast.
pub fn free_flight(points: &[Point]) -> Option<Vec<Point>> {
    let window = WINDOW.min(points.len());
    let speeds: Vec<Option<f64>> = points.windows(window).map(smooth_speed).collect();
    let fastest = speeds.iter().flatten().copied().fold(0.0, f64::max);
    let part = speeds.len().div_ceil(PARTS).max(1);
    let begins = speeds.chunks(part).enumerate().filter_map(|(i, speeds)| {
        let known = speeds
            .iter()
            .enumerate()
            .filter_map(|(j, speed)| Some((i * part + j, (*speed)?)));
        let (begin, speed) = known.max_by(|a, b| a.1.total_cmp(&b.1))?;
        (speed >= FAST_SHARE * fastest).then_some(begin)
    });
    let stretches = begins.filter_map(|begin| grown_from(points, begin..begin + window));
    stretches.max_by_key(Vec::len)
}

/// The smooth stretch around a window.
fn grown_from(points: &[Point], window: Range<usize>) -> Option<Vec<Point>> {
    let mut stretch: Vec<Point> = points.get(window.clone())?.to_vec();
    grow(&mut stretch, points.get(window.end..).unwrap_or(&[]).iter());
    stretch.reverse();
    grow(
        &mut stretch,
        points.get(..window.start).unwrap_or(&[]).iter().rev(),
    );
    stretch.reverse();
    Some(stretch)
}

/// Speed over a stretch in pixels per frame, if it is smooth.
fn smooth_speed(stretch: &[Point]) -> Option<f64> {
    let curve = local_curve(stretch)?;
    let (first, last) = (stretch.first()?, stretch.last()?);
    let speed = (last.position() - first.position()).norm() / (last.t - first.t).max(1.0);
    let squares: f64 = stretch
        .iter()
        .map(|p| (p.position() - curve.position(p.t)).norm_squared())
        .sum();
    let rms = (squares / stretch.len() as f64).sqrt();
    (rms < SMOOTH_RMS_PX + 0.02 * speed).then_some(speed)
}

/// Adds the points that go on smoothly; stops when several in a row do not. Points a little off (at an edge of shadow a
/// centroid jumps by the ball's radius) are of the path if it goes on behind them.
fn grow<'a>(path: &mut Vec<Point>, next: impl Iterator<Item = &'a Point>) {
    let (mut far_strays, mut near_strays) = (0, Vec::with_capacity(NEAR_STRAYS_MAX));
    for point in next {
        let Some(last) = path.last().copied() else { return };
        let from = path.len().saturating_sub(GROW_BACK);
        let samples: Vec<Sample> = path
            .get(from..)
            .unwrap_or(&[])
            .iter()
            .map(Point::sample)
            .collect();
        // A cubic over half the flight: an arm or a leg near the ball leaves it within a few frames.
        let degree = if samples.len() >= 2 * WINDOW { 3 } else { 2 };
        let stiffness = Stiffness {
            degree,
            acceleration_sigma: f64::INFINITY,
        };
        let Some(curve) = Curve::fit(&samples, stiffness) else {
            return;
        };
        let variance =
            curve.variance_px2(point.t) + point.sample().variance_px2 + light_variance_px2(&last, point);
        let miss = (point.position() - curve.position(point.t)).norm();
        if miss < GROW_SIGMAS * variance.sqrt() && miss < GROW_MAX_PX {
            path.append(&mut near_strays);
            path.push(*point);
            far_strays = 0;
            continue;
        }
        if miss < GROW_MAX_PX {
            near_strays.push(*point);
        } else {
            far_strays += 1;
        }
        if far_strays >= STRAYS_MAX || near_strays.len() >= NEAR_STRAYS_MAX {
            return;
        }
    }
}

/// The longest stretch that is smooth as a whole: what the hand and the glove add bends it. Ever shorter stretches are
/// tried at a few places each, then those between the first smooth one and the last that was not: all lengths and places
/// of a rough path of hundreds of points would be tens of thousands of fits.
fn smooth_part(points: &[Point], degree_max: usize) -> Option<Range<usize>> {
    let samples: Vec<Sample> = points.iter().map(Point::sample).collect();
    let depth = Depth::of(&samples);
    let is_smooth = |range: &Range<usize>| {
        let stretch = samples.get(range.clone());
        stretch.is_some_and(|stretch| roughness_px(stretch, &depth, degree_max) < TRIM_RMS_PX)
    };
    let smooth_of = |length: usize, places_max: usize| {
        let spare = points.len() - length;
        let places = (spare / TRIM_STEP).min(places_max);
        let begins = (0..=places).map(|i| spare * i / places.max(1));
        begins
            .map(|begin| begin..begin + length)
            .find(|range| is_smooth(range))
    };
    let (mut length, mut rough_length) = (points.len(), points.len());
    while length > WINDOW {
        if let Some(found) = smooth_of(length, TRIM_PLACES) {
            let mut between = (length + 1..rough_length).rev().step_by(TRIM_STEP);
            let longer = between.find_map(|length| smooth_of(length, FINE_PLACES));
            return Some(longer.unwrap_or(found));
        }
        rough_length = length;
        length -= (length / TRIM_SHARE).max(TRIM_STEP).min(length);
    }
    None
}

/// Rms distance from one smooth curve.
fn roughness_px(samples: &[Sample], depth: &Depth, degree_max: usize) -> f64 {
    let degree = (samples.len() / 6).clamp(2, degree_max);
    let stiffness = Stiffness {
        degree,
        acceleration_sigma: f64::INFINITY,
    };
    let Some(curve) = depth.fit(samples, stiffness) else {
        return f64::INFINITY;
    };
    let squares: f64 = samples
        .iter()
        .map(|s| (s.position_px - curve.position(s.t)).norm_squared())
        .sum();
    (squares / samples.len() as f64).sqrt()
}

/// Adds detections that lie on the path's continuation, into the future and then into the past.
fn extend(config: &TrackerConfig, points: Vec<Point>, history: &VecDeque<FramePoints>) -> Vec<Point> {
    let mut points = follow_on(config, points, || history.iter());
    points.reverse();
    points = follow_on(config, points, || history.iter().rev());
    points.reverse();
    points
}

/// Follows the path, also from a little before its end: its last points may already have been drawn aside (by an
/// edge of shadow, by an arm). The longest way counts.
fn follow_on<'a, I: Iterator<Item = &'a FramePoints>>(
    config: &TrackerConfig,
    points: Vec<Point>,
    frames: impl Fn() -> I,
) -> Vec<Point> {
    let mut best: Option<Vec<Point>> = None;
    for left_out in LEFT_OUT {
        let keep = points.len().saturating_sub(left_out);
        if left_out > 0 && keep < WINDOW {
            break;
        }
        let mut trial = points.get(..keep).unwrap_or(&[]).to_vec();
        follow(config, &mut trial, frames());
        drop_stragglers(&mut trial);
        if best.as_ref().is_none_or(|best| trial.len() > best.len()) {
            best = Some(trial);
        }
    }
    best.unwrap_or(points)
}

/// Drops a few last points far from the rest: over so long a gap something is always near the path.
fn drop_stragglers(points: &mut Vec<Point>) {
    let tail = points.len().saturating_sub(STRAGGLERS_MAX + 1);
    let gap = points
        .get(tail..)
        .unwrap_or(&[])
        .windows(2)
        .position(|pair| matches!(pair, [a, b] if (b.t - a.t).abs() > STRAGGLER_GAP));
    if let Some(gap) = gap {
        points.truncate(tail + gap + 1);
    }
}

/// Follows the path through frames in the order given.
fn follow<'a>(
    config: &TrackerConfig,
    points: &mut Vec<Point>,
    frames: impl Iterator<Item = &'a FramePoints>,
) {
    let Some(start) = points.last().copied() else {
        return;
    };
    let sense = points
        .first()
        .map_or(1.0, |p| if p.t <= start.t { 1.0 } else { -1.0 });
    let fitted = |points: &[Point]| {
        let from = points.len().saturating_sub(LOOK_AHEAD);
        local_curve(points.get(from..).unwrap_or(&[]))
    };
    let mut curve = fitted(points);
    for frame in frames {
        let Some(last) = points.last().copied() else {
            return;
        };
        let ahead = sense * (frame.t - last.t);
        if ahead < 0.5 {
            continue;
        }
        if ahead > f64::from(config.gap_frames_max) {
            return;
        }
        let Some(predicted) = curve.as_ref().map(|curve| curve.predict(frame.t)) else {
            return;
        };
        let best = frame
            .points
            .iter()
            .filter_map(|p| gain(&predicted, &last, p).map(|gain| (gain, p)))
            .max_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((_, point)) = best {
            points.push(*point);
            curve = fitted(points);
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix2;

    use super::*;
    use crate::geometry::Pixel;
    use crate::scene::Detection;
    use crate::time::StampedMidpoint;

    /// The candidates of a rendered pitch seen from behind the plate at 120 frames a second: times in frames, pixels. The first
    /// six are of the arm, the sixth nine frames before the hand; the ball is in the shadow from the 54th to the 60th.
    const T: [f64; 67] = [
        1.00, 6.01, 7.01, 10.03, 11.01, 12.02, 21.02, 22.00, 23.00, 23.98, 25.00, 26.00, 27.00, 27.99, 29.01,
        30.02, 31.00, 32.02, 32.99, 33.99, 35.02, 36.00, 37.00, 38.00, 39.00, 39.98, 40.98, 42.02, 42.98,
        44.01, 45.01, 46.00, 46.98, 48.03, 49.98, 51.00, 52.00, 52.98, 54.03, 55.01, 56.00, 57.02, 58.03,
        59.00, 59.98, 62.00, 63.00, 64.01, 65.02, 66.00, 66.98, 67.98, 69.00, 70.01, 71.01, 71.97, 74.01,
        75.04, 76.00, 77.00, 77.98, 78.99, 80.00, 80.98, 82.00, 83.02, 83.99,
    ];
    const X: [f64; 67] = [
        1085.7, 1067.8, 1062.5, 1049.0, 1048.4, 1047.6, 1028.0, 1024.8, 1023.4, 1020.8, 1019.7, 1018.6,
        1017.5, 1016.4, 1015.3, 1014.2, 1013.1, 1012.0, 1010.8, 1009.7, 1008.5, 1007.3, 1006.2, 1005.0,
        1003.8, 1002.6, 1001.3, 1000.1, 998.7, 997.6, 996.3, 995.0, 993.8, 992.6, 990.0, 988.6, 987.3, 986.1,
        984.7, 983.3, 982.0, 980.5, 979.1, 977.8, 976.3, 973.3, 971.8, 970.4, 968.9, 967.3, 965.8, 964.2,
        962.7, 961.0, 958.7, 957.0, 953.6, 952.3, 950.2, 948.4, 947.4, 945.7, 943.7, 941.8, 940.0, 938.3,
        936.4,
    ];
    const Y: [f64; 67] = [
        381.1, 334.3, 325.5, 302.4, 301.6, 297.6, 275.8, 275.1, 276.8, 277.8, 280.9, 284.0, 287.3, 290.7,
        294.3, 298.0, 301.7, 305.6, 309.7, 314.0, 318.4, 323.1, 328.0, 332.6, 337.6, 342.9, 348.3, 353.9,
        359.7, 365.7, 372.0, 378.5, 384.8, 390.8, 405.1, 412.2, 419.9, 427.6, 435.6, 443.9, 452.4, 461.2,
        470.2, 479.5, 489.1, 509.1, 519.7, 530.6, 541.7, 553.3, 565.1, 577.4, 590.0, 603.1, 619.0, 633.0,
        662.2, 676.5, 691.7, 708.7, 721.9, 739.3, 756.2, 774.3, 792.9, 812.0, 831.7,
    ];

    fn point(t: f64, x: f64, y: f64) -> Point {
        // In the shadow the blob is large and dim.
        let variance_px2 = if (71.0..78.0).contains(&t) { 0.3 } else { 0.02 };
        Point {
            detection: Detection {
                frame: t.round() as u64,
                stamped: StampedMidpoint::from_seconds_since(0, t / 120.0),
                centre: Pixel::new(x, y),
                covariance_px2: Matrix2::identity() * variance_px2,
                radius_px: 2.0,
                streak_px: [0.0; 2],
                strength: 30.0,
            },
            t,
            index: 0,
        }
    }

    #[test]
    fn an_arm_long_before_makes_no_pitch_rough() {
        let path = T.into_iter().zip(X.into_iter().zip(Y));
        let points: Vec<Point> = path.map(|(t, (x, y))| point(t, x, y)).collect();
        let camera = CameraId::new("home").unwrap();
        let config = TrackerConfig::default();
        let (_, with_arm) = judged(&config, &camera, &points, DEGREE_MAX).unwrap();
        assert_eq!(with_arm.kind, TrackKind::Rough, "{:?}", with_arm.shape);
        let hypothesis = Hypothesis::new(points);
        let (_, ball) = conclude(&config, &camera, &hypothesis, &VecDeque::new()).unwrap();
        assert_eq!(ball.kind, TrackKind::Pitch, "{:?}", ball.shape);
        let frames = ball.track.points.iter().map(|p| p.frame);
        assert!(frames.min().is_some_and(|first| first >= 21));
        assert!(ball.track.points.len() >= 55, "{}", ball.track.points.len());
    }
}
