//! One camera's capture thread: absent → connecting → streaming → degraded → lost → backoff → connecting.
//!
//! A camera's trouble is its own: nothing here waits for another camera, and nothing in the way of a frame blocks.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use crossbeam_channel::{RecvTimeoutError, Sender, TrySendError, bounded};

use super::health::{CameraHealth, CameraState};
use super::recorder::{RecordedLive, RecorderHealth};
use crate::capture::aravis::{
    CameraMemory, LiveCamera, LiveError, LiveFrame, LiveOptions, Next, Place, ReadyCamera,
};
use crate::time::SystemClock;

/// Longest wait for one frame before looking around.
const LOOK_AROUND: Duration = Duration::from_millis(100);
/// Silence after which the camera is asked whether it is alive. The look comes up to 0.1 s later, the answer takes up to
/// 0.3 s: a loss is told of within a second.
const SILENCE: Duration = Duration::from_millis(500);
/// Frames without a whole one among them for this long are a fault to be told of.
const NONE_WHOLE: Duration = Duration::from_secs(2);
/// A camera that answers but sends nothing for this long is opened anew.
const FROZEN: Duration = Duration::from_secs(6);
const BACKOFF_FIRST: Duration = Duration::from_millis(250);
const BACKOFF_MOST: Duration = Duration::from_secs(2);

/// A camera's capture thread.
pub struct Supervisor {
    /// How to open it.
    pub options: LiveOptions,
    /// Where frames go; when it is full the frame is dropped and counted.
    pub frames: Sender<LiveFrame>,
    /// The recorder, and what it could not take.
    pub record: Option<(Sender<RecordedLive>, Arc<RecorderHealth>)>,
    /// What it tells.
    pub health: Arc<CameraHealth>,
    /// Set: stop.
    pub stop: Arc<AtomicBool>,
}

/// How a connection ended.
enum End {
    Stopped,
    Lost,
}

impl Supervisor {
    /// Runs until told to stop; dropping `frames` then tells the end downstream.
    pub fn run(self) {
        let mut memory = CameraMemory::default();
        let mut backoff = BACKOFF_FIRST;
        let mut said = String::new();
        let mut warned = false;
        while !self.stopped() {
            if self.health.state() != CameraState::Absent {
                self.health.set_state(CameraState::Connecting);
            }
            let Some(connected) = self.connect(&mut memory) else {
                return;
            };
            match connected {
                Ok(camera) => {
                    tracing::info!(
                        camera = %self.options.camera, address = %camera.place(), model = camera.model(),
                        packet_size = camera.packet_size(), "streaming"
                    );
                    self.warn_of_small_buffer(&camera, &mut warned);
                    (backoff, said) = (BACKOFF_FIRST, String::new());
                    if matches!(self.stream(camera, &mut memory), End::Stopped) {
                        return;
                    }
                }
                Err(error) => {
                    let absent = matches!(error, LiveError::Absent { .. });
                    self.health.set_state(if absent {
                        CameraState::Absent
                    } else {
                        CameraState::Backoff
                    });
                    // Once per reason, not once per try.
                    let text = error.to_string();
                    if text != said {
                        tracing::warn!("{text}");
                        said = text;
                    }
                    // A program that died (an earlier run of this one) holds a camera until its heartbeat lapses, and
                    // asking who holds it is eight bytes.
                    if matches!(error, LiveError::Held { .. }) {
                        backoff = BACKOFF_FIRST;
                    }
                    self.sleep(backoff);
                    backoff = (backoff * 3 / 2).min(BACKOFF_MOST);
                }
            }
        }
    }

    /// Opens the camera on a thread of its own: one that falls silent meanwhile holds that thread for ten seconds, and
    /// not the end of the daemon. `None`: told to stop.
    fn connect(&self, memory: &mut CameraMemory) -> Option<Result<LiveCamera, LiveError>> {
        let failed = |reason: String| LiveError::Library {
            camera: self.options.camera.clone(),
            doing: "open it on a thread of its own",
            reason,
        };
        let (ready_in, ready) = bounded(1);
        let options = self.options.clone();
        let name = format!("open-{}", options.camera);
        // Whoever waited may have gone: then the camera is let go of here.
        let open = move || drop(ready_in.send(ReadyCamera::open(&options)));
        if let Err(error) = std::thread::Builder::new().name(name).spawn(open) {
            return Some(Err(failed(error.to_string())));
        }
        loop {
            match ready.recv_timeout(LOOK_AROUND) {
                Ok(opened) => {
                    return Some(opened.and_then(|r| LiveCamera::begin(r, &self.options, memory)));
                }
                Err(RecvTimeoutError::Timeout) if self.stopped() => return None,
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => {
                    return Some(Err(failed("the thread ended early".to_owned())));
                }
            }
        }
    }

