//! Lamps that flicker: how bright the light is in each part of the picture, and the frame as it were under even light.
//!
//! Lamps on alternating current make the levels of all they light rise and fall by the same factor, several levels from
//! frame to frame: more than a ball before what is dark stands out by, once the threshold follows what is bright. So where
//! much of the picture does that, frames are searched in a copy in which each cell has the light of the frame before. Factors
//! are told by the picture itself: tile by tile the sums of some rows are compared with the frame before, and what half of the
//! tiles of a cell agree on is the cell's. What moves before it, or a ball, is in few of them.

use super::dispatch::Kernels;
use super::evening::EVEN_UNIT;
use super::kernel::{TILE_HEIGHT_PX, TILE_WIDTH_PX};
use super::packed::UnpackedFrames;
use super::phases::Phases;
use super::regions::REGION_TILES;
use crate::scene::Frame;

/// Tile rows of a cell; it has the tile columns of a region.
pub const CELL_BANDS: usize = 4;
const CELL_TILES: usize = CELL_BANDS * REGION_TILES;
// A tile's number within its cell has four bits.
const _: () = assert!(CELL_TILES <= 16);
/// Rows of a tile that are summed.
const ROWS: [usize; 2] = [1, 5];
/// A cell flickers where the mean of its levels changes by so much from frame to frame.
const STEP_MIN: f32 = 1.25;
/// Light is evened where one cell of so many flickers, and no longer where not even half of these do.
const CELLS_PER_FLICKERING: usize = 16;
/// The light that frames are evened to follows their mean: within some seconds.
const FOLLOWED: f32 = 1.0 / 256.0;
/// Of what is no flicker frames are not evened by more.
const SCALE_LIMITS: [f32; 2] = [0.5, 2.0];

/// The light of each cell.
pub struct Light {
    kernels: Kernels,
    size_px: (usize, usize),
    /// Cells of a row.
    columns: usize,
    /// Mean change from frame to frame, levels.
    steps: Vec<f32>,
    /// What the levels of the newest frame are multiplied by.
    scales: Vec<f32>,
    /// Of the bands of a row of cells: of each tile in the newest frame and in the one before.
    sums: Vec<[u32; 2]>,
    /// What those of a row of cells are multiplied by, in parts of [`EVEN_UNIT`].
    units: Vec<u16>,
    evens: bool,
    /// Of the light as it is.
    phases: Phases,
    memory: UnpackedFrames,
}

impl Light {
    /// For frames of so many columns and rows, compared over up to `lag_max` frames.
    pub fn new((width_px, height_px): (usize, usize), lag_max: usize, kernels: Kernels) -> Self {
        let tiles = width_px.div_ceil(TILE_WIDTH_PX);
        let columns = tiles.div_ceil(REGION_TILES);
        let cells = columns * height_px.div_ceil(TILE_HEIGHT_PX * CELL_BANDS);
        Self {
            kernels,
            size_px: (width_px, height_px),
            columns,
            steps: vec![0.0; cells],
            scales: vec![1.0; cells],
            sums: vec![[0; 2]; tiles * CELL_BANDS],
            units: vec![EVEN_UNIT; columns],
            evens: false,
            phases: Phases::new(columns, lag_max),
            memory: UnpackedFrames::default(),
        }
    }

    /// Whether frames are evened: asked once a frame, before it is scanned, which ends what was taken of the one before.
    pub fn evens(&mut self) -> bool {
        self.phases.end_frame();
        let flickering = self.steps.iter().filter(|step| **step > STEP_MIN).count();
        let share = if self.evens { 2 } else { 1 } * CELLS_PER_FLICKERING;
        let evens = flickering * share >= self.steps.len().max(1);
        if evens != self.evens {
            tracing::debug!(flickering, cells = self.steps.len(), evens, "lamps flicker");
            self.scales.fill(1.0);
        }
        self.evens = evens;
        evens
    }

    /// Takes the mean change of a piece of a row while frames are not evened.
    #[inline]
    pub fn learn(&mut self, band: usize, column: usize, change: f32) {
        if !self.evens
            && let Some(step) = self.steps.get_mut(band / CELL_BANDS * self.columns + column)
        {
            follow(step, change.abs(), 0.25);
            self.phases.take(column, change);
        }
    }

    /// See [`Phases::lag_from`].
    pub fn lag_from(&self, needed: usize) -> usize {
        self.phases.lag_from(needed)
    }

