//! What can go wrong between a frame and its detections.

use crate::scene::{Frame, FrameStamp, RawFrame};

/// A frame the detector cannot take.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DetectionError {
    /// The frame is not of the size the detector was made for, or its bytes do not fill it.
    #[error(
        "frame {frame}: {width_px}x{height_px} in {bytes} bytes, expected {expected_width_px}x{expected_height_px}"
    )]
    FrameSize {
        /// Frame number.
        frame: u64,
        /// Columns it says it has.
        width_px: u32,
        /// Rows it says it has.
        height_px: u32,
        /// Bytes it holds.
        bytes: usize,
        /// Columns expected.
        expected_width_px: u32,
        /// Rows expected.
        expected_height_px: u32,
    },
}

/// Columns and rows that a frame has to have, and bytes that fill them.
pub(super) fn check_size(frame: &Frame, expected: (usize, usize)) -> Result<(), DetectionError> {
    let bytes = frame.bytes().len();
    let size_px = (frame.width_px, frame.height_px);
    let fits =
        (size_px.0 as usize, size_px.1 as usize) == expected && bytes == expected.0 * expected.1 && bytes > 0;
    if fits {
        return Ok(());
    }
    Err(wrong_size(frame.stamp, size_px, bytes, expected))
}

/// Of a frame as its camera sent it.
pub(super) fn wrong_size_of_raw(raw: &RawFrame, expected: (usize, usize)) -> DetectionError {
    wrong_size(
        raw.stamp,
        (raw.width_px, raw.height_px),
        raw.bytes().len(),
        expected,
    )
}

fn wrong_size(
    stamp: FrameStamp,
    (width_px, height_px): (u32, u32),
    bytes: usize,
    (expected_width, expected_height): (usize, usize),
) -> DetectionError {
    DetectionError::FrameSize {
        frame: stamp.frame,
        width_px,
        height_px,
        bytes,
        expected_width_px: expected_width as u32,
        expected_height_px: expected_height as u32,
    }
}
