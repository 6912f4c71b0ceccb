//! Tracks of all cameras to pitches as they happen: grouping, solving, and asking for calibrations.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, TrySendError};

use super::batch::{BatchOptions, solve_tracks, usual_rms_px};
use super::foresee::CalibrationInUse;
use super::health::{CameraHealth, CameraState};
use super::looker::SeenTrack;
use super::recorder::ClipTrigger;
use crate::flight::is_far_off;
use crate::scene::{Calibration, CameraId, ParameterKind, Pitch, Rig, Track, WorldFrame};
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

/// Work for the calibration worker.
pub struct CalibrationRequest {
    tracks: Vec<Track>,
    epochs: Epochs,
    version: u32,
}

/// Its answer.
pub struct CalibrationAnswer {
    calibration: Option<Calibration>,
    epochs: Epochs,
    reason: String,
}

/// Clock epoch per camera.
pub type Epochs = BTreeMap<CameraId, u32>;

/// Tracks this close in time may be one ball: cameras see different parts of a flight.
const TOGETHER_S: f64 = 0.6;
/// A camera that has been watched this far past a ball's end has no more to tell of it, seconds of its stamps.
const DECIDED_S: f64 = 0.4;
/// A camera that lags behind the others by more than this is not waited for.
const PATIENCE: Duration = Duration::from_secs(5);

/// A pitch in the making, or made.
struct Ball {
    tracks: Vec<SeenTrack>,
    published: bool,
}

/// The assembler's thread.
pub struct Assembler {
    /// The rig, its cameras' stamps taken as roughly alike.
    pub rig: Rig,
    /// Pitches published by earlier runs: numbers go on after them.
    pub numbers_before: u32,
    /// The calibration in use, with the clock epochs it holds for.
    pub calibration: Option<(Calibration, Epochs)>,
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

/// What the assembler keeps.
#[derive(Default)]
struct Desk {
    open: Vec<(Ball, Instant)>,
    window: VecDeque<Ball>,
    numbers: u32,
    since_calibration: usize,
    waiting: bool,
    version: u32,
    /// Balls since the last calibration that it did not explain.
    misfits: usize,
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
            match tracks.recv_timeout(Duration::from_millis(20)) {
                Ok(seen) => self.take(seen, &mut desk),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
            // First how far the cameras have been watched, then their tracks: none can be missed in between.
            let alive = self.alive();
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
            self.close_ripe(&mut desk, Some(&alive));
        }
        self.close_ripe(&mut desk, None);
        if desk.waiting
            && let Ok(answer) = answers.recv_timeout(Duration::from_secs(20))
        {
            self.adopt(answer, &mut desk);
        }
    }

    fn take(&self, seen: SeenTrack, desk: &mut Desk) {
        let Some((begin, end)) = seen.track.span() else {
            return;
        };
        let near = desk.open.iter_mut().find(|(ball, _)| {
            ball.tracks.iter().filter_map(|t| t.track.span()).any(|(b, e)| {
                begin.seconds_since(e.nanos()) < TOGETHER_S && b.seconds_since(end.nanos()) < TOGETHER_S
            })
        });
        match near {
            Some((ball, since)) => {
                ball.tracks.push(seen);
                *since = Instant::now();
            }
            None => {
                let ball = Ball {
                    tracks: vec![seen],
                    published: false,
                };
                desk.open.push((ball, Instant::now()));
            }
        }
    }

    /// Cameras that may still tell of a ball, each with the stamp up to which it has told all.
    fn alive(&self) -> Vec<(CameraId, i64)> {
        self.health
            .iter()
            .filter(|h| matches!(h.state(), CameraState::Streaming | CameraState::Degraded))
            .map(|h| (h.camera.clone(), h.watched_until_ns.load(Ordering::Acquire)))
            .collect()
    }

