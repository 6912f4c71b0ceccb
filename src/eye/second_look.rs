//! The second look: refines the centres of what may be a pitch, and judges again. Another thread may do it.

use std::collections::VecDeque;

use nalgebra::Vector2;

use super::EyeConfig;
use super::first_look::{BallStep, EndedBall, FlyingBall};
use crate::detection::{CutOuts, KnownSize, Refined, Refinement, Refiner, doubt};
use crate::scene::Track;
use crate::tracking::{TrackKind, TrackShape, TrackedBall, TrackerConfig, polish, vote};

/// Departure of refined centres from a smooth path beyond their covariance, pixels.
const REFINED_FLOOR_PX: f64 = 0.2;
/// Refined centres of a ball are no further than this from a smooth path (rms, pixels).
const REFINED_ROUGHNESS_MAX_PX: f64 = 0.5;
/// ... and of a short path, to which a curve bends easily, no further than this or so many of its σ: a bird's wings beat.
const SHORT_ROUGHNESS_MAX_PX: f64 = 0.2;
const SHORT_ROUGHNESS_SIGMAS: f64 = 2.5;
/// A rough path is tried without so many points at an end; what is then left must be smoother than this share of those limits.
const END_POINTS: usize = 8;
const SMOOTH_SHARE: f64 = 0.5;
/// A path is short to here, and in between to there, seconds.
const SHORT_S: [f64; 2] = [0.25, 0.5];
/// Earlier balls that vote on which way pitches go, and how many balls ago they were seen at most: a camera may be moved, and
/// batting practice ends.
const SHAPES_KEPT: usize = 60;
const SHAPES_BACK_MAX: usize = 240;
/// A ball says at least this share of what the loudest of the last ones says, or nothing is learnt of its step: one of half
/// the speed says an eighth.
const STEP_SAY_SHARE: f64 = 0.1;
/// Points over which a step is averaged.
const STEP_POINTS: usize = 6;

/// What is known of one camera's balls.
pub struct SecondLook {
    refiner: Refiner,
    tracker_config: TrackerConfig,
    /// Balls seen, each with its number; by rising number.
    shapes: Vec<(usize, TrackShape)>,
    balls: usize,
    /// What the last of them that may be pitches say ([`TrackShape::say`]).
    says: VecDeque<f64>,
    early: Vec<Fitted>,
}

/// What was fitted of a ball, perhaps before its path had ended; what more of it there is to find is sought at the end.
struct Fitted {
    by_first_look: Track,
    /// With its centres fitted, where it may be a pitch.
    ball: TrackedBall,
    refined: Option<Refined>,
}

/// Early looks kept.
const EARLY_MAX: usize = 4;

impl SecondLook {
    /// For the balls of one camera.
    pub fn new(config: &EyeConfig) -> Self {
        Self {
            refiner: Refiner::new(&config.detector),
            tracker_config: config.tracker.clone(),
            shapes: Vec::new(),
            balls: 0,
            says: VecDeque::with_capacity(SHAPES_KEPT),
            early: Vec::new(),
        }
    }

    /// Looks at a ball that still flies: when its path has ended most of the work is done. Whether there was a ball to
    /// look at.
    pub fn look_ahead(&mut self, flying: &FlyingBall) -> bool {
        let track = flying.path.flight(&flying.camera, &self.tracker_config);
        track.is_some_and(|track| {
            self.refiner
                .look_ahead(&flying.cut_outs, &track, flying.size.as_ref())
        })
    }

    /// Whether most of the work on this ball has been done while it flew.
    pub fn knows(&self, ended: &EndedBall) -> bool {
        self.refiner.knows(&ended.ball.track)
    }

    /// Fits a ball whose path will most likely end as it is: [`Self::look`] then has only the frames to seek that the path
    /// lacks. Where it does not end so, nothing has happened.
    pub fn look_early(&mut self, ended: EndedBall) {
        let fitted = self.fit(ended.ball, ended.cut_outs.as_ref(), ended.size.as_ref());
        if self.early.len() >= EARLY_MAX {
            self.early.remove(0);
        }
        self.early.push(fitted);
    }

