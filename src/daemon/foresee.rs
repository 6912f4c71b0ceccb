//! Balls in flight: from what every camera's eye has of them so far to where they will cross the plate.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender};
use nalgebra::Vector2;

use super::calibrating::{CalibrationInUse, Epochs};
use super::publish::{PublishHealth, in_flight_line};
use super::sky::{flight_in_sky, flights_of, foreseen_paths};
use crate::flight::{SolvedFlight, outlook_of};
use crate::scene::{Calibration, CameraId, ForeseenPath, Outlook, Rig, Track};
use crate::time::ArrivalTime;
use crate::tracking::{OpenPath, TrackerConfig};

/// What one camera's eye has of balls in flight.
pub struct InFlight {
    /// Camera.
    pub camera: CameraId,
    /// Epoch of its clock.
    pub clock_epoch: u32,
    /// Arrival of the newest frame.
    pub arrived: ArrivalTime,
    /// The likeliest paths.
    pub paths: Vec<OpenPath>,
    /// What is to be added to their centres: the first look's are drawn to the light, pixels.
    pub off_light_px: Vector2<f64>,
}

/// Where a camera will see a ball that is in flight.
pub struct ForeseenBall {
    /// Epoch of the camera's clock that the stamps are of.
    pub clock_epoch: u32,
    /// Its way through the picture.
    pub path: ForeseenPath,
}

/// No two estimates follow each other faster: 100 Hz.
const PACE: Duration = Duration::from_millis(10);
/// News of a camera older than this, by arrival, is of a ball that is gone.
const STALE_NS: i64 = 120_000_000;
/// A flight seen for less is not told of, seconds.
const SEEN_MIN_S: f64 = 0.1;
/// Estimates of one flight agree on the plate time to this.
const SAME_FLIGHT_NS: i64 = 250_000_000;

/// The thread's settings and outlets.
pub struct Foresee {
    /// The rig.
    pub rig: Rig,
    /// Tracker settings per camera.
    pub trackers: BTreeMap<CameraId, TrackerConfig>,
    /// The eyes, to be told where the ball will be.
    pub eyes: BTreeMap<CameraId, Sender<ForeseenBall>>,
    /// To the printer, if anyone reads; when it is full the estimate is dropped.
    pub lines: Option<Sender<String>>,
    /// What has been published.
    pub health: Arc<PublishHealth>,
}

/// The latest of one camera.
struct Latest {
    clock_epoch: u32,
    arrived: ArrivalTime,
    flights: Vec<Track>,
}

#[derive(Default)]
struct Sky {
    calibration: Option<CalibrationInUse>,
    latest: BTreeMap<CameraId, Latest>,
    flight: u32,
    plate_time_ns: Option<i64>,
}

impl Foresee {
    /// Runs until the eyes end.
    pub fn run(self, news: &Receiver<InFlight>, calibrations: &Receiver<CalibrationInUse>) {
        let mut sky = Sky::default();
        loop {
            let mut fresh: BTreeMap<CameraId, InFlight> = BTreeMap::new();
            match news.recv_timeout(Duration::from_millis(100)) {
                Ok(first) => drop(fresh.insert(first.camera.clone(), first)),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return,
            }
            let begun = Instant::now();
            fresh.extend(news.try_iter().map(|n| (n.camera.clone(), n)));
            if let Some(newest) = calibrations.try_iter().last() {
                sky.calibration = Some(newest);
            }
            if sky.calibration.is_none() || fresh.is_empty() {
                continue;
            }
            for (camera, news) in fresh {
                self.take(camera, &news, &mut sky);
            }
            self.estimate(&mut sky);
            std::thread::sleep(PACE.saturating_sub(begun.elapsed()));
        }
    }

    fn take(&self, camera: CameraId, news: &InFlight, sky: &mut Sky) {
        let Some(config) = self.trackers.get(&camera) else {
            return;
        };
        let latest = Latest {
            clock_epoch: news.clock_epoch,
            arrived: news.arrived,
            flights: flights_of(&news.paths, news.off_light_px, (&camera, config)),
        };
        sky.latest.insert(camera, latest);
    }

    fn estimate(&self, sky: &mut Sky) {
        let Some((calibration, epochs)) = &sky.calibration else {
            return;
        };
        let newest = sky.latest.values().map(|l| l.arrived.nanos()).max().unwrap_or(0);
        let valid = |(camera, latest): &(&CameraId, &Latest)| {
            epochs.get(*camera) == Some(&latest.clock_epoch) && newest - latest.arrived.nanos() < STALE_NS
        };
        let flights: Vec<&Track> = sky
            .latest
            .iter()
            .filter(valid)
            .flat_map(|(_, latest)| &latest.flights)
            .collect();
        let Some(flight) = flight_in_sky(&self.rig, calibration, &flights) else {
            return;
        };
        self.tell_eyes(calibration, epochs, &flight);
        let seen_s = flight.observed_s.1 - flight.observed_s.0;
        let outlook = outlook_of(&flight).ok().filter(|_| seen_s > SEEN_MIN_S);
        // What has passed the plate is no news any more: its pitch is on the way.
        let Some(outlook) = outlook.filter(|o| o.time_ns < o.plate_time_ns) else {
            return;
        };
        let same = sky
            .plate_time_ns
            .is_some_and(|t| (t - outlook.plate_time_ns).abs() < SAME_FLIGHT_NS);
        sky.flight += u32::from(!same);
        sky.plate_time_ns = Some(outlook.plate_time_ns);
        self.publish(&outlook, (sky.flight, calibration.version), newest);
    }

    /// Where each camera will see the ball. An eye that has not read the last word is told with the next estimate.
    fn tell_eyes(&self, calibration: &Calibration, epochs: &Epochs, flight: &SolvedFlight) {
        for (camera, path) in foreseen_paths(calibration, flight) {
            if let (Some(eye), Some(clock_epoch)) = (self.eyes.get(&camera), epochs.get(&camera)) {
                let clock_epoch = *clock_epoch;
                let _ = eye.try_send(ForeseenBall { clock_epoch, path });
            }
        }
    }

    fn publish(&self, outlook: &Outlook, (flight, version): (u32, u32), newest_ns: i64) {
        let Some(lines) = &self.lines else { return };
        let Some(line) = in_flight_line(outlook, flight, version) else {
            return;
        };
        if lines.try_send(line).is_err() {
            self.health.lines_dropped.fetch_add(1, Ordering::Relaxed);
        }
        self.health.estimates.fetch_add(1, Ordering::Relaxed);
        self.health.estimate_age.add_since_ns(outlook.time_ns);
        self.health.estimate_latency.add_since_ns(newest_ns);
    }
}
