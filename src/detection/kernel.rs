//! The loops that touch every pixel: plain safe code, compiled once per instruction set by [`super::dispatch`].
//!
//! All arithmetic is on bytes with saturation, so every instruction set gives the same bits.

use super::dispatch;
pub use super::lanes::{linearise, locate};

/// Columns of a tile.
pub const TILE_WIDTH_PX: usize = 32;
/// Rows of a tile.
pub const TILE_HEIGHT_PX: usize = 8;

/// Pixels of a row that one comparison decides on.
const SEGMENT_PX: usize = 256;
/// Tiles that they touch.
pub const SEGMENT_TILES: usize = SEGMENT_PX / TILE_WIDTH_PX;
/// Segments of a row that are told apart.
const SEGMENTS_MAX: usize = 64;
/// Lanes of the running maximum: they stay in registers.
const LANES: usize = 64;

/// Thresholds of a band: of each of its tiles, and the lowest of each [`SEGMENT_TILES`] of them.
#[derive(Debug, Clone, Copy)]
pub struct Limits<'a> {
    /// Of every tile.
    pub tiles: &'a [u8],
    /// The lowest of every segment.
    pub lowest: &'a [u8],
}

/// Tiles of one band (up to [`TILE_HEIGHT_PX`] rows) in which any |current − previous| is above the tile's threshold:
/// gives whether there is any; then their `hits` are `true`, all others `false`. `most` has a place for every column, all
/// zero before and after.
///
/// Rows are read straight through, 256 pixels at a time: one comparison with the lowest threshold of the tiles
/// they touch decides for all. From the first row on where it fails the largest changes of these columns are kept, and
/// decide tile by tile at the band's end. (A running maximum for all columns, or rows side by side, measured
/// 10–120 % slower than this, which reads at the speed of memory; asking for memory ahead 5–50 %.)
#[inline(always)]
pub fn changed_tiles(
    (current, previous): (&[u8], &[u8]),
    width: usize,
    limits: Limits<'_>,
    most: &mut [u8],
    hits: &mut [bool],
) -> bool {
    let width = width.max(1);
    let mut touched = 0_u64;
    for (c_row, p_row) in current.chunks(width).zip(previous.chunks(width)) {
        let ((c_whole, c_rest), (p_whole, p_rest)) = (c_row.as_chunks(), p_row.as_chunks());
        let (most_whole, most_rest) = most.as_chunks_mut();
        let segments = c_whole.iter().zip(p_whole).zip(limits.lowest).zip(most_whole);
        for (index, (((c, p), limit), most)) in segments.enumerate() {
            if touched & segment_bit(index) != 0 || segment_changes_more(c, p, *limit) {
                touched |= segment_bit(index);
                keep_most(most, c, p);
            }
        }
        let index = c_whole.len();
        if let (false, Some(limit)) = (c_rest.is_empty(), limits.lowest.get(index))
            && (touched & segment_bit(index) != 0 || piece_changes_more(c_rest, p_rest, *limit))
        {
            touched |= segment_bit(index);
            for ((most, c), p) in most_rest.iter_mut().zip(c_rest).zip(p_rest) {
                *most = (*most).max(c.abs_diff(*p));
            }
        }
    }
    if touched == 0 {
        return false;
    }
    let mut any = false;
    hits.fill(false);
    let tiles = limits
        .tiles
        .chunks(SEGMENT_TILES)
        .zip(hits.chunks_mut(SEGMENT_TILES));
    for (index, (most, (thresholds, hits))) in most.chunks_mut(SEGMENT_PX).zip(tiles).enumerate() {
        if touched & segment_bit(index) == 0 {
            continue;
        }
        let pieces = most.chunks(TILE_WIDTH_PX);
        for (most, (threshold, hit)) in pieces.zip(thresholds.iter().zip(hits)) {
            *hit = most.iter().fold(0, |most, change| (*change).max(most)) > *threshold;
            any |= *hit;
        }
        most.fill(0);
    }
    any
}

/// A segment's bit; beyond [`SEGMENTS_MAX`] a row's last ones share one.
#[inline(always)]
fn segment_bit(index: usize) -> u64 {
    1 << index.min(SEGMENTS_MAX - 1)
}

/// Takes the changes of a segment into the largest of their columns.
#[inline(always)]
fn keep_most(most: &mut [u8; SEGMENT_PX], current: &[u8; SEGMENT_PX], previous: &[u8; SEGMENT_PX]) {
    for ((most, c), p) in most.iter_mut().zip(current).zip(previous) {
        *most = (*most).max(c.abs_diff(*p));
    }
}

