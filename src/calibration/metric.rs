//! From a reconstruction of unknown scale and direction to metres with z up: gravity, drag and what a pitch is.

use nalgebra::{Matrix3, Point3, Rotation3, SMatrix, SVector, Vector3};

use crate::geometry::{Pose, rotation_from_vector};
use crate::scene::{BALL_MASS_KG, BALL_RADIUS_M};

/// Middle of a path: velocity and acceleration in units of the reconstruction.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Motion {
    pub velocity: Vector3<f64>,
    pub acceleration: Vector3<f64>,
}

/// What is known of the air and the place.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Air {
    pub gravity_mps2: f64,
    pub density_kgpm3: f64,
}

/// Metres per unit and the direction that is up, with how badly a pitch of this size would break physics.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Upgrade {
    pub scale_m: f64,
    pub up: Vector3<f64>,
    /// Mean squared standardised violation.
    pub penalty: f64,
}

/// Middle of the prior for a pitch's drag coefficient (domain §2), and half the ball's area over its mass.
const DRAG_COEFFICIENT: f64 = 0.35;
/// πr²/2m, m²/kg.
const HALF_AREA_OVER_MASS: f64 = std::f64::consts::PI * BALL_RADIUS_M * BALL_RADIUS_M / (2.0 * BALL_MASS_KG);
/// Speed of a pitch in the middle of its flight, m/s, and its spread in the logarithm.
const SPEED_MPS: f64 = 37.0;
const SPEED_SIGMA: f64 = 0.15;
/// Spread of drag and of lift across the flight, m/s²; lift is upwards on average.
const DRAG_SIGMA_MPS2: f64 = 1.5;
const LIFT_SIGMA_MPS2: f64 = 4.0;
const LIFT_MEAN_MPS2: f64 = 2.0;
/// Descent of a pitch: sine of the angle, and its spread.
const DESCENT: f64 = 0.06;
const DESCENT_SIGMA: f64 = 0.08;
/// A camera's own up is up to within this, radians, per axis.
const LEVEL_SIGMA: f64 = 0.35;

/// Scale and up that make the motions pitches. `scale_m`, `up`: known beforehand, where they are; `level`: where up
/// would be if the camera stood level. `None` without motions.
pub(crate) fn upgrade(
    motions: &[Motion],
    level: &Vector3<f64>,
    air: Air,
    (scale_m, up): (Option<f64>, Option<Vector3<f64>>),
) -> Option<Upgrade> {
    let speeds: Vec<f64> = motions
        .iter()
        .map(|m| m.velocity.norm())
        .filter(|v| *v > 0.0)
        .collect();
    if speeds.is_empty() {
        return None;
    }
    let mean_speed = speeds.iter().sum::<f64>() / speeds.len() as f64;
    let mut state = (
        scale_m.unwrap_or(SPEED_MPS / mean_speed).ln(),
        up.unwrap_or(*level).normalize(),
    );
    let moved = |state: &(f64, Vector3<f64>), d: &SVector<f64, 3>| {
        let log_scale = if scale_m.is_some() {
            state.0
        } else {
            state.0 + d[0]
        };
        if up.is_some() {
            return (log_scale, state.1);
        }
        let helper = if state.1.x.abs() < 0.7 {
            Vector3::x()
        } else {
            Vector3::y()
        };
        let a = state.1.cross(&helper).normalize();
        let b = state.1.cross(&a);
        (log_scale, (state.1 + a * d[1] + b * d[2]).normalize())
    };
    let residuals = |s: &(f64, Vector3<f64>)| residuals(motions, level, air, s);
    for _ in 0..25 {
        let here = residuals(&state);
        let mut normal = SMatrix::<f64, 3, 3>::identity() * 1e-6;
        let mut gradient = SVector::<f64, 3>::zeros();
        let columns: Vec<Vec<f64>> = (0..3)
            .map(|k| {
                let mut d = SVector::<f64, 3>::zeros();
                d[k] = 1e-5;
                residuals(&moved(&state, &d))
                    .iter()
                    .zip(&here)
                    .map(|(a, b)| (a - b) / 1e-5)
                    .collect()
            })
            .collect();
        for (i, r) in here.iter().enumerate() {
            let weight = 1.0 / (1.0 + (r / 3.0).powi(2));
            let row = SVector::<f64, 3>::new(columns[0][i], columns[1][i], columns[2][i]);
            normal += row * row.transpose() * weight;
            gradient += row * (r * weight);
        }
        let mut step = -(normal.cholesky()?.solve(&gradient));
        if step.norm() > 0.3 {
            step *= 0.3 / step.norm();
        }
        state = moved(&state, &step);
        if step.norm() < 1e-7 {
            break;
        }
    }
    let last = residuals(&state);
    let sum: f64 = last.iter().map(|r| (r * r).min(100.0)).sum();
    Some(Upgrade {
        scale_m: state.0.exp(),
        up: state.1,
        penalty: sum / last.len() as f64,
    })
}

