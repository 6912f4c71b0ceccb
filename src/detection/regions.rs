//! The noise of each region of the image, and the thresholds that follow from it.
//!
//! A region is [`REGION_TILES`] × [`REGION_BANDS`] tiles. Every frame a few rows give the mean of the clipped
//! |current − previous|; for Gaussian noise that mean is σ_d·√(2/π). Rises are followed at once, falls slowly.

use super::config::DetectorConfig;
use super::kernel::{Limits, SEGMENT_TILES, TILE_HEIGHT_PX, TILE_WIDTH_PX};
use crate::scene::PixelRect;

/// Tile columns of a region.
pub const REGION_TILES: usize = 4;
const _: () = assert!(SEGMENT_TILES.is_multiple_of(REGION_TILES));
/// Tile rows of a region.
pub const REGION_BANDS: usize = 8;
/// √(π/2): from mean |d| to σ_d of a Gaussian.
const SIGMA_OVER_MEAN: f32 = 1.253_314;
/// σ_d before anything was measured, levels.
const SIGMA_START: f32 = 3.0;

/// Noise and thresholds per region, and the tiles that may be looked at.
#[derive(Debug, Clone)]
pub struct RegionNoise {
    columns: usize,
    sigma: Vec<f32>,
    /// Clip per region.
    clip: Vec<u8>,
    /// Threshold per region, as last written to its tiles.
    levels: Vec<u8>,
    /// Per tile, 255 where it is not searched.
    threshold: Vec<u8>,
    /// The lowest threshold of every segment of a row of tiles.
    lowest: Vec<u8>,
    segments: usize,
    searched: Vec<bool>,
    bands: usize,
    tile_columns: usize,
    threshold_sigmas: f32,
    threshold_min: f32,
}

impl RegionNoise {
    /// For an image of this size.
    pub fn new(config: &DetectorConfig, width_px: usize, height_px: usize) -> Self {
        let tile_columns = width_px.div_ceil(TILE_WIDTH_PX);
        let bands = height_px.div_ceil(TILE_HEIGHT_PX);
        let columns = tile_columns.div_ceil(REGION_TILES);
        let count = columns * bands.div_ceil(REGION_BANDS);
        let mut noise = Self {
            columns,
            sigma: vec![SIGMA_START; count],
            clip: vec![0; count],
            levels: vec![0; count],
            threshold: vec![u8::MAX; tile_columns * bands],
            lowest: vec![u8::MAX; tile_columns.div_ceil(SEGMENT_TILES) * bands],
            segments: tile_columns.div_ceil(SEGMENT_TILES),
            bands,
            searched: (0..tile_columns * bands)
                .map(|tile| tile_searched(config, tile % tile_columns, tile / tile_columns))
                .collect(),
            tile_columns,
            threshold_sigmas: config.threshold_sigmas as f32,
            threshold_min: f32::from(config.threshold_levels_min),
        };
        for index in 0..count {
            noise.set_levels(index);
        }
        noise
    }

    /// Clip and threshold of a region as its noise says.
    #[inline]
    fn set_levels(&mut self, index: usize) {
        let Some(sigma) = self.sigma.get(index) else {
            return;
        };
        if let Some(clip) = self.clip.get_mut(index) {
            *clip = (4.0 * sigma + 4.0).min(255.0) as u8;
        }
        let levels = (self.threshold_sigmas * sigma + 1.0)
            .max(self.threshold_min)
            .min(254.0) as u8;
        if let Some(known) = self.levels.get_mut(index)
            && *known != levels
        {
            *known = levels;
            self.set_threshold(index, levels);
        }
    }

    fn set_threshold(&mut self, index: usize, levels: u8) {
        let (row, column) = (index / self.columns, index % self.columns);
        let first = column * REGION_TILES;
        let last = (first + REGION_TILES).min(self.tile_columns);
        for band in row * REGION_BANDS..((row + 1) * REGION_BANDS).min(self.bands) {
            let tiles = band * self.tile_columns + first..band * self.tile_columns + last;
            if let (Some(all), Some(searched)) =
                (self.threshold.get_mut(tiles.clone()), self.searched.get(tiles))
            {
                for (threshold, searched) in all.iter_mut().zip(searched) {
                    *threshold = if *searched { levels } else { u8::MAX };
                }
            }
            self.set_lowest(band, first / SEGMENT_TILES);
        }
    }

