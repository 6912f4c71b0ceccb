//! Frames of ten and twelve bits: unpacked band by band in the pass that scans them, while the band is in the cache.

use std::sync::Arc;

use super::detector::{Answers, Detector};
use super::dispatch::{Isa, Kernels};
use super::error::{DetectionError, wrong_size_of_raw};
use super::kernel::TILE_HEIGHT_PX;
use crate::scene::{Frame, FrameStamp, RawFrame};

/// Memory of frames that have been unpacked: used again once nobody reads them any more.
#[derive(Default)]
pub struct UnpackedFrames {
    all: Vec<Arc<Vec<u8>>>,
}

impl UnpackedFrames {
    /// Memory that nobody reads.
    pub(super) fn spare(&mut self, bytes: usize) -> Arc<Vec<u8>> {
        let free = self
            .all
            .iter()
            .position(|pixels| Arc::strong_count(pixels) == 1 && pixels.len() == bytes);
        match free {
            Some(index) => self.all.swap_remove(index),
            None => Arc::new(vec![0; bytes]),
        }
    }

    /// A frame with memory got here.
    pub(super) fn frame_of(
        &mut self,
        stamp: FrameStamp,
        (width_px, height_px): (usize, usize),
        levels: Arc<Vec<u8>>,
    ) -> Frame {
        self.all.push(levels.clone());
        Frame {
            stamp,
            width_px: width_px as u32,
            height_px: height_px as u32,
            pixels: levels,
        }
    }

    fn frame(&mut self, raw: &RawFrame, levels: Arc<Vec<u8>>) -> Frame {
        self.frame_of(raw.stamp, (raw.width_px as usize, raw.height_px as usize), levels)
    }

    /// The image that the detector sees: a Mono8 frame as it is, of any other the upper eight bits. `None`: its bytes do
    /// not fill it.
    pub fn image(&mut self, raw: &RawFrame) -> Option<Frame> {
        let pixels = raw.width_px as usize * raw.height_px as usize;
        if raw.bytes().len() < raw.format.bytes(pixels) {
            return None;
        }
        if let Some(frame) = raw.mono8() {
            return Some(frame);
        }
        let mut levels = self.spare(pixels);
        Kernels::new(Isa::to_unpack()).unpack(raw.format, raw.bytes(), Arc::get_mut(&mut levels)?);
        Some(self.frame(raw, levels))
    }
}

impl Detector {
    /// [`Detector::detect`] of a frame as its camera sent it: of a packed one by its upper eight bits.
    ///
    /// # Errors
    /// A frame of another size.
    pub fn detect_raw(&mut self, raw: &RawFrame, answers: &mut dyn Answers) -> Result<(), DetectionError> {
        if let Some(frame) = raw.mono8() {
            return self.detect(&frame, answers);
        }
        let pixels = self.width_px * self.height_px;
        let fits = raw.width_px as usize == self.width_px && raw.height_px as usize == self.height_px;
        if !fits || pixels == 0 || raw.bytes().len() < raw.format.bytes(pixels) {
            return Err(wrong_size_of_raw(raw, (self.width_px, self.height_px)));
        }
        self.begin(raw.stamp, answers);
        if self.evens() {
            let frame = self
                .unpacked
                .image(raw)
                .ok_or_else(|| wrong_size_of_raw(raw, (self.width_px, self.height_px)))?;
            self.take_evened(frame, answers);
            return Ok(());
        }
        let mut changed = self.history.spare_map(self.width_px, self.height_px);
        let previous = self.history.newest().map(|seen| seen.searched().clone());
        let mut levels = self.unpacked.spare(pixels);
        let unpacking = Kernels::new(Isa::to_unpack());
        if let Some(levels) = Arc::get_mut(&mut levels) {
            let band_pixels = self.width_px * TILE_HEIGHT_PX;
            // Eight rows of any width end with a byte.
            let packed = raw.bytes().chunks(raw.format.bytes(band_pixels));
            for (band, (packed, levels)) in packed.zip(levels.chunks_mut(band_pixels)).enumerate() {
                unpacking.unpack(raw.format, packed, levels);
                let begin = band * band_pixels;
                let before = previous.as_ref().map(|frame| frame.bytes());
                if let Some(before) = before.and_then(|all| all.get(begin..begin + levels.len())) {
                    self.scan_band(band, (levels, before), &mut changed);
                }
            }
        }
        let unpacked = self.unpacked.frame(raw, levels);
        self.take((unpacked, None), previous.is_some().then_some(changed), answers);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detection::DetectorConfig;
    use crate::detection::packing::tests::{ALL, pack};
    use crate::detection::painter::{Ball, Canvas};
    use crate::scene::{Detection, PixelFormat};

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
        for (format, bits) in ALL {
            let (mut found, mut detector, mut whole_images) =
                (All::default(), detector(), UnpackedFrames::default());
            for frame in &frames {
                // The lower bits are anything.
                let values = frame.bytes().iter().enumerate();
                let values: Vec<u16> = values
                    .map(|(i, v)| (u16::from(*v) << (bits - 8)) | ((i % 16) as u16 & ((1 << (bits - 8)) - 1)))
                    .collect();
                let raw = RawFrame {
                    format,
                    pixels: Arc::new(pack(format, &values)),
                    ..RawFrame::from(frame.clone())
                };
                assert_eq!(whole_images.image(&raw).unwrap().bytes(), frame.bytes());
                detector.detect_raw(&raw, &mut found).unwrap();
            }
            detector.flush(&mut found);
            assert_eq!(found.0, whole.0, "{format}");
            assert!(detector.unpacked.all.len() <= 30, "memory is used again");
            assert_eq!(whole_images.all.len(), 1, "memory is used again");
        }
        let short = RawFrame {
            format: PixelFormat::Mono12p,
            pixels: Arc::new(vec![0; 100]),
            ..RawFrame::from(frames[0].clone())
        };
        assert!(detector().detect_raw(&short, &mut All::default()).is_err());
        assert!(UnpackedFrames::default().image(&short).is_none());
    }
}
