//! Where frames come from: one trait; a recording, a folder of images, a video file; and live cameras.
//!
//! A source is an iterator over the frames of one camera by rising stamps. Everything after it is the same
//! code, live or not.

pub mod aravis;
mod error;
mod image_folder;
mod own_times;
mod recording;
mod stamps;
mod video;

pub use error::CaptureError;
pub use image_folder::ImageFolder;
pub use recording::RecordingSource;
pub use stamps::Stamping;
pub use video::VideoFile;

use crate::scene::{CameraId, Frame};

/// Size of a source's frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FrameGeometry {
    /// Columns.
    pub width_px: u32,
    /// Rows.
    pub height_px: u32,
}

/// The frames of one camera. An error ends neither the source nor the program: the next frame may be good;
/// `None` is the end.
pub trait FrameSource: Iterator<Item = Result<Frame, CaptureError>> + Send {
    /// Whose frames.
    fn camera(&self) -> &CameraId;
    /// Size of every frame.
    fn geometry(&self) -> FrameGeometry;
    /// How many frames there will be, where that is known.
    fn frames_expected(&self) -> Option<u64>;
    /// What a person should know once the last frame has come, though it is no error.
    fn remarks(&self) -> Vec<String> {
        Vec::new()
    }
    /// Whether it ended before it should have: a remark says where.
    fn is_cut_off(&self) -> bool {
        false
    }
}
