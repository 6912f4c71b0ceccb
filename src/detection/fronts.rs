//! The loop over the tiles of a body that moves: which of their rows may hold something in front of it, outside the range
//! of levels that the body has about there shortly before and after.
//! Plain safe code on bytes, compiled once per instruction set by [`super::dispatch`].
//!
//! A first look for [`super::movers`], which decides pixel by pixel. Every second row is read.

use super::dispatch::fetch_ahead;
use super::kernel::{TILE_HEIGHT_PX, TILE_WIDTH_PX};

/// Rows from one that is read to the next.
pub const ROW_STEP: usize = 2;
/// Most pixels beside a place whose range is taken.
pub const REACH_MAX_PX: usize = 4;
/// Most tiles that are looked at in one go.
pub const TILES_MAX: usize = 8;
/// Rows read of a tile.
const ROWS: usize = TILE_HEIGHT_PX / ROW_STEP;
/// Columns at the end of a row of tiles, beyond whole tiles, whose range is needed.
const END_PX: usize = 2 * REACH_MAX_PX;
/// Bytes that come from memory together.
const LINE_BYTES: usize = 64;
/// Columns whose range is held.
const HELD_PX: usize = (TILES_MAX + 1) * TILE_WIDTH_PX;

type Piece = [u8; TILE_WIDTH_PX];

/// Some tiles side by side.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TileRun {
    /// Band of tiles.
    pub band: usize,
    /// The first column of tiles.
    pub column: usize,
    /// Tiles, at most [`TILES_MAX`].
    pub tiles: usize,
}

/// For each tile of a run its rows, counted from the top by [`ROW_STEP`], in which some pixel is outside the range of levels
/// that the references have within `reach_px` beside it and in the tile's rows, by more than `threshold`: bits.
#[inline(always)]
pub fn rows_in_front(
    (current, one, other): (&[u8], &[u8], &[u8]),
    (width_px, height_px): (usize, usize),
    run: TileRun,
    (reach_px, threshold): (usize, u8),
) -> [u8; TILES_MAX] {
    let mut found = [0; TILES_MAX];
    let tiles = run.tiles.min(TILES_MAX);
    let reach_px = reach_px.min(REACH_MAX_PX);
    let (mut highest, mut lowest) = ([0u8; HELD_PX], [u8::MAX; HELD_PX]);
    let top = run.band * TILE_HEIGHT_PX;
    let left = run.column * TILE_WIDTH_PX;
    // The tile's rows, and the next ones above and below.
    let first = top.checked_sub(ROW_STEP).unwrap_or(top);
    let rows = (first..height_px.min(top + TILE_HEIGHT_PX + 1)).step_by(ROW_STEP);
    let (wholes, _) = highest.as_chunks_mut::<TILE_WIDTH_PX>();
    let (whole_lows, _) = lowest.as_chunks_mut::<TILE_WIDTH_PX>();
    for (piece, (high, low)) in wholes.iter_mut().zip(whole_lows).enumerate().take(tiles + 1) {
        let Some(begin) = (left + piece * TILE_WIDTH_PX).checked_sub(reach_px) else {
            // Of the columns before the image's first there is no level.
            for i in reach_px..TILE_WIDTH_PX {
                let x = i - reach_px;
                for at in rows.clone().map(|y| y * width_px + x) {
                    widen(&mut high[i], &mut low[i], (one.get(at), other.get(at)));
                }
            }
            continue;
        };
        let wanted = if piece == tiles { END_PX } else { TILE_WIDTH_PX };
        if begin + wanted > width_px {
            for (i, x) in (begin..width_px).enumerate() {
                for at in rows.clone().map(|y| y * width_px + x) {
                    widen(&mut high[i], &mut low[i], (one.get(at), other.get(at)));
                }
            }
        } else if piece == tiles {
            range_of::<END_PX>(
                (one, other),
                rows.clone().map(|y| y * width_px + begin),
                high,
                low,
            );
        } else {
            range_of::<TILE_WIDTH_PX>(
                (one, other),
                rows.clone().map(|y| y * width_px + begin),
                high,
                low,
            );
        }
    }
    for (tile, found) in found.iter_mut().enumerate().take(tiles) {
        let (mut high, mut low) = ([0u8; TILE_WIDTH_PX], [u8::MAX; TILE_WIDTH_PX]);
        for step in 0..=2 * reach_px {
            let from = tile * TILE_WIDTH_PX + step;
            let (Some(highs), Some(lows)) = (
                highest.get(from..from + TILE_WIDTH_PX),
                lowest.get(from..from + TILE_WIDTH_PX),
            ) else {
                continue;
            };
            for i in 0..TILE_WIDTH_PX {
                high[i] = high[i].max(highs[i]);
                low[i] = low[i].min(lows[i]);
            }
        }
        for row in 0..ROWS {
            let (y, x) = (top + ROW_STEP * row, left + tile * TILE_WIDTH_PX);
            let from = y * width_px + x;
            let length = TILE_WIDTH_PX.min(width_px.saturating_sub(x));
            let levels = current.get(from..from + length).filter(|_| y < height_px);
            let Some(levels) = levels else { continue };
            let beyond = match <&Piece>::try_from(levels) {
                Ok(levels) => any_beyond(levels, &high, &low, threshold),
                Err(_) => levels
                    .iter()
                    .zip(high.iter().zip(&low))
                    .any(|(level, (high, low))| {
                        level.saturating_sub(*high).max(low.saturating_sub(*level)) > threshold
                    }),
            };
            *found |= u8::from(beyond) << row;
        }
    }
    found
}

