//! The loops over the tiles of a body that moves: which of their rows may hold something in front of it, outside the range
//! of levels that the body has about there shortly before and after, and which pixels of such a row do.
//! Plain safe code on bytes, compiled once per instruction set by [`super::dispatch`].
//!
//! A first look and a second one for [`super::movers`]. Every second row is read.

use super::dispatch::{fetch_ahead, fetch_further};
use super::kernel::{TILE_HEIGHT_PX, TILE_WIDTH_PX};

/// Rows from one that is read to the next.
pub const ROW_STEP: usize = 2;
/// Fewest and most pixels beside a place whose range is taken.
const REACH_MIN_PX: usize = 2;
const REACH_MAX_PX: usize = 4;
/// Of the places beside one every second is enough where [`SOME`] rows are.
const PLACE_STEP: usize = 2;
/// Rows read of a tile.
pub const ROWS: usize = TILE_HEIGHT_PX / ROW_STEP;
/// Columns of a tile with those in reach, and some more for whole vectors.
const WIDE_PX: usize = TILE_WIDTH_PX + 4 * REACH_MAX_PX;

/// Columns of a tile with those in reach.
const LOOKED_PX: usize = TILE_WIDTH_PX + 2 * REACH_MAX_PX;
/// Memory that is fetched together.
const LINE_BYTES: usize = 64;

/// A row of a tile.
pub type Piece = [u8; TILE_WIDTH_PX];
type Wide = [u8; WIDE_PX];

/// The lowest and the highest level of each column.
type Range<Row> = [Row; 2];

/// A range of nothing.
const fn nothing<const WIDTH: usize>() -> Range<[u8; WIDTH]> {
    [[u8::MAX; WIDTH], [0; WIDTH]]
}

#[inline(always)]
fn widen<const WIDTH: usize>([low, high]: &mut Range<[u8; WIDTH]>, [lows, highs]: &Range<[u8; WIDTH]>) {
    for i in 0..WIDTH {
        low[i] = low[i].min(lows[i]);
        high[i] = high[i].max(highs[i]);
    }
}

/// Rows about a place: the first so many above it, so many, and from one to the next.
#[derive(Clone, Copy)]
struct Rows {
    above: usize,
    count: usize,
    step: usize,
}

/// The rows of a tile that are read, counted from its first.
const OWN: Rows = Rows {
    above: 0,
    count: ROWS,
    step: ROW_STEP,
};
/// Those whose range is taken: they, and the next ones above and below.
const ABOUT: Rows = Rows {
    above: ROW_STEP,
    count: ROWS + 2,
    step: ROW_STEP,
};
/// Every second of them: most tiles need no others, and each of a wide image is in another page.
const SOME: Rows = Rows {
    above: 0,
    count: ROWS / 2 + 1,
    step: 2 * ROW_STEP,
};

/// Rows of an image, `WIDTH` columns from a place on, where the image has them all.
#[inline(always)]
fn block<const WIDTH: usize>(
    image: &[u8],
    (width_px, height_px): (usize, usize),
    (y, left): (usize, usize),
    rows: Rows,
) -> Option<&[u8]> {
    let first = y.checked_sub(rows.above)?;
    let last = first + (rows.count - 1) * rows.step;
    let inside = left + WIDTH <= width_px && last < height_px;
    let all = image.get(first * width_px + left..last * width_px + left + WIDTH);
    all.filter(|_| inside)
}

/// Adds the columns of so many rows of a block to a range.
#[inline(always)]
fn widen_by_rows<const WIDTH: usize>(
    range: &mut Range<[u8; WIDTH]>,
    block: &[u8],
    (count, stride): (usize, usize),
) {
    for row in 0..count {
        if let Some(levels) = block.get(row * stride..).and_then(|rest| rest.first_chunk()) {
            widen(range, &[*levels; 2]);
        }
    }
}

