//! Best similarity transform between two sets of points (Umeyama 1991).

use nalgebra::{Matrix3, Point3, Rotation3, Vector3};

/// `y = scale·R·x + t`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Similarity {
    /// Ratio of lengths, to over from.
    pub scale: f64,
    /// Rotation.
    pub rotation: Rotation3<f64>,
    /// Translation, in units of the target.
    pub translation: Vector3<f64>,
}

impl Similarity {
    /// Maps a point.
    pub fn transform(&self, point: &Point3<f64>) -> Point3<f64> {
        Point3::from(self.scale * (self.rotation * point.coords) + self.translation)
    }
}

/// Least-squares similarity that takes each `from` point to its `to` point; `None` for fewer than three
/// pairs, different lengths, or points that all coincide.
pub fn align_similarity(from: &[Point3<f64>], to: &[Point3<f64>]) -> Option<Similarity> {
    if from.len() != to.len() || from.len() < 3 {
        return None;
    }
    let n = from.len() as f64;
    let mean = |points: &[Point3<f64>]| points.iter().fold(Vector3::zeros(), |s, p| s + p.coords) / n;
    let (from_mean, to_mean) = (mean(from), mean(to));
    let mut cross = Matrix3::zeros();
    let mut spread = 0.0;
    for (a, b) in from.iter().zip(to) {
        let da = a.coords - from_mean;
        cross += (b.coords - to_mean) * da.transpose() / n;
        spread += da.norm_squared() / n;
    }
    if !(spread > 0.0) {
        return None;
    }
    let svd = cross.svd(true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    let mut sign = Matrix3::identity();
    if (u * v_t).determinant() < 0.0 {
        sign[(2, 2)] = -1.0;
    }
    let rotation = Rotation3::from_matrix_unchecked(u * sign * v_t);
    let scale = (Matrix3::from_diagonal(&svd.singular_values) * sign).trace() / spread;
    Some(Similarity {
        scale,
        rotation,
        translation: to_mean - scale * (rotation * from_mean),
    })
}