    /// Refines the centres of what may be a pitch, adds the frames in which the first look lost it, and trims what then
    /// shows not to be free flight. With it what the first look should know of this camera's balls.
    pub fn look(&mut self, ended: EndedBall) -> (TrackedBall, Option<BallStep>) {
        let EndedBall { ball, cut_outs, size } = ended;
        let same = |early: &Fitted| early.by_first_look.points == ball.track.points;
        let number = ball.track.track;
        let fitted = match self.early.iter().position(same) {
            Some(at) => self.early.remove(at),
            None => self.fit(ball, cut_outs.as_ref(), size.as_ref()),
        };
        let (mut ball, by_first_look) = self.complete(fitted, cut_outs.as_ref());
        ball.track.track = number;
        let may_teach = ball.kind == TrackKind::Pitch && self.is_loud(&ball.shape);
        let step = may_teach.then(|| step_of(&ball.track, &by_first_look, ball.shape.radius_px));
        (ball, step.flatten())
    }

    /// Whether a ball says enough beside the last ones: a leg before a bright board may pass for a ball, and frames as far
    /// apart as suit it would hide balls.
    fn is_loud(&mut self, shape: &TrackShape) -> bool {
        let say = shape.say();
        if self.says.len() >= SHAPES_KEPT {
            self.says.pop_front();
        }
        self.says.push_back(say);
        let loudest = self.says.iter().copied().fold(0.0, f64::max);
        say >= STEP_SAY_SHARE * loudest
    }

    /// The centres of what may be a pitch, fitted.
    fn fit(&self, mut ball: TrackedBall, cut_outs: Option<&CutOuts>, size: Option<&KnownSize>) -> Fitted {
        let by_first_look = ball.track.clone();
        let refined = cut_outs.and_then(|cut_outs| self.refiner.refine(cut_outs, &mut ball.track, size));
        if let Some(refined) = &refined {
            self.judge(&mut ball, refined.refinement);
        }
        Fitted {
            by_first_look,
            ball,
            refined,
        }
    }

    /// Seeks a fitted ball in the frames that its track lacks, and learns its blur. With it its track by the first look.
    fn complete(&mut self, fitted: Fitted, cut_outs: Option<&CutOuts>) -> (TrackedBall, Track) {
        let Fitted {
            by_first_look,
            mut ball,
            refined,
        } = fitted;
        if let Some((mut refined, cut_outs)) = refined.zip(cut_outs) {
            let refinement = refined.refinement;
            let may_be_pitch = ball.kind == TrackKind::Pitch;
            // What is no ball teaches the wrong blur: a leg or a wing has no edge of a disc.
            if let Some(blur) = refined
                .blur
                .filter(|_| may_be_pitch || ball.kind == TrackKind::ThrowBack)
            {
                self.refiner.learn(&blur);
            }
            let regained = may_be_pitch.then(|| refined.ball.regain(cut_outs, &mut ball.track));
            if regained.is_some_and(|count| count > 0) {
                self.judge(&mut ball, refinement);
            }
            let points = by_first_look.points.len();
            tracing::debug!(camera = %ball.track.camera, points, ?regained, ?refinement, "refined");
        }
        let ends = ball.track.points.first().zip(ball.track.points.last());
        let frames = ends.map(|(first, last)| (first.frame, last.frame));
        tracing::debug!(camera = %ball.track.camera, kind = ?ball.kind, ?frames, shape = ?ball.shape, "moved");
        (ball, by_first_look)
    }

    /// Trims what shows not to be free flight from a refined ball, and tells what is left.
    fn judge(&self, ball: &mut TrackedBall, refinement: Refinement) {
        if let Some(polished) = polish(&ball.track, REFINED_FLOOR_PX) {
            ball.track = polished;
        }
        if let Some(shape) = TrackShape::measure(&ball.track, refinement.radius_px) {
            ball.shape = shape;
            ball.kind = shape.kind(&self.tracker_config);
        }
        if ball.shape.roughness_px > roughness_max_px(ball)
            && let Some(rest) = self.without_an_end(ball, refinement.radius_px)
        {
            *ball = rest;
        }
        if refinement.fitted < refinement.left || ball.shape.roughness_px > roughness_max_px(ball) {
            ball.kind = TrackKind::Rough;
        }
    }

