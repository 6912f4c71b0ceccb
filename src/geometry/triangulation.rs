//! A 3-D point from its pixels in two or more posed cameras.

use nalgebra::{Matrix3, Matrix4, MatrixXx4, Point3, RowVector4, Vector3};

use super::{Intrinsics, Normalized, Pixel, Pose};

/// Why no point could be had.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TriangulationError {
    /// Fewer than two views.
    #[error("{views} view(s): a point needs two")]
    TooFewViews {
        /// Views given.
        views: usize,
    },
    /// The rays are parallel to working accuracy, or meet behind a camera.
    #[error("the rays do not meet in front of the cameras")]
    NoIntersection,
}

/// Linear triangulation (DLT, Hartley & Zisserman §12.2) from normalised directions.
pub fn triangulate_dlt(views: &[(Pose, Normalized)]) -> Result<Point3<f64>, TriangulationError> {
    if views.len() < 2 {
        return Err(TriangulationError::TooFewViews { views: views.len() });
    }
    let row = |view: usize, k: usize| {
        let (pose, n) = &views[view];
        let value = if k == 0 { n.x } else { n.y };
        let depth = pose.rotation.matrix().row(2) * value - pose.rotation.matrix().row(k);
        let own = value * pose.translation_m.z - pose.translation_m[k];
        RowVector4::new(depth[0], depth[1], depth[2], own)
    };
    let square = if views.len() == 2 {
        Matrix4::from_rows(&[row(0, 0), row(0, 1), row(1, 0), row(1, 1)])
    } else {
        // R of A = QR has A's singular values and right vectors: the small problem stays four by four.
        let rows: Vec<_> = (0..2 * views.len()).map(|i| row(i / 2, i % 2)).collect();
        MatrixXx4::from_rows(&rows)
            .qr()
            .r()
            .fixed_view::<4, 4>(0, 0)
            .into_owned()
    };
    let svd = square.svd(false, true);
    let v_t = svd.v_t.ok_or(TriangulationError::NoIntersection)?;
    let smallest = svd.singular_values.imin();
    let h = v_t.row(smallest);
    if h[3].abs() < 1e-12 {
        return Err(TriangulationError::NoIntersection);
    }
    let point = Point3::new(h[0] / h[3], h[1] / h[3], h[2] / h[3]);
    if views.iter().any(|(pose, _)| !(pose.transform(&point).z > 0.0)) {
        return Err(TriangulationError::NoIntersection);
    }
    Ok(point)
}

/// Least-squares triangulation in pixels: DLT, then Gauss–Newton on the reprojection error.
/// Returns the point (metres) and its covariance for unit pixel noise (m² per px²).
pub fn triangulate_refined(
    views: &[(Pose, Intrinsics, Pixel)],
) -> Result<(Point3<f64>, Matrix3<f64>), TriangulationError> {
    let directions: Vec<_> = views
        .iter()
        .map(|(pose, lens, pixel)| lens.direction(*pixel).map(|n| (*pose, n)))
        .collect::<Result<_, _>>()
        .map_err(|_| TriangulationError::NoIntersection)?;
    let mut point = triangulate_dlt(&directions)?;
    let mut inverse = Matrix3::zeros();
    for _ in 0..10 {
        let mut normal = Matrix3::zeros();
        let mut gradient = Vector3::zeros();
        for (pose, lens, pixel) in views {
            let projected = lens
                .project_with_jacobian(&pose.transform(&point))
                .map_err(|_| TriangulationError::NoIntersection)?;
            let j = projected.by_camera_point * pose.rotation.matrix();
            normal += j.transpose() * j;
            gradient += j.transpose() * (projected.pixel.vector() - pixel.vector());
        }
        inverse = normal.try_inverse().ok_or(TriangulationError::NoIntersection)?;
        let step = inverse * gradient;
        point -= step;
        if step.norm() < 1e-10 {
            break;
        }
    }
    Ok((point, inverse))
}
