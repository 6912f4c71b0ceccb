//! What a path looks like as a whole, and whether a pitch may look like that.

use nalgebra::Vector2;

use super::config::TrackerConfig;
use super::curve::{Curve, Sample, Stiffness};
use super::depth::{Depth, DepthCurve};
use crate::scene::Track;

/// Largest rms distance of a ball's points from a smooth curve, pixels.
const ROUGHNESS_MAX_PX: f64 = 1.5;
/// Nothing thrown is faster, radii per second (50 m/s is 1360, and a ball half in shade measures half its size): rain is.
const SPEED_MAX_RADII_PER_S: f64 = 2500.0;
/// Radii are measured no further off than this from what is known of them, as shares of the smallest and the largest.
const RADIUS_SHARES: [f64; 2] = [0.4, 2.5];

/// Balls fly the same way when the cosine between them is above this, and are of one size within this log ratio.
const SAME_WAY_COSINE: f64 = 0.5;
const SAME_SIZE_LOG: f64 = 0.6;
/// A path of this length has its full say, in ball radii (5.5 m).
const LONG_PATH_RADII: f64 = 150.0;
/// Short paths are not quite without a say: a camera that looks along the flight sees no long ones.
const LENGTH_SAY_MIN: f64 = 0.5;
/// With so many balls that say at least this share of what the loudest says the size of a pitch is known, and others are
/// within this log ratio of it.
const SIZE_KNOWN_BALLS: usize = 4;
const LOUD_SHARE: f64 = 0.1;
const KNOWN_SIZE_LOG: f64 = 0.4;
/// Nothing smaller can be told from noise, pixels: a glint of 0.5 px is as slow as a ball of this size.
const RADIUS_MIN_PX: f64 = 1.2;
/// Stamps of ordinary cameras shake by this much, seconds: along its way a fast ball seems rough by half a pixel.
const STAMP_JITTER_S: f64 = 1.5e-4;
/// Gravity, the air, or its coming nearer change a ball's velocity in the picture by more than this, radii per second
/// squared (1.1 m/s² across the line of sight; a pitch from the side has 5 to 13), seen over at least so long.
const PULL_MIN_RADII_PER_S2: f64 = 30.0;
const PULL_SPAN_MIN_S: f64 = 0.15;
const PULL_SIGMAS: f64 = 4.0;
/// Points over which the peak speed is measured.
const PEAK_POINTS: usize = 8;

