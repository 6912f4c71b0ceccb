//! Normal equations of one flight: its points, its prior, and its ties to the cameras.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn, Matrix3, SMatrix, SVector};

use super::sighting::{CAMERA_COLUMNS, CameraModel, Sight};
use super::trajectory::{DRAG_ROW, FLIGHT_PARAMETERS, FlightPrior, LIFT_ROW, NODES, TERMS, Trajectory};
use crate::scene::TrackPoint;

/// A point of a flight and the camera that saw it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sighting {
    /// Index of the camera among the models.
    pub camera: usize,
    /// Index of the track among the pitch's tracks.
    pub track: usize,
    /// The point.
    pub point: TrackPoint,
}

/// What a squared distance in units of sigma costs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Loss {
    /// s²·ln(1 + d²/s²).
    Cauchy {
        /// s, in sigmas.
        scale: f64,
    },
    /// min(d², limit²): a point is in or out.
    Truncated {
        /// In sigmas.
        limit: f64,
    },
}

impl Loss {
    /// Cost and its derivative by d² (the weight).
    pub fn apply(self, distance2: f64) -> (f64, f64) {
        match self {
            Self::Cauchy { scale } => {
                let s2 = scale * scale;
                (s2 * (distance2 / s2).ln_1p(), 1.0 / (1.0 + distance2 / s2))
            }
            Self::Truncated { limit } => {
                let limit2 = limit * limit;
                if distance2 < limit2 {
                    (distance2, 1.0)
                } else {
                    (limit2, 0.0)
                }
            }
        }
    }

    /// Cost of a point that cannot be seen at all (behind the camera).
    fn unseen(self) -> f64 {
        self.apply(1e8).0
    }
}

/// Ties of one camera to a flight.
#[derive(Debug, Clone)]
pub struct CameraBlock {
    /// JᵀWJ of the camera's unknowns.
    pub hessian: SMatrix<f64, CAMERA_COLUMNS, CAMERA_COLUMNS>,
    /// JᵀWr.
    pub gradient: SVector<f64, CAMERA_COLUMNS>,
    /// Camera rows, flight columns.
    pub cross: DMatrix<f64>,
}

/// Normal equations of a flight. Costs are sums of squares, without the half.
#[derive(Debug, Clone)]
pub struct FlightEquations {
    /// Flight block.
    pub hessian: DMatrix<f64>,
    /// Half the cost's gradient.
    pub gradient: DVector<f64>,
    /// Robust cost of the points.
    pub data_cost: f64,
    /// Cost of the prior.
    pub prior_cost: f64,
    /// Per camera model; empty when only the flight was asked for.
    pub cameras: Vec<CameraBlock>,
}

/// Robust cost of points and prior, without derivatives.
pub fn flight_cost(
    cameras: &[CameraModel],
    trajectory: &Trajectory,
    sightings: &[Sighting],
    loss: Loss,
    prior: &FlightPrior,
) -> f64 {
    let data: f64 = sightings
        .iter()
        .map(|s| match Sight::new(&cameras[s.camera], &s.point, trajectory) {
            Ok(sight) => loss.apply(sight.distance2).0,
            Err(_) => loss.unseen(),
        })
        .sum();
    data + prior_cost(trajectory, prior)
}

fn prior_cost(trajectory: &Trajectory, prior: &FlightPrior) -> f64 {
    let aero = trajectory.aerodynamics();
    let nodes = trajectory.physics_residuals(prior.acceleration_sigma_mps2);
    let raw = SMatrix::<f64, NODES, 3>::from_fn(|node, axis| nodes[node].residual[axis]);
    (trajectory.node_whitening() * raw).norm_squared()
        + ((aero.drag_coefficient - prior.drag_coefficient) / prior.drag_sigma).powi(2)
        + aero.lift.norm_squared() / (prior.lift_sigma * prior.lift_sigma)
}