/// The range of each column of two images in some rows, from `REACH` columns left of `left` on.
#[inline(always)]
fn range_about<const REACH: usize>(
    (one, other): (&[u8], &[u8]),
    size_px: (usize, usize),
    (y, left): (usize, usize),
    rows: Rows,
) -> Range<Wide> {
    let mut range = nothing();
    let inside = |image| block::<WIDE_PX>(image, size_px, (y, left.checked_sub(REACH)?), rows);
    if let (Some(one), Some(other)) = (inside(one), inside(other)) {
        let count_and_stride = (rows.count, rows.step * size_px.0);
        widen_by_rows(&mut range, one, count_and_stride);
        widen_by_rows(&mut range, other, count_and_stride);
        return range;
    }
    for row in 0..rows.count {
        if let Some(y) = (y + rows.step * row).checked_sub(rows.above) {
            widen(&mut range, &row_about::<REACH, WIDE_PX>(one, size_px, (y, left)));
            widen(
                &mut range,
                &row_about::<REACH, WIDE_PX>(other, size_px, (y, left)),
            );
        }
    }
    range
}

/// The levels of a row from `REACH` columns left of `left` on: each a range, of nothing where the image has none.
#[inline(always)]
fn row_about<const REACH: usize, const WIDTH: usize>(
    image: &[u8],
    (width_px, height_px): (usize, usize),
    (y, left): (usize, usize),
) -> Range<[u8; WIDTH]> {
    let begin = left.saturating_sub(REACH);
    let row = y * width_px;
    let skipped = (begin + REACH).saturating_sub(left);
    let end = (begin + WIDTH - skipped).min(width_px);
    let mut range = nothing();
    if let Some(levels) = image.get(row + begin..row + end).filter(|_| y < height_px) {
        for bound in &mut range {
            bound[skipped..skipped + levels.len()].copy_from_slice(levels);
        }
    }
    range
}

/// The range of every `STEP`th of the places within `REACH` of each of a tile's columns, the first of which is number `REACH`.
#[inline(always)]
fn widened<const REACH: usize, const STEP: usize>([lows, highs]: &Range<Wide>) -> Range<Piece> {
    let mut range = nothing();
    for from in (0..2 * REACH / STEP + 1).map(|step| step * STEP) {
        let piece = |of: &Wide| -> Option<Piece> { of.get(from..from + TILE_WIDTH_PX)?.try_into().ok() };
        if let (Some(lows), Some(highs)) = (piece(lows), piece(highs)) {
            widen(&mut range, &[lows, highs]);
        }
    }
    range
}

/// How far the levels of a row are outside a range.
#[inline(always)]
fn beyond([lows, highs]: &Range<Piece>, [low, high]: &Range<Piece>) -> Piece {
    let mut changes = [0; TILE_WIDTH_PX];
    for i in 0..TILE_WIDTH_PX {
        let over = highs[i].saturating_sub(high[i]);
        changes[i] = over.max(low[i].saturating_sub(lows[i]));
    }
    changes
}

/// Whether any change is above a threshold.
#[inline(always)]
fn any_above(changes: &Piece, threshold: u8) -> bool {
    let mut any = 0;
    for change in changes {
        any |= change.saturating_sub(threshold);
    }
    any != 0
}

/// The rows of a tile (band and column), counted from the top by [`ROW_STEP`], in which some pixel is outside the range of
/// levels that the references have within `reach_px` (2 to 4) beside it and in the tile's rows, by more than `threshold`: bits.
#[inline(always)]
pub fn rows_in_front(
    images: (&[u8], &[u8], &[u8]),
    size_px: (usize, usize),
    tile: (usize, usize),
    (reach_px, threshold): (usize, u8),
) -> u8 {
    match reach_px {
        0..=REACH_MIN_PX => rows_within::<REACH_MIN_PX>(images, size_px, tile, threshold),
        3 => rows_within::<3>(images, size_px, tile, threshold),
        _ => rows_within::<REACH_MAX_PX>(images, size_px, tile, threshold),
    }
}