/// Whether |current − previous| exceeds a limit anywhere in a segment.
#[inline(always)]
fn segment_changes_more(current: &[u8; SEGMENT_PX], previous: &[u8; SEGMENT_PX], limit: u8) -> bool {
    let mut over = [0u8; LANES];
    for (c, p) in current.chunks_exact(LANES).zip(previous.chunks_exact(LANES)) {
        for ((over, c), p) in over.iter_mut().zip(c).zip(p) {
            *over = (*over).max(c.abs_diff(*p));
        }
    }
    // No sideways steps: what is left over the limit shows in any lane.
    over.iter().fold(0, |any, most| any | most.saturating_sub(limit)) != 0
}

/// The same of a shorter piece.
#[inline(always)]
fn piece_changes_more(current: &[u8], previous: &[u8], limit: u8) -> bool {
    let changes = current.iter().zip(previous);
    changes.fold(0, |any, (c, p)| any | c.abs_diff(*p).saturating_sub(limit)) != 0
}

/// Pixels that a step of a sum takes, and steps whose sums fit sixteen bits.
const SUM_STEP_PX: usize = 32;
const SUM_STEPS_MAX: usize = 256;

/// Sum of min(|current − previous|, clip).
#[inline(always)]
pub fn clipped_change_sum(current: &[u8], previous: &[u8], clip: u8) -> u32 {
    const PIECE_PX: usize = SUM_STEP_PX * SUM_STEPS_MAX;
    let mut sum = 0;
    for (current, previous) in current.chunks(PIECE_PX).zip(previous.chunks(PIECE_PX)) {
        let ((c_steps, c_rest), (p_steps, p_rest)) = (current.as_chunks(), previous.as_chunks());
        let mut lanes = [0u16; SUM_STEP_PX];
        for (c, p) in c_steps.iter().zip(p_steps) {
            let (c, p): (&[u8; SUM_STEP_PX], &[u8; SUM_STEP_PX]) = (c, p);
            for i in 0..SUM_STEP_PX {
                lanes[i] += u16::from(c[i].abs_diff(p[i]).min(clip));
            }
        }
        sum += lanes.iter().map(|lane| u32::from(*lane)).sum::<u32>();
        let rest = c_rest.iter().zip(p_rest);
        sum += rest
            .map(|(c, p)| u32::from(c.abs_diff(*p).min(clip)))
            .sum::<u32>();
    }
    sum
}

/// Reads both slices once and does next to nothing: the speed of memory, for the bench.
#[inline(always)]
pub fn read_both(one: &[u8], other: &[u8]) -> u8 {
    let mut lanes = [0u8; 256];
    for (a, b) in one.chunks_exact(256).zip(other.chunks_exact(256)) {
        for ((lane, a), b) in lanes.iter_mut().zip(a).zip(b) {
            *lane |= a ^ b;
        }
    }
    lanes.iter().fold(0, |all, lane| all | lane)
}

/// Three-frame change of one row piece (up to 64 pixels): bit i is set where the pixel is brighter than both
/// references, or darker than both, by more than `threshold`.
#[inline(always)]
pub fn change_mask(current: &[u8], before: &[u8], after: &[u8], threshold: u8) -> u64 {
    let mut flags = [0u8; 64];
    for (((flag, c), a), b) in flags.iter_mut().zip(current).zip(before).zip(after) {
        *flag = u8::from(change(*c, *a, *b) > threshold);
    }
    let mut mask = 0u64;
    for (i, eight) in flags.chunks_exact(8).take(current.len().div_ceil(8)).enumerate() {
        let mut bytes = [0u8; 8];
        bytes.copy_from_slice(eight);
        mask |= low_bits(bytes) << (8 * i);
    }
    mask
}

/// [`change_mask`] of a row of a tile.
#[inline(always)]
fn tile_row_mask(
    c: &[u8; TILE_WIDTH_PX],
    a: &[u8; TILE_WIDTH_PX],
    b: &[u8; TILE_WIDTH_PX],
    threshold: u8,
) -> u64 {
    let mut flags = [0u8; TILE_WIDTH_PX];
    for (((flag, c), a), b) in flags.iter_mut().zip(c).zip(a).zip(b) {
        *flag = if change(*c, *a, *b) > threshold {
            u8::MAX
        } else {
            0
        };
    }
    let (sixteens, _) = flags.as_chunks::<16>();
    let halves = sixteens.iter().rev();
    halves.fold(0, |mask, flags| {
        (mask << 16) | u64::from(dispatch::top_bits(flags))
    })
}

