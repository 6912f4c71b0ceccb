//! The Cramér–Rao bound of a scene: what no unbiased estimator of delays, poses and flights can beat.
//!
//! Flights are the physics itself here (release state, Cd, lift vector; RK4), not the estimator's polynomial,
//! and derivatives by them are central differences: an oracle that shares little with what it judges.

use nalgebra::{Cholesky, DMatrix, DVector, Point3, SMatrix, Vector3};

use super::JointOptions;
use super::noise::KEPT;
use super::problem::{Column, FlightUnknown, JointProblem, JointState};
use crate::calibration::{CalibrationError, InitialEstimate, PitchTracks};
use crate::flight::sighting::{CameraNoise, Sight};
use crate::flight::{Aerodynamics, Physics};
use crate::scene::{CameraId, ParameterKind, Rig};

/// Release state (6), Cd, w (3).
const UNKNOWNS: usize = 10;
/// Central difference of each: metres, m/s, 1, 1.
const STEPS: [f64; UNKNOWNS] = [1e-3, 1e-3, 1e-3, 1e-2, 1e-2, 1e-2, 1e-3, 1e-3, 1e-3, 1e-3];
/// Step of the integration, seconds.
const ARC_STEP_S: f64 = 0.004;

/// What the bound is stated for.
#[derive(Debug, Clone, PartialEq)]
pub struct BoundOptions {
    /// The problem's priors.
    pub joint: JointOptions,
    /// Noise of the points per rig camera.
    pub noise: Vec<CameraNoise>,
    /// Whether every clock is known to run true.
    pub clocks: Clocks,
    /// Planes y = const at which plate positions are stated, metres.
    pub plate_y_m: [f64; 2],
    /// Plane at which the speed is stated, metres.
    pub release_y_m: f64,
}

/// What is known of the cameras' clock rates.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Clocks {
    /// Equal.
    Steady,
    /// Unknown, with the problem's prior.
    Drifting,
}

/// Bounds of one camera.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraBound {
    /// Name.
    pub camera: CameraId,
    /// 1σ of τ, seconds; 0 for the reference.
    pub delay_sigma_s: f64,
    /// 1σ of the skew, ppm; 0 where it is known.
    pub skew_sigma_ppm: f64,
    /// 1σ of the centre per axis, metres.
    pub centre_sigma_m: [f64; 3],
}

/// Bounds of one pitch.
#[derive(Debug, Clone, PartialEq)]
pub struct PitchBound {
    /// Index among the pitches given.
    pub pitch: usize,
    /// 1σ of x and z at each of the planes asked for, metres; `None` where the ball does not get there.
    pub plate_sigma_m: [Option<[f64; 2]>; 2],
    /// 1σ of the speed at the release plane, m/s.
    pub release_speed_sigma_mps: Option<f64>,
}

/// The bound of a scene.
#[derive(Debug, Clone, PartialEq)]
pub struct Bound {
    /// Cameras placed.
    pub cameras: Vec<CameraBound>,
    /// Pitches that two cameras see.
    pub pitches: Vec<PitchBound>,
}

/// The bound at the true cameras, from the very points given (their times, weights and which of them fit).
///
/// # Errors
/// [`CalibrationError`] where the problem cannot be set up or its information is singular.
pub fn bound(
    rig: &Rig,
    pitches: &[PitchTracks],
    truth: &InitialEstimate,
    options: &BoundOptions,
) -> Result<Bound, CalibrationError> {
    let (mut problem, mut state) = JointProblem::new(rig, pitches, truth, &options.joint)?;
    for (index, camera) in state.cameras.iter_mut().enumerate() {
        if let Some(noise) = options.noise.get(problem.rig_cameras[index]) {
            camera.noise = *noise;
        }
        if options.clocks == Clocks::Steady {
            problem.fix(index, ParameterKind::ClockSkew);
        }
    }
    let terms = problem.terms.equations(&state.cameras, &problem.columns, KEPT);
    let mut information = terms.hessian;
    let mut shares = Vec::with_capacity(state.flights.len());
    let JointState { cameras, flights } = &mut state;
    for flight in flights {
        flight
            .state
            .settle(cameras, &flight.sightings)
            .map_err(|e| CalibrationError::NotConverged {
                stage: "bound",
                reason: e.to_string(),
            })?;
    }
    for flight in &state.flights {
        let share = Share::new(&problem.columns, &state, flight)?;
        information += &share.cameras - share.ties.tr_mul(&(&share.inverse * &share.ties));
        shares.push(share);
    }
    let covariance = Cholesky::new(information)
        .ok_or(CalibrationError::NotConverged {
            stage: "bound",
            reason: "the information matrix is singular".to_owned(),
        })?
        .inverse();
    Ok(Bound {
        cameras: camera_bounds(&problem, &state, &covariance),
        pitches: shares
            .iter()
            .map(|s| s.pitch_bound(&covariance, options))
            .collect(),
    })
}

