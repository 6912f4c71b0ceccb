//! A frame in, ball detections out.
//!
//! ```text
//! frame ─► scan (|c − p| per tile, one pass) ─► tiles hit before and after ─► three-frame mask
//!       ─► blobs ─► detections (centroid)   ... once tracked: refine (swept disc, no bias)
//! ```
//!
//! The scan reads two frames once ([`kernel`]); everything later touches only tiles that changed both
//! before and after the frame in question, so a ball is free of its own ghosts and the answer comes
//! `lag_frames` late. Thresholds follow the noise of each region ([`regions`]). [`PeakDetector`] is the paper's, to compare with.

#[cfg(test)]
mod adaptation_tests;
mod background;
mod blobs;
mod blur;
mod bodies;
mod candidates;
mod centroid;
mod choice;
mod config;
mod detector;
mod disc;
mod dispatch;
mod doubt;
mod error;
mod evening;
mod expected;
mod extents;
mod finds;
mod fit;
mod fronts;
mod history;
mod kernel;
#[cfg(test)]
mod lag_tests;
mod lamps;
mod lanes;
mod light;
mod looked;
mod median;
mod movers;
mod packed;
mod packing;
#[cfg(test)]
pub(crate) mod painter;
mod patches;
mod path;
mod peak;
mod phases;
mod plate;
mod refine;
mod regain;
mod regions;
mod running;
mod scan;
mod still;
mod tiles;
mod view;

pub use blur::BlurCosts;
pub use choice::ChosenDetector;
pub use config::DetectorConfig;
pub use detector::{Answers, Detector, DetectorCounters};
pub use dispatch::{Isa, Kernels};
pub use doubt::doubt;
pub use error::DetectionError;
pub use expected::ExpectedBall;
pub use packed::UnpackedFrames;
pub use patches::PatchPool as CutOuts;
pub use peak::PeakDetector;
pub use plate::{PlateSeen, SHIFT_MAX_PX, plate_middle, plate_place, seek_plate};
pub use refine::{KnownSize, Refined, Refinement, Refiner};
pub use regain::FittedBall;
pub use still::{Picture as StillPicture, Still};