/// What kind of movement a track is, by its shape alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TrackKind {
    /// May be a pitch.
    Pitch,
    /// Too short in time or path.
    Short,
    /// Too slow for its size.
    Slow,
    /// Faster than anything that is thrown.
    Fast,
    /// Not of a ball's size: a drop of rain, a player.
    Size,
    /// Not smooth.
    Rough,
    /// One of several that move side by side: parts of a player, not a ball.
    Group,
    /// Smooth and fast, but nothing pulls it: a bird.
    Straight,
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
    /// Largest speed over eight points, pixels per second.
    pub peak_speed_px_per_s: f64,
    /// Median radius, pixels.
    pub radius_px: f64,
    /// Rms distance from a smooth curve, pixels, beyond what shaking stamps explain.
    pub roughness_px: f64,
    /// Mean acceleration in the picture that the points allow for, pixels per second squared; infinite for short paths.
    pub pull_px_per_s2: f64,
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
        let stiffness = Stiffness {
            degree,
            acceleration_sigma: f64::INFINITY,
        };
        let curve = Depth::of(&samples).fit(&samples, stiffness)?;
        let span_s = end.seconds_since(epoch);
        let (first, last) = (samples.first()?, samples.last()?);
        let velocity = (last.position_px - first.position_px) / span_s.max(1e-9);
        let middle = curve.position(0.5 * span_s);
        Some(Self {
            span_s,
            velocity_px_per_s: [velocity.x, velocity.y],
            peak_speed_px_per_s: peak_speed(&samples),
            radius_px,
            roughness_px: roughness_px(&samples, &curve, velocity),
            pull_px_per_s2: pull_px_per_s2(&samples, span_s),
            middle_px: [middle.x, middle.y],
        })
    }

    /// Largest speed across the line of sight in ball radii per second.
    pub fn speed_radii_per_s(&self) -> f64 {
        self.peak_speed_px_per_s / self.radius_px.max(RADIUS_MIN_PX)
    }

    /// First to last point in ball radii.
    pub fn path_radii(&self) -> f64 {
        let [vx, vy] = self.velocity_px_per_s;
        vx.hypot(vy) * self.span_s / self.radius_px.max(RADIUS_MIN_PX)
    }

    fn direction(&self) -> [f64; 2] {
        let [vx, vy] = self.velocity_px_per_s;
        let speed = vx.hypot(vy).max(1e-9);
        [vx / speed, vy / speed]
    }

    /// Whether two fly the same way.
    fn flies_like(&self, other: &Self) -> bool {
        let (u, v) = (self.direction(), other.direction());
        u[0] * v[0] + u[1] * v[1] > SAME_WAY_COSINE
    }

    /// Size of the logarithm of their radii's ratio.
    fn size_log(&self, other: &Self) -> f64 {
        (self.radius_px.max(0.1) / other.radius_px.max(0.1)).ln().abs()
    }

    /// Whether two fly the same way and are about the same size.
    fn is_like(&self, other: &Self) -> bool {
        self.flies_like(other) && self.size_log(other) < SAME_SIZE_LOG
    }

    /// What it says of how pitches go. As many balls are thrown back as are pitched, and along longer paths, so speed
    /// tells: it counts by its cube; and many more birds than balls may pass, but few of them straight for several metres.
    pub fn say(&self) -> f64 {
        let length = (self.path_radii() / LONG_PATH_RADII).clamp(LENGTH_SAY_MIN, 1.0);
        (length * self.speed_radii_per_s()).powi(3)
    }

    /// The kind this shape alone allows.
    pub fn kind(&self, config: &TrackerConfig) -> TrackKind {
        if self.roughness_px > ROUGHNESS_MAX_PX {
            TrackKind::Rough
        } else if self.speed_radii_per_s() > SPEED_MAX_RADII_PER_S {
            TrackKind::Fast
        } else if config
            .ball_radius_px
            .is_some_and(|known| !self.is_as_large(known))
        {
            TrackKind::Size
        } else if self.span_s < config.span_min_s || self.path_radii() < config.path_radii_min {
            TrackKind::Short
        } else if self.speed_radii_per_s() < config.speed_radii_per_s_min {
            TrackKind::Slow
        } else if self.pull_px_per_s2 < PULL_MIN_RADII_PER_S2 * self.radius_px.max(RADIUS_MIN_PX) {
            TrackKind::Straight
        } else if config.pitch_way.is_some_and(|way| !self.goes(way)) {
            TrackKind::ThrowBack
        } else {
            TrackKind::Pitch
        }
    }

    /// Whether its radius may be between these.
    fn is_as_large(&self, [smallest, largest]: [f64; 2]) -> bool {
        let [least, most] = RADIUS_SHARES;
        (least * smallest..=most * largest).contains(&self.radius_px)
    }

    /// Whether it goes roughly along a unit vector.
    fn goes(&self, [x, y]: [f64; 2]) -> bool {
        let [vx, vy] = self.velocity_px_per_s;
        vx * x + vy * y > SAME_WAY_COSINE * vx.hypot(vy)
    }
}

/// Mean acceleration, and what its uncertainty adds: the departure from a parabola, taken for the noise, is that of neighbours
/// alike.
fn pull_px_per_s2(samples: &[Sample], span_s: f64) -> f64 {
    let parabola = Stiffness {
        degree: 2,
        acceleration_sigma: f64::INFINITY,
    };
    let Some(curve) = Curve::fit(samples, parabola).filter(|_| span_s > PULL_SPAN_MIN_S) else {
        return f64::INFINITY;
    };
    let at = |share: f64| curve.position(share * span_s);
    let pull = 4.0 * (at(1.0) - 2.0 * at(0.5) + at(0.0)).norm() / (span_s * span_s);
    let squares = samples
        .iter()
        .map(|s| (s.position_px - curve.position(s.t)).norm_squared());
    let count = samples.len() as f64;
    let noise_px = (squares.sum::<f64>() / count).sqrt();
    pull + PULL_SIGMAS * noise_px * (720.0 / count).sqrt() / (span_s * span_s)
}

/// Rms distance from a curve, less what shaking stamps make of it along the motion.
fn roughness_px(samples: &[Sample], curve: &DepthCurve, velocity: Vector2<f64>) -> f64 {
    let along = velocity.try_normalize(1e-9).unwrap_or_else(Vector2::x);
    let (mut along_px2, mut across_px2) = (0.0, 0.0);
    for sample in samples {
        let off = sample.position_px - curve.position(sample.t);
        along_px2 += off.dot(&along).powi(2);
        across_px2 += off.norm_squared() - off.dot(&along).powi(2);
    }
    let count = samples.len() as f64;
    let shaken_px = STAMP_JITTER_S * velocity.norm();
    ((along_px2 / count - shaken_px * shaken_px).max(0.0) + across_px2 / count).sqrt()
}

/// Largest speed over [`PEAK_POINTS`] points.
fn peak_speed(samples: &[Sample]) -> f64 {
    samples
        .windows(PEAK_POINTS.min(samples.len()).max(2))
        .filter_map(|stretch| {
            let (first, last) = (stretch.first()?, stretch.last()?);
            Some((last.position_px - first.position_px).norm() / (last.t - first.t).max(1e-9))
        })
        .fold(0.0, f64::max)
}