#[inline(always)]
fn rows_within<const REACH: usize>(
    (current, one, other): (&[u8], &[u8], &[u8]),
    size_px: (usize, usize),
    (band, column): (usize, usize),
    threshold: u8,
) -> u8 {
    let (top, left) = (band * TILE_HEIGHT_PX, column * TILE_WIDTH_PX);
    let about = |rows| range_about::<REACH>((one, other), size_px, (top, left), rows);
    if let Some(block) = block::<TILE_WIDTH_PX>(current, size_px, (top, left), OWN) {
        // All together first, and against a part of the places: in most tiles there is nothing, and what the levels of some
        // places hold those of all hold too.
        let mut levels = nothing();
        widen_by_rows(&mut levels, block, (ROWS, ROW_STEP * size_px.0));
        let range = widened::<REACH, PLACE_STEP>(&about(SOME));
        if !any_above(&beyond(&levels, &range), threshold) {
            return 0;
        }
    }
    let range = widened::<REACH, 1>(&about(ABOUT));
    let mut found = 0;
    for row in 0..ROWS {
        let levels = row_about::<0, TILE_WIDTH_PX>(current, size_px, (top + ROW_STEP * row, left));
        let any = any_above(&beyond(&levels, &range), threshold);
        found |= u8::from(any) << row;
    }
    found
}

/// How far each pixel of a piece of a row is outside the range of levels that the references have within `reach_px` (2 to 4)
/// about it; whether any is by more than `threshold`.
#[inline(always)]
pub fn row_in_front(
    images: (&[u8], &[u8], &[u8]),
    size_px: (usize, usize),
    place: (usize, usize),
    (reach_px, threshold): (usize, u8),
    changes: &mut Piece,
) -> bool {
    *changes = match reach_px {
        0..=REACH_MIN_PX => changes_within::<REACH_MIN_PX>(images, size_px, place),
        3 => changes_within::<3>(images, size_px, place),
        _ => changes_within::<REACH_MAX_PX>(images, size_px, place),
    };
    any_above(changes, threshold)
}

#[inline(always)]
fn changes_within<const REACH: usize>(
    (current, one, other): (&[u8], &[u8], &[u8]),
    size_px: (usize, usize),
    (y, left): (usize, usize),
) -> Piece {
    let about = Rows {
        above: REACH,
        count: 2 * REACH + 1,
        step: 1,
    };
    let range = widened::<REACH, 1>(&range_about::<REACH>((one, other), size_px, (y, left), about));
    let levels = row_about::<0, TILE_WIDTH_PX>(current, size_px, (y, left));
    beyond(&levels, &range)
}

/// Asks for the memory that [`rows_in_front`] reads of most tiles, but for the row below, which is of another tile as a rule; of
/// one that is at `beside`, the place beside the tile asked for before, only what that one has not.
#[inline(always)]
pub fn fetch_tile(
    (current, one, other): (&[u8], &[u8], &[u8]),
    width_px: usize,
    (band, column): (usize, usize),
    beside: Option<(usize, usize)>,
) {
    let begin = (band * TILE_HEIGHT_PX * width_px + column * TILE_WIDTH_PX).saturating_sub(REACH_MAX_PX);
    for (image, step) in [(current, ROW_STEP), (one, SOME.step), (other, SOME.step)] {
        let Some(rows) = image.get(begin..) else { continue };
        // Rows are whole lines apart as a rule: all of them end in the line they begin in, or none does.
        let ends_in_next = rows.as_ptr().addr() % LINE_BYTES + LOOKED_PX > LINE_BYTES;
        for at in (0..TILE_HEIGHT_PX).step_by(step).map(|row| row * width_px) {
            if beside != Some((band, column)) {
                fetch_further(rows, at);
            }
            if ends_in_next {
                fetch_further(rows, at + LOOKED_PX - 1);
            }
        }
    }
}

