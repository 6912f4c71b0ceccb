//! The joint estimator: one robust maximum-likelihood problem over poses, delays, clock skews and one flight
//! per pitch, every detection used at its own true exposure midpoint (method §3).
//!
//! `problem` (unknowns and state) and `camera_terms` (landmarks, positions, gauge) make the equations that
//! `solver` descends; `noise` and `wrong_tracks` decide what to believe; `publish` states the uncertainty.

mod bound;
mod camera_terms;
mod noise;
mod problem;
mod publish;
mod solver;
#[cfg(test)]
mod tests;
mod wrong_tracks;

use crate::calibration::{CalibrationError, InitialEstimate, PitchTracks};
use crate::flight::SolvedFlight;
use crate::flight::equations::Loss;
use crate::flight::solve::choose_level;
use crate::scene::{Calibration, CameraId, ParameterKind, Rig};

pub use bound::{Bound, BoundOptions, CameraBound, Clocks, PitchBound, bound};
pub use publish::check_delays;

use noise::KEPT;
use problem::{JointProblem, JointState};

/// How the joint problem is set up and judged.
#[derive(Debug, Clone, PartialEq)]
pub struct JointOptions {
    /// Fewest pitches seen by two cameras.
    pub pitches_needed: usize,
    /// Prior 1σ of a clock's rate error, ppm.
    pub skew_sigma_ppm: f64,
    /// A skew of one prior sigma is an unknown when it moves a camera by more than this over the session.
    pub drift_noticed_frames: f64,
    /// Mean and 1σ of a rolling shutter's readout where it is to be estimated, seconds.
    pub readout_prior_s: (f64, f64),
    /// A delay less sure than this is refused, frames.
    pub delay_sigma_frames_max: f64,
    /// Whether the noise of every camera is taken from the residuals; else what the points claim holds.
    pub noise: NoiseSource,
}

/// Where the noise of the points is known from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NoiseSource {
    /// A factor per camera on what the points claim, and the jitter of its stamps, from the residuals.
    Residuals,
    /// The points' own claims.
    Claims,
}

impl Default for JointOptions {
    fn default() -> Self {
        Self {
            pitches_needed: 1,
            skew_sigma_ppm: 30.0,
            drift_noticed_frames: 0.002,
            readout_prior_s: (0.015, 0.01),
            delay_sigma_frames_max: 0.35,
            noise: NoiseSource::Residuals,
        }
    }
}

/// A track that is not the ball that the other cameras saw.
#[derive(Debug, Clone, PartialEq)]
pub struct WrongTrack {
    /// Camera.
    pub camera: CameraId,
    /// Track number within the camera.
    pub track: u32,
    /// Index of the pitch it was taken for.
    pub pitch: usize,
    /// Share of its points that fit.
    pub kept_share: f64,
}

/// What the estimator found.
#[derive(Debug, Clone)]
pub struct JointSolution {
    /// Cameras, covariance, conditions, warnings.
    pub calibration: Calibration,
    /// Flights of the pitches used, covariance with the cameras' included.
    pub flights: Vec<SolvedFlight>,
    /// Index of each flight's pitch among those given.
    pub flight_pitches: Vec<usize>,
    /// Tracks left out.
    pub wrong_tracks: Vec<WrongTrack>,
    /// −2·ln of the posterior density at the solution, up to a constant of the points: tells valleys of one problem
    /// apart.
    pub surprise: f64,
    /// Robust cost per point kept or not, in squared sigmas at the noise the points claim: ranks hypotheses.
    pub cost: f64,
}

/// A start on its way to a solution.
#[derive(Debug, Clone)]
pub struct Candidate {
    problem: JointProblem,
    state: JointState,
    /// Mean robust cost per point, in squared sigmas as claimed: ranks candidates.
    pub cost: f64,
}

impl Candidate {
    /// Whether it lies where a solution already lies: delays to a tenth of a millisecond, turns to a third
    /// of a degree.
    pub fn same_place(&self, calibration: &Calibration) -> bool {
        self.state.cameras.len() == calibration.cameras.len()
            && self.state.cameras.iter().all(|own| {
                calibration.camera(&own.id).is_some_and(|other| {
                    let turn = own.pose.rotation.angle_to(&other.camera_from_world.rotation);
                    turn < 0.006 && (own.timing.capture_delay_s - other.capture_delay_s).abs() < 1e-4
                })
            })
    }
}

/// Refines one start to the end.
///
/// # Errors
/// [`CalibrationError`]: too few pitches, a delay that cannot be observed, no convergence.
pub fn refine(
    rig: &Rig,
    pitches: &[PitchTracks],
    start: &InitialEstimate,
    options: &JointOptions,
) -> Result<JointSolution, CalibrationError> {
    let candidate = explore(rig, pitches, start, options)?;
    let solution = finish(rig, pitches, candidate, options)?;
    check_delays(rig, &solution, options)?;
    Ok(solution)
}

/// Brings a start to the bottom of its valley with a broad loss: enough to choose among starts.
///
/// # Errors
/// [`CalibrationError`] where the problem cannot be set up.
pub fn explore(
    rig: &Rig,
    pitches: &[PitchTracks],
    start: &InitialEstimate,
    options: &JointOptions,
) -> Result<Candidate, CalibrationError> {
    let (problem, mut state) = JointProblem::new(rig, pitches, start, options)?;
    anneal(&problem, &mut state);
    let loss = Loss::Cauchy { scale: 3.0 };
    let cost = problem.cost(&state, loss) / noise::points(&state).max(1) as f64;
    Ok(Candidate { problem, state, cost })
}