fn residuals(motions: &[Motion], level: &Vector3<f64>, air: Air, state: &(f64, Vector3<f64>)) -> Vec<f64> {
    let (scale, up) = (state.0.exp(), state.1);
    let mut all = Vec::with_capacity(5 * motions.len() + 3);
    for m in motions {
        let velocity = m.velocity * scale;
        let speed = velocity.norm().max(1e-9);
        let along = velocity / speed;
        let drag = HALF_AREA_OVER_MASS * air.density_kgpm3 * DRAG_COEFFICIENT * speed * speed;
        // What gravity and drag leave over is lift, across the flight.
        let rest = m.acceleration * scale + up * air.gravity_mps2 + along * drag;
        let across = rest - along * rest.dot(&along) - up * LIFT_MEAN_MPS2;
        all.push(rest.dot(&along) / DRAG_SIGMA_MPS2);
        all.extend((across / LIFT_SIGMA_MPS2).iter());
        all.push((along.dot(&up) + DESCENT) / DESCENT_SIGMA);
        all.push((speed / SPEED_MPS).ln() / SPEED_SIGMA);
    }
    all.extend(((up - level) / LEVEL_SIGMA).iter());
    all
}

/// World of a reconstruction turned upright: z along `up`, y along the horizontal part of the reference camera's
/// view, origin at its centre, metres.
pub(crate) fn upright(poses: &mut [Option<Pose>], reference: usize, upgrade: &Upgrade) {
    let Some(camera) = poses.get(reference).copied().flatten() else {
        return;
    };
    let forward = camera.rotation.inverse() * Vector3::z();
    let z = upgrade.up.normalize();
    let mut y = forward - z * forward.dot(&z);
    if y.norm() < 1e-6 {
        y = z.cross(&Vector3::x());
    }
    let y = y.normalize();
    let x = y.cross(&z);
    let new_from_old =
        Rotation3::from_matrix_unchecked(Matrix3::from_rows(&[x.transpose(), y.transpose(), z.transpose()]));
    let origin = camera.centre_m();
    for pose in poses.iter_mut().flatten() {
        *pose = scaled(pose, &origin, upgrade.scale_m, &new_from_old);
    }
}

/// The pose after the world has been moved: new = scale·R·(old − origin).
fn scaled(pose: &Pose, origin: &Point3<f64>, scale: f64, new_from_old: &Rotation3<f64>) -> Pose {
    let centre = new_from_old * (pose.centre_m() - origin) * scale;
    let rotation = pose.rotation * new_from_old.inverse();
    Pose {
        rotation,
        translation_m: -(rotation * centre),
    }
}

/// Moves a reconstruction so that camera `anchor` gets the pose it is known to have, with lengths times `scale_m`.
pub(crate) fn anchored(poses: &mut [Option<Pose>], anchor: usize, known: &Pose, scale_m: f64) {
    let Some(camera) = poses.get(anchor).copied().flatten() else {
        return;
    };
    let new_from_old = known.rotation.inverse() * camera.rotation;
    let origin = camera.centre_m();
    let target = known.centre_m();
    for pose in poses.iter_mut().flatten() {
        let mut next = scaled(pose, &origin, scale_m, &new_from_old);
        next.translation_m -= next.rotation * target.coords;
        *pose = next;
    }
}

