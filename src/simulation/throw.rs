//! From a pitch as the scenario has it to its true flight: spin, aim, Statcast numbers.

use nalgebra::{Point3, Vector3};

use super::error::SimulationError;
use super::flight::{Flight, FlightEnd, FlightState, Forces, Transverse, transverse_axes};
use super::scenario::{FlightLaw, NineNumbers, PitchSpec, SiteSpec};

const FOOT: f64 = 0.3048;
/// Front of the plate, y = 17/12 ft, metres.
pub const PLATE_FRONT_Y_M: f64 = 17.0 / 12.0 * FOOT;
/// Middle of the plate, y = 8.5/12 ft, metres.
pub const PLATE_MIDDLE_Y_M: f64 = 8.5 / 12.0 * FOOT;
/// Plane at which release numbers are compared, y = 54.5 ft, metres.
pub const RELEASE_PLANE_Y_M: f64 = 54.5 * FOOT;
/// Where the catcher's glove stops a pitch, y in metres.
const GLOVE_Y_M: f64 = -0.45;
/// No flight lasts longer, seconds.
const LONGEST_S: f64 = 4.0;

/// A ball in the air: its flight and what made it.
#[derive(Debug, Clone, PartialEq)]
pub struct ThrownBall {
    /// For people.
    pub name: String,
    /// Release, seconds after the epoch, true time.
    pub start_s: f64,
    /// Cd.
    pub drag_coefficient: f64,
    /// Spin vector, rpm, where the flight was made from spin.
    pub spin_rpm: Option<[f64; 3]>,
    /// The flight, time from release.
    pub flight: Flight,
}

impl ThrownBall {
    /// The ball at a true time, seconds after the epoch.
    pub fn position_m(&self, true_s: f64) -> Point3<f64> {
        self.flight.position_m(true_s - self.start_s)
    }
    /// First and last instant of the flight, seconds after the epoch.
    pub fn span_s(&self) -> (f64, f64) {
        (self.start_s, self.start_s + self.flight.end_s)
    }
}

/// Makes the flight of one pitch or throw; `key` names it in errors.
pub(super) fn throw(
    spec: &PitchSpec,
    start_s: f64,
    site: &SiteSpec,
    key: &str,
) -> Result<ThrownBall, SimulationError> {
    let fail = |field: &str, problem: &str| Err(SimulationError::value(format!("{key}.{field}"), problem));
    let end = FlightEnd {
        y_m: spec.end_y_m.or(spec.end_after_s.is_none().then_some(GLOVE_Y_M)),
        after_s: spec.end_after_s.unwrap_or(LONGEST_S),
    };
    let mut forces = Forces {
        gravity_mps2: site.gravity_mps2,
        air_density_kgpm3: site.air_density_kgpm3,
        wind_mps: site.wind_mps.into(),
        drag_coefficient: 0.0,
        transverse: Transverse::None,
    };
    if let Some(nine) = &spec.statcast {
        if spec.release_m.is_some() || spec.velocity_mps.is_some() || spec.speed_mps.is_some() {
            return fail(
                "statcast",
                "the nine numbers already say release and velocity: leave those out",
            );
        }
        let flight = from_nine(nine, spec.model, &mut forces, end).ok_or_else(|| {
            SimulationError::value(format!("{key}.statcast"), "these numbers never reach the plate")
        })?;
        return Ok(thrown(spec, start_s, &forces, None, flight));
    }
    if spec.model == FlightLaw::ConstantAcceleration {
        return fail("model", "constant_acceleration needs `statcast` numbers");
    }
    let Some(release) = spec.release_m.map(Point3::from) else {
        return fail("release_m", "missing (or give `statcast`)");
    };
    let aim = match (spec.velocity_mps, spec.speed_mps, spec.target_m) {
        (Some(v), None, None) => Aim::Velocity(Vector3::from(v)),
        (None, Some(speed_mps), Some([x, z])) => Aim::Target {
            speed_mps,
            point: Point3::new(x, spec.target_y_m.unwrap_or(PLATE_FRONT_Y_M), z),
        },
        _ => {
            return fail(
                "velocity_mps",
                "give either `velocity_mps`, or `speed_mps` and `target_m`",
            );
        }
    };
    let rpm = spin_rpm(spec, &release, &aim, key)?;
    let rate_krpm = rpm.map_or(0.0, |s| Vector3::from(s).norm() / 1000.0);
    forces.drag_coefficient = spec.drag_coefficient.unwrap_or(0.297 + 0.0292 * rate_krpm);
    forces.transverse = transverse(spec, rpm);
    let velocity = match aim {
        Aim::Velocity(v) => v,
        Aim::Target { speed_mps, point } => {
            aimed_velocity(&forces, release, speed_mps, point).ok_or_else(|| {
                SimulationError::value(
                    format!("{key}.target_m"),
                    format!("cannot be reached at {speed_mps} m/s"),
                )
            })?
        }
    };
    let flight = Flight::integrate(&forces, release, velocity, end);
    Ok(thrown(spec, start_s, &forces, rpm, flight))
}

