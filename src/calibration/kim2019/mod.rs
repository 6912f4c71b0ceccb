//! The paper's recipe (`--method kim2019`): 2-D trajectory models, five-point with MLESAC, DLT, and a search
//! over the delays [Kim19 §III]. Kept as the paper has it; the default method is `joint`.
//!
//! Signs are those of the paper's equations, τ > 0 where true = stamped − τ; its prose around Fig. 3 and the sign
//! of τ* in its Tables 3–6 say the opposite. Departures, each named where it is made: the delays start from the
//! coarse search of [`super::initial`] (the paper starts near zero), instants at which the cameras do not all see
//! the ball are left out, lens distortion is taken out first, and a world with metres is added at the end.

pub mod reconstruction;
pub mod search;
mod session;
pub mod trajectory;
mod world;

use nalgebra::Point3;

use self::reconstruction::{Instant, Problem, Reconstruction};
use self::search::{Evaluation, Optimizer, PENALTY, least, search};
use self::trajectory::{ImageTrajectory, StrayPoints, TrajectoryModel};
use super::initial::{InitialOptions, hypotheses};
use super::{CalibrationError, InitialEstimate, PitchTracks};
use crate::geometry::Pose;
use crate::scene::{CostStep, Rig, WorldFrame};

pub use session::calibrate_session;

/// Choices of the paper.
#[derive(Debug, Clone, PartialEq)]
pub struct Kim2019Options {
    /// F1 or F2.
    pub trajectory: TrajectoryModel,
    /// O1 or O2.
    pub optimizer: Optimizer,
    /// Points that are not the ball.
    pub stray: StrayPoints,
    /// Every n-th frame of the reference camera gives an instant.
    pub stride: usize,
    /// Instants keep this far from the ends of the tracks, frames.
    pub margin_frames: f64,
    /// Minimal samples of MLESAC at every evaluation.
    pub samples: usize,
    /// 1σ of x* for MLESAC, pixels.
    pub sigma_px: f64,
    /// Seed of MLESAC.
    pub seed: u64,
    /// Most evaluations of the cost.
    pub evaluations_max: usize,
}

impl Default for Kim2019Options {
    fn default() -> Self {
        Self {
            trajectory: TrajectoryModel::PAPER,
            optimizer: Optimizer::NelderMead,
            stray: StrayPoints::Drop,
            stride: 1,
            margin_frames: 1.0,
            samples: 5,
            sigma_px: 0.5,
            seed: 1,
            evaluations_max: 120,
        }
    }
}

/// What the recipe finds.
#[derive(Debug, Clone)]
pub struct Kim2019Solution {
    /// Per rig camera.
    pub poses: Vec<Option<Pose>>,
    /// τ* per rig camera, seconds.
    pub capture_delay_s: Vec<f64>,
    /// Coordinates of the poses.
    pub world: WorldFrame,
    /// Mean reprojection error, pixels: the paper's "3D reconstruction error (pixel)".
    pub reprojection_px: f64,
    /// Root mean square reprojection error per rig camera, pixels.
    pub rms_px: Vec<f64>,
    /// Mean distance of the points to the trajectory model, pixels.
    pub misfit_px: f64,
    /// Every evaluation of the cost.
    pub cost_trace: Vec<CostStep>,
    /// What a person must know.
    pub notes: Vec<String>,
}

