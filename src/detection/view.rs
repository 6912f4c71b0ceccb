//! What a lens makes of a ball away from the middle of its picture: the circle is an ellipse, and the light comes from elsewhere.

use nalgebra::{Matrix2, Matrix3, Vector3};

use crate::geometry::{Intrinsics, Pixel};

/// A ball as it is seen at one pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// Offset on the ball across the line of sight (as on the lens's axis, at the same depth) to offset in the picture.
    pub shape: Matrix2<f64>,
    /// A direction in the camera's axes (right, down, against its view) to the axes of the line of sight (right, down,
    /// towards the camera).
    pub turn: Matrix3<f64>,
}

impl Default for View {
    /// On the lens's axis.
    fn default() -> Self {
        Self {
            shape: Matrix2::identity(),
            turn: Matrix3::identity(),
        }
    }
}

impl View {
    /// At a pixel of a lens; as on the axis where there is none, or where it cannot be inverted.
    pub fn of(lens: Option<&Intrinsics>, pixel: Pixel) -> Self {
        lens.and_then(|lens| Self::at(lens, pixel)).unwrap_or_default()
    }

    fn at(lens: &Intrinsics, pixel: Pixel) -> Option<Self> {
        let direction = lens.direction(pixel).ok()?;
        let at = Vector3::new(direction.x, direction.y, 1.0);
        let by_point = lens.project_with_jacobian(&at).ok()?.by_camera_point;
        // The circle lies across the line of sight; its axes are as near to the picture's as can be.
        let toward = -at.normalize();
        let right = toward.cross(&Vector3::y()).try_normalize(1e-9)?;
        let down = right.cross(&toward);
        let focal_px = (lens.fx_px * lens.fy_px).sqrt();
        let shape = Matrix2::from_columns(&[by_point * right, by_point * down]) / focal_px;
        let against_view = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, -1.0));
        let turn =
            Matrix3::from_rows(&[right.transpose(), down.transpose(), toward.transpose()]) * against_view;
        (0.25..4.0)
            .contains(&shape.determinant())
            .then_some(Self { shape, turn })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LENS: Intrinsics = Intrinsics {
        fx_px: 1000.0,
        fy_px: 1000.0,
        cx_px: 1023.5,
        cy_px: 511.5,
        distortion: [0.0; 5],
    };

    #[test]
    fn on_the_axis_a_sphere_is_a_circle() {
        let View { shape, turn } = View::at(&LENS, Pixel::new(1023.5, 511.5)).unwrap();
        assert!((shape - Matrix2::identity()).norm() < 1e-12, "{shape}");
        assert!((turn - Matrix3::identity()).norm() < 1e-12, "{turn}");
    }

    #[test]
    fn to_the_side_it_is_longer_by_the_cosine() {
        // tan θ = 0.75, cos θ = 0.8: across the radius f·R/z, along it f·R/(z·cos θ).
        let View { shape, turn } = View::at(&LENS, Pixel::new(1023.5 + 750.0, 511.5)).unwrap();
        assert!(
            (shape - Matrix2::new(1.25, 0.0, 0.0, 1.0)).norm() < 1e-12,
            "{shape}"
        );
        // Light from behind the camera comes, there, from the right: (x, −z)·(0.8, 0.6) = 0.6, and 0.8 from the front.
        let behind_camera = turn * Vector3::new(0.0, 0.0, 1.0);
        assert!(
            (behind_camera - Vector3::new(0.6, 0.0, 0.8)).norm() < 1e-12,
            "{turn}"
        );
        let View { shape, turn } = View::at(&LENS, Pixel::new(1023.5, 511.5 + 750.0)).unwrap();
        // Of a ball below the axis the camera sees the top: light from above is 0.6 from the front.
        let above = turn * Vector3::new(0.0, -1.0, 0.0);
        assert!((above - Vector3::new(0.0, -0.8, 0.6)).norm() < 1e-12, "{turn}");
        assert!(
            (shape - Matrix2::new(1.0, 0.0, 0.0, 1.25)).norm() < 1e-12,
            "{shape}"
        );
    }

    #[test]
    fn the_outline_of_a_sphere_is_the_shape_s_ellipse() {
        // By brute force: rays that touch a small sphere of radius R at depth z, through a lens with distortion.
        let lens = Intrinsics {
            distortion: [-0.08, 0.02, 0.0004, -0.0003, 0.0],
            ..LENS
        };
        let (centre, radius) = (Vector3::new(9.0, -3.0, 20.0), 0.0368);
        let toward = centre.normalize();
        let across = toward.cross(&Vector3::x()).normalize();
        let seen = lens.project(&centre).unwrap();
        let shape = View::at(&lens, seen).unwrap().shape;
        let on_axis = shape.try_inverse().unwrap();
        for k in 0..12 {
            let turn = nalgebra::Rotation3::from_axis_angle(
                &nalgebra::Unit::new_normalize(toward),
                f64::from(k) * std::f64::consts::TAU / 12.0,
            );
            let touch = centre + turn * across * radius;
            let off = lens.project(&touch).unwrap().vector() - seen.vector();
            let expected = 1000.0 * radius / 20.0;
            assert!(
                ((on_axis * off).norm() - expected).abs() < 2e-3 * expected,
                "{k}: {off}"
            );
        }
    }
}
