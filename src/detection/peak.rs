//! The paper's detector (`kim2019`): the peak of the difference image is the ball's centre.
//!
//! The paper's [Kim19 §IV; Kim and Kim 2018]: the difference of two consecutive frames, its peak taken for the centre, no
//! shape of a ball, one ball a frame. What it leaves open is ours: the difference is signed (a white ball brightens where it
//! comes; by its size alone it is as large where the ball was a frame ago), a peak below the noise threshold of its region is
//! none, of equal peaks the first by row and column counts, the radius is the paper's "about 3 pixels". Centres are whole
//! pixels and nothing refines them later.
//!
//! Known and not modelled, because that is the method: the peak lies on the lit side of the ball, the same way in every camera;
//! anywhere along a blurred ball; at its front where it overlaps itself from frame to frame; and on whatever else brightens
//! more than the ball does.

use nalgebra::Matrix2;

use super::config::{DetectorConfig, is_searched};
use super::detector::{Answers, DetectorCounters};
use super::dispatch::Isa;
use super::error::{DetectionError, check_size, wrong_size_of_raw};
use super::kernel::{TILE_HEIGHT_PX, TILE_WIDTH_PX};
use super::packed::UnpackedFrames;
use super::scan::Scan;
use super::tiles::TileMap;
use crate::geometry::Pixel;
use crate::scene::{Detection, Frame, FrameStamp, PixelRect, RawFrame};

/// Radius of a ball, of which a peak says nothing, pixels.
const RADIUS_PX: f64 = 3.0;
/// Variance of a place that is only known to a pixel, px².
const PIXEL_VARIANCE_PX2: f64 = 1.0 / 12.0;

/// One camera's detector of peaks.
pub struct PeakDetector {
    size_px: (usize, usize),
    regions: Vec<PixelRect>,
    masks: Vec<PixelRect>,
    radius_px: f64,
    break_s: f64,
    scan: Scan,
    changed: TileMap,
    previous: Option<Frame>,
    unpacked: UnpackedFrames,
    counters: DetectorCounters,
}

/// The largest rise so far and its pixel.
#[derive(Debug, Clone, Copy)]
struct Peak {
    rise: u8,
    x: usize,
    y: usize,
    difference_sigma: f32,
}

impl PeakDetector {
    /// A detector for frames of this size; of the settings it takes thresholds, regions, masks, radii and the break.
    pub fn new(config: &DetectorConfig, width_px: u32, height_px: u32) -> Self {
        Self::with_isa(config, width_px, height_px, Isa::detect())
    }

    /// The same on a chosen instruction set; answers do not depend on it.
    pub fn with_isa(config: &DetectorConfig, width_px: u32, height_px: u32, isa: Isa) -> Self {
        let size_px = (width_px as usize, height_px as usize);
        let [smallest, largest] = config.radius_px;
        Self {
            size_px,
            regions: config.regions.clone(),
            masks: config.masks.clone(),
            radius_px: RADIUS_PX.max(smallest).min(largest),
            break_s: config.break_s,
            scan: Scan::new(config, size_px, isa),
            changed: TileMap::new(size_px.0, size_px.1),
            previous: None,
            unpacked: UnpackedFrames::default(),
            counters: DetectorCounters::default(),
        }
    }

    /// What was seen and left out so far.
    pub fn counters(&self) -> DetectorCounters {
        self.counters
    }

    /// Takes the next frame; `answers` is told its one detection, or that it has none. Of the first frame of a window there is
    /// nothing to tell.
    ///
    /// # Errors
    /// A frame of another size.
    pub fn detect(&mut self, frame: &Frame, answers: &mut dyn Answers) -> Result<(), DetectionError> {
        check_size(frame, self.size_px)?;
        let stamped = frame.stamp.stamped;
        self.previous = self.previous.take().filter(|previous| {
            let step = stamped.seconds_since(previous.stamp.stamped.nanos());
            step > 0.0 && step <= self.break_s
        });
        self.counters.frames += 1;
        match self.previous.replace(frame.clone()) {
            Some(previous) => {
                let found = self.peak(frame.bytes(), previous.bytes());
                let found = found.map(|peak| self.detection(frame.stamp, &peak));
                answers.answer(frame.stamp, found.as_slice());
            }
            None => {
                self.counters.windows += 1;
                self.counters.unanswered += 1;
            }
        }
        Ok(())
    }

