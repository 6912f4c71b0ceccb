//! A pitch as a cubic polynomial in space, fitted linearly to the rays of posed cameras: the inner problem of
//! the search for initial values.

use nalgebra::{Matrix3, Point3, SMatrix, SVector, Vector3};

use crate::geometry::{Normalized, Pose};

const TERMS: usize = 4;
const SIZE: usize = 3 * TERMS;

/// One sample of a curve, at its true time.
#[derive(Debug, Clone, Copy)]
pub struct Ray {
    /// Index of the camera's pose.
    pub camera: usize,
    /// True time, seconds.
    pub time_s: f64,
    /// Direction.
    pub direction: Normalized,
    /// Focal length over the noise of the sample: what a unit of direction weighs.
    pub focal_px: f64,
}

/// What is known of a path before any ray, in the world's units.
#[derive(Debug, Clone, Copy)]
pub struct PathPrior {
    /// Expected acceleration.
    pub acceleration: Vector3<f64>,
    /// 1σ of it per axis; infinite: nothing known.
    pub acceleration_sigma: Vector3<f64>,
    /// 1σ of the jerk per axis about zero.
    pub jerk_sigma: f64,
    /// Rough distance from the cameras, for the weights.
    pub depth: f64,
}

impl PathPrior {
    /// A pitch in the home-plate frame: gravity, drag towards +y, lift of any direction.
    pub fn pitch(gravity_mps2: f64) -> Self {
        Self {
            acceleration: Vector3::new(0.0, 7.0, 2.0 - gravity_mps2),
            acceleration_sigma: Vector3::new(6.0, 6.0, 6.0),
            jerk_sigma: 15.0,
            depth: 25.0,
        }
    }

    /// Nothing known but smoothness at the scale of `depth`.
    pub fn smooth(depth: f64) -> Self {
        Self {
            acceleration: Vector3::zeros(),
            acceleration_sigma: Vector3::repeat(2.0 * depth),
            jerk_sigma: 2.0 * depth,
            depth,
        }
    }
}

/// A cubic path in space.
#[derive(Debug, Clone, Copy)]
pub struct Path {
    middle_s: f64,
    half_s: f64,
    coefficients: SMatrix<f64, 3, TERMS>,
}

fn powers(s: f64) -> SVector<f64, TERMS> {
    SVector::<f64, TERMS>::new(1.0, s, s * s, s * s * s)
}

impl Path {
    /// Least-squares path through the rays; `None` where they do not determine one.
    pub fn fit(poses: &[Pose], rays: &[Ray], prior: &PathPrior) -> Option<Self> {
        let mut path = Self::fit_weighted(poses, rays, prior, None)?;
        // The algebraic error is the image error times the depth: once more with the depths found.
        if let Some(better) = Self::fit_weighted(poses, rays, prior, Some(&path)) {
            path = better;
        }
        Some(path)
    }

    fn fit_weighted(poses: &[Pose], rays: &[Ray], prior: &PathPrior, last: Option<&Self>) -> Option<Self> {
        let first_s = rays.iter().map(|r| r.time_s).fold(f64::INFINITY, f64::min);
        let last_s = rays.iter().map(|r| r.time_s).fold(f64::NEG_INFINITY, f64::max);
        if !(last_s > first_s) {
            return None;
        }
        let (middle_s, half_s) = (0.5 * (first_s + last_s), 0.5 * (last_s - first_s));
        let mut normal = SMatrix::<f64, SIZE, SIZE>::zeros();
        let mut right = SVector::<f64, SIZE>::zeros();
        for ray in rays {
            let pose = poses.get(ray.camera)?;
            let depth = last.map_or(prior.depth, |p| {
                let z = pose.transform(&p.position(ray.time_s)).z;
                if z > 0.05 * prior.depth { z } else { prior.depth }
            });
            let (block, pull) = ray_equations(pose, ray, ray.focal_px / depth);
            let b = powers((ray.time_s - middle_s) / half_s);
            for i in 0..TERMS {
                for j in 0..TERMS {
                    let mut part = normal.fixed_view_mut::<3, 3>(3 * i, 3 * j);
                    part += block * (b[i] * b[j]);
                }
                let mut part = right.fixed_rows_mut::<3>(3 * i);
                part += pull * b[i];
            }
        }
        for axis in 0..3 {
            // X = Σ c_n s^n, s = t/h: acceleration 2·c2/h², jerk 6·c3/h³.
            let (by_a, by_j) = (2.0 / half_s.powi(2), 6.0 / half_s.powi(3));
            let weight = prior.acceleration_sigma[axis].powi(-2);
            normal[(6 + axis, 6 + axis)] += weight * by_a * by_a;
            right[6 + axis] += weight * by_a * prior.acceleration[axis];
            normal[(9 + axis, 9 + axis)] += by_j * by_j / (prior.jerk_sigma * prior.jerk_sigma);
        }
        let solution = normal.cholesky()?.solve(&right);
        let coefficients = SMatrix::<f64, 3, TERMS>::from_column_slice(solution.as_slice());
        coefficients.iter().all(|c| c.is_finite()).then_some(Self {
            middle_s,
            half_s,
            coefficients,
        })
    }

