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

/// The largest of every [`TILE_WIDTH_PX`] columns.
#[inline(always)]
pub fn tile_largest(column_max: &[u8], tile_max: &mut [u8]) {
    let mut tiles = column_max.chunks_exact(TILE_WIDTH_PX);
    let mut out = tile_max.iter_mut();
    for (tile, most) in tiles.by_ref().zip(out.by_ref()) {
        let mut lanes = [0u8; TILE_WIDTH_PX];
        lanes.copy_from_slice(tile);
        let mut width = TILE_WIDTH_PX / 2;
        while width > 0 {
            for i in 0..width {
                lanes[i] = lanes[i].max(lanes[i + width]);
            }
            width /= 2;
        }
        *most = lanes[0];
    }
    if let Some(most) = out.next() {
        *most = largest(tiles.remainder());
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

#[cfg(test)]
mod tests {
    use crate::detection::dispatch::{Isa, Kernels};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn every_instruction_set_gives_the_same_bits(
            bytes in prop::collection::vec(any::<u8>(), 3 * 8 * 97),
            width in 33..97usize, threshold in any::<u8>(), clip in any::<u8>(),
        ) {
            let size = 8 * width;
            let (c, a, b) = (&bytes[..size], &bytes[size..2 * size], &bytes[2 * size..3 * size]);
            let run = |isa: Isa| {
                let kernels = Kernels::new(isa);
                let mut columns = vec![7; width];
                kernels.band_change(c, a, &mut columns);
                let mut tiles = vec![0; width.div_ceil(32)];
                kernels.tile_largest(&columns, &mut tiles);
                let masks: Vec<u64> = c.chunks(32).zip(a.chunks(32)).zip(b.chunks(32))
                    .map(|((c, a), b)| kernels.change_mask(c, a, b, threshold)).collect();
                (columns, tiles, masks, kernels.clipped_change_sum(c, a, clip), kernels.read_both(c, a))
            };
            let portable = run(Isa::Portable);
            let by_hand = (0..width).map(|x| (0..8).map(|y| c[y * width + x].abs_diff(a[y * width + x])).max().unwrap());
            prop_assert!(portable.0.iter().copied().eq(by_hand));
            for isa in Isa::available() {
                prop_assert_eq!(&run(*isa), &portable, "{:?}", isa);
            }
        }
    }
}
