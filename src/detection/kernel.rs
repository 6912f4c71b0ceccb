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
/// A page of memory, and how far ahead of the pixels that are read the begins of pages are asked for.
const PAGE_BYTES: usize = 4096;
const PAGES_AHEAD_BYTES: usize = 8 * PAGE_BYTES;
/// Lanes of the running maximum: they stay in registers.
const LANES: usize = 64;

/// Thresholds of some bands: of each of their tiles, and the lowest of each [`SEGMENT_TILES`] of them.
#[derive(Debug, Clone, Copy)]
pub struct Limits<'a> {
    /// Of every tile, band by band.
    pub tiles: &'a [u8],
    /// The lowest of every segment, band by band.
    pub lowest: &'a [u8],
}

/// Sets the bits of the tiles in which any |current − previous| is above the tile's threshold, in so many bands from the
/// images' begin on; bands have [`TILE_HEIGHT_PX`] rows (the last may have fewer), and words of their own in `hits`.
///
/// Rows are read straight through, 256 pixels at a time: one comparison with the lowest threshold of the tiles
/// they touch decides for all, and only where it fails each tile is asked. (A running maximum of the columns, or rows side
/// by side, measured 10–120 % slower than this.) The processor runs ahead of what is read within a page only: the begin of
/// each page is asked for well before, which makes this a tenth to a third faster than plain reading. (Asking for more
/// lines of a page, or for pages of the previous frame, measured slower.)
#[inline(always)]
pub fn changed_tiles(
    (current, previous): (&[u8], &[u8]),
    (width, bands): (usize, usize),
    limits: Limits<'_>,
    hits: &mut [u64],
) {
    let width = width.max(1);
    let (whole, mut page, mut row_end) = (current, PAGES_AHEAD_BYTES, PAGES_AHEAD_BYTES);
    let tiles = width.div_ceil(TILE_WIDTH_PX);
    let images = current
        .chunks(width * TILE_HEIGHT_PX)
        .zip(previous.chunks(width * TILE_HEIGHT_PX));
    let lowest = limits.lowest.chunks(tiles.div_ceil(SEGMENT_TILES));
    let limits = limits.tiles.chunks(tiles).zip(lowest);
    let hits = hits.chunks_mut(tiles.div_ceil(64));
    for (((current, previous), (thresholds, lowest)), hits) in images.zip(limits).zip(hits).take(bands) {
        for (c_row, p_row) in current.chunks(width).zip(previous.chunks(width)) {
            row_end += c_row.len();
            while page < row_end {
                dispatch::fetch_ahead(whole, page);
                page += PAGE_BYTES;
            }
            let ((c_whole, c_rest), (p_whole, p_rest)) = (c_row.as_chunks(), p_row.as_chunks());
            let mut segments = c_whole.iter().zip(p_whole).zip(lowest);
            let mut index = 0;
            while let Some(over) = segments.position(|((c, p), limit)| segment_changes_more(c, p, *limit)) {
                index += over;
                if let (Some(c), Some(p)) = (c_whole.get(index), p_whole.get(index)) {
                    set_tiles((c, p), index, thresholds, hits);
                }
                index += 1;
            }
            let index = c_whole.len();
            if let (false, Some(limit)) = (c_rest.is_empty(), lowest.get(index))
                && piece_changes_more(c_rest, p_rest, *limit)
            {
                set_tiles((c_rest, p_rest), index, thresholds, hits);
            }
        }
    }
}

