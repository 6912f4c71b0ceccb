//! One open camera: frames in place, losses by cause, and an end that blocks nobody.

use std::sync::Arc;
use std::time::Duration;

use aravis::glib::translate::IntoGlib;
use aravis::prelude::*;
use aravis::{Buffer, BufferPayloadType, BufferStatus, Camera};
use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded, unbounded};

use super::description;
use super::error::LiveError;
use super::ffi::{PooledFrame, RawStream, SizedBuffer, receive_buffer, touched_buffer};
use super::frame_number::FrameNumber;
use super::open::{self, Opened};
use super::options::LiveOptions;
use super::place::{self, Place};
use super::pool::BufferMaker;
use super::ptp::PtpFollower;
use crate::scene::{FrameStamp, PixelFormat, RawFrame};
use crate::time::{
    ArrivalTime, ClockEvent, ClockLine, ClockModel, ClockModelOptions, ClockReading, DeviceTime, HostClock,
    StampedMidpoint,
};

/// Frames lost, by cause, since the camera was first opened.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
pub struct LiveCounters {
    /// Whole frames.
    pub frames: u64,
    /// Numbers missing between whole frames; the causes below are among them.
    pub missing: u64,
    /// Frames that came with packets missing in spite of resends.
    pub incomplete: u64,
    /// Frames for which no buffer was free: the readers are too slow.
    pub underruns: u64,
    /// Whole frames of another size or pixel format than asked for.
    pub misshapen: u64,
    /// Packets that were asked for again.
    pub resend_requests: u64,
    /// Frames whose device time could not be believed.
    pub clock_outliers: u64,
}

/// A frame with what the clock model says of it.
#[derive(Debug, Clone)]
pub struct LiveFrame {
    /// Image, as it came, and times.
    pub frame: RawFrame,
    /// 1σ of the stamp, seconds.
    pub stamp_sigma_s: f64,
    /// Rises when the capture delay may have changed.
    pub clock_epoch: u32,
    /// The clock model as it stands with this frame.
    pub clock: Option<ClockLine>,
    /// Exposure, seconds.
    pub exposure_s: f64,
    /// Frames lost right before this one.
    pub lost_before: u64,
}

/// What a wait brought.
#[derive(Debug)]
pub enum Next {
    /// A whole frame.
    Frame(LiveFrame),
    /// A frame that was not whole; it is counted.
    Incomplete,
    /// A frame of another size or pixel format than asked for: which. It is counted.
    Misshapen(String),
    /// Nothing within the time.
    Nothing,
}

/// What outlives a connection: the frames' memory, numbers, clock and counters of one camera.
pub struct CameraMemory {
    home: Sender<SizedBuffer>,
    returns: Receiver<SizedBuffer>,
    /// Frames that readers have.
    out: usize,
    maker: BufferMaker,
    numbers: FrameNumber,
    last_number: u64,
    clock: ClockModel,
    counters: LiveCounters,
    last_stamp: Option<StampedMidpoint>,
}

impl Default for CameraMemory {
    fn default() -> Self {
        let (home, returns) = unbounded();
        Self {
            home,
            returns,
            out: 0,
            maker: BufferMaker::new(),
            numbers: FrameNumber::default(),
            last_number: 0,
            clock: ClockModel::new(ClockModelOptions::default()),
            counters: LiveCounters::default(),
            last_stamp: None,
        }
    }
}

impl CameraMemory {
    /// Counters so far.
    pub fn counters(&self) -> LiveCounters {
        self.counters
    }
    /// Rate of the camera's clock over the host's, ppm, with 1σ.
    pub fn skew_ppm(&self) -> Option<(f64, f64)> {
        self.clock.skew_ppm()
    }
}

/// A camera that is found, opened and set up, and does not stream yet.
pub struct ReadyCamera {
    place: Place,
    opened: Opened,
}

impl ReadyCamera {
    /// Finds, opens and sets up a camera: on a bad day that takes ten seconds, on any thread.
    ///
    /// # Errors
    /// What stands in the way, with what to do.
    pub fn open(options: &LiveOptions) -> Result<Self, LiveError> {
        let place = place::locate(options)?;
        if let Place::Gige(address) = place {
            place::check_free(options, address)?;
            description::check(&options.camera, address)?;
        }
        let opened = open::open(options, &place)?;
        Ok(Self { place, opened })
    }
}

