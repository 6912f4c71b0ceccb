//! The stream channel of the emulated camera: cuts frames into packets and sends them in paced GSO groups.

use std::collections::VecDeque;
use std::io;
use std::net::{SocketAddr, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, RecvTimeoutError};
use quinn_udp::{Transmit, UdpSockRef, UdpSocketState};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;

use super::camera::{Handing, Shared, lock};
use super::gvsp::{self, ImageLeader, PacketPlan};
use super::packing::pack;
use super::registers::StreamSettings;
use super::script::{Pixels, Slot, Timeline};
use crate::scene::PixelFormat;

/// What the sender is told.
pub(super) enum Order {
    Start(StreamSettings),
    Stop,
    Resend(u16, u32, u32),
    TestPacket(StreamSettings),
    Freeze(Instant),
    End,
}

/// Frames kept for resends.
const KEPT: usize = 8;
/// A GSO message is at most a 16-bit length.
const MESSAGE_BYTES: usize = 65_000;
/// Packets between two looks at the clock and the orders.
const PACED_BYTES: usize = 250_000;
/// Time before a departure that is not slept through.
const AWAKE: Duration = Duration::from_micros(150);
/// Behind by more than this, exposures are skipped.
const BEHIND: Duration = Duration::from_millis(500);

/// A frame as it was sent.
struct Kept {
    block: u16,
    plan: PacketPlan,
    leader: ImageLeader,
    image: Pixels,
}

impl Kept {
    /// Appends packet `number`, whichever kind it is.
    fn packet(&self, number: u32, into: &mut Vec<u8>) {
        match number {
            0 => gvsp::leader(self.block, &self.leader, into),
            n if n == self.plan.trailer() => {
                gvsp::trailer(self.block, &self.plan, self.leader.height_px, into)
            }
            n => gvsp::payload(self.block, &self.plan, n, &self.image, into),
        }
    }
}

struct Stream {
    settings: StreamSettings,
    /// No exposure before this.
    earliest: Instant,
    /// Share of the script's exposures that are sent, accumulated.
    phase: f64,
}

pub(super) struct Sender {
    shared: Arc<Shared>,
    socket: UdpSocket,
    state: UdpSocketState,
    handing: Handing,
    timeline: Timeline,
    link_bytes_per_s: f64,
    rng: Pcg64,
    block: u16,
    kept: VecDeque<Kept>,
    /// Groups held back: when they go, bytes, packet length.
    held: Vec<(Instant, Vec<u8>, usize)>,
    held_to: SocketAddr,
    frozen_until: Instant,
    /// When the link is free again.
    link_free: Instant,
    group: Vec<u8>,
}

impl Sender {
    pub fn new(
        shared: Arc<Shared>,
        socket: UdpSocket,
        timeline: Timeline,
        (link_gbps, handing, seed): (f64, Handing, u64),
    ) -> io::Result<Self> {
        let state = UdpSocketState::new(UdpSockRef::from(&socket))?;
        let reference = socket2::SockRef::from(&socket);
        reference.set_send_buffer_size(4 << 20)?;
        let now = Instant::now();
        Ok(Self {
            shared,
            socket,
            state,
            handing,
            timeline,
            link_bytes_per_s: if link_gbps > 0.0 {
                link_gbps * 1e9 / 8.0
            } else {
                f64::INFINITY
            },
            rng: Pcg64::seed_from_u64(seed),
            block: 0,
            kept: VecDeque::new(),
            held: Vec::new(),
            held_to: SocketAddr::from(([0, 0, 0, 0], 0)),
            frozen_until: now,
            link_free: now,
            group: Vec::with_capacity(MESSAGE_BYTES + 16),
        })
    }

    /// Sends until told to end.
    pub fn run(mut self, orders: &Receiver<Order>) {
        let mut stream: Option<Stream> = None;
        loop {
            let Some(current) = &mut stream else {
                match orders.recv() {
                    Ok(Order::End) | Err(_) => return,
                    Ok(order) => self.obey(order, &mut stream),
                }
                continue;
            };
            let Some(slot) = self.timeline.next_after(current.earliest) else {
                // The script is over: what was sent may still be asked for again.
                match orders.recv() {
                    Ok(Order::End) | Err(_) => return,
                    Ok(order) => self.obey(order, &mut stream),
                }
                continue;
            };
            current.earliest = slot.begin + Duration::from_nanos(1);
            current.phase += current.settings.rate_hz / self.shared.identity.rate_hz.1;
            if current.phase < 1.0 - 1e-6 {
                continue;
            }
            current.phase -= 1.0;
            let settings = current.settings;
            let departs = slot.begin + Duration::from_secs_f64(settings.exposure_s + self.jitter_s());
            let image = self.cut(slot.pixels, settings.region);
            let slot = Slot {
                begin: slot.begin,
                pixels: match settings.pixel_format {
                    PixelFormat::Mono8 => image,
                    packed => Arc::new(pack(packed, &image)),
                },
            };
            if !self.wait(orders, departs, &mut stream) {
                return;
            }
            if stream.as_ref().is_some_and(|s| s.settings == settings) {
                self.expose(&settings, slot, departs);
            }
        }
    }

