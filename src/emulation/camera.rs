//! One emulated camera: its sockets, its threads, its clock, and what they share.

use std::io;
use std::net::{Ipv4Addr, SocketAddrV4, UdpSocket};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crossbeam_channel::{Sender as Channel, bounded, unbounded};
use socket2::{Domain, Protocol, Socket, Type};

use super::clock::DeviceClock;
use super::control;
use super::faults::{Drill, Faults};
use super::gvcp::GVCP_PORT;
use super::registers::{Identity, RegisterBank, STREAM_SOURCE_PORT, StrangeDescription};
use super::script::{Idle, Script, ScriptShape, Timeline};
use super::sender::{Order, Sender};
use crate::scene::PixelFormat;

/// Why an emulated camera cannot start.
#[derive(Debug, thiserror::Error)]
pub enum EmulatorError {
    /// Its address cannot be bound.
    #[error("address {address}, UDP port {port}: {source}; is it an address of this machine, and free?")]
    Bind {
        /// Address.
        address: Ipv4Addr,
        /// Port.
        port: u16,
        /// What the system says.
        source: io::Error,
    },
    /// A thread cannot be started.
    #[error("thread {0}: {1}")]
    Thread(&'static str, io::Error),
}

/// How packets are handed to the system.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Handing {
    /// Many at once, cut apart by the system (UDP GSO): half the processor time.
    #[default]
    Offloaded,
    /// One by one: on a virtual link a receiver's packet socket (AF_PACKET) sees the others before they are cut apart.
    OneByOne,
}

/// How to emulate.
#[derive(Debug, Clone)]
pub struct EmulatorOptions {
    /// Address to serve on.
    pub address: Ipv4Addr,
    /// Serial number.
    pub serial: String,
    /// User-defined name (the camera's id).
    pub user_name: String,
    /// Faults from the start.
    pub faults: Faults,
    /// Speed of the link it stands for, Gb/s; packets are spread in time accordingly.
    pub link_gbps: f64,
    /// When the script begins; `None`: with the first acquisition.
    pub begin: Option<Instant>,
    /// What is shown when the script has nothing.
    pub between: Idle,
    /// Pixel formats that it has; the first is the one at the start.
    pub pixel_formats: Vec<PixelFormat>,
    /// How packets are handed to the system.
    pub handing: Handing,
    /// Another GenICam description than the camera's own, to try a receiver with.
    pub genicam: Option<StrangeDescription>,
    /// Seed of the faults.
    pub seed: u64,
}

impl EmulatorOptions {
    /// A faultless camera on a 5 Gb/s link.
    pub fn new(address: Ipv4Addr, serial: &str) -> Self {
        Self {
            address,
            serial: serial.to_owned(),
            user_name: serial.to_owned(),
            faults: Faults::default(),
            link_gbps: 5.0,
            begin: None,
            between: Idle::Still,
            pixel_formats: vec![PixelFormat::Mono8],
            handing: Handing::Offloaded,
            genicam: None,
            seed: 1,
        }
    }
}

/// What the camera has done so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counters {
    /// Frames sent.
    pub frames: u64,
    /// Exposures that were not sent because the sender was over half a second behind.
    pub skipped: u64,
    /// Packets sent, resent ones included.
    pub packets: u64,
    /// Packets left out on purpose.
    pub lost: u64,
    /// Packets sent again on request.
    pub resent: u64,
}

#[derive(Debug, Default)]
pub(super) struct Counting {
    pub frames: AtomicU64,
    pub skipped: AtomicU64,
    pub packets: AtomicU64,
    pub lost: AtomicU64,
    pub resent: AtomicU64,
}

pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // A panicked thread leaves plain data behind: still the best there is.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// What the threads of one camera share.
pub(super) struct Shared {
    pub bank: Mutex<RegisterBank>,
    pub identity: Identity,
    pub clock: Mutex<DeviceClock>,
    pub faults: Mutex<Faults>,
    pub silent_until: Mutex<Instant>,
    pub source_port: u16,
    pub stop: AtomicBool,
    pub counting: Counting,
}

impl Shared {
    /// Whether the cable is pulled or the power is off.
    pub fn is_silent(&self) -> bool {
        Instant::now() < *lock(&self.silent_until)
    }
    pub fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }
    /// The device clock starts at zero now.
    pub fn reset_clock(&self) {
        let skew = lock(&self.faults).skew_ppm;
        *lock(&self.clock) = DeviceClock::new(Instant::now(), 0.0, skew);
    }
    /// Power-on state.
    pub fn reset_registers(&self) {
        let mut bank = RegisterBank::new(self.identity.clone());
        bank.set32(STREAM_SOURCE_PORT, u32::from(self.source_port));
        *lock(&self.bank) = bank;
    }
}

/// A running camera. Dropping it ends it.
pub struct Emulator {
    shared: Arc<Shared>,
    orders: Channel<Order>,
    threads: Vec<JoinHandle<()>>,
}

fn bound(address: Ipv4Addr, port: u16, reuse: Reuse) -> Result<UdpSocket, EmulatorError> {
    let make = || -> io::Result<UdpSocket> {
        let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))?;
        if reuse == Reuse::Shared {
            socket.set_reuse_address(true)?;
        }
        socket.bind(&SocketAddrV4::new(address, port).into())?;
        Ok(socket.into())
    };
    make().map_err(|source| EmulatorError::Bind {
        address,
        port,
        source,
    })
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Reuse {
    Alone,
    Shared,
}

fn named(name: &'static str, work: impl FnOnce() + Send + 'static) -> Result<JoinHandle<()>, EmulatorError> {
    std::thread::Builder::new()
        .name(name.to_owned())
        .spawn(work)
        .map_err(|e| EmulatorError::Thread(name, e))
}