/// A streaming camera. One thread owns it; see `ffi.rs`.
pub struct LiveCamera {
    options: LiveOptions,
    place: Place,
    camera: Camera,
    stream: RawStream,
    payload_bytes: usize,
    /// Buffers that the library has.
    in_stream: usize,
    exposure_s: f64,
    packet_size: u32,
    model: String,
    ptp: Option<PtpFollower>,
    socket_buffer_bytes: Option<usize>,
    /// The library's own counters when the stream began, so that ours go on over reconnections.
    underruns_seen: u64,
    resends_seen: u64,
}

impl LiveCamera {
    /// Finds, opens, sets up and starts a camera.
    ///
    /// # Errors
    /// What stands in the way, with what to do.
    pub fn start(options: &LiveOptions, memory: &mut CameraMemory) -> Result<Self, LiveError> {
        Self::begin(ReadyCamera::open(options)?, options, memory)
    }

    /// Gives a camera that is set up its memory, and starts it.
    ///
    /// # Errors
    /// It does not start.
    pub fn begin(
        ready: ReadyCamera,
        options: &LiveOptions,
        memory: &mut CameraMemory,
    ) -> Result<Self, LiveError> {
        let ReadyCamera { place, opened } = ready;
        let mut live = Self {
            options: options.clone(),
            place,
            camera: opened.camera,
            stream: opened.stream,
            payload_bytes: opened.payload_bytes,
            in_stream: 0,
            exposure_s: opened.exposure_s,
            packet_size: opened.packet_size,
            model: opened.model,
            ptp: opened.ptp,
            socket_buffer_bytes: opened.socket_buffer_bytes,
            underruns_seen: 0,
            resends_seen: 0,
        };
        live.take_back(memory);
        while live.in_stream < options.ready() {
            live.push(touched_buffer(live.payload_bytes));
        }
        memory.numbers = FrameNumber::after(memory.last_number);
        memory.clock.restart();
        if let Err(error) = live.camera.start_acquisition() {
            live.abandon();
            return Err(LiveError::Library {
                camera: options.camera.clone(),
                doing: "start the acquisition",
                reason: error.message().to_owned(),
            });
        }
        Ok(live)
    }

    fn push(&mut self, buffer: Buffer) {
        self.stream.push(buffer);
        self.in_stream += 1;
    }

    /// Frames that readers have let go of; memory of another size is let go, and so is more than the pool may have.
    fn take_back(&mut self, memory: &mut CameraMemory) {
        // A USB stream of 0.8.26 remembers buffers by their address: none of those it has had may be freed while it runs.
        let keeps_all = self.stream.gige().is_none();
        while let Ok(SizedBuffer { buffer, bytes }) = memory.returns.try_recv() {
            memory.out = memory.out.saturating_sub(1);
            let room = keeps_all || self.in_stream + memory.out < self.options.buffers;
            if room && bytes == self.payload_bytes {
                self.push(buffer);
            }
        }
    }

    /// More buffers where readers keep those that there are.
    fn grow(&mut self, memory: &mut CameraMemory) {
        while let Some(buffer) = memory.maker.take(self.payload_bytes) {
            self.push(buffer);
        }
        let room = self.options.buffers.saturating_sub(self.in_stream + memory.out);
        let missing = self.options.ready().saturating_sub(self.in_stream);
        memory.maker.ask(self.payload_bytes, room.min(missing));
    }

    /// Whether a reader that can do without may keep a frame: half of what is to be free is free.
    pub fn has_room(&self) -> bool {
        2 * self.in_stream >= self.options.ready()
    }

    /// Where it is.
    pub fn place(&self) -> &Place {
        &self.place
    }
    /// Its model.
    pub fn model(&self) -> &str {
        &self.model
    }
    /// The receive buffer that the system has granted, where that is less than was asked for.
    pub fn small_socket_buffer(&self) -> Option<usize> {
        self.socket_buffer_bytes
            .filter(|granted| *granted < self.options.socket_buffer_bytes)
    }
    /// Where its clock stands with the network's (PTP), in the standard's words; `None` where it does not try.
    pub fn ptp_state(&self) -> Option<&str> {
        self.ptp.as_ref().map(PtpFollower::state)
    }
    /// Asks the camera from time to time whether its clock follows the network's. That may take half a second: not for a
    /// moment when a ball flies.
    pub fn look_at_clock(&mut self) {
        if let Some(ptp) = &mut self.ptp {
            ptp.look(&self.camera);
        }
    }
    /// Packet size in use; 0 for USB.
    pub fn packet_size(&self) -> u32 {
        self.packet_size
    }