    /// Of a segment of a row of tiles; a region is within one.
    fn set_lowest(&mut self, band: usize, segment: usize) {
        let first = segment * SEGMENT_TILES;
        let tiles = band * self.tile_columns + first
            ..band * self.tile_columns + self.tile_columns.min(first + SEGMENT_TILES);
        let thresholds = self.threshold.get(tiles).unwrap_or_default();
        let lowest = thresholds.iter().copied().min().unwrap_or(u8::MAX);
        if let Some(known) = self.lowest.get_mut(band * self.segments + segment) {
            *known = lowest;
        }
    }

    fn index(&self, band: usize, tile_column: usize) -> usize {
        (band / REGION_BANDS) * self.columns + tile_column / REGION_TILES
    }

    /// A tile is hit above this many levels; 255 (never) where the tile is not searched.
    pub fn tile_threshold(&self, band: usize, tile_column: usize) -> u8 {
        self.band_thresholds(band)
            .get(tile_column)
            .copied()
            .unwrap_or(u8::MAX)
    }

    /// The thresholds of a row of tiles.
    pub fn band_thresholds(&self, band: usize) -> &[u8] {
        let begin = band * self.tile_columns;
        self.threshold
            .get(begin..begin + self.tile_columns)
            .unwrap_or(&[])
    }

    /// The thresholds of the rows of tiles from one on, with the lowest of each segment.
    pub fn limits_from(&self, band: usize) -> Limits<'_> {
        Limits {
            tiles: self.threshold.get(band * self.tile_columns..).unwrap_or(&[]),
            lowest: self.lowest.get(band * self.segments..).unwrap_or(&[]),
        }
    }

    /// Standard deviation of a frame difference here, levels.
    pub fn difference_sigma(&self, band: usize, tile_column: usize) -> f32 {
        self.sigma
            .get(self.index(band, tile_column))
            .copied()
            .unwrap_or(SIGMA_START)
    }

    /// Clips to apply when summing |d| in the regions of a row of tiles.
    pub fn clips(&self, band: usize) -> &[u8] {
        let begin = (band / REGION_BANDS) * self.columns;
        self.clip.get(begin..begin + self.columns).unwrap_or(&[])
    }

    /// Takes the mean clipped |d| of one row piece of a region.
    #[inline]
    pub fn learn(&mut self, band: usize, region_column: usize, mean_change: f32) {
        let index = (band / REGION_BANDS) * self.columns + region_column;
        if let Some(sigma) = self.sigma.get_mut(index) {
            let measured = (SIGMA_OVER_MEAN * mean_change).max(0.5);
            // Learned every second frame: a rise is there within 0.1 s, a fall within a second.
            let share = if measured > *sigma { 0.2 } else { 0.05 };
            *sigma += share * (measured - *sigma);
        }
        self.set_levels(index);
    }
}

fn tile_searched(config: &DetectorConfig, tile_column: usize, band: usize) -> bool {
    let tile = PixelRect {
        x_px: (tile_column * TILE_WIDTH_PX) as u32,
        y_px: (band * TILE_HEIGHT_PX) as u32,
        width_px: TILE_WIDTH_PX as u32,
        height_px: TILE_HEIGHT_PX as u32,
    };
    let wanted = config.regions.is_empty() || config.regions.iter().any(|r| overlaps(r, &tile));
    wanted && !config.masks.iter().any(|mask| covers(mask, &tile))
}

fn overlaps(a: &PixelRect, b: &PixelRect) -> bool {
    a.x_px < b.x_px.saturating_add(b.width_px)
        && b.x_px < a.x_px.saturating_add(a.width_px)
        && a.y_px < b.y_px.saturating_add(b.height_px)
        && b.y_px < a.y_px.saturating_add(a.height_px)
}

fn covers(outer: &PixelRect, inner: &PixelRect) -> bool {
    outer.x_px <= inner.x_px
        && outer.y_px <= inner.y_px
        && inner.x_px + inner.width_px <= outer.x_px.saturating_add(outer.width_px)
        && inner.y_px + inner.height_px <= outer.y_px.saturating_add(outer.height_px)
}
