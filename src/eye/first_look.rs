//! The first look: every frame through detector and tracker; ended balls go out with what a second look needs.

use nalgebra::Vector2;

use super::EyeConfig;
use crate::detection::{
    Answers, ChosenDetector, CutOuts, DetectionError, DetectorCounters, ExpectedBall, KnownSize,
};
use crate::scene::{CameraId, Detection, ForeseenPath, ForeseenPlace, Frame, FrameStamp, RawFrame, Track};
use crate::tracking::{OpenPath, TrackKind, TrackedBall, Tracker, TrackerCounters};

/// A ball that was missed in so many frames has most likely ended; the path is given up after some more.
const ENDING_FRAMES: f64 = 3.0;

/// A ball that flies is told of when it has been seen this often, and again every so many times.
const FLYING_POINTS: (usize, usize) = (48, 16);

/// A foreseen ball is no further off than so many of its sigmas, and so many pixels more: calibrations and the light.
const FORESEEN_SIGMAS: f64 = 3.0;
const FORESEEN_BEYOND_PX: f64 = 1.5;

/// A ball whose path has ended, with the cut-outs of its points if it may be a pitch.
pub struct EndedBall {
    /// Its path by the first look.
    pub ball: TrackedBall,
    /// What it looked like in every frame.
    pub cut_outs: Option<CutOuts>,
    /// Its size, where other cameras have told its distance.
    pub size: Option<KnownSize>,
}

/// A ball that still flies, with the cut-outs of its points so far.
pub struct FlyingBall {
    /// Whose ball.
    pub camera: CameraId,
    /// Its path so far.
    pub path: OpenPath,
    /// What it looked like in every frame.
    pub cut_outs: CutOuts,
    /// Its size, where other cameras have told its distance.
    pub size: Option<KnownSize>,
}

/// What a second look tells the first of this camera's balls: how far they move between frames at their slowest, how long
/// they are along their motion, and where their middle is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BallStep {
    /// Shortest step between frames, pixels.
    pub step_px: f64,
    /// Length along the motion, pixels.
    pub length_px: f64,
    /// The fitted centre less the first look's, which is drawn to the lit side: mean over the later half of the path,
    /// pixels.
    pub off_light_px: Vector2<f64>,
}

/// Detector and tracker of one camera.
pub struct FirstLook {
    camera: CameraId,
    detector: ChosenDetector,
    tracker: Tracker,
    /// See [`BallStep::off_light_px`].
    off_light_px: Vector2<f64>,
    /// Where the flight that all cameras see puts a ball in this one's picture.
    foreseen: Option<ForeseenPath>,
    /// Newest frame of the balls in flight that were told of.
    flying_told: Option<u64>,
    ended: Vec<EndedBall>,
}

/// The tracker as the detector sees it: it takes candidates and says where to look for weak ones. So does the flight
/// that other cameras see.
struct Guided<'a>(&'a mut Tracker, Option<&'a ForeseenPath>);

impl Answers for Guided<'_> {
    fn expect(&mut self, stamp: FrameStamp, expected: &mut Vec<ExpectedBall>) {
        let predictions = self.0.predictions(stamp);
        expected.extend(predictions.map(|(centre, reach_px, radius_px)| ExpectedBall {
            centre,
            reach_px,
            radius_px,
        }));
        let Some(foreseen) = self.1.and_then(|path| path.at(stamp.stamped)) else {
            return;
        };
        // A path of this camera that leads there knows it better.
        let off_px = |own: &ExpectedBall| (own.centre.vector() - foreseen.centre.vector()).norm();
        if expected.iter().all(|own| off_px(own) > own.reach_px) {
            expected.insert(0, expected_at(&foreseen));
        }
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

    fn is_quiet(&self, _detections: &[Detection]) -> bool {
        !self.0.sees_a_ball()
    }
}

fn expected_at(place: &ForeseenPlace) -> ExpectedBall {
    ExpectedBall {
        centre: place.centre,
        reach_px: FORESEEN_SIGMAS * place.sigma_px + FORESEEN_BEYOND_PX,
        radius_px: place.radius_px,
    }
}

impl FirstLook {
    /// For frames of this size.
    pub fn new(camera: CameraId, config: &EyeConfig, width_px: u32, height_px: u32) -> Self {
        Self {
            detector: ChosenDetector::new(&config.detector, width_px, height_px),
            tracker: Tracker::new(camera.clone(), config.tracker.clone()),
            camera,
            off_light_px: Vector2::zeros(),
            foreseen: None,
            flying_told: None,
            ended: Vec::new(),
        }
    }

