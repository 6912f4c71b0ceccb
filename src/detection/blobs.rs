//! From tiles that changed before and after a frame to connected blobs of pixels.
//!
//! Work and memory are bounded: at most [`RUNS_MAX`] runs of pixels a frame, the rest is counted by the caller.

use std::ops::Range;

use nalgebra::Vector2;

use super::dispatch::{Kernels, fetch_ahead};
use super::extents::{Extent, Extents};
use super::kernel::{TILE_HEIGHT_PX, TILE_WIDTH_PX};
use super::regions::RegionNoise;
use super::tiles::TileMap;

/// Most runs of changed pixels kept for one frame.
const RUNS_MAX: usize = 16_384;
/// Blobs next to each other become one if the frame holds no more than so many.
const JOINED_BLOBS_MAX: usize = 400;
/// Of a blob with a longer side one run in so many is read.
pub const LARGE_SIDE_PX: usize = 48;
const LARGE_SHARE: usize = 4;
/// The memory of so many tiles is asked for ahead.
const TILES_AHEAD_MAX: usize = 64;
/// Pixels that may be missing between two runs of one blob.
const GAP_PX: usize = 1;

/// Three images of one size: the one searched and two that show what is behind the ball.
#[derive(Clone, Copy)]
pub struct Images<'a> {
    /// The loops that read them.
    pub kernels: Kernels,
    /// Columns.
    pub width_px: usize,
    /// Rows.
    pub height_px: usize,
    /// The frame searched.
    pub current: &'a [u8],
    /// A reference.
    pub one: &'a [u8],
    /// The other reference.
    pub other: &'a [u8],
}

impl Images<'_> {
    /// Columns and rows of a square around a place, within the image.
    pub fn around(&self, x_px: f64, y_px: f64, reach_px: f64) -> (Range<usize>, Range<usize>) {
        let span = |centre: f64, size: usize| {
            // To whole pixels without `ceil` and `floor`, which are calls where the target has no instruction for them.
            let (low, high) = ((centre - reach_px).max(0.0), centre + reach_px);
            let low = low as usize + usize::from(low as usize as f64 != low);
            let high = if high < 0.0 {
                0
            } else {
                size.min((high as usize).saturating_add(1))
            };
            low.min(high)..high
        };
        (span(x_px, self.width_px), span(y_px, self.height_px))
    }

    /// The three as slices.
    pub fn levels(&self) -> (&[u8], &[u8], &[u8]) {
        (self.current, self.one, self.other)
    }
}

#[derive(Debug, Clone, Copy)]
struct Run {
    y: u32,
    begin: u32,
    end: u32,
    parent: u32,
}

/// A connected set of changed pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Blob {
    /// First column.
    pub left: usize,
    /// Last column.
    pub right: usize,
    /// First row.
    pub top: usize,
    /// Last row.
    pub bottom: usize,
    /// Pixels.
    pub area_px: usize,
    /// Sum of their columns and of their rows.
    pub place_sum: [usize; 2],
    /// Sum of the size of the change, levels.
    pub change_sum: i64,
    /// Largest size of change, levels.
    pub peak: i32,
    /// σ of a frame difference at the blob's first pixel, levels.
    pub difference_sigma: f32,
}

/// Finds blobs; keeps its buffers from frame to frame.
pub struct BlobFinder {
    kernels: Kernels,
    columns: Vec<usize>,
    masks: Vec<[u64; TILE_HEIGHT_PX]>,
    runs: Vec<Run>,
    blob_of_run: Vec<usize>,
    extents: Extents,
    /// The blobs of the last search.
    pub blobs: Vec<Blob>,
    /// Whether the last search ran out of runs.
    pub overflowed: bool,
}

impl Blob {
    /// Longer side less one, pixels.
    pub fn side_px(&self) -> usize {
        (self.right - self.left).max(self.bottom - self.top)
    }

    /// Mean place of its pixels.
    pub fn middle_px(&self) -> Vector2<f64> {
        let [x, y] = self.place_sum.map(|sum| sum as f64 / self.area_px.max(1) as f64);
        Vector2::new(x, y)
    }

    /// Change summed over its noise: larger is surer.
    pub fn significance(&self) -> f64 {
        self.change_sum as f64
            / (f64::from(self.difference_sigma.max(0.5)) * (self.area_px.max(1) as f64).sqrt())
    }

    fn extent(&self) -> Extent {
        [self.left, self.right, self.top, self.bottom].map(|place| place as u32)
    }

