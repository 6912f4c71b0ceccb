//! One guess at a ball: detections that follow each other smoothly, and where the next should be.

use nalgebra::Vector2;

use super::config::TrackerConfig;
use super::curve::{Curve, Prediction, Sample, Stiffness};
use crate::scene::Detection;

/// A path keeps so many of its last points at least, and at most twice as many: a pitch of 1.2 s at 500 frames a second has
/// fewer, and a sign that turns goes on for hours.
const POINTS_KEPT: usize = 600;
/// Points that the prediction looks back on.
const LOOK_BACK: usize = 10;
/// Departure of a real path from the local parabola, pixels.
const MODEL_SIGMA_PX: f64 = 0.4;
/// σ of that pull, as a share of the radius.
const LIGHT_OFFSET_OF_RADIUS: f64 = 0.3;
/// Gate in standard deviations.
const GATE_SIGMAS: f64 = 4.0;
/// Sizes of one ball in three frames differ by less than this.
const SIZE_RATIO_MAX: f64 = 2.46;
/// A gate is never wider than this, pixels.
const GATE_MAX_PX: f64 = 14.0;

/// A detection with its place in the stream: frame count of the tracker and index within that frame.
#[derive(Debug, Clone, Copy)]
pub struct Point {
    /// Detection.
    pub detection: Detection,
    /// Time in frames (stamps times nominal rate) since the window began.
    pub t: f64,
    /// Index within its frame.
    pub index: usize,
}

impl Point {
    /// Whether both are the same detection.
    pub fn same(&self, other: &Point) -> bool {
        self.detection.frame == other.detection.frame && self.index == other.index
    }

    /// Centre, pixels.
    pub fn position(&self) -> Vector2<f64> {
        self.detection.centre.vector()
    }

    /// As a sample of a curve.
    pub fn sample(&self) -> Sample {
        let variance = 0.5 * self.detection.covariance_px2.trace();
        Sample {
            t: self.t,
            position_px: self.position(),
            variance_px2: variance + MODEL_SIGMA_PX * MODEL_SIGMA_PX,
        }
    }
}

/// A growing path.
#[derive(Debug, Clone)]
pub struct Hypothesis {
    /// Its detections by rising time.
    pub points: Vec<Point>,
    /// Log-likelihood against clutter.
    pub score: f64,
    curve: Option<Curve>,
}

/// How well a detection continues a path.
#[derive(Debug, Clone, Copy)]
pub struct Match {
    /// Index of the detection in its frame.
    pub index: usize,
    /// Gain in score.
    pub gain: f64,
}

impl Hypothesis {
    /// From the points of a seed.
    pub fn new(points: Vec<Point>) -> Self {
        let mut hypothesis = Self {
            points,
            score: 0.0,
            curve: None,
        };
        hypothesis.refit();
        hypothesis
    }

    /// Time of the last point, frames.
    pub fn last_t(&self) -> f64 {
        self.points.last().map_or(f64::NEG_INFINITY, |p| p.t)
    }

    /// Adds a point.
    pub fn extend(&mut self, point: Point, gain: f64) {
        if self.points.len() >= 2 * POINTS_KEPT {
            self.points.drain(..POINTS_KEPT);
        }
        self.points.push(point);
        self.score += gain;
        self.refit();
    }

    fn refit(&mut self) {
        let from = self.points.len().saturating_sub(LOOK_BACK);
        self.curve = local_curve(self.points.get(from..).unwrap_or(&[]));
    }

    /// Where the path should be at time `t`, how far off it may be, and the ball's radius, pixels.
    pub fn prediction(&self, t: f64) -> Option<(Vector2<f64>, f64, f64)> {
        let curve = self.curve.as_ref()?;
        let from = self.points.len().saturating_sub(LOOK_BACK);
        let recent = self.points.get(from..).unwrap_or(&[]);
        let radius = recent.iter().map(|p| p.detection.radius_px).fold(0.0, f64::max);
        Some((
            curve.position(t),
            2.5 * curve.variance_px2(t).sqrt() + 1.0,
            radius,
        ))
    }

    /// The detections within the gate at time `t`, best first.
    pub fn matches(&self, t: f64, points: &[Point]) -> Vec<Match> {
        let Some(curve) = &self.curve else {
            return Vec::new();
        };
        let Some(last) = self.points.last() else {
            return Vec::new();
        };
        let predicted = curve.predict(t);
        let mut found: Vec<Match> = points
            .iter()
            .filter_map(|point| {
                gain(&predicted, last, point).map(|gain| Match {
                    index: point.index,
                    gain,
                })
            })
            .collect();
        found.sort_by(|a, b| b.gain.total_cmp(&a.gain));
        found
    }

    /// Whether two paths end in the same detections.
    pub fn same_end(&self, other: &Hypothesis) -> bool {
        let mine = self.points.iter().rev();
        let theirs = other.points.iter().rev();
        mine.zip(theirs).take(3).all(|(a, b)| a.same(b))
    }

    /// Whether two paths have come to the same detection.
    pub fn ends_with(&self, other: &Hypothesis) -> bool {
        let ends = self.points.last().zip(other.points.last());
        ends.is_some_and(|(a, b)| a.same(b))
    }

    /// Share of this path's points that the other path has too.
    pub fn shared(&self, other: &[Point]) -> f64 {
        in_both(&self.points, other) as f64 / self.points.len().max(1) as f64
    }
}

/// Detections that two paths have in common; both are by rising time.
pub fn in_both(one: &[Point], other: &[Point]) -> usize {
    let mut rest = other;
    let mut count = 0;
    for point in one {
        while let [first, later @ ..] = rest
            && first.detection.frame < point.detection.frame
        {
            rest = later;
        }
        count += usize::from(rest.first().is_some_and(|first| first.same(point)));
    }
    count
}

