//! The calibration as a recipe in numbered stages: tracks in, poses, delays and flights out.

use super::association::{AssociationOptions, associate};
use super::ball_world::{check_scale, rescale};
use super::initial::{InitialOptions, hypotheses};
use super::joint::{self, Candidate, JointOptions, JointSolution, WrongTrack};
use super::matching::{implausible, match_tracks};
use super::resection::LANDMARKS_NEEDED;
use super::sweep::sweep;
use super::{CalibrationError, InitialEstimate, PitchTracks};
use crate::flight::sighting::CameraModel;
use crate::flight::{FlightOptions, SolvedFlight, position_sigma_m, solve_flight};
use crate::scene::{Calibration, Rig, Track};

/// Options of every stage.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct CalibrationOptions {
    /// Tracks to pitches.
    pub association: AssociationOptions,
    /// First guesses.
    pub initial: InitialOptions,
    /// The joint problem.
    pub joint: JointOptions,
}

/// One pitch's flight.
#[derive(Debug, Clone, PartialEq)]
pub struct PitchFlight {
    /// Index among the outcome's pitches.
    pub pitch: usize,
    /// The flight; its tracks are in the order of the pitch's tracks.
    pub flight: SolvedFlight,
    /// Whether the calibration rests on it; else it was solved afterwards.
    pub used: bool,
}

/// A pitch without a flight, and why.
#[derive(Debug, Clone, PartialEq)]
pub struct UnsolvedPitch {
    /// Index among the outcome's pitches.
    pub pitch: usize,
    /// In words.
    pub reason: String,
}

/// What a calibration yields.
#[derive(Debug, Clone)]
pub struct CalibrationOutcome {
    /// Poses, delays, covariance.
    pub calibration: Calibration,
    /// All pitches found, in time order, wrong tracks already taken out.
    pub pitches: Vec<PitchTracks>,
    /// Flights in the order of the pitches.
    pub flights: Vec<PitchFlight>,
    /// Pitches without a flight.
    pub unsolved: Vec<UnsolvedPitch>,
    /// Tracks that were not the ball.
    pub wrong_tracks: Vec<WrongTrack>,
}

/// A start is finished too when its cost is within this factor of the best one's.
const RIVAL_FACTOR: f64 = 1.2;

/// A flight whose middle is less sure than this says nothing of a pitch, metres.
const POSITION_SIGMA_MAX_M: f64 = 0.5;

/// Calibrates a rig from the tracks of pitches.
///
/// # Errors
/// [`CalibrationError`]: too little to work on, no geometry that explains the tracks, or a delay left open.
pub fn calibrate(
    rig: &Rig,
    tracks: &[Track],
    options: &CalibrationOptions,
) -> Result<CalibrationOutcome, CalibrationError> {
    // 1. Tracks of several cameras that are one pitch.
    let pitches = associate(rig, tracks, &options.association).pitches;
    // 2.-5. The usual way, or another where it leads nowhere or leaves most tracks unexplained.
    let (pitches, solution, notes) = find(rig, tracks, pitches, options)?;
    // 6. A camera whose delay stays open is left out where two others remain; else the rig is refused.
    let (solution, open) = leave_open_out(rig, &pitches, solution, options)?;
    check_scale(rig, &solution)?;
    // 7. Flights of the pitches that the calibration does not rest on.
    let mut outcome = assemble(pitches, solution);
    outcome.calibration.warnings.extend(notes);
    outcome.calibration.warnings.extend(open);
    solve_the_rest(rig, &mut outcome);
    Ok(outcome)
}

/// Pitches, solution and what a person must know.
type Found = (Vec<PitchTracks>, JointSolution, Vec<String>);

/// By hypotheses; else, where the ball alone places the cameras, from another pair of them; else by the sweep,
/// where that is better.
fn find(
    rig: &Rig,
    tracks: &[Track],
    pitches: Vec<PitchTracks>,
    options: &CalibrationOptions,
) -> Result<Found, CalibrationError> {
    let sound = |found: &Found| is_sound(rig, tracks, &found.1, options);
    let usual = by_hypotheses(rig, tracks, pitches.clone(), options);
    if usual.as_ref().is_ok_and(sound) {
        return usual;
    }
    if let Some(found) = by_other_partners(rig, tracks, &pitches, options).find(sound) {
        return Ok(found);
    }
    match (by_sweep(rig, tracks, options), usual) {
        (Some(swept), Ok(found)) if !is_better(rig, &swept.1, &found.1, options) => Ok(found),
        (Some(swept), _) => Ok(swept),
        (None, usual) => usual,
    }
}

