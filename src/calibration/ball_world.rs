//! A world that only the ball's flight holds: its scale from gravity and drag, and whether a ball flies so there.

use super::joint::{self, JointSolution};
use super::matching::{implausible, unphysical};
use super::metric::Motion;
use super::recipe::{CalibrationOptions, start_of};
use super::self_calibration::make_pitches;
use super::{CalibrationError, PitchTracks};
use crate::flight::FlightOptions;
use crate::scene::{Rig, WorldFrame};

/// Most new starts of a world without landmarks, and the gain in −2·ln of the density for which the next is made.
const RESCALINGS: usize = 3;
const SURPRISE_NOTICED: f64 = 1.0;

/// Refuses a world without landmarks whose flights no ball flies: with its scale wrong, a free enough flight
/// fits any points.
pub(super) fn check_scale(rig: &Rig, solution: &JointSolution) -> Result<(), CalibrationError> {
    if solution.calibration.world != WorldFrame::ReferenceCamera {
        return Ok(());
    }
    let options = FlightOptions::for_site(&rig.site, solution.calibration.world);
    let reasons: Vec<String> = solution
        .flights
        .iter()
        .filter_map(|f| implausible(&f.trajectory, &options).or_else(|| unphysical(f, &options)))
        .collect();
    match reasons.first() {
        Some(reason) if 2 * reasons.len() > solution.flights.len() => Err(CalibrationError::NoPitches {
            implausible: reasons.len(),
            flights: solution.flights.len(),
            reason: reason.clone(),
        }),
        _ => Ok(()),
    }
}

/// A world without landmarks once more from the scale and the up that make its own flights pitches: a start that
/// was off by a quarter ends in a valley of its own, where lift stands for gravity. The likelier end stands.
pub(super) fn rescale(
    rig: &Rig,
    pitches: &[PitchTracks],
    mut solution: JointSolution,
    options: &CalibrationOptions,
) -> JointSolution {
    if solution.calibration.world != WorldFrame::ReferenceCamera {
        return solution;
    }
    for _ in 0..RESCALINGS {
        match rescaled(rig, pitches, &solution, options) {
            Some(better) => solution = better,
            None => break,
        }
    }
    solution
}

/// One such start to its end; `None` where that is not the likelier one.
fn rescaled(
    rig: &Rig,
    pitches: &[PitchTracks],
    solution: &JointSolution,
    options: &CalibrationOptions,
) -> Option<JointSolution> {
    let motions: Vec<Motion> = solution
        .flights
        .iter()
        .map(|f| {
            let middle_s = 0.5 * (f.observed_s.0 + f.observed_s.1);
            Motion {
                velocity: f.trajectory.velocity_mps(middle_s),
                acceleration: f.trajectory.acceleration_mps2(middle_s),
            }
        })
        .collect();
    let mut start = start_of(rig, &solution.calibration);
    if !make_pitches(rig, &motions, &mut start.poses) {
        return None;
    }
    let candidate = joint::explore(rig, pitches, &start, &options.joint).ok()?;
    let again = joint::finish(rig, pitches, candidate, &options.joint).ok()?;
    let likelier = again.surprise + SURPRISE_NOTICED < solution.surprise;
    (likelier && again.flights.len() >= solution.flights.len()).then_some(again)
}