    /// A frame under the light of the one before, both given as they are. The first of a window shows the light to follow.
    pub fn even(&mut self, frame: &Frame, before: Option<&Frame>) -> Option<Frame> {
        let Some(before) = before else {
            self.scales.fill(1.0);
            return None;
        };
        let (width, height) = self.size_px;
        let mut levels = self.memory.spare(width * height);
        let even = std::sync::Arc::get_mut(&mut levels)?;
        let cell_px = (width * TILE_HEIGHT_PX * CELL_BANDS).max(1);
        let images = frame.bytes().chunks(cell_px).zip(before.bytes().chunks(cell_px));
        for (row, ((current, before), even)) in images.zip(even.chunks_mut(cell_px)).enumerate() {
            self.take_cells(row, (current, before));
            let rows = current.chunks(width).zip(even.chunks_mut(width));
            for (current, even) in rows {
                self.kernels
                    .even_row(current, TILE_WIDTH_PX * REGION_TILES, &self.units, even);
            }
        }
        Some(self.memory.frame_of(frame.stamp, self.size_px, levels))
    }

    /// What a row of cells tells of its light.
    fn take_cells(&mut self, row: usize, (current, before): (&[u8], &[u8])) {
        let (width, _) = self.size_px;
        let tiles = width.div_ceil(TILE_WIDTH_PX);
        self.sums.fill([0; 2]);
        let bands = current
            .chunks(width * TILE_HEIGHT_PX)
            .zip(before.chunks(width * TILE_HEIGHT_PX));
        for ((current, before), sums) in bands.zip(self.sums.chunks_mut(tiles)) {
            for at in ROWS.map(|row| row * width..(row + 1) * width) {
                if let (Some(c), Some(p)) = (current.get(at.clone()), before.get(at)) {
                    self.kernels.add_tile_sums((c, p), sums);
                }
            }
        }
        let cells = row * self.columns..(row + 1) * self.columns;
        let (Some(steps), Some(scales)) = (self.steps.get_mut(cells.clone()), self.scales.get_mut(cells))
        else {
            return;
        };
        for (cell, ((step, scale), unit)) in steps.iter_mut().zip(scales).zip(&mut self.units).enumerate() {
            let first = cell * REGION_TILES;
            let of_cell = self
                .sums
                .chunks(tiles)
                .flat_map(|band| band.iter().skip(first).take(REGION_TILES));
            let (now, before, count) = agreed(of_cell);
            if before > 0 && now > 0 {
                let (now, before) = (now as f32, before as f32);
                *scale = (*scale * before / now).clamp(SCALE_LIMITS[0], SCALE_LIMITS[1]);
                let pixels = (count * ROWS.len() * TILE_WIDTH_PX) as f32;
                follow(step, (now - before).abs() / pixels, 0.05);
                self.phases.take(cell, (now - before) / pixels);
            }
            *scale += FOLLOWED * (1.0 - *scale);
            *unit = (*scale * f32::from(EVEN_UNIT) + 0.5) as u16;
        }
    }
}

/// Takes a measured step: a rise sooner than a fall.
fn follow(step: &mut f32, measured: f32, share: f32) {
    let share = if measured > *step { share } else { 0.25 * share };
    *step += share * (measured - *step);
}

/// The sums of the half of the tiles whose ratio is in the middle, now and before, and how many these are.
fn agreed<'a>(tiles: impl Iterator<Item = &'a [u32; 2]>) -> (u32, u32, usize) {
    let (mut all, mut by_ratio, mut count) = ([[0; 2]; CELL_TILES], [u32::MAX; CELL_TILES], 0);
    for (sums, (slot, key)) in tiles
        .filter(|[now, before]| *now > 0 && *before > 0)
        .zip(all.iter_mut().zip(&mut by_ratio))
    {
        let [now, before] = *sums;
        *slot = *sums;
        // Ratios up to 64 in steps of 2⁻²⁰, with the place in the lowest bits.
        let ratio = (u64::from(now) << 20) / u64::from(before);
        *key = (ratio.min((1 << 26) - 1) as u32) << 4 | count as u32;
        count += 1;
    }
    let keys = by_ratio.get_mut(..count).unwrap_or_default();
    keys.sort_unstable();
    let middle = keys.get(count / 4..count - count / 4).unwrap_or_default();
    let sums = middle.iter().filter_map(|key| all.get((key & 15) as usize));
    let (now, before) = sums.fold((0, 0), |(now, before), sums| (now + sums[0], before + sums[1]));
    (now, before, middle.len())
}