/// L⁻¹ ⊗ I₃ on node-major rows, from the last node up, in place.
fn whiten(whitening: &SMatrix<f64, NODES, NODES>, rows: &mut [f64]) {
    for node in (0..NODES).rev() {
        for axis in 0..3 {
            rows[3 * node + axis] = (0..=node)
                .map(|earlier| whitening[(node, earlier)] * rows[3 * earlier + axis])
                .sum();
        }
    }
}

impl FlightEquations {
    /// Linearises the points alone; `with_prior` completes it.
    pub fn of_points(
        cameras: &[CameraModel],
        trajectory: &Trajectory,
        sightings: &[Sighting],
        loss: Loss,
    ) -> Self {
        let mut equations = Self::empty();
        equations.add_points(cameras, trajectory, sightings, loss);
        equations
    }

    /// The same points under a prior.
    pub fn with_prior(&self, trajectory: &Trajectory, prior: &FlightPrior) -> Self {
        let mut equations = self.clone();
        equations.add_prior(trajectory, prior);
        equations
    }

    /// Linearises points and prior at a trajectory.
    pub fn new(
        cameras: &[CameraModel],
        trajectory: &Trajectory,
        sightings: &[Sighting],
        loss: Loss,
        prior: &FlightPrior,
    ) -> Self {
        let mut equations = Self::empty();
        equations.add_points(cameras, trajectory, sightings, loss);
        equations.add_prior(trajectory, prior);
        equations
    }

    /// The same with the cameras' blocks.
    pub fn with_cameras(
        cameras: &[CameraModel],
        trajectory: &Trajectory,
        sightings: &[Sighting],
        loss: Loss,
        prior: &FlightPrior,
    ) -> Self {
        let mut equations = Self::empty();
        equations.cameras = vec![
            CameraBlock {
                hessian: SMatrix::zeros(),
                gradient: SVector::zeros(),
                cross: DMatrix::zeros(CAMERA_COLUMNS, FLIGHT_PARAMETERS),
            };
            cameras.len()
        ];
        equations.add_points(cameras, trajectory, sightings, loss);
        equations.add_prior(trajectory, prior);
        equations
    }

    fn empty() -> Self {
        Self {
            hessian: DMatrix::zeros(FLIGHT_PARAMETERS, FLIGHT_PARAMETERS),
            gradient: DVector::zeros(FLIGHT_PARAMETERS),
            data_cost: 0.0,
            prior_cost: 0.0,
            cameras: Vec::new(),
        }
    }

    /// Cost of points and prior.
    pub fn cost(&self) -> f64 {
        self.data_cost + self.prior_cost
    }

    fn add_points(
        &mut self,
        cameras: &[CameraModel],
        trajectory: &Trajectory,
        sightings: &[Sighting],
        loss: Loss,
    ) {
        for s in sightings {
            let camera = &cameras[s.camera];
            let Ok(sight) = Sight::new(camera, &s.point, trajectory) else {
                self.data_cost += loss.unseen();
                continue;
            };
            let (cost, weight) = loss.apply(sight.distance2);
            self.data_cost += cost;
            if weight <= 0.0 {
                continue;
            }
            let weighted = weight * sight.information;
            let left = sight.by_position.transpose() * weighted;
            self.add_position_block(
                &sight.basis.value,
                &(left * sight.by_position),
                &(left * sight.residual_px),
            );
            if let Some(block) = self.cameras.get_mut(s.camera) {
                let j = sight.by_camera(camera, &s.point);
                let left = j.transpose() * weighted;
                block.hessian += left * j;
                block.gradient += left * sight.residual_px;
                let by_axis = left * sight.by_position;
                for axis in 0..3 {
                    for (k, value) in sight.basis.value.iter().enumerate() {
                        let mut column = block.cross.column_mut(axis * TERMS + k);
                        column.axpy(*value, &by_axis.column(axis), 1.0);
                    }
                }
            }
        }
        self.hessian.fill_lower_triangle_with_upper_triangle();
    }