/// A rotation that is not quite one after many products, made one again.
pub(crate) fn orthonormal(pose: &Pose) -> Pose {
    let mut rotation = pose.rotation;
    rotation.renormalize();
    Pose {
        rotation: rotation_from_vector(&rotation.scaled_axis()),
        translation_m: pose.translation_m,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scale_and_up_come_back_from_real_shaped_motions() {
        let air = Air {
            gravity_mps2: 9.80665,
            density_kgpm3: 1.194,
        };
        let turn = Rotation3::new(Vector3::new(0.3, -1.1, 2.0));
        let scale = 23.0;
        let pitches = [
            ([1.5, -39.0, -2.0], [3.0, 3.0]),
            ([-1.0, -35.0, -1.0], [-2.0, -3.5]),
            ([0.5, -41.0, -3.0], [-1.0, 5.0]),
            ([-1.5, -37.0, -1.5], [1.0, 2.0]),
        ];
        let motions: Vec<Motion> = pitches
            .iter()
            .map(|(v, lift)| {
                let v = Vector3::from(*v);
                let drag = -v * v.norm() * HALF_AREA_OVER_MASS * 1.194 * 0.34;
                let a = drag + Vector3::new(lift[0], 0.0, lift[1] - 9.80665);
                Motion {
                    velocity: turn * v / scale,
                    acceleration: turn * a / scale,
                }
            })
            .collect();
        // A camera rolled by ten degrees.
        let level = turn * (Rotation3::new(Vector3::new(0.0, 0.17, 0.0)) * Vector3::z());
        let found = upgrade(&motions, &level, air, (None, None)).unwrap();
        assert!((found.scale_m / scale - 1.0).abs() < 0.1, "{}", found.scale_m);
        assert!(found.up.angle(&(turn * Vector3::z())).to_degrees() < 15.0);
        assert!(found.penalty < 1.5, "{}", found.penalty);
        // The mirror image speeds up and falls upwards.
        let mirrored: Vec<Motion> = motions
            .iter()
            .map(|m| Motion {
                acceleration: -m.acceleration,
                ..*m
            })
            .collect();
        let wrong = upgrade(&mirrored, &level, air, (None, None)).unwrap();
        assert!(
            wrong.penalty > 4.0 * found.penalty,
            "{} {}",
            wrong.penalty,
            found.penalty
        );
    }

    #[test]
    fn an_upright_world_keeps_what_the_cameras_see() {
        let a = Pose::looking_at(Point3::new(3.0, 4.0, 5.0), Point3::new(0.0, 0.0, 1.0));
        let b = Pose::looking_at(Point3::new(-3.0, 4.0, 4.0), Point3::new(0.0, 0.0, 1.0));
        let turn = Rotation3::new(Vector3::new(0.3, -1.1, 2.0));
        let mut poses: Vec<_> = [a, b]
            .iter()
            .map(|p| Some(scaled(p, &Point3::new(1.0, 2.0, 3.0), 0.1, &turn)))
            .collect();
        let up = turn * Vector3::z();
        upright(
            &mut poses,
            0,
            &Upgrade {
                scale_m: 10.0,
                up,
                penalty: 0.0,
            },
        );
        let (a2, b2) = (poses[0].unwrap(), poses[1].unwrap());
        assert!((a2.centre_m().coords).norm() < 1e-9);
        assert!(((a2.centre_m() - b2.centre_m()).norm() - (a.centre_m() - b.centre_m()).norm()).abs() < 1e-9);
        assert!((a2.rotation.inverse() * a.rotation * Vector3::z() - Vector3::z()).norm() < 1e-9);
        anchored(&mut poses, 1, &b, 1.0);
        assert!((poses[0].unwrap().centre_m() - a.centre_m()).norm() < 1e-9);
        assert!((orthonormal(&poses[0].unwrap()).rotation.matrix() - a.rotation.matrix()).norm() < 1e-9);
    }
}
