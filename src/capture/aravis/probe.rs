//! Asks a GigE Vision camera whether it is there and who holds it: a few GVCP bytes, 100 ms, no library.
//!
//! The library's own open of a dead camera blocks every other camera's open for 2.5 s (one global lock), so nothing is
//! opened that has not answered here first.

use std::io;
use std::net::{Ipv4Addr, SocketAddrV4, UdpSocket};
use std::path::Path;
use std::time::{Duration, Instant};

use socket2::{Domain, Protocol, Socket, Type};

const GVCP_PORT: u16 = 3956;
const PRIVILEGE: u32 = 0x0a00;
/// Address of the program that holds the camera; cameras before GigE Vision 2 do not tell it.
const HOLDER: u32 = 0x0a14;
const DISCOVERY_BYTES: usize = 0xf8;

/// A camera that answered.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Found {
    /// Address.
    pub address: Ipv4Addr,
    /// Manufacturer.
    pub vendor: String,
    /// Model.
    pub model: String,
    /// Serial number.
    pub serial: String,
    /// User-defined name.
    pub user_name: String,
}

impl Found {
    /// Reads the payload of a discovery answer: the first 248 bootstrap bytes.
    fn parse(payload: &[u8]) -> Option<Self> {
        if payload.len() < DISCOVERY_BYTES {
            return None;
        }
        let text = |at: usize, count: usize| {
            let bytes = payload.get(at..at + count)?;
            let end = bytes.iter().position(|b| *b == 0).unwrap_or(count);
            // Hostile names stay on one line.
            let kept = String::from_utf8_lossy(bytes.get(..end)?).into_owned();
            Some(
                kept.chars()
                    .filter(|c| !c.is_control())
                    .collect::<String>()
                    .trim()
                    .to_owned(),
            )
        };
        let address: [u8; 4] = payload.get(0x24..0x28)?.try_into().ok()?;
        Some(Self {
            address: address.into(),
            vendor: text(0x48, 32)?,
            model: text(0x68, 32)?,
            serial: text(0xd8, 16)?,
            user_name: text(0xe8, 16)?,
        })
    }
}

/// An answer's payload, if it answers request `id` with the answer word.
fn payload_of(datagram: &[u8], word: u16, id: u16) -> Option<&[u8]> {
    let (header, payload) = datagram.split_at_checked(8)?;
    let expected = [[0, 0], word.to_be_bytes()].concat();
    (header.get(..4)? == expected && header.get(6..8)? == id.to_be_bytes()).then_some(payload)
}

fn ask(address: Ipv4Addr, request: &[u8], word: u16, patience: Duration) -> io::Result<Option<Vec<u8>>> {
    let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))?;
    socket.connect(SocketAddrV4::new(address, GVCP_PORT))?;
    let until = Instant::now() + patience;
    socket.send(request)?;
    answer_on(&socket, (word, 1), until)
}

/// The payload of the answer `word` to request `id`; all else that comes is left.
fn answer_on(socket: &UdpSocket, (word, id): (u16, u16), until: Instant) -> io::Result<Option<Vec<u8>>> {
    let mut datagram = [0; 1024];
    loop {
        let left = until.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Ok(None);
        }
        socket.set_read_timeout(Some(left))?;
        // Refused or timed out: nobody is there.
        let Ok(bytes) = socket.recv(&mut datagram) else {
            return Ok(None);
        };
        if let Some(payload) = datagram.get(..bytes).and_then(|d| payload_of(d, word, id)) {
            return Ok(Some(payload.to_vec()));
        }
    }
}

/// A camera's memory, read by one socket.
pub struct Registers {
    socket: UdpSocket,
    id: u16,
}

/// The most that one read may ask for.
const READ_BYTES: usize = 512;
/// A slow camera asks for patience (PENDING); a stalling one is given no more than this for a read.
const READ_PATIENCE: Duration = Duration::from_millis(400);
const READ_TRIES: usize = 3;

