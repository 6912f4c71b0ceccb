//! A ball in front of something that itself moves: a player's shirt changes everywhere, the ball is one spot of it.
//!
//! Such a spot is brighter (or darker) than everything near that place in frames shortly before and after: the
//! references are taken at their brightest and darkest over a few pixels, as far as a player moves meanwhile.
//! The ball moves further, so it stands out; edges and patterns of the player do not.

use nalgebra::Vector2;

use super::blobs::{Blob, Images};
use super::centroid::{Moments, Sums};
use super::dispatch::Kernels;
use super::fronts::{ROW_STEP, TileRun, fetch_run};
use super::kernel::{TILE_HEIGHT_PX, TILE_WIDTH_PX};

/// A spot within a blob is a ball's from this many pixels.
const SPOT_AREA_MIN_PX: usize = 3;
/// Spots answered for one blob, the strongest.
const SPOTS_MAX: usize = 6;
/// Spots tracked while a blob is read; a pattern that yields more is no player.
const SPOTS_OPEN_MAX: usize = 64;
/// Pixels that may be missing between two parts of one spot.
const SPOT_GAP_PX: usize = 2;
/// A wider or higher spot is no ball.
const SPOT_SIDE_MAX_PX: usize = 40;
/// Rows of a blob that are read: a higher one is not searched below that.
const ROWS_MAX: usize = 200;

/// The memory of a body's tiles is asked for so many runs ahead.
const RUNS_AHEAD: usize = 2;

/// A spot while it is gathered.
struct Spot {
    left: usize,
    right: usize,
    top: usize,
    bottom: usize,
    area_px: usize,
    peak: i32,
    sums: Sums,
}

impl Spot {
    fn at(x: usize, y: usize) -> Self {
        Self {
            left: x,
            right: x,
            top: y,
            bottom: y,
            area_px: 0,
            peak: 0,
            sums: Sums::default(),
        }
    }

    fn take(&mut self, x: usize, y: usize, change: i32) {
        self.left = self.left.min(x);
        self.right = self.right.max(x);
        self.bottom = y;
        self.area_px += 1;
        self.peak = self.peak.max(change);
        self.sums.add(Vector2::new(x as f64, y as f64), change, 0.0);
    }
}

/// Searches blobs for spots; keeps its buffers from frame to frame.
pub struct MoverSearch {
    kernels: Kernels,
    brightest: Vec<u8>,
    darkest: Vec<u8>,
    change: Vec<u8>,
    runs: Vec<TileRun>,
    rows: Vec<(usize, usize, u8)>,
    spots: Vec<Spot>,
}

impl MoverSearch {
    /// Buffers for an image this wide.
    pub fn new(width_px: usize, kernels: Kernels) -> Self {
        Self {
            kernels,
            brightest: vec![0; width_px],
            darkest: vec![0; width_px],
            change: vec![0; width_px],
            runs: Vec::with_capacity(1024),
            rows: Vec::with_capacity(1024),
            spots: Vec::with_capacity(SPOTS_OPEN_MAX),
        }
    }

