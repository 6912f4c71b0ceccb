//! Detections: where a ball may be in one frame.

use nalgebra::Matrix2;

use crate::geometry::Pixel;
use crate::time::StampedMidpoint;

/// How balls are found in frames.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum DetectorKind {
    /// All candidates; once tracked, each centre fitted with the ball's shape and light.
    #[default]
    Ball,
    /// The paper's: the peak of the difference image, one a frame.
    Kim2019,
}

impl DetectorKind {
    /// All of them.
    pub const ALL: [Self; 2] = [Self::Ball, Self::Kim2019];

    /// Its name on the command line and in configuration files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ball => "ball",
            Self::Kim2019 => "kim2019",
        }
    }

    /// The one of this name.
    pub fn of_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }
}

/// One ball candidate of one frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Detection {
    /// Frame number.
    pub frame: u64,
    /// Exposure midpoint by the stamps.
    pub stamped: StampedMidpoint,
    /// Geometric centre of the ball at the exposure midpoint, distorted pixels.
    pub centre: Pixel,
    /// Covariance of the centre, px².
    pub covariance_px2: Matrix2<f64>,
    /// Ball radius seen or assumed, pixels.
    pub radius_px: f64,
    /// Vector from the blur streak's start to its end, pixels (sign unknown from one frame).
    pub streak_px: [f64; 2],
    /// Contrast over the local noise: larger is surer.
    pub strength: f64,
}
