//! The one pass over two frames that every detector begins with: tiles that changed, and the noise of every region.

use super::config::DetectorConfig;
use super::dispatch::{Isa, Kernels};
use super::kernel::TILE_WIDTH_PX;
use super::regions::{REGION_TILES, RegionNoise};
use super::tiles::TileMap;

/// One row of every so many bands tells the noise, others in every frame.
const LEARN_EVERY_BANDS: usize = 16;

/// What the pass knows from frame to frame.
pub struct Scan {
    width_px: usize,
    kernels: Kernels,
    /// Noise and thresholds.
    pub noise: RegionNoise,
    /// All zero between two bands.
    column_changes: Vec<u8>,
    tile_hits: Vec<bool>,
}

impl Scan {
    /// For frames of so many columns and rows.
    pub fn new(config: &DetectorConfig, (width_px, height_px): (usize, usize), isa: Isa) -> Self {
        Self {
            width_px,
            kernels: Kernels::new(isa),
            noise: RegionNoise::new(config, width_px, height_px),
            column_changes: vec![0; width_px],
            tile_hits: vec![false; width_px.div_ceil(TILE_WIDTH_PX)],
        }
    }

    /// A band of a frame and of the one before, read once; `turn` is another for every frame. Tiles that changed are set.
    pub fn band(&mut self, band: usize, turn: u64, (current, before): (&[u8], &[u8]), changed: &mut TileMap) {
        let limits = self.noise.band_limits(band);
        let (most, hits) = (&mut self.column_changes, &mut self.tile_hits);
        if self
            .kernels
            .changed_tiles((current, before), self.width_px, limits, most, hits)
        {
            let tiles = self.tile_hits.iter().enumerate();
            for (column, _) in tiles.filter(|(_, hit)| **hit) {
                changed.set(band, column);
            }
        }
        if !(band + turn as usize).is_multiple_of(LEARN_EVERY_BANDS) {
            return;
        }
        let region_width = TILE_WIDTH_PX * REGION_TILES;
        let mut rows = current.chunks(self.width_px).zip(before.chunks(self.width_px));
        if let Some((c, p)) = rows.next_back() {
            for (region, (c, p)) in c.chunks(region_width).zip(p.chunks(region_width)).enumerate() {
                let sum = self
                    .kernels
                    .clipped_change_sum(c, p, self.noise.clip(band, region));
                self.noise.learn(band, region, sum as f32 / c.len() as f32);
            }
        }
    }
}
