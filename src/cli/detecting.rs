//! What the commands that search frames share: how balls are found in them.

use clap::{Args, ValueEnum};

use crate::eye::EyeConfig;
use crate::scene::DetectorKind;

/// How balls are found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Detector {
    /// All candidates; once tracked, each centre fitted with the ball's shape and light.
    Ball,
    /// The paper's: the peak of the difference of two consecutive frames, one a frame, whole pixels.
    Kim2019,
}

/// Options of every command that searches frames.
#[derive(Debug, Args)]
pub struct DetectingArgs {
    /// How balls are found in the frames [default: ball].
    #[arg(long, value_enum)]
    pub detector: Option<Detector>,
}

impl DetectingArgs {
    /// The settings with the detector asked for.
    pub fn of(&self, mut eye: EyeConfig) -> EyeConfig {
        eye.detector.kind = match self.detector {
            None | Some(Detector::Ball) => DetectorKind::Ball,
            Some(Detector::Kim2019) => DetectorKind::Kim2019,
        };
        eye
    }
}
