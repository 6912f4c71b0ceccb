//! How cameras send their pixels: names, numbers and layouts.
//!
//! They are those of the Pixel Format Naming Convention (`…p`: a bit stream, low bits first) and of GigE Vision (`…Packed`:
//! two pixels in three bytes, the low bits of both in the middle one). All of the detector's work is on the upper eight bits.

/// A monochrome pixel format. Rows follow each other without padding.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum PixelFormat {
    /// Eight bits each.
    #[default]
    Mono8,
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

impl PixelFormat {
    /// All of them.
    pub const ALL: [Self; 7] = [
        Self::Mono8,
        Self::Mono10p,
        Self::Mono12p,
        Self::Mono10Packed,
        Self::Mono12Packed,
        Self::Mono10,
        Self::Mono12,
    ];

    /// Its name in the convention, as cameras and configuration files have it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Mono8 => "Mono8",
            Self::Mono10p => "Mono10p",
            Self::Mono12p => "Mono12p",
            Self::Mono10Packed => "Mono10Packed",
            Self::Mono12Packed => "Mono12Packed",
            Self::Mono10 => "Mono10",
            Self::Mono12 => "Mono12",
        }
    }

    /// Its number in the convention, as cameras and stream packets have it.
    pub fn code(self) -> u32 {
        match self {
            Self::Mono8 => 0x0108_0001,
            Self::Mono10p => 0x010a_0046,
            Self::Mono12p => 0x010c_0047,
            Self::Mono10Packed => 0x010c_0004,
            Self::Mono12Packed => 0x010c_0006,
            Self::Mono10 => 0x0110_0003,
            Self::Mono12 => 0x0110_0005,
        }
    }

    /// The one of this name.
    pub fn of_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|format| format.name() == name)
    }

    /// The one of this number.
    pub fn of_code(code: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|format| format.code() == code)
    }

    /// Pixels that are packed together, and the bytes they take.
    pub fn group(self) -> (usize, usize) {
        match self {
            Self::Mono8 => (1, 1),
            Self::Mono10p => (4, 5),
            Self::Mono12p | Self::Mono10Packed | Self::Mono12Packed => (2, 3),
            Self::Mono10 | Self::Mono12 => (1, 2),
        }
    }

    /// Bytes of this many pixels.
    pub fn bytes(self, pixels: usize) -> usize {
        let (group, bytes) = self.group();
        pixels.div_ceil(group) * bytes
    }
}

impl std::fmt::Display for PixelFormat {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_numbers_lead_back() {
        for format in PixelFormat::ALL {
            assert_eq!(PixelFormat::of_name(format.name()), Some(format));
            assert_eq!(PixelFormat::of_code(format.code()), Some(format));
            // The convention's second byte: bits that a pixel takes.
            let (pixels, bytes) = format.group();
            assert_eq!(
                (format.code() >> 16 & 0xff) as usize,
                8 * bytes / pixels,
                "{format}"
            );
        }
        assert_eq!(
            (PixelFormat::of_name("mono8"), PixelFormat::of_code(0)),
            (None, None)
        );
    }

    #[test]
    fn whole_groups_are_counted() {
        // 2 097 152 pixels: 2 MiB, 2.5 MiB, 3 MiB, 4 MiB.
        let bytes = |format: PixelFormat| format.bytes(2048 * 1024) >> 19;
        assert_eq!(PixelFormat::ALL.map(bytes), [4, 5, 6, 6, 6, 8, 8]);
        assert_eq!(
            (PixelFormat::Mono10p.bytes(5), PixelFormat::Mono12p.bytes(5)),
            (10, 9)
        );
    }
}
