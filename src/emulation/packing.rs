//! Eight-bit images as a camera of ten or twelve bits sends them.

use crate::scene::PixelFormat;

/// The image in this format. Its levels are the upper eight bits; the lower ones repeat the topmost, so that black stays
/// black and white white.
pub fn pack(format: PixelFormat, levels: &[u8]) -> Vec<u8> {
    let ten = |level: u8| u64::from(level) << 2 | u64::from(level) >> 6;
    let twelve = |level: u8| u64::from(level) << 4 | u64::from(level) >> 4;
    let mut packed = Vec::with_capacity(format.bytes(levels.len()));
    match format {
        PixelFormat::Mono8 => packed.extend_from_slice(levels),
        PixelFormat::Mono10p => groups(levels, &mut packed, |[a, b, c, d]: [u8; 4]| {
            let [a, b, c, d, e, ..] = (ten(a) | ten(b) << 10 | ten(c) << 20 | ten(d) << 30).to_le_bytes();
            [a, b, c, d, e]
        }),
        PixelFormat::Mono12p => groups(levels, &mut packed, |[a, b]: [u8; 2]| {
            let [a, b, c, ..] = (twelve(a) | twelve(b) << 12).to_le_bytes();
            [a, b, c]
        }),
        PixelFormat::Mono10Packed => groups(levels, &mut packed, |[a, b]: [u8; 2]| {
            [a, (ten(a) & 3 | (ten(b) & 3) << 4) as u8, b]
        }),
        PixelFormat::Mono12Packed => groups(levels, &mut packed, |[a, b]: [u8; 2]| {
            [a, (twelve(a) & 15 | (twelve(b) & 15) << 4) as u8, b]
        }),
        PixelFormat::Mono10 => groups(levels, &mut packed, |[a]: [u8; 1]| (ten(a) as u16).to_le_bytes()),
        PixelFormat::Mono12 => groups(levels, &mut packed, |[a]: [u8; 1]| {
            (twelve(a) as u16).to_le_bytes()
        }),
    }
    packed
}

/// Group by group; the last is filled with black.
fn groups<const PIXELS: usize, const BYTES: usize>(
    levels: &[u8],
    packed: &mut Vec<u8>,
    group: impl Fn([u8; PIXELS]) -> [u8; BYTES],
) {
    let (whole, rest) = levels.as_chunks::<PIXELS>();
    packed.extend(whole.iter().flat_map(|pixels| group(*pixels)));
    if !rest.is_empty() {
        let mut last = [0; PIXELS];
        for (to, from) in last.iter_mut().zip(rest) {
            *to = *from;
        }
        packed.extend(group(last));
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::detection::UnpackedFrames;
    use crate::scene::{FrameStamp, RawFrame};
    use crate::time::StampedMidpoint;

    #[test]
    fn bytes_are_those_of_the_standards() {
        // 0xab is 0xaba of twelve bits and 0x2ae of ten, 0x12 is 0x121 and 0x048.
        for (format, packed) in [
            (PixelFormat::Mono8, &[0xab, 0x12][..]),
            (PixelFormat::Mono12p, &[0xba, 0x1a, 0x12]),
            (PixelFormat::Mono12Packed, &[0xab, 0x1a, 0x12]),
            (PixelFormat::Mono10Packed, &[0xab, 0x02, 0x12]),
            // 0x2ae | 0x048 << 10, low byte first.
            (PixelFormat::Mono10p, &[0xae, 0x22, 0x01, 0x00, 0x00]),
            (PixelFormat::Mono12, &[0xba, 0x0a, 0x21, 0x01]),
            (PixelFormat::Mono10, &[0xae, 0x02, 0x48, 0x00]),
        ] {
            assert_eq!(pack(format, &[0xab, 0x12]), packed, "{format}");
        }
    }

    #[test]
    fn what_is_packed_is_unpacked_to_the_same_levels() {
        let levels: Vec<u8> = (0..15 * 17).map(|i| (i * 7 % 256) as u8).collect();
        for format in PixelFormat::ALL {
            let packed = pack(format, &levels);
            assert_eq!(packed.len(), format.bytes(levels.len()), "{format}");
            let raw = RawFrame {
                stamp: FrameStamp {
                    frame: 1,
                    device: None,
                    arrival: None,
                    stamped: StampedMidpoint::from_nanos(0),
                },
                width_px: 15,
                height_px: 17,
                format,
                pixels: Arc::new(packed),
            };
            let image = UnpackedFrames::default().image(&raw).unwrap();
            assert_eq!(image.bytes(), levels, "{format}");
        }
    }
}
