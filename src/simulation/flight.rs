//! True flights: gravity, drag and Magnus force by RK4, dense enough to be exact to a micrometre.
//!
//! Domain §2: a = g − K·Cd·|v|·v + K·CL·|v|²·n with K = ρA/2m, v relative to the air. Never the solver's model.

use nalgebra::{Point3, Vector3};

use crate::scene::{BALL_MASS_KG, BALL_RADIUS_M};

/// Time constant of the spin's decay, s (domain §2: 25–30 s).
const SPIN_DECAY_S: f64 = 27.0;
/// Step of the integration and of the table, s. One step less or more changes a plate point by < 1 nm.
const STEP_S: f64 = 0.001;

/// What pushes the ball across its path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Transverse {
    /// Nothing.
    None,
    /// Magnus force of this spin vector (rad/s, world axes): CL = S/(0.4 + 2.32·S), S = r·ω⊥/|v|.
    Spin(Vector3<f64>),
    /// Constant lift coefficients, to the catcher's right (for a ball that comes to him) and up.
    Coefficients([f64; 2]),
    /// Lift coefficients that swing: amplitude, angular frequency (rad/s) and phase (rad).
    Swinging {
        /// Sideways and up.
        amplitude: [f64; 2],
        /// rad/s.
        frequency_radps: f64,
        /// At release, rad.
        phase_rad: [f64; 2],
    },
}

/// Everything that acts on one ball.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Forces {
    /// m/s², downwards.
    pub gravity_mps2: f64,
    /// kg/m³.
    pub air_density_kgpm3: f64,
    /// m/s.
    pub wind_mps: Vector3<f64>,
    /// Cd.
    pub drag_coefficient: f64,
    /// Across the path.
    pub transverse: Transverse,
}

impl Forces {
    /// K = ρA/2m, 1/m.
    pub fn drag_scale_perm(&self) -> f64 {
        let area = std::f64::consts::PI * BALL_RADIUS_M * BALL_RADIUS_M;
        self.air_density_kgpm3 * area / (2.0 * BALL_MASS_KG)
    }

    /// Acceleration `t_s` after release at velocity `v` (m/s), m/s².
    pub fn acceleration(&self, t_s: f64, v: &Vector3<f64>) -> Vector3<f64> {
        let air = v - self.wind_mps;
        let speed = air.norm();
        let k = self.drag_scale_perm();
        let mut a = Vector3::new(0.0, 0.0, -self.gravity_mps2) - k * self.drag_coefficient * speed * air;
        if speed > 1e-6 {
            a += k * speed * speed * self.lift(t_s, &air, speed);
        }
        a
    }

    /// CL times its unit direction.
    fn lift(&self, t_s: f64, air: &Vector3<f64>, speed: f64) -> Vector3<f64> {
        match self.transverse {
            Transverse::None => Vector3::zeros(),
            Transverse::Spin(omega) => {
                let cross = (omega * (-t_s / SPIN_DECAY_S).exp()).cross(air);
                let length = cross.norm();
                if length < 1e-9 {
                    return Vector3::zeros();
                }
                let spin = BALL_RADIUS_M * (length / speed) / speed;
                cross / length * (spin / (0.4 + 2.32 * spin))
            }
            Transverse::Coefficients([side, up]) => {
                let (right, above) = transverse_axes(air);
                right * side + above * up
            }
            Transverse::Swinging {
                amplitude,
                frequency_radps,
                phase_rad,
            } => {
                let (right, above) = transverse_axes(air);
                let swing = |i: usize| amplitude[i] * (frequency_radps * t_s + phase_rad[i]).sin();
                right * swing(0) + above * swing(1)
            }
        }
    }
}

/// Unit vectors across a velocity: to the catcher's right for a ball that comes to him, and up.
pub(super) fn transverse_axes(v: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
    let along = v.normalize();
    let above = Vector3::z() - along * along.z;
    let above = if above.norm() > 1e-9 {
        above.normalize()
    } else {
        Vector3::y()
    };
    (above.cross(&along), above)
}

/// One instant of a flight.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FlightState {
    /// Metres.
    pub position_m: Point3<f64>,
    /// m/s.
    pub velocity_mps: Vector3<f64>,
    /// m/s².
    pub acceleration_mps2: Vector3<f64>,
}

/// When a flight is over.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FlightEnd {
    /// When the ball passes this y, metres, from either side.
    pub y_m: Option<f64>,
    /// At the latest, seconds after release.
    pub after_s: f64,
}

/// A true flight: time in seconds after release, valid 0.1 s before it and 0.2 s after its end.
#[derive(Debug, Clone, PartialEq)]
pub struct Flight {
    begin_s: f64,
    states: Vec<FlightState>,
    /// End of the flight (the glove), seconds after release.
    pub end_s: f64,
}

