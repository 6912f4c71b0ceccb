//! The trajectory of one ball: a Legendre polynomial in time per axis, held to the physics by a prior.
//!
//! Position, velocity and acceleration are linear in the coefficients; drag and lift are parameters of the
//! flight, and a smooth residual acceleration of chosen size lets knuckleballs depart from the physics.

use nalgebra::{DVector, Matrix3, Point3, SMatrix, Vector3};

use super::physics::{Aerodynamics, Physics, TYPICAL_LIFT_EXPONENT};

/// Coefficients per axis: degree 8. Drag, Magnus force and spin decay over a pitch need 6 for 1 µm; a
/// knuckleball's wobble needs the rest.
pub const TERMS: usize = 9;
/// Coefficients x, y, z, then Cd, then w (3).
pub const FLIGHT_PARAMETERS: usize = 3 * TERMS + 4;
/// Row of Cd among the parameters.
pub const DRAG_ROW: usize = 3 * TERMS;
/// First row of w among the parameters.
pub const LIFT_ROW: usize = DRAG_ROW + 1;
/// Times at which the physics is asked for (Chebyshev nodes of the span).
pub const NODES: usize = 12;
/// Correlation time of the residual acceleration, seconds (Matérn 3/2). A knuckleball turns a quarter to one
/// and a half times on its way, so its force changes over a twentieth to a fifth of a second.
const CORRELATION_S: f64 = 0.05;

/// Cd before a flight is seen, between domain §2's 0.35 and the 0.314 ± 0.030 that 112 Statcast pitches have
/// at sea-level air: the air of a park is known to a tenth at best.
pub const TYPICAL_DRAG: f64 = 0.335;
/// 1σ of it. The balls of one day share their error, and a tighter prior (±0.03) turned that into delays off
/// by half a sigma and speeds off by two; this width costs 1 % of a delay's sigma where it is needed least.
const DRAG_SIGMA: f64 = 0.06;

/// What is believed of a flight before any point of it is seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FlightPrior {
    /// Cd, mean.
    pub drag_coefficient: f64,
    /// Cd, 1σ.
    pub drag_sigma: f64,
    /// w, 1σ per component (CL at 40 m/s).
    pub lift_sigma: f64,
    /// 1σ of the acceleration that is neither gravity, drag nor lift, m/s² per axis.
    pub acceleration_sigma_mps2: f64,
}

impl Default for FlightPrior {
    fn default() -> Self {
        Self {
            drag_coefficient: TYPICAL_DRAG,
            drag_sigma: DRAG_SIGMA,
            lift_sigma: 0.4,
            acceleration_sigma_mps2: 0.02,
        }
    }
}

/// Values of the basis polynomials at one time, with the derivatives by time in seconds.
#[derive(Debug, Clone, Copy)]
pub struct BasisRow {
    /// P_k.
    pub value: [f64; TERMS],
    /// dP_k/dt, 1/s.
    pub rate: [f64; TERMS],
    /// d²P_k/dt², 1/s².
    pub curvature: [f64; TERMS],
}

/// One prior residual triple, in units of its sigma, with its derivatives.
#[derive(Debug, Clone)]
pub struct PhysicsResidual {
    /// (acceleration − physics) / σ.
    pub residual: Vector3<f64>,
    /// Basis at the node.
    pub basis: BasisRow,
    /// ∂residual/∂(velocity).
    pub by_velocity: Matrix3<f64>,
    /// ∂residual/∂(acceleration) is this times the identity.
    pub by_acceleration: f64,
    /// ∂residual/∂Cd.
    pub by_drag: Vector3<f64>,
    /// ∂residual/∂w.
    pub by_lift: Matrix3<f64>,
}

/// A flight as a function of true time in seconds after `epoch_ns`.
#[derive(Debug, Clone, PartialEq)]
pub struct Trajectory {
    physics: Physics,
    epoch_ns: i64,
    begin_s: f64,
    end_s: f64,
    lift_exponent: f64,
    parameters: DVector<f64>,
}