    /// Once, not with every connection.
    fn warn_of_small_buffer(&self, camera: &LiveCamera, warned: &mut bool) {
        let asked = self.options.socket_buffer_bytes;
        if let Some(granted) = camera.small_socket_buffer()
            && !std::mem::replace(warned, true)
        {
            tracing::warn!(
                camera = %self.options.camera,
                "its socket has a buffer of {granted} bytes, {asked} were asked for: a busy host will lose frames; \
                 sysctl -w net.core.rmem_max={asked}"
            );
        }
    }

    fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    fn sleep(&self, time: Duration) {
        let until = Instant::now() + time;
        while !self.stopped() && Instant::now() < until {
            std::thread::sleep(Duration::from_millis(20).min(time));
        }
    }

    fn stream(&self, mut camera: LiveCamera, memory: &mut CameraMemory) -> End {
        let mut heard = Instant::now();
        let (mut asked, mut whole) = (heard, heard);
        loop {
            if self.stopped() {
                if !camera.stop() {
                    tracing::warn!(camera = %self.options.camera, "does not answer: it is left as it is");
                }
                return End::Stopped;
            }
            match camera.next(memory, &SystemClock, LOOK_AROUND) {
                Next::Frame(frame) => {
                    heard = Instant::now();
                    (asked, whole) = (heard, heard);
                    if self.health.set_state(CameraState::Streaming) {
                        tracing::info!(camera = %self.options.camera, frame = frame.frame.stamp.frame, "frames come");
                    }
                    self.record(&frame, &camera);
                    self.hand_on(frame);
                    if !self.health.in_flight.load(Ordering::Relaxed) {
                        camera.look_at_clock();
                    }
                }
                unusable @ (Next::Incomplete | Next::Misshapen(_)) => {
                    heard = Instant::now();
                    asked = heard;
                    if whole.elapsed() >= NONE_WHOLE && self.health.set_state(CameraState::Degraded) {
                        self.warn_of(&unusable, camera.packet_size());
                    }
                }
                Next::Nothing if asked.elapsed() >= SILENCE => {
                    asked = Instant::now();
                    let held = camera.is_held();
                    if held != Some(true) || heard.elapsed() >= FROZEN {
                        self.lose(camera, held, heard);
                        return End::Lost;
                    }
                    if self.health.set_state(CameraState::Degraded) {
                        let silent_ms = heard.elapsed().as_millis() as u64;
                        tracing::warn!(camera = %self.options.camera, silent_ms, "answers, but sends no frames");
                    }
                }
                Next::Nothing => {}
            }
            self.tell(memory);
        }
    }

    /// To the recorder, if the camera has memory to spare: that grows while the recorder fills its own.
    fn record(&self, frame: &LiveFrame, camera: &LiveCamera) {
        let Some((recorder, lost)) = &self.record else {
            return;
        };
        let recorded = RecordedLive {
            camera: self.options.camera.clone(),
            frame: frame.frame.clone(),
            exposure_s: frame.exposure_s,
        };
        if !camera.has_room() || recorder.try_send(recorded).is_err() {
            lost.frames_lost.fetch_add(1, Ordering::Relaxed);
        }
    }

    fn hand_on(&self, frame: LiveFrame) {
        if let Err(TrySendError::Full(_)) = self.frames.try_send(frame) {
            self.health.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Frames come, and none can be used.
    fn warn_of(&self, unusable: &Next, packet_size: u32) {
        let camera = &self.options.camera;
        match unusable {
            Next::Misshapen(shape) => {
                let (width, height) = self.options.size_px;
                tracing::warn!(
                    %camera, "frames come as {shape}, asked were {width}x{height} {}: another program has changed the \
                     camera, or its firmware is at fault; power it off and on", self.options.pixel_format
                );
            }
            _ => tracing::warn!(
                %camera, "frames come, none of them whole: packets of {packet_size} bytes do not all pass; look at cable and \
                 switch, at jumbo frames (MTU) of every port on the way, or set packet_size = 1500"
            ),
        }
    }

    fn lose(&self, camera: LiveCamera, held: Option<bool>, heard: Instant) {
        self.health.set_state(CameraState::Lost);
        self.health.losses.fetch_add(1, Ordering::Relaxed);
        let why = match held {
            None if matches!(camera.place(), Place::Device(_)) => "it sends nothing",
            None => "it does not answer",
            Some(false) => "it has been restarted",
            Some(true) => "it answers but sends nothing",
        };
        tracing::warn!(
            camera = %self.options.camera, silent_ms = heard.elapsed().as_millis() as u64,
            "lost: {why}; connecting anew"
        );
        camera.abandon();
    }

    fn tell(&self, memory: &CameraMemory) {
        let counters = memory.counters();
        let health = &self.health;
        for (to, from) in [
            (&health.frames, counters.frames),
            (&health.missing, counters.missing),
            (&health.incomplete, counters.incomplete),
            (&health.underruns, counters.underruns),
            (&health.misshapen, counters.misshapen),
        ] {
            to.store(from, Ordering::Relaxed);
        }
    }
}
