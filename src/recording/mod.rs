//! The on-disk session: writer, reader, repair; and track files.
//!
//! ```text
//! SESSION/
//!   first.0000.mcap        frames of camera `first`, first ten seconds of stamps (or 4 GiB)
//!   first.0001.mcap        the next
//!   third.0000.mcap.part   still being written, or its writer was killed
//!   session.mcap           rig, calibration and the list of the files above
//! ```
//!
//! Every file is a plain MCAP file without chunk compression and stands alone: rig and calibration are
//! attached to each. A camera's file has two channels:
//!
//! | topic | schema | what |
//! |---|---|---|
//! | `/<camera>/frame_info` | `pitchd.FrameInfo` (protobuf, in the file) | numbers, times, exposure, flags, checksums |
//! | `/<camera>/image` | `foxglove.RawImage` (mono8) or `foxglove.CompressedImage` (PNG) | the pixels |
//!
//! The info of a frame goes right before its image, with the same `sequence`; `log_time` is the stamped
//! midpoint. Why an own message beside the image: Foxglove's images have one time and no number, and a
//! frame must carry four times, its number and checksums without breaking the viewers.
//!
//! **Damage.** The info carries a CRC of itself and one of the pixels, so that a frame is either exactly the
//! frame that was written or it is not given at all. The reader walks the file record by record, entering
//! chunks (they are not compressed) instead of trusting their length, and after a broken record searches for
//! the next place where a frame begins. What is lost is counted in [`Damage`].

mod cursor;
mod damage;
mod disk;
mod error;
mod frame_file;
mod frame_info;
mod layout;
mod payload;
mod reader;
mod repair;
mod resync;
mod scan;
mod segment;
mod session_file;
mod summary;
mod track_files;
mod viewer_file;
mod writer;

pub use damage::{Damage, LostFrames};
pub use error::RecordingError;
pub use frame_info::{FrameFlags, RecordedFrame};
pub use layout::PixelEncoding;
pub use payload::encode_png;
pub use reader::{CameraFrames, CameraRecording, Holes, SessionReader, Verified};
pub use repair::{Repaired, repair_session};
pub use track_files::{TrackFileError, append_track, read_track_file, read_track_folder, write_track_folder};
pub use viewer_file::{ViewerInput, write_viewer_file};
pub use writer::{CameraGeometry, CameraWriter, DiskPath, SessionOptions, SessionWriter, remove_session};
