//! A ball in the making: what the cameras have told of it, and whether any of them may still tell more.

use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use super::looker::SeenTrack;
use crate::scene::{Calibration, CameraId, Pitch, Track};
use crate::time::{ArrivalTime, StampedMidpoint};

/// Tracks this close in time may be one ball: cameras see different parts of a flight.
const TOGETHER_S: f64 = 0.6;
/// A camera that has been watched this far past a ball's end has no more to tell of it, seconds of its stamps.
const DECIDED_S: f64 = 0.4;
/// A camera that lags behind the others by more than this is not waited for.
const PATIENCE: Duration = Duration::from_secs(5);

/// A camera that was lost tells of what it last saw when it is back; later than this it has forgotten.
const OLD: Duration = Duration::from_secs(60);

/// How far a camera that sends frames has been watched, in its own stamps.
#[derive(Debug, Clone)]
pub struct Watched {
    /// Camera.
    pub camera: CameraId,
    /// Every ball up to here has been told of, nanoseconds.
    pub settled_ns: i64,
    /// Nothing that began before this was still being followed or looked at, nanoseconds.
    pub clear_ns: i64,
}

/// A pitch in the making, or made.
pub struct Ball {
    tracks: Vec<SeenTrack>,
    newest: Instant,
    /// What came of the tracks as they are, once that has been tried.
    pub solved: Option<Solved>,
    /// Whether a pitch of it has gone out.
    pub published: bool,
}

/// What came of a ball's tracks with the calibration in use: nothing where they could not be solved.
#[derive(Default)]
pub struct Solved {
    /// Its pitches, each with the tracks that it was solved from.
    pub pitches: Vec<(Pitch, Vec<Track>)>,
    /// Why its other flights are no pitches by this calibration.
    pub misfits: Vec<String>,
}

impl Ball {
    /// A ball that one camera has told of; `None` for a track without points.
    pub fn new(seen: SeenTrack) -> Option<Self> {
        seen.track.span()?;
        Some(Self {
            tracks: vec![seen],
            newest: Instant::now(),
            solved: None,
            published: false,
        })
    }

    /// Whether this may be a track of the same ball.
    pub fn may_have(&self, track: &Track) -> bool {
        let Some((begin, end)) = track.span() else {
            return false;
        };
        self.spans().any(|(b, e)| {
            begin.seconds_since(e.nanos()) < TOGETHER_S && b.seconds_since(end.nanos()) < TOGETHER_S
        })
    }

    /// Another track of it.
    pub fn add(&mut self, seen: SeenTrack) {
        self.tracks.push(seen);
        self.newest = Instant::now();
        self.solved = None;
    }

    /// What the cameras have told.
    pub fn tracks(&self) -> &[SeenTrack] {
        &self.tracks
    }

    /// Cameras that have told of it.
    pub fn cameras(&self) -> BTreeSet<&CameraId> {
        self.tracks.iter().map(|t| &t.track.camera).collect()
    }

    fn spans(&self) -> impl Iterator<Item = (StampedMidpoint, StampedMidpoint)> + '_ {
        self.tracks.iter().filter_map(|t| t.track.span())
    }

    /// Stamps of its first and its last point.
    pub fn span(&self) -> Option<(StampedMidpoint, StampedMidpoint)> {
        let begin = self.spans().map(|s| s.0).min()?;
        Some((begin, self.spans().map(|s| s.1).max()?))
    }

    /// Arrival of the last frame that its tracks needed.
    pub fn complete(&self) -> Option<ArrivalTime> {
        self.tracks.iter().map(|t| t.complete).max()
    }

    /// Whether this camera has not told of it.
    pub fn lacks(&self, camera: &CameraId) -> bool {
        !self.has(camera)
    }

    /// Whether no camera will still tell of it.
    pub fn is_old(&self) -> bool {
        self.newest.elapsed() > OLD
    }

    fn has(&self, camera: &CameraId) -> bool {
        self.tracks.iter().any(|t| t.track.camera == *camera)
    }

    fn end_ns(&self) -> i64 {
        self.span().map_or(0, |s| s.1.nanos())
    }

    /// Whether every camera has told of it, or never will. By the frames' own time, not the wall's: a busy host delays
    /// pitches and does not tear them apart.
    pub fn is_decided(&self, cameras: &[Watched]) -> bool {
        let decided_ns = self.end_ns().saturating_add((1e9 * DECIDED_S) as i64);
        let told = |watched: &Watched| watched.settled_ns > decided_ns || self.has(&watched.camera);
        cameras.iter().all(told) || self.newest.elapsed() > PATIENCE
    }

    /// Whether it is worth solving: no camera of the calibration still follows what may be this ball.
    pub fn may_be_complete(&self, cameras: &[Watched], calibration: &Calibration) -> bool {
        self.cameras().len() > 1 && self.all_have_told(cameras, delays(calibration), i64::MIN)
    }

    /// Whether its pitches are as good as they will be: every camera of the calibration has told of it, or followed
    /// nothing when it had crossed the plate. A camera without a calibration cannot add to them.
    pub fn is_complete(&self, cameras: &[Watched], calibration: &Calibration) -> bool {
        let fits = self.solved.as_ref().filter(|s| s.misfits.is_empty());
        let plates = fits.and_then(|s| s.pitches.iter().map(|(pitch, _)| pitch.plate_time_ns).max());
        plates.is_some_and(|plate_ns| self.all_have_told(cameras, delays(calibration), plate_ns))
    }

    /// As [`Self::is_complete`], for a ball at the plate at this true time.
    fn all_have_told(
        &self,
        cameras: &[Watched],
        delay_s: impl Fn(&CameraId) -> Option<f64>,
        plate_ns: i64,
    ) -> bool {
        cameras.iter().all(|watched| {
            let Some(delay_s) = delay_s(&watched.camera) else {
                return true;
            };
            let delay_ns = (1e9 * delay_s).round() as i64;
            let needed_ns = plate_ns.saturating_add(delay_ns).max(self.end_ns());
            watched.clear_ns > needed_ns || self.has(&watched.camera)
        })
    }
}

