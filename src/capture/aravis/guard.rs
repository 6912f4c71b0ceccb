//! A guard in the kernel before the library's stream socket: packets that the library would not survive never reach it.
//!
//! Aravis 0.8.26 believes a packet's number and makes room for as many packets as it says: one packet with a 32-bit
//! number ends the process ("failed to allocate 61136531408 bytes"). And a UDP socket takes packets from everybody. So a
//! classic BPF program passes what the asked camera may send of one image, and nothing else.

use std::io;
use std::net::Ipv4Addr;
use std::time::Duration;

use socket2::SockFilter;

use super::ffi::RawStream;

// The kernel's names (linux/filter.h); a load beyond the packet's end drops it.
const LOAD_WORD: u16 = 0x20;
const LOAD_BYTE: u16 = 0x30;
const LOAD_HALF: u16 = 0x28;
const AND: u16 = 0x54;
const IF_EQUAL: u16 = 0x15;
const IF_GREATER: u16 = 0x25;
const IF_SET: u16 = 0x45;
const RETURN: u16 = 0x06;
/// Offsets from here on count from the IP header; others from the UDP header.
const IP_HEADER: u32 = 0xfff0_0000;
const IP_SOURCE: u32 = IP_HEADER + 12;
const PASS: u32 = 0xffff_ffff;
const DROP: u32 = 0;

const UDP_BYTES: u32 = 8;
/// Status, block, format, number.
const FORMAT: u32 = UDP_BYTES + 4;
const EXTENDED: u32 = 0x80;
/// GigE Vision 2: block and number of 64 and 32 bits stand behind the old header.
const EXTENDED_NUMBER: u32 = UDP_BYTES + 16;
/// Leader, payload, trailer are 1, 2, 3.
const KIND_MOST: u32 = 3;
/// Payload type of a leader, behind the header and a reserved half.
const LEADER_TYPE: u32 = UDP_BYTES + 8 + 2;
const EXTENDED_LEADER_TYPE: u32 = UDP_BYTES + 20 + 2;
/// An image; an image with chunks behind it, as version 1 and as version 2 say it.
const IMAGES: [u32; 3] = [0x0001, 0x0004, 0x4001];

/// What one image's packets look like.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Expected {
    /// The only sender.
    pub camera: Ipv4Addr,
    /// Bytes of an image.
    pub payload_bytes: usize,
    /// Packet size with IP and UDP headers.
    pub packet_size: u32,
}

impl Expected {
    /// The highest number that a packet may have: leader and trailer included, headers of the longest kind.
    fn number_most(&self) -> u32 {
        let data = (self.packet_size as usize).saturating_sub(64).max(1);
        u32::try_from(self.payload_bytes.div_ceil(data) + 2).unwrap_or(u32::MAX)
    }
}

/// Sets the guard before a stream that has not begun.
///
/// # Errors
/// The socket was not found, or the kernel refuses.
pub fn set(stream: &RawStream, expected: &Expected) -> io::Result<()> {
    stream.attach(expected.camera, &program(expected))
}

const TRIES: usize = 3;
const BETWEEN_TRIES: Duration = Duration::from_millis(30);

/// Tries again where it failed: memory may be short for a moment, and other threads open and close files meanwhile.
///
/// # Errors
/// The last try's.
pub fn insist(set: impl Fn() -> io::Result<()>) -> io::Result<()> {
    for _ in 1..TRIES {
        match set() {
            Ok(()) => return Ok(()),
            Err(error) => tracing::debug!(%error, "the packet filter is tried again"),
        }
        std::thread::sleep(BETWEEN_TRIES);
    }
    set()
}