/// The low bits of eight bytes.
#[inline(always)]
pub fn low_bits(bytes: [u8; 8]) -> u64 {
    u64::from_le_bytes(bytes).wrapping_mul(0x0102_0408_1020_4080) >> 56
}

/// The masks of [`change_mask`] for the rows of one tile: `masks.len()` rows from `begin` on, `stride` apart, `width`
/// pixels each (up to 64). `false`: all zero. Rows that an image lacks are zero.
#[inline(always)]
pub fn tile_masks(
    (current, one, other): (&[u8], &[u8], &[u8]),
    (begin, stride, width): (usize, usize, usize),
    threshold: u8,
    masks: &mut [u64],
) -> bool {
    let mut any = 0;
    for (row, mask) in masks.iter_mut().enumerate() {
        let piece = begin + row * stride..begin + row * stride + width;
        let (Some(c), Some(a), Some(b)) = (
            current.get(piece.clone()),
            one.get(piece.clone()),
            other.get(piece),
        ) else {
            *mask = 0;
            continue;
        };
        *mask = match (
            <&[u8; TILE_WIDTH_PX]>::try_from(c),
            <&[u8; TILE_WIDTH_PX]>::try_from(a),
            <&[u8; TILE_WIDTH_PX]>::try_from(b),
        ) {
            (Ok(c), Ok(a), Ok(b)) => tile_row_mask(c, a, b, threshold),
            _ => change_mask(c, a, b, threshold),
        };
        any |= *mask;
    }
    any != 0
}

/// Sums over the pixels of a window, each with the weight max(0, [`WEIGHT_STEPS`]·|change| − floor).
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct WindowSums {
    /// Σ weight.
    pub sum: u64,
    /// Σ weight·column, Σ weight·row.
    pub first: [u64; 2],
    /// Σ weight·column², Σ weight·column·row, Σ weight·row².
    pub second: [u64; 3],
    /// Pixels with a weight.
    pub count: u64,
}

impl WindowSums {
    /// Takes a pixel.
    pub fn add(&mut self, (x, y): (usize, usize), weight: u8) {
        let (x, y, weight) = (x as u64, y as u64, u64::from(weight));
        self.sum += weight;
        let [by_x, by_y] = &mut self.first;
        *by_x += weight * x;
        *by_y += weight * y;
        let [by_xx, by_xy, by_yy] = &mut self.second;
        *by_xx += weight * x * x;
        *by_xy += weight * x * y;
        *by_yy += weight * y * y;
        self.count += u64::from(weight > 0);
    }
}

/// Steps of a weight per level.
pub const WEIGHT_STEPS: u32 = 8;
/// A window is no wider and no higher than this, pixels: its sums fit 32 bits in each of [`SUM_LANES`] lanes.
pub const WINDOW_MAX_PX: usize = 64;
/// Most rows of a window are no wider than this, pixels.
const NARROW_PX: usize = 32;
/// Lanes of the sums.
const SUM_LANES: usize = 8;

/// [`WindowSums`] with columns and rows counted from `begin`: row y has the columns `rows[y]` (first and length, at most
/// [`WINDOW_MAX_PX`] in all), rows are `stride` apart. Rows that an image lacks count nothing.
#[inline(always)]
pub fn window_sums(
    (current, one, other): (&[u8], &[u8], &[u8]),
    (begin, stride): (usize, usize),
    rows: &[(usize, usize)],
    floor: u32,
) -> WindowSums {
    let (mut sum, mut by_x, mut by_y) = ([0u32; SUM_LANES], [0u32; SUM_LANES], [0u32; SUM_LANES]);
    let (mut by_xx, mut by_xy, mut by_yy) = ([0u32; SUM_LANES], [0u32; SUM_LANES], [0u32; SUM_LANES]);
    let mut count = [0u32; SUM_LANES];
    for (y, (first, length)) in (0u32..).zip(rows) {
        let from = begin + y as usize * stride;
        let mut sizes = [0u8; WINDOW_MAX_PX];
        let columns = (*first, *length);
        let end = (first + length).min(WINDOW_MAX_PX);
        let read =
            end <= NARROW_PX && row_in_window::<NARROW_PX>((current, one, other), from, columns, &mut sizes);
        if !read && !row_in_window::<WINDOW_MAX_PX>((current, one, other), from, columns, &mut sizes) {
            let piece = from + first..from + end;
            if let (Some(c), Some(a), Some(b), Some(sizes)) = (
                current.get(piece.clone()),
                one.get(piece.clone()),
                other.get(piece),
                sizes.get_mut(*first..end),
            ) {
                change_row(c, a, b, sizes);
            }
        }
        let end = end.div_ceil(SUM_LANES);
        let (eights, _) = sizes.as_chunks::<SUM_LANES>();
        let (mut row_sum, mut row_by_x) = ([0u32; SUM_LANES], [0u32; SUM_LANES]);
        for (block, eight) in eights.iter().enumerate().take(end).skip(first / SUM_LANES) {
            for i in 0..SUM_LANES {
                let x = (block * SUM_LANES + i) as u32;
                let weight = (WEIGHT_STEPS * u32::from(eight[i])).saturating_sub(floor);
                row_sum[i] += weight;
                row_by_x[i] += weight * x;
                by_xx[i] += weight * x * x;
                count[i] += u32::from(weight > 0);
            }
        }
        for i in 0..SUM_LANES {
            sum[i] += row_sum[i];
            by_x[i] += row_by_x[i];
            by_y[i] += row_sum[i] * y;
            by_xy[i] += row_by_x[i] * y;
            by_yy[i] += row_sum[i] * y * y;
        }
    }
    let all = |lanes: [u32; SUM_LANES]| lanes.iter().map(|lane| u64::from(*lane)).sum();
    WindowSums {
        sum: all(sum),
        first: [all(by_x), all(by_y)],
        second: [all(by_xx), all(by_xy), all(by_yy)],
        count: all(count),
    }
}