    /// Closes balls of which every living camera has told, or that have waited long enough; all of them at the end
    /// (`None`). By the frames' own time, not the wall's: a busy host delays pitches and does not tear them apart.
    fn close_ripe(&mut self, desk: &mut Desk, alive: Option<&[(CameraId, i64)]>) {
        let ripe = |(ball, since): &(Ball, Instant)| {
            let Some(alive) = alive else { return true };
            let end_ns = ball
                .tracks
                .iter()
                .filter_map(|t| Some(t.track.span()?.1.nanos()))
                .max();
            let decided_ns = end_ns.unwrap_or(0).saturating_add((1e9 * DECIDED_S) as i64);
            let told = |(camera, until_ns): &(CameraId, i64)| {
                *until_ns > decided_ns || ball.tracks.iter().any(|t| t.track.camera == *camera)
            };
            alive.iter().all(told) || since.elapsed() > PATIENCE
        };
        let (ready, open) = std::mem::take(&mut desk.open).into_iter().partition(ripe);
        desk.open = open;
        let ready: Vec<(Ball, Instant)> = ready;
        for (ball, _) in ready {
            self.close(ball, desk);
        }
    }

    fn close(&mut self, mut ball: Ball, desk: &mut Desk) {
        let cameras: std::collections::BTreeSet<_> = ball.tracks.iter().map(|t| &t.track.camera).collect();
        if cameras.len() < 2 {
            let track = ball
                .tracks
                .first()
                .map(|t| (t.track.camera.to_string(), t.track.points.len()));
            tracing::info!(?track, "a ball that one camera alone has seen");
            return;
        }
        self.ask_for_clip(&ball);
        self.solve(&mut ball, desk, Wait::Live);
        desk.window.push_back(ball);
        desk.since_calibration += 1;
        while desk.window.len() > self.plan.window_pitches {
            desk.window.pop_front();
        }
        self.ask(desk);
    }

    fn ask_for_clip(&self, ball: &Ball) {
        let spans: Vec<_> = ball.tracks.iter().filter_map(|t| t.track.span()).collect();
        let first = spans.iter().map(|s| s.0.nanos()).min();
        let last = spans.iter().map(|s| s.1.nanos()).max();
        if let (Some(clips), Some(first_ns), Some(last_ns)) = (&self.clips, first, last)
            && clips.try_send(ClipTrigger { first_ns, last_ns }).is_err()
        {
            tracing::error!("a clip could not be asked for: the recorder is behind");
        }
    }

    /// Solves a ball with the calibration in use, by the cameras whose clocks it still holds for.
    fn solve(&self, ball: &mut Ball, desk: &mut Desk, wait: Wait) {
        let Some((calibration, epochs)) = &self.calibration else {
            return;
        };
        let valid: Vec<Track> = ball
            .tracks
            .iter()
            .filter(|t| epochs.get(&t.track.camera) == Some(&t.clock_epoch))
            .map(|t| t.track.clone())
            .collect();
        let options = BatchOptions {
            calibration: Some(calibration.clone()),
            ..BatchOptions::default()
        };
        let batch = match solve_tracks(&self.rig, &valid, &options) {
            Ok(batch) => batch,
            Err(error) => {
                tracing::warn!(%error, "a ball was not solved");
                return;
            }
        };
        for warning in &batch.warnings {
            tracing::debug!("{warning}");
        }
        for mut pitch in batch.pitches {
            if let Some(why) = misfit(&pitch, &batch.calibration) {
                desk.misfits += 1;
                tracing::warn!("a ball is kept back until the next calibration: {why}");
                continue;
            }
            desk.numbers += 1;
            let number = desk.numbers;
            let solved = batch.flights.iter().find(|f| f.number == pitch.pitch);
            let tracks = solved.map(|f| f.tracks.clone()).unwrap_or_default();
            ball.published = true;
            pitch.pitch = number;
            let complete = ball.tracks.iter().map(|t| t.complete).max();
            let exposed = ball.tracks.iter().filter_map(|t| Some(t.track.span()?.1)).max();
            let published = Published {
                pitch,
                tracks,
                complete: complete.filter(|_| wait == Wait::Live),
                exposed: exposed.filter(|_| wait == Wait::Live),
            };
            if self.publish.try_send(published).is_err() {
                tracing::error!(number, "a pitch could not be published: the queue is full");
            }
        }
    }