impl Emulator {
    /// Starts a camera that shows `script`.
    ///
    /// # Errors
    /// The address cannot be bound, or a thread cannot be started.
    pub fn start(
        options: &EmulatorOptions,
        shape: ScriptShape,
        script: Script,
    ) -> Result<Self, EmulatorError> {
        let control_socket = bound(options.address, GVCP_PORT, Reuse::Alone)?;
        let stream_socket = bound(options.address, 0, Reuse::Alone)?;
        let source_port = stream_socket.local_addr().map_or(0, |a| a.port());
        let identity = Identity {
            address: options.address,
            serial: options.serial.clone(),
            user_name: options.user_name.clone(),
            width_px: shape.width_px,
            height_px: shape.height_px,
            pixel_formats: options.pixel_formats.clone(),
            rate_hz: (1.0, shape.rate_hz),
            exposure_s: shape.exposure_s,
            genicam: options.genicam.clone(),
            link_mbps: (1000.0 * options.link_gbps).clamp(1.0, 1e6) as u32,
        };
        let now = Instant::now();
        let faults = options.faults;
        let shared = Arc::new(Shared {
            bank: Mutex::new(RegisterBank::new(identity.clone())),
            identity,
            clock: Mutex::new(DeviceClock::new(now, faults.clock_offset_s, faults.skew_ppm)),
            faults: Mutex::new(faults),
            silent_until: Mutex::new(now),
            source_port,
            stop: AtomicBool::new(false),
            counting: Counting::default(),
        });
        shared.reset_registers();
        let (orders, taken) = unbounded();
        // 64 frames of read-ahead: 128 MiB at 2048×1024.
        let (frames_in, frames) = bounded(64);
        let mut emulator = Self {
            shared: shared.clone(),
            orders: orders.clone(),
            threads: Vec::new(),
        };
        let timeline = Timeline::new(shape, frames, (options.begin, options.between));
        let sender = Sender::new(
            shared.clone(),
            stream_socket,
            timeline,
            (options.link_gbps, options.handing, options.seed),
        )
        .map_err(|e| EmulatorError::Thread("emulate-send", e))?;
        emulator.threads.push(named("emulate-read", move || {
            for frame in script {
                if frames_in.send(frame).is_err() {
                    return;
                }
            }
        })?);
        emulator
            .threads
            .push(named("emulate-send", move || sender.run(&taken))?);
        let answering = control_socket
            .try_clone()
            .map_err(|e| EmulatorError::Thread("emulate-find", e))?;
        let control_shared = shared.clone();
        emulator.threads.push(named("emulate-ctrl", move || {
            control::serve(&control_shared, &control_socket, &orders);
        })?);
        // Broadcast discovery: several cameras of one host share the port; without it only unicast finds the camera.
        match bound(Ipv4Addr::BROADCAST, GVCP_PORT, Reuse::Shared) {
            Ok(broadcast) => emulator.threads.push(named("emulate-find", move || {
                control::answer_discovery(&shared, &broadcast, &answering);
            })?),
            Err(error) => tracing::warn!(%error, "broadcast discovery is off"),
        }
        Ok(emulator)
    }

    /// Does a drill now.
    pub fn drill(&self, drill: Drill) {
        let shared = &self.shared;
        let now = Instant::now();
        match drill {
            Drill::Freeze(for_time) => drop(self.orders.send(Order::Freeze(now + for_time))),
            Drill::Disconnect(for_time) => *lock(&shared.silent_until) = now + for_time,
            Drill::Reboot(for_time) => self.reboot(now + for_time),
            Drill::StepClock(by_s) => {
                let skew = lock(&shared.faults).skew_ppm;
                let mut clock = lock(&shared.clock);
                *clock = clock.stepped(now, by_s, skew);
            }
            Drill::Faults(faults) => {
                let mut clock = lock(&shared.clock);
                *clock = clock.stepped(now, 0.0, faults.skew_ppm);
                *lock(&shared.faults) = faults;
            }
            Drill::Quit => shared.stop.store(true, Ordering::Relaxed),
        }
    }

    fn reboot(&self, up: Instant) {
        *lock(&self.shared.silent_until) = up;
        self.shared.reset_registers();
        let skew = lock(&self.shared.faults).skew_ppm;
        *lock(&self.shared.clock) = DeviceClock::new(up, 0.0, skew);
        // The sender is gone only when the emulator ends.
        let _ = self.orders.send(Order::Stop);
    }

    /// The GenICam description that it serves.
    pub fn genicam(&self) -> String {
        lock(&self.shared.bank).genicam()
    }

    /// The faults that hold now.
    pub fn faults(&self) -> Faults {
        *lock(&self.shared.faults)
    }

    /// What it has done so far.
    pub fn counters(&self) -> Counters {
        let c = &self.shared.counting;
        let get = |n: &AtomicU64| n.load(Ordering::Relaxed);
        Counters {
            frames: get(&c.frames),
            skipped: get(&c.skipped),
            packets: get(&c.packets),
            lost: get(&c.lost),
            resent: get(&c.resent),
        }
    }

    /// Whether `quit` was asked for.
    pub fn is_stopped(&self) -> bool {
        self.shared.stopped()
    }
}

impl Drop for Emulator {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        let _ = self.orders.send(Order::End);
        for thread in self.threads.drain(..) {
            // A thread that panicked has said so; there is nothing to add.
            let _ = thread.join();
        }
    }
}

/// How long a socket waits before its thread looks around.
pub(super) const PATIENCE: Duration = Duration::from_millis(50);
