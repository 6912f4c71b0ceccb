//! One cell of the paper's matrices: one pair of delays, one preset, four algorithms, and `joint` beside them.

use nalgebra::Point3;

use super::space::{self, NoisePreset, RATE_HZ};
use crate::calibration::joint::{self, JointOptions};
use crate::calibration::kim2019::reconstruction::{Problem, Reconstruction};
use crate::calibration::kim2019::search::{Optimizer, least};
use crate::calibration::kim2019::trajectory::{StrayPoints, TrajectoryModel};
use crate::calibration::kim2019::{Cost, Kim2019Options, as_start, optimise, prepare};
use crate::calibration::{CalibrationError, InitialEstimate, PitchTracks};
use crate::geometry::align_similarity;
use crate::scene::{Rig, WorldFrame};

/// A column of the tables.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, serde::Serialize)]
pub enum Algorithm {
    /// Quadratic, quasi-Newton.
    F1O1,
    /// Quadratic, Nelder–Mead.
    F1O2,
    /// Spline, quasi-Newton.
    F2O1,
    /// Spline, Nelder–Mead.
    F2O2,
    /// F2O2 with the reprojection error as the cost, which needs no truth.
    F2Reprojection,
    /// The joint estimator, which needs no truth either.
    Joint,
}

impl Algorithm {
    /// In the order of the tables.
    pub const ALL: [Self; 6] = [
        Self::F1O1,
        Self::F1O2,
        Self::F2O1,
        Self::F2O2,
        Self::F2Reprojection,
        Self::Joint,
    ];

    /// Name as printed.
    pub fn name(self) -> &'static str {
        match self {
            Self::F1O1 => "F1O1",
            Self::F1O2 => "F1O2",
            Self::F2O1 => "F2O1",
            Self::F2O2 => "F2O2",
            Self::F2Reprojection => "F2O2 (reprojection)",
            Self::Joint => "joint",
        }
    }
}

/// Errors of one algorithm in one cell; `None` where it failed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CellErrors {
    /// |τ2 − τ2*| and |τ3 − τ3*|, frames.
    pub delay_frames: [f64; 2],
    /// Mean 3-D distance after the best similarity [Kim19 eq. 5], centimetres.
    pub distance_cm: f64,
}

/// One cell.
#[derive(Debug, Clone)]
pub struct Cell {
    /// τ2, τ3, frames.
    pub delays_frames: [f64; 2],
    /// Per algorithm, in the order of [`Algorithm::ALL`].
    pub errors: Vec<Option<CellErrors>>,
    /// Draws of the noise, and in how many of them each algorithm answered.
    pub draws: u64,
    /// In the order of [`Algorithm::ALL`].
    pub answered: Vec<u64>,
    /// Mean distance of the points to F1 and to F2, pixels.
    pub misfit_px: [f64; 2],
    /// Why `joint` gave no answer, where it gave none.
    pub joint_refusal: Option<String>,
}

/// Instants: every third frame, three frames from the ends (τ is searched within two and a half).
pub(super) fn options(trajectory: TrajectoryModel, optimizer: Optimizer) -> Kim2019Options {
    Kim2019Options {
        trajectory,
        optimizer,
        stray: StrayPoints::Keep,
        stride: 3,
        margin_frames: 3.0,
        samples: 2,
        sigma_px: 1.0,
        seed: 7,
        // A gradient costs four evaluations.
        evaluations_max: match optimizer {
            Optimizer::QuasiNewton => 210,
            Optimizer::NelderMead => 90,
        },
    }
}

/// An estimate that knows nothing: delays zero, no poses.
pub(super) fn nothing(rig: &Rig) -> InitialEstimate {
    let n = rig.cameras.len();
    InitialEstimate {
        poses: vec![None; n],
        capture_delay_s: vec![0.0; n],
        clock_skew_ppm: vec![0.0; n],
        skew_epoch_ns: vec![space::EPOCH_NS; n],
        world: WorldFrame::ReferenceCamera,
        score_px: 0.0,
        notes: Vec::new(),
    }
}

/// Draws of the noise, each with frames at another phase of the flight: their mean errors fill a cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Draws {
    /// Seed of the first; the others count on.
    pub first_seed: u64,
    /// How many; one is run in any case.
    pub count: u64,
}