    fn join(&mut self, other: &Blob) {
        self.left = self.left.min(other.left);
        self.right = self.right.max(other.right);
        self.top = self.top.min(other.top);
        self.bottom = self.bottom.max(other.bottom);
        self.area_px += other.area_px;
        for (sum, more) in self.place_sum.iter_mut().zip(other.place_sum) {
            *sum += more;
        }
        self.change_sum += other.change_sum;
        self.peak = self.peak.max(other.peak);
    }
}

impl BlobFinder {
    /// Joins small blobs next to each other: the lit and the dark side of a ball, the ends of a streak.
    fn join_neighbours(&mut self) {
        if self.blobs.len() > JOINED_BLOBS_MAX {
            return;
        }
        self.blobs.sort_unstable_by_key(|blob| (blob.top, blob.left));
        self.extents.clear();
        self.blobs
            .iter()
            .for_each(|blob| self.extents.push(blob.extent()));
        for index in 0..self.blobs.len() {
            let Some(mut blob) = self.blobs.get(index).copied().filter(|blob| blob.area_px > 0) else {
                continue;
            };
            let beside = |extents: &Extents, blob: &Blob| {
                let next = self
                    .kernels
                    .first_beside(extents.from(index + 1), blob.extent())?;
                Some(index + 1 + next)
            };
            while let Some(next) = beside(&self.extents, &blob) {
                self.extents.take_out(next);
                if let Some(taken) = self.blobs.get_mut(next) {
                    blob.join(taken);
                    taken.area_px = 0;
                }
            }
            if let Some(slot) = self.blobs.get_mut(index) {
                *slot = blob;
            }
        }
        self.blobs.retain(|blob| blob.area_px > 0);
    }

    /// Buffers for an image this wide.
    pub fn new(width_px: usize, kernels: Kernels) -> Self {
        let tiles = width_px.div_ceil(TILE_WIDTH_PX);
        Self {
            kernels,
            columns: Vec::with_capacity(tiles),
            masks: Vec::with_capacity(tiles),
            runs: Vec::with_capacity(RUNS_MAX),
            blob_of_run: Vec::with_capacity(RUNS_MAX),
            extents: Extents::default(),
            blobs: Vec::with_capacity(RUNS_MAX),
            overflowed: false,
        }
    }

    /// Asks for the memory of tiles that are searched soon.
    pub fn fetch_ahead(&self, images: &Images<'_>, tiles: &TileMap) {
        let mut left = TILES_AHEAD_MAX;
        for band in tiles.bands() {
            for column in tiles.columns(band).take(left) {
                left -= 1;
                let begin = band * TILE_HEIGHT_PX * images.width_px + column * TILE_WIDTH_PX;
                for row in 0..TILE_HEIGHT_PX {
                    let at = begin + row * images.width_px;
                    for image in [images.current, images.one, images.other] {
                        fetch_ahead(image, at);
                        fetch_ahead(image, at + TILE_WIDTH_PX - 1);
                    }
                }
            }
        }
    }

    /// Finds the blobs within the tiles given.
    pub fn find(&mut self, images: &Images<'_>, tiles: &TileMap, noise: &RegionNoise) {
        self.runs.clear();
        self.blobs.clear();
        self.overflowed = false;
        let mut previous_row = 0..0;
        for band in tiles.bands() {
            if !self.mask_band(images, tiles, band, noise) {
                continue;
            }
            let top = band * TILE_HEIGHT_PX;
            for row in 0..TILE_HEIGHT_PX.min(images.height_px.saturating_sub(top)) {
                let begin = self.runs.len();
                if !self.take_row_runs((top + row) as u32, row) {
                    self.overflowed = true;
                    break;
                }
                let this_row = begin..self.runs.len();
                self.join_rows(previous_row, this_row.clone());
                previous_row = this_row;
            }
        }
        self.gather(images, noise);
        self.join_neighbours();
    }

    fn mask_band(&mut self, images: &Images<'_>, tiles: &TileMap, band: usize, noise: &RegionNoise) -> bool {
        self.columns.clear();
        self.masks.clear();
        let top = band * TILE_HEIGHT_PX;
        for column in tiles.columns(band) {
            // Pixels count from 60 % of the tile's threshold: one clear pixel admits its dimmer neighbours.
            let low = (u32::from(noise.tile_threshold(band, column)) * 3 / 5) as u8;
            let left = column * TILE_WIDTH_PX;
            let right = (left + TILE_WIDTH_PX).min(images.width_px);
            let mut masks = [0u64; TILE_HEIGHT_PX];
            let pixels = (images.current, images.one, images.other);
            let place = (top * images.width_px + left, images.width_px, right - left);
            if self.kernels.tile_masks(pixels, place, low, &mut masks) {
                self.columns.push(column);
                self.masks.push(masks);
            }
        }
        !self.columns.is_empty()
    }

