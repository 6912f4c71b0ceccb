//! Which tiles of a frame changed: one bit per tile, rows of tiles padded to whole words.

use super::kernel::{TILE_HEIGHT_PX, TILE_WIDTH_PX};

/// One bit per tile of [`TILE_WIDTH_PX`] × [`TILE_HEIGHT_PX`] pixels.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TileMap {
    words_per_band: usize,
    words: Vec<u64>,
}

impl TileMap {
    /// An empty map for an image of this size.
    pub fn new(width_px: usize, height_px: usize) -> Self {
        let words_per_band = width_px.div_ceil(TILE_WIDTH_PX).div_ceil(64);
        Self {
            words_per_band,
            words: vec![0; words_per_band * height_px.div_ceil(TILE_HEIGHT_PX)],
        }
    }

    /// Clears every bit.
    pub fn clear(&mut self) {
        self.words.fill(0);
    }

    /// The words of the bands from one on.
    pub fn words_from(&mut self, band: usize) -> &mut [u64] {
        self.words
            .get_mut(band * self.words_per_band..)
            .unwrap_or_default()
    }

    /// Sets one tile.
    #[cfg(test)]
    pub fn set(&mut self, band: usize, column: usize) {
        if let Some(word) = self.words.get_mut(band * self.words_per_band + column / 64) {
            *word |= 1 << (column % 64);
        }
    }

    /// Moves the tiles of one band from one column to another here.
    pub fn take_from(&mut self, from: &mut TileMap, band: usize, (first, last): (usize, usize)) {
        let begin = band * self.words_per_band;
        let all = begin..begin + self.words_per_band;
        let (Some(here), Some(there)) = (self.words.get_mut(all.clone()), from.words.get_mut(all)) else {
            return;
        };
        for (i, (here, there)) in here.iter_mut().zip(there).enumerate() {
            let from = |column: usize| match column.saturating_sub(64 * i) {
                bit @ 0..64 => u64::MAX << bit,
                _ => 0,
            };
            let moved = *there & from(first) & !from(last + 1);
            *here |= moved;
            *there &= !moved;
        }
    }

    /// Makes this the tiles set in both, or in the one that is there.
    pub fn set_both(&mut self, one: Option<&TileMap>, other: Option<&TileMap>) {
        match (one, other) {
            (Some(a), Some(b)) => {
                for ((word, a), b) in self.words.iter_mut().zip(&a.words).zip(&b.words) {
                    *word = a & b;
                }
            }
            (Some(a), None) | (None, Some(a)) => self.words.copy_from_slice(&a.words),
            (None, None) => self.clear(),
        }
    }

    /// Tiles set.
    pub fn count(&self) -> usize {
        self.words.iter().map(|w| w.count_ones() as usize).sum()
    }

    /// The bands with tiles set, rising.
    pub fn bands(&self) -> impl Iterator<Item = usize> + '_ {
        let bands = self.words.chunks(self.words_per_band.max(1)).enumerate();
        bands
            .filter(|(_, words)| words.iter().any(|word| *word != 0))
            .map(|(band, _)| band)
    }

    /// Columns of the tiles set in one band, rising.
    pub fn columns(&self, band: usize) -> impl Iterator<Item = usize> + '_ {
        let begin = band * self.words_per_band;
        let words = self.words.get(begin..begin + self.words_per_band).unwrap_or(&[]);
        words.iter().enumerate().flat_map(|(i, word)| {
            let mut rest = *word;
            std::iter::from_fn(move || {
                (rest != 0).then(|| {
                    let bit = rest.trailing_zeros() as usize;
                    rest &= rest - 1;
                    i * 64 + bit
                })
            })
        })
    }
}