/// Which of these shapes of one camera go with its pitches: most balls, and the fast ones most of all, fly the
/// same way at about the same size. `false`: a throw back, a pick-off, or something else that is smooth.
pub fn vote(shapes: &[TrackShape]) -> Vec<bool> {
    let support = |a: &TrackShape| -> f64 {
        let friends = shapes.iter().filter(|b| a.is_like(b));
        friends.map(TrackShape::say).sum()
    };
    let Some(leader) = shapes.iter().max_by(|a, b| support(a).total_cmp(&support(b))) else {
        return Vec::new();
    };
    let friends = shapes.iter().filter(|s| leader.is_like(s));
    let (typical, known) = match typical(friends.collect()) {
        Some(typical) => (typical, KNOWN_SIZE_LOG),
        None => (leader, SAME_SIZE_LOG),
    };
    let votes = shapes
        .iter()
        .map(|s| leader.flies_like(s) && typical.size_log(s) < known);
    votes.collect()
}

/// The ball of the middle size, each counted by what it says; `None` where too few say much.
fn typical(mut friends: Vec<&TrackShape>) -> Option<&TrackShape> {
    let loudest = friends.iter().map(|s| s.say()).fold(0.0, f64::max);
    let loud = friends.iter().filter(|s| s.say() > LOUD_SHARE * loudest).count();
    if loud < SIZE_KNOWN_BALLS {
        return None;
    }
    friends.sort_by(|a, b| a.radius_px.total_cmp(&b.radius_px));
    let mut left = 0.5 * friends.iter().map(|s| s.say()).sum::<f64>();
    friends.into_iter().find(|s| {
        left -= s.say();
        left <= 0.0
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pixel;
    use crate::scene::{CameraId, TrackPoint};
    use crate::time::StampedMidpoint;

    fn shape(vx: f64, vy: f64, radius_px: f64) -> TrackShape {
        TrackShape {
            span_s: 0.45,
            velocity_px_per_s: [vx, vy],
            peak_speed_px_per_s: vx.hypot(vy),
            radius_px,
            roughness_px: 0.1,
            pull_px_per_s2: 900.0,
            middle_px: [900.0, 400.0],
        }
    }

    #[test]
    fn pitches_outvote_throws_back_and_small_things() {
        let shapes = [
            shape(-3300.0, 250.0, 3.2),
            shape(1700.0, -10.0, 3.3),
            shape(-2500.0, 300.0, 3.2),
            shape(1800.0, 40.0, 3.3),
            shape(-800.0, 0.0, 1.1),
        ];
        assert_eq!(vote(&shapes), [true, false, true, false, false]);
        assert_eq!(vote(&shapes[..1]), [true]);
        // Every pitch is thrown back, more slowly, seen for longer.
        let back = |vx: f64| TrackShape {
            span_s: 0.9,
            ..shape(vx, -60.0, 3.3)
        };
        let shapes = [
            shape(-3100.0, 200.0, 3.2),
            back(2000.0),
            shape(-2700.0, 250.0, 3.3),
            back(1800.0),
        ];
        assert_eq!(vote(&shapes), [true, false, true, false]);
        // A bird of half the size flies their way: four pitches know it, three do not (ln(3.3/2) = 0.50).
        let mut shapes = vec![shape(-3100.0, 200.0, 3.3); 3];
        shapes.push(shape(-600.0, 40.0, 2.0));
        assert_eq!(vote(&shapes[1..]), [true, true, true]);
        shapes.insert(0, shape(-2900.0, 200.0, 3.2));
        assert_eq!(vote(&shapes), [true, true, true, true, false]);
        // Sixty birds that were followed for an eighth of a second do not outvote one pitch: 0.125·550/1.2 = 57 radii.
        let bird = TrackShape {
            span_s: 0.125,
            ..shape(-550.0, 60.0, 1.2)
        };
        let mut shapes = vec![bird; 60];
        shapes.push(shape(-3100.0, 200.0, 3.3));
        let votes = vote(&shapes);
        assert!(votes[60] && votes[..60].iter().all(|bird| !bird));
    }

    #[test]
    fn a_thing_of_a_size_between_does_not_make_birds_of_pitches() {
        // It is like both: ln(3.5/2.05) = 0.53, ln(2.05/1.2) = 0.54.
        let bird = |radius_px: f64| TrackShape {
            span_s: 0.15,
            ..shape(-700.0, 60.0, radius_px)
        };
        let mut shapes = vec![shape(-3300.0, 200.0, 3.5); 12];
        shapes.extend(vec![bird(1.2); 20]);
        shapes.push(bird(2.05));
        let votes = vote(&shapes);
        assert!(votes[..12].iter().all(|pitch| *pitch), "{votes:?}");
        assert!(votes[12..].iter().all(|bird| !bird), "{votes:?}");
        // A smaller ball than the one between would allow: ln(3.9/2.05) = 0.64.
        shapes.push(shape(-3300.0, 200.0, 3.9));
        assert_eq!(vote(&shapes).last(), Some(&true));
    }

    #[test]
    fn stamps_that_shake_make_no_ball_rough() {
        let curve = |samples: &[Sample]| {
            let level = Stiffness {
                degree: 2,
                acceleration_sigma: f64::INFINITY,
            };
            Depth::of(samples).fit(samples, level).unwrap()
        };
        // 0.5 px forth and back, along the motion of 3500 px/s or across it.
        let shaken = |along: f64, across: f64| {
            let samples: Vec<Sample> = (0..60)
                .map(|i| {
                    let off = if i % 2 == 0 { 0.5 } else { -0.5 };
                    Sample {
                        t: f64::from(i) / 175.0,
                        position_px: Vector2::new(20.0 * f64::from(i) + along * off, 300.0 + across * off),
                        variance_px2: 1.0,
                    }
                })
                .collect();
            roughness_px(&samples, &curve(&samples), Vector2::new(3500.0, 0.0))
        };
        assert!(shaken(1.0, 0.0) < 0.1, "{}", shaken(1.0, 0.0));
        assert!((shaken(0.0, 1.0) - 0.5).abs() < 0.01, "{}", shaken(0.0, 1.0));
    }

    #[test]
    fn what_nothing_pulls_is_no_ball() {
        let path = |pull_px_per_s2: f64, points: u32| {
            let points = (0..points).map(|i| {
                let t = f64::from(i) / 175.0;
                let shake = if i % 2 == 0 { 0.3 } else { -0.3 };
                TrackPoint {
                    frame: u64::from(i),
                    stamped: StampedMidpoint::from_seconds_since(0, t),
                    pixel: Pixel::new(1800.0 - 700.0 * t, 300.0 + shake + 0.5 * pull_px_per_s2 * t * t),
                    covariance_px2: None,
                }
            });
            let track = Track {
                camera: CameraId::new("first").unwrap(),
                track: 0,
                points: points.collect(),
            };
            TrackShape::measure(&track, 1.4)
                .unwrap()
                .kind(&TrackerConfig::default())
        };
        assert_eq!(path(0.0, 80), TrackKind::Straight);
        assert_eq!(path(150.0, 80), TrackKind::Pitch);
        assert_eq!(path(0.0, 30), TrackKind::Pitch, "too short to tell");
    }

    #[test]
    fn rain_is_faster_and_smaller_than_a_ball() {
        // Drops before a camera behind home, of which one is as large as a ball seems: 6118/1.556 = 3932 radii/s.
        let known = TrackerConfig {
            ball_radius_px: Some([2.6, 4.9]),
            ..TrackerConfig::default()
        };
        let unknown = TrackerConfig::default();
        let kinds = |shape: TrackShape| [shape.kind(&unknown), shape.kind(&known)];
        assert_eq!(kinds(shape(475.0, 6099.0, 1.556)), [TrackKind::Fast; 2]);
        // Slower, far away: 0.4 · 2.6 = 1.04 px.
        let far = kinds(shape(-95.0, 2550.0, 1.03));
        assert_eq!(far, [TrackKind::Pitch, TrackKind::Size]);
        assert_eq!(kinds(shape(40.0, 1500.0, 3.5)), [TrackKind::Pitch; 2]);
        // Half in shade.
        assert_eq!(kinds(shape(40.0, 1500.0, 1.05)), [TrackKind::Pitch; 2]);
        // 2.5 · 4.9 = 12.25 px.
        let large = kinds(shape(40.0, 6000.0, 12.3));
        assert_eq!(large, [TrackKind::Pitch, TrackKind::Size]);
    }

    #[test]
    fn a_known_way_tells_pitches_from_throws_back() {
        let config = TrackerConfig {
            pitch_way: Some([-1.0, 0.0]),
            ..TrackerConfig::default()
        };
        assert_eq!(shape(-3300.0, 250.0, 3.2).kind(&config), TrackKind::Pitch);
        assert_eq!(shape(3300.0, 250.0, 3.2).kind(&config), TrackKind::ThrowBack);
        assert_eq!(shape(-900.0, 3000.0, 3.2).kind(&config), TrackKind::ThrowBack);
        let unknown = TrackerConfig::default();
        assert_eq!(shape(3300.0, 250.0, 3.2).kind(&unknown), TrackKind::Pitch);
    }
}
