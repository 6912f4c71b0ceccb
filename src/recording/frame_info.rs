//! The message beside each image: number, times, exposure, flags and checksums of one frame.

use prost::Message;
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet};

use super::layout::PixelEncoding;
use crate::scene::{CameraId, Frame, FrameStamp};
use crate::time::{ArrivalTime, DeviceTime, StampedMidpoint};

/// What a recorder knows to be odd about a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct FrameFlags(pub u32);

impl FrameFlags {
    /// Frames that the camera has taken are missing right before this one, whoever lost them.
    pub const AFTER_LOSS: Self = Self(1);

    /// Whether all bits of `other` are set.
    pub fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }
}

/// A frame as the recording has it.
#[derive(Debug, Clone)]
pub struct RecordedFrame {
    /// The image and its times.
    pub frame: Frame,
    /// Exposure, seconds, where it was known.
    pub exposure_s: Option<f64>,
    /// Oddities.
    pub flags: FrameFlags,
}

impl From<Frame> for RecordedFrame {
    fn from(frame: Frame) -> Self {
        Self {
            frame,
            exposure_s: None,
            flags: FrameFlags::default(),
        }
    }
}

/// `pitchd.FrameInfo`, protobuf. Fields are only ever added.
#[derive(Clone, PartialEq, Message)]
pub struct FrameInfo {
    /// Frame number: rises by one per exposure; gaps are frames the camera or host lost.
    #[prost(fixed64, tag = "1")]
    pub frame: u64,
    /// Middle of the exposure by the camera's stamps, nanoseconds.
    #[prost(sfixed64, tag = "2")]
    pub stamped_midpoint_ns: i64,
    /// The camera's own clock.
    #[prost(sfixed64, optional, tag = "3")]
    pub device_time_ns: Option<i64>,
    /// The host's monotonic clock when it had the frame.
    #[prost(sfixed64, optional, tag = "4")]
    pub arrival_time_ns: Option<i64>,
    /// Exposure time.
    #[prost(sfixed64, optional, tag = "5")]
    pub exposure_ns: Option<i64>,
    /// See [`FrameFlags`].
    #[prost(fixed32, tag = "6")]
    pub flags: u32,
    /// Columns.
    #[prost(fixed32, tag = "7")]
    pub width_px: u32,
    /// Rows.
    #[prost(fixed32, tag = "8")]
    pub height_px: u32,
    /// Place of the frame in its file, from 0, without gaps: a gap is damage.
    #[prost(fixed32, tag = "9")]
    pub index: u32,
    /// "mono8" or "png".
    #[prost(string, tag = "10")]
    pub encoding: String,
    /// Camera id.
    #[prost(string, tag = "11")]
    pub camera: String,
    /// CRC-32 (IEEE) of the pixels, row by row, before any compression.
    #[prost(fixed32, tag = "12")]
    pub pixels_crc32: u32,
    /// CRC-32 of all bytes of this message before this field, which is its last.
    #[prost(fixed32, tag = "100")]
    pub info_crc32: u32,
}

/// The last field's tag (100, four bytes) as it is encoded.
const CRC_TAG: [u8; 2] = [0xa5, 0x06];

/// Longest info in bytes that is believed.
pub const INFO_BYTES_MAX: u64 = 256;

impl FrameInfo {
    /// The info of a frame, not yet sealed.
    pub fn new(recorded: &RecordedFrame, camera: &CameraId, encoding: PixelEncoding) -> Self {
        let stamp = recorded.frame.stamp;
        Self {
            frame: stamp.frame,
            stamped_midpoint_ns: stamp.stamped.nanos(),
            device_time_ns: stamp.device.map(DeviceTime::nanos),
            arrival_time_ns: stamp.arrival.map(ArrivalTime::nanos),
            exposure_ns: recorded.exposure_s.map(|s| (s * 1e9).round() as i64),
            flags: recorded.flags.0,
            width_px: recorded.frame.width_px,
            height_px: recorded.frame.height_px,
            index: 0,
            encoding: encoding.name().to_owned(),
            camera: camera.as_str().to_owned(),
            pixels_crc32: crc32fast::hash(recorded.frame.bytes()),
            info_crc32: 0,
        }
    }

