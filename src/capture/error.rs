//! Why a frame did not come.

use std::path::PathBuf;

use crate::scene::CameraId;
use crate::vision::image_files::ImageError;

/// What is wrong with a source, or with one frame of it.
#[derive(Debug, thiserror::Error)]
pub enum CaptureError {
    /// The session has no camera of that name.
    #[error("{}: no camera {camera} was recorded", place.display())]
    NoSuchCamera {
        /// Camera.
        camera: CameraId,
        /// Session.
        place: PathBuf,
    },
    /// There is nothing to read.
    #[error("camera {camera}: {}: {reason}", path.display())]
    NoFrames {
        /// Camera.
        camera: CameraId,
        /// Folder or file.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// A frame has no time.
    #[error("camera {camera}: {}: no timestamp for frame {frame} ({})", list.display(), file.display())]
    NoTimestamp {
        /// Camera.
        camera: CameraId,
        /// Frame number.
        frame: u64,
        /// Its image.
        file: PathBuf,
        /// The list of timestamps.
        list: PathBuf,
    },
    /// The list of timestamps is wrong.
    #[error("camera {camera}: {}: {reason}", list.display())]
    Timestamps {
        /// Camera.
        camera: CameraId,
        /// The list.
        list: PathBuf,
        /// What is wrong, with the line.
        reason: String,
    },
    /// Two images of one number.
    #[error("camera {camera}: frame {frame} is there twice: {} and {}", first.display(), second.display())]
    DuplicateFrame {
        /// Camera.
        camera: CameraId,
        /// Frame number.
        frame: u64,
        /// One image.
        first: PathBuf,
        /// The other.
        second: PathBuf,
    },
    /// An image of another size than the rig says.
    #[error(
        "camera {camera}: {}: is {}x{} pixels, the rig says {}x{}",
        file.display(), got.width_px, got.height_px, expected.width_px, expected.height_px
    )]
    FrameSize {
        /// Camera.
        camera: CameraId,
        /// Image or video.
        file: PathBuf,
        /// Its size.
        got: super::FrameGeometry,
        /// The rig's.
        expected: super::FrameGeometry,
    },
    /// An image or video cannot be read.
    #[error("camera {camera}: {source}")]
    Image {
        /// Camera.
        camera: CameraId,
        /// Which file, and why.
        source: ImageError,
    },
}