    /// Waits for the next frame.
    pub fn next(&mut self, memory: &mut CameraMemory, clock: &dyn HostClock, patience: Duration) -> Next {
        self.take_back(memory);
        self.grow(memory);
        let timeout_us = u64::try_from(patience.as_micros()).unwrap_or(u64::MAX);
        let Some(buffer) = self.stream.pop(timeout_us) else {
            self.count(memory);
            return Next::Nothing;
        };
        self.in_stream = self.in_stream.saturating_sub(1);
        let (width_px, height_px) = self.options.size_px;
        // Metadata of a buffer that is not complete is of its previous use.
        let (id, device_ns, arrival_unix_ns) =
            (buffer.frame_id(), buffer.timestamp(), buffer.system_timestamp());
        if let Some(shape) = self.another_shape(&buffer) {
            self.push(buffer);
            memory.counters.misshapen += 1;
            return Next::Misshapen(shape);
        }
        let buffer = SizedBuffer {
            buffer,
            bytes: self.payload_bytes,
        };
        match PooledFrame::new(buffer, self.options.frame_bytes(), memory.home.clone()) {
            Err(buffer) => {
                self.push(buffer);
                memory.counters.incomplete += 1;
                Next::Incomplete
            }
            Ok(pixels) => {
                memory.out += 1;
                let arrival = clock.monotonic_of_unix(arrival_unix_ns);
                let (stamp, reading, lost_before) = self.stamp(memory, (id, device_ns), arrival);
                Next::Frame(LiveFrame {
                    frame: RawFrame {
                        stamp,
                        width_px,
                        height_px,
                        format: self.options.pixel_format,
                        pixels: Arc::new(pixels),
                    },
                    stamp_sigma_s: reading.sigma_s,
                    clock_epoch: reading.epoch,
                    clock: reading.line,
                    exposure_s: self.exposure_s,
                    lost_before,
                })
            }
        }
    }

    /// What a whole buffer holds, if it is not what was asked for.
    fn another_shape(&self, buffer: &Buffer) -> Option<String> {
        if buffer.status() != BufferStatus::Success {
            return None;
        }
        // The library's getters are for images alone.
        let payload = buffer.payload_type();
        let image = matches!(
            payload,
            BufferPayloadType::Image | BufferPayloadType::ChunkData | BufferPayloadType::ExtendedChunkData
        );
        if !image || buffer.n_parts() == 0 {
            return Some(format!("no image ({payload:?})"));
        }
        let got = [buffer.image_width(), buffer.image_height()].map(|n| u32::try_from(n).unwrap_or(0));
        let code = buffer.image_pixel_format().into_glib();
        let asked = &self.options;
        if (got[0], got[1]) != asked.size_px || code != asked.pixel_format.code() {
            let name = PixelFormat::of_code(code)
                .map_or_else(|| format!("pixel format {code:#010x}"), |f| f.to_string());
            return Some(format!("{}x{} {name}", got[0], got[1]));
        }
        let received = buffer.data().1;
        if received < asked.frame_bytes() {
            return Some(format!("{received} bytes"));
        }
        let (padding, _) = buffer.image_padding();
        (padding != 0).then(|| format!("rows with {padding} bytes of padding"))
    }

