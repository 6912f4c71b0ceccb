//! The constant-acceleration ("9P") view of a flight in Statcast's frame and units (domain §4).
//!
//! An export view only: on real flights it is off by up to 5.7 mm at the plate (domain §2), so the estimate
//! itself is never this. Axes are the home-plate frame's; lengths feet, times seconds, t = 0 at y = 50 ft.

use nalgebra::{Matrix3, Vector3};

/// Metres in a foot.
pub const FOOT_M: f64 = 0.3048;
/// m/s in a mile per hour.
pub const MPH_MPS: f64 = 0.44704;
/// y at which the nine parameters are stated, feet.
pub const REFERENCE_Y_FT: f64 = 50.0;
/// Front edge of the plate, feet.
pub const PLATE_FRONT_Y_FT: f64 = 17.0 / 12.0;
/// Middle of the plate, feet.
pub const PLATE_MIDDLE_Y_FT: f64 = 8.5 / 12.0;
/// Gravity as Statcast's movement columns take it, ft/s².
pub const STATCAST_GRAVITY_FTPS2: f64 = 32.174;

/// r(t) = r0 + v0·t + a·t²/2; feet and seconds, t = 0 at y = 50 ft.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NineParameter {
    /// x0, 50, z0, ft.
    pub position_ft: Vector3<f64>,
    /// vx0, vy0, vz0, ft/s.
    pub velocity_ftps: Vector3<f64>,
    /// ax, ay, az, ft/s².
    pub acceleration_ftps2: Vector3<f64>,
}

/// Release-to-plate movement without gravity along the line of flight, feet.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Movement {
    /// pfx_x, ft.
    pub x_ft: f64,
    /// pfx_z, ft.
    pub z_ft: f64,
}

impl NineParameter {
    /// Time at which the ball crosses `y_ft` on its way to the plate:
    /// t_Y = (−vy0 − sqrt(vy0² − 2·ay·(50 − Y)))/ay; `None` if it never does.
    pub fn time_at_y(&self, y_ft: f64) -> Option<f64> {
        let (drop, v, a) = (
            self.position_ft.y - y_ft,
            self.velocity_ftps.y,
            self.acceleration_ftps2.y,
        );
        if a.abs() < 1e-9 {
            return (v != 0.0).then(|| -drop / v);
        }
        let discriminant = v * v - 2.0 * a * drop;
        (discriminant >= 0.0).then(|| (-v - discriminant.sqrt()) / a)
    }

    /// Position at `time_s`, ft.
    pub fn position(&self, time_s: f64) -> Vector3<f64> {
        self.position_ft + self.velocity_ftps * time_s + self.acceleration_ftps2 * (0.5 * time_s * time_s)
    }

    /// Velocity at `time_s`, ft/s.
    pub fn velocity(&self, time_s: f64) -> Vector3<f64> {
        self.velocity_ftps + self.acceleration_ftps2 * time_s
    }

    /// Speed at `y_ft`, mph.
    pub fn speed_at_y_mph(&self, y_ft: f64) -> Option<f64> {
        self.time_at_y(y_ft)
            .map(|t| self.velocity(t).norm() * FOOT_M / MPH_MPS)
    }

    /// pfx_x = ½(ax − ay·vx/vy)·T², pfx_z = ½(az + g − ay·vz/vy)·T², v at release, T release → 17/12 ft.
    pub fn movement(&self, release_y_ft: f64) -> Option<Movement> {
        let release = self.time_at_y(release_y_ft)?;
        let flight_s = self.time_at_y(PLATE_FRONT_Y_FT)? - release;
        let v = self.velocity(release);
        let a = &self.acceleration_ftps2;
        let half_t2 = 0.5 * flight_s * flight_s;
        Some(Movement {
            x_ft: (a.x - a.y * v.x / v.y) * half_t2,
            z_ft: (a.z + STATCAST_GRAVITY_FTPS2 - a.y * v.z / v.y) * half_t2,
        })
    }

    /// Least-squares parabola through `(seconds, metres)` samples, restated at y = 50 ft.
    /// `None` for fewer than three samples or a flight that never crosses y = 50 ft.
    pub fn fit(samples: &[(f64, Vector3<f64>)]) -> Option<Self> {
        if samples.len() < 3 {
            return None;
        }
        let middle = samples.iter().map(|s| s.0).sum::<f64>() / samples.len() as f64;
        let mut normal = Matrix3::zeros();
        let mut right = Matrix3::zeros();
        for (time_s, position_m) in samples {
            let t = time_s - middle;
            let row = Vector3::new(1.0, t, 0.5 * t * t);
            normal += row * row.transpose();
            right += row * (position_m / FOOT_M).transpose();
        }
        let solved = normal.try_inverse()? * right;
        let at_middle = Self {
            position_ft: solved.row(0).transpose(),
            velocity_ftps: solved.row(1).transpose(),
            acceleration_ftps2: solved.row(2).transpose(),
        };
        let start = at_middle.time_at_y(REFERENCE_Y_FT)?;
        Some(Self {
            position_ft: at_middle.position(start),
            velocity_ftps: at_middle.velocity(start),
            acceleration_ftps2: at_middle.acceleration_ftps2,
        })
    }
}