fn by_hypotheses(
    rig: &Rig,
    tracks: &[Track],
    pitches: Vec<PitchTracks>,
    options: &CalibrationOptions,
) -> Result<Found, CalibrationError> {
    // 2. Where the cameras may be and how late their stamps may run.
    let starts = hypotheses(rig, &pitches, &options.initial)?;
    // 3. Every start to the bottom of its valley.
    let mut candidates = Vec::with_capacity(starts.len());
    let mut refusal = None;
    for start in &starts {
        match joint::explore(rig, &pitches, start, &options.joint) {
            Ok(candidate) => candidates.push((candidate, &start.notes)),
            Err(error) => refusal = Some(error),
        }
    }
    candidates.sort_by(|a, b| a.0.cost.total_cmp(&b.0.cost));
    // 4. The best, and its rivals, to the end.
    let (solution, notes) = choose(rig, &pitches, candidates, options, refusal)?;
    // 5. Where tracks are left over or do not fit: tracks to pitches anew, by geometry.
    let (pitches, solution) = rematch(rig, tracks, pitches, solution, options);
    let solution = rescale(rig, &pitches, solution, options);
    Ok((pitches, solution, notes))
}

/// The same from other pairs of cameras, where the ball alone has to place them.
fn by_other_partners(
    rig: &Rig,
    tracks: &[Track],
    pitches: &[PitchTracks],
    options: &CalibrationOptions,
) -> impl Iterator<Item = Found> {
    let marked = rig
        .cameras
        .iter()
        .filter(|c| c.landmarks.len() >= LANDMARKS_NEEDED);
    let partners = match marked.count() {
        0 | 1 => rig.cameras.len() - 1,
        _ => 1,
    };
    (1..partners).filter_map(move |partner| {
        let mut options = options.clone();
        options.initial.partner = partner;
        by_hypotheses(rig, tracks, pitches.to_vec(), &options).ok()
    })
}

fn by_sweep(rig: &Rig, tracks: &[Track], options: &CalibrationOptions) -> Option<Found> {
    let (pitches, start) = sweep(rig, tracks)?;
    let candidate = joint::explore(rig, &pitches, &start, &options.joint).ok()?;
    let solution = joint::finish(rig, &pitches, candidate, &options.joint).ok()?;
    let (pitches, solution) = rematch(rig, tracks, pitches, solution, options);
    Some((pitches, solution, start.notes))
}

/// Tracks that a solution's flights explain.
fn explained(solution: &JointSolution) -> usize {
    let all = solution.flights.iter().flat_map(|f| &f.tracks);
    all.filter(|t| t.kept > t.outliers).count()
}

/// Whether a swept solution is to be preferred: it alone observes its delays, or it explains more tracks.
fn is_better(rig: &Rig, swept: &JointSolution, found: &JointSolution, options: &CalibrationOptions) -> bool {
    let observes = |solution| {
        joint::check_delays(rig, solution, &options.joint).is_ok() && check_scale(rig, solution).is_ok()
    };
    match (observes(swept), observes(found)) {
        (true, false) => true,
        (false, true) => false,
        _ => explained(swept) > explained(found),
    }
}

/// Whether a solution observes its delays and explains a third of the tracks of the cameras it places.
fn is_sound(rig: &Rig, tracks: &[Track], solution: &JointSolution, options: &CalibrationOptions) -> bool {
    let placed = tracks
        .iter()
        .filter(|t| solution.calibration.camera(&t.camera).is_some())
        .count();
    3 * explained(solution) >= placed
        && joint::check_delays(rig, solution, &options.joint).is_ok()
        && check_scale(rig, solution).is_ok()
}

fn choose(
    rig: &Rig,
    pitches: &[PitchTracks],
    candidates: Vec<(Candidate, &Vec<String>)>,
    options: &CalibrationOptions,
    mut refusal: Option<CalibrationError>,
) -> Result<(JointSolution, Vec<String>), CalibrationError> {
    let best_cost = candidates.first().map_or(f64::INFINITY, |c| c.0.cost);
    let mut best: Option<(JointSolution, Vec<String>)> = None;
    for (candidate, notes) in candidates {
        if best.is_some() && candidate.cost > RIVAL_FACTOR * best_cost {
            break;
        }
        if best
            .as_ref()
            .is_some_and(|(b, _)| candidate.same_place(&b.calibration))
        {
            continue;
        }
        match joint::finish(rig, pitches, candidate, &options.joint) {
            Ok(solution) => {
                if best.as_ref().is_none_or(|(b, _)| solution.cost < b.cost) {
                    best = Some((solution, notes.clone()));
                }
            }
            Err(error) => refusal = refusal.or(Some(error)),
        }
    }
    best.ok_or_else(|| {
        refusal.unwrap_or(CalibrationError::NotConverged {
            stage: "joint estimation",
            reason: "no start led to a solution".to_owned(),
        })
    })
}

