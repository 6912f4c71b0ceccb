//! The recorder's thread: the last seconds of every camera in memory, and from them a clip of every pitch.
//!
//! Frames stay in the buffers in which they arrived. What the recorder holds of them, in the ring, in clips waiting for
//! the disk and in the one being written, is counted to the byte and never exceeds its limit: a slow disk makes the
//! ring shorter and clips poorer, and nobody upstream waits.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, Sender};

use super::clip_disk::DiskJob;
use crate::config::{RecordConfig, RecordMode};
use crate::scene::{CameraId, RawFrame};

/// What the recorder has done and left undone.
#[derive(Debug, Default)]
pub struct RecorderHealth {
    /// Bytes of frames held now.
    pub held_bytes: AtomicUsize,
    /// Clips (or continuous sessions) written whole.
    pub clips: AtomicU64,
    /// Clips without all of their frames: they had left the memory.
    pub clips_cut: AtomicU64,
    /// Clips lost: the disk was busy, full or gone.
    pub clips_lost: AtomicU64,
    /// Frames on the disk.
    pub frames: AtomicU64,
    /// Frames not recorded.
    pub frames_lost: AtomicU64,
}

impl RecorderHealth {
    /// One line for people.
    pub fn line(&self) -> String {
        let get = |n: &AtomicU64| n.load(Ordering::Relaxed);
        format!(
            "recorder: {} clips, {} cut short, {} lost, {} frames written, {} lost, {} MiB in memory",
            get(&self.clips),
            get(&self.clips_cut),
            get(&self.clips_lost),
            get(&self.frames),
            get(&self.frames_lost),
            self.held_bytes.load(Ordering::Relaxed) >> 20
        )
    }
}

/// A frame in the recorder's memory; counted as long as anybody here holds it.
pub struct HeldFrame {
    /// Whose.
    pub camera: CameraId,
    /// The frame, as it came.
    pub frame: RawFrame,
    /// Exposure, seconds.
    pub exposure_s: f64,
    health: Arc<RecorderHealth>,
}

impl HeldFrame {
    fn new(camera: CameraId, frame: RawFrame, exposure_s: f64, health: &Arc<RecorderHealth>) -> Self {
        health
            .held_bytes
            .fetch_add(frame.bytes().len(), Ordering::Relaxed);
        Self {
            camera,
            frame,
            exposure_s,
            health: health.clone(),
        }
    }
    fn stamp_ns(&self) -> i64 {
        self.frame.stamp.stamped.nanos()
    }
}

impl Drop for HeldFrame {
    fn drop(&mut self) {
        let bytes = self.frame.bytes().len();
        self.health.held_bytes.fetch_sub(bytes, Ordering::Relaxed);
    }
}

/// A frame on its way to the recorder.
pub struct RecordedLive {
    /// Whose.
    pub camera: CameraId,
    /// The frame, as it came.
    pub frame: RawFrame,
    /// Exposure, seconds.
    pub exposure_s: f64,
}

/// A ball was seen: its first and last stamp, nanoseconds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ClipTrigger {
    /// Of the first point.
    pub first_ns: i64,
    /// Of the last.
    pub last_ns: i64,
}

/// The recorder's thread.
pub struct Recorder {
    config: RecordConfig,
    cameras: Vec<CameraId>,
    disk: Sender<DiskJob>,
    health: Arc<RecorderHealth>,
    rings: Vec<VecDeque<Arc<HeldFrame>>>,
    waiting: Vec<(ClipTrigger, Instant)>,
    /// Stamp of the latest frame that had to go.
    gone_ns: i64,
}

/// A camera that is silent is not waited for longer than this.
const PATIENCE: Duration = Duration::from_secs(2);

impl Recorder {
    /// A recorder with an empty memory.
    pub fn new(
        config: RecordConfig,
        cameras: Vec<CameraId>,
        disk: Sender<DiskJob>,
        health: Arc<RecorderHealth>,
    ) -> Self {
        Self {
            rings: cameras.iter().map(|_| VecDeque::new()).collect(),
            config,
            cameras,
            disk,
            health,
            waiting: Vec::new(),
            gone_ns: i64::MIN,
        }
    }

