//! One camera's eye thread: every live frame searched as it comes; balls whose paths have ended, and balls in flight, out.
//!
//! Nothing here waits: what is dear (fitting centres, solving flights) is other threads' work.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use crossbeam_channel::{Receiver, Sender};

use super::foresee::{ForeseenBall, InFlight};
use super::health::CameraHealth;
use super::looker::{BallToLookAt, ToLook};
use super::outfit::Wanted;
use crate::capture::aravis::LiveFrame;
use crate::detection::{Still, UnpackedFrames};
use crate::eye::{BallStep, EndedBall, EyeConfig, FirstLook};
use crate::scene::{CameraId, RawFrame};
use crate::time::{ArrivalTime, ClockLine, StampedMidpoint};
use crate::tracking::OpenPath;

/// Where an eye's thread sends what it finds.
pub struct EyeChannels {
    /// Ended balls, to this camera's second look.
    pub look: Sender<ToLook>,
    /// Balls in flight.
    pub in_flight: Sender<InFlight>,
    /// What the second look has found of this camera's balls.
    pub steps: Receiver<BallStep>,
    /// Where this camera will see a ball in flight.
    pub foreseen: Receiver<ForeseenBall>,
    /// Stills of home plate, to where calibrations are made.
    pub stills: Sender<(CameraId, Still)>,
}

/// Places in the queue to the second look that are kept for balls: news of how far has been watched may be missed.
const PLACES_FOR_BALLS: usize = 48;

/// Runs until the frames end; then what was still open is decided and the end goes on downstream.
pub fn watch(
    frames: &Receiver<LiveFrame>,
    channels: &EyeChannels,
    wanted: Wanted,
    health: &Arc<CameraHealth>,
) {
    let Wanted { eye, still } = wanted;
    let mut watcher = Watcher {
        still,
        unpacked: UnpackedFrames::default(),
        channels,
        health,
        watching: None,
        last_arrival: ArrivalTime::from_nanos(0),
        recent: VecDeque::with_capacity(RECENT),
        clock: None,
        stamp_sigma_s: f64::INFINITY,
        in_flight: false,
    };
    for live in frames {
        watcher.take(&live, &eye);
    }
    watcher.end_window();
}

struct Watcher<'a> {
    /// Of home plate; of packed frames an image is made for it.
    still: Option<Still>,
    unpacked: UnpackedFrames,
    channels: &'a EyeChannels,
    health: &'a CameraHealth,
    /// The eye, and the epoch of the clock that its frames are stamped by.
    watching: Option<(FirstLook, u32)>,
    last_arrival: ArrivalTime,
    /// The latest frames: number, stamp, device time by the clock model.
    recent: VecDeque<(u64, StampedMidpoint, Option<i64>)>,
    clock: Option<ClockLine>,
    /// 1σ of the newest stamp, seconds.
    stamp_sigma_s: f64,
    /// Whether balls in flight were told of with the last frame.
    in_flight: bool,
}

/// A ball flies 15 mm in this time. In its first two seconds a clock may be off by more: every frame may have been late.
const STAMP_SIGMA_MAX_S: f64 = 0.4e-3;

/// Frames that a track may reach back.
const RECENT: usize = 1024;