    /// The strongest spots of a blob: where the change beyond `reach_px` exceeds `threshold`. Of a large blob every second
    /// row is read: a ball has several.
    pub fn find(
        &mut self,
        near: &Images<'_>,
        blob: &Blob,
        (reach_px, threshold): (usize, u8),
    ) -> impl Iterator<Item = (Moments, Blob)> + '_ {
        self.spots.clear();
        let left = blob.left.saturating_sub(reach_px + 1);
        let right = (blob.right + reach_px + 2).min(near.width_px);
        for y in (blob.top..=blob.bottom).step_by(ROW_STEP).take(ROWS_MAX) {
            if self.read_row(near, y, left..right, reach_px) > threshold
                && !self.take_row(y, left..right, threshold)
            {
                break;
            }
        }
        self.strongest(blob.difference_sigma)
    }

    /// The strongest spots in front of a large body, given by its tiles from top to bottom.
    pub fn find_in_front(
        &mut self,
        near: &Images<'_>,
        tiles: impl Iterator<Item = TileRun>,
        (reach_px, threshold): (usize, u8),
        difference_sigma: f32,
    ) -> impl Iterator<Item = (Moments, Blob)> + '_ {
        self.spots.clear();
        let size = (near.width_px, near.height_px);
        self.rows.clear();
        self.runs.clear();
        self.runs.extend(tiles);
        for (index, run) in self.runs.iter().enumerate() {
            if let Some(later) = self.runs.get(index + RUNS_AHEAD) {
                fetch_run(near.levels(), near.width_px, *later);
            }
            let found = self
                .kernels
                .rows_in_front(near.levels(), size, *run, (reach_px, threshold));
            for (tile, rows) in found.iter().enumerate().filter(|(_, rows)| **rows != 0) {
                self.rows.push((run.band, run.column + tile, *rows));
            }
        }
        let rows = std::mem::take(&mut self.rows);
        for band in rows.chunk_by(|a, b| a.0 == b.0) {
            if !self.take_band(near, band, (reach_px, threshold)) {
                break;
            }
        }
        self.rows = rows;
        self.strongest(difference_sigma)
    }

    /// Decides pixel by pixel in the rows found of the tiles of one band; `false` where there are too many spots.
    fn take_band(
        &mut self,
        near: &Images<'_>,
        tiles: &[(usize, usize, u8)],
        (reach_px, threshold): (usize, u8),
    ) -> bool {
        for row in 0..TILE_HEIGHT_PX / ROW_STEP {
            for (band, column, _) in tiles.iter().filter(|tile| tile.2 >> row & 1 != 0) {
                let (x, y) = (column * TILE_WIDTH_PX, band * TILE_HEIGHT_PX + ROW_STEP * row);
                let columns = x.saturating_sub(reach_px)..(x + TILE_WIDTH_PX + reach_px).min(near.width_px);
                if self.read_row(near, y, columns.clone(), reach_px) > threshold
                    && !self.take_row(y, columns, threshold)
                {
                    return false;
                }
            }
        }
        true
    }

    fn strongest(&mut self, sigma: f32) -> impl Iterator<Item = (Moments, Blob)> + '_ {
        let spots = &mut self.spots;
        spots.retain(|spot| {
            let side = (spot.right - spot.left).max(spot.bottom - spot.top);
            spot.area_px >= SPOT_AREA_MIN_PX && side <= SPOT_SIDE_MAX_PX
        });
        spots.sort_by(|a, b| b.sums.total().total_cmp(&a.sums.total()));
        spots.iter().take(SPOTS_MAX).filter_map(move |spot| {
            let moments = spot.sums.moments(Vector2::zeros(), f64::from(sigma))?;
            Some((
                moments,
                Blob {
                    left: spot.left,
                    right: spot.right,
                    top: spot.top,
                    bottom: spot.bottom,
                    area_px: spot.area_px,
                    place_sum: [0; 2],
                    change_sum: 0,
                    peak: spot.peak,
                    difference_sigma: sigma,
                },
            ))
        })
    }

    /// The change of one row beyond its neighbourhood; gives the largest, 0 where the image has no such row.
    fn read_row(
        &mut self,
        near: &Images<'_>,
        y: usize,
        columns: std::ops::Range<usize>,
        reach_px: usize,
    ) -> u8 {
        let width = columns.len();
        let (Some(bright), Some(dark), Some(change)) = (
            self.brightest.get_mut(..width),
            self.darkest.get_mut(..width),
            self.change.get_mut(..width),
        ) else {
            return 0;
        };
        let top = y.saturating_sub(reach_px);
        let rows = (y + reach_px + 1).min(near.height_px) - top;
        let place = (top * near.width_px + columns.start, near.width_px, rows);
        if !self
            .kernels
            .range_of_rows((near.one, near.other), place, bright, dark)
        {
            return 0;
        }
        let begin = y * near.width_px + columns.start;
        let Some(pixels) = near.current.get(begin..begin + width) else {
            return 0;
        };
        self.kernels.beyond(pixels, bright, dark, reach_px, change)
    }

    /// Adds a row's changed pixels to the spots they touch; `false` where there are too many spots.
    fn take_row(&mut self, y: usize, columns: std::ops::Range<usize>, threshold: u8) -> bool {
        let (left, width) = (columns.start, columns.len());
        for (i, change) in self.change.iter().enumerate().take(width) {
            if *change <= threshold {
                continue;
            }
            let x = left + i;
            let touched = self.spots.iter_mut().rev().find(|spot| {
                y <= spot.bottom + SPOT_GAP_PX
                    && x + SPOT_GAP_PX >= spot.left
                    && x <= spot.right + SPOT_GAP_PX
            });
            let change = i32::from(*change);
            if let Some(spot) = touched {
                spot.take(x, y, change);
            } else if self.spots.len() < SPOTS_OPEN_MAX {
                let mut spot = Spot::at(x, y);
                spot.take(x, y, change);
                self.spots.push(spot);
            } else {
                return false;
            }
        }
        true
    }
}
