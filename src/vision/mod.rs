//! The only room that says `opencv`; no `Mat` leaves it.

mod difference;
mod essential;
pub mod image_files;
mod resection;

pub use difference::DifferenceBaseline;
pub use essential::five_point;
pub use resection::resection_candidates;

/// OpenCV refused.
#[derive(Debug, thiserror::Error)]
#[error("OpenCV: {0}")]
pub struct VisionError(#[from] opencv::Error);