impl Trajectory {
    /// A trajectory of these parameters (`FLIGHT_PARAMETERS` of them: x, y, z coefficients, Cd, w) over
    /// `[begin_s, end_s]` after `epoch_ns`. Missing parameters are zero, surplus ones are dropped.
    pub fn new(physics: Physics, epoch_ns: i64, span_s: (f64, f64), parameters: DVector<f64>) -> Self {
        Self {
            physics,
            epoch_ns,
            begin_s: span_s.0,
            // A span of nothing has no basis; a millisecond is far below any pitch.
            end_s: span_s.1.max(span_s.0 + 1e-3),
            lift_exponent: TYPICAL_LIFT_EXPONENT,
            parameters: parameters.resize_vertically(FLIGHT_PARAMETERS, 0.0),
        }
    }

    /// The trajectory that passes closest (least squares) to sampled positions `(t_s, metres)` with this
    /// drag and lift. At least three samples at different times.
    pub fn through(
        physics: Physics,
        epoch_ns: i64,
        samples: &[(f64, Point3<f64>)],
        aerodynamics: &Aerodynamics,
    ) -> Self {
        let begin = samples.iter().map(|s| s.0).fold(f64::INFINITY, f64::min);
        let end = samples.iter().map(|s| s.0).fold(f64::NEG_INFINITY, f64::max);
        let mut fitted = Self::new(physics, epoch_ns, (begin, end), DVector::zeros(FLIGHT_PARAMETERS));
        let terms = TERMS.min(samples.len().max(1));
        let design = nalgebra::DMatrix::from_fn(samples.len(), terms, |r, c| {
            samples.get(r).map_or(0.0, |s| fitted.basis(s.0).value[c])
        });
        let targets =
            nalgebra::DMatrix::from_fn(samples.len(), 3, |r, c| samples.get(r).map_or(0.0, |s| s.1[c]));
        if let Ok(solution) = design.svd(true, true).solve(&targets, 1e-12) {
            for axis in 0..3 {
                for k in 0..terms {
                    fitted.parameters[axis * TERMS + k] = solution[(k, axis)];
                }
            }
        }
        fitted.with_aerodynamics(aerodynamics)
    }

    /// The same path with other drag and lift.
    pub fn with_aerodynamics(mut self, aerodynamics: &Aerodynamics) -> Self {
        self.parameters[DRAG_ROW] = aerodynamics.drag_coefficient;
        for i in 0..3 {
            self.parameters[LIFT_ROW + i] = aerodynamics.lift[i];
        }
        self.lift_exponent = aerodynamics.lift_exponent;
        self
    }

    /// All parameters: x, y, z coefficients (metres), Cd, w.
    pub fn parameters(&self) -> &DVector<f64> {
        &self.parameters
    }

    /// The same flight with other parameters.
    pub fn with_parameters(&self, parameters: DVector<f64>) -> Self {
        Self {
            parameters: parameters.resize_vertically(FLIGHT_PARAMETERS, 0.0),
            ..self.clone()
        }
    }

    /// The same flight with the lift's exponent that goes with its lift, `Aerodynamics::exponent_at`.
    pub fn with_own_exponent(mut self) -> Self {
        let v = self.velocity_mps(0.5 * (self.begin_s + self.end_s));
        self.lift_exponent = self.aerodynamics().exponent_at(&v);
        self
    }

    /// Zero of the time axis, nanoseconds of the reference camera's true time.
    pub fn epoch_ns(&self) -> i64 {
        self.epoch_ns
    }

    /// The times between which the physics was asked for, seconds after the epoch.
    pub fn span_s(&self) -> (f64, f64) {
        (self.begin_s, self.end_s)
    }

    /// Air and gravity.
    pub fn physics(&self) -> &Physics {
        &self.physics
    }

