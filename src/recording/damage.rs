//! What of a session is lost, in numbers and words.

use std::fmt;
use std::path::PathBuf;

use crate::scene::CameraId;

/// How many frames are gone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LostFrames {
    /// Counted from the file's own numbers.
    Exactly(u64),
    /// The end of the file is gone, and nothing says how much there was.
    AtLeast(u64),
}

impl LostFrames {
    /// The number.
    pub fn count(self) -> u64 {
        match self {
            Self::Exactly(n) | Self::AtLeast(n) => n,
        }
    }
}

/// What is wrong with one file of a session. A damaged file is still read as far as it can be.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Damage {
    /// File.
    pub file: PathBuf,
    /// Whose frames; `None` for the session file.
    pub camera: Option<CameraId>,
    /// Frames read that are whole.
    pub frames_read: u64,
    /// Frames that are not.
    pub frames_lost: LostFrames,
    /// Bytes that belong to no whole record.
    pub bytes_lost: u64,
    /// What was found, first places first.
    pub reason: String,
}

impl fmt::Display for Damage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = self.file.file_name().unwrap_or(self.file.as_os_str());
        write!(f, "{}: {}", name.display(), self.reason)?;
        if let Some(camera) = &self.camera {
            let (at_least, lost) = match self.frames_lost {
                LostFrames::Exactly(n) => ("", n),
                LostFrames::AtLeast(n) => ("at least ", n),
            };
            write!(
                f,
                " (camera {camera}: {} frames read, {at_least}{lost} lost",
                self.frames_read
            )?;
            if self.bytes_lost > 0 {
                write!(f, ", {} bytes unreadable", self.bytes_lost)?;
            }
            write!(f, ")")?;
        }
        Ok(())
    }
}
