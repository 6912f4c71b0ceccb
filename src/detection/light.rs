//! Lamps that flicker: how bright the light is in each part of the picture, and the frame as it were under even light.
//!
//! Lamps on alternating current make the levels of all they light rise and fall by the same factor, several levels from
//! frame to frame: more than a ball before what is dark stands out by, once the threshold follows what is bright. So where
//! much of the picture does that, frames are searched in a copy in which each cell has the light of the frame before. Factors
//! are told by the picture itself: tile by tile the sums of some rows are compared with the frame before, and what half of the
//! tiles of a cell agree on is the cell's. What moves before it, or a ball, is in few of them. Where two lamps meet in a cell it
//! is a line instead of a factor ([`super::lamps`]).

use super::dispatch::Kernels;
use super::evening::{EVEN_HALF, EVEN_UNIT, Evening};
use super::kernel::{TILE_HEIGHT_PX, TILE_WIDTH_PX};
use super::lamps::{CellTiles, LightStep, TILES_MAX};
use super::packed::UnpackedFrames;
use super::phases::Phases;
use super::regions::REGION_TILES;
use crate::scene::Frame;

/// Tile rows of a cell; it has the tile columns of a region.
pub const CELL_BANDS: usize = 4;
const _: () = assert!(CELL_BANDS * REGION_TILES <= TILES_MAX);
/// Rows of a tile that are summed.
const ROWS: [usize; 2] = [1, 5];
/// A cell flickers where the mean of its levels changes by so much from frame to frame.
const STEP_MIN: f32 = 1.25;
/// Light is evened where one cell of so many flickers, and no longer where not even half of these do.
const CELLS_PER_FLICKERING: usize = 16;
/// The light that frames are evened to follows their mean: within some seconds.
const FOLLOWED: f32 = 1.0 / 256.0;
/// Of what is no flicker frames are not evened by more: factors, and levels either way.
const SCALE_LIMITS: [f32; 2] = [0.5, 2.0];
const OFFSET_MAX: f32 = 60.0;

/// The light of each cell.
pub struct Light {
    kernels: Kernels,
    size_px: (usize, usize),
    /// Cells of a row.
    columns: usize,
    /// Mean change from frame to frame, levels.
    steps: Vec<f32>,
    /// What makes of the newest frame's levels those under even light.
    evenings: Vec<LightStep>,
    /// Of the bands of a row of cells: of each tile in the newest frame and in the one before.
    sums: Vec<[u32; 2]>,
    /// The same of a row of cells, as it is applied.
    applied: Vec<Evening>,
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
            evenings: vec![LightStep::NONE; cells],
            sums: vec![[0; 2]; tiles * CELL_BANDS],
            applied: vec![Evening::NONE; columns],
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
            self.evenings.fill(LightStep::NONE);
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
            self.evenings.fill(LightStep::NONE);
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
                    .even_row(current, TILE_WIDTH_PX * REGION_TILES, &self.applied, even);
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
        let (Some(steps), Some(evenings)) = (self.steps.get_mut(cells.clone()), self.evenings.get_mut(cells))
        else {
            return;
        };
        let cells = steps.iter_mut().zip(evenings).zip(&mut self.applied);
        for (cell, ((step, evening), applied)) in cells.enumerate() {
            let first = cell * REGION_TILES;
            let of_cell = self
                .sums
                .chunks(tiles)
                .flat_map(|band| band.iter().skip(first).take(REGION_TILES));
            if let Some((light, change)) = CellTiles::new(of_cell).step(ROWS.len() * TILE_WIDTH_PX) {
                *evening = light.then(*evening);
                follow(step, change.abs(), 0.05);
                self.phases.take(cell, change);
            }
            *evening = settled(*evening);
            *applied = Evening {
                scale: (evening.gain * f32::from(EVEN_UNIT) + 0.5) as u16,
                offset: (evening.offset * f32::from(EVEN_HALF)).round() as i16,
            };
        }
    }
}

/// Within limits, and a little nearer to the light as it is.
fn settled(evening: LightStep) -> LightStep {
    let gain = evening.gain.clamp(SCALE_LIMITS[0], SCALE_LIMITS[1]);
    let offset = evening.offset.clamp(-OFFSET_MAX, OFFSET_MAX);
    LightStep {
        gain: gain + FOLLOWED * (1.0 - gain),
        offset: (1.0 - FOLLOWED) * offset,
    }
}

/// Takes a measured step: a rise sooner than a fall.
fn follow(step: &mut f32, measured: f32, share: f32) {
    let share = if measured > *step { share } else { 0.25 * share };
    *step += share * (measured - *step);
}