    /// [`Self::detect`] of a frame as its camera sent it: of a packed one by its upper eight bits.
    ///
    /// # Errors
    /// A frame of another size.
    pub fn detect_raw(&mut self, raw: &RawFrame, answers: &mut dyn Answers) -> Result<(), DetectionError> {
        match self.unpacked.image(raw) {
            Some(frame) => self.detect(&frame, answers),
            None => Err(wrong_size_of_raw(raw, self.size_px)),
        }
    }

    /// Ends the window: the next frame is compared with none before.
    pub fn flush(&mut self) {
        self.previous = None;
    }

    /// The largest rise from the frame before.
    fn peak(&mut self, current: &[u8], before: &[u8]) -> Option<Peak> {
        let (width, _) = self.size_px;
        let band_bytes = width * TILE_HEIGHT_PX;
        self.changed.clear();
        let mut best = None;
        let bands = current.chunks(band_bytes).zip(before.chunks(band_bytes));
        for (band, pixels) in bands.enumerate() {
            self.scan
                .bands(band, self.counters.frames, pixels, &mut self.changed);
            for column in self.changed.columns(band) {
                self.look_into(pixels, (band, column), &mut best);
            }
        }
        best
    }

    /// Takes the pixel of a tile that rises most, if it rises more than the best and than the noise.
    fn look_into(
        &self,
        (current, before): (&[u8], &[u8]),
        (band, column): (usize, usize),
        best: &mut Option<Peak>,
    ) {
        let (width, _) = self.size_px;
        let threshold = self.scan.noise.tile_threshold(band, column);
        let columns = column * TILE_WIDTH_PX..((column + 1) * TILE_WIDTH_PX).min(width);
        for (row, (c, p)) in current.chunks(width).zip(before.chunks(width)).enumerate() {
            let (Some(c), Some(p)) = (c.get(columns.clone()), p.get(columns.clone())) else {
                continue;
            };
            let y = band * TILE_HEIGHT_PX + row;
            for (x, (c, p)) in columns.clone().zip(c.iter().zip(p)) {
                let rise = c.saturating_sub(*p);
                let more = |best: &Peak| (rise, best.y) > (best.rise, y);
                if rise > threshold && best.as_ref().is_none_or(more) && self.is_searched(x, y) {
                    *best = Some(Peak {
                        rise,
                        x,
                        y,
                        difference_sigma: self.scan.noise.difference_sigma(band, column),
                    });
                }
            }
        }
    }

    fn is_searched(&self, x: usize, y: usize) -> bool {
        is_searched(&self.regions, &self.masks, (x as f64, y as f64))
    }

    fn detection(&self, stamp: FrameStamp, peak: &Peak) -> Detection {
        // Without a shape the peak may be anywhere on the ball: a disc's variance about its centre.
        let variance = PIXEL_VARIANCE_PX2 + 0.25 * self.radius_px * self.radius_px;
        Detection {
            frame: stamp.frame,
            stamped: stamp.stamped,
            centre: Pixel::new(peak.x as f64, peak.y as f64),
            covariance_px2: Matrix2::identity() * variance,
            radius_px: self.radius_px,
            streak_px: [0.0; 2],
            strength: f64::from(peak.rise) / f64::from(peak.difference_sigma.max(0.5)),
        }
    }
}

#[cfg(test)]
#[path = "peak_tests.rs"]
mod tests;