    fn stamp(
        &mut self,
        memory: &mut CameraMemory,
        (id, device_ns): (u64, u64),
        arrival: ArrivalTime,
    ) -> (FrameStamp, ClockReading, u64) {
        let device = DeviceTime::from_nanos(i64::try_from(device_ns).unwrap_or(i64::MAX));
        let own = memory.clock.push(device, arrival, self.exposure_s);
        // Calibrations know a clock by its epoch: 0 is the network's, a camera's own begins at 1.
        let own = ClockReading {
            epoch: own.epoch.saturating_add(1),
            ..own
        };
        let reading = match &mut self.ptp {
            Some(ptp) => ptp.stamp(own, self.exposure_s),
            None => own,
        };
        // After a reconnection the numbers go on as if the camera had never stopped.
        if memory.numbers.is_first()
            && let Some(last) = memory.last_stamp
        {
            let gap_s = reading.stamped.seconds_since(last.nanos()).clamp(0.0, 1e6);
            let unseen = (gap_s * self.options.frame_rate_hz).round() as u64;
            memory.counters.missing += unseen.saturating_sub(1);
            memory.numbers = FrameNumber::after(memory.last_number.saturating_add(unseen.saturating_sub(1)));
        }
        let (frame, lost) = memory.numbers.number(id);
        memory.last_number = frame;
        memory.last_stamp = Some(reading.stamped);
        memory.counters.frames += 1;
        memory.counters.missing += lost;
        if matches!(reading.event, Some(ClockEvent::Outlier { .. })) {
            memory.counters.clock_outliers += 1;
        }
        if let Some(event @ (ClockEvent::Restarted { .. } | ClockEvent::Wrapped { .. })) = reading.event {
            tracing::warn!(camera = %self.options.camera, frame, ?event, "the camera's clock");
        }
        if lost > 0 || frame.is_multiple_of(64) {
            self.count(memory);
        }
        let stamp = FrameStamp {
            frame,
            device: Some(device),
            arrival: Some(arrival),
            stamped: reading.stamped,
        };
        (stamp, reading, lost)
    }

    /// Adds what the library has counted since the last look. It counts every packet for which there was no buffer.
    fn count(&mut self, memory: &mut CameraMemory) {
        let data = self.packet_size.saturating_sub(36).max(1) as usize;
        let packets = match self.packet_size {
            0 => 1,
            _ => self.payload_bytes.div_ceil(data) as u64 + 2,
        };
        let frames = self
            .stream
            .counter("n_underruns")
            .saturating_sub(self.underruns_seen)
            / packets;
        memory.counters.underruns += frames;
        self.underruns_seen += frames * packets;
        if self.stream.gige().is_none() {
            return;
        }
        let resends = self.stream.counter("n_resend_requests");
        memory.counters.resend_requests += resends.saturating_sub(self.resends_seen);
        self.resends_seen = resends;
    }

    /// Whether the camera answers and is still held (by us): `None` when it is silent, or not of the kind that is asked.
    pub fn is_held(&self) -> Option<bool> {
        self.place.is_held()
    }

    /// Stops a camera. A live one takes 2 ms; one that does not answer blocks for up to twelve seconds, and is waited for
    /// no longer than [`STOP_PATIENCE`]: answers whether it has stopped.
    pub fn stop(self) -> bool {
        let (ended_in, ended) = bounded::<()>(0);
        self.let_go(move |camera, stream| {
            let _ = camera.stop_acquisition();
            drop((stream, camera));
            drop(ended_in);
        });
        ended.recv_timeout(STOP_PATIENCE) == Err(RecvTimeoutError::Disconnected)
    }

    /// Lets go of a camera that does not answer. Its tear-down blocks for up to twelve seconds: a thread of its own
    /// does that.
    pub fn abandon(self) {
        self.let_go(|camera, stream| drop((stream, camera)));
    }

    fn let_go(self, how: impl FnOnce(Camera, RawStream) + Send + 'static) {
        let name = "camera-teardown".to_owned();
        let (camera, stream) = (self.camera, self.stream);
        let work = move || how(camera, stream);
        if let Err(error) = std::thread::Builder::new().name(name).spawn(work) {
            tracing::error!(camera = %self.options.camera, %error, "the camera is torn down in line");
        }
    }
}

/// How long a camera may take to stop.
const STOP_PATIENCE: Duration = Duration::from_secs(1);

/// Receive buffer that the system grants when `asked` is asked for; less means `net.core.rmem_max` is too small.
///
/// # Errors
/// No socket to be had.
pub fn granted_socket_buffer(asked: usize) -> std::io::Result<usize> {
    use socket2::{Domain, SockRef, Socket, Type};
    let socket = Socket::new(Domain::IPV4, Type::DGRAM, None)?;
    receive_buffer(&SockRef::from(&socket), asked)
}
