//! From the estimate to what is published: covariance of everything, condition, observability, warnings.

use nalgebra::{DMatrix, DVector};

use super::noise::{self, KEPT};
use super::problem::{JointProblem, JointState};
use super::solver::{Linearised, Reduced};
use super::{JointOptions, JointSolution};
use crate::calibration::{CalibrationError, PitchTracks};
use crate::flight::SolvedFlight;
use crate::flight::outcome::summarise;
use crate::flight::sighting::Sight;
use crate::scene::{
    Calibration, CalibrationMethod, CameraCalibration, Parameter, ParameterKind, Rig, WorldFrame,
};

/// A landmark this many sigmas off is named in the warnings.
const LANDMARK_SIGMAS: f64 = 4.5;

fn singular() -> CalibrationError {
    CalibrationError::NotConverged {
        stage: "covariance",
        reason: "the normal equations are singular".to_owned(),
    }
}

/// Covariance of the camera unknowns, flights marginalised out.
pub(super) fn camera_covariance(
    problem: &JointProblem,
    state: &JointState,
) -> Result<DMatrix<f64>, CalibrationError> {
    let reduced = problem.linearise(state, KEPT).reduce(0.0);
    Ok(reduced.ok_or_else(singular)?.cameras.inverse())
}

/// Calibration and flights with their uncertainty.
pub(super) fn publish(
    rig: &Rig,
    pitches: &[PitchTracks],
    problem: &JointProblem,
    state: &JointState,
) -> Result<JointSolution, CalibrationError> {
    let at = problem.linearise(state, KEPT);
    let reduced = at.reduce(0.0).ok_or_else(singular)?;
    let covariance = reduced.cameras.inverse();
    let sigmas = noise::sigmas(&covariance);
    let flights = flights(pitches, state, &at, &reduced, &covariance);
    let calibration = Calibration {
        version: 1,
        method: CalibrationMethod::Joint,
        reference: state.cameras[problem.reference].id.clone(),
        world: problem.world,
        cameras: cameras(rig, problem, state, &sigmas),
        parameters: problem
            .columns
            .iter()
            .map(|c| Parameter {
                camera: state.cameras[c.camera].id.clone(),
                kind: c.parameter(),
            })
            .collect(),
        covariance: (0..covariance.nrows())
            .map(|r| covariance.row(r).iter().copied().collect())
            .collect(),
        condition: condition(&reduced.complement),
        variance_factor: claimed_variance_factor(state),
        pitches_used: state.flights.iter().map(|f| f.pitch as u32 + 1).collect(),
        warnings: warnings(rig, problem, state, &covariance),
        cost_trace: Vec::new(),
    };
    Ok(JointSolution {
        calibration,
        flight_pitches: state.flights.iter().map(|f| f.pitch).collect(),
        flights,
        wrong_tracks: Vec::new(),
        surprise: at.cost + noise::log_determinants(state),
        cost: at.cost,
    })
}

fn flights(
    pitches: &[PitchTracks],
    state: &JointState,
    at: &Linearised,
    reduced: &Reduced,
    covariance: &DMatrix<f64>,
) -> Vec<SolvedFlight> {
    state
        .flights
        .iter()
        .zip(&at.flights)
        .zip(&reduced.flights)
        .map(|((flight, share), factor)| {
            let own = factor.inverse();
            let gain = &own * &share.ties;
            let total = own + &gain * covariance * gain.transpose();
            let tracks = pitches.get(flight.pitch).map_or(&[][..], |p| &p.tracks);
            let mut solved = summarise(&state.cameras, tracks, &flight.sightings, &flight.state, KEPT);
            solved.covariance = 0.5 * (&total + total.transpose());
            solved
        })
        .collect()
}

fn cameras(
    rig: &Rig,
    problem: &JointProblem,
    state: &JointState,
    sigmas: &DVector<f64>,
) -> Vec<CameraCalibration> {
    let mut all = Vec::with_capacity(state.cameras.len());
    for (index, camera) in state.cameras.iter().enumerate() {
        let setup = &rig.cameras[problem.rig_cameras[index]];
        let (mut points, mut square, mut own, mut claimed) = (0, 0.0, 0.0, 0usize);
        for flight in &state.flights {
            for s in flight.sightings.iter().filter(|s| s.camera == index) {
                let Ok(sight) = Sight::new(camera, &s.point, &flight.state.trajectory) else {
                    continue;
                };
                if KEPT.apply(sight.distance2).1 > 0.5 {
                    points += 1;
                    square += sight.residual_px.norm_squared();
                    if let Some(c) = s.point.covariance_px2 {
                        own += 0.5 * c.trace() * camera.noise.variance_factor;
                        claimed += 1;
                    }
                }
            }
        }
        let noise_sigma_px = if claimed > 0 {
            (own / claimed as f64).sqrt()
        } else {
            camera.noise.sigma_px
        };
        let delay_sigma = column_sigma(problem, sigmas, index, ParameterKind::CaptureDelay);
        all.push(CameraCalibration {
            id: camera.id.clone(),
            camera_from_world: camera.pose,
            capture_delay_s: camera.timing.capture_delay_s,
            capture_delay_sigma_s: delay_sigma.unwrap_or(0.0),
            clock_skew_ppm: camera.timing.clock_skew_ppm,
            skew_epoch_ns: camera.timing.skew_epoch_ns,
            network_clock: false,
            readout_s: camera.timing.readout_s,
            intrinsics: camera.intrinsics,
            width_px: setup.width_px,
            height_px: setup.height_px,
            reprojection_rms_px: (square / f64::from(points.max(1))).sqrt(),
            points: points as usize,
            noise_sigma_px,
            jitter_sigma_s: camera.noise.jitter_s,
        });
    }
    all
}