/// Runs every algorithm on one cell. Its errors are means over the draws in which the algorithm answered; F1, whose
/// error is its model's and hardly the noise's, runs on the first draw alone.
///
/// # Errors
/// Where no track can be used at all; an algorithm that fails in every draw is a `None`.
pub fn run(
    rig: &Rig,
    delays_frames: [f64; 2],
    noise: &NoisePreset,
    draws: Draws,
) -> Result<Cell, CalibrationError> {
    let both = [TrajectoryModel::Quadratic, TrajectoryModel::PAPER];
    let mut cell = draw((rig, &both), delays_frames, noise, (draws.first_seed, 0.0))?;
    let mut all = vec![cell.errors.clone()];
    for k in 1..draws.count {
        let phase_frames = k as f64 / draws.count as f64;
        let drawn = (draws.first_seed + k, phase_frames);
        let next = draw((rig, &both[1..]), delays_frames, noise, drawn)?;
        cell.joint_refusal = cell.joint_refusal.or(next.joint_refusal);
        all.push(next.errors);
    }
    cell.draws = all.len() as u64;
    for (k, mean) in cell.errors.iter_mut().enumerate() {
        let answers: Vec<CellErrors> = all.iter().filter_map(|e| e.get(k).copied().flatten()).collect();
        *mean = mean_errors(&answers);
        cell.answered[k] = answers.len() as u64;
    }
    Ok(cell)
}

fn mean_errors(answers: &[CellErrors]) -> Option<CellErrors> {
    let mean = |of: fn(&CellErrors) -> f64| answers.iter().map(of).sum::<f64>() / answers.len() as f64;
    (!answers.is_empty()).then(|| CellErrors {
        delay_frames: [mean(|e| e.delay_frames[0]), mean(|e| e.delay_frames[1])],
        distance_cm: mean(|e| e.distance_cm),
    })
}

fn draw(
    (rig, models): (&Rig, &[TrajectoryModel]),
    delays_frames: [f64; 2],
    noise: &NoisePreset,
    drawn: (u64, f64),
) -> Result<Cell, CalibrationError> {
    let pitches = space::pitches(rig, &[0.0, delays_frames[0], delays_frames[1]], noise, drawn);
    let f1_left_out = if models.contains(&TrajectoryModel::Quadratic) {
        0
    } else {
        2
    };
    let mut errors = vec![None; f1_left_out];
    let mut misfit_px = [0.0; 2];
    let mut joint_start = None;
    for &model in models {
        let first = options(model, Optimizer::QuasiNewton);
        let problem = prepare(rig, &pitches, &nothing(rig), &first)?;
        misfit_px[usize::from(model == TrajectoryModel::PAPER)] = problem.misfit_px();
        let truth: Vec<Point3<f64>> = problem
            .instants
            .iter()
            .filter_map(|i| space::truth_at(i.pitch, i.time_s))
            .collect();
        for optimizer in [Optimizer::QuasiNewton, Optimizer::NelderMead] {
            let found = solve(&problem, &options(model, optimizer), &Cost::Distance(&truth));
            errors.push(found.map(|f| judge(&f, delays_frames)));
        }
        if model == TrajectoryModel::PAPER {
            let found = solve(
                &problem,
                &options(model, Optimizer::NelderMead),
                &Cost::Reprojection,
            );
            let scored = found.as_ref().and_then(|f| {
                let distance_m = problem.distance(&f.2, &truth)?;
                Some(judge(&(f.0.clone(), distance_m, f.2.clone()), delays_frames))
            });
            errors.push(scored);
            joint_start = found.map(|f| (problem, truth, f));
        }
    }
    let joint = match joint_start {
        Some((problem, truth, f)) => {
            joint_errors((rig, &pitches), (&problem, &truth), (&f.0, &f.2), delays_frames)
        }
        None => Err("no start from F2".to_owned()),
    };
    let joint_refusal = joint.as_ref().err().cloned();
    errors.push(joint.ok());
    Ok(Cell {
        delays_frames,
        draws: 1,
        answered: errors.iter().map(|e| u64::from(e.is_some())).collect(),
        errors,
        misfit_px,
        joint_refusal,
    })
}