/// Asks for the memory of a run that is looked at soon.
#[inline(always)]
pub fn fetch_run((current, one, other): (&[u8], &[u8], &[u8]), width_px: usize, run: TileRun) {
    let (top, left) = (run.band * TILE_HEIGHT_PX, run.column * TILE_WIDTH_PX);
    let right = left + run.tiles.min(TILES_MAX) * TILE_WIDTH_PX + REACH_MAX_PX;
    for y in (top.saturating_sub(ROW_STEP)..top + TILE_HEIGHT_PX + 1).step_by(ROW_STEP) {
        for x in (left..right).step_by(LINE_BYTES).chain(Some(right)) {
            fetch_ahead(one, y * width_px + x);
            fetch_ahead(other, y * width_px + x);
            if (top..top + TILE_HEIGHT_PX).contains(&y) {
                fetch_ahead(current, y * width_px + x);
            }
        }
    }
}

/// Widens a range by a level of each reference, where there is one.
#[inline(always)]
fn widen(high: &mut u8, low: &mut u8, (one, other): (Option<&u8>, Option<&u8>)) {
    for level in one.into_iter().chain(other) {
        *high = (*high).max(*level);
        *low = (*low).min(*level);
    }
}

/// The range of both references, column by column, over rows that begin at the places given.
#[inline(always)]
fn range_of<const WIDTH: usize>(
    (one, other): (&[u8], &[u8]),
    begins: impl Iterator<Item = usize>,
    high: &mut Piece,
    low: &mut Piece,
) {
    let (mut highest, mut lowest) = ([0u8; WIDTH], [u8::MAX; WIDTH]);
    for begin in begins {
        let whole = |all: &'_ [u8]| -> Option<[u8; WIDTH]> { all.get(begin..begin + WIDTH)?.try_into().ok() };
        let (Some(a), Some(b)) = (whole(one), whole(other)) else {
            continue;
        };
        for i in 0..WIDTH {
            highest[i] = highest[i].max(a[i]).max(b[i]);
            lowest[i] = lowest[i].min(a[i]).min(b[i]);
        }
    }
    high[..WIDTH].copy_from_slice(&highest);
    low[..WIDTH].copy_from_slice(&lowest);
}

/// Whether any level is outside its range.
#[inline(always)]
fn any_beyond(levels: &Piece, high: &Piece, low: &Piece, threshold: u8) -> bool {
    let mut over = [0u8; TILE_WIDTH_PX];
    for i in 0..TILE_WIDTH_PX {
        let change = levels[i]
            .saturating_sub(high[i])
            .max(low[i].saturating_sub(levels[i]));
        over[i] = change.saturating_sub(threshold);
    }
    over.iter().fold(0, |any, over| any | over) != 0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detection::dispatch::{Isa, Kernels};
    use proptest::prelude::*;

    const WIDTH: usize = 150;
    const HEIGHT: usize = 37;

    proptest! {
        #[test]
        fn rows_in_front_are_those_found_by_hand(
            bytes in prop::collection::vec(any::<u8>(), 3 * WIDTH * HEIGHT), band in 0..5usize, column in 0..5usize,
            tiles in 1..=5usize, reach_px in 2..=4usize, threshold in 0..60u8,
        ) {
            let (current, rest) = bytes.split_at(WIDTH * HEIGHT);
            let (one, other) = rest.split_at(WIDTH * HEIGHT);
            // Fewer levels than there are: else nothing is outside the range of so many.
            let few = |image: &[u8]| image.iter().map(|v| 100 + v / 8).collect::<Vec<u8>>();
            let (one, other) = (few(one), few(other));
            let run = TileRun { band, column, tiles: tiles.min(5 - column) };
            let mut by_hand = [0u8; TILES_MAX];
            for (tile, found) in by_hand.iter_mut().enumerate().take(run.tiles) {
                for row in 0..ROWS {
                    let y = TILE_HEIGHT_PX * band + ROW_STEP * row;
                    let left = (column + tile) * TILE_WIDTH_PX;
                    let first = (TILE_HEIGHT_PX * band).saturating_sub(if band == 0 { 0 } else { ROW_STEP });
                    let beyond = (left..(left + TILE_WIDTH_PX).min(WIDTH)).filter(|_| y < HEIGHT).any(|x| {
                        let rows = (first..HEIGHT.min(TILE_HEIGHT_PX * (band + 1) + 1)).step_by(ROW_STEP);
                        let around = x.saturating_sub(reach_px)..(x + reach_px + 1).min(WIDTH);
                        let levels: Vec<u8> = rows.flat_map(|y| around.clone().map(move |x| y * WIDTH + x))
                            .flat_map(|at| [one[at], other[at]]).collect();
                        let (low, high) = (levels.iter().min().unwrap(), levels.iter().max().unwrap());
                        let level = current[y * WIDTH + x];
                        level.saturating_sub(*high).max(low.saturating_sub(level)) > threshold
                    });
                    *found |= u8::from(beyond) << row;
                }
            }
            for isa in Isa::available() {
                let found = Kernels::new(*isa)
                    .rows_in_front((current, &one, &other), (WIDTH, HEIGHT), run, (reach_px, threshold));
                prop_assert_eq!(found, by_hand, "{:?}", isa);
            }
        }
    }
}
