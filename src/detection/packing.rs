//! Pixels of ten and twelve bits to their upper eight bits.

use crate::scene::PixelFormat;

/// The upper eight bits of each pixel. Pixels that `packed` lacks stay as they are.
#[inline(always)]
pub fn unpack(format: PixelFormat, packed: &[u8], levels: &mut [u8]) {
    match format {
        PixelFormat::Mono8 => groups((packed, levels), |level: [u8; 1]| level),
        PixelFormat::Mono10p => groups(
            fours::<5>((packed, levels), [2, 4, 6, 8]),
            |[a, b, c, d, e]: [u8; 5]| [a >> 2 | b << 6, b >> 4 | c << 4, c >> 6 | d << 2, e],
        ),
        PixelFormat::Mono12p => groups(
            fours::<6>((packed, levels), [4, 8, 12, 16]),
            |[a, b, c]: [u8; 3]| [a >> 4 | b << 4, c],
        ),
        PixelFormat::Mono10Packed | PixelFormat::Mono12Packed => groups(
            fours::<6>((packed, levels), [0, 8, 8, 16]),
            |[a, _, c]: [u8; 3]| [a, c],
        ),
        PixelFormat::Mono10 => groups((packed, levels), |[a, b]: [u8; 2]| [a >> 2 | b << 6]),
        PixelFormat::Mono12 => groups((packed, levels), |[a, b]: [u8; 2]| [a >> 4 | b << 4]),
    }
}

/// Four pixels at a time out of a word of eight bytes, `BYTES` of which are theirs: level k is the word's bits from
/// 8k + `shifts[k]` on. Answers what is left: the last bytes make no whole word. Byte by byte it takes four times as long.
#[inline(always)]
fn fours<'a, const BYTES: usize>(
    (packed, levels): (&'a [u8], &'a mut [u8]),
    shifts: [u32; 4],
) -> (&'a [u8], &'a mut [u8]) {
    let mut done = 0;
    for to in levels.as_chunks_mut::<4>().0 {
        let Some(word) = packed.get(done * BYTES..).and_then(|rest| rest.first_chunk()) else {
            break;
        };
        let word = u64::from_le_bytes(*word);
        let [a, b, c, d] = shifts.map(|shift| word >> shift);
        let four = a & 0xff | b & 0xff00 | c & 0x00ff_0000 | d & 0xff00_0000;
        *to = (four as u32).to_le_bytes();
        done += 1;
    }
    let left = packed.get(done * BYTES..).unwrap_or_default();
    (left, levels.get_mut(4 * done..).unwrap_or_default())
}

/// Whole groups, and the last pixels of a group that is not needed in full.
#[inline(always)]
fn groups<const BYTES: usize, const PIXELS: usize>(
    (packed, levels): (&[u8], &mut [u8]),
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
    pub fn pack(format: PixelFormat, values: &[u16]) -> Vec<u8> {
        let stream = |bits: usize| {
            let mut out = vec![0u8; (values.len() * bits).div_ceil(8)];
            for (i, value) in values.iter().enumerate() {
                for bit in (0..bits).filter(|bit| value >> bit & 1 == 1) {
                    out[(i * bits + bit) / 8] |= 1 << ((i * bits + bit) % 8);
                }
            }
            out.resize(format.bytes(values.len()), 0);
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
        match format {
            PixelFormat::Mono8 => values.iter().map(|v| *v as u8).collect(),
            PixelFormat::Mono10p => stream(10),
            PixelFormat::Mono12p => stream(12),
            PixelFormat::Mono10Packed => threes(10),
            PixelFormat::Mono12Packed => threes(12),
            PixelFormat::Mono10 | PixelFormat::Mono12 => {
                values.iter().flat_map(|v| v.to_le_bytes()).collect()
            }
        }
    }

    pub const ALL: [(PixelFormat, u32); 6] = [
        (PixelFormat::Mono10p, 10),
        (PixelFormat::Mono12p, 12),
        (PixelFormat::Mono10Packed, 10),
        (PixelFormat::Mono12Packed, 12),
        (PixelFormat::Mono10, 10),
        (PixelFormat::Mono12, 12),
    ];

    #[test]
    fn bytes_are_those_of_the_standards() {
        // Pixels 0xabc and 0x123 of twelve bits; 0x2af, 0x05b, 0x3c1 and 0x16e of ten (their eights: ab, 16, f0, 5b).
        for (format, packed, levels) in [
            (PixelFormat::Mono8, &[0xab, 0x12][..], &[0xab, 0x12][..]),
            // PFNC: p0 bits 0–7 | p0 bits 8–11 low, p1 bits 0–3 high | p1 bits 4–11.
            (PixelFormat::Mono12p, &[0xbc, 0x3a, 0x12], &[0xab, 0x12]),
            // GigE Vision: p0 bits 4–11 | p0 bits 0–3 low, p1 bits 0–3 high | p1 bits 4–11.
            (PixelFormat::Mono12Packed, &[0xab, 0x3c, 0x12], &[0xab, 0x12]),
            // p0 bits 2–9 | p0 bits 0–1 at 0, p1 bits 0–1 at 4 | p1 bits 2–9.
            (PixelFormat::Mono10Packed, &[0xab, 0x33, 0x16], &[0xab, 0x16]),
            // Ten bits after ten bits: 0x2af | 0x05b << 10 | 0x3c1 << 20 | 0x16e << 30, low byte first.
            (
                PixelFormat::Mono10p,
                &[0xaf, 0x6e, 0x11, 0xbc, 0x5b],
                &[0xab, 0x16, 0xf0, 0x5b],
            ),
            (PixelFormat::Mono12, &[0xbc, 0x0a, 0x23, 0x01], &[0xab, 0x12]),
            (PixelFormat::Mono10, &[0xaf, 0x02, 0x5b, 0x00], &[0xab, 0x16]),
        ] {
            let mut unpacked = vec![0; levels.len()];
            unpack(format, packed, &mut unpacked);
            assert_eq!(unpacked, levels, "{format}");
        }
    }

    proptest! {
        #[test]
        fn every_packing_gives_its_upper_bits(values in prop::collection::vec(any::<u16>(), 0..300)) {
            for (format, bits) in ALL {
                let values: Vec<u16> = values.iter().map(|v| v >> (16 - bits)).collect();
                let packed = pack(format, &values);
                prop_assert_eq!(packed.len(), format.bytes(values.len()));
                let expected: Vec<u8> = values.iter().map(|v| (v >> (bits - 8)) as u8).collect();
                for isa in Isa::available() {
                    let mut levels = vec![0; values.len()];
                    Kernels::new(*isa).unpack(format, &packed, &mut levels);
                    prop_assert_eq!(&levels, &expected, "{:?} {:?}", format, isa);
                }
            }
        }
    }
}
