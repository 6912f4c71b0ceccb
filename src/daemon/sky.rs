//! What all cameras together know of a ball in flight, and where that puts it in each one's picture. Live frames and
//! replayed ones ask here, so that both see the same.

use std::collections::BTreeMap;

use nalgebra::Vector2;

use crate::flight::sighting::CameraModel;
use crate::flight::{FlightOptions, SolvedFlight, flight_so_far, foresee, may_be_one_pitch};
use crate::geometry::Pixel;
use crate::scene::{Calibration, CameraId, ForeseenPath, Rig, Track, WorldFrame};
use crate::time::TrueMidpoint;
use crate::tracking::{OpenPath, TrackerConfig};

/// Shortest path that may be of a pitch, seconds and ball radii: two cameras and the physics must agree on it, so it needs to
/// say less than one that is judged alone.
const SPAN_MIN_S: f64 = 0.05;
const PATH_RADII_MIN: f64 = 20.0;
/// Paths of one ball end together to this, seconds of true time.
const TOGETHER_S: f64 = 0.12;
/// Combinations of paths tried for one estimate, and most that are thought of.
const TRIES: usize = 6;
const COMBINATIONS_MAX: usize = 256;

/// The parts of these paths that fly freely and may be pitches; the first look's centres are drawn to the light, and
/// `off_light_px` is to be added to them.
pub fn flights_of(
    paths: &[OpenPath],
    off_light_px: Vector2<f64>,
    (camera, config): (&CameraId, &TrackerConfig),
) -> Vec<Track> {
    let config = TrackerConfig {
        span_min_s: SPAN_MIN_S.min(config.span_min_s),
        path_radii_min: PATH_RADII_MIN.min(config.path_radii_min),
        ..config.clone()
    };
    let flights = paths.iter().filter_map(|path| path.flight(camera, &config));
    flights
        .map(|mut flight| {
            for point in &mut flight.points {
                let centre = point.pixel.vector() + off_light_px;
                point.pixel = Pixel::new(centre.x, centre.y);
            }
            flight
        })
        .collect()
}

/// The pitched ball that at least two cameras see in these paths, one that all see first.
pub fn flight_in_sky(rig: &Rig, calibration: &Calibration, flights: &[&Track]) -> Option<SolvedFlight> {
    if calibration.world != WorldFrame::HomePlate || flights.len() < 2 {
        return None;
    }
    let options = FlightOptions::for_site(&rig.site, calibration.world).in_flight();
    let solve = |tracks: Vec<Track>| match flight_so_far(calibration, &tracks, &options) {
        Ok(flight) => Some(flight),
        Err(error) => {
            tracing::trace!(%error, "no flight");
            None
        }
    };
    combinations(calibration, flights)
        .into_iter()
        .take(TRIES)
        .find_map(solve)
}

/// Where every camera of the calibration will see this ball.
pub fn foreseen_paths(calibration: &Calibration, flight: &SolvedFlight) -> BTreeMap<CameraId, ForeseenPath> {
    let cameras = calibration.cameras.iter();
    let paths = cameras.map(|camera| (camera.id.clone(), foresee(camera, flight)));
    paths.filter(|(_, path)| !path.places().is_empty()).collect()
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
