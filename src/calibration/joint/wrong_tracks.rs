//! Whole tracks that are not the ball the other cameras saw: found by the share of their points that fit.

use super::WrongTrack;
use super::noise::KEPT;
use super::problem::{FlightUnknown, JointState, start_flight};
use crate::calibration::PitchTracks;
use crate::flight::FlightOptions;
use crate::flight::sighting::{CameraModel, Sight};
use crate::flight::solve::fit_flight;

/// A track with a smaller share of fitting points is not this ball's. A ball's track with 10 % false points
/// and 5 % lost to the threshold keeps five sixths.
const SHARE_NEEDED: f64 = 0.5;

/// Takes the worst misfitting track of every flight out, and the flight with it when fewer than two cameras
/// remain. What is left of a flight starts anew. A flight that fits all its tracks once it may wobble as a knuckleball
/// does keeps them.
pub(super) fn take_out(
    pitches: &[PitchTracks],
    state: &mut JointState,
    levels_mps2: &[f64],
) -> Vec<WrongTrack> {
    let mut wrong = Vec::new();
    let cameras = &state.cameras;
    state.flights.retain_mut(|flight| {
        let Some(pitch) = pitches.get(flight.pitch) else {
            return false;
        };
        let Some((track, kept_share)) = worst(cameras, flight, pitch.tracks.len()) else {
            return true;
        };
        if let Some(freed) = freed(cameras, flight, levels_mps2)
            && worst(cameras, &freed, pitch.tracks.len()).is_none()
        {
            *flight = freed;
            return true;
        }
        wrong.push(WrongTrack {
            camera: pitch.tracks[track].camera.clone(),
            track: pitch.tracks[track].track,
            pitch: flight.pitch,
            kept_share,
        });
        flight.sightings.retain(|s| s.track != track);
        let mut seen: Vec<_> = flight.sightings.iter().map(|s| s.camera).collect();
        seen.sort_unstable();
        seen.dedup();
        if seen.len() < 2 {
            return false;
        }
        let options = options_of(flight, vec![flight.state.prior.acceleration_sigma_mps2]);
        let span = flight.state.trajectory.span_s();
        if let Some(anew) = start_flight(cameras, &flight.sightings, &options) {
            flight.state.trajectory = anew.trajectory.with_span(span.0, span.1);
        }
        true
    });
    wrong
}

/// The track that fits worst and the share of its points that fit, where that is too small.
fn worst(cameras: &[CameraModel], flight: &FlightUnknown, tracks: usize) -> Option<(usize, f64)> {
    let mut counts = vec![(0usize, 0usize); tracks];
    for s in &flight.sightings {
        let fits = Sight::new(&cameras[s.camera], &s.point, &flight.state.trajectory)
            .is_ok_and(|sight| KEPT.apply(sight.distance2).1 > 0.5);
        counts[s.track].0 += usize::from(fits);
        counts[s.track].1 += 1;
    }
    let seen = counts.iter().enumerate().filter(|(_, (_, all))| *all > 0);
    let shares = seen.map(|(track, (fits, all))| (track, *fits as f64 / *all as f64));
    shares
        .min_by(|a, b| a.1.total_cmp(&b.1))
        .filter(|(_, share)| *share < SHARE_NEEDED)
}

/// The flight with the residual acceleration that its points ask for.
fn freed(cameras: &[CameraModel], flight: &FlightUnknown, levels_mps2: &[f64]) -> Option<FlightUnknown> {
    let options = options_of(flight, levels_mps2.to_vec());
    let epoch_ns = flight.state.trajectory.epoch_ns();
    let mut state = fit_flight(cameras, &flight.sightings, epoch_ns, &options).ok()?;
    let (begin_s, end_s) = flight.state.trajectory.span_s();
    state.trajectory = state.trajectory.with_span(begin_s, end_s);
    Some(FlightUnknown {
        state,
        ..flight.clone()
    })
}

fn options_of(flight: &FlightUnknown, acceleration_levels_mps2: Vec<f64>) -> FlightOptions {
    FlightOptions {
        physics: *flight.state.trajectory.physics(),
        prior: flight.state.prior,
        acceleration_levels_mps2,
        // The span is kept as it was.
        cover_y_m: None,
    }
}