    /// Drag and lift.
    pub fn aerodynamics(&self) -> Aerodynamics {
        Aerodynamics {
            drag_coefficient: self.parameters[DRAG_ROW],
            lift: Vector3::new(
                self.parameters[LIFT_ROW],
                self.parameters[LIFT_ROW + 1],
                self.parameters[LIFT_ROW + 2],
            ),
            lift_exponent: self.lift_exponent,
        }
    }

    /// The basis at `t_s`. Position is Σ value_k·c_k per axis, and so on.
    pub fn basis(&self, t_s: f64) -> BasisRow {
        let half = 0.5 * (self.end_s - self.begin_s);
        let u = (t_s - self.begin_s) / half - 1.0;
        let (mut p, mut d, mut s) = ([0.0; TERMS], [0.0; TERMS], [0.0; TERMS]);
        p[0] = 1.0;
        p[1] = u;
        d[1] = 1.0 / half;
        for k in 2..TERMS {
            let n = k as f64;
            // Legendre: n·P_n = (2n − 1)·u·P_{n−1} − (n − 1)·P_{n−2}, and its derivatives by u, scaled to t.
            let (a, b) = ((2.0 * n - 1.0) / n, (n - 1.0) / n);
            p[k] = a * u * p[k - 1] - b * p[k - 2];
            d[k] = a * (p[k - 1] / half + u * d[k - 1]) - b * d[k - 2];
            s[k] = a * (2.0 * d[k - 1] / half + u * s[k - 1]) - b * s[k - 2];
        }
        BasisRow {
            value: p,
            rate: d,
            curvature: s,
        }
    }

    fn combine(&self, weights: &[f64; TERMS]) -> Vector3<f64> {
        let c = self.parameters.as_slice();
        let axis = |a: usize| {
            c.iter()
                .skip(a * TERMS)
                .zip(weights)
                .map(|(c, w)| c * w)
                .sum::<f64>()
        };
        Vector3::new(axis(0), axis(1), axis(2))
    }

    /// Position from a basis row, metres.
    pub fn position_at(&self, basis: &BasisRow) -> Point3<f64> {
        Point3::from(self.combine(&basis.value))
    }

    /// Velocity from a basis row, m/s.
    pub fn velocity_at(&self, basis: &BasisRow) -> Vector3<f64> {
        self.combine(&basis.rate)
    }

    /// Position, metres.
    pub fn position_m(&self, t_s: f64) -> Point3<f64> {
        self.position_at(&self.basis(t_s))
    }

    /// Velocity, m/s.
    pub fn velocity_mps(&self, t_s: f64) -> Vector3<f64> {
        self.velocity_at(&self.basis(t_s))
    }

    /// Acceleration, m/s².
    pub fn acceleration_mps2(&self, t_s: f64) -> Vector3<f64> {
        self.combine(&self.basis(t_s).curvature)
    }

    /// The last time in the span (a tenth of it beyond included) at which y equals `y_m`; `None` if never.
    pub fn time_at_y(&self, y_m: f64) -> Option<f64> {
        let margin = 0.1 * (self.end_s - self.begin_s);
        let (first, last) = (self.begin_s - margin, self.end_s + margin);
        let steps = 64;
        let step = (last - first) / f64::from(steps);
        let miss = |t: f64| self.position_m(t).y - y_m;
        let bracket = (0..steps).rev().find_map(|i| {
            let a = first + f64::from(i) * step;
            (miss(a) * miss(a + step) <= 0.0).then_some((a, a + step))
        });
        let (mut low, mut high) = bracket?;
        let mut t = 0.5 * (low + high);
        for _ in 0..60 {
            let f = miss(t);
            if f * miss(low) > 0.0 {
                low = t;
            } else {
                high = t;
            }
            let newton = t - f / self.velocity_mps(t).y;
            let next = if newton > low && newton < high {
                newton
            } else {
                0.5 * (low + high)
            };
            if (next - t).abs() < 1e-13 {
                return Some(next);
            }
            t = next;
        }
        Some(t)
    }