    /// Adds M ⊗ (b bᵀ) to the upper triangle of the coefficient block and v ⊗ b to the gradient.
    fn add_position_block(
        &mut self,
        basis: &[f64; TERMS],
        information: &Matrix3<f64>,
        gradient: &nalgebra::Vector3<f64>,
    ) {
        for column_axis in 0..3 {
            for (l, bl) in basis.iter().enumerate() {
                let column = column_axis * TERMS + l;
                self.gradient[column] += gradient[column_axis] * bl;
                for row_axis in 0..=column_axis {
                    let m = information[(row_axis, column_axis)] * bl;
                    let last = if row_axis == column_axis { l + 1 } else { TERMS };
                    let mut target = self.hessian.view_mut((row_axis * TERMS, column), (last, 1));
                    for (h, bk) in target.iter_mut().zip(basis) {
                        *h += m * bk;
                    }
                }
            }
        }
    }

    fn add_prior(&mut self, trajectory: &Trajectory, prior: &FlightPrior) {
        let mut rows = DMatrix::zeros(Trajectory::physics_rows(), FLIGHT_PARAMETERS);
        let mut residuals = DVector::zeros(Trajectory::physics_rows());
        let nodes = trajectory.physics_residuals(prior.acceleration_sigma_mps2);
        for (node, r) in nodes.iter().enumerate() {
            for row_axis in 0..3 {
                let row = 3 * node + row_axis;
                residuals[row] = r.residual[row_axis];
                for axis in 0..3 {
                    for k in 0..TERMS {
                        rows[(row, axis * TERMS + k)] = r.by_velocity[(row_axis, axis)] * r.basis.rate[k];
                    }
                    rows[(row, LIFT_ROW + axis)] = r.by_lift[(row_axis, axis)];
                }
                for k in 0..TERMS {
                    rows[(row, row_axis * TERMS + k)] += r.by_acceleration * r.basis.curvature[k];
                }
                rows[(row, DRAG_ROW)] = r.by_drag[row_axis];
            }
        }
        let whitening = trajectory.node_whitening();
        for mut column in rows.column_iter_mut() {
            whiten(&whitening, column.as_mut_slice());
        }
        whiten(&whitening, residuals.as_mut_slice());
        self.hessian.gemm_tr(1.0, &rows, &rows, 1.0);
        self.gradient.gemv_tr(1.0, &rows, &residuals, 1.0);
        let aero = trajectory.aerodynamics();
        let drag = 1.0 / (prior.drag_sigma * prior.drag_sigma);
        let lift = 1.0 / (prior.lift_sigma * prior.lift_sigma);
        self.hessian[(DRAG_ROW, DRAG_ROW)] += drag;
        self.gradient[DRAG_ROW] += drag * (aero.drag_coefficient - prior.drag_coefficient);
        for i in 0..3 {
            self.hessian[(LIFT_ROW + i, LIFT_ROW + i)] += lift;
            self.gradient[LIFT_ROW + i] += lift * aero.lift[i];
        }
        self.prior_cost = residuals.norm_squared()
            + drag * (aero.drag_coefficient - prior.drag_coefficient).powi(2)
            + lift * aero.lift.norm_squared();
    }

    /// Cholesky factor of the flight block with its diagonal raised by the fraction `damping`.
    pub fn factor(&self, damping: f64) -> Option<Cholesky<f64, Dyn>> {
        let mut damped = self.hessian.clone();
        for i in 0..damped.nrows() {
            damped[(i, i)] *= 1.0 + damping;
        }
        Cholesky::new(damped)
    }

    /// −2·ln of the marginal likelihood of the points (Laplace), up to a constant that depends only on the
    /// points: chooses between sizes of the residual acceleration.
    pub fn evidence_cost(&self, prior: &FlightPrior) -> Option<f64> {
        let factor = self.factor(0.0)?;
        let log_determinant = 2.0 * factor.l_dirty().diagonal().iter().map(|d| d.ln()).sum::<f64>();
        // The prior is a density over the accelerations the polynomial can have: TERMS − 2 per axis.
        let rank = 3.0 * (TERMS - 2) as f64;
        Some(self.cost() + 2.0 * rank * prior.acceleration_sigma_mps2.ln() + log_determinant)
    }
}