    fn jitter_s(&mut self) -> f64 {
        let mean_s = 1e-3 * lock(&self.shared.faults).jitter_ms;
        -mean_s * self.rng.random_range(1e-9..1.0_f64).ln()
    }

    /// Waits until a frame departs, obeying orders; `false` at the end.
    fn wait(&mut self, orders: &Receiver<Order>, departs: Instant, stream: &mut Option<Stream>) -> bool {
        loop {
            self.release_held();
            let next = self
                .held
                .iter()
                .map(|h| h.0)
                .min()
                .map_or(departs, |h| h.min(departs));
            // A camera's exposures are timed by hardware. A sleep ends some 60 us late and by a different amount each time,
            // which the receiver's clock model would see: the last of it is waited out awake.
            match orders.recv_deadline(next.checked_sub(AWAKE).unwrap_or(next)) {
                Ok(Order::End) | Err(RecvTimeoutError::Disconnected) => return false,
                Ok(order) => {
                    self.obey(order, stream);
                    if stream.is_none() {
                        return true;
                    }
                }
                Err(RecvTimeoutError::Timeout) => {
                    while Instant::now() < next {
                        std::hint::spin_loop();
                    }
                    if next >= departs {
                        return !self.shared.stopped();
                    }
                }
            }
        }
    }

    fn obey(&mut self, order: Order, stream: &mut Option<Stream>) {
        match order {
            Order::Start(settings) => {
                self.block = 0;
                self.kept.clear();
                *stream = Some(Stream {
                    settings,
                    earliest: Instant::now(),
                    phase: 1.0,
                });
            }
            Order::Stop | Order::End => *stream = None,
            Order::Resend(block, first, last) => self.resend(block, first, last, stream.as_ref()),
            Order::TestPacket(settings) => {
                let bytes = (settings.packet_size as usize).saturating_sub(gvsp::IP_UDP_BYTES);
                let packet = vec![0; bytes];
                self.transmit(&settings, &packet, bytes);
            }
            Order::Freeze(until) => self.frozen_until = until,
        }
    }

    /// One exposure: the image, as the stream has it, becomes a block and goes out.
    fn expose(&mut self, settings: &StreamSettings, slot: Slot, departs: Instant) {
        let now = Instant::now();
        if now < self.frozen_until {
            return;
        }
        self.block = gvsp::next_block(self.block);
        if now.saturating_duration_since(departs) > BEHIND {
            self.shared.counting.skipped.fetch_add(1, Ordering::Relaxed);
            return;
        }
        let [width_px, height_px, offset_x_px, offset_y_px] = settings.region;
        let kept = Kept {
            block: self.block,
            plan: PacketPlan::new(settings.packet_size, slot.pixels.len()),
            leader: ImageLeader {
                timestamp_ticks: lock(&self.shared.clock).ticks(slot.begin),
                pixel_format: settings.pixel_format,
                width_px,
                height_px,
                offset_x_px,
                offset_y_px,
            },
            image: slot.pixels,
        };
        self.send_frame(settings, &kept);
        self.shared.counting.frames.fetch_add(1, Ordering::Relaxed);
        if self.kept.len() >= KEPT {
            self.kept.pop_front();
        }
        self.kept.push_back(kept);
    }

    /// The region of interest; the whole sensor is not copied.
    fn cut(&self, pixels: Pixels, [width, height, x, y]: [u32; 4]) -> Pixels {
        let sensor_width = self.shared.identity.width_px as usize;
        if width as usize == sensor_width && height == self.shared.identity.height_px {
            return pixels;
        }
        let mut image = Vec::with_capacity(width as usize * height as usize);
        for row in pixels
            .chunks(sensor_width.max(1))
            .skip(y as usize)
            .take(height as usize)
        {
            image.extend_from_slice(row.get(x as usize..(x + width) as usize).unwrap_or_default());
        }
        Arc::new(image)
    }

