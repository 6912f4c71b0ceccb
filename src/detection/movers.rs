//! A ball in front of something that itself moves: a player's shirt changes everywhere, the ball is one spot of it.
//!
//! Such a spot is brighter (or darker) than everything near that place in frames shortly before and after: the
//! references are taken at their brightest and darkest over a few pixels, as far as a player moves meanwhile.
//! The ball moves further, so it stands out; edges and patterns of the player do not.

use std::ops::Range;

use nalgebra::Vector2;

use super::blobs::{Blob, Images};
use super::centroid::{Moments, Sums};
use super::dispatch::Kernels;
use super::fronts::{ROW_STEP, ROWS, fetch_rows, fetch_tile};
use super::kernel::{TILE_HEIGHT_PX, TILE_WIDTH_PX, WindowSums};

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

/// The memory of a body's tiles is asked for so many tiles ahead.
const TILES_AHEAD: usize = 64;

/// A spot while it is gathered.
struct Spot {
    /// Row and column of its first pixel, which no other spot has.
    begun: (usize, usize),
    left: usize,
    right: usize,
    top: usize,
    bottom: usize,
    area_px: usize,
    peak: u8,
    /// By levels, with places in the image.
    sums: WindowSums,
}

impl Spot {
    fn at(x: usize, y: usize) -> Self {
        Self {
            begun: (y, x),
            left: x,
            right: x,
            top: y,
            bottom: y,
            area_px: 0,
            peak: 0,
            sums: WindowSums::default(),
        }
    }

    fn take(&mut self, x: usize, y: usize, change: u8) {
        self.left = self.left.min(x);
        self.right = self.right.max(x);
        self.bottom = y;
        self.area_px += 1;
        self.peak = self.peak.max(change);
        self.sums.add((x, y), change);
    }
}

/// A tile (band and column) with the rows that may hold something in front of a body: bits.
#[derive(Debug, Clone, Copy)]
struct TileInFront {
    place: (usize, usize),
    rows: u8,
}

/// Searches blobs for spots; keeps its buffers from frame to frame.
pub struct MoverSearch {
    kernels: Kernels,
    tiles: Vec<(usize, usize)>,
    found: Vec<TileInFront>,
    spots: Vec<Spot>,
    /// Those before it have ended.
    first_open: usize,
}

impl MoverSearch {
    /// With the kernels of a detector.
    pub fn new(kernels: Kernels) -> Self {
        Self {
            kernels,
            tiles: Vec::with_capacity(1024),
            found: Vec::with_capacity(1024),
            spots: Vec::with_capacity(SPOTS_OPEN_MAX),
            first_open: 0,
        }
    }

