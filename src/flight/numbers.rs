//! The numbers of a pitch, each with its 1σ, from a solved trajectory and the covariance of its parameters.
//!
//! A number stated at a plane `y = const` moves with the crossing time: ∂q/∂p is taken at fixed time plus
//! `dq/dt · ∂t/∂p`, with `∂t/∂p = −(∂y/∂p)/v_y`.

use nalgebra::{DMatrix, DVector, Matrix2, SMatrix, Vector3};

use super::nine_parameter::{FOOT_M, Movement, NineParameter};
use super::trajectory::{BasisRow, FLIGHT_PARAMETERS, TERMS, Trajectory};

/// y of the front of the plate, metres (17/12 ft).
pub const PLATE_FRONT_Y_M: f64 = 17.0 / 12.0 * FOOT_M;
/// y of the middle of the plate, metres (8.5/12 ft).
pub const PLATE_MIDDLE_Y_M: f64 = 8.5 / 12.0 * FOOT_M;
/// y at which release is stated for comparison, metres (54.5 ft).
pub const RELEASE_Y_M: f64 = 54.5 * FOOT_M;

/// Why a trajectory has no pitch numbers.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NumbersError {
    /// It never comes to the plane.
    #[error("the flight does not cross y = {y_m:.4} m ({what})")]
    NoCrossing {
        /// Plane, metres.
        y_m: f64,
        /// Its name.
        what: &'static str,
    },
    /// It crosses, but not toward the plate.
    #[error("the ball does not fly toward the plate (vy = {vy_mps:.2} m/s at y = {y_m:.2} m)")]
    NotToThePlate {
        /// Velocity along y, m/s.
        vy_mps: f64,
        /// Plane, metres.
        y_m: f64,
    },
    /// It passes where no pitch does.
    #[error("no pitch flies {what} at x = {x_m:.2} m, z = {z_m:.2} m (y = {y_m:.2} m)")]
    OutOfTheWay {
        /// Which place.
        what: &'static str,
        /// Plane, metres.
        y_m: f64,
        /// Where, metres.
        x_m: f64,
        /// How high, metres.
        z_m: f64,
    },
    /// It was in flight before it could have been released.
    #[error("it was already in flight {y_m:.1} m from the plate: thrown from behind the mound")]
    FromBehindTheMound {
        /// First point seen, metres.
        y_m: f64,
    },
    /// Too little of the way was seen.
    #[error("only {seen_m:.1} m of its way to the plate were seen")]
    BarelySeen {
        /// Along y, metres.
        seen_m: f64,
    },
    /// The covariance does not fit the trajectory.
    #[error("covariance is {rows}×{columns}, the flight has {expected} parameters")]
    CovarianceShape {
        /// Rows.
        rows: usize,
        /// Columns.
        columns: usize,
        /// Parameters of a flight.
        expected: usize,
    },
}

/// State of the ball at a plane of constant y, with the covariance of all of it.
#[derive(Debug, Clone, PartialEq)]
pub struct PlaneState {
    /// Seconds after the trajectory's epoch.
    pub time_s: f64,
    /// Position, metres.
    pub position_m: Vector3<f64>,
    /// Velocity, m/s.
    pub velocity_mps: Vector3<f64>,
    /// Speed, m/s.
    pub speed_mps: f64,
    /// Covariance of (x, y, z, vx, vy, vz, speed, time); y is exact by construction.
    pub covariance: SMatrix<f64, 8, 8>,
}

impl PlaneState {
    /// 1σ of row `i` of the covariance's order.
    pub fn sigma(&self, i: usize) -> f64 {
        self.covariance[(i, i)].max(0.0).sqrt()
    }
    /// Covariance of (x, z), m².
    pub fn xz_covariance_m2(&self) -> Matrix2<f64> {
        let c = &self.covariance;
        Matrix2::new(c[(0, 0)], c[(0, 2)], c[(2, 0)], c[(2, 2)])
    }
}

