//! Balls in flight: from what every camera's eye has of them so far to where they will cross the plate.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender};
use nalgebra::Vector2;

use super::calibrating::CalibrationInUse;
use super::publish::{PublishHealth, in_flight_line};
use crate::flight::sighting::CameraModel;
use crate::flight::{FlightOptions, look_ahead, may_be_one_pitch};
use crate::geometry::Pixel;
use crate::scene::{Calibration, CameraId, Outlook, Rig, Track, WorldFrame};
use crate::time::{ArrivalTime, TrueMidpoint};
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

/// No two estimates follow each other faster: 100 Hz.
const PACE: Duration = Duration::from_millis(10);
/// News of a camera older than this, by arrival, is of a ball that is gone.
const STALE_NS: i64 = 120_000_000;
/// Paths of one ball end together to this, seconds of true time.
const TOGETHER_S: f64 = 0.12;
/// Combinations of paths tried for one estimate, and most that are thought of.
const TRIES: usize = 6;
const COMBINATIONS_MAX: usize = 256;
/// Estimates of one flight agree on the plate time to this.
const SAME_FLIGHT_NS: i64 = 250_000_000;

/// The thread's settings and outlets.
pub struct Foresee {
    /// The rig.
    pub rig: Rig,
    /// Tracker settings per camera.
    pub trackers: BTreeMap<CameraId, TrackerConfig>,
    /// To the printer; when it is full the estimate is dropped.
    pub lines: Sender<String>,
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
        let flights = news.paths.iter().filter_map(|p| p.flight(&camera, config));
        let flights = flights.map(|mut flight| {
            for point in &mut flight.points {
                let centre = point.pixel.vector() + news.off_light_px;
                point.pixel = Pixel::new(centre.x, centre.y);
            }
            flight
        });
        let latest = Latest {
            clock_epoch: news.clock_epoch,
            arrived: news.arrived,
            flights: flights.collect(),
        };
        sky.latest.insert(camera, latest);
    }

    fn estimate(&self, sky: &mut Sky) {
        let Some((calibration, epochs)) = &sky.calibration else {
            return;
        };
        if calibration.world != WorldFrame::HomePlate {
            return;
        }
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
        let options = FlightOptions::for_site(&self.rig.site, calibration.world).in_flight();
        let outlook = combinations(calibration, &flights)
            .into_iter()
            .take(TRIES)
            .find_map(|tracks| match look_ahead(calibration, &tracks, &options) {
                Ok(outlook) => Some(outlook),
                Err(error) => {
                    tracing::trace!(%error, "no outlook");
                    None
                }
            });
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

    fn publish(&self, outlook: &Outlook, (flight, version): (u32, u32), newest_ns: i64) {
        let Some(line) = in_flight_line(outlook, flight, version) else {
            return;
        };
        if self.lines.try_send(line).is_err() {
            self.health.lines_dropped.fetch_add(1, Ordering::Relaxed);
        }
        self.health.estimates.fetch_add(1, Ordering::Relaxed);
        self.health.estimate_age.add_since_ns(outlook.time_ns);
        self.health.estimate_latency.add_since_ns(newest_ns);
    }
}

/// Paths that may be of one ball, at most one a camera: all cameras together first, most points first.
fn combinations(calibration: &Calibration, flights: &[&Track]) -> Vec<Vec<Track>> {
    let end = |track: &Track| -> Option<TrueMidpoint> {
        let last = track.points.last()?;
        let timing = calibration.camera(&track.camera)?.timing();
        Some(timing.true_midpoint(last.stamped, last.pixel.y))
    };
    let cameras = calibration.cameras.iter().map(CameraModel::from_calibration);
    let cameras: BTreeMap<CameraId, CameraModel> = cameras.map(|c| (c.id.clone(), c)).collect();
    // A look at three instants; a flight that two players' limbs make is dear to refuse.
    let are_one = |one: &Track, other: &Track| {
        let pair = cameras.get(&one.camera).zip(cameras.get(&other.camera));
        pair.is_some_and(|(a, b)| may_be_one_pitch((a, one), (b, other)))
    };
    let mut sets: Vec<Vec<(&Track, TrueMidpoint)>> = vec![Vec::new()];
    for track in flights {
        let Some(ends) = end(track) else { continue };
        let fits = |set: &&Vec<(&Track, TrueMidpoint)>| {
            set.iter().all(|(other, other_ends)| {
                other.camera != track.camera
                    && ends.seconds_since(other_ends.nanos()).abs() < TOGETHER_S
                    && are_one(other, track)
            })
        };
        let longer: Vec<_> = sets
            .iter()
            .filter(fits)
            .map(|set| [set.as_slice(), &[(*track, ends)]].concat())
            .take(COMBINATIONS_MAX.saturating_sub(sets.len()))
            .collect();
        sets.extend(longer);
    }
    sets.retain(|set| set.len() > 1);
    let points = |set: &[(&Track, TrueMidpoint)]| set.iter().map(|(t, _)| t.points.len()).sum::<usize>();
    sets.sort_by_key(|set| std::cmp::Reverse((set.len(), points(set))));
    sets.into_iter()
        .map(|set| set.into_iter().map(|(track, _)| track.clone()).collect())
        .collect()
}
