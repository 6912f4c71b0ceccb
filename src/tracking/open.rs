//! Balls in flight: what is known of a path before it has ended.

use super::config::TrackerConfig;
use super::ending::free_flight;
use super::hypothesis::{Hypothesis, Point};
use super::shape::{TrackKind, TrackShape};
use crate::scene::{CameraId, Track, TrackPoint};

/// Fewest points of a path that is told of.
const POINTS_MIN: usize = 10;
/// Most paths told of at once.
const OPEN_MAX: usize = 3;

/// A path that is still being followed.
#[derive(Debug, Clone)]
pub struct OpenPath {
    points: Vec<Point>,
}

impl OpenPath {
    /// Points so far.
    pub fn points(&self) -> usize {
        self.points.len()
    }

    /// Frame of the newest point.
    pub fn newest_frame(&self) -> Option<u64> {
        self.points.last().map(|p| p.detection.frame)
    }

    /// All of it, what the hand adds too. Its track number is the frame in which the path begins.
    pub fn track(&self, camera: &CameraId) -> Track {
        self.track_of(camera, &self.points)
    }

    fn track_of(&self, camera: &CameraId, points: &[Point]) -> Track {
        let begin = self.points.first().map_or(0, |p| p.detection.frame);
        Track {
            camera: camera.clone(),
            track: u32::try_from(begin & u64::from(u32::MAX)).unwrap_or(0),
            points: points.iter().map(point_of).collect(),
        }
    }

    /// The part that flies freely, if that may be a pitch. Its track number is the frame in which the path begins.
    /// Dear (a curve for every point): not for the thread that searches the frames.
    pub fn flight(&self, camera: &CameraId, config: &TrackerConfig) -> Option<Track> {
        let free = free_flight(&self.points)?;
        let track = self.track_of(camera, &free);
        let mut radii: Vec<f64> = free.iter().map(|p| p.detection.radius_px).collect();
        radii.sort_by(f64::total_cmp);
        let shape = TrackShape::measure(&track, radii.get(radii.len() / 2).copied()?)?;
        (shape.kind(config) == TrackKind::Pitch).then_some(track)
    }
}

/// A detection as a point of a track.
pub fn point_of(point: &Point) -> TrackPoint {
    TrackPoint {
        frame: point.detection.frame,
        stamped: point.detection.stamped,
        pixel: point.detection.centre,
        covariance_px2: Some(point.detection.covariance_px2),
    }
}

/// The likeliest of the paths being followed, each ball once.
pub fn open_paths(alive: &[Hypothesis], config: &TrackerConfig) -> Vec<OpenPath> {
    let mut told: Vec<&Hypothesis> = Vec::with_capacity(OPEN_MAX);
    // By falling score, as the tracker keeps them.
    for hypothesis in alive.iter().filter(|h| h.points.len() >= POINTS_MIN) {
        let known = |p: &Point| told.iter().any(|other| other.points.iter().any(|q| q.same(p)));
        let from = hypothesis.points.len() - POINTS_MIN;
        let recent = hypothesis.points.get(from..).unwrap_or(&[]);
        if told.len() < OPEN_MAX && is_fast(recent, config) && !recent.iter().any(known) {
            told.push(hypothesis);
        }
    }
    told.into_iter()
        .map(|h| OpenPath {
            points: h.points.clone(),
        })
        .collect()
}

/// Whether these points go as fast as a pitch's.
pub fn is_fast(points: &[Point], config: &TrackerConfig) -> bool {
    let (Some(first), Some(last)) = (points.first(), points.last()) else {
        return false;
    };
    let radius_px = points.iter().map(|p| p.detection.radius_px).fold(0.1, f64::max);
    let speed_px_per_frame = (last.position() - first.position()).norm() / (last.t - first.t).max(1.0);
    // Radii vary from frame to frame: half of what a whole path must have.
    speed_px_per_frame * config.frame_rate_hz > 0.5 * config.speed_radii_per_s_min * radius_px
}