/// One step, with its jumps by name.
enum Step {
    Do(u16, u32),
    /// Code, value, and where to go on if so; else to the next step.
    To(u16, u32, &'static str),
    /// Code, value, and where to go on if not.
    Unless(u16, u32, &'static str),
    Name(&'static str),
}

fn program(expected: &Expected) -> Vec<SockFilter> {
    use Step::{Do, Name, To, Unless};
    let most = expected.number_most();
    let mut steps = vec![
        Do(LOAD_WORD, IP_SOURCE),
        Unless(IF_EQUAL, expected.camera.into(), "drop"),
        Do(LOAD_BYTE, FORMAT),
        To(IF_SET, EXTENDED, "extended"),
        To(IF_EQUAL, 0, "drop"),
        To(IF_GREATER, KIND_MOST, "drop"),
        Do(LOAD_WORD, FORMAT),
        Do(AND, 0x00ff_ffff),
        To(IF_GREATER, most, "drop"),
        Do(LOAD_BYTE, FORMAT),
        Unless(IF_EQUAL, 1, "pass"),
        Do(LOAD_HALF, LEADER_TYPE),
    ];
    steps.extend(IMAGES.map(|image| To(IF_EQUAL, image, "pass")));
    steps.extend([
        Name("drop"),
        Do(RETURN, DROP),
        Name("extended"),
        Do(AND, EXTENDED - 1),
        To(IF_EQUAL, 0, "end"),
        To(IF_GREATER, KIND_MOST, "end"),
        Do(LOAD_WORD, EXTENDED_NUMBER),
        To(IF_GREATER, most, "end"),
        Do(LOAD_BYTE, FORMAT),
        Do(AND, EXTENDED - 1),
        Unless(IF_EQUAL, 1, "pass"),
        Do(LOAD_HALF, EXTENDED_LEADER_TYPE),
    ]);
    steps.extend(IMAGES.map(|image| To(IF_EQUAL, image, "pass")));
    steps.extend([Name("end"), Do(RETURN, DROP), Name("pass"), Do(RETURN, PASS)]);
    assemble(&steps)
}

/// Jumps go forward, by the count of steps between.
fn assemble(steps: &[Step]) -> Vec<SockFilter> {
    let is_name = |step: &&Step| !matches!(step, Step::Name(_));
    let far = |from: usize, to: &str| {
        let between = steps.iter().skip(from + 1);
        let between = between.take_while(|s| !matches!(s, Step::Name(name) if *name == to));
        u8::try_from(between.filter(is_name).count()).unwrap_or(u8::MAX)
    };
    let code = |(at, step): (usize, &Step)| match step {
        Step::Do(code, k) => Some(SockFilter::new(*code, 0, 0, *k)),
        Step::To(code, k, name) => Some(SockFilter::new(*code, far(at, name), 0, *k)),
        Step::Unless(code, k, name) => Some(SockFilter::new(*code, 0, far(at, name), *k)),
        Step::Name(_) => None,
    };
    steps.iter().enumerate().filter_map(code).collect()
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;
    use std::net::UdpSocket;

    use super::*;

    #[test]
    fn a_guard_that_cannot_be_set_is_tried_again_and_then_refused() {
        let tries = Cell::new(0);
        let fails = |times: usize| {
            tries.set(0);
            insist(|| {
                tries.set(tries.get() + 1);
                match tries.get() <= times {
                    true => Err(io::ErrorKind::OutOfMemory.into()),
                    false => Ok(()),
                }
            })
        };
        assert!(fails(0).is_ok() && tries.get() == 1);
        assert!(fails(2).is_ok() && tries.get() == 3);
        assert!(fails(9).is_err() && tries.get() == TRIES);
    }

    /// A guarded socket, and whether it hears what a sender on `from` sends.
    fn passes(expected: &Expected, from: &str, packets: &[Vec<u8>]) -> Vec<bool> {
        let guarded = UdpSocket::bind("127.0.0.1:0").unwrap();
        socket2::SockRef::from(&guarded)
            .attach_filter(&program(expected))
            .unwrap();
        guarded.set_read_timeout(Some(Duration::from_millis(20))).unwrap();
        let sender = UdpSocket::bind((from, 0)).unwrap();
        let mut heard = [0; 4096];
        let pass = |packet: &Vec<u8>| {
            sender.send_to(packet, guarded.local_addr().unwrap()).unwrap();
            match guarded.recv(&mut heard) {
                Ok(bytes) => {
                    assert_eq!(&heard[..bytes], packet, "whole");
                    true
                }
                Err(_) => false,
            }
        };
        packets.iter().map(pass).collect()
    }

    fn packet(format: u8, number: u32) -> Vec<u8> {
        let mut bytes = vec![0, 0, 0, 7];
        bytes.extend((u32::from(format) << 24 | number).to_be_bytes());
        // A leader's payload type: an image.
        bytes.extend([0, 0, 0, 1]);
        bytes.extend([9; 40]);
        bytes
    }

    fn extended(format: u8, number: u32) -> Vec<u8> {
        let mut bytes = vec![0, 0, 0, 0, format | 0x80, 0, 0, 0];
        bytes.extend(7_u64.to_be_bytes());
        bytes.extend(number.to_be_bytes());
        bytes.extend([0, 0, 0x40, 1]);
        bytes.extend([9; 40]);
        bytes
    }

    const EXPECTED: Expected = Expected {
        camera: Ipv4Addr::new(127, 0, 96, 1),
        payload_bytes: 51_200,
        packet_size: 1500,
    };

    #[test]
    fn an_images_packets_pass_and_nothing_else() {
        // 51 200 / 1436 bytes: 36 packets, leader and trailer.
        assert_eq!(EXPECTED.number_most(), 38);
        let good = [
            packet(1, 0),
            packet(3, 1),
            packet(3, 36),
            packet(2, 37),
            extended(1, 0),
            extended(3, 36),
            extended(2, 37),
        ];
        assert_eq!(passes(&EXPECTED, "127.0.96.1", &good), vec![true; good.len()]);
        let mut other_payload = packet(1, 0);
        other_payload[11] = 0x0b;
        let mut other_extended = extended(1, 0);
        other_extended[22..24].copy_from_slice(&[0, 9]);
        let bad = [
            packet(3, 39),
            packet(3, 0x00ff_ffff),
            packet(0, 1),
            packet(4, 1),
            packet(0x7f, 1),
            extended(3, 39),
            extended(3, u32::MAX),
            extended(8, 1),
            extended(0, 1),
            other_payload,
            other_extended,
            vec![],
            vec![0; 3],
            packet(1, 0)[..9].to_vec(),
            extended(3, 1)[..18].to_vec(),
        ];
        assert_eq!(passes(&EXPECTED, "127.0.96.1", &bad), vec![false; bad.len()]);
        assert_eq!(
            passes(&EXPECTED, "127.0.96.2", &good),
            vec![false; good.len()],
            "another sender"
        );
    }
}
