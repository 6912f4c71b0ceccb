//! The five-point solver: every essential matrix that five correspondences allow.

use nalgebra::Matrix3;
use opencv::calib3d;
use opencv::core::{Mat, Point2d, Vector};
use opencv::prelude::*;

use super::VisionError;
use crate::geometry::Normalized;

/// All essential matrices E (x2ᵀ·E·x1 = 0, unit Frobenius norm) through exactly five correspondences
/// (Nistér 2004, OpenCV's solver): none to ten. Whatever is not finite or has not the singular values
/// (σ, σ, 0) of an essential matrix is dropped.
pub fn five_point(pairs: &[[Normalized; 2]; 5]) -> Result<Vec<Matrix3<f64>>, VisionError> {
    let side = |k: usize| -> Vector<Point2d> { pairs.iter().map(|p| Point2d::new(p[k].x, p[k].y)).collect() };
    let (first, second) = (side(0), side(1));
    let identity = Mat::eye(3, 3, opencv::core::CV_64F)?.to_mat()?;
    let mut mask = Mat::default();
    // With exactly five points OpenCV returns all roots stacked, without sampling: the robust part is ours,
    // so that it is MLESAC, seeded, and never hangs.
    let stacked = calib3d::find_essential_mat(
        &first,
        &second,
        &identity,
        calib3d::RANSAC,
        0.999,
        1.0,
        1,
        &mut mask,
    )?;
    let mut solutions = Vec::new();
    for block in 0..stacked.rows() / 3 {
        let mut e = Matrix3::zeros();
        for row in 0..3 {
            let values = stacked.at_row::<f64>(3 * block + row)?;
            for (column, value) in values.iter().take(3).enumerate() {
                e[(row as usize, column)] = *value;
            }
        }
        if let Some(e) = checked(&e) {
            solutions.push(e);
        }
    }
    Ok(solutions)
}

fn checked(e: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    let norm = e.norm();
    if !norm.is_finite() || norm < 1e-12 {
        return None;
    }
    let e = e / norm;
    let s = e.singular_values();
    let (most, middle, least) = (s.max(), s.sum() - s.max() - s.min(), s.min());
    (middle > 0.95 * most && least < 0.05 * most).then_some(e)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Pose, skew};
    use nalgebra::Point3;

    #[test]
    fn one_of_the_solutions_is_the_true_essential_matrix() {
        let a = Pose::looking_at(Point3::new(20.0, 5.0, 3.0), Point3::new(0.0, 9.0, 1.0));
        let b = Pose::looking_at(Point3::new(-19.0, 6.0, 4.0), Point3::new(0.0, 8.0, 1.0));
        let b_from_a = b.compose(&a.inverse());
        let mut truth = skew(&b_from_a.translation_m) * b_from_a.rotation.matrix();
        truth /= truth.norm();
        let points = [
            [0.3, 17.0, 1.8],
            [-0.2, 1.0, 0.7],
            [0.9, 9.0, 1.5],
            [-0.8, 12.0, 0.3],
            [0.1, 5.0, 2.2],
        ];
        let pairs = points.map(|p| {
            let world = Point3::from(p);
            [a, b].map(|pose| {
                let c = pose.transform(&world);
                Normalized {
                    x: c.x / c.z,
                    y: c.y / c.z,
                }
            })
        });
        let found = five_point(&pairs).unwrap();
        assert!(!found.is_empty());
        let miss = found
            .iter()
            .map(|e| (e - truth).norm().min((e + truth).norm()))
            .fold(f64::INFINITY, f64::min);
        assert!(miss < 1e-6, "closest of {} is {miss} away", found.len());
    }
}