/// Calibrates by the paper's recipe, with the reprojection error as the cost (the one a user can run).
///
/// # Errors
/// As [`hypotheses`], and [`CalibrationError::NotConverged`] where no delay gives a reconstruction.
pub fn calibrate(
    rig: &Rig,
    pitches: &[PitchTracks],
    options: &Kim2019Options,
) -> Result<Kim2019Solution, CalibrationError> {
    let starts = hypotheses(rig, pitches, &InitialOptions::default())?;
    let Some(start) = starts.first() else {
        return Err(CalibrationError::NoTracks);
    };
    let problem = prepare(rig, pitches, start, options)?;
    let frames: Vec<f64> = problem
        .others
        .iter()
        .map(|&c| rig.cameras[c].frame_rate_hz)
        .collect();
    let from: Vec<f64> = problem
        .others
        .iter()
        .zip(&frames)
        .map(|(&c, rate)| start.capture_delay_s[c] * rate)
        .collect();
    let trace = optimise(&problem, &frames, &from, (options, &Cost::Reprojection));
    let not_converged = |reason: &str| CalibrationError::NotConverged {
        stage: "kim2019 delay search",
        reason: reason.to_owned(),
    };
    let Some((best, cost)) = least(&trace).filter(|(_, cost)| *cost < PENALTY) else {
        return Err(not_converged("no delay gives a reconstruction"));
    };
    let seconds = in_seconds(best, &frames);
    let found = problem
        .reconstruct(&seconds)?
        .ok_or_else(|| not_converged("the best delay fails"))?;
    let mut capture_delay_s = vec![0.0; rig.cameras.len()];
    for (&camera, &delay) in problem.others.iter().zip(&seconds) {
        capture_delay_s[camera] = delay;
    }
    let placed = world::place(rig, pitches, &found, &capture_delay_s);
    let mut notes = start.notes.clone();
    notes.extend(placed.note);
    Ok(Kim2019Solution {
        poses: placed.poses,
        capture_delay_s,
        world: placed.world,
        reprojection_px: *cost,
        rms_px: found.rms_px,
        misfit_px: problem.misfit_px(),
        cost_trace: steps(&trace, &frames),
        notes,
    })
}

fn in_seconds(frames: &[f64], rates_hz: &[f64]) -> Vec<f64> {
    frames.iter().zip(rates_hz).map(|(d, rate)| d / rate).collect()
}

fn steps(trace: &[Evaluation], rates_hz: &[f64]) -> Vec<CostStep> {
    trace
        .iter()
        .enumerate()
        .map(|(evaluation, (delays, cost))| CostStep {
            evaluation,
            capture_delay_s: in_seconds(delays, rates_hz),
            cost_px: *cost,
        })
        .collect()
}

/// A reconstruction as a start for another estimator: metres and a world added. Delays in seconds, cameras of the
/// problem's `others`.
pub fn as_start(
    rig: &Rig,
    pitches: &[PitchTracks],
    (problem, found): (&Problem, &Reconstruction),
    delays_s: &[f64],
) -> InitialEstimate {
    let mut capture_delay_s = vec![0.0; rig.cameras.len()];
    for (&camera, &delay) in problem.others.iter().zip(delays_s) {
        capture_delay_s[camera] = delay;
    }
    let placed = world::place(rig, pitches, found, &capture_delay_s);
    let stamps = pitches.iter().flat_map(|p| &p.tracks).filter_map(|t| t.span());
    let epoch_ns = stamps.map(|(a, _)| a.nanos()).min().unwrap_or(0);
    InitialEstimate {
        poses: placed.poses,
        capture_delay_s,
        clock_skew_ppm: vec![0.0; rig.cameras.len()],
        skew_epoch_ns: vec![epoch_ns; rig.cameras.len()],
        world: placed.world,
        score_px: found.reprojection_px,
        notes: placed.note.into_iter().collect(),
    }
}

/// What is minimised.
pub enum Cost<'a> {
    /// Mean reprojection error, pixels: real data.
    Reprojection,
    /// Mean distance to the true points at the problem's instants [Kim19 eq. 5]: simulation.
    Distance(&'a [Point3<f64>]),
}

/// Searches the delays (frames of each camera) from `from`; every evaluation, in order.
pub fn optimise(
    problem: &Problem,
    rates_hz: &[f64],
    from: &[f64],
    (options, cost): (&Kim2019Options, &Cost),
) -> Vec<Evaluation> {
    let at = |delays: &[f64]| -> f64 {
        let seconds = in_seconds(delays, rates_hz);
        let Ok(Some(found)) = problem.reconstruct(&seconds) else {
            return PENALTY;
        };
        match cost {
            Cost::Reprojection => found.reprojection_px,
            Cost::Distance(truth) => problem.distance(&found, truth).unwrap_or(PENALTY),
        }
    };
    search(&at, from, options.optimizer, options.evaluations_max)
}