/// The joint estimator told what holds in the paper's space: clocks of one rate, and no delay too weak to print.
pub(super) fn joint_options() -> JointOptions {
    JointOptions {
        delay_sigma_frames_max: f64::INFINITY,
        skew_sigma_ppm: 1e-3,
        ..JointOptions::default()
    }
}

type Found = (Vec<f64>, f64, Reconstruction);

fn solve(problem: &Problem, options: &Kim2019Options, cost: &Cost) -> Option<Found> {
    let rates = vec![RATE_HZ; problem.others.len()];
    let trace = optimise(problem, &rates, &vec![0.0; rates.len()], (options, cost));
    let (delays, cost) = least(&trace)?.clone();
    let found = problem.reconstruct_frames(&delays, &rates).ok()??;
    Some((delays, cost, found))
}

fn judge((delays, distance_m, _): &Found, truth_frames: [f64; 2]) -> CellErrors {
    CellErrors {
        delay_frames: [
            (delays[0] - truth_frames[0]).abs(),
            (delays[1] - truth_frames[1]).abs(),
        ],
        distance_cm: 100.0 * distance_m,
    }
}

/// The joint estimator from where the paper's recipe (with the cost a user can run) has led.
fn joint_errors(
    (rig, pitches): (&Rig, &[PitchTracks]),
    (problem, truth): (&Problem, &[Point3<f64>]),
    (delays, found): (&[f64], &Reconstruction),
    truth_frames: [f64; 2],
) -> Result<CellErrors, String> {
    let seconds: Vec<f64> = delays.iter().map(|d| d / RATE_HZ).collect();
    let start = as_start(rig, pitches, (problem, found), &seconds);
    let solution = joint::refine(rig, pitches, &start, &joint_options()).map_err(|e| e.to_string())?;
    let mut delay_frames = [f64::NAN; 2];
    for (error, (id, truth)) in delay_frames.iter_mut().zip(["c2", "c3"].iter().zip(truth_frames)) {
        let camera = solution
            .calibration
            .cameras
            .iter()
            .find(|c| c.id.as_str() == *id)
            .ok_or_else(|| format!("camera {id} left out"))?;
        *error = (camera.capture_delay_s * RATE_HZ - truth).abs();
    }
    let (mut from, mut to) = (Vec::new(), Vec::new());
    for (instant, point) in problem.instants.iter().zip(truth) {
        let Some(k) = solution.flight_pitches.iter().position(|&p| p == instant.pitch) else {
            continue;
        };
        let trajectory = &solution.flights[k].trajectory;
        let epoch_s = (trajectory.epoch_ns() - space::EPOCH_NS) as f64 / 1e9;
        from.push(trajectory.position_m(instant.time_s - epoch_s));
        to.push(*point);
    }
    let similarity = align_similarity(&from, &to).ok_or("too few points")?;
    let sum: f64 = from
        .iter()
        .zip(&to)
        .map(|(a, b)| (similarity.transform(a) - b).norm())
        .sum();
    Ok(CellErrors {
        delay_frames,
        distance_cm: 100.0 * sum / from.len() as f64,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_noise_f2_and_joint_find_the_delays_and_f1_does_not() {
        let rig = space::rig().unwrap();
        let once = Draws {
            first_seed: 3,
            count: 1,
        };
        let cell = run(&rig, [1.0, -1.5], &space::presets(0.05)[0], once).unwrap();
        let worst = |a: Algorithm| {
            let k = Algorithm::ALL.iter().position(|b| *b == a).unwrap();
            cell.errors[k].map_or(f64::INFINITY, |e| e.delay_frames[0].max(e.delay_frames[1]))
        };
        assert!(worst(Algorithm::F2O1) < 0.02 && worst(Algorithm::F2O2) < 0.02);
        assert!(worst(Algorithm::F2Reprojection) < 0.02 && worst(Algorithm::Joint) < 0.002);
        assert!(worst(Algorithm::F1O1) > 0.2 && worst(Algorithm::F1O2) > 0.2);
        assert!(cell.misfit_px[1] < 0.05 && cell.misfit_px[0] > 1.0);
    }
}