    fn node_s(&self, node: usize) -> f64 {
        let half = 0.5 * (self.end_s - self.begin_s);
        let angle = std::f64::consts::PI * (node as f64 + 0.5) / NODES as f64;
        self.begin_s + half * (1.0 - angle.cos())
    }

    /// Inverse of the lower Cholesky factor of the residual acceleration's correlation between the nodes:
    /// applied to the residuals of one axis it makes them independent.
    pub fn node_whitening(&self) -> SMatrix<f64, NODES, NODES> {
        let rate = 3f64.sqrt() / CORRELATION_S;
        let correlation = SMatrix::<f64, NODES, NODES>::from_fn(|i, j| {
            let x = rate * (self.node_s(i) - self.node_s(j)).abs();
            // The nugget keeps nodes of a very short span apart; no force repeats to a thousandth.
            (1.0 + x) * (-x).exp() + if i == j { 1e-3 } else { 0.0 }
        });
        let identity = SMatrix::identity();
        correlation
            .cholesky()
            .and_then(|c| c.l().solve_lower_triangular(&identity))
            .unwrap_or(identity)
    }

    /// Residuals of the physics at the nodes in units of the prior's acceleration sigma, correlated between
    /// nodes (see `node_whitening`).
    pub fn physics_residuals(&self, acceleration_sigma_mps2: f64) -> Vec<PhysicsResidual> {
        let aerodynamics = self.aerodynamics();
        let weight = 1.0 / acceleration_sigma_mps2;
        let half = 0.5 * (self.end_s - self.begin_s);
        (0..NODES)
            .map(|k| {
                let t = self.node_s(k);
                let basis = self.basis(t);
                let v = self.velocity_at(&basis);
                let law = self
                    .physics
                    .acceleration(&v, &aerodynamics, t - self.begin_s - half);
                PhysicsResidual {
                    residual: weight * (self.combine(&basis.curvature) - law.value),
                    basis,
                    by_velocity: -weight * law.by_velocity,
                    by_acceleration: weight,
                    by_drag: -weight * law.by_drag,
                    by_lift: -weight * law.by_lift,
                }
            })
            .collect()
    }

    /// Number of scalar physics residuals.
    pub const fn physics_rows() -> usize {
        3 * NODES
    }

    /// The same flight on another span: the polynomial where it is known, the physics beyond.
    pub fn with_span(&self, begin_s: f64, end_s: f64) -> Self {
        let samples: Vec<_> = (0..=4 * TERMS)
            .map(|i| begin_s + (end_s - begin_s) * i as f64 / (4 * TERMS) as f64)
            .map(|t| (t, self.extended_position_m(t)))
            .collect();
        let mut moved = Self::through(self.physics, self.epoch_ns, &samples, &self.aerodynamics());
        moved.begin_s = begin_s;
        moved.end_s = end_s.max(begin_s + 1e-3);
        moved
    }

    /// Position from the polynomial inside the span, by integrating the physics (RK4) outside, metres.
    pub fn extended_position_m(&self, t_s: f64) -> Point3<f64> {
        let from = t_s.clamp(self.begin_s, self.end_s);
        if from == t_s {
            return self.position_m(t_s);
        }
        let aerodynamics = self.aerodynamics();
        let middle = 0.5 * (self.begin_s + self.end_s);
        let steps = ((t_s - from).abs() / 0.005).ceil().clamp(1.0, 1000.0);
        let h = (t_s - from) / steps;
        let law = |t: f64, v: &Vector3<f64>| self.physics.acceleration(v, &aerodynamics, t - middle).value;
        let (mut t, mut r, mut v) = (from, self.position_m(from), self.velocity_mps(from));
        for _ in 0..steps as usize {
            let a1 = law(t, &v);
            let v2 = v + 0.5 * h * a1;
            let a2 = law(t + 0.5 * h, &v2);
            let v3 = v + 0.5 * h * a2;
            let a3 = law(t + 0.5 * h, &v3);
            let v4 = v + h * a3;
            let a4 = law(t + h, &v4);
            r += h / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4);
            v += h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4);
            t += h;
        }
        r
    }
}
