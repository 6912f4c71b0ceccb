//! One camera's second look: balls whose paths have ended in, tracks of pitched balls out. Its thread may take its time:
//! the frames are searched by another.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, TryRecvError};

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
    /// How far has been watched.
    Watched {
        /// Every ball up to this stamp has been told of.
        settled: Option<StampedMidpoint>,
        /// Nothing is being followed any more at this one.
        clear: Option<StampedMidpoint>,
    },
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

/// A ball in flight is told of again, or its path ends, within so many frames; after them other balls are no longer kept
/// waiting for it. Nor are they when so many wait.
const PATIENCE_FRAMES: f64 = 45.0;
const WAITING_MAX: usize = 32;

/// Runs until the eye ends. While a ball flies that has been looked at in flight, all else waits: what ends with a pitch
/// (a bat, a glove, a runner) is dearer to look at than what is left of the pitch.
pub fn look(
    balls: &Receiver<ToLook>,
    (tracks, steps): (&Sender<SeenTrack>, &Sender<BallStep>),
    config: &EyeConfig,
    health: &Arc<CameraHealth>,
) {
    let mut looker = Looker {
        second: SecondLook::new(config),
        tracks,
        steps,
        health,
        numbers: 0,
    };
    let patience = Duration::from_secs_f64(PATIENCE_FRAMES / config.tracker.frame_rate_hz.max(1.0));
    let mut waiting: VecDeque<ToLook> = VecDeque::new();
    let mut flying_until: Option<Instant> = None;
    loop {
        let told = match flying_until {
            Some(until) => balls.recv_deadline(until),
            None if waiting.is_empty() => balls.recv().map_err(|_| RecvTimeoutError::Disconnected),
            None => balls.try_recv().map_err(|error| match error {
                TryRecvError::Empty => RecvTimeoutError::Timeout,
                TryRecvError::Disconnected => RecvTimeoutError::Disconnected,
            }),
        };
        match told {
            Ok(ToLook::Flying(flying)) => {
                if looker.second.look_ahead(&flying) {
                    flying_until = Some(Instant::now() + patience);
                }
            }
            Ok(ToLook::Early(ending)) if looker.second.knows(&ending) || flying_until.is_none() => {
                looker.second.look_early(*ending);
                flying_until = flying_until.map(|_| Instant::now() + patience);
            }
            Ok(ToLook::Early(_)) => {}
            Ok(ToLook::Ball(ball)) if looker.second.knows(&ball.ended) => {
                looker.look_at(*ball);
                flying_until = None;
            }
            Ok(other) => {
                // How far has been watched: the newest says it all.
                match (other, waiting.back_mut()) {
                    (ToLook::Watched { settled, clear }, Some(ToLook::Watched { settled: s, clear: c })) => {
                        (*s, *c) = (settled.or(*s), clear.or(*c));
                    }
                    (other, _) => waiting.push_back(other),
                }
            }
            Err(RecvTimeoutError::Timeout) => flying_until = None,
            Err(RecvTimeoutError::Disconnected) => break,
        }
        if (flying_until.is_none() && balls.is_empty() || waiting.len() > WAITING_MAX)
            && let Some(next) = waiting.pop_front()
        {
            looker.take(next);
        }
    }
    for told in waiting {
        looker.take(told);
    }
}

struct Looker<'a> {
    second: SecondLook,
    tracks: &'a Sender<SeenTrack>,
    steps: &'a Sender<BallStep>,
    health: &'a CameraHealth,
    /// Tracks so far.
    numbers: u32,
}