    /// Takes the next frame of the camera.
    ///
    /// # Errors
    /// A frame of another size.
    pub fn push(&mut self, frame: &Frame) -> Result<(), DetectionError> {
        let mut guided = Guided(&mut self.tracker, self.foreseen.as_ref());
        let result = self.detector.detect(frame, &mut guided);
        self.keep_ended();
        result
    }

    /// As [`Self::push`], of a frame as its camera sent it.
    ///
    /// # Errors
    /// A frame of another size.
    pub fn push_raw(&mut self, raw: &RawFrame) -> Result<(), DetectionError> {
        let mut guided = Guided(&mut self.tracker, self.foreseen.as_ref());
        let result = self.detector.detect_raw(raw, &mut guided);
        self.keep_ended();
        result
    }

    fn keep_ended(&mut self) {
        let balls = self.tracker.drain();
        self.keep(balls);
    }

    /// Ends the recording: what was still open is decided.
    pub fn finish(&mut self) {
        let mut guided = Guided(&mut self.tracker, self.foreseen.as_ref());
        self.detector.flush(&mut guided);
        let balls = self.tracker.finish();
        self.keep(balls);
        // The stamps that follow may be of another clock.
        self.foreseen = None;
    }

    fn keep(&mut self, balls: Vec<TrackedBall>) {
        for ball in balls {
            let may_be_pitch = ball.kind == TrackKind::Pitch;
            let cut_outs = may_be_pitch.then(|| self.detector.cut_outs(&ball.track));
            let size = self.known_size(&ball.track);
            self.ended.push(EndedBall { ball, cut_outs, size });
        }
    }

    /// The balls that have ended since the last call.
    pub fn drain(&mut self) -> Vec<EndedBall> {
        std::mem::take(&mut self.ended)
    }

    /// Balls that were last seen a few frames ago, as they will be if their paths end there.
    pub fn ending(&self) -> Vec<EndedBall> {
        let balls = self.tracker.ending(ENDING_FRAMES).into_iter();
        balls
            .map(|ball| EndedBall {
                cut_outs: Some(self.detector.point_cut_outs(&ball.track)),
                size: self.known_size(&ball.track),
                ball,
            })
            .collect()
    }

    /// Those of the balls in flight ([`Self::open`]) of which enough is new since they were told of.
    pub fn flying(&mut self, open: &[OpenPath]) -> Vec<FlyingBall> {
        let (first, every) = FLYING_POINTS;
        let due = |path: &&OpenPath| {
            path.newest_frame() > self.flying_told
                && path.points() >= first
                && (path.points() - first).is_multiple_of(every)
        };
        let told: Vec<FlyingBall> = open
            .iter()
            .filter(due)
            .map(|path| {
                let track = path.track(&self.camera);
                FlyingBall {
                    camera: self.camera.clone(),
                    path: path.clone(),
                    cut_outs: self.detector.point_cut_outs(&track),
                    size: self.known_size(&track),
                }
            })
            .collect();
        let newest = told.iter().filter_map(|ball| ball.path.newest_frame()).max();
        self.flying_told = newest.max(self.flying_told);
        told
    }

    /// The likeliest balls in flight.
    pub fn open(&self) -> Vec<OpenPath> {
        self.tracker.open()
    }

    /// Whether what may be a ball is being followed, or held back because it may go on.
    pub fn follows(&self, open: &[OpenPath]) -> bool {
        !open.is_empty() || self.tracker.holds_back()
    }

    /// Takes what a second look has found of this camera's balls; it holds from where nothing is being followed.
    pub fn adapt(&mut self, ball: BallStep) {
        self.off_light_px = ball.off_light_px;
        self.detector.adapt_lag(ball.step_px, ball.length_px);
    }

    /// Takes the way of a ball through this camera's picture, by the flight that other cameras see too: weak candidates
    /// there are accepted. It replaces the one before.
    pub fn foresee(&mut self, path: ForeseenPath) {
        self.foreseen = Some(path);
    }

    /// The size of this ball, if it is the foreseen one: most of its points are where that is.
    fn known_size(&self, track: &Track) -> Option<KnownSize> {
        let path = self.foreseen.as_ref()?;
        let there = track.points.iter().filter_map(|point| {
            let place = path.at(point.stamped)?;
            let off_px = (point.pixel.vector() - place.centre.vector()).norm();
            let near = off_px < expected_at(&place).reach_px + place.radius_px;
            near.then_some((point.stamped, place.radius_px))
        });
        let there: Vec<_> = there.collect();
        let (first, last) = (there.first()?, there.last()?);
        (2 * there.len() > track.points.len()).then_some(KnownSize([*first, *last]))
    }

    /// What is to be added to the centres of balls in flight, by the last ball that was fitted, pixels.
    pub fn off_light_px(&self) -> Vector2<f64> {
        self.off_light_px
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