    fn send_frame(&mut self, settings: &StreamSettings, frame: &Kept) {
        let packet_bytes = frame.plan.data_bytes + gvsp::HEADER_BYTES;
        let faults = *lock(&self.shared.faults);
        let per_group = match self.handing {
            // Spoilt packets differ in length.
            _ if faults.mangle > 0.0 => 1,
            Handing::Offloaded => (MESSAGE_BYTES / packet_bytes).clamp(1, self.state.max_gso_segments()),
            Handing::OneByOne => 1,
        };
        let mut since_pause = 0;
        self.link_free = self.link_free.max(Instant::now());
        let mut group = std::mem::take(&mut self.group);
        let trailer = frame.plan.trailer();
        let mut next = 0;
        while next <= trailer {
            // Packets of one group have one length, but for the last: leader and trailer go alone.
            let end = match next {
                0 => 1,
                n if n == trailer => n + 1,
                n => trailer.min(n + per_group as u32),
            };
            group.clear();
            for number in next..end {
                if faults.loss > 0.0 && self.rng.random_bool(faults.loss) {
                    self.shared.counting.lost.fetch_add(1, Ordering::Relaxed);
                } else {
                    frame.packet(number, &mut group);
                }
            }
            next = end;
            let mut length = packet_bytes;
            if faults.mangle > 0.0 && self.rng.random_bool(faults.mangle) {
                faults.mangling.spoil(&mut group, &mut self.rng);
                // One packet, however long it is now.
                length = length.max(group.len());
            }
            self.dispatch(settings, &group, length, &faults);
            since_pause += group.len();
            if since_pause >= PACED_BYTES {
                self.pace(since_pause);
                since_pause = 0;
            }
        }
        self.pace(since_pause);
        self.group = group;
    }

    /// Lets the link carry what was handed to it.
    fn pace(&mut self, bytes: usize) {
        self.link_free += Duration::from_secs_f64(bytes as f64 / self.link_bytes_per_s);
        let ahead = self.link_free.saturating_duration_since(Instant::now());
        // A sleep is some 60 us longer than asked: shorter debts are carried over.
        if ahead > Duration::from_micros(120) {
            std::thread::sleep(ahead - Duration::from_micros(60));
        }
        self.release_held();
    }

    fn dispatch(
        &mut self,
        settings: &StreamSettings,
        group: &[u8],
        packet_bytes: usize,
        faults: &super::Faults,
    ) {
        if faults.reorder > 0.0 && self.rng.random_bool(faults.reorder) {
            let due = Instant::now() + Duration::from_secs_f64(1e-3 * faults.reorder_ms);
            self.held.push((due, group.to_vec(), packet_bytes));
        } else {
            self.transmit(settings, group, packet_bytes);
        }
        if !self.held.is_empty() {
            self.held_to = SocketAddr::V4(settings.to);
        }
    }

    fn release_held(&mut self) {
        if self.held.is_empty() {
            return;
        }
        let now = Instant::now();
        let (due, later) = std::mem::take(&mut self.held)
            .into_iter()
            .partition(|h| h.0 <= now);
        self.held = later;
        let due: Vec<_> = due;
        for (_, group, packet_bytes) in due {
            self.transmit_to(self.held_to, &group, packet_bytes);
        }
    }

    fn resend(&mut self, block: u16, first: u32, last: u32, stream: Option<&Stream>) {
        let Some(stream) = stream else { return };
        let Some(at) = self.kept.iter().position(|k| k.block == block) else {
            return;
        };
        let loss = lock(&self.shared.faults).loss;
        let mut packet = Vec::new();
        let last = last.min(self.kept.get(at).map_or(0, |k| k.plan.trailer()));
        for number in first..=last {
            if loss > 0.0 && self.rng.random_bool(loss) {
                self.shared.counting.lost.fetch_add(1, Ordering::Relaxed);
                continue;
            }
            packet.clear();
            if let Some(kept) = self.kept.get(at) {
                kept.packet(number, &mut packet);
            }
            self.transmit(&stream.settings, &packet, packet.len());
            self.shared.counting.resent.fetch_add(1, Ordering::Relaxed);
        }
    }

    fn transmit(&self, settings: &StreamSettings, bytes: &[u8], packet_bytes: usize) {
        self.transmit_to(SocketAddr::V4(settings.to), bytes, packet_bytes);
    }

    fn transmit_to(&self, to: SocketAddr, bytes: &[u8], packet_bytes: usize) {
        if bytes.is_empty() || to.port() == 0 || self.shared.is_silent() {
            return;
        }
        let transmit = Transmit {
            destination: to,
            ecn: None,
            contents: bytes,
            segment_size: (bytes.len() > packet_bytes).then_some(packet_bytes),
            src_ip: None,
        };
        for _ in 0..200 {
            match self.state.try_send(UdpSockRef::from(&self.socket), &transmit) {
                Ok(()) => {
                    let packets = bytes.len().div_ceil(packet_bytes.max(1)) as u64;
                    self.shared.counting.packets.fetch_add(packets, Ordering::Relaxed);
                    return;
                }
                // The socket's buffer is full: the link is slower than asked.
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                    std::thread::sleep(Duration::from_micros(50));
                }
                Err(error) => {
                    tracing::debug!(%error, %to, "packets could not be sent");
                    return;
                }
            }
        }
    }
}