/// Groups the tracks by geometry when the first grouping, by time alone, leaves any unexplained, and
/// calibrates again from there. The first solution stands when that does not work out.
fn rematch(
    rig: &Rig,
    tracks: &[Track],
    pitches: Vec<PitchTracks>,
    solution: JointSolution,
    options: &CalibrationOptions,
) -> (Vec<PitchTracks>, JointSolution) {
    let placed = |t: &&Track| solution.calibration.camera(&t.camera).is_some();
    if explained(&solution) == tracks.iter().filter(placed).count() {
        return (pitches, solution);
    }
    let calibration = &solution.calibration;
    let cameras: Vec<_> = calibration
        .cameras
        .iter()
        .map(CameraModel::from_calibration)
        .collect();
    let flight = FlightOptions::for_site(&rig.site, calibration.world);
    let regrouped = match_tracks(&cameras, tracks, &flight);
    let meeting = |groups: &[PitchTracks]| groups.iter().filter(|p| p.cameras_seen() > 1).count();
    if meeting(&regrouped) == 0 {
        return (pitches, solution);
    }
    let start = start_of(rig, calibration);
    let again = joint::explore(rig, &regrouped, &start, &options.joint)
        .and_then(|candidate| joint::finish(rig, &regrouped, candidate, &options.joint));
    match again {
        Ok(again) => (regrouped, again),
        Err(_) => (pitches, solution),
    }
}

/// Takes cameras with an open delay out, one by one; says which and why.
fn leave_open_out(
    rig: &Rig,
    pitches: &[PitchTracks],
    mut solution: JointSolution,
    options: &CalibrationOptions,
) -> Result<(JointSolution, Vec<String>), CalibrationError> {
    let mut left_out = Vec::new();
    while let Err(refusal) = joint::check_delays(rig, &solution, &options.joint) {
        let mut start = start_of(rig, &solution.calibration);
        let CalibrationError::NotEnoughParallax { camera, .. } = &refusal else {
            return Err(refusal);
        };
        if let Some(pose) = rig.index_of(camera).and_then(|i| start.poses.get_mut(i)) {
            *pose = None;
        }
        if start.poses.iter().flatten().count() < 2 {
            return Err(refusal);
        }
        let Ok(candidate) = joint::explore(rig, pitches, &start, &options.joint) else {
            return Err(refusal);
        };
        solution = joint::finish(rig, pitches, candidate, &options.joint)?;
        left_out.push(refusal.to_string());
    }
    Ok((solution, left_out))
}

/// A calibration as a start.
pub(super) fn start_of(rig: &Rig, calibration: &Calibration) -> InitialEstimate {
    let of = |rig_camera: &crate::scene::CameraSetup| calibration.camera(&rig_camera.id);
    let number = |value: fn(&crate::scene::CameraCalibration) -> f64| -> Vec<f64> {
        rig.cameras.iter().map(|c| of(c).map_or(0.0, value)).collect()
    };
    InitialEstimate {
        poses: rig
            .cameras
            .iter()
            .map(|c| of(c).map(|c| c.camera_from_world))
            .collect(),
        capture_delay_s: number(|c| c.capture_delay_s),
        clock_skew_ppm: number(|c| c.clock_skew_ppm),
        skew_epoch_ns: rig
            .cameras
            .iter()
            .map(|c| of(c).map_or(0, |c| c.skew_epoch_ns))
            .collect(),
        world: calibration.world,
        score_px: 0.0,
        notes: Vec::new(),
    }
}

fn assemble(mut pitches: Vec<PitchTracks>, solution: JointSolution) -> CalibrationOutcome {
    let JointSolution {
        calibration,
        mut flights,
        flight_pitches,
        wrong_tracks,
        ..
    } = solution;
    for (flight, pitch) in flights.iter_mut().zip(&flight_pitches) {
        let is_wrong = |camera: &_, track| {
            wrong_tracks
                .iter()
                .any(|w| w.pitch == *pitch && w.camera == *camera && w.track == track)
        };
        flight.tracks.retain(|t| !is_wrong(&t.camera, t.track));
    }
    for (index, pitch) in pitches.iter_mut().enumerate() {
        pitch.tracks.retain(|t| {
            !wrong_tracks
                .iter()
                .any(|w| w.pitch == index && w.camera == t.camera && w.track == t.track)
        });
    }
    CalibrationOutcome {
        calibration,
        pitches,
        flights: flights
            .into_iter()
            .zip(flight_pitches)
            .map(|(flight, pitch)| PitchFlight {
                pitch,
                flight,
                used: true,
            })
            .collect(),
        unsolved: Vec::new(),
        wrong_tracks,
    }
}

