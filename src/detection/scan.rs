//! The one pass over two frames that every detector begins with: tiles that changed, and the noise of every region.

use super::config::DetectorConfig;
use super::dispatch::{Isa, Kernels};
use super::kernel::{TILE_HEIGHT_PX, TILE_WIDTH_PX};
use super::light::Light;
use super::regions::{REGION_TILES, RegionNoise};
use super::tiles::TileMap;

/// One row of every so many bands tells the noise, others in every frame.
const LEARN_EVERY_BANDS: usize = 16;
/// Columns of a region.
const REGION_WIDTH_PX: usize = TILE_WIDTH_PX * REGION_TILES;

/// What the pass knows from frame to frame.
pub struct Scan {
    width_px: usize,
    kernels: Kernels,
    /// Noise and thresholds.
    pub noise: RegionNoise,
    /// Whether lamps flicker.
    pub light: Light,
    /// Of the regions of a row of tiles.
    sums: Vec<[u32; 3]>,
}

impl Scan {
    /// For frames of so many columns and rows.
    pub fn new(config: &DetectorConfig, (width_px, height_px): (usize, usize), isa: Isa) -> Self {
        Self {
            width_px,
            kernels: Kernels::new(isa),
            noise: RegionNoise::new(config, width_px, height_px),
            light: Light::new((width_px, height_px), config.lag_frames_max, Kernels::new(isa)),
            sums: vec![[0; 3]; width_px.div_ceil(REGION_WIDTH_PX)],
        }
    }

    /// Bands of a frame and of the one before, from `first` on, read once; `turn` is another for every frame. Tiles that
    /// changed are set.
    pub fn bands(
        &mut self,
        first: usize,
        turn: u64,
        (current, before): (&[u8], &[u8]),
        changed: &mut TileMap,
    ) {
        let band_px = (self.width_px * TILE_HEIGHT_PX).max(1);
        let (mut band, mut current, mut before) = (first, current, before);
        while !current.is_empty() && !before.is_empty() {
            // All up to the next band that tells the noise, whose last row is then in the cache.
            let place = (band + turn as usize) % LEARN_EVERY_BANDS;
            let bands = (LEARN_EVERY_BANDS - place) % LEARN_EVERY_BANDS + 1;
            let pixels = (bands * band_px).min(current.len()).min(before.len());
            let (limits, hits) = (self.noise.limits_from(band), changed.words_from(band));
            self.kernels
                .changed_tiles((current, before), (self.width_px, bands), limits, hits);
            let ((c, c_rest), (p, p_rest)) = (current.split_at(pixels), before.split_at(pixels));
            if pixels > (bands - 1) * band_px {
                self.learn(band + bands - 1, (c, p));
            }
            (band, current, before) = (band + bands, c_rest, p_rest);
        }
    }

    /// What the last row of some bands, the last of which is `band`, tells of the noise.
    fn learn(&mut self, band: usize, (current, before): (&[u8], &[u8])) {
        let mut rows = current.chunks(self.width_px).zip(before.chunks(self.width_px));
        let Some((c, p)) = rows.next_back() else { return };
        let clips = self.noise.clips(band);
        self.kernels
            .clipped_change_sums((c, p), REGION_WIDTH_PX, clips, &mut self.sums);
        for (region, ([change, rises, falls], pixels)) in
            self.sums.iter().zip(c.chunks(REGION_WIDTH_PX)).enumerate()
        {
            let mean = |sum: f32| sum / pixels.len() as f32;
            self.noise.learn(band, region, mean(*change as f32));
            self.light
                .learn(band, region, mean(*rises as f32 - *falls as f32));
        }
    }
}