/// Sets the bits of the tiles of a segment of one row that change by more than their thresholds.
#[inline(always)]
fn set_tiles((current, previous): (&[u8], &[u8]), segment: usize, thresholds: &[u8], hits: &mut [u64]) {
    const WORD_SEGMENTS: usize = 64 / SEGMENT_TILES;
    let ((c_whole, c_rest), (p_whole, p_rest)) = (current.as_chunks(), previous.as_chunks());
    let thresholds = thresholds.get(segment * SEGMENT_TILES..).unwrap_or_default();
    let mut bits = 0_u64;
    for (tile, ((c, p), threshold)) in c_whole.iter().zip(p_whole).zip(thresholds).enumerate() {
        let (c, p): (&[u8; TILE_WIDTH_PX], &[u8; TILE_WIDTH_PX]) = (c, p);
        bits |= u64::from(piece_changes_more(c, p, *threshold)) << tile;
    }
    if let Some(threshold) = thresholds.get(c_whole.len()) {
        bits |= u64::from(piece_changes_more(c_rest, p_rest, *threshold)) << c_whole.len();
    }
    if let Some(word) = hits.get_mut(segment / WORD_SEGMENTS) {
        *word |= bits << (SEGMENT_TILES * (segment % WORD_SEGMENTS));
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

/// Pixels that a step of a sum takes.
const SUM_STEP_PX: usize = 64;

/// Pixels change together where lamps flicker, many by a few levels; an edge that moves changes few by many. So of a rise or a
/// fall no more counts, levels.
pub const STEP_CLIP: u8 = 4;

/// Sums over pieces of a row of `length` pixels (the last may have fewer): of min(|current − previous|, clip), each piece with
/// a clip of its own, and of the rises and of the falls, each pixel's up to [`STEP_CLIP`].
#[inline(always)]
pub fn clipped_change_sums(
    (current, previous): (&[u8], &[u8]),
    length: usize,
    clips: &[u8],
    sums: &mut [[u32; 3]],
) {
    let pieces = current.chunks(length.max(1)).zip(previous.chunks(length.max(1)));
    for ((c, p), (clip, sum)) in pieces.zip(clips.iter().zip(sums)) {
        *sum = clipped_change_sum(c, p, *clip);
    }
}

#[inline(always)]
fn clipped_change_sum(current: &[u8], previous: &[u8], clip: u8) -> [u32; 3] {
    // As many steps as a byte holds the clipped changes of; the piece of a region takes two.
    let steps = usize::from(u8::MAX / clip.max(STEP_CLIP));
    let mut sums = [0; 3];
    let ((c_steps, c_rest), (p_steps, p_rest)) = (current.as_chunks(), previous.as_chunks());
    for (current, previous) in c_steps.chunks(steps).zip(p_steps.chunks(steps)) {
        let mut lanes = [[0u8; SUM_STEP_PX]; 3];
        for (c, p) in current.iter().zip(previous) {
            let (c, p): (&[u8; SUM_STEP_PX], &[u8; SUM_STEP_PX]) = (c, p);
            for i in 0..SUM_STEP_PX {
                let [change, rise, fall] = clipped_change(c[i], p[i], clip);
                lanes[0][i] += change;
                lanes[1][i] += rise;
                lanes[2][i] += fall;
            }
        }
        for (sum, lanes) in sums.iter_mut().zip(lanes) {
            *sum += lanes.iter().map(|lane| u32::from(*lane)).sum::<u32>();
        }
    }
    for (c, p) in c_rest.iter().zip(p_rest) {
        for (sum, change) in sums.iter_mut().zip(clipped_change(*c, *p, clip)) {
            *sum += u32::from(change);
        }
    }
    sums
}

/// Of one pixel: the change up to `clip`, rise and fall up to [`STEP_CLIP`].
#[inline(always)]
fn clipped_change(current: u8, previous: u8, clip: u8) -> [u8; 3] {
    let (rise, fall) = (current.saturating_sub(previous), previous.saturating_sub(current));
    [(rise | fall).min(clip), rise.min(STEP_CLIP), fall.min(STEP_CLIP)]
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
/// A window is no wider and no higher than this, pixels: its sums fit 32 bits in each column.
pub const WINDOW_MAX_PX: usize = 64;
/// Most windows are no wider than this, pixels.
const NARROW_PX: usize = 32;
/// Columns whose sums stay in registers.
const SUM_LANES: usize = 16;

/// [`WindowSums`] with columns and rows counted from `begin`: row y has the columns `rows[y]` (first and length, at most
/// [`WINDOW_MAX_PX`] in all), rows are `stride` apart. Rows that an image lacks count nothing.
#[inline(always)]
pub fn window_sums(
    images: (&[u8], &[u8], &[u8]),
    place: (usize, usize),
    rows: &[(usize, usize)],
    floor: u32,
) -> WindowSums {
    let end = rows.iter().map(|(first, length)| first + length).max();
    if end.is_none_or(|end| end <= NARROW_PX) {
        sums_of_window::<NARROW_PX>(images, place, rows, floor)
    } else {
        sums_of_window::<WINDOW_MAX_PX>(images, place, rows, floor)
    }
}

#[inline(always)]
fn sums_of_window<const WIDTH: usize>(
    (current, one, other): (&[u8], &[u8], &[u8]),
    (begin, stride): (usize, usize),
    rows: &[(usize, usize)],
    floor: u32,
) -> WindowSums {
    let mut sizes = [[0u8; WIDTH]; WINDOW_MAX_PX];
    for (y, ((first, length), sizes)) in rows.iter().zip(&mut sizes).enumerate() {
        let from = begin + y * stride;
        if !row_in_window((current, one, other), from, (*first, *length), sizes) {
            let piece = from + first..from + (first + length).min(WIDTH);
            if let (Some(c), Some(a), Some(b), Some(sizes)) = (
                current.get(piece.clone()),
                one.get(piece.clone()),
                other.get(piece),
                sizes.get_mut(*first..),
            ) {
                change_row(c, a, b, sizes);
            }
        }
    }
    let mut all = WindowSums::default();
    for left in (0..WIDTH).step_by(SUM_LANES) {
        let rows = sizes.iter().take(rows.len());
        let rows = rows.filter_map(|row| row.get(left..left + SUM_LANES)?.try_into().ok());
        add_columns(rows, left as u64, floor, &mut all);
    }
    all
}

/// Adds the weights of some columns from `left` on.
///
/// From the last row up three sums are run, each of the one before: of Σ w, Σ w·(y + 1), Σ w·(y + 1)·(y + 2)/2, with no product.
#[inline(always)]
fn add_columns<'a>(
    rows: impl DoubleEndedIterator<Item = &'a [u8; SUM_LANES]>,
    left: u64,
    floor: u32,
    all: &mut WindowSums,
) {
    const STEPS: u16 = WEIGHT_STEPS as u16;
    let floor = floor.min(u32::from(u16::MAX)) as u16;
    let (mut sum, mut once, mut twice) = ([0u32; SUM_LANES], [0u32; SUM_LANES], [0u32; SUM_LANES]);
    let mut count = [0u16; SUM_LANES];
    for sizes in rows.rev() {
        for i in 0..SUM_LANES {
            let weight = (STEPS * u16::from(sizes[i])).saturating_sub(floor);
            count[i] += u16::from(weight > 0);
            sum[i] += u32::from(weight);
            once[i] += sum[i];
            twice[i] += once[i];
        }
    }
    for (x, i) in (left..).zip(0..SUM_LANES) {
        let (sum, once, twice) = (u64::from(sum[i]), u64::from(once[i]), u64::from(twice[i]));
        let by_y = once - sum;
        all.sum += sum;
        all.count += u64::from(count[i]);
        let ([first_x, first_y], [xx, xy, yy]) = (&mut all.first, &mut all.second);
        *first_x += sum * x;
        *first_y += by_y;
        *xx += sum * x * x;
        *xy += by_y * x;
        *yy += 2 * twice - 3 * by_y - 2 * sum;
    }
}

/// The size of the change of a row of a window that begins at `from`, 0 outside the columns `first .. first + length`.
/// `false`, and nothing read, where the images have fewer pixels left.
#[inline(always)]
fn row_in_window<const WIDTH: usize>(
    (current, one, other): (&[u8], &[u8], &[u8]),
    from: usize,
    (first, length): (usize, usize),
    sizes: &mut [u8; WIDTH],
) -> bool {
    let whole = |all: &[u8]| -> Option<[u8; WIDTH]> { all.get(from..from + WIDTH)?.try_into().ok() };
    let (Some(c), Some(a), Some(b)) = (whole(current), whole(one), whole(other)) else {
        return false;
    };
    let (low, length) = (first.min(WIDTH), length.min(WIDTH.saturating_sub(first)));
    for i in 0..WIDTH {
        let inside = (i as u8).wrapping_sub(low as u8) < length as u8;
        sizes[i] = if inside { change(c[i], a[i], b[i]) } else { 0 };
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
