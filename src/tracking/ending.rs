//! What happens when a path ends: back to the hand, outliers out, ends trimmed, shape judged.

use std::collections::VecDeque;

use nalgebra::Vector2;

use super::config::TrackerConfig;
use super::curve::{Curve, Sample, Stiffness};
use super::hypothesis::{Hypothesis, Point, gain, local_curve};
use super::shape::{TrackShape, TrackedBall};
use super::tracker::FramePoints;
use crate::scene::{CameraId, Track, TrackPoint};

/// Points looked at when extending back.
const LOOK_AHEAD: usize = 10;
/// A point further than this many σ from the smooth path is not the ball.
const OUTLIER_SIGMAS: f64 = 5.0;
/// Departure of centroids from the smooth path beyond their covariance, pixels.
const CENTROID_FLOOR_PX: f64 = 0.5;

/// The ball of a path, with the detections it took; `None` where it is none.
pub fn conclude(
    config: &TrackerConfig,
    camera: &CameraId,
    hypothesis: &Hypothesis,
    history: &VecDeque<FramePoints>,
) -> Option<(Vec<Point>, TrackedBall)> {
    let points = extend_back(config, hypothesis.points.clone(), history);
    let track = Track {
        camera: camera.clone(),
        track: 0,
        points: points
            .iter()
            .map(|p| TrackPoint {
                frame: p.detection.frame,
                stamped: p.detection.stamped,
                pixel: p.detection.centre,
                covariance_px2: Some(p.detection.covariance_px2),
            })
            .collect(),
    };
    let track = polish(&track, CENTROID_FLOOR_PX)?;
    let mut radii: Vec<f64> = points.iter().map(|p| p.detection.radius_px).collect();
    radii.sort_by(f64::total_cmp);
    let radius_px = radii.get(radii.len() / 2).copied()?;
    let shape = TrackShape::measure(&track, radius_px)?;
    let kind = shape.kind(config);
    if track.points.len() < config.points_min {
        return None;
    }
    Some((
        points,
        TrackedBall {
            track,
            kind,
            shape,
            score: hypothesis.score,
        },
    ))
}

/// Adds earlier detections that lie on the path's continuation into the past.
fn extend_back(
    config: &TrackerConfig,
    mut points: Vec<Point>,
    history: &VecDeque<FramePoints>,
) -> Vec<Point> {
    points.reverse();
    for frame in history.iter().rev() {
        let Some(first) = points.last() else { break };
        if frame.t >= first.t - 0.5 {
            continue;
        }
        if first.t - frame.t > f64::from(config.gap_frames_max) {
            break;
        }
        let from = points.len().saturating_sub(LOOK_AHEAD);
        let Some(curve) = local_curve(points.get(from..).unwrap_or(&[])) else {
            break;
        };
        let best = frame
            .points
            .iter()
            .filter_map(|p| gain(&curve, frame.t, first, p).map(|gain| (gain, p)))
            .max_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((_, point)) = best {
            points.push(*point);
        }
    }
    points.reverse();
    points
}

/// Drops points off the smooth path, worst first; what is left is the ball in free flight.
///
/// `floor_px` is the departure allowed beyond the covariance. Called again after the centres were refined: with
/// their small covariance the ends in the hand and in the glove show. `None` when nothing is left.
pub fn polish(track: &Track, floor_px: f64) -> Option<Track> {
    let epoch = track.points.first()?.stamped.nanos();
    let mut kept = track.points.clone();
    loop {
        let samples: Vec<Sample> = kept.iter().map(|p| sample(p, epoch, floor_px)).collect();
        let degree = match samples.len() {
            0..4 => return None,
            4..10 => 2,
            10..24 => 3,
            24..50 => 4,
            _ => 5,
        };
        let curve = Curve::fit(
            &samples,
            Stiffness {
                degree,
                acceleration_sigma: f64::INFINITY,
            },
        )?;
        let excess = |s: &Sample| -> f64 {
            let miss: Vector2<f64> = s.position_px - curve.position(s.t);
            miss.norm() / s.variance_px2.sqrt()
        };
        let worst = samples
            .iter()
            .map(excess)
            .enumerate()
            .max_by(|a, b| a.1.total_cmp(&b.1))?;
        if worst.1 <= OUTLIER_SIGMAS {
            break;
        }
        kept.remove(worst.0);
    }
    Some(Track {
        camera: track.camera.clone(),
        track: track.track,
        points: kept,
    })
}

fn sample(point: &TrackPoint, epoch: i64, floor_px: f64) -> Sample {
    let variance = point.covariance_px2.map_or(0.25, |c| 0.5 * c.trace());
    Sample {
        t: point.stamped.seconds_since(epoch),
        position_px: point.pixel.vector(),
        variance_px2: variance + floor_px * floor_px,
    }
}
