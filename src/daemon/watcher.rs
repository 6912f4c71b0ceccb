//! One camera's detection thread: live frames in, tracks of pitched balls out.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use crossbeam_channel::{Receiver, Sender};

use super::health::CameraHealth;
use crate::capture::aravis::LiveFrame;
use crate::eye::{CameraEye, EyeConfig};
use crate::scene::Track;
use crate::time::{ArrivalTime, ClockLine, HostClock, StampedMidpoint, SystemClock};

/// A track as it leaves its camera.
#[derive(Debug, Clone)]
pub struct SeenTrack {
    /// The track; its number is unique within the camera and this run.
    pub track: Track,
    /// Epoch of the camera's clock: another one, another delay.
    pub clock_epoch: u32,
    /// When the last frame that it needed had arrived.
    pub complete: ArrivalTime,
}

/// Runs until the frames end; then what was still open is decided and the end goes on downstream.
pub fn watch(
    frames: &Receiver<LiveFrame>,
    tracks: &Sender<SeenTrack>,
    eye: &EyeConfig,
    health: &Arc<CameraHealth>,
) {
    let mut watcher = Watcher {
        tracks,
        health,
        watching: None,
        numbers: 0,
        last_arrival: ArrivalTime::from_nanos(0),
        recent: VecDeque::new(),
        clock: None,
    };
    for live in frames {
        watcher.take(&live, eye);
    }
    watcher.end_window();
}

struct Watcher<'a> {
    tracks: &'a Sender<SeenTrack>,
    health: &'a CameraHealth,
    /// The eye, and the epoch of the clock that its frames are stamped by.
    watching: Option<(CameraEye, u32)>,
    numbers: u32,
    last_arrival: ArrivalTime,
    /// The latest frames: number, stamp, device time by the clock model.
    recent: VecDeque<(u64, StampedMidpoint, Option<i64>)>,
    clock: Option<ClockLine>,
}

/// Frames that a track may reach back.
const RECENT: usize = 1024;

impl Watcher<'_> {
    fn take(&mut self, live: &LiveFrame, config: &EyeConfig) {
        let frame = &live.frame;
        // Tracks do not cross a break of the clock: their stamps would not fit each other.
        if self
            .watching
            .as_ref()
            .is_some_and(|(_, epoch)| *epoch != live.clock_epoch)
        {
            self.end_window();
            self.recent.clear();
        }
        if self.recent.len() >= RECENT {
            self.recent.pop_front();
        }
        let device_ns = live.clock.map(|c| c.device_ns);
        self.recent
            .push_back((frame.stamp.frame, frame.stamp.stamped, device_ns));
        self.clock = live.clock.or(self.clock);
        self.last_arrival = frame.stamp.arrival.unwrap_or(self.last_arrival);
        let (eye, _) = self.watching.get_or_insert_with(|| {
            let camera = self.health.camera.clone();
            let new = CameraEye::new(camera, config.clone(), frame.width_px, frame.height_px);
            (new, live.clock_epoch)
        });
        match eye.push(frame) {
            Ok(()) => self.health.processed.fetch_add(1, Ordering::Relaxed),
            Err(error) => {
                tracing::debug!(camera = %self.health.camera, frame = frame.stamp.frame, %error, "not searched");
                self.health.refused.fetch_add(1, Ordering::Relaxed)
            }
        };
        let late_ns = SystemClock
            .monotonic()
            .nanos()
            .saturating_sub(self.last_arrival.nanos());
        self.health.latency.add_s(1e-9 * late_ns as f64);
        self.send();
        self.tell_how_far();
    }

    fn end_window(&mut self) {
        if let Some((eye, _)) = &mut self.watching {
            eye.finish();
        }
        self.send();
        self.watching = None;
    }

    /// Only after the tracks have gone: whoever reads this will find them in the queue. The eye answers some frames
    /// late, and after a pause it tells of what was before only then.
    fn tell_how_far(&self) {
        let Some((eye, _)) = &self.watching else { return };
        let behind = 3 * eye.lag_frames() + 2;
        let settled = self.recent.len().checked_sub(behind);
        if let Some((_, stamped, _)) = settled.and_then(|k| self.recent.get(k)) {
            self.health
                .watched_until_ns
                .store(stamped.nanos(), Ordering::Release);
        }
    }

    fn send(&mut self) {
        let Some((eye, clock_epoch)) = &mut self.watching else {
            return;
        };
        let clock_epoch = *clock_epoch;
        for mut track in eye.drain_pitches() {
            track.track = self.numbers;
            self.numbers += 1;
            if let Some(clock) = &self.clock {
                stamp_by_one_line(&mut track, &self.recent, clock);
            }
            self.health.tracks.fetch_add(1, Ordering::Relaxed);
            let seen = SeenTrack {
                track,
                clock_epoch,
                complete: self.last_arrival,
            };
            // A dozen tracks a minute into a queue of 256: full only when the assembler is gone.
            if self.tracks.send(seen).is_err() {
                tracing::error!(camera = %self.health.camera, "a track found nobody to take it");
            }
        }
    }
}

/// The clock model learns with every frame, and a young one moves while the ball flies: all points of a track are
/// stamped anew by the model as it stands at the track's end.
fn stamp_by_one_line(
    track: &mut Track,
    recent: &VecDeque<(u64, StampedMidpoint, Option<i64>)>,
    clock: &ClockLine,
) {
    for point in &mut track.points {
        let at = recent.binary_search_by_key(&point.frame, |(frame, _, _)| *frame);
        if let Some((_, _, Some(device_ns))) = at.ok().and_then(|k| recent.get(k)) {
            point.stamped = clock.stamped(*device_ns);
        }
    }
}
