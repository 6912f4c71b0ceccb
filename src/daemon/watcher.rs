//! One camera's detection thread: live frames in, tracks of pitched balls out.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use crossbeam_channel::{Receiver, Sender};

use super::health::CameraHealth;
use crate::capture::aravis::LiveFrame;
use crate::eye::{CameraEye, EyeConfig};
use crate::scene::Track;
use crate::time::{ArrivalTime, HostClock, SystemClock};

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
    let mut watching: Option<(CameraEye, u32)> = None;
    let mut numbers = 0;
    let mut last_arrival = ArrivalTime::from_nanos(0);
    for live in frames {
        let frame = &live.frame;
        // Tracks do not cross a break of the clock: their stamps would not fit each other.
        if let Some((old, epoch)) = &mut watching
            && *epoch != live.clock_epoch
        {
            old.finish();
            send(old, (*epoch, last_arrival), &mut numbers, tracks, health);
            watching = None;
        }
        let (eye, epoch) = watching.get_or_insert_with(|| {
            let new = CameraEye::new(
                health.camera.clone(),
                eye.clone(),
                frame.width_px,
                frame.height_px,
            );
            (new, live.clock_epoch)
        });
        last_arrival = frame.stamp.arrival.unwrap_or(last_arrival);
        match eye.push(frame) {
            Ok(()) => health.processed.fetch_add(1, Ordering::Relaxed),
            Err(error) => {
                tracing::debug!(camera = %health.camera, frame = frame.stamp.frame, %error, "not searched");
                health.refused.fetch_add(1, Ordering::Relaxed)
            }
        };
        let late_ns = SystemClock
            .monotonic()
            .nanos()
            .saturating_sub(last_arrival.nanos());
        health
            .latency_us
            .store(u64::try_from(late_ns / 1000).unwrap_or(0), Ordering::Relaxed);
        let epoch = *epoch;
        send(eye, (epoch, last_arrival), &mut numbers, tracks, health);
        // Only now: whoever reads this will find the tracks in the queue.
        health
            .watched_until_ns
            .store(frame.stamp.stamped.nanos(), Ordering::Release);
    }
    if let Some((eye, epoch)) = &mut watching {
        eye.finish();
        send(eye, (*epoch, last_arrival), &mut numbers, tracks, health);
    }
}

fn send(
    eye: &mut CameraEye,
    (clock_epoch, complete): (u32, ArrivalTime),
    numbers: &mut u32,
    tracks: &Sender<SeenTrack>,
    health: &CameraHealth,
) {
    for mut track in eye.drain_pitches() {
        track.track = *numbers;
        *numbers += 1;
        health.tracks.fetch_add(1, Ordering::Relaxed);
        let seen = SeenTrack {
            track,
            clock_epoch,
            complete,
        };
        // A dozen tracks a minute into a queue of 256: full only when the assembler is gone.
        if tracks.send(seen).is_err() {
            tracing::error!(camera = %health.camera, "a track found nobody to take it");
        }
    }
}