    /// A rough ball without some points at its begin, its end or both, if the rest is a smooth pitch: a curve that went through
    /// the hand for a while leaves no point far enough off it.
    fn without_an_end(&self, ball: &TrackedBall, radius_px: f64) -> Option<TrackedBall> {
        let points = ball.track.points.as_slice();
        let parts = [(END_POINTS, 0), (0, END_POINTS), (END_POINTS, END_POINTS)];
        parts.into_iter().find_map(|(begin, end)| {
            let kept = points.get(begin..points.len().checked_sub(end)?)?;
            let track = Track {
                points: kept.to_vec(),
                ..ball.track.clone()
            };
            let track = polish(&track, REFINED_FLOOR_PX)?;
            let shape = TrackShape::measure(&track, radius_px)?;
            let kind = shape.kind(&self.tracker_config);
            let rest = TrackedBall {
                track,
                shape,
                kind,
                score: ball.score,
            };
            let smooth = shape.roughness_px < SMOOTH_SHARE * roughness_max_px(&rest);
            (kind == TrackKind::Pitch && smooth).then_some(rest)
        })
    }

    /// The pitches among these balls. Which way this camera's pitches go is voted by all balls seen so far, so asking
    /// once at the end is surest.
    pub fn pitches(&mut self, mut balls: Vec<TrackedBall>) -> Vec<Track> {
        balls.retain(|ball| ball.kind == TrackKind::Pitch);
        let numbered = (self.balls..).zip(balls.iter().map(|ball| ball.shape));
        self.shapes.extend(numbered);
        self.balls += balls.len();
        let shapes: Vec<TrackShape> = self.shapes.iter().map(|(_, shape)| *shape).collect();
        let votes = vote(&shapes);
        let fresh = votes.len() - balls.len();
        let oldest = self.balls.saturating_sub(SHAPES_BACK_MAX);
        self.shapes.retain(|(number, _)| *number >= oldest);
        // Of the older half those go that say least: birds between two innings do not make the pitches forgotten.
        while self.shapes.len() > SHAPES_KEPT {
            let older = self.shapes.iter().take(SHAPES_KEPT / 2).enumerate();
            let least = older.min_by(|a, b| a.1.1.say().total_cmp(&b.1.1.say()));
            let Some((index, _)) = least else { break };
            self.shapes.remove(index);
        }
        let fresh_votes = votes.into_iter().skip(fresh);
        balls
            .into_iter()
            .zip(fresh_votes)
            .filter(|(_, pitch)| *pitch)
            .map(|(mut ball, _)| {
                let doubted = doubt(&mut ball.track, ball.shape.radius_px);
                tracing::debug!(camera = %ball.track.camera, track = ball.track.track, doubted, "pitch");
                ball.track
            })
            .collect()
    }
}

/// The largest departure from a smooth path that a ball's refined centres may have.
fn roughness_max_px(ball: &TrackedBall) -> f64 {
    let [short_s, long_s] = SHORT_S;
    let longer = ((ball.shape.span_s - short_s) / (long_s - short_s)).clamp(0.0, 1.0);
    let allowed_px = SHORT_ROUGHNESS_MAX_PX + longer * (REFINED_ROUGHNESS_MAX_PX - SHORT_ROUGHNESS_MAX_PX);
    let points = ball.track.points.iter();
    let variances = points.filter_map(|p| Some(0.5 * p.covariance_px2?.trace()));
    let count = ball.track.points.len().max(1) as f64;
    let sigma_px = (variances.sum::<f64>() / count).sqrt();
    (SHORT_ROUGHNESS_SIGMAS * sigma_px).clamp(allowed_px, REFINED_ROUGHNESS_MAX_PX)
}

