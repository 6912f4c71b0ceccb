//! Whole tracks that are not the ball the other cameras saw: found by the share of their points that fit.

use super::WrongTrack;
use super::noise::KEPT;
use super::problem::{JointState, start_flight};
use crate::calibration::PitchTracks;
use crate::flight::FlightOptions;
use crate::flight::sighting::Sight;

/// A track with a smaller share of fitting points is not this ball's. A ball's track with 10 % false points
/// and 5 % lost to the threshold keeps five sixths.
const SHARE_NEEDED: f64 = 0.5;

/// Takes the worst misfitting track of every flight out, and the flight with it when fewer than two cameras
/// remain. What is left of a flight starts anew.
pub(super) fn take_out(pitches: &[PitchTracks], state: &mut JointState) -> Vec<WrongTrack> {
    let mut wrong = Vec::new();
    let cameras = &state.cameras;
    state.flights.retain_mut(|flight| {
        let Some(pitch) = pitches.get(flight.pitch) else {
            return false;
        };
        let mut counts = vec![(0usize, 0usize); pitch.tracks.len()];
        for s in &flight.sightings {
            let fits = Sight::new(&cameras[s.camera], &s.point, &flight.state.trajectory)
                .is_ok_and(|sight| KEPT.apply(sight.distance2).1 > 0.5);
            counts[s.track].0 += usize::from(fits);
            counts[s.track].1 += 1;
        }
        let share = |(fits, all): &(usize, usize)| *fits as f64 / (*all).max(1) as f64;
        let worst = counts
            .iter()
            .enumerate()
            .filter(|(_, c)| c.1 > 0)
            .min_by(|a, b| share(a.1).total_cmp(&share(b.1)));
        let Some((track, count)) = worst.filter(|(_, c)| share(c) < SHARE_NEEDED) else {
            return true;
        };
        wrong.push(WrongTrack {
            camera: pitch.tracks[track].camera.clone(),
            track: pitch.tracks[track].track,
            pitch: flight.pitch,
            kept_share: share(count),
        });
        flight.sightings.retain(|s| s.track != track);
        let mut seen: Vec<_> = flight.sightings.iter().map(|s| s.camera).collect();
        seen.sort_unstable();
        seen.dedup();
        if seen.len() < 2 {
            return false;
        }
        let options = FlightOptions {
            physics: *flight.state.trajectory.physics(),
            prior: flight.state.prior,
            acceleration_levels_mps2: vec![flight.state.prior.acceleration_sigma_mps2],
            // The span is kept as it was.
            cover_y_m: None,
        };
        let span = flight.state.trajectory.span_s();
        if let Some(anew) = start_flight(cameras, &flight.sightings, &options) {
            flight.state.trajectory = anew.trajectory.with_span(span.0, span.1);
        }
        true
    });
    wrong
}