/// Trajectory models, instants and starting poses of a problem. The estimate says where the delays start and
/// may bring poses that MLESAC tries beside its samples.
pub fn prepare(
    rig: &Rig,
    pitches: &[PitchTracks],
    start: &InitialEstimate,
    options: &Kim2019Options,
) -> Result<Problem, CalibrationError> {
    let stamps = pitches.iter().flat_map(|p| &p.tracks).filter_map(|t| t.span());
    let epoch_ns = stamps
        .map(|(a, _)| a.nanos())
        .min()
        .ok_or(CalibrationError::NoTracks)?;
    let model = (options.trajectory, options.stray);
    let trajectories: Vec<Vec<Option<ImageTrajectory>>> = pitches
        .iter()
        .map(|p| {
            rig.cameras
                .iter()
                .map(|c| ImageTrajectory::fit(c, p, epoch_ns, model))
                .collect()
        })
        .collect();
    let others: Vec<usize> = (0..rig.cameras.len())
        .filter(|&c| c != rig.reference)
        .filter(|&c| {
            trajectories
                .iter()
                .any(|t| t[c].is_some() && t[rig.reference].is_some())
        })
        .collect();
    if others.is_empty() {
        let camera = rig.reference_camera().id.clone();
        return Err(CalibrationError::NoCommonPitches { camera });
    }
    let lens = |c: usize| &rig.cameras[c].intrinsics;
    let mut problem = Problem {
        instants: instants(rig, &trajectories, &others, (start, options)),
        trajectories,
        reference: rig.reference,
        focal_px: (0..rig.cameras.len())
            .map(|c| 0.5 * (lens(c).fx_px + lens(c).fy_px))
            .collect(),
        samples: options.samples,
        seed: options.seed,
        sigma_px: options.sigma_px,
        starts: vec![Vec::new(); others.len()],
        others,
    };
    for k in 0..problem.others.len() {
        let camera = problem.others[k];
        if let (Some(own), Some(base)) = (start.poses[camera], start.poses[rig.reference]) {
            problem.starts[k].push(own.compose(&base.inverse()));
        }
        // One thorough search at the start; every evaluation then tries its answer beside a few fresh samples,
        // which keeps the cost a function of the delays alone.
        let found = problem.relative_pose(k, start.capture_delay_s[camera], 12 * options.samples.max(5))?;
        problem.starts[k].extend(found);
    }
    Ok(problem)
}

/// Every n-th stamp of the reference camera, with the cameras that see the ball then.
fn instants(
    rig: &Rig,
    trajectories: &[Vec<Option<ImageTrajectory>>],
    others: &[usize],
    (start, options): (&InitialEstimate, &Kim2019Options),
) -> Vec<Instant> {
    let mut all = Vec::new();
    for (pitch, of) in trajectories.iter().enumerate() {
        let Some(reference) = &of[rig.reference] else {
            continue;
        };
        for &time_s in reference.stamps_s.iter().step_by(options.stride.max(1)) {
            let sees = |&&c: &&usize| {
                let margin_s = options.margin_frames / rig.cameras[c].frame_rate_hz;
                let at = time_s + start.capture_delay_s[c];
                of[c]
                    .as_ref()
                    .is_some_and(|t| at >= t.span_s.0 + margin_s && at <= t.span_s.1 - margin_s)
            };
            let mut cameras = vec![rig.reference];
            cameras.extend(others.iter().filter(sees));
            if cameras.len() > 1 {
                all.push(Instant {
                    pitch,
                    time_s,
                    cameras,
                });
            }
        }
    }
    all
}

impl Problem {
    /// Mean distance of all points to the trajectory models, pixels.
    pub fn misfit_px(&self) -> f64 {
        let all: Vec<f64> = self
            .trajectories
            .iter()
            .flatten()
            .flatten()
            .map(|t| t.misfit_px)
            .collect();
        all.iter().sum::<f64>() / all.len().max(1) as f64
    }

    /// The reconstruction at delays in frames.
    pub fn reconstruct_frames(
        &self,
        delays: &[f64],
        rates_hz: &[f64],
    ) -> Result<Option<Reconstruction>, CalibrationError> {
        self.reconstruct(&in_seconds(delays, rates_hz))
    }
}
