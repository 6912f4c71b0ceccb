//! What can go wrong between a frame and its detections.

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
