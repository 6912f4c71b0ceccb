//! What every camera's threads tell about themselves: state and counters, written by one thread, read by anyone.

use super::histogram::Histogram;
use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU8, AtomicU64, Ordering};

use crate::scene::CameraId;

/// Where a camera stands (design §6).
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
#[repr(u8)]
pub enum CameraState {
    /// Nobody answers.
    Absent = 0,
    /// Being opened.
    Connecting = 1,
    /// Frames come.
    Streaming = 2,
    /// It answers, but no frames come, or none that can be used.
    Degraded = 3,
    /// It has just been lost.
    Lost = 4,
    /// Refused; waiting before the next try.
    Backoff = 5,
}

impl CameraState {
    fn of(number: u8) -> Self {
        match number {
            1 => Self::Connecting,
            2 => Self::Streaming,
            3 => Self::Degraded,
            4 => Self::Lost,
            5 => Self::Backoff,
            _ => Self::Absent,
        }
    }
}

/// One camera's health.
#[derive(Debug)]
pub struct CameraHealth {
    /// Whose.
    pub camera: CameraId,
    state: AtomicU8,
    /// Whole frames from the camera.
    pub frames: AtomicU64,
    /// Frames the camera, the link or the receiver lost.
    pub missing: AtomicU64,
    /// Of those: packets missing in spite of resends.
    pub incomplete: AtomicU64,
    /// Of those: no free buffer.
    pub underruns: AtomicU64,
    /// Of those: whole, but of another size or pixel format.
    pub misshapen: AtomicU64,
    /// Whole frames dropped because detection was busy.
    pub dropped: AtomicU64,
    /// Frames that went through detection.
    pub processed: AtomicU64,
    /// Frames that detection refused.
    pub refused: AtomicU64,
    /// Balls that got no second look, because too many came at once.
    pub balls_lost: AtomicU64,
    /// Stills of home plate that nobody took, because too many waited.
    pub stills_lost: AtomicU64,
    /// Whether what may be a ball is being followed.
    pub in_flight: AtomicBool,
    /// Tracks of pitched balls.
    pub tracks: AtomicU64,
    /// Times the camera was lost.
    pub losses: AtomicU64,
    /// Stamp up to which every track has been handed on, nanoseconds.
    pub settled_ns: AtomicI64,
    /// Stamp of the newest frame at which nothing was being followed that might be a ball, and what had been followed
    /// before it was handed on, nanoseconds.
    pub clear_ns: AtomicI64,
    /// Of every frame: from arrival of its first packet to the end of detection.
    pub latency: Histogram,
    /// Of every ball: from arrival of the frame with which its path ended to its fitted track.
    pub second_look: Histogram,
}

impl CameraHealth {
    /// A camera not yet seen.
    pub fn new(camera: CameraId) -> Self {
        Self {
            camera,
            state: AtomicU8::new(0),
            frames: AtomicU64::new(0),
            missing: AtomicU64::new(0),
            incomplete: AtomicU64::new(0),
            underruns: AtomicU64::new(0),
            misshapen: AtomicU64::new(0),
            dropped: AtomicU64::new(0),
            processed: AtomicU64::new(0),
            refused: AtomicU64::new(0),
            balls_lost: AtomicU64::new(0),
            stills_lost: AtomicU64::new(0),
            in_flight: AtomicBool::new(false),
            tracks: AtomicU64::new(0),
            losses: AtomicU64::new(0),
            settled_ns: AtomicI64::new(i64::MIN),
            clear_ns: AtomicI64::new(i64::MIN),
            latency: Histogram::default(),
            second_look: Histogram::default(),
        }
    }
    /// Where it stands.
    pub fn state(&self) -> CameraState {
        CameraState::of(self.state.load(Ordering::Relaxed))
    }
    /// Goes to a state; answers whether it is another one.
    pub fn set_state(&self, state: CameraState) -> bool {
        self.state.swap(state as u8, Ordering::Relaxed) != state as u8
    }
    /// One line for people: everything that was lost, by cause.
    pub fn line(&self) -> String {
        let get = |n: &AtomicU64| n.load(Ordering::Relaxed);
        format!(
            "{} {:?}: {} frames, {} processed, {} missing ({} incomplete, {} without buffer, {} of another shape), {} dropped before detection, \
             {} refused, {} tracks, {} balls not looked at, {} stills not taken, lost {} times, arrival to detected {}, path's end to fitted {}",
            self.camera,
            self.state(),
            get(&self.frames),
            get(&self.processed),
            get(&self.missing),
            get(&self.incomplete),
            get(&self.underruns),
            get(&self.misshapen),
            get(&self.dropped),
            get(&self.refused),
            get(&self.tracks),
            get(&self.balls_lost),
            get(&self.stills_lost),
            get(&self.losses),
            self.latency.in_words(),
            self.second_look.in_words(),
        )
    }
}
