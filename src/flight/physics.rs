//! Forces on a pitched ball: gravity, drag and a transverse force that need not come from spin (domain §2).

use nalgebra::{Matrix3, Vector3};

use crate::scene::{BALL_MASS_KG, BALL_RADIUS_M};

/// Speed at which the lift vector is stated, m/s.
const LIFT_SPEED_MPS: f64 = 40.0;
/// Time constant of the spin's decay, seconds (domain §2: 25–30 s).
const SPIN_DECAY_S: f64 = 27.0;
/// Exponent of a fastball's lift, before its CL is known.
pub const TYPICAL_LIFT_EXPONENT: f64 = 0.5;

/// Air and gravity of the site. World z is up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Physics {
    /// Gravity, m/s².
    pub gravity_mps2: f64,
    /// K = ρA/2m, 1/m.
    pub drag_per_m: f64,
}

impl Default for Physics {
    fn default() -> Self {
        Self::new(9.80665, 1.194)
    }
}

/// Drag and lift of one flight; dimensionless.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Aerodynamics {
    /// Cd.
    pub drag_coefficient: f64,
    /// w: the transverse acceleration is K·|v|·(|v|/40 m/s)^(p−1)·(w × v), so that |w⊥| is CL at 40 m/s.
    /// Its part along v is all but unobservable.
    pub lift: Vector3<f64>,
    /// p, held fixed while a flight is solved.
    pub lift_exponent: f64,
}

impl Aerodynamics {
    /// The exponent that CL = S/(0.4 + 2.32·S) (domain §2) has at this lift and direction of flight:
    /// d ln(CL·|v|) / d ln|v| = 2.32·CL. A bullet spin's lift grows with speed more slowly than a fastball's.
    pub fn exponent_at(&self, velocity_mps: &Vector3<f64>) -> f64 {
        let speed = velocity_mps.norm().max(1e-3);
        let transverse = self.lift.cross(velocity_mps).norm() / speed;
        (2.32 * transverse).clamp(0.05, 0.9)
    }
}

/// An acceleration with its derivatives.
#[derive(Debug, Clone, Copy)]
pub struct Acceleration {
    /// m/s².
    pub value: Vector3<f64>,
    /// By velocity, 1/s.
    pub by_velocity: Matrix3<f64>,
    /// By Cd, m/s².
    pub by_drag: Vector3<f64>,
    /// By w, m/s².
    pub by_lift: Matrix3<f64>,
}

impl Physics {
    /// From gravity (m/s²) and air density (kg/m³).
    pub fn new(gravity_mps2: f64, air_density_kgpm3: f64) -> Self {
        let area_m2 = std::f64::consts::PI * BALL_RADIUS_M * BALL_RADIUS_M;
        Self {
            gravity_mps2,
            drag_per_m: 0.5 * air_density_kgpm3 * area_m2 / BALL_MASS_KG,
        }
    }

    /// Acceleration at velocity `velocity_mps`, `age_s` seconds after the time at which the lift is stated.
    pub fn acceleration(
        &self,
        velocity_mps: &Vector3<f64>,
        aerodynamics: &Aerodynamics,
        age_s: f64,
    ) -> Acceleration {
        let v = velocity_mps;
        // 1 mm/s: keeps the powers finite for a ball at rest, where the forces vanish anyway.
        let speed = v.norm().max(1e-3);
        let k = self.drag_per_m;
        let cd = aerodynamics.drag_coefficient;
        let exponent = aerodynamics.lift_exponent;
        let decay = ((exponent - 1.0) * age_s / SPIN_DECAY_S).exp();
        let strength = k * speed * (speed / LIFT_SPEED_MPS).powf(exponent - 1.0) * decay;
        let lift = strength * aerodynamics.lift.cross(v);
        Acceleration {
            value: Vector3::new(0.0, 0.0, -self.gravity_mps2) - k * cd * speed * v + lift,
            by_velocity: strength * aerodynamics.lift.cross_matrix()
                + exponent / (speed * speed) * lift * v.transpose()
                - k * cd * (speed * Matrix3::identity() + v * v.transpose() / speed),
            by_drag: -k * speed * v,
            by_lift: -strength * v.cross_matrix(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn k_of_the_domain_file() {
        // domain §2: K = 0.01757 /m at 1.194 kg/m³.
        assert!((Physics::new(9.80665, 1.194).drag_per_m - 0.01757).abs() < 5e-6);
    }

    #[test]
    fn derivatives_match_central_differences() {
        let physics = Physics::default();
        let v = Vector3::new(2.0, -41.0, -3.0);
        let aero = Aerodynamics {
            drag_coefficient: 0.33,
            lift: Vector3::new(-0.2, 0.1, 0.05),
            lift_exponent: 0.4,
        };
        let exact = physics.acceleration(&v, &aero, 0.3);
        let h = 1e-5;
        for i in 0..3 {
            let mut d = Vector3::zeros();
            d[i] = h;
            let at = |s: f64| physics.acceleration(&(v + s * d), &aero, 0.3).value;
            assert!(((at(1.0) - at(-1.0)) / (2.0 * h) - exact.by_velocity.column(i)).norm() < 1e-7);
            let at = |s: f64| {
                let lift = aero.lift + s * d;
                physics
                    .acceleration(&v, &Aerodynamics { lift, ..aero }, 0.3)
                    .value
            };
            assert!(((at(1.0) - at(-1.0)) / (2.0 * h) - exact.by_lift.column(i)).norm() < 1e-7);
        }
        let at = |s: f64| {
            let drag_coefficient = aero.drag_coefficient + s * h;
            let changed = Aerodynamics {
                drag_coefficient,
                ..aero
            };
            physics.acceleration(&v, &changed, 0.3).value
        };
        assert!(((at(1.0) - at(-1.0)) / (2.0 * h) - exact.by_drag).norm() < 1e-7);
    }
}
