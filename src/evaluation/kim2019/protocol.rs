//! The shape of the paper's real experiment on simulated data [Kim19 §IV-B]: two cameras below one dugout roof,
//! 2048×1024 at 175 fps, six pitches, four delays, four trials.

use nalgebra::Point3;

use crate::calibration::association::group_pitches;
use crate::calibration::joint;
use crate::calibration::kim2019::reconstruction::{Problem, Reconstruction};
use crate::calibration::kim2019::search::{Optimizer, least};
use crate::calibration::kim2019::trajectory::{StrayPoints, TrajectoryModel};
use crate::calibration::kim2019::{Cost, Kim2019Options, as_start, optimise, prepare};
use crate::calibration::recipe::{CalibrationOptions, calibrate};
use crate::calibration::{InitialEstimate, PitchTracks};
use crate::evaluation::efficiency::scene_bound;
use crate::geometry::Pose;
use crate::scene::Calibration;
use crate::simulation::{
    CameraSpec, DetectionNoise, Scenario, Simulated, SimulationError, simulate_tracks, stock_camera,
    stock_pitches,
};

/// Frame rate, Hz.
const RATE_HZ: f64 = 175.0;
/// Pitches of a trial.
const PITCHES: usize = 6;

/// What the trials are made of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProtocolOptions {
    /// Trials per delay.
    pub trials: usize,
    /// 1σ of a detected centre per axis, pixels.
    pub detection_sigma_px: f64,
    /// 1σ of the stamps, frames.
    pub jitter_frames: f64,
}

/// How one method did in one trial.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Score {
    /// |τ − τ*|, frames.
    pub delay_frames: f64,
    /// Mean reprojection error of x* (F2's, or F1's for F1) at the method's poses and delay, pixels.
    pub reprojection_px: f64,
    /// Mean 3-D distance to the true flights after the best similarity, centimetres.
    pub distance_cm: f64,
}

/// One trial.
#[derive(Debug, Clone)]
pub struct Trial {
    /// τ2, frames.
    pub delay_frames: f64,
    /// Its number.
    pub trial: usize,
    /// F1, F2, synchronised (F2 at the true delay), joint without and with landmarks; `None`: failed.
    pub scores: [Option<Score>; 5],
    /// Cramér–Rao bound of the delay without and with landmarks, 1σ in frames.
    pub bound_frames: [Option<f64>; 2],
}

/// Names of [`Trial::scores`].
pub const METHODS: [&str; 5] = ["F1", "F2", "synchronised", "joint", "joint + landmarks"];

fn cameras(delay_frames: f64, jitter_s: f64) -> Vec<CameraSpec> {
    // Below the first-base dugout's roof, seven metres apart.
    let places = [("camera1", [19.2, 1.5, 2.7]), ("camera2", [18.2, 8.5, 2.7])];
    let made = places
        .iter()
        .filter_map(|(id, at)| stock_camera(id, *at, [0.0, 8.5, 1.0], 1750.0).ok());
    made.zip([0.0, delay_frames])
        .map(|(camera, delay)| CameraSpec {
            jitter_s,
            ..camera.with_delay_frames(delay)
        })
        .collect()
}

