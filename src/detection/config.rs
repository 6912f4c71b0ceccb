//! Settings of one camera's detector.

use crate::geometry::Intrinsics;
use crate::scene::{DetectorKind, PixelRect};

/// Settings of one camera's detector.
#[derive(Debug, Clone, PartialEq)]
pub struct DetectorConfig {
    /// How balls are found.
    pub kind: DetectorKind,
    /// Exposure time in seconds; without it the blur streak is measured.
    pub exposure_s: Option<f64>,
    /// The lens: away from its axis the ball's picture is an ellipse. Without it a circle is taken.
    pub lens: Option<Intrinsics>,
    /// Frames before and after that show the background behind a ball; the answer comes this much later.
    /// Adapted by [`super::Detector::adapt_lag`] within 1..=`lag_frames_max`, without a pause.
    pub lag_frames: usize,
    /// Largest lag that adaptation may choose.
    pub lag_frames_max: usize,
    /// A change is a hit above this many standard deviations of the frame difference.
    pub threshold_sigmas: f64,
    /// ... and never below this many grey levels.
    pub threshold_levels_min: u8,
    /// Most candidates answered for one frame; the strongest stay, the rest are counted.
    pub candidates_max: usize,
    /// Most tiles looked at pixel by pixel in one frame; above it the frame counts as a global change.
    pub busy_fraction_max: f64,
    /// Smallest and largest ball radius in pixels.
    pub radius_px: [f64; 2],
    /// A break between stamps longer than this starts anew, seconds.
    pub break_s: f64,
    /// Memory for cut-outs around candidates, bytes; they wait there for their track to end.
    pub patch_bytes: usize,
    /// Only these regions are searched; empty: the whole frame.
    pub regions: Vec<PixelRect>,
    /// Never searched.
    pub masks: Vec<PixelRect>,
}

/// Whether a place is in one of the regions (none: the whole frame) and in no mask.
pub fn is_searched(regions: &[PixelRect], masks: &[PixelRect], (x_px, y_px): (f64, f64)) -> bool {
    let holds = |rect: &PixelRect| rect.contains(x_px, y_px);
    (regions.is_empty() || regions.iter().any(holds)) && !masks.iter().any(holds)
}

impl Default for DetectorConfig {
    fn default() -> Self {
        Self {
            kind: DetectorKind::Ball,
            exposure_s: None,
            lens: None,
            lag_frames: 6,
            lag_frames_max: 10,
            threshold_sigmas: 5.0,
            threshold_levels_min: 8,
            candidates_max: 48,
            busy_fraction_max: 0.4,
            radius_px: [1.2, 14.0],
            break_s: 0.25,
            patch_bytes: 32 << 20,
            regions: Vec::new(),
            masks: Vec::new(),
        }
    }
}
