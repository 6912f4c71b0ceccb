//! Levenberg–Marquardt on cameras and flights at once; flights are eliminated by Schur's complement, so the
//! work grows linearly with the pitches.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use crate::flight::equations::{FlightEquations, Loss, flight_cost};
use crate::flight::sighting::{CAMERA_COLUMNS, CameraModel};
use crate::flight::trajectory::FLIGHT_PARAMETERS;

use super::problem::{Column, FlightUnknown, JointProblem, JointState};

/// A step that promises less than this (in units of the squared-sigma cost) is no step.
const PROMISE_ENOUGH: f64 = 1e-3;

/// One flight's share of the linearised problem.
pub(super) struct FlightShare {
    /// The flight's own normal equations.
    pub(super) equations: FlightEquations,
    /// Flight rows, camera columns.
    pub(super) ties: DMatrix<f64>,
}

/// The linearised problem.
pub(super) struct Linearised {
    pub(super) hessian: DMatrix<f64>,
    pub(super) gradient: DVector<f64>,
    pub(super) flights: Vec<FlightShare>,
    pub(super) cost: f64,
}

/// The cameras' Schur complement and what takes its solution back to the flights.
pub(super) struct Reduced {
    pub(super) cameras: Cholesky<f64, Dyn>,
    pub(super) flights: Vec<Cholesky<f64, Dyn>>,
    pub(super) complement: DMatrix<f64>,
    right: DVector<f64>,
}

impl JointProblem {
    /// Cost at a state.
    pub(super) fn cost(&self, state: &JointState, loss: Loss) -> f64 {
        let flights: f64 = state
            .flights
            .iter()
            .map(|f| {
                flight_cost(
                    &state.cameras,
                    &f.state.trajectory,
                    &f.sightings,
                    loss,
                    &f.state.prior,
                )
            })
            .sum();
        flights + self.terms.cost(&state.cameras, &self.columns, loss)
    }

    /// Normal equations at a state.
    pub(super) fn linearise(&self, state: &JointState, loss: Loss) -> Linearised {
        let terms = self.terms.equations(&state.cameras, &self.columns, loss);
        let mut total = Linearised {
            hessian: terms.hessian,
            gradient: terms.gradient,
            flights: Vec::with_capacity(state.flights.len()),
            cost: terms.cost,
        };
        for flight in &state.flights {
            total.add_flight(&self.columns, &state.cameras, flight, loss);
        }
        total
    }

    /// Moves the state along a step of the cameras and steps of the flights.
    fn stepped(&self, state: &JointState, step: &DVector<f64>, flights: &[DVector<f64>]) -> JointState {
        let mut moved = state.clone();
        for (index, camera) in moved.cameras.iter_mut().enumerate() {
            let mut own = [0.0; CAMERA_COLUMNS];
            for (i, column) in self.columns.iter().enumerate() {
                if column.camera == index {
                    own[column.kind] = step[i];
                }
            }
            *camera = camera.perturbed(&own);
        }
        for (flight, step) in moved.flights.iter_mut().zip(flights) {
            let path = &flight.state.trajectory;
            flight.state.trajectory = path.with_parameters(path.parameters() + step);
        }
        moved
    }

    /// Descends until a step promises nothing, for at most `iterations` linearisations; the cost reached.
    pub(super) fn descend(&self, state: &mut JointState, loss: Loss, iterations: usize) -> f64 {
        let mut damping = 1e-5;
        let mut at = self.linearise(state, loss);
        let mut left = iterations;
        while left > 0 && damping < 1e8 {
            let Some(reduced) = at.reduce(damping) else {
                damping *= 100.0;
                continue;
            };
            let (step, flights) = reduced.solve(&at);
            let promised = at.promise(&step, &flights);
            if promised < PROMISE_ENOUGH {
                break;
            }
            let trial = self.stepped(state, &step, &flights);
            let cost = self.cost(&trial, loss);
            if cost < at.cost {
                let gain = at.cost - cost;
                *state = trial;
                left -= 1;
                at = self.linearise(state, loss);
                damping = (damping * if gain > 0.5 * promised { 0.03 } else { 0.5 }).max(1e-10);
            } else {
                damping = (damping * 10.0).max(1e-5);
            }
        }
        at.cost
    }
}

impl Linearised {
    fn add_flight(
        &mut self,
        columns: &[Column],
        cameras: &[CameraModel],
        flight: &FlightUnknown,
        loss: Loss,
    ) {
        let equations = FlightEquations::with_cameras(
            cameras,
            &flight.state.trajectory,
            &flight.sightings,
            loss,
            &flight.state.prior,
        );
        let mut ties = DMatrix::zeros(FLIGHT_PARAMETERS, columns.len());
        for (i, column) in columns.iter().enumerate() {
            let block = &equations.cameras[column.camera];
            ties.set_column(i, &block.cross.row(column.kind).transpose());
            self.gradient[i] += block.gradient[column.kind];
            for (j, other) in columns.iter().enumerate() {
                if other.camera == column.camera {
                    self.hessian[(i, j)] += block.hessian[(column.kind, other.kind)];
                }
            }
        }
        self.cost += equations.cost();
        self.flights.push(FlightShare { equations, ties });
    }

    /// Eliminates the flights, with every diagonal raised by the fraction `damping`.
    pub(super) fn reduce(&self, damping: f64) -> Option<Reduced> {
        let mut complement = self.hessian.clone();
        for i in 0..complement.nrows() {
            complement[(i, i)] *= 1.0 + damping;
        }
        let mut right = -&self.gradient;
        let mut factors = Vec::with_capacity(self.flights.len());
        for flight in &self.flights {
            let factor = flight.equations.factor(damping)?;
            let lower = factor.l();
            let half = lower.solve_lower_triangular(&flight.ties)?;
            let half_gradient = lower.solve_lower_triangular(&flight.equations.gradient)?;
            complement -= half.tr_mul(&half);
            right += half.tr_mul(&half_gradient);
            factors.push(factor);
        }
        let cameras = Cholesky::new(complement.clone())?;
        Some(Reduced {
            cameras,
            flights: factors,
            complement,
            right,
        })
    }

    /// Decrease of the quadratic model along a (damped) step, in cost units; half of it is certain.
    fn promise(&self, step: &DVector<f64>, flights: &[DVector<f64>]) -> f64 {
        let own: f64 = flights
            .iter()
            .zip(&self.flights)
            .map(|(s, f)| s.dot(&f.equations.gradient))
            .sum();
        -(step.dot(&self.gradient) + own)
    }
}

impl Reduced {
    /// The step of the cameras and of every flight.
    fn solve(&self, at: &Linearised) -> (DVector<f64>, Vec<DVector<f64>>) {
        let step = self.cameras.solve(&self.right);
        let flights = self
            .flights
            .iter()
            .zip(&at.flights)
            .map(|(factor, f)| factor.solve(&-(&f.equations.gradient + &f.ties * &step)))
            .collect();
        (step, flights)
    }
}
