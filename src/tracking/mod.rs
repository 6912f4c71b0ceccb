//! Detections in, 2-D tracks out, one camera at a time.
//!
//! ```text
//! detections ─► seeds (three in line) ─► hypotheses (predict, gate, branch) ─► ended
//!            ─► extended back to the hand ─► outliers and ends trimmed ─► kind by shape ─► TrackedBall
//! ```

mod config;
mod curve;
mod depth;
mod ending;
mod hypothesis;
mod open;
mod polish;
mod shape;
mod tracker;
mod way;

pub use config::TrackerConfig;
pub use open::OpenPath;
pub use polish::polish;
pub use shape::{TrackKind, TrackShape, TrackedBall, vote};
pub use tracker::{Tracker, TrackerCounters};
pub use way::{pitch_radii, pitch_way};