    /// The strongest spots of a blob: where the change beyond `reach_px` exceeds `threshold`. Of a large blob every second
    /// row is read: a ball has several.
    pub fn find(
        &mut self,
        near: &Images<'_>,
        blob: &Blob,
        limits: (usize, u8),
    ) -> impl Iterator<Item = (Moments, Blob)> + '_ {
        self.spots.clear();
        self.first_open = 0;
        let (left, end) = (blob.left.saturating_sub(1), blob.right + 2);
        'rows: for y in (blob.top..=blob.bottom).step_by(ROW_STEP).take(ROWS_MAX) {
            for x in (left..end).step_by(TILE_WIDTH_PX) {
                if !self.take_piece(near, (y, x..end), limits) {
                    break 'rows;
                }
            }
        }
        self.strongest(blob.difference_sigma)
    }

    /// The strongest spots in front of a large body, given by its tiles from top to bottom.
    pub fn find_in_front(
        &mut self,
        near: &Images<'_>,
        tiles: impl Iterator<Item = (usize, usize)>,
        limits: (usize, u8),
        difference_sigma: f32,
    ) -> impl Iterator<Item = (Moments, Blob)> + '_ {
        self.spots.clear();
        self.first_open = 0;
        self.found.clear();
        self.tiles.clear();
        self.tiles.extend(tiles);
        let size_px = (near.width_px, near.height_px);
        let mut beside = None;
        let mut fetch = |tile: &(usize, usize)| {
            fetch_tile(near.levels(), near.width_px, *tile, beside);
            beside = Some((tile.0, tile.1 + 1));
        };
        self.tiles.iter().take(TILES_AHEAD).for_each(&mut fetch);
        let mut ahead = self.tiles.iter().skip(TILES_AHEAD);
        for place in self.tiles.iter().copied() {
            ahead.by_ref().take(1).for_each(&mut fetch);
            let rows = self.kernels.rows_in_front(near.levels(), size_px, place, limits);
            if rows != 0 {
                fetch_rows((near.one, near.other), near.width_px, place, (limits.0, rows));
                self.found.push(TileInFront { place, rows });
            }
        }
        let found = std::mem::take(&mut self.found);
        for band in found.chunk_by(|a, b| a.place.0 == b.place.0) {
            if !self.take_band(near, band, limits) {
                break;
            }
        }
        self.found = found;
        self.strongest(difference_sigma)
    }

    /// Decides pixel by pixel in the rows found of the tiles of one band; `false` where there are too many spots.
    fn take_band(&mut self, near: &Images<'_>, tiles: &[TileInFront], limits: (usize, u8)) -> bool {
        (0..ROWS).all(|row| {
            let mut of_row = tiles.iter().filter(|tile| tile.rows >> row & 1 != 0);
            of_row.all(|tile| {
                let (band, column) = tile.place;
                let (y, x) = (band * TILE_HEIGHT_PX + ROW_STEP * row, column * TILE_WIDTH_PX);
                self.take_piece(near, (y, x..x + TILE_WIDTH_PX), limits)
            })
        })
    }

    /// Adds the changed pixels of some columns of a row, the first of a piece, to the spots they touch; `false` where there
    /// are too many spots.
    fn take_piece(
        &mut self,
        near: &Images<'_>,
        (y, columns): (usize, Range<usize>),
        limits: (usize, u8),
    ) -> bool {
        let mut changes = [0; TILE_WIDTH_PX];
        let size_px = (near.width_px, near.height_px);
        let levels = near.levels();
        if !self
            .kernels
            .row_in_front(levels, size_px, (y, columns.start), limits, &mut changes)
        {
            return true;
        }
        // Rows come from the top: what has ended is not touched again.
        let ended = |spot: &Spot| spot.bottom + SPOT_GAP_PX < y;
        while self.spots.get(self.first_open).is_some_and(ended) {
            self.first_open += 1;
        }
        for (x, change) in columns.zip(changes).filter(|(_, change)| *change > limits.1) {
            let open = self.spots.get_mut(self.first_open..).unwrap_or_default();
            let touched = open.iter_mut().rev().find(|spot| {
                y <= spot.bottom + SPOT_GAP_PX
                    && x + SPOT_GAP_PX >= spot.left
                    && x <= spot.right + SPOT_GAP_PX
            });
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

    fn strongest(&mut self, sigma: f32) -> impl Iterator<Item = (Moments, Blob)> + '_ {
        let spots = &mut self.spots;
        spots.retain(|spot| {
            let side = (spot.right - spot.left).max(spot.bottom - spot.top);
            spot.area_px >= SPOT_AREA_MIN_PX && side <= SPOT_SIDE_MAX_PX
        });
        spots.sort_unstable_by_key(|spot| (std::cmp::Reverse(spot.sums.sum), spot.begun));
        spots.iter().take(SPOTS_MAX).filter_map(move |spot| {
            let sums = Sums::of(&spot.sums, 1);
            let moments = sums.moments(Vector2::zeros(), f64::from(sigma))?;
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
                    peak: i32::from(spot.peak),
                    difference_sigma: sigma,
                },
            ))
        })
    }
}
