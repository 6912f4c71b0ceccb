//! The detector that a camera's settings ask for.

use super::config::DetectorConfig;
use super::detector::{Answers, Detector, DetectorCounters};
use super::error::DetectionError;
use super::patches::PatchPool;
use super::peak::PeakDetector;
use crate::scene::{DetectorKind, Frame, RawFrame, Track};

/// One of the detectors ([`DetectorConfig::kind`]); each method is as [`Detector`]'s.
pub enum ChosenDetector {
    /// Candidates, whose centres can be fitted later.
    Ball(Box<Detector>),
    /// The paper's peaks.
    Kim2019(Box<PeakDetector>),
}

impl ChosenDetector {
    /// For frames of this size.
    pub fn new(config: &DetectorConfig, width_px: u32, height_px: u32) -> Self {
        match config.kind {
            DetectorKind::Ball => Self::Ball(Box::new(Detector::new(config.clone(), width_px, height_px))),
            DetectorKind::Kim2019 => Self::Kim2019(Box::new(PeakDetector::new(config, width_px, height_px))),
        }
    }

    /// Takes the next frame.
    ///
    /// # Errors
    /// A frame of another size.
    pub fn detect(&mut self, frame: &Frame, answers: &mut dyn Answers) -> Result<(), DetectionError> {
        match self {
            Self::Ball(detector) => detector.detect(frame, answers),
            Self::Kim2019(detector) => detector.detect(frame, answers),
        }
    }

    /// Takes the next frame as its camera sent it.
    ///
    /// # Errors
    /// A frame of another size.
    pub fn detect_raw(&mut self, raw: &RawFrame, answers: &mut dyn Answers) -> Result<(), DetectionError> {
        match self {
            Self::Ball(detector) => detector.detect_raw(raw, answers),
            Self::Kim2019(detector) => detector.detect_raw(raw, answers),
        }
    }

    /// Ends the window.
    pub fn flush(&mut self, answers: &mut dyn Answers) {
        match self {
            Self::Ball(detector) => detector.flush(answers),
            Self::Kim2019(detector) => detector.flush(),
        }
    }

    /// What the second look needs of a track; peaks keep nothing, and are not looked at again.
    pub fn cut_outs(&self, track: &Track) -> PatchPool {
        match self {
            Self::Ball(detector) => detector.cut_outs(track),
            Self::Kim2019(_) => PatchPool::new(0),
        }
    }

    /// What it needs of a track that may go on.
    pub fn point_cut_outs(&self, track: &Track) -> PatchPool {
        match self {
            Self::Ball(detector) => detector.point_cut_outs(track),
            Self::Kim2019(_) => PatchPool::new(0),
        }
    }

    /// Chooses the frames' distance in time; peaks are always of consecutive frames.
    pub fn adapt_lag(&mut self, step_px: f64, length_px: f64) {
        match self {
            Self::Ball(detector) => detector.adapt_lag(step_px, length_px),
            Self::Kim2019(_) => {}
        }
    }

    /// Frames between a frame and its answer.
    pub fn lag_frames(&self) -> usize {
        match self {
            Self::Ball(detector) => detector.lag_frames(),
            Self::Kim2019(_) => 0,
        }
    }

    /// What was seen and left out.
    pub fn counters(&self) -> DetectorCounters {
        match self {
            Self::Ball(detector) => detector.counters(),
            Self::Kim2019(detector) => detector.counters(),
        }
    }
}
