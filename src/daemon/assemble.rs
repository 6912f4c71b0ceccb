//! Tracks of all cameras to pitches as they happen: grouping, solving, and asking for calibrations.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, TrySendError};

use super::ball::{Ball, Solved, Watched};
use super::batch::{BatchOptions, solve_tracks, usual_rms_px};
use super::calibrating::{CalibrationAnswer, CalibrationInUse, CalibrationRequest, Epochs, from_file};
use super::health::{CameraHealth, CameraState};
use super::looker::SeenTrack;
use super::recorder::ClipTrigger;
use crate::flight::is_far_off;
use crate::scene::{Calibration, CameraId, Pitch, Rig, Track};
use crate::time::is_of_network;
use crate::time::{ArrivalTime, StampedMidpoint};

/// When pitches are calibrated from.
#[derive(Debug, Clone, Copy)]
pub struct CalibrationPlan {
    /// Pitches before the first.
    pub first_pitches: usize,
    /// Pitches looked back on.
    pub window_pitches: usize,
    /// New pitches before the next.
    pub every_pitches: usize,
}

/// What may change while it runs.
pub struct NewPlan {
    /// When to calibrate.
    pub plan: CalibrationPlan,
    /// Another calibration to go on with, from a file.
    pub calibration: Option<Calibration>,
}

/// A pitch as it is published.
#[derive(Debug, Clone)]
pub struct Published {
    /// The pitch.
    pub pitch: Pitch,
    /// What it was solved from.
    pub tracks: Vec<Track>,
    /// Arrival of the last frame it needed; `None` where it waited for a calibration.
    pub complete: Option<ArrivalTime>,
    /// Exposure midpoint of the last point of it.
    pub exposed: Option<StampedMidpoint>,
}

/// The assembler's thread.
pub struct Assembler {
    /// The rig, its cameras' stamps taken as roughly alike.
    pub rig: Rig,
    /// Pitches published by earlier runs: numbers go on after them.
    pub numbers_before: u32,
    /// The calibration in use, with the clock epochs it holds for.
    pub calibration: Option<CalibrationInUse>,
    /// When to calibrate.
    pub plan: CalibrationPlan,
    /// State of every camera.
    pub health: Vec<Arc<CameraHealth>>,
    /// To the worker; holds one request.
    pub requests: Sender<CalibrationRequest>,
    /// To the recorder.
    pub clips: Option<Sender<ClipTrigger>>,
    /// To the publisher.
    pub publish: Sender<Published>,
    /// To the keeper of calibrations.
    pub versions: Sender<Calibration>,
    /// To those who look ahead.
    pub foresee: Sender<CalibrationInUse>,
}

/// Between two looks at how far the cameras have been watched: while a ball waits for one, and else.
const CLOSE_LOOK: Duration = Duration::from_millis(2);
const LOOK_AROUND: Duration = Duration::from_millis(20);

/// What the assembler keeps.
#[derive(Default)]
struct Desk {
    open: Vec<Ball>,
    /// Balls that one camera alone has told of, lately.
    alone: Vec<Ball>,
    window: VecDeque<Ball>,
    numbers: u32,
    since_calibration: usize,
    waiting: bool,
    version: u32,
    /// Balls since the last calibration that it did not explain.
    misfits: usize,
}

impl Desk {
    /// What was tried with another calibration is tried again.
    fn forget_solutions(&mut self) {
        for ball in self.open.iter_mut().filter(|b| !b.published) {
            ball.solved = None;
        }
    }
}

