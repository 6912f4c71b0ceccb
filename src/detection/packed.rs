//! Frames of ten and twelve bits: unpacked band by band in the pass that scans them, while the band is in the cache.

use std::sync::Arc;

use super::detector::{Answers, Detector};
use super::error::DetectionError;
use super::kernel::TILE_HEIGHT_PX;
use super::packing::Packing;
use crate::scene::{Frame, FrameStamp};

/// A frame as a camera packs it, rows from the top, no padding.
#[derive(Debug, Clone, Copy)]
pub struct PackedFrame<'a> {
    /// Which frame, and when.
    pub stamp: FrameStamp,
    /// Columns.
    pub width_px: u32,
    /// Rows.
    pub height_px: u32,
    /// How its pixels are packed.
    pub packing: Packing,
    /// Its bytes.
    pub bytes: &'a [u8],
}

/// Memory of the frames that the detector has unpacked: used again once nobody compares with them any more.
#[derive(Default)]
pub struct UnpackedFrames {
    all: Vec<Arc<Vec<u8>>>,
}

impl UnpackedFrames {
    /// Memory that nobody reads.
    fn spare(&mut self, bytes: usize) -> Arc<Vec<u8>> {
        let free = self
            .all
            .iter()
            .position(|pixels| Arc::strong_count(pixels) == 1 && pixels.len() == bytes);
        match free {
            Some(index) => self.all.swap_remove(index),
            None => Arc::new(vec![0; bytes]),
        }
    }
}

impl Detector {
    /// [`Detector::detect`] of a packed frame by its upper eight bits.
    ///
    /// # Errors
    /// A frame of another size.
    pub fn detect_packed(
        &mut self,
        frame: &PackedFrame<'_>,
        answers: &mut dyn Answers,
    ) -> Result<(), DetectionError> {
        let pixels = self.width_px * self.height_px;
        let fits = frame.width_px as usize == self.width_px && frame.height_px as usize == self.height_px;
        if !fits || pixels == 0 || frame.bytes.len() < frame.packing.bytes(pixels) {
            let size_px = (frame.width_px, frame.height_px);
            return Err(self.wrong_size(frame.stamp, size_px, frame.bytes.len()));
        }
        self.begin(frame.stamp, answers);
        let mut changed = self.history.spare_map(self.width_px, self.height_px);
        let previous = self.history.newest().map(|seen| seen.frame.clone());
        let mut levels = self.unpacked.spare(pixels);
        if let Some(levels) = Arc::get_mut(&mut levels) {
            let band_pixels = self.width_px * TILE_HEIGHT_PX;
            // Eight rows of any width end with a byte.
            let packed = frame.bytes.chunks(frame.packing.bytes(band_pixels));
            for (band, (packed, levels)) in packed.zip(levels.chunks_mut(band_pixels)).enumerate() {
                self.kernels.unpack(frame.packing, packed, levels);
                let begin = band * band_pixels;
                let before = previous.as_ref().map(|frame| frame.bytes());
                if let Some(before) = before.and_then(|all| all.get(begin..begin + levels.len())) {
                    self.scan_band(band, (levels, before), &mut changed);
                }
            }
        }
        self.unpacked.all.push(levels.clone());
        let unpacked = Frame {
            stamp: frame.stamp,
            width_px: frame.width_px,
            height_px: frame.height_px,
            pixels: levels,
        };
        self.take(unpacked, previous.is_some().then_some(changed), answers);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detection::DetectorConfig;
    use crate::detection::packing::tests::{ALL, pack};
    use crate::detection::painter::{Ball, Canvas};
    use crate::scene::Detection;

    #[derive(Default)]
    struct All(Vec<Detection>);

    impl Answers for All {
        fn answer(&mut self, _stamp: FrameStamp, detections: &[Detection]) {
            self.0.extend(detections);
        }
    }

    #[test]
    fn packed_frames_give_the_candidates_of_unpacked_ones() {
        let stand = Canvas::stand(300, 97, 3, 20.0);
        let frames: Vec<Frame> = (0..24u64)
            .map(|i| {
                let mut canvas = stand.clone();
                canvas.ball(&Ball {
                    centre: [20.0 + 11.0 * i as f64, 40.0 + 0.3 * i as f64],
                    streak: [2.0, 0.1],
                    radius: 3.1,
                    light: 215.0,
                    shade: 90.0,
                    to_light: [0.2, -1.0, -0.3],
                });
                canvas.frame(i, 175.0, 1.2)
            })
            .collect();
        let detector = || Detector::new(DetectorConfig::default(), 300, 97);
        let (mut whole, mut plain) = (All::default(), detector());
        for frame in &frames {
            plain.detect(frame, &mut whole).unwrap();
        }
        plain.flush(&mut whole);
        assert!(whole.0.len() >= 24, "{} candidates", whole.0.len());
        for (packing, bits) in ALL {
            let (mut found, mut detector) = (All::default(), detector());
            for frame in &frames {
                // The lower bits are anything.
                let values = frame.bytes().iter().enumerate();
                let values: Vec<u16> = values
                    .map(|(i, v)| (u16::from(*v) << (bits - 8)) | ((i % 16) as u16 & ((1 << (bits - 8)) - 1)))
                    .collect();
                let packed = PackedFrame {
                    stamp: frame.stamp,
                    width_px: 300,
                    height_px: 97,
                    packing,
                    bytes: &pack(packing, &values),
                };
                detector.detect_packed(&packed, &mut found).unwrap();
            }
            detector.flush(&mut found);
            assert_eq!(found.0, whole.0, "{packing:?}");
            assert!(detector.unpacked.all.len() <= 30, "memory is used again");
        }
        let short = PackedFrame {
            stamp: frames[0].stamp,
            width_px: 300,
            height_px: 97,
            packing: Packing::Mono12p,
            bytes: &[0; 100],
        };
        assert!(detector().detect_packed(&short, &mut All::default()).is_err());
    }
}