    /// Position.
    pub fn position(&self, time_s: f64) -> Point3<f64> {
        Point3::from(self.coefficients * powers((time_s - self.middle_s) / self.half_s))
    }

    /// Velocity.
    pub fn velocity(&self, time_s: f64) -> Vector3<f64> {
        let s = (time_s - self.middle_s) / self.half_s;
        let d = SVector::<f64, TERMS>::new(0.0, 1.0, 2.0 * s, 3.0 * s * s);
        self.coefficients * d / self.half_s
    }

    /// Acceleration in the middle of the path.
    pub fn acceleration(&self) -> Vector3<f64> {
        self.coefficients.column(2) * (2.0 / self.half_s.powi(2))
    }

    /// Residuals of the prior (acceleration, jerk), sigmas.
    pub fn prior_residuals(&self, prior: &PathPrior) -> [f64; 6] {
        let a = (self.acceleration() - prior.acceleration).component_div(&prior.acceleration_sigma);
        let j = self.coefficients.column(3) * (6.0 / self.half_s.powi(3) / prior.jerk_sigma);
        [a.x, a.y, a.z, j[0], j[1], j[2]]
    }

    /// Whether a time lies within the rays' time.
    pub fn covers(&self, time_s: f64) -> bool {
        (time_s - self.middle_s).abs() <= self.half_s
    }

    /// Middle of the rays' time.
    pub fn middle_s(&self) -> f64 {
        self.middle_s
    }

    /// Residuals of the rays in the image, sigmas (both coordinates); rays from behind count as `behind` each.
    pub fn residuals(&self, poses: &[Pose], rays: &[Ray], behind: f64) -> Vec<[f64; 2]> {
        rays.iter()
            .map(|ray| match poses.get(ray.camera) {
                Some(pose) => {
                    let c = pose.transform(&self.position(ray.time_s));
                    if c.z > 1e-9 {
                        let r = [
                            ray.focal_px * (c.x / c.z - ray.direction.x),
                            ray.focal_px * (c.y / c.z - ray.direction.y),
                        ];
                        r.map(|v| v.clamp(-behind, behind))
                    } else {
                        [behind; 2]
                    }
                }
                None => [behind; 2],
            })
            .collect()
    }
}

/// Normal equations of one ray for the point it goes through: (u·r3 − r1)·X = t1 − u·t3, and so for v.
fn ray_equations(pose: &Pose, ray: &Ray, weight: f64) -> (Matrix3<f64>, Vector3<f64>) {
    let r = pose.rotation.matrix();
    let t = &pose.translation_m;
    let mut block = Matrix3::zeros();
    let mut pull = Vector3::zeros();
    for (axis, value) in [ray.direction.x, ray.direction.y].into_iter().enumerate() {
        let row = (r.row(2) * value - r.row(axis)).transpose() * weight;
        let target = (t[axis] - value * t.z) * weight;
        block += row * row.transpose();
        pull += row * target;
    }
    (block, pull)
}