impl Registers {
    /// Of the camera at an address.
    pub fn of(address: Ipv4Addr) -> io::Result<Self> {
        let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))?;
        socket.connect(SocketAddrV4::new(address, GVCP_PORT))?;
        Ok(Self { socket, id: 0 })
    }

    /// At most `most` bytes from `address` on; `None`: refused, or no whole answer by `until`.
    pub fn read(&mut self, address: u32, most: usize, until: Instant) -> Option<Vec<u8>> {
        let wanted = most.min(READ_BYTES);
        let count = u16::try_from(wanted.next_multiple_of(4)).ok()?;
        (0..READ_TRIES).find_map(|_| {
            self.id = self.id.checked_add(1).unwrap_or(1);
            let mut request = vec![0x42, 0x01, 0x00, 0x84, 0x00, 0x08];
            request.extend(self.id.to_be_bytes());
            request.extend(address.to_be_bytes());
            request.extend([0, 0]);
            request.extend(count.to_be_bytes());
            self.socket.send(&request).ok()?;
            let until = until.min(Instant::now() + READ_PATIENCE);
            let answer = answer_on(&self.socket, (0x0085, self.id), until).ok()??;
            let (place, data) = answer.split_at_checked(4)?;
            let whole = place == address.to_be_bytes() && data.len() >= usize::from(count);
            whole.then(|| data.get(..wanted).map(<[u8]>::to_vec))?
        })
    }
}

/// Who is at an address; `None`: nobody within `patience`.
pub fn ping(address: Ipv4Addr, patience: Duration) -> Option<Found> {
    let request = [0x42, 0x01, 0x00, 0x02, 0x00, 0x00, 0x00, 0x01];
    let payload = ask(address, &request, 0x0003, patience).ok()??;
    // A camera behind another route may tell an address of its own; the one that answered is the one that works.
    Found::parse(&payload).map(|found| Found { address, ..found })
}

/// Whether a program holds the camera at an address; `None`: no answer.
pub fn is_held(address: Ipv4Addr, patience: Duration) -> Option<bool> {
    register(address, PRIVILEGE, patience).map(|value| value & 3 != 0)
}

/// Host of the program that holds the camera at an address, where the camera tells it.
pub fn holder(address: Ipv4Addr, patience: Duration) -> Option<Ipv4Addr> {
    let host = register(address, HOLDER, patience)?;
    (host != 0).then(|| Ipv4Addr::from(host))
}

fn register(address: Ipv4Addr, place: u32, patience: Duration) -> Option<u32> {
    let mut request = vec![0x42, 0x01, 0x00, 0x80, 0x00, 0x04, 0x00, 0x01];
    request.extend(place.to_be_bytes());
    let payload = ask(address, &request, 0x0081, patience).ok()??;
    Some(u32::from_be_bytes(payload.get(..4)?.try_into().ok()?))
}

/// Asks all interfaces by broadcast.
pub fn discover(patience: Duration) -> Vec<Found> {
    let names: Vec<String> = std::fs::read_dir(Path::new("/sys/class/net"))
        .map(|folder| {
            folder
                .flatten()
                .map(|e| e.file_name().to_string_lossy().into_owned())
                .collect()
        })
        .unwrap_or_default();
    let sockets: Vec<UdpSocket> = names.iter().filter_map(|name| broadcast_on(name).ok()).collect();
    let until = Instant::now() + patience;
    let mut found: Vec<Found> = Vec::new();
    let mut datagram = [0; 1024];
    while Instant::now() < until {
        for socket in &sockets {
            while let Ok((bytes, from)) = socket.recv_from(&mut datagram) {
                let payload = datagram.get(..bytes).and_then(|d| payload_of(d, 0x0003, 1));
                let Some(camera) = payload.and_then(Found::parse) else {
                    continue;
                };
                let std::net::IpAddr::V4(address) = from.ip() else {
                    continue;
                };
                if !found.iter().any(|f| f.address == address) {
                    found.push(Found { address, ..camera });
                }
            }
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    found.sort_by_key(|f| f.address);
    found
}

fn broadcast_on(interface: &str) -> io::Result<UdpSocket> {
    let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))?;
    socket.bind_device(Some(interface.as_bytes()))?;
    socket.set_broadcast(true)?;
    socket.set_nonblocking(true)?;
    let socket: UdpSocket = socket.into();
    // 0x11: an answer is wanted, and it may be a broadcast.
    socket.send_to(
        &[0x42, 0x11, 0x00, 0x02, 0x00, 0x00, 0x00, 0x01],
        (Ipv4Addr::BROADCAST, GVCP_PORT),
    )?;
    Ok(socket)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn nobody_answers_within_the_patience() {
        let begun = Instant::now();
        assert_eq!(
            ping(Ipv4Addr::new(127, 0, 91, 77), Duration::from_millis(100)),
            None
        );
        assert!(begun.elapsed() < Duration::from_secs(1));
    }

    proptest! {
        #[test]
        fn hostile_answers_are_read_or_left(payload in prop::collection::vec(any::<u8>(), 0..600)) {
            let _ = payload_of(&payload, 3, 1);
            if let Some(found) = Found::parse(&payload) {
                prop_assert!(found.serial.chars().all(|c| !c.is_control()));
            }
        }
    }
}