/// A parabola through some points with a prior on its acceleration.
pub fn local_curve(points: &[Point]) -> Option<Curve> {
    let samples: Vec<Sample> = points.iter().map(Point::sample).collect();
    let (first, last) = (samples.first()?, samples.last()?);
    let speed = (last.position_px - first.position_px).norm() / (last.t - first.t).abs().max(1e-9);
    // Gravity is about 0.05 px/frame² here, perspective up to a few percent of the speed.
    let stiffness = Stiffness {
        degree: 2,
        acceleration_sigma: 0.15 + 0.03 * speed,
    };
    Curve::fit(&samples, stiffness)
}

/// The light's pull on a centroid as the track knows the ball's size: where one side of the ball has the
/// background's level, the other side's centroid lies two thirds of the radius off.
pub fn light_variance_px2(last: &Point, point: &Point) -> f64 {
    (LIGHT_OFFSET_OF_RADIUS * last.detection.radius_px.max(point.detection.radius_px)).powi(2)
}

/// Gain in score from continuing a path whose prediction this is with `point`; `None` outside the gate.
pub fn gain(predicted: &Prediction, last: &Point, point: &Point) -> Option<f64> {
    let miss = (point.position() - predicted.position_px).norm();
    if miss > GATE_MAX_PX {
        return None;
    }
    let variance = predicted.variance_px2 + point.sample().variance_px2 + light_variance_px2(last, point);
    let sigmas = miss / variance.sqrt();
    if sigmas > GATE_SIGMAS {
        return None;
    }
    let ratio = (point.detection.radius_px / last.detection.radius_px.max(0.1))
        .ln()
        .abs();
    let size = if ratio < 1.1 { 0.3 * ratio } else { 2.0 };
    Some(2.5 - 0.3 * sigmas * sigmas - size)
}

/// Two detections of different frames that a ball may have made one after the other.
#[derive(Debug, Clone, Copy)]
pub struct Pair<'a> {
    from: &'a Point,
    to: &'a Point,
    velocity: Vector2<f64>,
    speed: f64,
}

impl<'a> Pair<'a> {
    /// `None` where sizes or speed are not a ball's.
    pub fn new(config: &TrackerConfig, from: &'a Point, to: &'a Point) -> Option<Self> {
        let frames = to.t - from.t;
        let velocity = (to.position() - from.position()) / frames;
        let speed = velocity.norm();
        let [slowest, fastest] = config.speed_px_per_frame;
        // Speeds of three in line differ by less than their mean and 0.3.
        let possible = 2.0 * speed + 0.3 >= slowest && speed <= 1.5 * fastest + 0.3;
        (frames > 0.0 && possible && alike(from, to)).then_some(Self {
            from,
            to,
            velocity,
            speed,
        })
    }

    /// The earlier of the two.
    pub fn middle(&self) -> &'a Point {
        self.from
    }

    /// Seeds: three detections in line at nearly even steps, of like size; `first` comes before both of the pair.
    pub fn continues(&self, config: &TrackerConfig, first: &Point) -> bool {
        let (before, after) = (self.from.t - first.t, self.to.t - self.from.t);
        if before <= 0.0 {
            return false;
        }
        let velocity = (self.from.position() - first.position()) / before;
        let turn = (self.velocity - velocity).norm();
        // The rest is dear, and this leaves little: the mean speed is at most this one's and half of the turn.
        if turn > 0.6 + 2.0 * self.speed {
            return false;
        }
        let speed = 0.5 * (velocity.norm() + self.speed);
        let [slowest, fastest] = config.speed_px_per_frame;
        let noise = |p: &Point| 0.5 * p.detection.covariance_px2.trace();
        let spread = (noise(first) + 4.0 * noise(self.from) + noise(self.to)).sqrt();
        let tolerance = 0.5 + 0.08 * speed + 2.0 * spread / before.min(after);
        turn <= tolerance.min(0.3 + speed)
            && (slowest..=fastest).contains(&speed)
            && alike(first, self.from)
            && alike(first, self.to)
    }
}

/// Whether the sizes of two detections may be one ball's.
fn alike(one: &Point, other: &Point) -> bool {
    let radius = |p: &Point| p.detection.radius_px.max(0.5);
    let ratio = radius(one) / radius(other);
    (1.0 / SIZE_RATIO_MAX..SIZE_RATIO_MAX).contains(&ratio)
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix2;

    use super::*;
    use crate::geometry::Pixel;
    use crate::time::StampedMidpoint;

    #[test]
    fn a_path_that_never_ends_keeps_its_last_points() {
        // A light on a wheel that turns once in 100 frames.
        let point = |frame: u64| {
            let turn = 0.02 * std::f64::consts::PI * frame as f64;
            Point {
                detection: Detection {
                    frame,
                    stamped: StampedMidpoint::from_seconds_since(0, frame as f64 / 175.0),
                    centre: Pixel::new(300.0 + 90.0 * turn.cos(), 200.0 + 90.0 * turn.sin()),
                    covariance_px2: Matrix2::identity() * 0.01,
                    radius_px: 3.0,
                    streak_px: [0.0; 2],
                    strength: 20.0,
                },
                t: frame as f64,
                index: 0,
            }
        };
        let mut path = Hypothesis::new((0..3).map(point).collect());
        for frame in 3..10_000 {
            path.extend(point(frame), 1.0);
            assert!(path.points.len() <= 2 * POINTS_KEPT);
            assert!(path.points.len() >= POINTS_KEPT.min(frame as usize));
        }
        assert_eq!(path.last_t(), 9_999.0);
        let (place, _, _) = path.prediction(10_000.0).unwrap();
        assert!((place - Vector2::new(390.0, 200.0)).norm() < 1.0, "{place:?}");
    }
}