impl Assembler {
    /// Runs until all cameras' tracks have ended; a pitch in the making is finished first.
    pub fn run(
        mut self,
        tracks: &Receiver<SeenTrack>,
        answers: &Receiver<CalibrationAnswer>,
        plans: &Receiver<NewPlan>,
    ) {
        let mut desk = Desk {
            version: self.calibration.as_ref().map_or(0, |c| c.0.version),
            numbers: self.numbers_before,
            ..Desk::default()
        };
        self.tell_calibration();
        loop {
            let patience = if desk.open.iter().any(|b| !b.published) {
                CLOSE_LOOK
            } else {
                LOOK_AROUND
            };
            match tracks.recv_timeout(patience) {
                Ok(seen) => self.take(seen, &mut desk),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
            // First how far the cameras have been watched, then their tracks: none can be missed in between.
            let cameras = self.watched();
            for seen in tracks.try_iter() {
                self.take(seen, &mut desk);
            }
            while let Ok(answer) = answers.try_recv() {
                self.adopt(answer, &mut desk);
            }
            for new in plans.try_iter() {
                self.plan = new.plan;
                if let Some(calibration) = new.calibration {
                    self.replace(calibration, &mut desk);
                }
            }
            self.publish_complete(&mut desk, &cameras);
            self.close_decided(&mut desk, Some(&cameras));
        }
        self.close_decided(&mut desk, None);
        if desk.waiting
            && let Ok(answer) = answers.recv_timeout(Duration::from_secs(20))
        {
            self.adopt(answer, &mut desk);
        }
    }

    fn take(&self, seen: SeenTrack, desk: &mut Desk) {
        if let Some(ball) = desk.open.iter_mut().find(|ball| ball.may_have(&seen.track)) {
            ball.add(seen);
            return;
        }
        // A camera that stood still, or was lost, tells late of a ball that the others have told of: no second pitch.
        let late = |ball: &Ball| ball.lacks(&seen.track.camera) && ball.may_have(&seen.track);
        if let Some(index) = desk.window.iter().position(late) {
            self.take_late(seen, desk, index);
            return;
        }
        desk.alone.retain(|ball| !ball.is_old());
        match desk.alone.iter().position(late) {
            Some(index) => {
                let mut ball = desk.alone.swap_remove(index);
                ball.add(seen);
                desk.open.push(ball);
            }
            None => desk.open.extend(Ball::new(seen)),
        }
    }

    /// A track of a ball of the window, which has been closed.
    fn take_late(&self, seen: SeenTrack, desk: &mut Desk, index: usize) {
        let Some(mut ball) = desk.window.remove(index) else {
            return;
        };
        tracing::info!(camera = %seen.track.camera, published = ball.published, "a track of a ball that was closed");
        ball.add(seen);
        if !ball.published {
            self.solve(&mut ball);
            self.publish(&mut ball, desk, Wait::ForCalibration);
        }
        ball.solved = None;
        desk.window.insert(index, ball);
    }

    /// How far the cameras that send frames have been watched.
    fn watched(&self) -> Vec<Watched> {
        let sending = self.health.iter().filter(|h| h.state() == CameraState::Streaming);
        sending
            .map(|health| Watched {
                camera: health.camera.clone(),
                settled_ns: health.settled_ns.load(Ordering::Acquire),
                clear_ns: health.clear_ns.load(Ordering::Acquire),
            })
            .collect()
    }

    /// Publishes balls of which every camera has told that can, without waiting for those that only might.
    fn publish_complete(&mut self, desk: &mut Desk, cameras: &[Watched]) {
        let Some((calibration, _)) = &self.calibration else {
            return;
        };
        let mut open = std::mem::take(&mut desk.open);
        let worth = |ball: &&mut Ball| !ball.published && ball.may_be_complete(cameras, calibration);
        for ball in open.iter_mut().filter(worth) {
            self.solve(ball);
            if ball.is_complete(cameras, calibration) {
                self.publish(ball, desk, Wait::Live);
            }
        }
        desk.open = open;
    }

    /// Closes balls of which every camera has told or never will; all of them at the end (`None`).
    fn close_decided(&mut self, desk: &mut Desk, cameras: Option<&[Watched]>) {
        let is_decided = |ball: &Ball| cameras.is_none_or(|cameras| ball.is_decided(cameras));
        let (decided, open): (Vec<Ball>, Vec<Ball>) =
            std::mem::take(&mut desk.open).into_iter().partition(is_decided);
        desk.open = open;
        for ball in decided {
            self.close(ball, desk);
        }
    }

    fn close(&mut self, mut ball: Ball, desk: &mut Desk) {
        if ball.cameras().len() < 2 {
            let track = ball.tracks().first();
            let track = track.map(|t| (t.track.camera.to_string(), t.track.points.len()));
            tracing::info!(?track, "a ball that one camera alone has seen");
            desk.alone.push(ball);
            return;
        }
        self.ask_for_clip(&ball);
        if !ball.published {
            self.solve(&mut ball);
            self.publish(&mut ball, desk, Wait::Live);
        }
        ball.solved = None;
        desk.window.push_back(ball);
        desk.since_calibration += 1;
        while desk.window.len() > self.plan.window_pitches {
            desk.window.pop_front();
        }
        self.ask(desk);
    }

    fn ask_for_clip(&self, ball: &Ball) {
        let (Some(clips), Some((first, last))) = (&self.clips, ball.span()) else {
            return;
        };
        let trigger = ClipTrigger {
            first_ns: first.nanos(),
            last_ns: last.nanos(),
        };
        if clips.try_send(trigger).is_err() {
            tracing::error!("a clip could not be asked for: the recorder is behind");
        }
    }

    /// Solves a ball with the calibration in use, by the cameras whose clocks it still holds for; once for the same tracks.
    fn solve(&self, ball: &mut Ball) {
        let Some((calibration, epochs)) = self.calibration.as_ref().filter(|_| ball.solved.is_none()) else {
            return;
        };
        let seen = ball.tracks().iter();
        let valid = seen.filter(|t| epochs.get(&t.track.camera) == Some(&t.clock_epoch));
        let valid: Vec<Track> = valid.map(|t| t.track.clone()).collect();
        let options = BatchOptions {
            calibration: Some(calibration.clone()),
            ..BatchOptions::default()
        };
        let mut solved = Solved::default();
        match solve_tracks(&self.rig, &valid, &options) {
            Ok(batch) => {
                for warning in &batch.warnings {
                    tracing::debug!("{warning}");
                }
                for pitch in batch.pitches {
                    if let Some(why) = misfit(&pitch, &batch.calibration) {
                        solved.misfits.push(why);
                        continue;
                    }
                    let flight = batch.flights.iter().find(|f| f.number == pitch.pitch);
                    let tracks = flight.map(|f| f.tracks.clone()).unwrap_or_default();
                    solved.pitches.push((pitch, tracks));
                }
            }
            Err(error) => tracing::warn!(%error, "a ball was not solved"),
        }
        ball.solved = Some(solved);
    }

    /// Sends the pitches of a solved ball out.
    fn publish(&self, ball: &mut Ball, desk: &mut Desk, wait: Wait) {
        let Some(solved) = ball.solved.take() else {
            return;
        };
        for why in solved.misfits {
            desk.misfits += 1;
            tracing::warn!("a ball is kept back until the next calibration: {why}");
        }
        for (mut pitch, tracks) in solved.pitches {
            desk.numbers += 1;
            let number = desk.numbers;
            ball.published = true;
            pitch.pitch = number;
            let published = Published {
                pitch,
                tracks,
                complete: ball.complete().filter(|_| wait == Wait::Live),
                exposed: ball.span().map(|s| s.1).filter(|_| wait == Wait::Live),
            };
            if self.publish.try_send(published).is_err() {
                tracing::error!(number, "a pitch could not be published: the queue is full");
            }
        }
    }

    /// Of every camera the epoch of its newest track: one that follows the network's clock again is in an earlier one.
    fn current_epochs(desk: &Desk) -> Epochs {
        let seen = desk.window.iter().flat_map(Ball::tracks);
        seen.map(|t| (t.track.camera.clone(), t.clock_epoch)).collect()
    }

    /// Asks for a calibration when there is none, when it has aged, or when a camera's clock began anew.
    fn ask(&self, desk: &mut Desk) {
        let epochs = Self::current_epochs(desk);
        let is_valid = |t: &SeenTrack| epochs.get(&t.track.camera) == Some(&t.clock_epoch);
        // Pitches that two cameras saw with their present clocks.
        let shared = |camera: &CameraId| {
            let has = |b: &&Ball| {
                b.tracks()
                    .iter()
                    .any(|t| is_valid(t) && t.track.camera == *camera)
            };
            let others = |b: &&Ball| {
                b.tracks()
                    .iter()
                    .any(|t| is_valid(t) && t.track.camera != *camera)
            };
            desk.window.iter().filter(|b| has(b) && others(b)).count()
        };
        let enough = epochs
            .keys()
            .filter(|c| shared(c) >= self.plan.first_pitches)
            .count();
        let stale = match &self.calibration {
            None => true,
            Some((_, held)) => {
                desk.since_calibration >= self.plan.every_pitches
                    || desk.misfits >= self.plan.first_pitches
                    || epochs
                        .iter()
                        .any(|(c, e)| held.get(c) != Some(e) && shared(c) >= self.plan.first_pitches)
            }
        };
        if desk.waiting || !stale || enough < 2 {
            return;
        }
        let tracks = desk
            .window
            .iter()
            .flat_map(|b| b.tracks().iter().filter(|t| is_valid(t)).map(|t| t.track.clone()))
            .collect();
        let request = CalibrationRequest {
            tracks,
            epochs,
            version: desk.version + 1,
        };
        desk.waiting = self.requests.try_send(request).is_ok();
    }

    /// Goes on with a calibration that a person has given.
    fn replace(&mut self, mut calibration: Calibration, desk: &mut Desk) {
        desk.version += 1;
        calibration.version = desk.version;
        tracing::info!(version = desk.version, "the calibration of the file is in use");
        let epochs = Self::current_epochs(desk);
        let (calibration, mut of_file) = from_file(calibration);
        for (camera, epoch) in &mut of_file {
            let now = epochs.get(camera).copied().unwrap_or(*epoch);
            if is_of_network(now) == is_of_network(*epoch) {
                *epoch = now;
            }
        }
        self.calibration = Some((calibration, of_file));
        desk.forget_solutions();
        self.tell_calibration();
    }

    fn tell_calibration(&self) {
        if let Some(in_use) = &self.calibration
            && let Err(TrySendError::Full(_)) = self.foresee.try_send(in_use.clone())
        {
            tracing::error!("balls in flight are not looked at with the new calibration: the queue is full");
        }
    }

    fn adopt(&mut self, answer: CalibrationAnswer, desk: &mut Desk) {
        desk.waiting = false;
        desk.since_calibration = 0;
        desk.misfits = 0;
        let Some(calibration) = answer.calibration else {
            tracing::warn!("no new calibration, the last good one stays: {}", answer.reason);
            return;
        };
        desk.version = calibration.version;
        tracing::info!(version = calibration.version, "a calibration is in use");
        if self.versions.try_send(calibration.clone()).is_err() {
            tracing::error!("a calibration could not be handed on to be kept");
        }
        self.calibration = Some((calibration, answer.epochs));
        desk.forget_solutions();
        self.tell_calibration();
        // What could not be solved before is solved now.
        let mut window = std::mem::take(&mut desk.window);
        for ball in window.iter_mut().filter(|b| !b.published) {
            self.solve(ball);
            self.publish(ball, desk, Wait::ForCalibration);
        }
        desk.window = window;
    }
}

/// Slowest and fastest pitch, m/s.
const SPEED_MPS: [f64; 2] = [10.0, 60.0];

/// Why a ball is no pitch by this calibration although it was solved: nobody should see it before another calibration
/// has been tried (a camera was kicked, or a clock began anew unnoticed).
fn misfit(pitch: &Pitch, calibration: &Calibration) -> Option<String> {
    let speed_mps = pitch.release_speed_mps;
    if pitch.cameras.len() < 2 {
        return Some("the points of one camera alone lie on its flight".to_owned());
    }
    if !(SPEED_MPS[0]..SPEED_MPS[1]).contains(&speed_mps) {
        return Some(format!("it would have flown at {speed_mps:.1} m/s"));
    }
    let (rms_px, usual_px) = (pitch.reprojection_rms_px, usual_rms_px(calibration));
    is_far_off(rms_px, usual_px)
        .then(|| format!("its points lie {rms_px:.1} px off its flight, {usual_px:.2} px are usual"))
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Wait {
    Live,
    ForCalibration,
}

#[cfg(test)]
#[path = "assemble_tests.rs"]
mod tests;
