//! Perspective-n-point: rough camera poses from points of known position.

use nalgebra::{Matrix3, Point3, Rotation3, Vector3};
use opencv::calib3d::{self, SolvePnPMethod};
use opencv::core::{Mat, Point2d, Point3d, Vec3d, Vector};
use opencv::prelude::*;

use super::VisionError;
use crate::geometry::{Normalized, Pose};

/// Candidate poses (unrefined) of a camera that sees `world_m[i]` in direction `directions[i]`.
///
/// SQPNP over all points, and both solutions of the planar problem (IPPE) over the points of the best plane,
/// because a plane seen from afar has two poses that look nearly the same. Three points or fewer than three
/// distinct directions may give nothing: the list is then empty. Candidates that put a point behind the camera
/// are left out.
pub fn resection_candidates(
    world_m: &[Point3<f64>],
    directions: &[Normalized],
) -> Result<Vec<Pose>, VisionError> {
    if world_m.len() != directions.len() || world_m.len() < 3 {
        return Ok(Vec::new());
    }
    let mut candidates = Vec::new();
    candidates.extend(solve(world_m, directions, SolvePnPMethod::SOLVEPNP_SQPNP)?);
    let (plane, distances) = best_plane(world_m);
    let near: Vec<usize> = (0..world_m.len())
        .filter(|&i| distances[i].abs() < plane.tolerance_m)
        .collect();
    if near.len() >= 4 {
        // IPPE wants exact coplanarity: the points are moved into the plane for the rough pose only.
        let flat: Vec<_> = near
            .iter()
            .map(|&i| world_m[i] - plane.normal * distances[i])
            .collect();
        let seen: Vec<_> = near.iter().map(|&i| directions[i]).collect();
        candidates.extend(solve(&flat, &seen, SolvePnPMethod::SOLVEPNP_IPPE)?);
    }
    if world_m.len() >= 6 {
        candidates.extend(solve(world_m, directions, SolvePnPMethod::SOLVEPNP_EPNP)?);
    }
    candidates.retain(|pose| world_m.iter().all(|p| pose.transform(p).z > 0.0));
    Ok(candidates)
}

struct Plane {
    normal: Vector3<f64>,
    tolerance_m: f64,
}

/// The plane most points lie in, from triples of points, and every point's distance to it.
fn best_plane(points: &[Point3<f64>]) -> (Plane, Vec<f64>) {
    let spread = points
        .iter()
        .flat_map(|a| points.iter().map(move |b| (a - b).norm()))
        .fold(0.0, f64::max);
    let tolerance_m = 0.01 * spread;
    let mut best = (Vector3::z(), points[0], 0usize);
    let n = points.len().min(24);
    for i in 0..n {
        for j in i + 1..n {
            for k in j + 1..n {
                let normal = (points[j] - points[i]).cross(&(points[k] - points[i]));
                if normal.norm() < 1e-6 * spread * spread {
                    continue;
                }
                let normal = normal.normalize();
                let count = points
                    .iter()
                    .filter(|p| (*p - points[i]).dot(&normal).abs() < tolerance_m)
                    .count();
                if count > best.2 {
                    best = (normal, points[i], count);
                }
            }
        }
    }
    let (normal, origin, _) = best;
    let distances = points.iter().map(|p| (p - origin).dot(&normal)).collect();
    (Plane { normal, tolerance_m }, distances)
}

fn solve(
    world_m: &[Point3<f64>],
    directions: &[Normalized],
    method: SolvePnPMethod,
) -> Result<Vec<Pose>, VisionError> {
    let object: Vector<Point3d> = world_m.iter().map(|p| Point3d::new(p.x, p.y, p.z)).collect();
    let image: Vector<Point2d> = directions.iter().map(|d| Point2d::new(d.x, d.y)).collect();
    let identity = Mat::eye(3, 3, opencv::core::CV_64F)?.to_mat()?;
    let (none, mut error) = (Mat::default(), Mat::default());
    let (mut rotations, mut translations) = (Vector::<Mat>::new(), Vector::<Mat>::new());
    // Degenerate input makes some of OpenCV's solvers throw; that is "no candidate", not a failure.
    let solved = calib3d::solve_pnp_generic(
        &object,
        &image,
        &identity,
        &none,
        &mut rotations,
        &mut translations,
        false,
        method,
        &none,
        &none,
        &mut error,
    );
    if solved.is_err() {
        return Ok(Vec::new());
    }
    let mut poses = Vec::new();
    for (rotation, translation) in rotations.iter().zip(translations.iter()) {
        let (Some(omega), Some(t)) = (vector3(&rotation)?, vector3(&translation)?) else {
            continue;
        };
        let rotation = Rotation3::new(omega);
        if rotation.matrix() != &Matrix3::zeros() {
            poses.push(Pose {
                rotation,
                translation_m: t,
            });
        }
    }
    Ok(poses)
}

fn vector3(mat: &Mat) -> Result<Option<Vector3<f64>>, VisionError> {
    if mat.total() != 3 {
        return Ok(None);
    }
    let v = if mat.typ() == opencv::core::CV_64FC3 {
        let v = mat.at::<Vec3d>(0)?;
        Vector3::new(v[0], v[1], v[2])
    } else {
        Vector3::new(*mat.at::<f64>(0)?, *mat.at::<f64>(1)?, *mat.at::<f64>(2)?)
    };
    Ok(v.iter().all(|x| x.is_finite()).then_some(v))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::FieldPreset;

    #[test]
    fn the_true_pose_is_among_the_candidates() {
        let field = FieldPreset::Professional;
        let world: Vec<_> = field.landmarks().into_iter().map(|(_, p)| p).collect();
        let centres = [
            [20.0, 6.0, 3.0],
            [-18.0, 3.0, 2.5],
            [2.0, -25.0, 9.0],
            [30.0, -12.0, 12.0],
        ];
        let mut cases = 0;
        for centre in centres {
            let truth = Pose::looking_at(Point3::from(centre), Point3::new(0.0, 8.0, 1.0));
            for keep in [4, 6, 12, world.len()] {
                let (mut points, mut seen) = (Vec::new(), Vec::new());
                for p in &world {
                    let c = truth.transform(p);
                    if c.z > 1.0 && points.len() < keep {
                        points.push(*p);
                        seen.push(Normalized {
                            x: c.x / c.z,
                            y: c.y / c.z,
                        });
                    }
                }
                let found = resection_candidates(&points, &seen).unwrap();
                let miss = found
                    .iter()
                    .map(|p| (p.centre_m() - truth.centre_m()).norm())
                    .fold(f64::INFINITY, f64::min);
                // Points moved into the plane make the candidate rough; refinement is the caller's.
                assert!(miss < 1.5, "{keep} points from {centre:?}: {miss} m");
                cases += 1;
            }
        }
        assert_eq!(cases, 16);
    }
}
