//! GigE Vision control packets (GVCP): what a camera must understand and answer. Pure bytes, no sockets.
//!
//! Every number is big-endian. A command is `42 flags | command | size | id | payload`; an answer is
//! `status | command + 1 | size | id | payload`. Source: GigE Vision 1.2 as spoken by Aravis 0.8.

/// UDP port on which every GigE Vision camera listens.
pub const GVCP_PORT: u16 = 3956;
/// Bytes before the payload.
pub const HEADER_BYTES: usize = 8;
/// The most bytes one READMEM or WRITEMEM may ask for.
pub const MEMORY_BYTES_MOST: usize = 536;
/// The most bytes behind the header, of a command or an answer: 576 with the IP, UDP and GVCP headers.
pub const PAYLOAD_BYTES_MOST: usize = 540;

const COMMAND_MARK: u8 = 0x42;
const FLAG_ACK_WANTED: u8 = 0x01;
const DISCOVERY: u16 = 0x0002;
const PACKET_RESEND: u16 = 0x0040;
const READ_REGISTER: u16 = 0x0080;
const WRITE_REGISTER: u16 = 0x0082;
const READ_MEMORY: u16 = 0x0084;
const WRITE_MEMORY: u16 = 0x0086;

/// A command's request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Request {
    /// Who is there?
    Discovery,
    /// Send these packets of a block again; no answer on this channel.
    PacketResend {
        /// Block (frame) number on the stream channel.
        block: u16,
        /// First packet.
        first: u32,
        /// Last packet, included.
        last: u32,
    },
    /// Read 32-bit registers.
    ReadRegisters(Vec<u32>),
    /// Write 32-bit registers: address, value.
    WriteRegisters(Vec<(u32, u32)>),
    /// Read memory.
    ReadMemory {
        /// Address.
        address: u32,
        /// Bytes.
        count: usize,
    },
    /// Write memory.
    WriteMemory {
        /// Address.
        address: u32,
        /// What to write.
        bytes: Vec<u8>,
    },
    /// Something this camera does not know.
    Unknown,
    /// A known command with a payload that cannot be one.
    Malformed,
}

/// A command as it came.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Command {
    /// Command word, repeated (+1) in the answer.
    pub word: u16,
    /// Number of the request, repeated in the answer.
    pub id: u16,
    /// Whether an answer is wanted.
    pub answer: Answer,
    /// What is asked.
    pub request: Request,
}

/// Whether the sender waits for an answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Answer {
    /// Yes.
    Wanted,
    /// No.
    Unwanted,
}

/// Why a command is refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u16)]
pub enum Refusal {
    /// GEV_STATUS_NOT_IMPLEMENTED
    NotImplemented = 0x8001,
    /// GEV_STATUS_INVALID_PARAMETER
    InvalidParameter = 0x8002,
    /// GEV_STATUS_INVALID_ADDRESS
    InvalidAddress = 0x8003,
    /// GEV_STATUS_WRITE_PROTECT
    WriteProtect = 0x8004,
    /// GEV_STATUS_BAD_ALIGNMENT
    BadAlignment = 0x8005,
    /// GEV_STATUS_ACCESS_DENIED
    AccessDenied = 0x8006,
}

fn word16(bytes: &[u8], at: usize) -> Option<u16> {
    Some(u16::from_be_bytes(bytes.get(at..at + 2)?.try_into().ok()?))
}

fn word32(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_be_bytes(bytes.get(at..at + 4)?.try_into().ok()?))
}

impl Command {
    /// Reads a datagram; `None` if it is no GVCP command at all (no answer is due then).
    pub fn parse(datagram: &[u8]) -> Option<Self> {
        let (header, payload) = datagram.split_at_checked(HEADER_BYTES)?;
        if header.first() != Some(&COMMAND_MARK) {
            return None;
        }
        let flags = *header.get(1)?;
        let (word, size, id) = (word16(header, 2)?, word16(header, 4)?, word16(header, 6)?);
        let payload = payload.get(..usize::from(size));
        let request = match payload {
            Some(payload) if payload.len() <= PAYLOAD_BYTES_MOST => Request::parse(word, payload),
            _ => Request::Malformed,
        };
        let answer = if flags & FLAG_ACK_WANTED != 0 && word != PACKET_RESEND {
            Answer::Wanted
        } else {
            Answer::Unwanted
        };
        Some(Self {
            word,
            id,
            answer,
            request,
        })
    }

    /// The answer that grants the command.
    pub fn grant(&self, payload: &[u8]) -> Vec<u8> {
        answer(0, self, payload)
    }

    /// The answer that refuses it.
    pub fn refuse(&self, why: Refusal) -> Vec<u8> {
        answer(why as u16, self, &[])
    }
}