fn camera_bounds(problem: &JointProblem, state: &JointState, covariance: &DMatrix<f64>) -> Vec<CameraBound> {
    let mut all = Vec::with_capacity(state.cameras.len());
    for (index, camera) in state.cameras.iter().enumerate() {
        let at = |parameter: ParameterKind| {
            problem
                .columns
                .iter()
                .position(|c| c.camera == index && c.parameter() == parameter)
        };
        let sigma = |parameter| at(parameter).map_or(0.0, |i| covariance[(i, i)].max(0.0).sqrt());
        let mut centre_sigma_m = [0.0; 3];
        if let Some(first) = at(ParameterKind::TranslationX) {
            // The centre moves by −Rᵀ·υ.
            let r = camera.pose.rotation.matrix().transpose();
            let own = covariance.view((first, first), (3, 3));
            let centre = r * own * r.transpose();
            centre_sigma_m = std::array::from_fn(|k| centre[(k, k)].max(0.0).sqrt());
        }
        all.push(CameraBound {
            camera: camera.id.clone(),
            delay_sigma_s: sigma(ParameterKind::CaptureDelay),
            skew_sigma_ppm: sigma(ParameterKind::ClockSkew),
            centre_sigma_m,
        });
    }
    all
}

/// A flight by the physics: positions and velocities on a grid of times about its middle.
struct Arc {
    begin_s: f64,
    samples: Vec<(Point3<f64>, Vector3<f64>)>,
}

/// State and forces of a flight at one instant.
#[derive(Clone, Copy)]
struct Launch {
    time_s: f64,
    position_m: Point3<f64>,
    velocity_mps: Vector3<f64>,
    aerodynamics: Aerodynamics,
}

impl Launch {
    fn moved(mut self, unknown: usize, step: f64) -> Self {
        match unknown {
            k @ 0..=2 => self.position_m[k] += step,
            k @ 3..=5 => self.velocity_mps[k - 3] += step,
            6 => self.aerodynamics.drag_coefficient += step,
            k => self.aerodynamics.lift[(k - 7).min(2)] += step,
        }
        self
    }

    fn steps(&self, physics: &Physics, h: f64, count: usize) -> Vec<(Point3<f64>, Vector3<f64>)> {
        let law = |t: f64, v: &Vector3<f64>| physics.acceleration(v, &self.aerodynamics, t).value;
        let (mut r, mut v) = (self.position_m, self.velocity_mps);
        let mut all = Vec::with_capacity(count);
        for i in 0..count {
            let t = i as f64 * h;
            let a1 = law(t, &v);
            let v2 = v + 0.5 * h * a1;
            let a2 = law(t + 0.5 * h, &v2);
            let v3 = v + 0.5 * h * a2;
            let a3 = law(t + 0.5 * h, &v3);
            let v4 = v + h * a3;
            let a4 = law(t + h, &v4);
            r += h / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4);
            v += h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4);
            all.push((r, v));
        }
        all
    }

    fn fly(&self, physics: &Physics, (begin_s, end_s): (f64, f64)) -> Arc {
        let before = ((self.time_s - begin_s) / ARC_STEP_S).ceil().max(1.0) as usize;
        let after = ((end_s - self.time_s) / ARC_STEP_S).ceil().max(1.0) as usize;
        let mut samples = self.steps(physics, -ARC_STEP_S, before);
        samples.reverse();
        samples.push((self.position_m, self.velocity_mps));
        samples.extend(self.steps(physics, ARC_STEP_S, after));
        Arc {
            begin_s: self.time_s - before as f64 * ARC_STEP_S,
            samples,
        }
    }
}

impl Arc {
    /// Cubic Hermite between the samples (good to a nanometre at 4 ms).
    fn at(&self, t_s: f64) -> (Point3<f64>, Vector3<f64>) {
        let place = ((t_s - self.begin_s) / ARC_STEP_S).clamp(0.0, (self.samples.len() - 2) as f64);
        let i = place.floor() as usize;
        let ((a, va), (b, vb)) = (self.samples[i], self.samples[i + 1]);
        let u = (t_s - self.begin_s) / ARC_STEP_S - i as f64;
        let (h, u2, u3) = (ARC_STEP_S, u * u, u * u * u);
        let position = (2.0 * u3 - 3.0 * u2 + 1.0) * a.coords
            + (u3 - 2.0 * u2 + u) * h * va
            + (3.0 * u2 - 2.0 * u3) * b.coords
            + (u3 - u2) * h * vb;
        let velocity =
            (6.0 * u2 - 6.0 * u) / h * (a - b) + (3.0 * u2 - 4.0 * u + 1.0) * va + (3.0 * u2 - 2.0 * u) * vb;
        (Point3::from(position), velocity)
    }
}

/// One flight's information and its ties to the cameras.
struct Share {
    pitch: usize,
    middle: Arc,
    either: Vec<(Arc, Arc)>,
    span_s: (f64, f64),
    /// Of the flight's unknowns, the cameras held.
    inverse: DMatrix<f64>,
    ties: DMatrix<f64>,
    cameras: DMatrix<f64>,
}