fn thrown(
    spec: &PitchSpec,
    start_s: f64,
    forces: &Forces,
    spin_rpm: Option<[f64; 3]>,
    flight: Flight,
) -> ThrownBall {
    ThrownBall {
        name: spec.name.clone(),
        start_s,
        drag_coefficient: forces.drag_coefficient,
        spin_rpm,
        flight,
    }
}

enum Aim {
    Velocity(Vector3<f64>),
    Target { speed_mps: f64, point: Point3<f64> },
}

/// The spin vector in rpm: as given, or from rate, tilt and active share. Tilt 180° is ω = −x (backspin of a
/// ball that flies to −y), so ω = (cos φ, 0, sin φ)·active, the rest along the flight.
fn spin_rpm(
    spec: &PitchSpec,
    release: &Point3<f64>,
    aim: &Aim,
    key: &str,
) -> Result<Option<[f64; 3]>, SimulationError> {
    match (spec.spin_vector_rpm, spec.spin_rpm, spec.spin_axis_deg) {
        (None, None, None) => Ok(None),
        (Some(vector), None, None) => Ok(Some(vector)),
        (None, Some(rate), Some(axis)) => {
            let active = spec.active_spin.unwrap_or(1.0).clamp(0.0, 1.0);
            let along = match aim {
                Aim::Velocity(v) => v.normalize(),
                Aim::Target { point, .. } => (point - release).normalize(),
            };
            let phi = axis.to_radians();
            let tilt = Vector3::new(phi.cos(), 0.0, phi.sin());
            let across = (tilt - along * tilt.dot(&along)).normalize();
            let omega = rate * (across * active + along * (1.0 - active * active).sqrt());
            Ok(Some(omega.into()))
        }
        _ => Err(SimulationError::value(
            format!("{key}.spin_rpm"),
            "give `spin_vector_rpm`, or `spin_rpm` with `spin_axis_deg`",
        )),
    }
}

fn transverse(spec: &PitchSpec, rpm: Option<[f64; 3]>) -> Transverse {
    match (&spec.knuckle, rpm) {
        (Some(k), _) => Transverse::Swinging {
            amplitude: k.amplitude,
            frequency_radps: k.frequency_hz * std::f64::consts::TAU,
            phase_rad: k.phase_deg.map(f64::to_radians),
        },
        (None, Some(spin)) => Transverse::Spin(Vector3::from(spin) * (std::f64::consts::TAU / 60.0)),
        (None, None) => Transverse::None,
    }
}

/// Direction at which a ball of this speed meets the target: the aim point moves by the miss until it is < 1 nm.
fn aimed_velocity(
    forces: &Forces,
    release: Point3<f64>,
    speed_mps: f64,
    target: Point3<f64>,
) -> Option<Vector3<f64>> {
    let mut aim = target;
    let end = FlightEnd {
        y_m: Some(target.y),
        after_s: LONGEST_S,
    };
    for _ in 0..60 {
        let velocity = (aim - release).normalize() * speed_mps;
        let flight = Flight::integrate(forces, release, velocity, end);
        let miss = flight.position_m(flight.time_at_y(target.y)?) - target;
        if miss.norm() < 1e-9 {
            return Some(velocity);
        }
        // A lob's answer is weaker than its aim: damping keeps the iteration a contraction.
        aim -= Vector3::new(miss.x, 0.0, miss.z) * 0.9;
    }
    None
}