impl Watcher<'_> {
    fn take(&mut self, live: &LiveFrame, config: &EyeConfig) {
        let frame = &live.frame;
        self.keep_to_epoch(live.clock_epoch);
        if self.recent.len() >= RECENT {
            self.recent.pop_front();
        }
        let device_ns = live.clock.map(|c| c.device_ns);
        self.recent
            .push_back((frame.stamp.frame, frame.stamp.stamped, device_ns));
        self.clock = live.clock.or(self.clock);
        self.stamp_sigma_s = live.stamp_sigma_s;
        self.last_arrival = frame.stamp.arrival.unwrap_or(self.last_arrival);
        let (eye, _) = self.watching.get_or_insert_with(|| {
            let camera = self.health.camera.clone();
            let new = FirstLook::new(camera, config, frame.width_px, frame.height_px);
            (new, live.clock_epoch)
        });
        for step in self.channels.steps.try_iter() {
            eye.adapt(step);
        }
        for ball in self.channels.foreseen.try_iter() {
            if ball.clock_epoch == live.clock_epoch {
                eye.foresee(ball.path);
            }
        }
        match eye.push_raw(frame) {
            Ok(()) => self.health.processed.fetch_add(1, Ordering::Relaxed),
            Err(error) => {
                tracing::debug!(camera = %self.health.camera, frame = frame.stamp.frame, %error, "not searched");
                self.health.refused.fetch_add(1, Ordering::Relaxed)
            }
        };
        self.health.latency.add_since_ns(self.last_arrival.nanos());
        let open = eye.open();
        let flying = eye.flying(&open);
        let follows = eye.follows(&open);
        self.health.in_flight.store(follows, Ordering::Relaxed);
        self.tell_of_flights(open);
        for flying in flying {
            // Only a help: where it is missed the fit begins anew.
            let _ = self.channels.look.try_send(ToLook::Flying(Box::new(flying)));
        }
        self.hand_on();
        self.tell_how_far(follows);
        self.take_still(frame);
    }

    /// Home plate as it looks most of the time is told of when as many frames of it are there as are kept.
    fn take_still(&mut self, frame: &RawFrame) {
        let Some(still) = &mut self.still else { return };
        if !still.is_due() {
            return;
        }
        let image = frame.mono8().or_else(|| self.unpacked.image(frame));
        if image.is_some_and(|image| still.take(&image)) {
            // Only a help: the next one says more.
            let told = (self.health.camera.clone(), still.clone());
            if self.channels.stills.try_send(told).is_err() {
                self.health.stills_lost.fetch_add(1, Ordering::Relaxed);
            }
        }
    }

    /// Tracks do not cross a break of the clock: their stamps would not fit each other. What the eye knows of the picture
    /// (its noise, its light) goes on.
    fn keep_to_epoch(&mut self, epoch: u32) {
        if self.watching.as_ref().is_none_or(|(_, of_eye)| *of_eye == epoch) {
            return;
        }
        self.end_window();
        self.recent.clear();
        self.still.iter_mut().for_each(Still::clear);
        if let Some((_, of_eye)) = &mut self.watching {
            *of_eye = epoch;
        }
    }

    fn end_window(&mut self) {
        if let Some((eye, _)) = &mut self.watching {
            eye.finish();
        }
        self.hand_on();
    }

    /// The balls in flight, and once that there are none any more.
    fn tell_of_flights(&mut self, paths: Vec<OpenPath>) {
        let Some((eye, clock_epoch)) = &self.watching else {
            return;
        };
        if self.stamp_sigma_s > STAMP_SIGMA_MAX_S || paths.is_empty() && !self.in_flight {
            return;
        }
        self.in_flight = !paths.is_empty();
        // A queue that is full holds news older than this frame's: the next frame tells again.
        let _ = self.channels.in_flight.try_send(InFlight {
            camera: self.health.camera.clone(),
            clock_epoch: *clock_epoch,
            arrived: self.last_arrival,
            paths,
            off_light_px: eye.off_light_px(),
        });
    }

    /// Only after the balls have gone: whoever hears this will have had them. The eye answers some frames late, and
    /// after a pause it tells of what was before only then.
    fn tell_how_far(&self, follows: bool) {
        let Some((eye, _)) = &self.watching else { return };
        if self.channels.look.len() + PLACES_FOR_BALLS >= LOOK_QUEUE {
            return;
        }
        let lag = eye.lag_frames();
        let before = |frames: usize| {
            let (_, stamped, _) = self.recent.get(self.recent.len().checked_sub(1 + frames)?)?;
            Some(*stamped)
        };
        let told = ToLook::Watched {
            settled: before(3 * lag + 1),
            clear: before(lag).filter(|_| !follows),
        };
        let _ = self.channels.look.try_send(told);
    }

    fn hand_on(&mut self) {
        let Some((eye, clock_epoch)) = &mut self.watching else {
            return;
        };
        let clock_epoch = *clock_epoch;
        for ending in eye.ending() {
            // Only a help: it may be missed.
            let _ = self.channels.look.try_send(ToLook::Early(Box::new(ending)));
        }
        for ended in eye.drain() {
            if ended.cut_outs.is_none() {
                tracing::debug!(camera = %self.health.camera, kind = ?ended.ball.kind, "moved");
                continue;
            }
            if self.stamp_sigma_s > STAMP_SIGMA_MAX_S {
                tracing::info!(camera = %self.health.camera, "a ball is left out: its camera's clock is not known yet");
                continue;
            }
            let ball = BallToLookAt {
                stamps: stamps_by_one_line(&ended, &self.recent, self.clock.as_ref()),
                ended,
                clock_epoch,
                complete: self.last_arrival,
            };
            if self.channels.look.try_send(ToLook::Ball(Box::new(ball))).is_err() {
                self.health.balls_lost.fetch_add(1, Ordering::Relaxed);
                tracing::error!(camera = %self.health.camera, "a ball was not looked at again: too many at once");
            }
        }
    }
}

/// Places in the queue to the second look.
pub const LOOK_QUEUE: usize = 64;

/// The clock model learns with every frame, and a young one moves while the ball flies: all points of a track get
/// stamps by the model as it stands at the track's end, those too that the second look finds in other frames' cut-outs.
fn stamps_by_one_line(
    ended: &EndedBall,
    recent: &VecDeque<(u64, StampedMidpoint, Option<i64>)>,
    clock: Option<&ClockLine>,
) -> Vec<(u64, StampedMidpoint)> {
    let Some(clock) = clock else { return Vec::new() };
    let Some(cut_outs) = &ended.cut_outs else {
        return Vec::new();
    };
    let seen = ended.ball.track.points.iter().map(|point| point.frame);
    let mut frames: Vec<u64> = seen.chain(cut_outs.frames().map(|(frame, _)| frame)).collect();
    frames.sort_unstable();
    frames.dedup();
    let stamped = |frame: u64| {
        let at = recent.binary_search_by_key(&frame, |(frame, _, _)| *frame);
        let (_, _, device_ns) = recent.get(at.ok()?)?;
        Some((frame, clock.stamped((*device_ns)?)))
    };
    frames.into_iter().filter_map(stamped).collect()
}

#[cfg(test)]
#[path = "watcher_tests.rs"]
mod tests;
