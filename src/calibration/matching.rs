//! Which tracks are the same ball, by geometry: once the cameras are placed, two tracks of one ball meet on a
//! flight and two of different things do not.

use super::PitchTracks;
use crate::flight::equations::{Loss, Sighting};
use crate::flight::sighting::{CameraModel, Sight};
use crate::flight::solve::{FlightState, KEEP_LIMIT, epoch, fit_flight};
use crate::flight::{FlightOptions, SolvedFlight, Trajectory, linear_start};
use crate::scene::Track;

/// Slack for cameras that are not yet at their best, pixels: a calibration from two pitches is off by this
/// much where they did not fly.
const SLACK_PX: f64 = 1.0;
/// A pair whose straight first fit misses by more than this (median, pixels) is not one ball: constant
/// acceleration misses a pitch by 0.5 px.
const FIRST_MISFIT_PX: f64 = 6.0;
/// Share of a track's points that must fit.
const SHARE_NEEDED: f64 = 0.7;
/// Balls in play slower or faster than this are no pitch, m/s.
const SPEED_MPS: (f64, f64) = (12.0, 55.0);
/// Cd farther than this from the prior's is no ball's, and lift of more prior sigmas is none's: a wrong pair
/// needs twenty times as much.
const DRAG_MARGIN: f64 = 0.2;
const LIFT_SIGMAS: f64 = 5.0;
/// The same for the forces that a flight's acceleration tells, with room for a world scaled by a fifth too much.
const FORCE_DRAG_MARGIN: f64 = 0.25;
const FORCE_LIFT_MOST: f64 = 0.7;

/// One track with its camera and its span in true time.
struct Seen<'a> {
    track: &'a Track,
    camera: usize,
    span_s: (f64, f64),
}

/// Two or more tracks on one flight.
struct Meeting {
    tracks: Vec<usize>,
    state: FlightState,
    /// Points that fit: the more, the surer.
    points: usize,
}

/// Groups tracks that lie on one flight; tracks that meet none come last, each alone. In time order.
pub fn match_tracks(cameras: &[CameraModel], tracks: &[Track], options: &FlightOptions) -> Vec<PitchTracks> {
    let loose: Vec<CameraModel> = cameras.iter().map(loosened).collect();
    let origin_ns = tracks
        .iter()
        .filter_map(Track::span)
        .map(|s| s.0.nanos())
        .min()
        .unwrap_or(0);
    let seen: Vec<Seen> = tracks
        .iter()
        .filter_map(|t| seen(cameras, t, origin_ns))
        .collect();
    let rigid = FlightOptions {
        acceleration_levels_mps2: options.acceleration_levels_mps2.iter().copied().take(1).collect(),
        ..options.clone()
    };
    let mut meetings = pairs(&loose, &seen, &rigid);
    meetings.sort_by_key(|m| std::cmp::Reverse(m.points));
    let mut taken = vec![false; seen.len()];
    let mut groups: Vec<(f64, PitchTracks)> = Vec::new();
    for mut meeting in meetings {
        if meeting.tracks.iter().any(|t| taken[*t]) {
            continue;
        }
        extend(&loose, &seen, &taken, &mut meeting);
        for t in &meeting.tracks {
            taken[*t] = true;
        }
        groups.push(group(&seen, &meeting.tracks));
    }
    for (index, _) in taken.iter().enumerate().filter(|(_, taken)| !**taken) {
        groups.push(group(&seen, &[index]));
    }
    groups.sort_by(|a, b| a.0.total_cmp(&b.0));
    groups.into_iter().map(|(_, g)| g).collect()
}

fn group(seen: &[Seen], tracks: &[usize]) -> (f64, PitchTracks) {
    let begin = tracks
        .iter()
        .map(|t| seen[*t].span_s.0)
        .fold(f64::INFINITY, f64::min);
    let tracks = tracks.iter().map(|t| seen[*t].track.clone()).collect();
    (begin, PitchTracks { tracks })
}

fn loosened(camera: &CameraModel) -> CameraModel {
    let mut loose = camera.clone();
    let sigma = camera.noise.sigma_px.max(0.05);
    let wider = 1.0 + (SLACK_PX / sigma).powi(2);
    loose.noise.sigma_px = sigma * wider.sqrt();
    loose.noise.variance_factor *= wider;
    loose
}

fn seen<'a>(cameras: &[CameraModel], track: &'a Track, origin_ns: i64) -> Option<Seen<'a>> {
    let camera = cameras.iter().position(|c| c.id == track.camera)?;
    let timing = &cameras[camera].timing;
    let (first, last) = (track.points.first()?, track.points.last()?);
    let at = |p: &crate::scene::TrackPoint| timing.true_seconds(p.stamped, p.pixel.y, origin_ns);
    Some(Seen {
        track,
        camera,
        span_s: (at(first), at(last)),
    })
}

/// Median misfit in pixels of every pair of tracks of two cameras that overlap in time, by a first flight
/// through every third point.
pub(super) fn first_misfits(cameras: &[CameraModel], tracks: &[Track], options: &FlightOptions) -> Vec<f64> {
    let origin_ns = tracks.iter().filter_map(Track::span).map(|s| s.0.nanos()).min();
    let seen: Vec<Seen> = tracks
        .iter()
        .filter_map(|t| seen(cameras, t, origin_ns.unwrap_or(0)))
        .collect();
    let mut misfits = Vec::new();
    for (a, b) in overlapping(&seen) {
        let points: Vec<Sighting> = sightings(&seen, &[a, b]).into_iter().step_by(3).collect();
        let first = linear_start(cameras, &points, options.physics, epoch(&points));
        misfits.extend(first.map(|(_, median_px)| median_px));
    }
    misfits
}