    fn current_epochs(desk: &Desk) -> Epochs {
        let mut epochs = Epochs::new();
        for seen in desk.window.iter().flat_map(|b| &b.tracks) {
            let newest = epochs
                .entry(seen.track.camera.clone())
                .or_insert(seen.clock_epoch);
            *newest = seen.clock_epoch.max(*newest);
        }
        epochs
    }

    /// Asks for a calibration when there is none, when it has aged, or when a camera's clock began anew.
    fn ask(&self, desk: &mut Desk) {
        let epochs = Self::current_epochs(desk);
        let is_valid = |t: &SeenTrack| epochs.get(&t.track.camera) == Some(&t.clock_epoch);
        // Pitches that two cameras saw with their present clocks.
        let shared = |camera: &CameraId| {
            let has = |b: &&Ball| b.tracks.iter().any(|t| is_valid(t) && t.track.camera == *camera);
            let others = |b: &&Ball| b.tracks.iter().any(|t| is_valid(t) && t.track.camera != *camera);
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
            .flat_map(|b| b.tracks.iter().filter(|t| is_valid(t)).map(|t| t.track.clone()))
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
            *epoch = epochs.get(camera).copied().unwrap_or(*epoch);
        }
        self.calibration = Some((calibration, of_file));
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
        self.tell_calibration();
        // What could not be solved before is solved now.
        let mut window = std::mem::take(&mut desk.window);
        for ball in window.iter_mut().filter(|b| !b.published) {
            self.solve(ball, desk, Wait::ForCalibration);
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

/// The calibration worker's thread: one request at a time, never in the way of a pitch.
pub fn calibrate(rig: &Rig, requests: &Receiver<CalibrationRequest>, answers: &Sender<CalibrationAnswer>) {
    for request in requests {
        let begun = Instant::now();
        let made = solve_tracks(rig, &request.tracks, &BatchOptions::default());
        let (calibration, reason) = match made {
            Ok(batch) if batch.calibration.world != WorldFrame::HomePlate => (
                None,
                "the rig's landmarks do not fix the home-plate frame".to_owned(),
            ),
            Ok(batch) => {
                let mut calibration = batch.calibration;
                calibration.version = request.version;
                tracing::info!(
                    pitches = batch.flights.len(),
                    seconds = begun.elapsed().as_secs_f64(),
                    "calibrated"
                );
                (Some(calibration), String::new())
            }
            Err(error) => (None, error.to_string()),
        };
        let answer = CalibrationAnswer {
            calibration,
            epochs: request.epochs,
            reason,
        };
        if answers.send(answer).is_err() {
            return;
        }
    }
}

/// A calibration that was read from a file as it holds for live stamps, and for which clock epochs: each camera's first.
///
/// Live stamps are on this host's clock, so there is no skew between them; a skew that another session had would move a
/// delay that is stated hours ago by seconds.
pub fn from_file(mut calibration: Calibration) -> CalibrationInUse {
    for camera in &mut calibration.cameras {
        camera.clock_skew_ppm = 0.0;
    }
    let kept: Vec<bool> = calibration
        .parameters
        .iter()
        .map(|p| p.kind != ParameterKind::ClockSkew)
        .collect();
    let keep = |row: Vec<f64>| -> Vec<f64> {
        let kept = row.into_iter().zip(&kept).filter(|(_, kept)| **kept);
        kept.map(|(value, _)| value).collect()
    };
    let rows = std::mem::take(&mut calibration.covariance);
    let kept_rows = rows.into_iter().zip(&kept).filter(|(_, kept)| **kept);
    calibration.covariance = kept_rows.map(|(row, _)| keep(row)).collect();
    calibration
        .parameters
        .retain(|p| p.kind != ParameterKind::ClockSkew);
    let epochs = calibration.cameras.iter().map(|c| (c.id.clone(), 0)).collect();
    (calibration, epochs)
}