    /// The bytes for the file, with the message's own checksum.
    pub fn seal(mut self) -> Vec<u8> {
        self.info_crc32 = 0;
        let mut bytes = self.encode_to_vec();
        let crc = crc32fast::hash(&bytes);
        bytes.extend(CRC_TAG);
        bytes.extend(crc.to_le_bytes());
        bytes
    }

    /// Reads an info; `None` unless it is exactly what [`FrameInfo::seal`] wrote.
    pub fn open(bytes: &[u8]) -> Option<Self> {
        let (before, last) = bytes.split_at_checked(bytes.len().checked_sub(6)?)?;
        let crc = last.strip_prefix(&CRC_TAG)?;
        if crc32fast::hash(before).to_le_bytes() != *crc {
            return None;
        }
        Self::decode(bytes).ok()
    }

    /// Bytes of the pixels before compression.
    pub fn pixel_count(&self) -> u64 {
        u64::from(self.width_px) * u64::from(self.height_px)
    }

    /// The times.
    pub fn stamp(&self) -> FrameStamp {
        FrameStamp {
            frame: self.frame,
            device: self.device_time_ns.map(DeviceTime::from_nanos),
            arrival: self.arrival_time_ns.map(ArrivalTime::from_nanos),
            stamped: StampedMidpoint::from_nanos(self.stamped_midpoint_ns),
        }
    }

    /// The schema for the file: a serialised `google.protobuf.FileDescriptorSet`.
    pub fn schema() -> Vec<u8> {
        let fields = [
            ("frame", 1, Type::Fixed64),
            ("stamped_midpoint_ns", 2, Type::Sfixed64),
            ("device_time_ns", 3, Type::Sfixed64),
            ("arrival_time_ns", 4, Type::Sfixed64),
            ("exposure_ns", 5, Type::Sfixed64),
            ("flags", 6, Type::Fixed32),
            ("width_px", 7, Type::Fixed32),
            ("height_px", 8, Type::Fixed32),
            ("index", 9, Type::Fixed32),
            ("encoding", 10, Type::String),
            ("camera", 11, Type::String),
            ("pixels_crc32", 12, Type::Fixed32),
            ("info_crc32", 100, Type::Fixed32),
        ];
        let field = |(name, number, kind): (&str, i32, Type)| FieldDescriptorProto {
            name: Some(name.to_owned()),
            number: Some(number),
            label: Some(Label::Optional.into()),
            r#type: Some(kind.into()),
            ..Default::default()
        };
        // proto2 syntax: every field keeps its presence, which proto3 needs synthetic oneofs for.
        FileDescriptorSet {
            file: vec![FileDescriptorProto {
                name: Some("pitchd/FrameInfo.proto".to_owned()),
                package: Some("pitchd".to_owned()),
                syntax: Some("proto2".to_owned()),
                message_type: vec![DescriptorProto {
                    name: Some("FrameInfo".to_owned()),
                    field: fields.map(field).to_vec(),
                    ..Default::default()
                }],
                ..Default::default()
            }],
        }
        .encode_to_vec()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn info() -> FrameInfo {
        FrameInfo {
            frame: 4_000_000_000_000,
            stamped_midpoint_ns: -5,
            device_time_ns: Some(0),
            arrival_time_ns: None,
            exposure_ns: Some(1_000_000),
            flags: 1,
            width_px: 2048,
            height_px: 1024,
            index: 17,
            encoding: "mono8".to_owned(),
            camera: "first".to_owned(),
            pixels_crc32: 0xdead_beef,
            info_crc32: 0,
        }
    }

    #[test]
    fn any_flipped_bit_is_seen() {
        let bytes = info().seal();
        assert!(bytes.len() as u64 <= INFO_BYTES_MAX);
        assert_eq!(FrameInfo::open(&bytes).unwrap().stamp(), info().stamp());
        let mut tried = 0;
        for position in 0..bytes.len() {
            for bit in 0..8 {
                let mut flipped = bytes.clone();
                flipped[position] ^= 1 << bit;
                assert!(FrameInfo::open(&flipped).is_none(), "byte {position} bit {bit}");
                tried += 1;
            }
            assert!(FrameInfo::open(&bytes[..position]).is_none());
        }
        assert_eq!(tried, 8 * bytes.len());
    }
}