/// A flight through the nine numbers: as they stand, or physics with the drag and transverse force they show at
/// mid-flight, aimed at their plate point.
fn from_nine(nine: &NineNumbers, law: FlightLaw, forces: &mut Forces, end: FlightEnd) -> Option<Flight> {
    let r50 = Point3::new(nine.x0, 50.0, nine.z0) * FOOT;
    let v50 = Vector3::new(nine.vx0, nine.vy0, nine.vz0) * FOOT;
    let a = Vector3::new(nine.ax, nine.ay, nine.az) * FOOT;
    let at = |t: f64| FlightState {
        position_m: r50 + v50 * t + a * (0.5 * t * t),
        velocity_mps: v50 + a * t,
        acceleration_mps2: a,
    };
    let time_at = |y: f64| {
        let root = v50.y * v50.y - 2.0 * a.y * (r50.y - y);
        (root >= 0.0 && a.y.abs() > 1e-9).then(|| (-v50.y - root.sqrt()) / a.y)
    };
    let release = at(time_at(nine.release_pos_y * FOOT)?);
    let t_plate = time_at(PLATE_FRONT_Y_M)?;
    if law == FlightLaw::ConstantAcceleration {
        return Some(Flight::constant_acceleration(release, end));
    }
    let middle = at(0.5 * t_plate);
    let air = middle.velocity_mps - forces.wind_mps;
    let force = a + Vector3::new(0.0, 0.0, forces.gravity_mps2);
    let scale = forces.drag_scale_perm() * air.norm_squared();
    let (right, above) = transverse_axes(&air);
    forces.drag_coefficient = -force.dot(&air.normalize()) / scale;
    forces.transverse = Transverse::Coefficients([force.dot(&right) / scale, force.dot(&above) / scale]);
    let speed = release.velocity_mps.norm();
    let velocity = aimed_velocity(forces, release.position_m, speed, at(t_plate).position_m)?;
    Some(Flight::integrate(forces, release.position_m, velocity, end))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Domain §4: real pitches, the nine numbers and the plate points reported for them (feet).
    fn vectors() -> Vec<(NineNumbers, [f64; 2], [f64; 2])> {
        let nine = |n: [f64; 9]| NineNumbers {
            x0: n[0],
            z0: n[1],
            vx0: n[2],
            vy0: n[3],
            vz0: n[4],
            ax: n[5],
            ay: n[6],
            az: n[7],
            release_pos_y: n[8],
        };
        vec![
            (
                nine([
                    -0.9001, 6.1657, 3.8351, -128.8867, -6.0460, -3.8055, 27.5059, -12.9495, 54.31,
                ]),
                [0.314, 2.784],
                [0.328, 2.717],
            ),
            (
                nine([
                    -1.1480, 5.9186, 1.2845, -117.0051, -0.0903, 2.3033, 21.7438, -38.0715, 53.96,
                ]),
                [-0.377, 2.317],
                [-0.362, 2.207],
            ),
            (
                nine([
                    -1.1849, 5.7138, 3.5024, -92.1384, 4.6877, 6.3260, 14.8070, -40.6506, 55.15,
                ]),
                [1.710, 2.113],
                [1.770, 1.961],
            ),
        ]
    }

    #[test]
    fn nine_numbers_reproduce_the_reported_plate_points() {
        for (nine, front, middle) in vectors() {
            for (model, front_tolerance_ft, middle_tolerance_ft) in [
                (FlightLaw::ConstantAcceleration, 0.0006, 0.0006),
                // Physics is aimed at the front point; a few mm of other curvature are left at the middle.
                (FlightLaw::Physics, 0.0006, 0.01),
            ] {
                let spec = PitchSpec {
                    statcast: Some(nine),
                    model,
                    ..PitchSpec::default()
                };
                let ball = throw(&spec, 0.0, &SiteSpec::default(), "pitch").unwrap();
                for (y, truth, tolerance) in [
                    (PLATE_FRONT_Y_M, front, front_tolerance_ft),
                    (PLATE_MIDDLE_Y_M, middle, middle_tolerance_ft),
                ] {
                    let r = ball.flight.position_m(ball.flight.time_at_y(y).unwrap());
                    assert!((r.x / FOOT - truth[0]).abs() < tolerance, "{model:?} {r}");
                    assert!((r.z / FOOT - truth[1]).abs() < tolerance, "{model:?} {r}");
                }
            }
        }
    }

    #[test]
    fn an_aimed_pitch_meets_its_target() {
        for (speed, target) in [(42.0, [0.2, 0.7]), (25.0, [-0.3, 0.9])] {
            let spec = PitchSpec {
                release_m: Some([-0.6, 16.6, 1.8]),
                speed_mps: Some(speed),
                target_m: Some(target),
                spin_rpm: Some(2300.0),
                spin_axis_deg: Some(215.0),
                ..PitchSpec::default()
            };
            let ball = throw(&spec, 3.0, &SiteSpec::default(), "pitch").unwrap();
            let t = ball.flight.time_at_y(PLATE_FRONT_Y_M).unwrap();
            let r = ball.flight.position_m(t);
            assert!((r.x - target[0]).abs() < 1e-8 && (r.z - target[1]).abs() < 1e-8);
            assert!((ball.flight.state(0.0).velocity_mps.norm() - speed).abs() < 1e-9);
        }
    }
}
