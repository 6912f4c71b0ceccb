//! Pinhole camera with Brown distortion (OpenCV order k1 k2 p1 p2 k3) and its derivatives.

use nalgebra::{Matrix2, Matrix2x3, Vector2, Vector3};
use serde::{Deserialize, Serialize};

/// A point of the image as the sensor has it (distorted), pixels; the centre of the top-left pixel is (0, 0).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Pixel {
    /// Column, to the right.
    pub x: f64,
    /// Row, downwards.
    pub y: f64,
}

impl Pixel {
    /// Column and row.
    pub const fn new(x: f64, y: f64) -> Self {
        Self { x, y }
    }
    /// As a vector.
    pub fn vector(self) -> Vector2<f64> {
        Vector2::new(self.x, self.y)
    }
}

/// A viewing direction x_c/z_c, y_c/z_c: no lens, no pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Normalized {
    /// x_c / z_c.
    pub x: f64,
    /// y_c / z_c.
    pub y: f64,
}

/// Why a pixel has no direction or a point no pixel.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LensError {
    /// The point lies behind the camera or in its plane.
    #[error("point is not in front of the camera (depth {depth_m} m)")]
    Behind {
        /// Depth z_c in metres.
        depth_m: f64,
    },
    /// The distortion could not be inverted there.
    #[error("lens distortion cannot be inverted at pixel ({x:.1}, {y:.1})")]
    NotInvertible {
        /// Column.
        x: f64,
        /// Row.
        y: f64,
    },
}

/// A pixel with its derivative by the point in camera coordinates.
#[derive(Debug, Clone, Copy)]
pub struct PixelJacobian {
    /// The pixel.
    pub pixel: Pixel,
    /// ∂pixel/∂x_c, px/m.
    pub by_camera_point: Matrix2x3<f64>,
}

/// Focal lengths, principal point and distortion of one camera.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Intrinsics {
    /// Focal length along columns, pixels.
    pub fx_px: f64,
    /// Focal length along rows, pixels.
    pub fy_px: f64,
    /// Principal point, column, pixels.
    pub cx_px: f64,
    /// Principal point, row, pixels.
    pub cy_px: f64,
    /// k1 k2 p1 p2 k3 (OpenCV order); a file may leave out k3.
    #[serde(default, deserialize_with = "four_or_five")]
    pub distortion: [f64; 5],
}

fn four_or_five<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<[f64; 5], D::Error> {
    let given = <Vec<f64> as Deserialize>::deserialize(deserializer)?;
    match *given.as_slice() {
        [] => Ok([0.0; 5]),
        [k1, k2, p1, p2] => Ok([k1, k2, p1, p2, 0.0]),
        [k1, k2, p1, p2, k3] => Ok([k1, k2, p1, p2, k3]),
        _ => Err(serde::de::Error::custom(format!(
            "{} distortion coefficients, where k1 k2 p1 p2 and k3 are meant",
            given.len()
        ))),
    }
}

impl Intrinsics {
    /// Normalised direction to normalised distorted coordinates, with the 2×2 derivative.
    fn distort(&self, x: f64, y: f64) -> (Vector2<f64>, Matrix2<f64>) {
        let [k1, k2, p1, p2, k3] = self.distortion;
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let radial_r2 = k1 + r2 * (2.0 * k2 + 3.0 * k3 * r2);
        let xd = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x);
        let yd = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y;
        let xy = 2.0 * x * y * radial_r2 + 2.0 * p1 * x + 2.0 * p2 * y;
        let jacobian = Matrix2::new(
            radial + 2.0 * x * x * radial_r2 + 2.0 * p1 * y + 6.0 * p2 * x,
            xy,
            xy,
            radial + 2.0 * y * y * radial_r2 + 6.0 * p1 * y + 2.0 * p2 * x,
        );
        (Vector2::new(xd, yd), jacobian)
    }

    /// The pixel at which a direction is seen.
    pub fn pixel(&self, direction: Normalized) -> Pixel {
        let (d, _) = self.distort(direction.x, direction.y);
        Pixel::new(self.fx_px * d.x + self.cx_px, self.fy_px * d.y + self.cy_px)
    }

    /// Projects a point in camera coordinates (metres) to a distorted pixel.
    pub fn project(&self, camera_m: &Vector3<f64>) -> Result<Pixel, LensError> {
        self.project_with_jacobian(camera_m).map(|p| p.pixel)
    }

    /// Projects a point in camera coordinates (metres), with the derivative by that point.
    pub fn project_with_jacobian(&self, camera_m: &Vector3<f64>) -> Result<PixelJacobian, LensError> {
        let z = camera_m.z;
        // Also refuses NaN.
        if !(z > 1e-6) {
            return Err(LensError::Behind { depth_m: z });
        }
        let (x, y) = (camera_m.x / z, camera_m.y / z);
        let (d, distort) = self.distort(x, y);
        let normalise = Matrix2x3::new(1.0 / z, 0.0, -x / z, 0.0, 1.0 / z, -y / z);
        let focal = Matrix2::new(self.fx_px, 0.0, 0.0, self.fy_px);
        Ok(PixelJacobian {
            pixel: Pixel::new(self.fx_px * d.x + self.cx_px, self.fy_px * d.y + self.cy_px),
            by_camera_point: focal * distort * normalise,
        })
    }

    /// The direction seen at a distorted pixel: Newton on the distortion, to 1e-12.
    pub fn direction(&self, pixel: Pixel) -> Result<Normalized, LensError> {
        let target = Vector2::new(
            (pixel.x - self.cx_px) / self.fx_px,
            (pixel.y - self.cy_px) / self.fy_px,
        );
        let mut guess = target;
        for _ in 0..50 {
            let (distorted, jacobian) = self.distort(guess.x, guess.y);
            let miss = distorted - target;
            if miss.norm() < 1e-13 {
                break;
            }
            let Some(inverse) = jacobian.try_inverse() else {
                break;
            };
            let mut step = inverse * miss;
            // A strong lens folds far outside the image; short steps keep Newton on the near branch.
            if step.norm() > 0.3 {
                step *= 0.3 / step.norm();
            }
            guess -= step;
        }
        let (distorted, jacobian) = self.distort(guess.x, guess.y);
        if (distorted - target).norm() < 1e-9 && jacobian.determinant() > 0.0 {
            Ok(Normalized {
                x: guess.x,
                y: guess.y,
            })
        } else {
            Err(LensError::NotInvertible {
                x: pixel.x,
                y: pixel.y,
            })
        }
    }
}
