//! One guess at a ball: detections that follow each other smoothly, and where the next should be.

use nalgebra::Vector2;

use super::config::TrackerConfig;
use super::curve::{Curve, Sample, Stiffness};
use crate::scene::Detection;

/// Points that the prediction looks back on.
const LOOK_BACK: usize = 10;
/// Departure of a real path from the local parabola, pixels.
const MODEL_SIGMA_PX: f64 = 0.4;
/// σ of that pull, as a share of the radius.
const LIGHT_OFFSET_OF_RADIUS: f64 = 0.3;
/// Gate in standard deviations.
const GATE_SIGMAS: f64 = 4.0;
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
        let mut found: Vec<Match> = points
            .iter()
            .filter_map(|point| {
                gain(curve, t, last, point).map(|gain| Match {
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

    /// Share of this path's points that the other path has too.
    pub fn shared(&self, other: &[Point]) -> f64 {
        let both = self
            .points
            .iter()
            .filter(|p| other.iter().any(|q| q.same(p)))
            .count();
        both as f64 / self.points.len().max(1) as f64
    }
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

/// Gain in score from continuing a path, fitted as `curve`, with `point`; `None` outside the gate.
pub fn gain(curve: &Curve, t: f64, last: &Point, point: &Point) -> Option<f64> {
    let miss = (point.position() - curve.position(t)).norm();
    let variance = curve.variance_px2(t) + point.sample().variance_px2 + light_variance_px2(last, point);
    let sigmas = miss / variance.sqrt();
    if miss > GATE_MAX_PX || sigmas > GATE_SIGMAS {
        return None;
    }
    let ratio = (point.detection.radius_px / last.detection.radius_px.max(0.1))
        .ln()
        .abs();
    let size = if ratio < 1.1 { 0.3 * ratio } else { 2.0 };
    Some(2.5 - 0.3 * sigmas * sigmas - size)
}

/// Seeds: three detections in line at nearly even steps, of like size.
pub fn aligned(config: &TrackerConfig, a: &Point, b: &Point, c: &Point) -> bool {
    let (first, second) = (b.t - a.t, c.t - b.t);
    if first <= 0.0 || second <= 0.0 {
        return false;
    }
    let (v1, v2) = (
        (b.position() - a.position()) / first,
        (c.position() - b.position()) / second,
    );
    let speed = 0.5 * (v1.norm() + v2.norm());
    let [slowest, fastest] = config.speed_px_per_frame;
    let noise = |p: &Point| 0.5 * p.detection.covariance_px2.trace();
    let tolerance =
        0.5 + 0.08 * speed + 2.0 * (noise(a) + 4.0 * noise(b) + noise(c)).sqrt() / first.min(second);
    let radius = |p: &Point| p.detection.radius_px.max(0.5);
    let alike = (radius(a) / radius(c)).ln().abs() < 0.9 && (radius(a) / radius(b)).ln().abs() < 0.9;
    alike && (slowest..=fastest).contains(&speed) && (v2 - v1).norm() <= tolerance.min(0.3 + speed)
}