    /// Runs until the frames end; clips not yet complete are written with what there is. `configs` are newer settings:
    /// what is remembered and cut out changes with them, the mode does not.
    pub fn run(
        mut self,
        frames: &Receiver<RecordedLive>,
        triggers: &Receiver<ClipTrigger>,
        configs: &Receiver<RecordConfig>,
    ) {
        let tick = Duration::from_millis(50);
        loop {
            match frames.recv_timeout(tick) {
                Ok(live) => self.take(live),
                Err(crossbeam_channel::RecvTimeoutError::Timeout) => {}
                Err(crossbeam_channel::RecvTimeoutError::Disconnected) => break,
            }
            for new in configs.try_iter() {
                let RecordConfig {
                    before_s, after_s, ..
                } = new;
                (self.config.before_s, self.config.after_s) = (before_s, after_s);
            }
            self.waiting
                .extend(triggers.try_iter().map(|t| (t, Instant::now())));
            self.cut_clips(false);
        }
        // The last balls are decided after the last frame.
        while let Ok(trigger) = triggers.recv() {
            self.waiting.push((trigger, Instant::now()));
        }
        self.cut_clips(true);
    }

    fn take(&mut self, live: RecordedLive) {
        let Some(at) = self.cameras.iter().position(|c| *c == live.camera) else {
            return;
        };
        let limit = self.config.memory_bytes;
        let need = live.frame.bytes().len();
        while self.health.held_bytes.load(Ordering::Relaxed) + need > limit {
            // The longest memory gives first. What a clip still holds is not freed by this: then the rings empty, and
            // at last the frame is not kept.
            let longest = self.rings.iter_mut().max_by_key(|r| r.len());
            let Some(oldest) = longest.and_then(VecDeque::pop_front) else {
                self.gone_ns = self.gone_ns.max(live.frame.stamp.stamped.nanos());
                self.health.frames_lost.fetch_add(1, Ordering::Relaxed);
                return;
            };
            self.gone_ns = self.gone_ns.max(oldest.stamp_ns());
        }
        let held = Arc::new(HeldFrame::new(
            live.camera,
            live.frame,
            live.exposure_s,
            &self.health,
        ));
        if self.config.mode == RecordMode::Continuous {
            if self.disk.try_send(DiskJob::Frame(held)).is_err() {
                self.health.frames_lost.fetch_add(1, Ordering::Relaxed);
            }
        } else if let Some(ring) = self.rings.get_mut(at) {
            ring.push_back(held);
        }
    }

    /// Hands complete clips to the disk; all of them at the end.
    fn cut_clips(&mut self, all: bool) {
        if self.config.mode != RecordMode::Clips {
            self.waiting.clear();
            return;
        }
        let after_ns = (1e9 * self.config.after_s) as i64;
        let newest: Vec<Option<i64>> = self
            .rings
            .iter()
            .map(|r| r.back().map(|f| f.stamp_ns()))
            .collect();
        let complete = |(trigger, since): &(ClipTrigger, Instant)| {
            let until = trigger.last_ns.saturating_add(after_ns);
            all || since.elapsed() > PATIENCE || newest.iter().flatten().all(|n| *n >= until)
        };
        let (ready, waiting) = std::mem::take(&mut self.waiting).into_iter().partition(complete);
        self.waiting = waiting;
        let ready: Vec<(ClipTrigger, Instant)> = ready;
        for (trigger, _) in ready {
            self.cut(trigger);
        }
    }

    fn cut(&mut self, trigger: ClipTrigger) {
        let from = trigger
            .first_ns
            .saturating_sub((1e9 * self.config.before_s) as i64);
        let until = trigger.last_ns.saturating_add((1e9 * self.config.after_s) as i64);
        let cut_short = self.gone_ns >= from;
        let frames: Vec<_> = self
            .rings
            .iter()
            .flatten()
            .filter(|f| (from..=until).contains(&f.stamp_ns()))
            .cloned()
            .collect();
        if cut_short {
            self.health.clips_cut.fetch_add(1, Ordering::Relaxed);
            tracing::warn!(
                frames = frames.len(),
                "a clip is cut short: some of its frames had left the memory"
            );
        }
        let count = frames.len() as u64;
        if self.disk.try_send(DiskJob::Clip(frames)).is_err() {
            self.health.clips_lost.fetch_add(1, Ordering::Relaxed);
            self.health.frames_lost.fetch_add(count, Ordering::Relaxed);
            tracing::error!("a clip is lost: the disk is still busy with those before");
        }
    }
}

#[cfg(test)]
#[path = "recorder_tests.rs"]
mod tests;