impl Looker<'_> {
    fn take(&mut self, told: ToLook) {
        match told {
            ToLook::Ball(ball) => self.look_at(*ball),
            ToLook::Watched { settled, clear } => {
                for (to, from) in [(&self.health.settled_ns, settled), (&self.health.clear_ns, clear)] {
                    if let Some(stamped) = from {
                        to.store(stamped.nanos(), Ordering::Release);
                    }
                }
            }
            ToLook::Flying(_) | ToLook::Early(_) => {}
        }
    }

    fn look_at(&mut self, ball: BallToLookAt) {
        let (looked_at, step) = self.second.look(ball.ended);
        if let Some(step) = step {
            // The eye takes the next one if it has not taken the last.
            let _ = self.steps.try_send(step);
        }
        for mut track in self.second.pitches(vec![looked_at]) {
            track.track = self.numbers;
            self.numbers += 1;
            for point in &mut track.points {
                let at = ball
                    .stamps
                    .binary_search_by_key(&point.frame, |(frame, _)| *frame);
                if let Some((_, stamped)) = at.ok().and_then(|k| ball.stamps.get(k)) {
                    point.stamped = *stamped;
                }
            }
            self.health.tracks.fetch_add(1, Ordering::Relaxed);
            let seen = SeenTrack {
                track,
                clock_epoch: ball.clock_epoch,
                complete: ball.complete,
            };
            // A dozen tracks a minute into a queue of 256: full only when the assembler is gone.
            if self.tracks.send(seen).is_err() {
                tracing::error!(camera = %self.health.camera, "a track found nobody to take it");
            }
        }
        self.health.second_look.add_since_ns(ball.complete.nanos());
    }
}

#[cfg(test)]
mod tests {
    use super::super::watcher::LOOK_QUEUE;
    use super::*;
    use crate::detection::painter::{Ball, Canvas};
    use crate::eye::FirstLook;
    use crate::scene::CameraId;
    use crossbeam_channel::bounded;

    /// What an eye tells of one flight that begins at this frame.
    fn flight(begin: u64) -> (FlyingBall, EndedBall) {
        let config = EyeConfig::default();
        let mut eye = FirstLook::new(CameraId::new("side").unwrap(), &config, 640, 240);
        let stand = Canvas::stand(640, 240, 3, 40.0);
        let (mut flying, mut ended) = (Vec::new(), Vec::new());
        for number in 0..90u64 {
            let mut canvas = stand.clone();
            if (10..62).contains(&number) {
                let t = number as f64 - 10.0;
                canvas.ball(&Ball {
                    centre: [20.0 + 8.5 * t, 90.0 + 0.6 * t + 0.011 * t * t],
                    streak: [1.6, 0.2],
                    radius: 3.2,
                    light: 190.0,
                    shade: 130.0,
                    to_light: [0.2, -0.9, -0.3],
                });
            }
            eye.push(&canvas.frame(begin + number, 175.0, 2.0)).unwrap();
            let open = eye.open();
            flying.extend(eye.flying(&open));
            ended.extend(eye.drain());
        }
        (flying.remove(0), ended.remove(0))
    }

    fn to_look_at(ended: EndedBall) -> ToLook {
        ToLook::Ball(Box::new(BallToLookAt {
            ended,
            stamps: Vec::new(),
            clock_epoch: 0,
            complete: ArrivalTime::from_nanos(1),
        }))
    }

    #[test]
    fn what_ends_beside_a_flight_waits_for_it() {
        let ((_, beside), (flying, ended)) = (flight(0), flight(1000));
        let beside_begins = beside.ball.track.points.first().unwrap().frame;
        let watched = beside.ball.track.span().unwrap().1;
        let (told, balls) = bounded(LOOK_QUEUE);
        let (tracks_in, tracks) = bounded(8);
        let (steps_in, _steps) = bounded(8);
        for message in [
            ToLook::Flying(Box::new(flying)),
            to_look_at(beside),
            ToLook::Watched {
                settled: Some(watched),
                clear: None,
            },
            to_look_at(ended),
        ] {
            told.send(message).unwrap();
        }
        drop(told);
        let health = Arc::new(CameraHealth::new(CameraId::new("side").unwrap()));
        look(&balls, (&tracks_in, &steps_in), &EyeConfig::default(), &health);
        let seen: Vec<u64> = tracks
            .try_iter()
            .map(|t| t.track.points.first().unwrap().frame)
            .collect();
        assert_eq!(seen.len(), 2);
        assert!(seen[0] > 1000 && seen[1].abs_diff(beside_begins) <= 2, "{seen:?}");
        assert_eq!(health.settled_ns.load(Ordering::Acquire), watched.nanos());
    }
}