/// The size of the change of a row of a window that begins at `from`, 0 outside the columns `first .. first + length`, all
/// of them among the first `WIDTH`. `false`, and nothing read, where fewer pixels are left.
#[inline(always)]
fn row_in_window<const WIDTH: usize>(
    (current, one, other): (&[u8], &[u8], &[u8]),
    from: usize,
    (first, length): (usize, usize),
    sizes: &mut [u8; WINDOW_MAX_PX],
) -> bool {
    let whole = |all: &[u8]| -> Option<[u8; WIDTH]> { all.get(from..from + WIDTH)?.try_into().ok() };
    let (Some(c), Some(a), Some(b)) = (whole(current), whole(one), whole(other)) else {
        return false;
    };
    let (low, length) = (first.min(WIDTH), length.min(WIDTH.saturating_sub(first)));
    for (i, size) in sizes.iter_mut().enumerate().take(WIDTH) {
        let inside = (i as u8).wrapping_sub(low as u8) < length as u8;
        *size = if inside { change(c[i], a[i], b[i]) } else { 0 };
    }
    true
}

/// Sum and largest size of the change of `length` pixels from `begin` on; (0, 0) where an image ends before.
#[inline(always)]
pub fn change_of_run((current, one, other): (&[u8], &[u8], &[u8]), begin: usize, length: usize) -> (u32, u8) {
    const BLOCK: usize = 32;
    let (mut sum, mut peak) = (0u32, 0u8);
    let (mut from, end) = (begin, begin + length);
    while from < end {
        let mut sizes = [0u8; BLOCK];
        let whole = |all: &'_ [u8]| -> Option<[u8; BLOCK]> { all.get(from..from + BLOCK)?.try_into().ok() };
        let left = (end - from).min(BLOCK);
        if let (Some(c), Some(a), Some(b)) = (whole(current), whole(one), whole(other)) {
            for i in 0..BLOCK {
                sizes[i] = if (i as u8) < left as u8 {
                    change(c[i], a[i], b[i])
                } else {
                    0
                };
            }
        } else if let (Some(c), Some(a), Some(b)) =
            (current.get(from..end), one.get(from..end), other.get(from..end))
        {
            change_row(c, a, b, &mut sizes);
        }
        sum += sizes.iter().map(|size| u32::from(*size)).sum::<u32>();
        peak = sizes.iter().fold(peak, |peak, size| peak.max(*size));
        from += BLOCK;
    }
    (sum, peak)
}

/// The size of the change of a row piece, pixel by pixel.
#[inline(always)]
pub fn change_row(current: &[u8], one: &[u8], other: &[u8], sizes: &mut [u8]) {
    for (((size, c), a), b) in sizes.iter_mut().zip(current).zip(one).zip(other) {
        *size = change(*c, *a, *b);
    }
}

/// Change of one pixel against both references: the smaller of the two when they agree in sign, else 0.
#[inline(always)]
pub fn change(current: u8, before: u8, after: u8) -> u8 {
    let brighter = current.saturating_sub(before.max(after));
    let darker = before.min(after).saturating_sub(current);
    brighter.max(darker)
}

#[cfg(test)]
#[path = "kernel_tests.rs"]
mod tests;
