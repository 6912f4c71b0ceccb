//! One camera's eye: frames in, tracks of pitched balls out (detection, then tracking, then a second look).

use crate::detection::{Answers, DetectionError, Detector, DetectorConfig, DetectorCounters, ExpectedBall};
use crate::scene::{CameraId, Detection, Frame, FrameStamp, Rig, Track};
use crate::tracking::{
    TrackKind, TrackShape, TrackedBall, Tracker, TrackerConfig, TrackerCounters, polish, vote,
};

/// Departure of refined centres from a smooth path beyond their covariance, pixels.
const REFINED_FLOOR_PX: f64 = 0.2;

/// Refined centres of a ball are no further than this from a smooth path (rms, pixels).
const REFINED_ROUGHNESS_MAX_PX: f64 = 0.5;

/// Settings of an eye.
#[derive(Debug, Clone, Default)]
pub struct EyeConfig {
    /// Of its detector.
    pub detector: DetectorConfig,
    /// Of its tracker.
    pub tracker: TrackerConfig,
}

impl EyeConfig {
    /// What the rig knows of a camera; the defaults where it does not know it. Live frames and replayed ones both
    /// take it from here, so that they give the same pitches.
    pub fn of_rig(rig: &Rig, camera: &CameraId) -> Self {
        let mut eye = Self::default();
        if let Some(setup) = rig.camera(camera) {
            eye.detector.exposure_s = setup.exposure_s;
            eye.tracker.frame_rate_hz = setup.frame_rate_hz;
        }
        eye
    }
}

/// Detector and tracker of one camera.
pub struct CameraEye {
    detector: Detector,
    tracker: Tracker,
    tracker_config: TrackerConfig,
    balls: Vec<TrackedBall>,
    shapes: Vec<TrackShape>,
}

/// The tracker as the detector sees it: it takes candidates and says where to look for weak ones.
struct Guided<'a>(&'a mut Tracker);

impl Answers for Guided<'_> {
    fn expect(&mut self, stamp: FrameStamp, expected: &mut Vec<ExpectedBall>) {
        let predictions = self.0.predictions(stamp);
        expected.extend(predictions.map(|(centre, reach_px, radius_px)| ExpectedBall {
            centre,
            reach_px,
            radius_px,
        }));
    }

    fn answer(&mut self, stamp: FrameStamp, detections: &[Detection]) {
        for d in detections {
            tracing::trace!(
                frame = stamp.frame,
                x = d.centre.x,
                y = d.centre.y,
                radius = d.radius_px,
                strength = d.strength,
                "candidate"
            );
        }
        self.0.push(stamp, detections);
    }
}

impl CameraEye {
    /// An eye for frames of this size.
    pub fn new(camera: CameraId, config: EyeConfig, width_px: u32, height_px: u32) -> Self {
        Self {
            detector: Detector::new(config.detector, width_px, height_px),
            tracker: Tracker::new(camera, config.tracker.clone()),
            tracker_config: config.tracker,
            balls: Vec::new(),
            shapes: Vec::new(),
        }
    }

    /// Takes the next frame of the camera.
    pub fn push(&mut self, frame: &Frame) -> Result<(), DetectionError> {
        let Self {
            detector, tracker, ..
        } = self;
        let result = detector.detect(frame, &mut Guided(tracker));
        self.collect();
        result
    }

    /// Ends the recording: what was still open is decided.
    pub fn finish(&mut self) {
        let Self {
            detector, tracker, ..
        } = self;
        detector.flush(&mut Guided(tracker));
        let last = self.tracker.finish();
        self.look_again(last);
    }

    fn collect(&mut self) {
        let fresh = self.tracker.drain();
        self.look_again(fresh);
    }

    /// Refines the centres of what may be a pitch, and trims what then shows not to be free flight.
    fn look_again(&mut self, balls: Vec<TrackedBall>) {
        for mut ball in balls {
            if ball.kind == TrackKind::Pitch
                && let Some(refinement) = self.detector.refine(&mut ball.track)
            {
                tracing::debug!(camera = %ball.track.camera, points = ball.track.points.len(), ?refinement, "refined");
                if let Some(polished) = polish(&ball.track, REFINED_FLOOR_PX) {
                    ball.track = polished;
                }
                if let Some(shape) = TrackShape::measure(&ball.track, refinement.radius_px) {
                    ball.shape = shape;
                    ball.kind = shape.kind(&self.tracker_config);
                }
                if refinement.fitted < refinement.left || ball.shape.roughness_px > REFINED_ROUGHNESS_MAX_PX {
                    ball.kind = TrackKind::Rough;
                }
            }
            if ball.kind == TrackKind::Pitch
                && let Some((step_px, length_px)) = slowest_step(&ball.track, ball.shape.radius_px)
            {
                self.detector.adapt_lag(step_px, length_px);
            }
            let ends = ball.track.points.first().zip(ball.track.points.last());
            let frames = ends.map(|(first, last)| (first.frame, last.frame));
            tracing::debug!(camera = %ball.track.camera, kind = ?ball.kind, ?frames, shape = ?ball.shape, "moved");
            self.balls.push(ball);
        }
    }

    /// Everything smooth that moved since the last call, with its kind.
    pub fn drain_balls(&mut self) -> Vec<TrackedBall> {
        std::mem::take(&mut self.balls)
    }

    /// The pitches since the last call. Which way this camera's pitches go is voted by all balls seen so far, so
    /// asking once at the end is surest.
    pub fn drain_pitches(&mut self) -> Vec<Track> {
        let mut balls = self.drain_balls();
        balls.retain(|ball| ball.kind == TrackKind::Pitch);
        self.shapes.extend(balls.iter().map(|ball| ball.shape));
        let votes = vote(&self.shapes);
        let fresh = votes.len() - balls.len();
        if fresh > SHAPES_KEPT {
            self.shapes.drain(..fresh - SHAPES_KEPT);
        }
        let fresh_votes = votes.into_iter().skip(fresh);
        balls
            .into_iter()
            .zip(fresh_votes)
            .filter(|(_, pitch)| *pitch)
            .map(|(ball, _)| ball.track)
            .collect()
    }

    /// Frames between a frame and its answer.
    pub fn lag_frames(&self) -> usize {
        self.detector.lag_frames()
    }

    /// What was seen and left out.
    pub fn counters(&self) -> (DetectorCounters, TrackerCounters) {
        (self.detector.counters(), self.tracker.counters())
    }
}

/// Earlier balls that vote on which way pitches go.
const SHAPES_KEPT: usize = 60;
/// Points over which a step is averaged.
const STEP_POINTS: usize = 6;

/// The shortest step of a track between frames, and the ball's length along its motion, pixels.
fn slowest_step(track: &Track, radius_px: f64) -> Option<(f64, f64)> {
    let step_px = track
        .points
        .windows(STEP_POINTS)
        .filter_map(|points| {
            let (first, last) = (points.first()?, points.last()?);
            let frames = last.frame.checked_sub(first.frame)?.max(1) as f64;
            Some((last.pixel.vector() - first.pixel.vector()).norm() / frames)
        })
        .min_by(f64::total_cmp)?;
    Some((step_px, 2.6 * radius_px + 0.3 * step_px))
}

#[cfg(test)]
mod tests;
