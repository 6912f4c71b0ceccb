//! Frames to 2-D tracks, every camera on its own thread: the first half of the pipeline.
//!
//! There is no queue to fill: each thread pulls its source as fast as it may (or at the pace asked for) and keeps its tracks
//! until the source ends. Cameras share nothing, or, where a calibration is known, what they see of a ball in flight.

use std::time::{Duration, Instant};

use super::histogram::Histogram;
use super::lockstep::{Lockstep, Seat};
use super::outfit::Wanted;
use crate::capture::{FrameGeometry, FrameSource};
use crate::detection::{DetectionError, Still, StillPicture};
use crate::eye::CameraEye;
use crate::scene::{Calibration, CameraId, Frame, FrameSearch, Rig, Track, WorldFrame};
use crate::time::{HostClock, SystemClock};

/// How fast a recording is played.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Pace {
    /// As fast as it goes.
    Max,
    /// This many times the speed of the stamps.
    Times(f64),
}

/// What became of one camera's frames.
#[derive(Debug, Clone)]
pub struct Watched {
    /// Camera.
    pub camera: CameraId,
    /// Frames that went through detection.
    pub frames: u64,
    /// Frames that could not be used, with the reason of the first few.
    pub unusable: u64,
    /// The first reasons, each naming camera and frame.
    pub reasons: Vec<String>,
    /// Pitched balls.
    pub tracks: Vec<Track>,
    /// What the search cost and left out; `None` where it ended early.
    pub search: Option<FrameSearch>,
    /// Where home plate is, as it looks most of the time.
    pub still: Option<StillPicture>,
}

/// A camera's eye that is timed.
pub struct TimedEye {
    camera: CameraId,
    rate_hz: f64,
    eye: CameraEye,
    still: Option<Still>,
    times: Histogram,
}

impl TimedEye {
    /// An eye for frames of this size.
    pub fn new(camera: CameraId, wanted: Wanted, (width_px, height_px): (u32, u32)) -> Self {
        let config = wanted.eye;
        Self {
            rate_hz: config.tracker.frame_rate_hz,
            eye: CameraEye::new(camera.clone(), config, width_px, height_px),
            camera,
            still: wanted.still,
            times: Histogram::default(),
        }
    }

    /// Takes the next frame of the camera.
    ///
    /// # Errors
    /// A frame of another size.
    pub fn push(&mut self, frame: &Frame) -> Result<(), DetectionError> {
        let begun = SystemClock.monotonic().nanos();
        let result = self.eye.push(frame);
        self.times.add_since_ns(begun);
        if let Some(still) = &mut self.still
            && still.is_due()
        {
            still.take(frame);
        }
        result
    }

    /// Ends the recording: its pitches in time order, numbered, what the search cost, and the still.
    pub fn finish(mut self) -> (Vec<Track>, FrameSearch, Option<StillPicture>) {
        self.eye.finish();
        let mut tracks = self.eye.drain_pitches();
        tracks.sort_by_key(Track::span);
        for (number, track) in tracks.iter_mut().enumerate() {
            track.track = number as u32;
        }
        let (detector, tracker) = self.eye.counters();
        tracing::info!(camera = %self.camera, ?detector, ?tracker, "searched");
        let answered = detector.frames.saturating_sub(detector.unanswered).max(1);
        let waited_frames = detector.waited as f64 / answered as f64;
        let search_ms = |share| 1e3 * self.times.quantile_s(share).unwrap_or(0.0);
        let search = FrameSearch {
            camera: self.camera,
            frames: detector.frames,
            waited_frames,
            waited_ms: 1e3 * waited_frames / self.rate_hz.max(1e-3),
            search_ms_p50: search_ms(0.5),
            search_ms_p99: search_ms(0.99),
            global_changes: detector.global_changes,
            candidates_dropped: detector.candidates_dropped,
            overflows: detector.overflows,
        };
        (tracks, search, self.still.and_then(|still| still.picture()))
    }
}

/// Reasons kept per camera; the rest is counted.
const REASONS_KEPT: usize = 5;