/// Descends with a loss that narrows from what the residuals are now.
fn anneal(problem: &JointProblem, state: &mut JointState) {
    let mut scale = noise::median_distance(state).clamp(1.5, 500.0) * 2.0;
    loop {
        problem.descend(state, Loss::Cauchy { scale }, 6);
        if scale <= 3.0 {
            break;
        }
        scale = (scale / 4.0).max(3.0);
    }
}

/// Takes a candidate to its maximum-likelihood end: noise from the residuals, points in or out, wrong tracks
/// out, wobbling flights freed, clocks that do not drift held; then states the uncertainty. Whether that is
/// good enough is [`check_delays`]'s to say.
///
/// # Errors
/// [`CalibrationError`]: too few pitches left, no convergence.
pub fn finish(
    rig: &Rig,
    pitches: &[PitchTracks],
    candidate: Candidate,
    options: &JointOptions,
) -> Result<JointSolution, CalibrationError> {
    let Candidate {
        mut problem,
        mut state,
        cost,
    } = candidate;
    let mut wrong = Vec::new();
    for _ in 0..5 {
        if options.noise == NoiseSource::Residuals {
            noise::scale_by_median(&mut state);
        }
        problem.descend(&mut state, Loss::Cauchy { scale: 3.0 }, 8);
        let found = wrong_tracks::take_out(pitches, &mut state, &problem.flight.acceleration_levels_mps2);
        if state.flights.len() < options.pitches_needed {
            return Err(CalibrationError::TooFewPitches {
                found: state.flights.len(),
                needed: options.pitches_needed,
            });
        }
        if found.is_empty() {
            break;
        }
        wrong.extend(found);
    }
    problem.terms.weigh(&state.cameras);
    free_wobbling(&problem, &mut state)?;
    settle(&problem, &mut state, options)?;
    if stiffen(&problem, &mut state) {
        anneal(&problem, &mut state);
        settle(&problem, &mut state, options)?;
    }
    free_wobbling(&problem, &mut state)?;
    if hold_steady_clocks(&mut problem, &mut state, options)? {
        settle(&problem, &mut state, options)?;
    } else {
        problem.descend(&mut state, KEPT, 10);
    }
    publish::publish(rig, pitches, &problem, &state).map(|mut solution| {
        solution.wrong_tracks = wrong;
        solution.cost = cost;
        solution
    })
}

/// Points in or out and noise from the residuals, in turn, until neither changes.
fn settle(
    problem: &JointProblem,
    state: &mut JointState,
    options: &JointOptions,
) -> Result<(), CalibrationError> {
    let mut before = noise::kept(state);
    for _ in 0..8 {
        for flight in &mut state.flights {
            flight.state.trajectory = flight.state.trajectory.clone().with_own_exponent();
        }
        let cost = problem.descend(state, KEPT, 15);
        if !cost.is_finite() {
            return Err(CalibrationError::NotConverged {
                stage: "joint estimation",
                reason: "the cost is not a number".to_owned(),
            });
        }
        let change = match options.noise {
            NoiseSource::Residuals => noise::estimate(problem, state, KEPT),
            NoiseSource::Claims => 0.0,
        };
        let now = noise::kept(state);
        if now == before && change < 0.01 {
            return Ok(());
        }
        before = now;
    }
    Ok(())
}

/// Gives each flight the residual acceleration that its points ask for, the cameras held.
fn free_wobbling(problem: &JointProblem, state: &mut JointState) -> Result<(), CalibrationError> {
    for flight in &mut state.flights {
        let levels = &problem.flight.acceleration_levels_mps2;
        flight.state = choose_level(flight.state.clone(), &state.cameras, &flight.sightings, levels)
            .map_err(|e| CalibrationError::NotConverged {
                stage: "flight",
                reason: e.to_string(),
            })?;
    }
    Ok(())
}

/// Takes the residual acceleration back where most flights were given some: not all pitches are knuckleballs,
/// but all look so from cameras a little off, and flights so free hide a wrong scale. Says whether it did.
fn stiffen(problem: &JointProblem, state: &mut JointState) -> bool {
    let Some(&rigid) = problem.flight.acceleration_levels_mps2.first() else {
        return false;
    };
    let freed = state
        .flights
        .iter()
        .filter(|f| f.state.prior.acceleration_sigma_mps2 > rigid);
    if 2 * freed.count() <= state.flights.len() {
        return false;
    }
    for flight in &mut state.flights {
        flight.state.prior.acceleration_sigma_mps2 = rigid;
    }
    true
}

/// Holds at zero the skew of each clock that shows none: the density of zero after the data over its density
/// before (Savage and Dickey). Says whether any was held.
fn hold_steady_clocks(
    problem: &mut JointProblem,
    state: &mut JointState,
    options: &JointOptions,
) -> Result<bool, CalibrationError> {
    let covariance = publish::camera_covariance(problem, state)?;
    let mut steady = Vec::new();
    for (i, column) in problem.columns.iter().enumerate() {
        if column.parameter() != ParameterKind::ClockSkew {
            continue;
        }
        let skew = state.cameras[column.camera].timing.clock_skew_ppm;
        let (after, prior) = (covariance[(i, i)], options.skew_sigma_ppm.powi(2));
        let log_ratio = 0.5 * (prior / after).ln() - 0.5 * skew * skew * (1.0 / after - 1.0 / prior);
        if log_ratio > 0.0 {
            steady.push(column.camera);
        }
    }
    for camera in &steady {
        problem.fix(*camera, ParameterKind::ClockSkew);
        state.cameras[*camera].timing.clock_skew_ppm = 0.0;
    }
    Ok(!steady.is_empty())
}
