//! Pixels of ten and twelve bits as cameras send them, and their upper eight bits.
//!
//! Names and layouts are those of the Pixel Format Naming Convention (`…p`: little-endian bit stream) and of GigE Vision
//! (`…Packed`: two pixels in three bytes, the low bits of both in the middle one).

/// How a camera packs its pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Packing {
    /// Ten bits each, four pixels in five bytes.
    Mono10p,
    /// Twelve bits each, two pixels in three bytes.
    Mono12p,
    /// Ten bits each, two pixels in three bytes.
    Mono10Packed,
    /// Twelve bits each, two pixels in three bytes.
    Mono12Packed,
    /// Ten bits in two bytes, little-endian.
    Mono10,
    /// Twelve bits in two bytes, little-endian.
    Mono12,
}

impl Packing {
    /// Pixels that are packed together, and the bytes they take.
    pub fn group(self) -> (usize, usize) {
        match self {
            Self::Mono10p => (4, 5),
            Self::Mono12p | Self::Mono10Packed | Self::Mono12Packed => (2, 3),
            Self::Mono10 | Self::Mono12 => (1, 2),
        }
    }

    /// Bytes of this many pixels, rows one after the other without padding.
    pub fn bytes(self, pixels: usize) -> usize {
        let (group, bytes) = self.group();
        pixels.div_ceil(group) * bytes
    }
}

/// The upper eight bits of each pixel. Pixels that `packed` lacks stay as they are.
#[inline(always)]
pub fn unpack(packing: Packing, packed: &[u8], levels: &mut [u8]) {
    match packing {
        Packing::Mono10p => groups(packed, levels, |[a, b, c, d, e]: [u8; 5]| {
            [a >> 2 | b << 6, b >> 4 | c << 4, c >> 6 | d << 2, e]
        }),
        Packing::Mono12p => groups(packed, levels, |[a, b, c]: [u8; 3]| [a >> 4 | b << 4, c]),
        Packing::Mono10Packed | Packing::Mono12Packed => {
            groups(packed, levels, |[a, _, c]: [u8; 3]| [a, c]);
        }
        Packing::Mono10 => groups(packed, levels, |[a, b]: [u8; 2]| [a >> 2 | b << 6]),
        Packing::Mono12 => groups(packed, levels, |[a, b]: [u8; 2]| [a >> 4 | b << 4]),
    }
}

/// Whole groups, and the last pixels of a group that is not needed in full.
#[inline(always)]
fn groups<const BYTES: usize, const PIXELS: usize>(
    packed: &[u8],
    levels: &mut [u8],
    group: impl Fn([u8; BYTES]) -> [u8; PIXELS],
) {
    let (from, _) = packed.as_chunks::<BYTES>();
    let (to, rest) = levels.as_chunks_mut::<PIXELS>();
    for (to, from) in to.iter_mut().zip(from) {
        *to = group(*from);
    }
    if let Some(from) = from.get(to.len()) {
        for (to, level) in rest.iter_mut().zip(group(*from)) {
            *to = level;
        }
    }
}

#[cfg(test)]
pub mod tests {
    use super::*;
    use crate::detection::dispatch::{Isa, Kernels};
    use proptest::prelude::*;

    /// Packs bit by bit, as the standards' figures show it.
    pub fn pack(packing: Packing, values: &[u16]) -> Vec<u8> {
        let stream = |bits: usize| {
            let mut out = vec![0u8; (values.len() * bits).div_ceil(8)];
            for (i, value) in values.iter().enumerate() {
                for bit in (0..bits).filter(|bit| value >> bit & 1 == 1) {
                    out[(i * bits + bit) / 8] |= 1 << ((i * bits + bit) % 8);
                }
            }
            out.resize(packing.bytes(values.len()), 0);
            out
        };
        let threes = |bits: u32| {
            let low = bits - 8;
            let mask = (1 << low) - 1;
            let pairs = values
                .chunks(2)
                .map(|pair| (pair[0], pair.get(1).copied().unwrap_or(0)));
            pairs
                .flat_map(|(p, q)| {
                    [
                        (p >> low) as u8,
                        (p & mask | (q & mask) << 4) as u8,
                        (q >> low) as u8,
                    ]
                })
                .collect()
        };
        match packing {
            Packing::Mono10p => stream(10),
            Packing::Mono12p => stream(12),
            Packing::Mono10Packed => threes(10),
            Packing::Mono12Packed => threes(12),
            Packing::Mono10 | Packing::Mono12 => values.iter().flat_map(|v| v.to_le_bytes()).collect(),
        }
    }

    pub const ALL: [(Packing, u32); 6] = [
        (Packing::Mono10p, 10),
        (Packing::Mono12p, 12),
        (Packing::Mono10Packed, 10),
        (Packing::Mono12Packed, 12),
        (Packing::Mono10, 10),
        (Packing::Mono12, 12),
    ];

    proptest! {
        #[test]
        fn every_packing_gives_its_upper_bits(values in prop::collection::vec(any::<u16>(), 0..300)) {
            for (packing, bits) in ALL {
                let values: Vec<u16> = values.iter().map(|v| v >> (16 - bits)).collect();
                let packed = pack(packing, &values);
                prop_assert_eq!(packed.len(), packing.bytes(values.len()));
                let expected: Vec<u8> = values.iter().map(|v| (v >> (bits - 8)) as u8).collect();
                for isa in Isa::available() {
                    let mut levels = vec![0; values.len()];
                    Kernels::new(*isa).unpack(packing, &packed, &mut levels);
                    prop_assert_eq!(&levels, &expected, "{:?} {:?}", packing, isa);
                }
            }
        }
    }
}
