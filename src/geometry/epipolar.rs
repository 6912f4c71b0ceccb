//! Two views: the essential matrix, its Sampson distance and its four poses.

use nalgebra::{Matrix3, Rotation3, Vector3};

use super::{Normalized, Pose, skew, triangulate_dlt};

/// E = [t]×·R of `second_from_first`, so that x2ᵀ·E·x1 = 0.
pub fn essential_matrix(second_from_first: &Pose) -> Matrix3<f64> {
    skew(&second_from_first.translation_m) * second_from_first.rotation.matrix()
}

/// Sampson distance of a correspondence in pixels, signed: the algebraic error over its standard deviation
/// for unit pixel noise in both images (Hartley & Zisserman eq. 11.9, with a focal length per camera).
pub fn sampson_px(e: &Matrix3<f64>, pair: &[Normalized; 2], focal_px: [f64; 2]) -> f64 {
    let x1 = Vector3::new(pair[0].x, pair[0].y, 1.0);
    let x2 = Vector3::new(pair[1].x, pair[1].y, 1.0);
    let line2 = e * x1;
    let line1 = e.transpose() * x2;
    let variance = (line2.x * line2.x + line2.y * line2.y) / (focal_px[1] * focal_px[1])
        + (line1.x * line1.x + line1.y * line1.y) / (focal_px[0] * focal_px[0]);
    x2.dot(&line2) / variance.sqrt().max(1e-300)
}

/// The four `second_from_first` poses (|t| = 1) of an essential matrix: a twisted pair and its mirror images.
pub fn decompose_essential(e: &Matrix3<f64>) -> Option<[Pose; 4]> {
    let svd = e.svd(true, true);
    let (mut u, mut v_t) = (svd.u?, svd.v_t?);
    if !u.iter().chain(v_t.iter()).all(|x| x.is_finite()) {
        return None;
    }
    // nalgebra sorts the singular values; the third column of U is the left null vector.
    if u.determinant() < 0.0 {
        u = -u;
    }
    if v_t.determinant() < 0.0 {
        v_t = -v_t;
    }
    let w = Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
    let t: Vector3<f64> = u.column(2).into_owned();
    let turns = [u * w * v_t, u * w.transpose() * v_t].map(Rotation3::from_matrix_unchecked);
    Some([
        Pose {
            rotation: turns[0],
            translation_m: t,
        },
        Pose {
            rotation: turns[0],
            translation_m: -t,
        },
        Pose {
            rotation: turns[1],
            translation_m: t,
        },
        Pose {
            rotation: turns[1],
            translation_m: -t,
        },
    ])
}

/// The pose of the four that has most points in front of both cameras, and how many that are.
pub fn cheirality(e: &Matrix3<f64>, pairs: &[[Normalized; 2]]) -> Option<(Pose, usize)> {
    let in_front = |pose: &Pose| {
        let seen = |p: &&[Normalized; 2]| triangulate_dlt(&[(Pose::identity(), p[0]), (*pose, p[1])]).is_ok();
        pairs.iter().filter(seen).count()
    };
    decompose_essential(e)?
        .into_iter()
        .map(|pose| (pose, in_front(&pose)))
        .max_by_key(|(_, count)| *count)
        .filter(|(_, count)| *count > 0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    fn two_views() -> (Pose, Vec<[Normalized; 2]>) {
        let a = Pose::looking_at(Point3::new(18.0, 4.0, 3.0), Point3::new(0.0, 9.0, 1.0));
        let b = Pose::looking_at(Point3::new(17.0, -6.0, 2.5), Point3::new(0.0, 9.0, 1.0));
        let second_from_first = b.compose(&a.inverse());
        let pairs = (0..30)
            .map(|i| {
                let s = f64::from(i) / 30.0;
                let p = Point3::new(
                    0.7 * (9.0 * s).sin(),
                    18.0 * (1.0 - s),
                    2.0 - s + 0.4 * (5.0 * s).cos(),
                );
                [a, b].map(|pose| {
                    let c = pose.transform(&p);
                    Normalized {
                        x: c.x / c.z,
                        y: c.y / c.z,
                    }
                })
            })
            .collect();
        (second_from_first, pairs)
    }

    #[test]
    fn cheirality_takes_the_true_pose_of_the_four() {
        let (truth, pairs) = two_views();
        let e = essential_matrix(&truth);
        for p in &pairs {
            assert!(sampson_px(&e, p, [1800.0; 2]).abs() < 1e-9);
        }
        let (found, count) = cheirality(&e, &pairs).unwrap();
        assert_eq!(count, pairs.len());
        assert!(found.rotation.angle_to(&truth.rotation) < 1e-6);
        assert!((found.translation_m - truth.translation_m.normalize()).norm() < 1e-6);
        // The sign of E means nothing.
        let (again, _) = cheirality(&-e, &pairs).unwrap();
        assert!((again.translation_m - found.translation_m).norm() < 1e-6);
    }

    #[test]
    fn sampson_distance_is_in_pixels() {
        let (truth, pairs) = two_views();
        let e = essential_matrix(&truth);
        // One image moved by 1 px across its epipolar line: H&Z's first-order distance is 1/√2 to 1 px.
        let mut moved = pairs[10];
        let line = e * Vector3::new(moved[0].x, moved[0].y, 1.0);
        let n = (line.x * line.x + line.y * line.y).sqrt();
        moved[1].x += line.x / n / 1800.0;
        moved[1].y += line.y / n / 1800.0;
        let d = sampson_px(&e, &moved, [1800.0; 2]).abs();
        assert!((0.6..=1.0).contains(&d), "{d}");
    }
}
