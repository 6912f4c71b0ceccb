//! What a broken or hostile camera sends: packets spoilt in every way a receiver must live with. Pure bytes, no sockets.

use rand::Rng;

use super::gvsp;

/// A way to spoil a stream packet.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Mangling {
    /// Any of those below.
    #[default]
    Any,
    /// Nothing but noise, of any length.
    Noise,
    /// Cut short, in the header or behind it.
    Cut,
    /// Noise behind its end.
    Long,
    /// Another packet number: within the image, behind it, or absurd.
    Number,
    /// Another block.
    Block,
    /// Another kind: leader, trailer, payload, or one that nobody knows.
    Kind,
    /// An error status.
    Status,
    /// A leader of another payload type, pixel format, size or time.
    Leader,
    /// A leader of half the columns.
    Shape,
    /// No payload: as where large packets do not pass.
    Payload,
    /// No trailer.
    Trailer,
    /// Some bits turned.
    Bits,
}

impl Mangling {
    const ALL: [(&'static str, Self); 13] = [
        ("any", Self::Any),
        ("noise", Self::Noise),
        ("cut", Self::Cut),
        ("long", Self::Long),
        ("number", Self::Number),
        ("block", Self::Block),
        ("kind", Self::Kind),
        ("status", Self::Status),
        ("leader", Self::Leader),
        ("shape", Self::Shape),
        ("payload", Self::Payload),
        ("trailer", Self::Trailer),
        ("bits", Self::Bits),
    ];

    /// By its name.
    pub(super) fn named(name: &str) -> Option<Self> {
        let found = Self::ALL.iter().find(|(known, _)| *known == name);
        found.map(|(_, mangling)| *mangling)
    }

    /// Spoils a stream packet; an empty one is not sent.
    pub(super) fn spoil(self, packet: &mut Vec<u8>, random: &mut impl Rng) {
        let kind = packet.get(4).copied().unwrap_or(0);
        match self {
            Self::Any => {
                let which = random.random_range(1..Self::ALL.len());
                if let Some((_, one)) = Self::ALL.get(which) {
                    one.spoil(packet, random);
                }
            }
            Self::Noise => noise(packet, random),
            Self::Cut => packet.truncate(random.random_range(0..packet.len().max(1))),
            Self::Long => {
                let end = packet.len();
                packet.resize(end + random.random_range(1..4000), 0xff);
            }
            Self::Number => {
                let most = [300, 70_000, 1 << 24][random.random_range(0..3)];
                let number: u32 = random.random_range(0..most);
                set(packet, 5, &number.to_be_bytes()[1..]);
            }
            Self::Block => set(packet, 2, &random.random::<u16>().to_be_bytes()),
            Self::Kind => set(packet, 4, &[random.random()]),
            Self::Status => set(packet, 0, &random.random::<u16>().to_be_bytes()),
            // Payload type, time, pixel format, columns, rows, offsets, padding.
            Self::Leader if kind == gvsp::LEADER => {
                let words = packet.len().saturating_sub(gvsp::HEADER_BYTES) / 4;
                for _ in 0..random.random_range(1..4) {
                    let word = gvsp::HEADER_BYTES + 4 * random.random_range(0..words.max(1));
                    let small = random.random_range(0..4096_u32);
                    let value = if random.random() { random.random() } else { small };
                    set(packet, word, &value.to_be_bytes());
                }
            }
            Self::Shape if kind == gvsp::LEADER => {
                let columns = packet.get(24..28).and_then(|word| word.try_into().ok());
                let half = columns.map_or(0, u32::from_be_bytes) / 2;
                set(packet, 24, &half.to_be_bytes());
            }
            Self::Payload if ![gvsp::LEADER, gvsp::TRAILER].contains(&kind) => packet.clear(),
            Self::Trailer if kind == gvsp::TRAILER => packet.clear(),
            Self::Leader | Self::Shape | Self::Payload | Self::Trailer => {}
            Self::Bits => {
                for _ in 0..random.random_range(1..6) {
                    let at = random.random_range(0..packet.len().clamp(1, 48));
                    let bit = 1 << random.random_range(0..8);
                    if let Some(byte) = packet.get_mut(at) {
                        *byte ^= bit;
                    }
                }
            }
        }
    }
}

/// Spoils an answer on the control channel.
pub(super) fn spoil_answer(answer: &mut Vec<u8>, random: &mut impl Rng) {
    match random.random_range(0..9) {
        0 => noise(answer, random),
        1 => answer.truncate(random.random_range(0..answer.len().max(1))),
        // Status, answer word, size, number.
        2 => set(answer, 0, &random.random::<u16>().to_be_bytes()),
        3 => set(answer, 2, &random.random::<u16>().to_be_bytes()),
        4 => set(answer, 4, &random.random::<u16>().to_be_bytes()),
        5 => set(answer, 6, &random.random::<u16>().to_be_bytes()),
        // Noise of the right length.
        6 => {
            if let Some(payload) = answer.get_mut(8..) {
                random.fill_bytes(payload);
            }
        }
        7 => answer.resize(answer.len() + random.random_range(1..900), 0xff),
        // "Not yet": PENDING_ACK with a time to wait, milliseconds.
        _ => {
            let wait_ms: u16 = random.random_range(0..300);
            set(answer, 2, &0x0089_u16.to_be_bytes());
            set(answer, 4, &4_u16.to_be_bytes());
            answer.truncate(8);
            answer.extend([[0, 0], wait_ms.to_be_bytes()].concat());
        }
    }
}

fn noise(packet: &mut Vec<u8>, random: &mut impl Rng) {
    packet.resize(random.random_range(0..2000), 0);
    random.fill_bytes(packet);
}

/// Sets bytes where the packet reaches that far.
fn set(packet: &mut [u8], at: usize, bytes: &[u8]) {
    if let Some(place) = packet.get_mut(at..at + bytes.len()) {
        place.copy_from_slice(bytes);
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_pcg::Pcg64;

    use super::*;

    #[test]
    fn every_way_spoils_the_packets_it_is_for() {
        let mut random = Pcg64::seed_from_u64(3);
        let packet = |kind: u8| [&[0, 0, 0, 9, kind, 0, 0, 4][..], &[7; 36]].concat();
        for (name, mangling) in Mangling::ALL {
            assert_eq!(Mangling::named(name), Some(mangling));
            let kind = match mangling {
                Mangling::Leader | Mangling::Shape => gvsp::LEADER,
                Mangling::Trailer => gvsp::TRAILER,
                _ => 3,
            };
            let spoilt = (0..500).filter(|_| {
                let mut now = packet(kind);
                mangling.spoil(&mut now, &mut random);
                now != packet(kind)
            });
            let count = spoilt.count();
            // Three in eleven of any are for leaders and trailers alone.
            let least = if mangling == Mangling::Any { 300 } else { 380 };
            assert!(count > least, "{name}: {count} of 500");
            for length in 0..12 {
                let mut short = vec![1; length];
                mangling.spoil(&mut short, &mut random);
                spoil_answer(&mut short, &mut random);
            }
        }
        let mut payload = packet(3);
        Mangling::Leader.spoil(&mut payload, &mut random);
        assert_eq!(payload, packet(3), "a leader's faults are a leader's");
    }
}
