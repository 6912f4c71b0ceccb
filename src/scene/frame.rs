//! Frames: images with their times.

use std::ops::Deref;
use std::sync::Arc;

use super::PixelFormat;
use crate::time::{ArrivalTime, DeviceTime, StampedMidpoint};

/// When and which: everything about a frame but its pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FrameStamp {
    /// Frame number: rises by one per exposure, gaps are lost frames.
    pub frame: u64,
    /// The camera's own time, where it has one.
    pub device: Option<DeviceTime>,
    /// When the host had the frame, where it was live.
    pub arrival: Option<ArrivalTime>,
    /// Middle of the exposure by the stamps.
    pub stamped: StampedMidpoint,
}

/// One Mono8 image, rows from the top, no padding. Cloning shares the pixels.
#[derive(Clone)]
pub struct Frame {
    /// Which frame, and when.
    pub stamp: FrameStamp,
    /// Columns.
    pub width_px: u32,
    /// Rows.
    pub height_px: u32,
    /// `width·height` bytes; the owner may be a pool that takes the memory back on drop.
    pub pixels: Arc<dyn Deref<Target = [u8]> + Send + Sync>,
}

impl Frame {
    /// The pixels, row by row.
    pub fn bytes(&self) -> &[u8] {
        &self.pixels
    }
}

impl std::fmt::Debug for Frame {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Frame")
            .field("stamp", &self.stamp)
            .field("width_px", &self.width_px)
            .field("height_px", &self.height_px)
            .finish_non_exhaustive()
    }
}

/// One image as its camera sent it. Cloning shares the bytes.
#[derive(Clone)]
pub struct RawFrame {
    /// Which frame, and when.
    pub stamp: FrameStamp,
    /// Columns.
    pub width_px: u32,
    /// Rows.
    pub height_px: u32,
    /// How its pixels are packed.
    pub format: PixelFormat,
    /// `format.bytes(width·height)` bytes; the owner may be a pool that takes the memory back on drop.
    pub pixels: Arc<dyn Deref<Target = [u8]> + Send + Sync>,
}

impl RawFrame {
    /// The bytes, as they came.
    pub fn bytes(&self) -> &[u8] {
        &self.pixels
    }

    /// The same memory as an image, where it is one already.
    pub fn mono8(&self) -> Option<Frame> {
        (self.format == PixelFormat::Mono8).then(|| Frame {
            stamp: self.stamp,
            width_px: self.width_px,
            height_px: self.height_px,
            pixels: self.pixels.clone(),
        })
    }
}

impl From<Frame> for RawFrame {
    fn from(frame: Frame) -> Self {
        Self {
            stamp: frame.stamp,
            width_px: frame.width_px,
            height_px: frame.height_px,
            format: PixelFormat::Mono8,
            pixels: frame.pixels,
        }
    }
}

impl std::fmt::Debug for RawFrame {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("RawFrame")
            .field("stamp", &self.stamp)
            .field("width_px", &self.width_px)
            .field("height_px", &self.height_px)
            .field("format", &self.format)
            .finish_non_exhaustive()
    }
}