/// Asks for the memory that [`row_in_front`] reads of these rows of a tile and [`rows_in_front`] has not.
#[inline(always)]
pub fn fetch_rows(
    (one, other): (&[u8], &[u8]),
    width_px: usize,
    (band, column): (usize, usize),
    (reach_px, rows): (usize, u8),
) {
    let (top, left) = (band * TILE_HEIGHT_PX, column * TILE_WIDTH_PX);
    let first = top + ROW_STEP * rows.trailing_zeros() as usize;
    let last = top + ROW_STEP * rows.checked_ilog2().unwrap_or(0) as usize;
    for y in first.saturating_sub(reach_px)..=last + reach_px {
        for image in [one, other] {
            fetch_ahead(image, y * width_px + left);
            fetch_ahead(image, y * width_px + left + TILE_WIDTH_PX - 1);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detection::dispatch::{Isa, Kernels};
    use proptest::prelude::*;

    const WIDTH: usize = 150;
    const HEIGHT: usize = 37;
    const SIZE: (usize, usize) = (WIDTH, HEIGHT);

    /// How far a pixel is outside the levels of two images in some rows and near columns.
    fn by_hand(
        (current, one, other): (&[u8], &[u8], &[u8]),
        (x, y): (usize, usize),
        rows: impl Iterator<Item = usize>,
        reach_px: usize,
    ) -> u8 {
        let around = x.saturating_sub(reach_px)..(x + reach_px + 1).min(WIDTH);
        let levels: Vec<u8> = rows
            .flat_map(|y| around.clone().map(move |x| y * WIDTH + x))
            .flat_map(|at| [one[at], other[at]])
            .collect();
        let (low, high) = (levels.iter().min().unwrap(), levels.iter().max().unwrap());
        let level = current[y * WIDTH + x];
        level.saturating_sub(*high).max(low.saturating_sub(level))
    }

    proptest! {
        #[test]
        fn what_is_in_front_is_what_is_found_by_hand(
            bytes in prop::collection::vec(any::<u8>(), 3 * WIDTH * HEIGHT), band in 0..5usize, column in 0..5usize,
            reach_px in 2..=4usize, threshold in 0..60u8,
        ) {
            let (current, rest) = bytes.split_at(WIDTH * HEIGHT);
            let (one, other) = rest.split_at(WIDTH * HEIGHT);
            // Fewer levels than there are: else nothing is outside the range of so many.
            let few = |image: &[u8]| image.iter().map(|v| 100 + v / 8).collect::<Vec<u8>>();
            let (one, other) = (few(one), few(other));
            let images = (current, one.as_slice(), other.as_slice());
            let (top, left) = (TILE_HEIGHT_PX * band, TILE_WIDTH_PX * column);
            let first = if band == 0 { 0 } else { top - ROW_STEP };
            let (mut rows, mut changes) = (0, [[0; TILE_WIDTH_PX]; ROWS]);
            for (row, changes) in changes.iter_mut().enumerate() {
                let y = top + ROW_STEP * row;
                for (x, change) in (left..WIDTH).zip(changes).filter(|_| y < HEIGHT) {
                    let of_tile = (first..HEIGHT.min(top + TILE_HEIGHT_PX + 1)).step_by(ROW_STEP);
                    let any = by_hand(images, (x, y), of_tile, reach_px) > threshold;
                    rows |= u8::from(any) << row;
                    let near = y.saturating_sub(reach_px)..(y + reach_px + 1).min(HEIGHT);
                    *change = by_hand(images, (x, y), near, reach_px);
                }
            }
            for isa in Isa::available() {
                let kernels = Kernels::new(*isa);
                let limits = (reach_px, threshold);
                let found = kernels.rows_in_front(images, SIZE, (band, column), limits);
                prop_assert_eq!(found, rows, "{:?}", isa);
                for (row, changes) in changes.iter().enumerate() {
                    let mut found = [7; TILE_WIDTH_PX];
                    let place = (top + ROW_STEP * row, left);
                    let any = kernels.row_in_front(images, SIZE, place, limits, &mut found);
                    prop_assert_eq!(&found, changes, "{:?}", isa);
                    prop_assert_eq!(any, changes.iter().any(|change| *change > threshold));
                }
            }
        }
    }
}