impl Share {
    fn new(columns: &[Column], state: &JointState, flight: &FlightUnknown) -> Result<Self, CalibrationError> {
        let path = &flight.state.trajectory;
        let span_s = path.span_s();
        let time_s = 0.5 * (span_s.0 + span_s.1);
        let launch = Launch {
            time_s,
            position_m: path.position_m(time_s),
            velocity_mps: path.velocity_mps(time_s),
            aerodynamics: path.aerodynamics(),
        };
        let fly = |l: Launch| l.fly(path.physics(), span_s);
        let mut share = Self {
            pitch: flight.pitch,
            middle: fly(launch),
            either: (0..UNKNOWNS)
                .map(|k| (fly(launch.moved(k, STEPS[k])), fly(launch.moved(k, -STEPS[k]))))
                .collect(),
            span_s,
            inverse: DMatrix::zeros(UNKNOWNS, UNKNOWNS),
            ties: DMatrix::zeros(UNKNOWNS, columns.len()),
            cameras: DMatrix::zeros(columns.len(), columns.len()),
        };
        let prior = &flight.state.prior;
        let mut own = DMatrix::zeros(UNKNOWNS, UNKNOWNS);
        own[(6, 6)] = prior.drag_sigma.powi(-2);
        for k in 7..UNKNOWNS {
            own[(k, k)] = prior.lift_sigma.powi(-2);
        }
        for s in &flight.sightings {
            let camera = &state.cameras[s.camera];
            let Ok(sight) = Sight::new(camera, &s.point, path) else {
                continue;
            };
            if KEPT.apply(sight.distance2).1 < 0.5 {
                continue;
            }
            let t = camera
                .timing
                .true_seconds(s.point.stamped, s.point.pixel.y, path.epoch_ns());
            let by_flight = sight.by_position * share.position_rows(t);
            let by_camera = sight.by_camera(camera, &s.point);
            let mut by_columns = DMatrix::zeros(2, columns.len());
            for (i, column) in columns.iter().enumerate() {
                if column.camera == s.camera {
                    by_columns.set_column(i, &by_camera.column(column.kind));
                }
            }
            let left = by_flight.transpose() * sight.information;
            own += left * by_flight;
            share.ties += left * &by_columns;
            share.cameras += by_columns.transpose() * sight.information * &by_columns;
        }
        share.inverse = Cholesky::new(own)
            .ok_or(CalibrationError::NotConverged {
                stage: "bound",
                reason: format!("pitch {} is not fixed by its points", flight.pitch + 1),
            })?
            .inverse();
        Ok(share)
    }

    /// ∂position/∂(unknowns) at a time.
    fn position_rows(&self, t_s: f64) -> SMatrix<f64, 3, UNKNOWNS> {
        self.rows(t_s, |(r, _)| r.coords)
    }

    fn rows(
        &self,
        t_s: f64,
        part: impl Fn((Point3<f64>, Vector3<f64>)) -> Vector3<f64>,
    ) -> SMatrix<f64, 3, UNKNOWNS> {
        let mut rows = SMatrix::<f64, 3, UNKNOWNS>::zeros();
        for (k, (plus, minus)) in self.either.iter().enumerate() {
            let change = (part(plus.at(t_s)) - part(minus.at(t_s))) / (2.0 * STEPS[k]);
            rows.set_column(k, &change);
        }
        rows
    }

    fn crossing_s(&self, y_m: f64) -> Option<f64> {
        let (mut low, mut high) = self.span_s;
        let y = |t: f64| self.middle.at(t).0.y;
        if !(y(low) > y_m && y(high) < y_m) {
            return None;
        }
        for _ in 0..60 {
            let t = 0.5 * (low + high);
            if y(t) > y_m { low = t } else { high = t }
        }
        Some(0.5 * (low + high))
    }

    fn pitch_bound(&self, cameras: &DMatrix<f64>, options: &BoundOptions) -> PitchBound {
        let gain = &self.inverse * &self.ties;
        let covariance = &self.inverse + &gain * cameras * gain.transpose();
        let sigma = |row: DVector<f64>| (row.transpose() * &covariance * &row)[0].max(0.0).sqrt();
        let plate = |y_m: f64| {
            let t = self.crossing_s(y_m)?;
            let (_, v) = self.middle.at(t);
            let rows = self.position_rows(t);
            let at = |axis: usize| {
                let row = rows.row(axis) - v[axis] / v.y * rows.row(1);
                sigma(DVector::from_iterator(UNKNOWNS, row.iter().copied()))
            };
            Some([at(0), at(2)])
        };
        let speed = || {
            let t = self.crossing_s(options.release_y_m)?;
            let (_, v) = self.middle.at(t);
            let before = self.middle.at(t - 1e-3).1.norm();
            let rate = (v.norm() - before) / 1e-3;
            let rows = self.rows(t, |(_, v)| v);
            let positions = self.position_rows(t);
            let row = v.normalize().transpose() * rows - rate / v.y * positions.row(1);
            Some(sigma(DVector::from_iterator(UNKNOWNS, row.iter().copied())))
        };
        PitchBound {
            pitch: self.pitch,
            plate_sigma_m: options.plate_y_m.map(plate),
            release_speed_sigma_mps: speed(),
        }
    }
}
