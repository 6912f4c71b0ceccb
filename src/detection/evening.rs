//! The loops that tell the light of tiles and even it ([`super::light`]), compiled as those of [`super::kernel`].

use super::kernel::TILE_WIDTH_PX;

/// Adds the levels of a row of two images to the sums of its tiles.
#[inline(always)]
pub fn add_tile_sums((one, other): (&[u8], &[u8]), sums: &mut [[u32; 2]]) {
    let tiles = one.chunks(TILE_WIDTH_PX).zip(other.chunks(TILE_WIDTH_PX));
    for ((a, b), [sum_a, sum_b]) in tiles.zip(sums) {
        *sum_a += tile_sum(a);
        *sum_b += tile_sum(b);
    }
}

#[inline(always)]
fn tile_sum(levels: &[u8]) -> u32 {
    match <&[u8; TILE_WIDTH_PX]>::try_from(levels) {
        Ok(levels) => levels.iter().map(|level| u32::from(*level)).sum(),
        Err(_) => levels.iter().map(|level| u32::from(*level)).sum(),
    }
}

/// A scale of 1 of [`even_row`], which are below 4.
pub const EVEN_UNIT: u16 = 1 << 10;

/// A row whose pieces of `length` pixels are multiplied by a scale each, in parts of [`EVEN_UNIT`], rounded.
#[inline(always)]
pub fn even_row(row: &[u8], length: usize, scales: &[u16], even: &mut [u8]) {
    let pieces = row.chunks(length.max(1)).zip(even.chunks_mut(length.max(1)));
    for ((piece, even), scale) in pieces.zip(scales) {
        if *scale == EVEN_UNIT {
            even.copy_from_slice(piece);
            continue;
        }
        for (even, level) in even.iter_mut().zip(piece) {
            // Twice the level that is sought: the last bit rounds.
            let twice = ((u32::from(u16::from(*level) << 7) * u32::from(*scale)) >> 16) as u16;
            *even = ((twice + 1) >> 1).min(255) as u8;
        }
    }
}
