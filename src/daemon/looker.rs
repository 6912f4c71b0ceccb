//! One camera's second look: balls whose paths have ended in, tracks of pitched balls out. Its thread may take its time:
//! the frames are searched by another.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use crossbeam_channel::{Receiver, Sender};

use super::health::CameraHealth;
use crate::eye::{BallStep, EndedBall, EyeConfig, FlyingBall, SecondLook};
use crate::scene::Track;
use crate::time::{ArrivalTime, StampedMidpoint};

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

/// What the second look is told, in the order in which it happened.
pub enum ToLook {
    /// A ball that still flies: most of the work is done when it has landed.
    Flying(Box<FlyingBall>),
    /// A ball that was last seen some frames ago: what is found now need not be sought when its path has ended.
    Early(Box<EndedBall>),
    /// A ball whose path has ended.
    Ball(Box<BallToLookAt>),
    /// Every ball up to this stamp has been told of.
    WatchedUntil(StampedMidpoint),
}

/// A ball whose path has ended.
pub struct BallToLookAt {
    /// The ball.
    pub ended: EndedBall,
    /// Stamps of its frames by the clock as it stood at the path's end.
    pub stamps: Vec<(u64, StampedMidpoint)>,
    /// Epoch of that clock.
    pub clock_epoch: u32,
    /// Arrival of the frame with which the path ended.
    pub complete: ArrivalTime,
}

/// Runs until the eye ends.
pub fn look(
    balls: &Receiver<ToLook>,
    (tracks, steps): (&Sender<SeenTrack>, &Sender<BallStep>),
    config: &EyeConfig,
    health: &Arc<CameraHealth>,
) {
    let mut second = SecondLook::new(config);
    let mut numbers = 0;
    for told in balls {
        let ball = match told {
            ToLook::Ball(ball) => *ball,
            ToLook::Flying(flying) => {
                second.look_ahead(&flying);
                continue;
            }
            ToLook::Early(ending) => {
                second.look_early(*ending);
                continue;
            }
            ToLook::WatchedUntil(stamped) => {
                health.watched_until_ns.store(stamped.nanos(), Ordering::Release);
                continue;
            }
        };
        let (looked_at, step) = second.look(ball.ended);
        if let Some(step) = step {
            // The eye takes the next one if it has not taken the last.
            let _ = steps.try_send(step);
        }
        for mut track in second.pitches(vec![looked_at]) {
            track.track = numbers;
            numbers += 1;
            for point in &mut track.points {
                let at = ball
                    .stamps
                    .binary_search_by_key(&point.frame, |(frame, _)| *frame);
                if let Some((_, stamped)) = at.ok().and_then(|k| ball.stamps.get(k)) {
                    point.stamped = *stamped;
                }
            }
            health.tracks.fetch_add(1, Ordering::Relaxed);
            let seen = SeenTrack {
                track,
                clock_epoch: ball.clock_epoch,
                complete: ball.complete,
            };
            // A dozen tracks a minute into a queue of 256: full only when the assembler is gone.
            if tracks.send(seen).is_err() {
                tracing::error!(camera = %health.camera, "a track found nobody to take it");
            }
        }
        health.second_look.add_since_ns(ball.complete.nanos());
    }
}