/// Table before the release and after the end, in steps.
const MARGIN_BEFORE: usize = 100;
const MARGIN_AFTER: usize = 200;

impl Flight {
    /// Integrates from a release position and velocity.
    pub fn integrate(
        forces: &Forces,
        release_m: Point3<f64>,
        velocity_mps: Vector3<f64>,
        end: FlightEnd,
    ) -> Self {
        let start = FlightState {
            position_m: release_m,
            velocity_mps,
            acceleration_mps2: forces.acceleration(0.0, &velocity_mps),
        };
        let mut states = vec![start];
        let mut state = start;
        for i in 0..MARGIN_BEFORE {
            state = step(forces, -(i as f64) * STEP_S, &state, -STEP_S);
            states.push(state);
        }
        states.reverse();
        let last = (end.after_s / STEP_S).ceil() as usize;
        state = start;
        let mut left = None;
        for i in 0..last.max(1) + MARGIN_AFTER {
            let next = step(forces, i as f64 * STEP_S, &state, STEP_S);
            states.push(next);
            let passed = |y: f64| (state.position_m.y - y) * (next.position_m.y - y) <= 0.0;
            let over = end.y_m.is_some_and(passed) || i + 1 >= last;
            state = next;
            left = match left {
                None if over => Some(MARGIN_AFTER),
                None => None,
                Some(0) => break,
                Some(n) => Some(n - 1),
            };
        }
        Self::from_table(-(MARGIN_BEFORE as f64) * STEP_S, states, end)
    }

    /// The constant-acceleration flight r + v·t + a·t²/2, t from release.
    pub fn constant_acceleration(start: FlightState, end: FlightEnd) -> Self {
        let at = |t: f64| FlightState {
            position_m: start.position_m + start.velocity_mps * t + start.acceleration_mps2 * (0.5 * t * t),
            velocity_mps: start.velocity_mps + start.acceleration_mps2 * t,
            acceleration_mps2: start.acceleration_mps2,
        };
        let last = (end.after_s / STEP_S).ceil() as i64 + MARGIN_AFTER as i64;
        let first = -(MARGIN_BEFORE as i64);
        let states = (first..=last).map(|i| at(i as f64 * STEP_S)).collect();
        Self::from_table(first as f64 * STEP_S, states, end)
    }

    fn from_table(begin_s: f64, states: Vec<FlightState>, end: FlightEnd) -> Self {
        let mut flight = Self {
            begin_s,
            states,
            end_s: end.after_s,
        };
        if let Some(t) = end.y_m.and_then(|y| flight.time_at_y(y)) {
            flight.end_s = t.min(end.after_s);
        }
        flight
    }

    /// The ball `t_s` after release; outside its table it flies straight on.
    pub fn state(&self, t_s: f64) -> FlightState {
        let u = (t_s - self.begin_s) / STEP_S;
        let last = self.states.len() - 1;
        let i = (u.floor().max(0.0) as usize).min(last.saturating_sub(1));
        let (a, b) = (&self.states[i], &self.states[(i + 1).min(last)]);
        let s = u - i as f64;
        if !(0.0..=1.0).contains(&s) {
            let edge = if s < 0.0 { a } else { b };
            let beyond = if s < 0.0 { s } else { s - 1.0 } * STEP_S;
            return FlightState {
                position_m: edge.position_m + edge.velocity_mps * beyond,
                ..*edge
            };
        }
        hermite(a, b, s)
    }

    /// Position, metres.
    pub fn position_m(&self, t_s: f64) -> Point3<f64> {
        self.state(t_s).position_m
    }

    /// First time at or after the release (or, failing that, in the table before it) at which y is passed.
    pub fn time_at_y(&self, y_m: f64) -> Option<f64> {
        let passes = |i: usize| {
            let (a, b) = (self.states.get(i)?, self.states.get(i + 1)?);
            ((a.position_m.y - y_m) * (b.position_m.y - y_m) <= 0.0).then_some(i)
        };
        let release = (-self.begin_s / STEP_S).round() as usize;
        let i = (release..self.states.len())
            .find_map(passes)
            .or_else(|| (0..release).rev().find_map(passes))?;
        let (mut low, mut high) = (i as f64, i as f64 + 1.0);
        let side = self.states[i].position_m.y > y_m;
        for _ in 0..50 {
            let middle = 0.5 * (low + high);
            let above = self.state(self.begin_s + middle * STEP_S).position_m.y > y_m;
            if above == side {
                low = middle;
            } else {
                high = middle;
            }
        }
        Some(self.begin_s + 0.5 * (low + high) * STEP_S)
    }
}

