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

/// A scale of 1 of [`even_row`], which are below 4, and a level of its offsets.
pub const EVEN_UNIT: u16 = 1 << 10;
pub const EVEN_HALF: i16 = 2;

/// What [`even_row`] makes of a level: `scale` times it, and `offset` more.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Evening {
    /// In parts of [`EVEN_UNIT`].
    pub scale: u16,
    /// In parts of [`EVEN_HALF`], within ±1024.
    pub offset: i16,
}

impl Evening {
    /// Levels stay as they are.
    pub const NONE: Self = Self {
        scale: EVEN_UNIT,
        offset: 0,
    };
}

/// A row whose pieces of `length` pixels are evened by one each, rounded.
#[inline(always)]
pub fn even_row(row: &[u8], length: usize, evenings: &[Evening], even: &mut [u8]) {
    let pieces = row.chunks(length.max(1)).zip(even.chunks_mut(length.max(1)));
    for ((piece, even), evening) in pieces.zip(evenings) {
        if *evening == Evening::NONE {
            even.copy_from_slice(piece);
            continue;
        }
        let (scale, offset) = (u32::from(evening.scale), evening.offset.clamp(-1024, 1024));
        for (even, level) in even.iter_mut().zip(piece) {
            // Twice the level that is sought: the last bit rounds.
            let twice = ((u32::from(u16::from(*level) << 7) * scale) >> 16) as i16;
            *even = ((twice + offset + 1) >> 1).clamp(0, 255) as u8;
        }
    }
}
