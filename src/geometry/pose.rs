//! Rigid camera poses, `camera_from_world`.

use nalgebra::{Matrix3, Point3, Rotation3, Vector3};
use serde::{Deserialize, Serialize};

/// A camera's pose: `x_c = R·X_w + t` (metres).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// R of camera_from_world.
    pub rotation: Rotation3<f64>,
    /// t of camera_from_world, metres.
    pub translation_m: Vector3<f64>,
}

impl Pose {
    /// The camera sits at the world's origin and looks along its +z.
    pub fn identity() -> Self {
        Self {
            rotation: Rotation3::identity(),
            translation_m: Vector3::zeros(),
        }
    }

    /// A camera at `centre_m` that looks at `target_m`, its image's up as close to world +z as can be.
    pub fn looking_at(centre_m: Point3<f64>, target_m: Point3<f64>) -> Self {
        let forward = (target_m - centre_m).normalize();
        let mut up = Vector3::z();
        if forward.cross(&up).norm() < 1e-9 {
            up = Vector3::y();
        }
        let right = forward.cross(&up).normalize();
        let down = forward.cross(&right);
        let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_rows(&[
            right.transpose(),
            down.transpose(),
            forward.transpose(),
        ]));
        Self {
            rotation,
            translation_m: -(rotation * centre_m.coords),
        }
    }

    /// World point to camera coordinates, metres.
    pub fn transform(&self, world_m: &Point3<f64>) -> Vector3<f64> {
        self.rotation * world_m.coords + self.translation_m
    }

    /// Camera coordinates to world, metres.
    pub fn inverse_transform(&self, camera_m: &Vector3<f64>) -> Point3<f64> {
        Point3::from(self.rotation.inverse() * (camera_m - self.translation_m))
    }

    /// The camera's centre −Rᵀt in world coordinates, metres.
    pub fn centre_m(&self) -> Point3<f64> {
        Point3::from(-(self.rotation.inverse() * self.translation_m))
    }

    /// `camera_from_world` of the perturbed camera: `x_c' = exp([ω]×)·x_c + υ`.
    /// `delta` is (ω₁ ω₂ ω₃ rad, υ₁ υ₂ υ₃ m); ∂x_c/∂ω = −[x_c]×, ∂x_c/∂υ = I.
    pub fn perturbed(&self, delta: &[f64; 6]) -> Self {
        let turn = rotation_from_vector(&Vector3::new(delta[0], delta[1], delta[2]));
        Self {
            rotation: turn * self.rotation,
            translation_m: turn * self.translation_m + Vector3::new(delta[3], delta[4], delta[5]),
        }
    }

    /// `a_from_c = a_from_b ∘ b_from_c` with `self` = a_from_b.
    pub fn compose(&self, b_from_c: &Pose) -> Pose {
        Pose {
            rotation: self.rotation * b_from_c.rotation,
            translation_m: self.rotation * b_from_c.translation_m + self.translation_m,
        }
    }

    /// The inverse transform.
    pub fn inverse(&self) -> Pose {
        let rotation = self.rotation.inverse();
        Pose {
            rotation,
            translation_m: -(rotation * self.translation_m),
        }
    }
}

/// exp([ω]×) by Rodrigues' formula.
pub fn rotation_from_vector(omega: &Vector3<f64>) -> Rotation3<f64> {
    Rotation3::new(*omega)
}

/// [v]×, so that `skew(v)·w = v × w`.
pub fn skew(v: &Vector3<f64>) -> Matrix3<f64> {
    v.cross_matrix()
}

#[derive(Serialize, Deserialize)]
struct PoseOnDisk {
    rotation: [[f64; 3]; 3],
    translation_m: [f64; 3],
}

impl Serialize for Pose {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let m = self.rotation.matrix();
        PoseOnDisk {
            rotation: std::array::from_fn(|r| std::array::from_fn(|c| m[(r, c)])),
            translation_m: self.translation_m.into(),
        }
        .serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Pose {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let disk = PoseOnDisk::deserialize(deserializer)?;
        let m = Matrix3::from_fn(|r, c| disk.rotation[r][c]);
        let finite = m.iter().chain(&disk.translation_m).all(|v| v.is_finite());
        if !finite || (m * m.transpose() - Matrix3::identity()).norm() > 1e-4 || m.determinant() < 0.0 {
            return Err(serde::de::Error::custom(
                "`rotation` is not a proper rotation matrix (rows orthonormal, determinant +1)",
            ));
        }
        Ok(Pose {
            // A printed matrix is orthonormal only to its digits; the nearest rotation is meant.
            rotation: Rotation3::from_matrix_eps(&m, 1e-15, 100, Rotation3::from_matrix_unchecked(m)),
            translation_m: disk.translation_m.into(),
        })
    }
}
