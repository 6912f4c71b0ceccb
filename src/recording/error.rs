//! What can go wrong with a session.

use std::path::{Path, PathBuf};

use crate::scene::CameraId;

/// Why a session cannot be written or opened. What is damaged inside an open session is no error but a
/// [`super::Damage`].
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The disk is full. What was written before stays readable.
    #[error("{}: the disk is full", file.display())]
    DiskFull {
        /// File being written.
        file: PathBuf,
    },
    /// The operating system refused.
    #[error("{}: {source}", file.display())]
    Io {
        /// File or folder.
        file: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A frame whose bytes do not fill it.
    #[error(
        "camera {camera}, frame {frame}: has {bytes} bytes of pixels, {}x{} need {bytes_needed}", size_px.0, size_px.1
    )]
    FrameBytes {
        /// Camera.
        camera: CameraId,
        /// Frame number.
        frame: u64,
        /// Columns and rows.
        size_px: (u32, u32),
        /// Bytes it has.
        bytes: usize,
        /// Bytes of that many pixels as they are sent.
        bytes_needed: usize,
    },
    /// A frame of another size than the camera's.
    #[error(
        "camera {camera}, frame {frame}: is {}x{} pixels, expected {}x{}", got_px.0, got_px.1, expected_px.0, expected_px.1
    )]
    FrameSize {
        /// Camera.
        camera: CameraId,
        /// Frame number.
        frame: u64,
        /// Columns and rows.
        got_px: (u32, u32),
        /// Columns and rows.
        expected_px: (u32, u32),
    },
    /// Frames must come in the order of their numbers and stamps.
    #[error(
        "camera {camera}, frame {frame} (stamp {stamped_ns} ns) does not come after frame {previous_frame} (stamp {previous_ns} ns)"
    )]
    NotRising {
        /// Camera.
        camera: CameraId,
        /// Frame number.
        frame: u64,
        /// Its stamp.
        stamped_ns: i64,
        /// The frame written before.
        previous_frame: u64,
        /// Its stamp.
        previous_ns: i64,
    },
    /// A camera was opened twice for writing.
    #[error("camera {camera} is already being recorded in this session")]
    CameraTwice {
        /// Camera.
        camera: CameraId,
    },
    /// The folder for a new session holds something.
    #[error("{}: exists and is not empty", folder.display())]
    NotEmpty {
        /// Folder.
        folder: PathBuf,
    },
    /// Not a session, or nothing of it is left.
    #[error("{}: {reason}", folder.display())]
    NotASession {
        /// Folder.
        folder: PathBuf,
        /// Why.
        reason: String,
    },
    /// Written by a newer pitchd.
    #[error("{}: session format {found}, this pitchd reads up to {known}", file.display())]
    Version {
        /// File.
        file: PathBuf,
        /// Version in the file.
        found: u32,
        /// Newest version known.
        known: u32,
    },
    /// The MCAP or PNG encoder refused.
    #[error("{}: {reason}", file.display())]
    Encoding {
        /// File being written.
        file: PathBuf,
        /// Why.
        reason: String,
    },
}

impl RecordingError {
    /// An I/O error with its file; a full disk gets its own variant.
    pub(crate) fn io(file: &Path, source: std::io::Error) -> Self {
        use std::io::ErrorKind::{QuotaExceeded, StorageFull};
        if matches!(source.kind(), StorageFull | QuotaExceeded) {
            return Self::DiskFull {
                file: file.to_owned(),
            };
        }
        Self::Io {
            file: file.to_owned(),
            source,
        }
    }

    /// An error of the MCAP writer with its file.
    pub(super) fn mcap(file: &Path, error: mcap::McapError) -> Self {
        match error {
            mcap::McapError::Io(source) => Self::io(file, source),
            other => Self::Encoding {
                file: file.to_owned(),
                reason: other.to_string(),
            },
        }
    }
}