fn column_sigma(
    problem: &JointProblem,
    sigmas: &DVector<f64>,
    camera: usize,
    parameter: ParameterKind,
) -> Option<f64> {
    let at = problem
        .columns
        .iter()
        .position(|c| c.camera == camera && c.parameter() == parameter)?;
    sigmas.get(at).copied()
}

/// Refuses a solution that leaves a delay open.
///
/// # Errors
/// [`CalibrationError::NotEnoughParallax`] with the camera, its parallax and the delay's sigma.
pub fn check_delays(
    rig: &Rig,
    solution: &JointSolution,
    options: &JointOptions,
) -> Result<(), CalibrationError> {
    let calibration = &solution.calibration;
    for camera in &calibration.cameras {
        let rate = rig.camera(&camera.id).map_or(1.0, |c| c.frame_rate_hz);
        let sigma_frames = camera.capture_delay_sigma_s * rate;
        // Also refuses NaN.
        if !(sigma_frames < options.delay_sigma_frames_max) {
            return Err(CalibrationError::NotEnoughParallax {
                camera: camera.id.clone(),
                parallax_deg: parallax_deg(solution, camera),
                sigma_frames,
            });
        }
    }
    Ok(())
}

/// Median angle at the ball between a camera and the reference, degrees.
fn parallax_deg(solution: &JointSolution, camera: &CameraCalibration) -> f64 {
    let calibration = &solution.calibration;
    let Some(reference) = calibration.camera(&calibration.reference) else {
        return 0.0;
    };
    let centres = [camera, reference].map(|c| c.camera_from_world.centre_m());
    let mut angles: Vec<f64> = solution
        .flights
        .iter()
        .flat_map(|f| {
            let (begin, end) = f.observed_s;
            (0..10).map(move |i| {
                f.trajectory
                    .position_m(begin + (end - begin) * f64::from(i) / 9.0)
            })
        })
        .map(|ball| (ball - centres[0]).angle(&(ball - centres[1])).to_degrees())
        .collect();
    angles.sort_by(f64::total_cmp);
    angles.get(angles.len() / 2).copied().unwrap_or(0.0)
}

/// Condition of the matrix scaled to a unit diagonal.
fn condition(complement: &DMatrix<f64>) -> f64 {
    let scale = complement.diagonal().map(|d| 1.0 / d.max(1e-300).sqrt());
    let scaled = DMatrix::from_fn(complement.nrows(), complement.ncols(), |r, c| {
        complement[(r, c)] * scale[r] * scale[c]
    });
    let values = scaled.symmetric_eigenvalues();
    values.max() / values.min().max(1e-300)
}

/// Mean factor by which the residuals exceed the variance the points claim.
fn claimed_variance_factor(state: &JointState) -> f64 {
    let total: f64 = state.cameras.iter().map(|c| c.noise.variance_factor).sum();
    total / state.cameras.len().max(1) as f64
}

/// Relative 1σ of the longest distance between the reference and another camera: how well the scale is known.
fn scale_sigma(problem: &JointProblem, state: &JointState, covariance: &DMatrix<f64>) -> f64 {
    let origin = state.cameras[problem.reference].pose.centre_m();
    let far = state
        .cameras
        .iter()
        .enumerate()
        .map(|(i, c)| (i, c.pose.centre_m() - origin));
    let Some((camera, baseline)) = far.max_by(|a, b| a.1.norm().total_cmp(&b.1.norm())) else {
        return f64::INFINITY;
    };
    let first = problem
        .columns
        .iter()
        .position(|c| c.camera == camera && c.parameter() == ParameterKind::TranslationX);
    let Some(first) = first.filter(|_| baseline.norm() > 0.0) else {
        return f64::INFINITY;
    };
    // The centre moves by −Rᵀ·υ; the reference camera's is held.
    let own = covariance.fixed_view::<3, 3>(first, first);
    let along = state.cameras[camera].pose.rotation * baseline.normalize();
    along.dot(&(own * along)).max(0.0).sqrt() / baseline.norm()
}

fn warnings(rig: &Rig, problem: &JointProblem, state: &JointState, covariance: &DMatrix<f64>) -> Vec<String> {
    let mut all: Vec<String> = problem
        .terms
        .misfits(&state.cameras, LANDMARK_SIGMAS)
        .iter()
        .map(|m| {
            format!(
                "landmark {} in camera {} is {:.1} px ({:.1} sigmas) off and was left out",
                m.name, state.cameras[m.camera].id, m.residual_px, m.sigmas
            )
        })
        .collect();
    for (index, setup) in rig.cameras.iter().enumerate() {
        if !problem.rig_cameras.contains(&index) {
            all.push(format!("camera {} could not be placed and is left out", setup.id));
        }
    }
    if problem.world == WorldFrame::ReferenceCamera && !problem.terms.fix_scale() {
        all.push(format!(
            "the scale rests on gravity and drag: 1σ {:.0} %",
            100.0 * scale_sigma(problem, state, covariance)
        ));
    }
    all
}