/// Capture delay of every camera of a calibration, seconds.
fn delays(calibration: &Calibration) -> impl Fn(&CameraId) -> Option<f64> + '_ {
    |camera| Some(calibration.camera(camera)?.capture_delay_s)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pixel;
    use crate::scene::TrackPoint;

    const FRAME_NS: i64 = 5_714_286;

    fn id(name: &str) -> CameraId {
        CameraId::new(name).unwrap()
    }

    /// Seventy frames of a ball, the first at this stamp.
    fn seen(camera: &str, begin_ns: i64) -> SeenTrack {
        let point = |k: i64| TrackPoint {
            frame: k as u64,
            stamped: StampedMidpoint::from_nanos(begin_ns + k * FRAME_NS),
            pixel: Pixel::new(k as f64, 0.0),
            covariance_px2: None,
        };
        SeenTrack {
            track: Track {
                camera: id(camera),
                track: 0,
                points: (0..70).map(point).collect(),
            },
            clock_epoch: 0,
            complete: ArrivalTime::from_nanos(begin_ns + 80 * FRAME_NS),
        }
    }

    fn watched(camera: &str, settled_ns: i64, clear_ns: i64) -> Watched {
        Watched {
            camera: id(camera),
            settled_ns,
            clear_ns,
        }
    }

    #[test]
    fn a_camera_that_saw_nothing_is_waited_for_to_the_plate_only() {
        let mut ball = Ball::new(seen("first", 0)).unwrap();
        ball.add(seen("third", 2_000_000));
        let end_ns = 2_000_000 + 69 * FRAME_NS;
        // At the plate 30 ms after the last point; the camera at home stamps 8 ms late.
        let plate_ns = end_ns + 30_000_000;
        let delay_s = |camera: &CameraId| Some(if *camera == id("home") { 0.008 } else { 0.0 });
        let told = |clear_ns: i64| {
            let cameras = [
                watched("first", 0, 0),
                watched("third", 0, 0),
                watched("home", clear_ns, clear_ns),
            ];
            (
                ball.all_have_told(&cameras, delay_s, plate_ns),
                ball.is_decided(&cameras),
            )
        };
        assert_eq!(told(end_ns), (false, false));
        // Before the camera has seen as far as the ball's last point nothing is worth a try.
        for (clear_ns, worth) in [(end_ns, false), (end_ns + 1, true)] {
            let cameras = [watched("home", clear_ns, clear_ns)];
            assert_eq!(ball.all_have_told(&cameras, delay_s, i64::MIN), worth);
        }
        assert_eq!(told(plate_ns + 8_000_000), (false, false));
        assert_eq!(told(plate_ns + 8_000_001), (true, false));
        // Nothing is closed before the camera can have told of another part of the flight.
        assert_eq!(told(end_ns + 400_000_001), (true, true));
        // A camera without a calibration adds nothing to the pitch.
        let cameras = [watched("home", 0, 0)];
        assert!(ball.all_have_told(&cameras, |_| None, plate_ns));
        assert!(!ball.is_decided(&cameras));
        // One that follows something is waited for, and has told once its track is here.
        let cameras = [watched("home", plate_ns, 0)];
        assert!(!ball.all_have_told(&cameras, delay_s, plate_ns));
        ball.add(seen("home", 8_000_000));
        assert!(ball.all_have_told(&cameras, delay_s, plate_ns) && ball.is_decided(&cameras));
    }

    #[test]
    fn tracks_within_half_a_second_are_one_ball() {
        let ball = Ball::new(seen("first", 0)).unwrap();
        let end_ns = 69 * FRAME_NS;
        assert!(ball.may_have(&seen("third", end_ns + 590_000_000).track));
        assert!(!ball.may_have(&seen("third", end_ns + 610_000_000).track));
        let nothing = SeenTrack {
            track: Track {
                points: Vec::new(),
                ..seen("third", 0).track
            },
            ..seen("third", 0)
        };
        assert!(!ball.may_have(&nothing.track) && Ball::new(nothing).is_none());
    }
}