/// What the first look should know: the shortest step between frames, the length along the motion, the middle.
fn step_of(track: &Track, by_first_look: &Track, radius_px: f64) -> Option<BallStep> {
    let step_px = track
        .points
        .windows(STEP_POINTS)
        .filter_map(|points| {
            let (first, last) = (points.first()?, points.last()?);
            let frames = last.frame.checked_sub(first.frame)?.max(1) as f64;
            Some((last.pixel.vector() - first.pixel.vector()).norm() / frames)
        })
        .min_by(f64::total_cmp)?;
    let later = track.points.get(track.points.len() / 2..)?;
    let moved: Vec<Vector2<f64>> = later
        .iter()
        .filter_map(|fitted| {
            let first = &by_first_look.points;
            let at = first.binary_search_by_key(&fitted.frame, |p| p.frame).ok()?;
            Some(fitted.pixel.vector() - first.get(at)?.pixel.vector())
        })
        .collect();
    Some(BallStep {
        step_px,
        length_px: 2.6 * radius_px + 0.3 * step_px,
        off_light_px: moved.iter().sum::<Vector2<f64>>() / moved.len().max(1) as f64,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pixel;
    use crate::scene::{CameraId, TrackPoint};
    use crate::time::StampedMidpoint;

    fn moving(step_px: f64, radius_px: f64) -> TrackShape {
        let point = |frame: u64| TrackPoint {
            frame,
            stamped: StampedMidpoint::from_seconds_since(0, frame as f64 / 175.0),
            pixel: Pixel::new(step_px * frame as f64, 0.02 * (frame * frame) as f64),
            covariance_px2: None,
        };
        let track = Track {
            camera: CameraId::new("side").unwrap(),
            track: 0,
            points: (0..80).map(point).collect(),
        };
        TrackShape::measure(&track, radius_px).unwrap()
    }

    #[test]
    fn a_slow_thing_chooses_no_lag() {
        let (ball, lob, leg) = (moving(20.0, 3.5), moving(10.0, 3.5), moving(4.0, 2.4));
        let mut second = SecondLook::new(&EyeConfig::default());
        // Nothing is known before the first, whatever it is.
        assert!(second.is_loud(&leg) && second.is_loud(&ball));
        assert!(!second.is_loud(&leg));
        assert!(second.is_loud(&lob));
        // The camera was moved to where balls look slow: the loud one is forgotten.
        for _ in 0..SHAPES_KEPT {
            second.is_loud(&leg);
        }
        assert!(second.is_loud(&leg));
    }

    #[test]
    fn a_path_that_begins_in_the_hand_is_a_pitch_from_where_it_leaves_it() {
        let second = SecondLook::new(&EyeConfig::default());
        let ball = |off_px: &dyn Fn(u64) -> f64| {
            let point = |frame: u64| TrackPoint {
                frame,
                stamped: StampedMidpoint::from_seconds_since(0, frame as f64 / 175.0),
                pixel: Pixel::new(20.0 * frame as f64, 0.02 * (frame * frame) as f64 + off_px(frame)),
                covariance_px2: Some(nalgebra::Matrix2::identity() * 1e-4),
            };
            let track = Track {
                camera: CameraId::new("side").unwrap(),
                track: 0,
                points: (0..80).map(point).collect(),
            };
            TrackedBall {
                shape: TrackShape::measure(&track, 3.5).unwrap(),
                track,
                kind: TrackKind::Rough,
                score: 0.0,
            }
        };
        // The hand swings for seven frames.
        let hand = ball(&|frame| 3.0 * (0.9 * frame as f64).sin() * f64::from(u8::from(frame < 8)));
        assert!(hand.shape.roughness_px > 0.5, "{}", hand.shape.roughness_px);
        let rest = second.without_an_end(&hand, 3.5).unwrap();
        assert_eq!(rest.kind, TrackKind::Pitch);
        let frames: Vec<u64> = rest.track.points.iter().map(|p| p.frame).collect();
        assert_eq!(frames, (8..80).collect::<Vec<_>>());
        // A wing beats all along.
        let wing = ball(&|frame| 1.5 * (0.9 * frame as f64).sin());
        assert!(second.without_an_end(&wing, 3.5).is_none());
    }
}
