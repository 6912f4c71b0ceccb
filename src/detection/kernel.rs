//! The loops that touch every pixel: plain safe code, compiled once per instruction set by [`super::dispatch`].
//!
//! All arithmetic is on bytes with saturation, so every instruction set gives the same bits.

/// Columns of a tile.
pub const TILE_WIDTH_PX: usize = 32;
/// Rows of a tile.
pub const TILE_HEIGHT_PX: usize = 8;

/// Per column, the largest |current − previous| over the rows of one band (up to [`TILE_HEIGHT_PX`] rows).
/// `column_max` has the image's width.
#[inline(always)]
pub fn band_change(current: &[u8], previous: &[u8], column_max: &mut [u8]) {
    let width = column_max.len();
    column_max.fill(0);
    for (c_row, p_row) in current.chunks_exact(width).zip(previous.chunks_exact(width)) {
        for ((most, c), p) in column_max.iter_mut().zip(c_row).zip(p_row) {
            *most = (*most).max(c.abs_diff(*p));
        }
    }
}

/// Sum of min(|current − previous|, clip).
#[inline(always)]
pub fn clipped_change_sum(current: &[u8], previous: &[u8], clip: u8) -> u32 {
    current
        .iter()
        .zip(previous)
        .map(|(c, p)| u32::from(c.abs_diff(*p).min(clip)))
        .sum()
}

/// Largest byte.
#[inline(always)]
pub fn largest(bytes: &[u8]) -> u8 {
    bytes.iter().fold(0, |most, b| most.max(*b))
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
    for (i, flag) in flags.iter().enumerate() {
        mask |= u64::from(*flag) << i;
    }
    mask
}

/// Change of one pixel against both references: the smaller of the two when they agree in sign, else 0.
#[inline(always)]
pub fn change(current: u8, before: u8, after: u8) -> u8 {
    let brighter = current.saturating_sub(before.max(after));
    let darker = before.min(after).saturating_sub(current);
    brighter.max(darker)
}