/// The 9P view with its movement and 1σ.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NineParameterView {
    /// Parabola fitted release → plate front.
    pub nine: NineParameter,
    /// pfx, ft.
    pub movement: Movement,
    /// 1σ of pfx x, z, ft.
    pub movement_sigma_ft: [f64; 2],
}

/// Row `weights` of axis `axis` among all flight parameters.
fn spread(weights: &[f64; TERMS], axis: usize) -> DVector<f64> {
    let mut row = DVector::zeros(FLIGHT_PARAMETERS);
    for (k, w) in weights.iter().enumerate() {
        row[axis * TERMS + k] = *w;
    }
    row
}

fn check_shape(covariance: &DMatrix<f64>) -> Result<(), NumbersError> {
    let expected = FLIGHT_PARAMETERS;
    if covariance.shape() == (expected, expected) {
        return Ok(());
    }
    Err(NumbersError::CovarianceShape {
        rows: covariance.nrows(),
        columns: covariance.ncols(),
        expected,
    })
}

/// The ball where it crosses `y_m` toward the plate.
///
/// # Errors
/// [`NumbersError`] where it does not.
pub fn state_at_plane(
    trajectory: &Trajectory,
    covariance: &DMatrix<f64>,
    (y_m, what): (f64, &'static str),
) -> Result<PlaneState, NumbersError> {
    check_shape(covariance)?;
    let time_s = trajectory
        .time_at_y(y_m)
        .ok_or(NumbersError::NoCrossing { y_m, what })?;
    let basis = trajectory.basis(time_s);
    let velocity = trajectory.velocity_at(&basis);
    if velocity.y > -1.0 {
        return Err(NumbersError::NotToThePlate {
            vy_mps: velocity.y,
            y_m,
        });
    }
    let acceleration = trajectory.acceleration_mps2(time_s);
    let jacobian = plane_jacobian(&basis, &velocity, &acceleration);
    let covariance = &jacobian * covariance * jacobian.transpose();
    Ok(PlaneState {
        time_s,
        position_m: trajectory.position_at(&basis).coords,
        velocity_mps: velocity,
        speed_mps: velocity.norm(),
        covariance: SMatrix::from_fn(|r, c| covariance[(r, c)]),
    })
}

/// 8 × `FLIGHT_PARAMETERS`: rows as in [`PlaneState::covariance`].
fn plane_jacobian(basis: &BasisRow, velocity: &Vector3<f64>, acceleration: &Vector3<f64>) -> DMatrix<f64> {
    let time_row = spread(&basis.value, 1) * (-1.0 / velocity.y);
    let direction = velocity.normalize();
    let mut jacobian = DMatrix::zeros(8, FLIGHT_PARAMETERS);
    for axis in 0..3 {
        let position_row = spread(&basis.value, axis) + &time_row * velocity[axis];
        let velocity_row = spread(&basis.rate, axis) + &time_row * acceleration[axis];
        let speed_row = jacobian.row(6) + (&velocity_row * direction[axis]).transpose();
        jacobian.set_row(axis, &position_row.transpose());
        jacobian.set_row(3 + axis, &velocity_row.transpose());
        jacobian.set_row(6, &speed_row);
    }
    jacobian.set_row(7, &time_row.transpose());
    jacobian
}

/// Fits the 9P view over release → plate front and takes its movement from `release_y_m`.
///
/// # Errors
/// [`NumbersError`] where the flight does not cross both planes.
pub fn nine_parameter_view(
    trajectory: &Trajectory,
    covariance: &DMatrix<f64>,
    release_y_m: f64,
) -> Result<NineParameterView, NumbersError> {
    check_shape(covariance)?;
    let crossing = |y_m, what| {
        trajectory
            .time_at_y(y_m)
            .ok_or(NumbersError::NoCrossing { y_m, what })
    };
    let begin = crossing(release_y_m, "release")?;
    let end = crossing(PLATE_FRONT_Y_M, "front of the plate")?;
    let times: Vec<f64> = (0..=80)
        .map(|i| begin + (end - begin) * f64::from(i) / 80.0)
        .collect();
    let view = |t: &Trajectory| {
        let samples: Vec<_> = times.iter().map(|s| (*s, t.position_m(*s).coords)).collect();
        let nine = NineParameter::fit(&samples)?;
        nine.movement(release_y_m / FOOT_M).map(|m| (nine, m))
    };
    let no_fit = NumbersError::NoCrossing {
        y_m: 50.0 * FOOT_M,
        what: "50 ft",
    };
    let (nine, movement) = view(trajectory).ok_or(no_fit.clone())?;
    // Movement is a smooth function of the 27 coefficients; a central difference of 0.1 mm is exact to 1e-9 ft.
    let step = 1e-4;
    let mut jacobian = DMatrix::zeros(2, FLIGHT_PARAMETERS);
    for i in 0..3 * TERMS {
        let shifted = |sign: f64| {
            let mut parameters = trajectory.parameters().clone();
            parameters[i] += sign * step;
            view(&trajectory.with_parameters(parameters)).map(|v| v.1)
        };
        let (Some(plus), Some(minus)) = (shifted(1.0), shifted(-1.0)) else {
            return Err(no_fit);
        };
        jacobian[(0, i)] = (plus.x_ft - minus.x_ft) / (2.0 * step);
        jacobian[(1, i)] = (plus.z_ft - minus.z_ft) / (2.0 * step);
    }
    let spread = &jacobian * covariance * jacobian.transpose();
    Ok(NineParameterView {
        nine,
        movement,
        movement_sigma_ft: [spread[(0, 0)].max(0.0).sqrt(), spread[(1, 1)].max(0.0).sqrt()],
    })
}

/// Speed at a fixed time with its 1σ, m/s.
pub fn speed_at(trajectory: &Trajectory, covariance: &DMatrix<f64>, time_s: f64) -> (f64, f64) {
    let basis = trajectory.basis(time_s);
    let velocity = trajectory.velocity_at(&basis);
    let speed = velocity.norm();
    let mut row = DVector::zeros(FLIGHT_PARAMETERS);
    for axis in 0..3 {
        row += spread(&basis.rate, axis) * (velocity[axis] / speed.max(1e-9));
    }
    if check_shape(covariance).is_err() {
        return (speed, f64::NAN);
    }
    (speed, row.dot(&(covariance * &row)).max(0.0).sqrt())
}

/// 1σ per axis of the position at a fixed time, metres.
pub fn position_sigma_m(trajectory: &Trajectory, covariance: &DMatrix<f64>, time_s: f64) -> [f64; 3] {
    let basis = trajectory.basis(time_s);
    std::array::from_fn(|axis| {
        let mut variance = 0.0;
        for (i, a) in basis.value.iter().enumerate() {
            for (j, b) in basis.value.iter().enumerate() {
                variance += a
                    * b
                    * covariance
                        .get((axis * TERMS + i, axis * TERMS + j))
                        .copied()
                        .unwrap_or(0.0);
            }
        }
        variance.max(0.0).sqrt()
    })
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;

    use super::*;
    use crate::flight::{Aerodynamics, Physics};

    /// 40 m/s toward the plate from (−0.5, 17, 1.8) with constant acceleration (3, 8, −6) m/s².
    fn path() -> Trajectory {
        let samples: Vec<_> = (0..=50)
            .map(|i| {
                let t = 0.01 * f64::from(i);
                let at = |r: f64, v: f64, a: f64| r + v * t + 0.5 * a * t * t;
                (
                    t,
                    Point3::new(at(-0.5, 1.0, 3.0), at(17.0, -40.0, 8.0), at(1.8, -1.0, -6.0)),
                )
            })
            .collect();
        let aerodynamics = Aerodynamics {
            drag_coefficient: 0.35,
            lift: Vector3::zeros(),
            lift_exponent: 1.5,
        };
        Trajectory::through(Physics::default(), 0, &samples, &aerodynamics)
    }

    fn spread_out() -> DMatrix<f64> {
        DMatrix::from_diagonal(&DVector::from_fn(FLIGHT_PARAMETERS, |i, _| {
            1e-6 * (1.0 + i as f64)
        }))
    }

    #[test]
    fn the_state_at_a_plane_is_the_parabola_s() {
        let state = state_at_plane(&path(), &spread_out(), (1.0, "test")).unwrap();
        // 17 − 40·t + 4·t² = 1 → t = (40 − sqrt(1600 − 256))/8 = 0.417424...
        let t = (40.0 - (1600.0_f64 - 256.0).sqrt()) / 8.0;
        assert!((state.time_s - t).abs() < 1e-9, "{}", state.time_s);
        assert!((state.position_m.x - (-0.5 + t + 1.5 * t * t)).abs() < 1e-8);
        assert!((state.velocity_mps.z - (-1.0 - 6.0 * t)).abs() < 1e-7);
        assert!((state.position_m.y - 1.0).abs() < 1e-9);
    }

    #[test]
    fn the_covariance_at_a_plane_is_that_of_central_differences() {
        let (path, covariance) = (path(), spread_out());
        let state = state_at_plane(&path, &covariance, (1.0, "test")).unwrap();
        let mut numeric = DMatrix::zeros(8, FLIGHT_PARAMETERS);
        for i in 0..FLIGHT_PARAMETERS {
            let moved = |sign: f64| {
                let mut p = path.parameters().clone();
                p[i] += sign * 1e-5;
                let s = state_at_plane(&path.with_parameters(p), &covariance, (1.0, "test")).unwrap();
                let mut all = s.position_m.as_slice().to_vec();
                all.extend(s.velocity_mps.iter());
                all.extend([s.speed_mps, s.time_s]);
                DVector::from_vec(all)
            };
            numeric.set_column(i, &((moved(1.0) - moved(-1.0)) / 2e-5));
        }
        let expected = &numeric * &covariance * numeric.transpose();
        for r in 0..8 {
            for c in 0..8 {
                if r == 1 || c == 1 {
                    // y is exact by construction; numerically only to the crossing's 1e-13 s.
                    assert!(expected[(r, c)].abs() < 1e-9 && state.covariance[(r, c)].abs() < 1e-12);
                    continue;
                }
                let scale = (expected[(r, r)] * expected[(c, c)]).sqrt();
                let miss = (state.covariance[(r, c)] - expected[(r, c)]).abs() / scale;
                assert!(
                    miss < 1e-4,
                    "{r},{c}: {} is not {}",
                    state.covariance[(r, c)],
                    expected[(r, c)]
                );
            }
        }
    }

    #[test]
    fn a_ball_flying_away_or_never_crossing_is_refused() {
        let far = state_at_plane(&path(), &spread_out(), (-30.0, "back stop"));
        assert!(matches!(far, Err(NumbersError::NoCrossing { .. })));
        let small = state_at_plane(&path(), &DMatrix::zeros(3, 3), (1.0, "test"));
        assert!(matches!(small, Err(NumbersError::CovarianceShape { .. })));
        let samples: Vec<_> = (0..=50)
            .map(|i| 0.01 * f64::from(i))
            .map(|t| (t, Point3::new(0.0, 2.0 + 30.0 * t, 1.0)))
            .collect();
        let aerodynamics = path().aerodynamics();
        let away = Trajectory::through(Physics::default(), 0, &samples, &aerodynamics);
        let told = state_at_plane(&away, &spread_out(), (10.0, "test"));
        assert!(matches!(told, Err(NumbersError::NotToThePlate { .. })));
    }

    #[test]
    fn movement_of_a_parabola_is_its_acceleration_s() {
        let view = nine_parameter_view(&path(), &spread_out(), RELEASE_Y_M).unwrap();
        assert!((view.nine.acceleration_ftps2.x * FOOT_M - 3.0).abs() < 1e-6);
        assert!((view.nine.acceleration_ftps2.z * FOOT_M + 6.0).abs() < 1e-6);
        assert!((view.nine.position_ft.y - 50.0).abs() < 1e-9);
        assert!(view.movement_sigma_ft.iter().all(|s| *s > 0.0 && s.is_finite()));
    }
}