/// Pairs of tracks of two cameras that overlap in time.
fn overlapping(seen: &[Seen]) -> Vec<(usize, usize)> {
    let mut pairs = Vec::new();
    for (a, first) in seen.iter().enumerate() {
        for (b, second) in seen.iter().enumerate().skip(a + 1) {
            let overlap = first.span_s.1.min(second.span_s.1) - first.span_s.0.max(second.span_s.0);
            let shorter = (first.span_s.1 - first.span_s.0).min(second.span_s.1 - second.span_s.0);
            if first.camera != second.camera && overlap > 0.3 * shorter {
                pairs.push((a, b));
            }
        }
    }
    pairs
}

fn sightings(seen: &[Seen], tracks: &[usize]) -> Vec<Sighting> {
    let mut all = Vec::new();
    for t in tracks {
        all.extend(seen[*t].track.points.iter().map(|p| Sighting {
            camera: seen[*t].camera,
            track: *t,
            point: *p,
        }));
    }
    all
}

/// Every pair of tracks of two cameras that overlap in time and lie on one plausible flight.
fn pairs(cameras: &[CameraModel], seen: &[Seen], options: &FlightOptions) -> Vec<Meeting> {
    let mut found = Vec::new();
    for (a, b) in overlapping(seen) {
        let tracks = vec![a, b];
        let points = sightings(seen, &tracks);
        let epoch_ns = epoch(&points);
        let near = linear_start(cameras, &points, options.physics, epoch_ns)
            .is_some_and(|(_, median_px)| median_px < FIRST_MISFIT_PX);
        if !near {
            continue;
        }
        let Ok(state) = fit_flight(cameras, &points, epoch_ns, options) else {
            continue;
        };
        let fits = |t: &usize| share(cameras, seen, *t, &state.trajectory) >= SHARE_NEEDED;
        if tracks.iter().all(fits) && implausible(&state.trajectory, options).is_none() {
            found.push(Meeting {
                points: points.len(),
                tracks,
                state,
            });
        }
    }
    found
}

/// Adds the free tracks that lie on a meeting's flight.
fn extend(cameras: &[CameraModel], seen: &[Seen], taken: &[bool], meeting: &mut Meeting) {
    let epoch_ns = meeting.state.trajectory.epoch_ns();
    let (begin, end) = meeting.state.trajectory.span_s();
    for (t, other) in seen.iter().enumerate() {
        if taken[t] || meeting.tracks.contains(&t) {
            continue;
        }
        let timing = &cameras[other.camera].timing;
        let inside = other.track.points.iter().all(|p| {
            let at = timing.true_seconds(p.stamped, p.pixel.y, epoch_ns);
            (begin - 0.05..end + 0.05).contains(&at)
        });
        if inside && share(cameras, seen, t, &meeting.state.trajectory) >= SHARE_NEEDED {
            meeting.tracks.push(t);
        }
    }
}

/// Share of a track's points that lie on a flight.
fn share(cameras: &[CameraModel], seen: &[Seen], track: usize, path: &Trajectory) -> f64 {
    let own = &seen[track];
    let loss = Loss::Truncated { limit: KEEP_LIMIT };
    let fits =
        own.track.points.iter().filter(|p| {
            Sight::new(&cameras[own.camera], p, path).is_ok_and(|s| loss.apply(s.distance2).1 > 0.5)
        });
    fits.count() as f64 / own.track.points.len().max(1) as f64
}

/// Why no ball's forces bend a flight so, in words. A free enough flight fits points in a world of any scale; its
/// own acceleration tells: CL of a spinning ball ends at 1/2.32 (domain §2).
pub fn unphysical(flight: &SolvedFlight, options: &FlightOptions) -> Option<String> {
    let (begin, end) = flight.observed_s;
    let path = &flight.trajectory;
    let v = path.velocity_mps(0.5 * (begin + end));
    let mut force = (path.velocity_mps(end) - path.velocity_mps(begin)) / (end - begin);
    force.z += options.physics.gravity_mps2;
    let pressure = options.physics.drag_per_m * v.norm_squared();
    let along = v.normalize();
    let drag = -force.dot(&along) / pressure;
    let lift = (force - force.dot(&along) * along).norm() / pressure;
    let far = (drag - options.prior.drag_coefficient).abs() > FORCE_DRAG_MARGIN;
    // Also what is not a number.
    (far || !(lift < FORCE_LIFT_MOST)).then(|| {
        let speed = v.norm();
        format!("at {speed:.0} m/s it brakes and bends with Cd {drag:.2} and CL {lift:.2}")
    })
}

/// Why a flight is no pitched ball's, in words; `None` where it may be one.
pub fn implausible(path: &Trajectory, options: &FlightOptions) -> Option<String> {
    let (begin, end) = path.span_s();
    let speed = path.velocity_mps(0.5 * (begin + end)).norm();
    if !(SPEED_MPS.0..SPEED_MPS.1).contains(&speed) {
        return Some(format!("its speed is {speed:.1} m/s"));
    }
    let aero = path.aerodynamics();
    let drag = (aero.drag_coefficient - options.prior.drag_coefficient).abs();
    let lift = aero.lift.norm() / options.prior.lift_sigma;
    if drag > DRAG_MARGIN || lift > LIFT_SIGMAS {
        return Some(format!(
            "its drag and lift (Cd {:.2}, CL {:.2}) are no ball's",
            aero.drag_coefficient,
            aero.lift.norm()
        ));
    }
    None
}