pub(crate) fn solve_the_rest(rig: &Rig, outcome: &mut CalibrationOutcome) {
    let options = FlightOptions::for_site(&rig.site, outcome.calibration.world);
    for (pitch, tracks) in outcome.pitches.iter_mut().enumerate() {
        if outcome.flights.iter().any(|f| f.pitch == pitch) {
            continue;
        }
        tracks
            .tracks
            .retain(|t| outcome.calibration.camera(&t.camera).is_some());
        let solved = solve_flight(&outcome.calibration, &tracks.tracks, &options);
        let solved = solved.map_err(|e| e.to_string()).and_then(|flight| {
            let cameras = tracks.cameras_seen();
            match doubt(&flight, cameras, &options) {
                None => Ok(flight),
                Some(reason) => Err(reason),
            }
        });
        match solved {
            Ok(flight) => outcome.flights.push(PitchFlight {
                pitch,
                flight,
                used: false,
            }),
            Err(reason) => outcome.unsolved.push(UnsolvedPitch { pitch, reason }),
        }
    }
    outcome.flights.sort_by_key(|f| f.pitch);
}

/// Why a flight that the calibration does not rest on is not to be shown.
fn doubt(flight: &SolvedFlight, cameras: usize, options: &FlightOptions) -> Option<String> {
    let path = &flight.trajectory;
    if let Some(reason) = implausible(path, options) {
        return Some(format!("it is no pitch: {reason}"));
    }
    let middle_s = 0.5 * (flight.observed_s.0 + flight.observed_s.1);
    let sigma_m = position_sigma_m(path, &flight.covariance, middle_s)
        .iter()
        .copied()
        .fold(0.0, f64::max);
    (sigma_m > POSITION_SIGMA_MAX_M)
        .then(|| format!("seen by {cameras} camera(s), its position is only good to {sigma_m:.1} m"))
}

#[cfg(test)]
mod tests {
    use super::super::matching::unphysical;
    use super::*;
    use crate::flight::trajectory::DRAG_ROW;
    use crate::simulation::{DetectionNoise, Layout, Scenario, simulate_tracks};

    #[test]
    fn a_session_is_calibrated_from_nothing_but_landmarks() {
        for (layout, delays) in [
            (Layout::Three, &[0.73, -1.31][..]),
            (Layout::TwoOpposite, &[-1.7][..]),
        ] {
            let scenario = Scenario::stock(layout, delays, 8).with_detection(DetectionNoise::gaussian(0.3));
            let simulated = simulate_tracks(&scenario).unwrap();
            let clock = std::time::Instant::now();
            let outcome =
                calibrate(&simulated.rig, &simulated.tracks, &CalibrationOptions::default()).unwrap();
            println!("{layout:?}: {:?}", clock.elapsed());
            assert_eq!(outcome.flights.len(), 8);
            assert!(outcome.wrong_tracks.is_empty() && outcome.unsolved.is_empty());
            for (camera, truth) in outcome.calibration.cameras.iter().zip(&simulated.truth.cameras) {
                let error = (camera.capture_delay_s - truth.capture_delay_s) * 175.0;
                println!(
                    "{}: {error:+.4} ± {:.4}",
                    camera.id,
                    175.0 * camera.capture_delay_sigma_s
                );
                assert!(error.abs() < 4.0 * 175.0 * camera.capture_delay_sigma_s + 1e-9);
            }
        }
    }

    /// In a world half its size the same flight falls half as fast: only lift that no ball has can hold it up.
    #[test]
    fn a_world_at_half_its_size_has_no_pitches() {
        let scenario =
            Scenario::stock(Layout::TwoOpposite, &[-1.7], 4).with_detection(DetectionNoise::gaussian(0.3));
        let simulated = simulate_tracks(&scenario).unwrap();
        let outcome = calibrate(&simulated.rig, &simulated.tracks, &CalibrationOptions::default()).unwrap();
        let options = FlightOptions::default();
        assert_eq!(outcome.flights.len(), 4);
        for PitchFlight { flight, .. } in &outcome.flights {
            assert_eq!(unphysical(flight, &options), None);
            let mut small = flight.clone();
            let mut parameters = small.trajectory.parameters().clone();
            parameters.rows_mut(0, DRAG_ROW).scale_mut(0.5);
            small.trajectory = small.trajectory.with_parameters(parameters);
            assert!(unphysical(&small, &options).is_some());
        }
    }
}