fn answer(status: u16, to: &Command, payload: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(HEADER_BYTES + payload.len());
    let size = u16::try_from(payload.len()).unwrap_or(u16::MAX);
    for word in [status, to.word.wrapping_add(1), size, to.id] {
        bytes.extend_from_slice(&word.to_be_bytes());
    }
    bytes.extend_from_slice(payload);
    bytes
}

impl Request {
    fn parse(word: u16, payload: &[u8]) -> Self {
        let parsed = match word {
            DISCOVERY => Some(Self::Discovery),
            PACKET_RESEND => Self::parse_resend(payload),
            READ_REGISTER if !payload.is_empty() && payload.len().is_multiple_of(4) => {
                Some(Self::ReadRegisters(
                    (0..payload.len())
                        .step_by(4)
                        .filter_map(|at| word32(payload, at))
                        .collect(),
                ))
            }
            WRITE_REGISTER if !payload.is_empty() && payload.len().is_multiple_of(8) => {
                Some(Self::WriteRegisters(
                    (0..payload.len())
                        .step_by(8)
                        .filter_map(|at| Some((word32(payload, at)?, word32(payload, at + 4)?)))
                        .collect(),
                ))
            }
            READ_MEMORY => Self::parse_read_memory(payload),
            WRITE_MEMORY => Self::parse_write_memory(payload),
            READ_REGISTER | WRITE_REGISTER => None,
            _ => Some(Self::Unknown),
        };
        parsed.unwrap_or(Self::Malformed)
    }

    fn parse_resend(payload: &[u8]) -> Option<Self> {
        // Stream channel (16 bits), block (16 bits), first and last packet (24 bits each in 32).
        Some(Self::PacketResend {
            block: word16(payload, 2)?,
            first: word32(payload, 4)? & 0x00ff_ffff,
            last: word32(payload, 8)? & 0x00ff_ffff,
        })
    }

    fn parse_read_memory(payload: &[u8]) -> Option<Self> {
        let (address, count) = (word32(payload, 0)?, usize::from(word16(payload, 6)?));
        (count <= MEMORY_BYTES_MOST).then_some(Self::ReadMemory { address, count })
    }

    fn parse_write_memory(payload: &[u8]) -> Option<Self> {
        let address = word32(payload, 0)?;
        let bytes = payload.get(4..)?;
        (bytes.len() <= MEMORY_BYTES_MOST).then(|| Self::WriteMemory {
            address,
            bytes: bytes.to_vec(),
        })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn the_discovery_ping_of_eight_bytes_is_understood() {
        let command = Command::parse(&[0x42, 0x01, 0x00, 0x02, 0x00, 0x00, 0x00, 0x01]).unwrap();
        assert_eq!(
            (command.request.clone(), command.answer),
            (Request::Discovery, Answer::Wanted)
        );
        let ack = command.grant(&[7; 4]);
        assert_eq!(ack, [0, 0, 0, 3, 0, 4, 0, 1, 7, 7, 7, 7]);
    }

    #[test]
    fn reads_writes_and_resends_are_told_apart() {
        let read = [0x42, 1, 0, 0x80, 0, 4, 0, 9, 0, 0, 0x0a, 0];
        assert_eq!(
            Command::parse(&read).unwrap().request,
            Request::ReadRegisters(vec![0x0a00])
        );
        let write = [0x42, 1, 0, 0x82, 0, 8, 0, 9, 0, 0, 0x0a, 0, 0, 0, 0, 2];
        assert_eq!(
            Command::parse(&write).unwrap().request,
            Request::WriteRegisters(vec![(0x0a00, 2)])
        );
        let resend = [0x42, 0, 0, 0x40, 0, 12, 0, 9, 0, 0, 0, 5, 0, 0, 0, 3, 0, 0, 0, 8];
        let command = Command::parse(&resend).unwrap();
        assert_eq!(
            command.request,
            Request::PacketResend {
                block: 5,
                first: 3,
                last: 8
            }
        );
        assert_eq!(command.answer, Answer::Unwanted);
        let refused = Command::parse(&read).unwrap().refuse(Refusal::AccessDenied);
        assert_eq!(refused, [0x80, 0x06, 0, 0x81, 0, 0, 0, 9]);
    }

    proptest! {
        #[test]
        fn no_datagram_makes_it_panic(mut bytes in prop::collection::vec(any::<u8>(), 0..700), mark in any::<bool>()) {
            if mark && !bytes.is_empty() {
                bytes[0] = COMMAND_MARK;
            }
            if let Some(command) = Command::parse(&bytes) {
                prop_assert!(bytes.len() >= HEADER_BYTES);
                if let Request::ReadMemory { count, .. } = command.request {
                    prop_assert!(count <= MEMORY_BYTES_MOST);
                }
            }
        }
    }
}
