//! The second look: refines the centres of what may be a pitch, and judges again. Another thread may do it.

use nalgebra::Vector2;

use super::EyeConfig;
use super::first_look::{BallStep, EndedBall, FlyingBall};
use crate::detection::{BlurCosts, Refinement, Refiner};
use crate::scene::Track;
use crate::tracking::{TrackKind, TrackShape, TrackedBall, TrackerConfig, polish, vote};

/// Departure of refined centres from a smooth path beyond their covariance, pixels.
const REFINED_FLOOR_PX: f64 = 0.2;
/// Refined centres of a ball are no further than this from a smooth path (rms, pixels).
const REFINED_ROUGHNESS_MAX_PX: f64 = 0.5;
/// ... and of a short path, to which a curve bends easily, no further than this or so many of its σ: a bird's wings beat.
const SHORT_ROUGHNESS_MAX_PX: f64 = 0.2;
const SHORT_ROUGHNESS_SIGMAS: f64 = 2.5;
/// A path is short to here, and in between to there, seconds.
const SHORT_S: [f64; 2] = [0.25, 0.5];
/// Earlier balls that vote on which way pitches go, and how many balls ago they were seen at most: a camera may be moved, and
/// batting practice ends.
const SHAPES_KEPT: usize = 60;
const SHAPES_BACK_MAX: usize = 240;
/// A ball says at least this share of what the loudest one says, or nothing is learnt of its step: a slow one of half the speed
/// says an eighth.
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
    /// What the ball says that said most ([`TrackShape::say`]).
    loudest: f64,
    early: Vec<Early>,
}

/// A second look that was taken before the path had ended.
struct Early {
    by_first_look: Track,
    ball: TrackedBall,
    step: Option<BallStep>,
    blur: Option<BlurCosts>,
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
            loudest: 0.0,
            early: Vec::new(),
        }
    }

    /// Looks at a ball that still flies: when its path has ended most of the work is done. Whether there was a ball to
    /// look at.
    pub fn look_ahead(&mut self, flying: &FlyingBall) -> bool {
        let track = flying.path.flight(&flying.camera, &self.tracker_config);
        track.is_some_and(|track| self.refiner.look_ahead(&flying.cut_outs, &track))
    }

    /// Whether most of the work on this ball has been done while it flew.
    pub fn knows(&self, ended: &EndedBall) -> bool {
        self.refiner.knows(&ended.ball.track)
    }

    /// Looks at a ball whose path will most likely end as it is: [`Self::look`] then answers at once. Where it does not
    /// end so, nothing has happened.
    pub fn look_early(&mut self, ended: EndedBall) {
        let by_first_look = ended.ball.track.clone();
        let (ball, step, blur) = self.look_now(ended);
        if self.early.len() >= EARLY_MAX {
            self.early.remove(0);
        }
        self.early.push(Early {
            by_first_look,
            ball,
            step,
            blur,
        });
    }

    /// Refines the centres of what may be a pitch, and trims what then shows not to be free flight. With it what the
    /// first look should know of this camera's balls.
    pub fn look(&mut self, ended: EndedBall) -> (TrackedBall, Option<BallStep>) {
        let same = |early: &Early| early.by_first_look.points == ended.ball.track.points;
        let early = self.early.iter().position(same).map(|at| self.early.remove(at));
        let number = ended.ball.track.track;
        let (mut ball, step, blur) = match early {
            Some(early) => (early.ball, early.step, early.blur),
            None => self.look_now(ended),
        };
        ball.track.track = number;
        if let Some(blur) = blur {
            self.refiner.learn(&blur);
        }
        let say = ball.shape.say();
        if step.is_some() {
            self.loudest = self.loudest.max(say);
        }
        // A leg before a bright board may pass for a ball: frames as far apart as suit it would hide balls.
        (ball, step.filter(|_| say >= STEP_SAY_SHARE * self.loudest))
    }

    fn look_now(&self, ended: EndedBall) -> (TrackedBall, Option<BallStep>, Option<BlurCosts>) {
        let EndedBall { mut ball, cut_outs } = ended;
        let mut learnt = None;
        let by_first_look = ball.track.clone();
        if let Some(cut_outs) = &cut_outs
            && let Some(mut refined) = self.refiner.refine(cut_outs, &mut ball.track)
        {
            let refinement = refined.refinement;
            let points = ball.track.points.len();
            self.judge(&mut ball, refinement);
            let may_be_pitch = ball.kind == TrackKind::Pitch;
            // What is no ball teaches the wrong blur: a leg or a wing has no edge of a disc.
            if may_be_pitch || ball.kind == TrackKind::ThrowBack {
                learnt = refined.blur;
            }
            let regained = may_be_pitch.then(|| refined.ball.regain(cut_outs, &mut ball.track));
            if regained.is_some_and(|count| count > 0) {
                self.judge(&mut ball, refinement);
            }
            tracing::debug!(camera = %ball.track.camera, points, ?regained, ?refinement, "refined");
        }
        let step = (ball.kind == TrackKind::Pitch)
            .then(|| step_of(&ball.track, &by_first_look, ball.shape.radius_px))
            .flatten();
        let ends = ball.track.points.first().zip(ball.track.points.last());
        let frames = ends.map(|(first, last)| (first.frame, last.frame));
        tracing::debug!(camera = %ball.track.camera, kind = ?ball.kind, ?frames, shape = ?ball.shape, "moved");
        (ball, step, learnt)
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
        if refinement.fitted < refinement.left || ball.shape.roughness_px > roughness_max_px(ball) {
            ball.kind = TrackKind::Rough;
        }
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
            .map(|(ball, _)| ball.track)
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
