//! What the commands that search frames share: how balls are found in them.

use clap::builder::PossibleValue;
use clap::{Args, ValueEnum};

use crate::eye::EyeConfig;
use crate::scene::DetectorKind;

impl ValueEnum for DetectorKind {
    fn value_variants<'a>() -> &'a [Self] {
        &Self::ALL
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        let help = match self {
            Self::Ball => "All candidates; once tracked, each centre fitted with the ball's shape and light",
            Self::Kim2019 => {
                "The paper's: the peak of the difference of two consecutive frames, one a frame, whole pixels"
            }
        };
        Some(PossibleValue::new(self.name()).help(help))
    }
}

/// Options of every command that searches frames.
#[derive(Debug, Args)]
pub struct DetectingArgs {
    /// How balls are found in the frames [default: ball].
    #[arg(long, value_enum)]
    pub detector: Option<DetectorKind>,
}

impl DetectingArgs {
    /// The settings with the detector asked for.
    pub fn of(&self, mut eye: EyeConfig) -> EyeConfig {
        eye.detector.kind = self.detector.unwrap_or_default();
        eye
    }
}
