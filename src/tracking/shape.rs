//! What a path looks like as a whole, and whether a pitch may look like that.

use super::config::TrackerConfig;
use super::curve::{Curve, Sample, Stiffness};
use crate::scene::Track;

/// Largest rms distance of a ball's points from a smooth curve, pixels.
const ROUGHNESS_MAX_PX: f64 = 1.5;

/// What kind of movement a track is, by its shape alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TrackKind {
    /// May be a pitch.
    Pitch,
    /// Too short in time or path.
    Short,
    /// Too slow for its size.
    Slow,
    /// Not smooth.
    Rough,
    /// One of several that move side by side: parts of a player, not a ball.
    Group,
    /// Smooth and fast, but against the way the pitches of this camera go.
    ThrowBack,
}

/// Measures of a whole path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackShape {
    /// First to last point, seconds.
    pub span_s: f64,
    /// Mean velocity, pixels per second.
    pub velocity_px_per_s: [f64; 2],
    /// Median radius, pixels.
    pub radius_px: f64,
    /// Rms distance from a smooth curve, pixels.
    pub roughness_px: f64,
    /// Mean position, pixels.
    pub middle_px: [f64; 2],
}

/// A finished ball.
#[derive(Debug, Clone)]
pub struct TrackedBall {
    /// Its points.
    pub track: Track,
    /// What it looks like.
    pub kind: TrackKind,
    /// In numbers.
    pub shape: TrackShape,
    /// Log-likelihood against clutter.
    pub score: f64,
}

impl TrackShape {
    /// Measures a track; `None` for fewer than four points.
    pub fn measure(track: &Track, radius_px: f64) -> Option<Self> {
        let (begin, end) = track.span()?;
        let epoch = begin.nanos();
        let samples: Vec<Sample> = track
            .points
            .iter()
            .map(|p| Sample {
                t: p.stamped.seconds_since(epoch),
                position_px: p.pixel.vector(),
                variance_px2: 1.0,
            })
            .collect();
        let degree = (samples.len() / 4).clamp(1, 4);
        let curve = Curve::fit(
            &samples,
            Stiffness {
                degree,
                acceleration_sigma: f64::INFINITY,
            },
        )?;
        let count = samples.len() as f64;
        let squares: f64 = samples
            .iter()
            .map(|s| (s.position_px - curve.position(s.t)).norm_squared())
            .sum();
        let span_s = end.seconds_since(epoch);
        let (first, last) = (samples.first()?, samples.last()?);
        let velocity = (last.position_px - first.position_px) / span_s.max(1e-9);
        let middle = curve.position(0.5 * span_s);
        Some(Self {
            span_s,
            velocity_px_per_s: [velocity.x, velocity.y],
            radius_px,
            roughness_px: (squares / count).sqrt(),
            middle_px: [middle.x, middle.y],
        })
    }

    /// Mean speed across the line of sight in ball radii per second.
    pub fn speed_radii_per_s(&self) -> f64 {
        let [vx, vy] = self.velocity_px_per_s;
        vx.hypot(vy) / self.radius_px.max(0.1)
    }

    /// The kind this shape alone allows.
    pub fn kind(&self, config: &TrackerConfig) -> TrackKind {
        if self.roughness_px > ROUGHNESS_MAX_PX {
            TrackKind::Rough
        } else if self.span_s < config.span_min_s {
            TrackKind::Short
        } else if self.speed_radii_per_s() < config.speed_radii_per_s_min {
            TrackKind::Slow
        } else {
            TrackKind::Pitch
        }
    }
}
