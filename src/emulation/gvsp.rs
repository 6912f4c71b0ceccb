//! GigE Vision stream packets (GVSP): leader, payload and trailer of one image. Pure bytes, no sockets.
//!
//! A packet is `status(16) | block(16) | format(8) packet(24) | data`. Packet 0 is the leader, 1 … n the pixels, n + 1
//! the trailer. The packet size register counts the IP and UDP headers too, so a packet of 9000 carries 8964 bytes.

use crate::scene::PixelFormat;

/// Bytes before the data of a packet.
pub const HEADER_BYTES: usize = 8;
/// IPv4 and UDP headers, which the packet size register includes.
pub const IP_UDP_BYTES: usize = 28;

/// Format byte of a leader.
pub const LEADER: u8 = 1;
/// Format byte of a trailer.
pub const TRAILER: u8 = 2;
const FORMAT_LEADER: u32 = LEADER as u32;
const FORMAT_TRAILER: u32 = TRAILER as u32;
const FORMAT_PAYLOAD: u32 = 3;
const PAYLOAD_TYPE_IMAGE: u32 = 1;

/// What the leader says of its image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ImageLeader {
    /// Device clock at the begin of the exposure, ticks.
    pub timestamp_ticks: u64,
    /// How its pixels are packed.
    pub pixel_format: PixelFormat,
    /// Columns.
    pub width_px: u32,
    /// Rows.
    pub height_px: u32,
    /// First column on the sensor.
    pub offset_x_px: u32,
    /// First row on the sensor.
    pub offset_y_px: u32,
}

/// How an image is cut into packets.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PacketPlan {
    /// Pixels in one packet, bytes.
    pub data_bytes: usize,
    /// Bytes of the image.
    pub image_bytes: usize,
}

impl PacketPlan {
    /// The plan for a packet size register value; too small a size is raised to 576.
    pub fn new(packet_size: u32, image_bytes: usize) -> Self {
        let size = (packet_size as usize).max(576);
        Self {
            data_bytes: size - IP_UDP_BYTES - HEADER_BYTES,
            image_bytes,
        }
    }
    /// Payload packets, numbered 1 … this.
    pub fn payload_packets(&self) -> u32 {
        u32::try_from(self.image_bytes.div_ceil(self.data_bytes)).unwrap_or(0x00ff_fff0)
    }
    /// Number of the trailer.
    pub fn trailer(&self) -> u32 {
        self.payload_packets() + 1
    }
}

fn header(block: u16, format: u32, packet: u32, into: &mut Vec<u8>) {
    into.extend_from_slice(&0_u16.to_be_bytes());
    into.extend_from_slice(&block.to_be_bytes());
    into.extend_from_slice(&(format << 24 | packet & 0x00ff_ffff).to_be_bytes());
}

/// Appends the leader.
pub fn leader(block: u16, image: &ImageLeader, into: &mut Vec<u8>) {
    header(block, FORMAT_LEADER, 0, into);
    into.extend_from_slice(&PAYLOAD_TYPE_IMAGE.to_be_bytes());
    into.extend_from_slice(&image.timestamp_ticks.to_be_bytes());
    for word in [
        image.pixel_format.code(),
        image.width_px,
        image.height_px,
        image.offset_x_px,
        image.offset_y_px,
        0, // padding of lines and of the image
    ] {
        into.extend_from_slice(&word.to_be_bytes());
    }
}

/// Appends payload packet `packet` (from 1) of an image; nothing if the image does not reach that far.
pub fn payload(block: u16, plan: &PacketPlan, packet: u32, image: &[u8], into: &mut Vec<u8>) {
    let begin = (packet.saturating_sub(1) as usize).saturating_mul(plan.data_bytes);
    let end = begin.saturating_add(plan.data_bytes).min(image.len());
    let Some(data) = image.get(begin..end).filter(|d| packet > 0 && !d.is_empty()) else {
        return;
    };
    header(block, FORMAT_PAYLOAD, packet, into);
    into.extend_from_slice(data);
}

/// Appends the trailer.
pub fn trailer(block: u16, plan: &PacketPlan, height_px: u32, into: &mut Vec<u8>) {
    header(block, FORMAT_TRAILER, plan.trailer(), into);
    into.extend_from_slice(&PAYLOAD_TYPE_IMAGE.to_be_bytes());
    into.extend_from_slice(&height_px.to_be_bytes());
}

/// The block after this one: 16 bits, zero is never used.
pub fn next_block(block: u16) -> u16 {
    block.checked_add(1).unwrap_or(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_2048_by_1024_image_is_234_jumbo_packets() {
        let plan = PacketPlan::new(9000, 2048 * 1024);
        // 9000 − 28 − 8 = 8964 bytes a packet; 2 097 152 / 8964 = 233.95
        assert_eq!(
            (plan.data_bytes, plan.payload_packets(), plan.trailer()),
            (8964, 234, 235)
        );
        assert_eq!(next_block(65535), 1);
    }

    #[test]
    fn every_byte_of_the_image_is_in_one_packet() {
        let image: Vec<u8> = (0..5000_u32).map(|i| (i % 251) as u8).collect();
        let plan = PacketPlan::new(1500, image.len());
        let mut back = Vec::new();
        for packet in 0..=plan.trailer() {
            let mut bytes = Vec::new();
            payload(3, &plan, packet, &image, &mut bytes);
            if let Some(data) = bytes.get(HEADER_BYTES..) {
                assert_eq!(bytes[..4], [0, 0, 0, 3]);
                assert_eq!(bytes[4], 3);
                back.extend_from_slice(data);
            }
        }
        assert_eq!(back, image);
    }

    #[test]
    fn the_leader_is_44_bytes_with_the_time_at_12() {
        let mut bytes = Vec::new();
        let image = ImageLeader {
            timestamp_ticks: 0x0102_0304_0506_0708,
            pixel_format: PixelFormat::Mono12p,
            width_px: 2048,
            height_px: 1024,
            offset_x_px: 0,
            offset_y_px: 0,
        };
        leader(9, &image, &mut bytes);
        assert_eq!(bytes.len(), 44);
        assert_eq!(bytes[12..20], [1, 2, 3, 4, 5, 6, 7, 8]);
        assert_eq!(bytes[20..24], [0x01, 0x0c, 0x00, 0x47]);
        assert_eq!(bytes[4], 1);
    }
}