/// One classical Runge–Kutta step of the state (r, v).
fn step(forces: &Forces, t: f64, from: &FlightState, h: f64) -> FlightState {
    let v1 = from.velocity_mps;
    let a1 = forces.acceleration(t, &v1);
    let v2 = v1 + a1 * (0.5 * h);
    let a2 = forces.acceleration(t + 0.5 * h, &v2);
    let v3 = v1 + a2 * (0.5 * h);
    let a3 = forces.acceleration(t + 0.5 * h, &v3);
    let v4 = v1 + a3 * h;
    let a4 = forces.acceleration(t + h, &v4);
    let velocity_mps = v1 + (a1 + 2.0 * (a2 + a3) + a4) * (h / 6.0);
    FlightState {
        position_m: from.position_m + (v1 + 2.0 * (v2 + v3) + v4) * (h / 6.0),
        velocity_mps,
        acceleration_mps2: forces.acceleration(t + h, &velocity_mps),
    }
}

/// Cubic Hermite interpolation of position and of velocity over one step, s in 0..1.
fn hermite(a: &FlightState, b: &FlightState, s: f64) -> FlightState {
    let (s2, s3) = (s * s, s * s * s);
    let (h00, h10) = (2.0 * s3 - 3.0 * s2 + 1.0, (s3 - 2.0 * s2 + s) * STEP_S);
    let (h01, h11) = (3.0 * s2 - 2.0 * s3, (s3 - s2) * STEP_S);
    let (ra, rb) = (a.position_m.coords, b.position_m.coords);
    FlightState {
        position_m: Point3::from(ra * h00 + a.velocity_mps * h10 + rb * h01 + b.velocity_mps * h11),
        velocity_mps: a.velocity_mps * h00
            + a.acceleration_mps2 * h10
            + b.velocity_mps * h01
            + b.acceleration_mps2 * h11,
        acceleration_mps2: a.acceleration_mps2.lerp(&b.acceleration_mps2, s),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn still_air(transverse: Transverse, drag_coefficient: f64) -> Forces {
        Forces {
            gravity_mps2: 9.80665,
            air_density_kgpm3: 1.194,
            wind_mps: Vector3::zeros(),
            drag_coefficient,
            transverse,
        }
    }

    const GLOVE: FlightEnd = FlightEnd {
        y_m: Some(-0.45),
        after_s: 3.0,
    };

    #[test]
    fn without_air_the_flight_is_the_parabola() {
        let forces = still_air(Transverse::None, 0.0);
        let (r0, v0) = (Point3::new(-0.6, 16.6, 1.8), Vector3::new(1.0, -40.0, -1.5));
        let flight = Flight::integrate(&forces, r0, v0, GLOVE);
        for i in -50..=420 {
            let t = f64::from(i) * 1e-3 + 0.000_37;
            let truth = r0 + v0 * t + Vector3::new(0.0, 0.0, -0.5 * 9.80665 * t * t);
            // 1 nm: rounding only, a parabola is exact under RK4 and Hermite.
            assert!((flight.position_m(t) - truth).norm() < 1e-9, "t {t}");
        }
        assert!((flight.end_s - (16.6 + 0.45) / 40.0).abs() < 1e-9);
    }

    #[test]
    fn drag_alone_has_the_closed_form() {
        // dv/dt = −k v² without gravity: v = v0/(1 + k v0 t), x = ln(1 + k v0 t)/k.
        let mut forces = still_air(Transverse::None, 0.35);
        forces.gravity_mps2 = 0.0;
        let flight = Flight::integrate(
            &forces,
            Point3::new(0.0, 17.0, 1.5),
            Vector3::new(0.0, -42.0, 0.0),
            GLOVE,
        );
        let k = forces.drag_scale_perm() * 0.35;
        for t in [0.0, 0.1234, 0.3, 0.4321] {
            let y = 17.0 - (1.0 + k * 42.0 * t).ln() / k;
            assert!((flight.position_m(t).y - y).abs() < 1e-9);
        }
        // domain §2: K = 0.01757 /m at 1.194 kg/m³.
        assert!((forces.drag_scale_perm() - 0.01757).abs() < 1e-5);
    }

    #[test]
    fn backspin_lifts_and_a_tilt_to_the_left_pushes_left() {
        let end = |omega: Vector3<f64>| {
            let f = Flight::integrate(
                &still_air(Transverse::Spin(omega), 0.35),
                Point3::new(0.0, 16.6, 1.8),
                Vector3::new(0.0, -42.0, 0.0),
                GLOVE,
            );
            f.position_m(f.time_at_y(0.4318).unwrap())
        };
        let none = end(Vector3::zeros());
        // ω = −x is backspin for a ball that flies to −y: ω × v points up.
        assert!(end(Vector3::new(-230.0, 0.0, 0.0)).z > none.z + 0.3);
        assert!(end(Vector3::new(0.0, 0.0, -230.0)).x < -0.3);
    }
}
