//! A still picture of a part of the field: what a camera sees there most of the time.
//!
//! Frames from all over a session are kept there, and the middle one of each pixel's levels counts: people walk through, lamps
//! flicker and a ball flies by, and nothing is left of them.

use crate::scene::{Frame, PixelRect};

/// Frames that are kept; of more, every second one goes, and in the end the oldest.
const KEPT_MAX: usize = 32;
/// Fewest frames of a still.
const KEPT_MIN: usize = 5;
/// At first one frame of so many is kept, in the end one of these: a camera that was moved is seen where it is now after some
/// minutes.
const STRIDE: u64 = 8;
const STRIDE_MAX: u64 = 2048;

/// A part of a picture, levels row by row.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// Where it is in the whole picture.
    pub place: PixelRect,
    /// `width·height` levels.
    pub levels: Vec<f32>,
}

impl Picture {
    /// The level at a column and a row of the whole picture.
    pub fn at(&self, x: u32, y: u32) -> Option<f32> {
        let (column, row) = (x.checked_sub(self.place.x_px)?, y.checked_sub(self.place.y_px)?);
        let inside = column < self.place.width_px && row < self.place.height_px;
        let index = row as usize * self.place.width_px as usize + column as usize;
        inside.then(|| self.levels.get(index).copied()).flatten()
    }
}

/// Gathers a still of one part of a camera's frames.
#[derive(Debug, Clone)]
pub struct Still {
    place: PixelRect,
    stride: u64,
    seen: u64,
    kept: Vec<Vec<u8>>,
}

impl Still {
    /// Of this part; what of it is beyond the frames is left out.
    pub fn new(place: PixelRect) -> Self {
        Self {
            place,
            stride: STRIDE,
            seen: 0,
            kept: Vec::with_capacity(KEPT_MAX),
        }
    }

    /// Whether the next frame is one to take; each frame is asked about once.
    pub fn is_due(&mut self) -> bool {
        let due = self.seen.is_multiple_of(self.stride);
        self.seen += 1;
        due
    }

    /// Begins anew: the camera may stand otherwise.
    pub fn clear(&mut self) {
        (self.seen, self.stride) = (0, STRIDE);
        self.kept.clear();
    }

    /// Takes a frame that is due; whether there are as many as ever are.
    pub fn take(&mut self, frame: &Frame) -> bool {
        if self.kept.is_empty() {
            self.place.width_px = self
                .place
                .width_px
                .min(frame.width_px.saturating_sub(self.place.x_px));
            self.place.height_px = self
                .place
                .height_px
                .min(frame.height_px.saturating_sub(self.place.y_px));
        }
        if self.kept.len() >= KEPT_MAX && self.stride >= STRIDE_MAX {
            self.kept.remove(0);
        } else if self.kept.len() >= KEPT_MAX {
            let mut keep = false;
            self.kept.retain(|_| {
                keep = !keep;
                keep
            });
            self.stride *= 2;
            // The last one kept is one stride back, and the next one due is this only every second time.
            if !self.seen.saturating_sub(1).is_multiple_of(self.stride) {
                return false;
            }
        }
        let (left, width) = (self.place.x_px as usize, self.place.width_px as usize);
        let rows = frame.bytes().chunks(frame.width_px.max(1) as usize);
        let rows = rows
            .skip(self.place.y_px as usize)
            .take(self.place.height_px as usize);
        let part: Vec<u8> = rows
            .flat_map(|row| row.get(left..left + width).unwrap_or_default())
            .copied()
            .collect();
        if part.len() == width * self.place.height_px as usize && !part.is_empty() {
            self.kept.push(part);
        }
        self.kept.len() == KEPT_MAX
    }

    /// The still, if enough frames were seen.
    pub fn picture(&self) -> Option<Picture> {
        if self.kept.len() < KEPT_MIN {
            return None;
        }
        let pixels = self.place.width_px as usize * self.place.height_px as usize;
        let mut levels = Vec::with_capacity(pixels);
        let mut of_pixel = Vec::with_capacity(self.kept.len());
        for pixel in 0..pixels {
            of_pixel.clear();
            of_pixel.extend(self.kept.iter().filter_map(|part| part.get(pixel)).copied());
            of_pixel.sort_unstable();
            // The mean of the middle third: the levels of a steady pixel are whole numbers about it.
            let third = of_pixel.len() / 3;
            let middle = of_pixel.get(third..of_pixel.len() - third).unwrap_or_default();
            let sum: f32 = middle.iter().map(|level| f32::from(*level)).sum();
            levels.push(sum / middle.len().max(1) as f32);
        }
        Some(Picture {
            place: self.place,
            levels,
        })
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::scene::FrameStamp;
    use crate::time::StampedMidpoint;

    fn frame(number: u64, level: impl Fn(u32, u32) -> u8) -> Frame {
        let pixels: Vec<u8> = (0..6)
            .flat_map(|y| (0..8).map(move |x| (x, y)))
            .map(|(x, y)| level(x, y))
            .collect();
        Frame {
            stamp: FrameStamp {
                frame: number,
                device: None,
                arrival: None,
                stamped: StampedMidpoint::from_nanos(1_000_000 * number as i64),
            },
            width_px: 8,
            height_px: 6,
            pixels: Arc::new(pixels),
        }
    }

    #[test]
    fn who_walks_through_is_not_in_the_still() {
        // Columns 5 to 8 of which one is beyond the frames, rows 2 to 4.
        let mut still = Still::new(PixelRect {
            x_px: 5,
            y_px: 2,
            width_px: 4,
            height_px: 3,
        });
        assert_eq!(still.picture(), None);
        for number in 0..2000 {
            // Somebody stands there for a quarter of the time.
            if !still.is_due() {
                continue;
            }
            let hidden = (600..1100).contains(&number);
            still.take(&frame(
                number,
                |x, y| if hidden { 250 } else { (10 * x + y) as u8 },
            ));
        }
        assert!(still.kept.len() > KEPT_MAX / 2 && still.kept.len() <= KEPT_MAX);
        let picture = still.picture().unwrap();
        assert_eq!((picture.place.width_px, picture.place.height_px), (3, 3));
        assert_eq!(picture.at(5, 2), Some(52.0));
        assert_eq!(picture.at(7, 4), Some(74.0));
        assert_eq!(
            (picture.at(8, 4), picture.at(4, 3), picture.at(6, 5)),
            (None, None, None)
        );
    }
}