    fn take_row_runs(&mut self, y: u32, row: usize) -> bool {
        let row_begin = self.runs.len();
        for (column, masks) in self.columns.iter().zip(&self.masks) {
            let mut mask = masks.get(row).copied().unwrap_or(0);
            while mask != 0 {
                let first = mask.trailing_zeros();
                let length = (mask >> first).trailing_ones();
                mask &= !(((1u64 << length) - 1) << first);
                let begin = (column * TILE_WIDTH_PX) as u32 + first;
                let end = begin + length;
                let index = self.runs.len();
                match self.runs.last_mut() {
                    Some(last) if index > row_begin && begin <= last.end + GAP_PX as u32 => last.end = end,
                    _ if index >= RUNS_MAX => return false,
                    _ => self.runs.push(Run {
                        y,
                        begin,
                        end,
                        parent: index as u32,
                    }),
                }
            }
        }
        true
    }

    fn root(&mut self, mut index: u32) -> u32 {
        while let Some(run) = self.runs.get(index as usize).copied() {
            if run.parent == index {
                break;
            }
            let grand = self
                .runs
                .get(run.parent as usize)
                .map_or(run.parent, |p| p.parent);
            if let Some(run) = self.runs.get_mut(index as usize) {
                run.parent = grand;
            }
            index = grand;
        }
        index
    }

    fn join_rows(&mut self, above: Range<usize>, below: Range<usize>) {
        let (mut a, mut b) = (above.start, below.start);
        while a < above.end && b < below.end {
            let (Some(upper), Some(lower)) = (self.runs.get(a).copied(), self.runs.get(b).copied()) else {
                return;
            };
            if upper.y + 1 != lower.y {
                return;
            }
            let gap = GAP_PX as u32;
            if upper.begin <= lower.end + gap && lower.begin <= upper.end + gap {
                let (ra, rb) = (self.root(a as u32), self.root(b as u32));
                if let Some(run) = self.runs.get_mut(ra.max(rb) as usize) {
                    run.parent = ra.min(rb);
                }
            }
            if upper.end < lower.end {
                a += 1;
            } else {
                b += 1;
            }
        }
    }

    fn gather(&mut self, images: &Images<'_>, noise: &RegionNoise) {
        self.blob_of_run.clear();
        for index in 0..self.runs.len() {
            let Some(run) = self.runs.get(index).copied() else {
                continue;
            };
            // A parent always comes before its child, so its blob is known.
            let known = self.blob_of_run.get(run.parent as usize).copied();
            let slot = known.unwrap_or(self.blobs.len());
            self.blob_of_run.push(slot);
            let (y, begin, last) = (run.y as usize, run.begin as usize, run.end as usize - 1);
            if known.is_none() {
                self.blobs.push(Blob {
                    left: begin,
                    right: last,
                    top: y,
                    bottom: y,
                    area_px: 0,
                    place_sum: [0; 2],
                    change_sum: 0,
                    peak: 0,
                    difference_sigma: noise.difference_sigma(y / TILE_HEIGHT_PX, begin / TILE_WIDTH_PX),
                });
            }
            let Some(blob) = self.blobs.get_mut(slot) else {
                continue;
            };
            let length = last + 1 - begin;
            blob.left = blob.left.min(begin);
            blob.right = blob.right.max(last);
            blob.top = blob.top.min(y);
            blob.bottom = blob.bottom.max(y);
            blob.area_px += length;
            blob.place_sum[0] += length * (begin + last) / 2;
            blob.place_sum[1] += length * y;
        }
        self.add_changes(images);
    }

    /// Adds up the change of every blob; of large ones, which are no ball by themselves, that of a few runs.
    fn add_changes(&mut self, images: &Images<'_>) {
        for (index, (run, slot)) in self.runs.iter().zip(&self.blob_of_run).enumerate() {
            let Some(blob) = self.blobs.get_mut(*slot) else {
                continue;
            };
            let share = if blob.side_px() > LARGE_SIDE_PX {
                LARGE_SHARE
            } else {
                1
            };
            if !index.is_multiple_of(share) {
                continue;
            }
            let at = run.y as usize * images.width_px + run.begin as usize;
            let length = (run.end - run.begin) as usize;
            let (sum, peak) = self.kernels.change_of_run(images.levels(), at, length);
            blob.change_sum += i64::from(sum) * share as i64;
            blob.peak = blob.peak.max(i32::from(peak));
        }
    }
}