/// Runs one trial with every method.
///
/// # Errors
/// A scenario that cannot be simulated.
pub fn run(delay_frames: f64, trial: usize, options: &ProtocolOptions) -> Result<Trial, SimulationError> {
    let seed = 1000 * trial as u64 + (100.0 * delay_frames).round() as u64;
    let jitter_s = options.jitter_frames / RATE_HZ;
    let mut scenario = Scenario::new(cameras(delay_frames, jitter_s), stock_pitches(PITCHES))
        .with_seed(seed)
        .with_detection(DetectionNoise::gaussian(options.detection_sigma_px));
    let clicked = simulate_tracks(&scenario)?;
    let with_landmarks = scene_bound(&scenario).ok();
    scenario = scenario.without_landmarks();
    let blind = simulate_tracks(&scenario)?;
    let without_landmarks = scene_bound(&scenario).ok();
    let bound = |b: Option<(_, crate::calibration::joint::Bound)>| {
        b.and_then(|(_, b)| b.cameras.get(1).map(|c| c.delay_sigma_s * RATE_HZ))
    };
    let mut scores = [None; 5];
    let pitches = group_pitches(&blind.rig, &blind.tracks);
    let nothing = nothing(&blind);
    let mut start = None;
    for (k, model) in [TrajectoryModel::Quadratic, TrajectoryModel::PAPER]
        .into_iter()
        .enumerate()
    {
        let Ok(problem) = prepare(&blind.rig, &pitches, &nothing, &kim_options(model)) else {
            continue;
        };
        let trace = optimise(
            &problem,
            &[RATE_HZ],
            &[0.0],
            (&kim_options(model), &Cost::Reprojection),
        );
        let Some((best, _)) = least(&trace) else {
            continue;
        };
        let truth = true_points(&blind, &pitches, &problem);
        let at = |frames: f64| problem.reconstruct_frames(&[frames], &[RATE_HZ]).ok().flatten();
        if let Some(found) = at(best[0]) {
            scores[k] = score(&problem, &found, &truth, (best[0] - delay_frames).abs());
            if model == TrajectoryModel::PAPER {
                scores[2] = at(delay_frames).and_then(|f| score(&problem, &f, &truth, 0.0));
                let delay_s = best[0] / RATE_HZ;
                start = Some(as_start(&blind.rig, &pitches, (&problem, &found), &[delay_s]));
            }
        }
        if let Some(start) = &start {
            scores[3] = joint::refine(&blind.rig, &pitches, start, &super::cells::joint_options())
                .ok()
                .and_then(|s| calibrated(&problem, &s.calibration, &truth, delay_frames));
            scores[4] = calibrate(&clicked.rig, &clicked.tracks, &CalibrationOptions::default())
                .ok()
                .and_then(|o| calibrated(&problem, &o.calibration, &truth, delay_frames));
        }
    }
    Ok(Trial {
        delay_frames,
        trial,
        scores,
        bound_frames: [bound(without_landmarks), bound(with_landmarks)],
    })
}

fn kim_options(trajectory: TrajectoryModel) -> Kim2019Options {
    Kim2019Options {
        trajectory,
        optimizer: Optimizer::NelderMead,
        stray: StrayPoints::Keep,
        stride: 3,
        margin_frames: 3.0,
        samples: 2,
        sigma_px: 0.5,
        ..Kim2019Options::default()
    }
}

fn nothing(simulated: &Simulated) -> InitialEstimate {
    InitialEstimate {
        skew_epoch_ns: vec![simulated.truth.epoch_ns; simulated.rig.cameras.len()],
        ..super::cells::nothing(&simulated.rig)
    }
}

/// True positions at the problem's instants.
fn true_points(simulated: &Simulated, pitches: &[PitchTracks], problem: &Problem) -> Vec<Point3<f64>> {
    let stamps = pitches.iter().flat_map(|p| &p.tracks).filter_map(|t| t.span());
    let epoch_ns = stamps.map(|(a, _)| a.nanos()).min().unwrap_or(0);
    let shift_s = (epoch_ns - simulated.truth.epoch_ns) as f64 / 1e9;
    problem
        .instants
        .iter()
        .filter_map(|i| {
            let at_s = i.time_s + shift_s;
            let ball = simulated.truth.balls.iter().find(|b| {
                let (from, to) = b.span_s();
                (from - 0.05..=to + 0.05).contains(&at_s)
            });
            Some(ball?.position_m(at_s))
        })
        .collect()
}

fn score(
    problem: &Problem,
    found: &Reconstruction,
    truth: &[Point3<f64>],
    delay_frames: f64,
) -> Option<Score> {
    let distance_cm = 100.0 * problem.distance(found, truth)?;
    Some(Score {
        delay_frames,
        reprojection_px: found.reprojection_px,
        distance_cm,
    })
}

/// A published calibration by the same measures.
fn calibrated(
    problem: &Problem,
    calibration: &Calibration,
    truth: &[Point3<f64>],
    delay_frames: f64,
) -> Option<Score> {
    let poses: Vec<Option<Pose>> = ["camera1", "camera2"]
        .iter()
        .map(|id| {
            calibration
                .cameras
                .iter()
                .find(|c| c.id.as_str() == *id)
                .map(|c| c.camera_from_world)
        })
        .collect();
    let camera = calibration.cameras.iter().find(|c| c.id.as_str() == "camera2")?;
    let found = problem.at_poses(poses, &[camera.capture_delay_s]);
    score(
        problem,
        &found,
        truth,
        (camera.capture_delay_s * RATE_HZ - delay_frames).abs(),
    )
}