/// Runs every source to its end, one thread a camera, for what is `wanted` of it. With a calibration known
/// before, what some cameras see of a ball in flight tells the others where to look.
///
/// `on_frame` is called after each frame, on any thread.
pub fn watch_all(
    sources: Vec<Box<dyn FrameSource>>,
    wanted: &(dyn Fn(&CameraId) -> Wanted + Sync),
    pace: Pace,
    known: Option<(&Rig, &Calibration)>,
    on_frame: &(dyn Fn() + Sync),
) -> Vec<Watched> {
    let cameras: Vec<CameraId> = sources.iter().map(|source| source.camera().clone()).collect();
    let lockstep = known
        .filter(|(_, calibration)| calibration.world == WorldFrame::HomePlate)
        .map(|(rig, calibration)| Lockstep::new(rig, calibration, &cameras));
    let lockstep = lockstep.as_ref();
    std::thread::scope(|scope| {
        let threads: Vec<_> = sources
            .into_iter()
            .map(|source| {
                let camera = source.camera().clone();
                let wanted = wanted(&camera);
                let seat = lockstep.and_then(|lockstep| lockstep.seat(&camera, &wanted.eye.tracker));
                let thread = std::thread::Builder::new().name(format!("watch-{camera}"));
                (
                    camera,
                    thread.spawn_scoped(scope, move || watch(source, wanted, (pace, seat), on_frame)),
                )
            })
            .collect();
        threads
            .into_iter()
            .map(|(camera, thread)| match thread.map(|t| t.join()) {
                Ok(Ok(watched)) => watched,
                Ok(Err(_)) => lost(camera, "its thread ended early".to_owned()),
                Err(error) => lost(camera, format!("no thread for it: {error}")),
            })
            .collect()
    })
}

fn lost(camera: CameraId, reason: String) -> Watched {
    let reasons = vec![format!("camera {camera}: {reason}")];
    Watched {
        camera,
        frames: 0,
        unusable: 0,
        reasons,
        tracks: Vec::new(),
        search: None,
        still: None,
    }
}

fn watch(
    source: Box<dyn FrameSource>,
    wanted: Wanted,
    (pace, mut seat): (Pace, Option<Seat<'_>>),
    on_frame: &(dyn Fn() + Sync),
) -> Watched {
    let FrameGeometry { width_px, height_px } = source.geometry();
    let camera = source.camera().clone();
    let mut eye = TimedEye::new(camera.clone(), wanted, (width_px, height_px));
    let mut watched = lost(camera.clone(), String::new());
    watched.reasons.clear();
    let mut clock = Paced::new(pace);
    let refuse = |watched: &mut Watched, reason: String| {
        watched.unusable += 1;
        if watched.reasons.len() < REASONS_KEPT {
            watched.reasons.push(format!("camera {camera}: {reason}"));
        }
    };
    for frame in source {
        on_frame();
        let frame = match frame {
            Ok(frame) => frame,
            Err(error) => {
                refuse(&mut watched, error.to_string());
                continue;
            }
        };
        clock.wait_for(&frame);
        if let Some(seat) = &mut seat {
            seat.before(frame.stamp.stamped, &mut eye.eye);
        }
        match eye.push(&frame) {
            Ok(()) => watched.frames += 1,
            Err(error) => refuse(&mut watched, error.to_string()),
        }
    }
    drop(seat);
    let (tracks, search, still) = eye.finish();
    watched.still = still;
    watched.tracks = tracks;
    watched.search = Some(search);
    watched
}

/// Holds frames back until their time has come. Long gaps between clips are skipped.
struct Paced {
    pace: Pace,
    start: Option<(Instant, i64)>,
}

impl Paced {
    fn new(pace: Pace) -> Self {
        Self { pace, start: None }
    }

    fn wait_for(&mut self, frame: &Frame) {
        let Pace::Times(times) = self.pace else {
            return;
        };
        let stamp = frame.stamp.stamped.nanos();
        let (begun, first) = *self.start.get_or_insert((Instant::now(), stamp));
        let due = Duration::from_secs_f64(((stamp - first) as f64 / 1e9 / times).clamp(0.0, 1e9));
        let ahead = due.saturating_sub(begun.elapsed());
        if ahead > Duration::from_secs(1) {
            self.start = Some((Instant::now(), stamp));
        } else {
            std::thread::sleep(ahead);
        }
    }
}
