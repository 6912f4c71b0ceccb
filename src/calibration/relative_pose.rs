//! Relative pose of two cameras from correspondences: five-point inside MLESAC, then maximum likelihood.

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use rand::Rng;
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use super::CalibrationError;
use crate::geometry::{Normalized, Pose, cheirality, essential_matrix, rotation_from_vector, sampson_px};
use crate::vision::five_point;

/// What the robust search takes for granted.
#[derive(Debug, Clone, Copy)]
pub struct MlesacOptions {
    /// Minimal samples drawn.
    pub samples: usize,
    /// 1σ of a coordinate, pixels.
    pub sigma_px: f64,
    /// Range ν of the outliers' uniform distribution, pixels.
    pub outlier_range_px: f64,
    /// Seed of the sampling.
    pub seed: u64,
    /// Focal lengths of the two cameras, pixels.
    pub focal_px: [f64; 2],
    /// Refinement steps over all points after the search (Torr & Zisserman's step 4); 0: none.
    pub refinements: usize,
}

/// `second_from_first` with |t| = 1, and how well it explains the correspondences.
#[derive(Debug, Clone, Copy)]
pub struct RelativePose {
    /// The pose.
    pub second_from_first: Pose,
    /// Negative log-likelihood over the number of correspondences.
    pub cost: f64,
    /// Root mean square Sampson distance of the inliers, pixels.
    pub rms_px: f64,
    /// Correspondences more likely right than wrong.
    pub inliers: usize,
    /// Correspondences in front of both cameras.
    pub in_front: usize,
}

/// Best relative pose [Torr & Zisserman 2000 over Nistér 2004], the same for the same seed.
/// `starts` are poses to try beside the samples (an earlier answer at a neighbouring delay).
/// `None` where no sample gives an essential matrix with a point in front of both cameras.
pub fn mlesac(
    pairs: &[[Normalized; 2]],
    starts: &[Pose],
    options: &MlesacOptions,
) -> Result<Option<RelativePose>, CalibrationError> {
    if pairs.len() < 5 {
        return Ok(None);
    }
    let mut rng = Pcg64Mcg::seed_from_u64(options.seed);
    let mut best: Option<(f64, Matrix3<f64>)> = None;
    let mut consider = |e: Matrix3<f64>| {
        let cost = negative_log_likelihood(&e, pairs, options).0;
        if best.is_none_or(|(least, _)| cost < least) {
            best = Some((cost, e));
        }
    };
    for start in starts {
        consider(essential_matrix(start));
    }
    for _ in 0..options.samples {
        let Some(sample) = draw_five(pairs, &mut rng) else {
            break;
        };
        for e in five_point(&sample)? {
            consider(e);
        }
    }
    let Some((_, e)) = best else {
        return Ok(None);
    };
    let Some((mut pose, _)) = cheirality(&e, &thinned(pairs)) else {
        return Ok(None);
    };
    for _ in 0..options.refinements {
        pose = refine(&pose, pairs, options);
    }
    Ok(Some(judge(&pose, pairs, options)))
}

/// Cost and counts of a given relative pose.
pub fn judge(pose: &Pose, pairs: &[[Normalized; 2]], options: &MlesacOptions) -> RelativePose {
    let e = essential_matrix(pose);
    let (cost, weights) = negative_log_likelihood(&e, pairs, options);
    let mut sum = (0.0, 0.0, 0);
    for (pair, weight) in pairs.iter().zip(&weights) {
        let d = sampson_px(&e, pair, options.focal_px);
        sum = (
            sum.0 + weight * d * d,
            sum.1 + weight,
            sum.2 + usize::from(*weight > 0.5),
        );
    }
    let few = thinned(pairs);
    let front = few.iter().filter(|p| in_front(pose, p)).count();
    RelativePose {
        second_from_first: *pose,
        cost,
        rms_px: (sum.0 / sum.1.max(1e-12)).sqrt(),
        inliers: sum.2,
        in_front: front * pairs.len() / few.len().max(1),
    }
}

fn in_front(pose: &Pose, pair: &[Normalized; 2]) -> bool {
    crate::geometry::triangulate_dlt(&[(Pose::identity(), pair[0]), (*pose, pair[1])]).is_ok()
}

/// At most forty of the correspondences, evenly spread: enough to tell front from behind.
fn thinned(pairs: &[[Normalized; 2]]) -> Vec<[Normalized; 2]> {
    pairs
        .iter()
        .step_by(pairs.len().div_ceil(40).max(1))
        .copied()
        .collect()
}

fn draw_five(pairs: &[[Normalized; 2]], rng: &mut Pcg64Mcg) -> Option<[[Normalized; 2]; 5]> {
    let mut picked: Vec<usize> = Vec::with_capacity(5);
    for _ in 0..200 {
        let i = rng.random_range(0..pairs.len());
        if !picked.contains(&i) {
            picked.push(i);
        }
        if let Ok(five) = <[usize; 5]>::try_from(picked.as_slice()) {
            return Some(five.map(|i| pairs[i]));
        }
    }
    None
}

/// Mean negative log-likelihood of the mixture "Gaussian or uniform", its share of inliers found by EM, and
/// every correspondence's probability of being an inlier.
fn negative_log_likelihood(
    e: &Matrix3<f64>,
    pairs: &[[Normalized; 2]],
    options: &MlesacOptions,
) -> (f64, Vec<f64>) {
    let sigma = options.sigma_px;
    let outlier = 1.0 / options.outlier_range_px;
    let peak = 1.0 / (sigma * (2.0 * std::f64::consts::PI).sqrt());
    let densities: Vec<f64> = pairs
        .iter()
        .map(|pair| {
            let z = sampson_px(e, pair, options.focal_px) / sigma;
            peak * (-0.5 * z * z).exp()
        })
        .collect();
    let n = pairs.len() as f64;
    let mut share: f64 = 0.5;
    for _ in 0..4 {
        let sum: f64 = densities
            .iter()
            .map(|p| share * p / (share * p + (1.0 - share) * outlier))
            .sum();
        share = (sum / n).clamp(0.01, 0.99);
    }
    let cost = -densities
        .iter()
        .map(|p| (share * p + (1.0 - share) * outlier).ln())
        .sum::<f64>()
        / n;
    let weights = densities
        .iter()
        .map(|p| share * p / (share * p + (1.0 - share) * outlier))
        .collect();
    (cost, weights)
}

/// Five numbers: a turn of R and a move of t on the unit sphere.
pub(crate) fn moved(pose: &Pose, delta: &[f64]) -> Pose {
    let t = pose.translation_m.normalize();
    let helper = if t.x.abs() < 0.7 {
        Vector3::x()
    } else {
        Vector3::y()
    };
    let a = t.cross(&helper).normalize();
    let b = t.cross(&a);
    Pose {
        rotation: rotation_from_vector(&Vector3::new(delta[0], delta[1], delta[2])) * pose.rotation,
        translation_m: (t + a * delta[3] + b * delta[4]).normalize(),
    }
}

/// Levenberg–Marquardt on the Sampson distances, each weighted by its probability of being an inlier.
pub fn refine(start: &Pose, pairs: &[[Normalized; 2]], options: &MlesacOptions) -> Pose {
    let (_, weights) = negative_log_likelihood(&essential_matrix(start), pairs, options);
    let roots: Vec<f64> = weights.iter().map(|w| w.sqrt()).collect();
    let residuals = |pose: &Pose| {
        let e = essential_matrix(pose);
        DVector::from_iterator(
            pairs.len(),
            pairs
                .iter()
                .zip(&roots)
                .map(|(p, w)| w * sampson_px(&e, p, options.focal_px)),
        )
    };
    let mut pose = Pose {
        rotation: start.rotation,
        translation_m: start.translation_m.normalize(),
    };
    let mut here = residuals(&pose);
    let mut damping = 1e-3;
    for _ in 0..15 {
        let mut jacobian = DMatrix::zeros(pairs.len(), 5);
        for k in 0..5 {
            let mut delta = [0.0; 5];
            delta[k] = 1e-6;
            jacobian.set_column(k, &((residuals(&moved(&pose, &delta)) - &here) / 1e-6));
        }
        let normal = jacobian.tr_mul(&jacobian);
        let gradient = jacobian.tr_mul(&here);
        let mut gained = false;
        while damping < 1e8 {
            let mut damped = normal.clone();
            for i in 0..5 {
                damped[(i, i)] += damping * normal[(i, i)].max(1e-12);
            }
            let Some(factor) = damped.cholesky() else {
                damping *= 10.0;
                continue;
            };
            let step = -factor.solve(&gradient);
            let next_pose = moved(&pose, step.as_slice());
            let next = residuals(&next_pose);
            if next.norm_squared() < here.norm_squared() {
                gained = here.norm_squared() - next.norm_squared() > 1e-9 * here.norm_squared();
                (pose, here) = (next_pose, next);
                damping = (damping * 0.1).max(1e-10);
                break;
            }
            damping *= 10.0;
        }
        if !gained {
            break;
        }
    }
    pose
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;
    use rand_distr::{Distribution, Normal};

    #[test]
    fn a_quarter_of_wrong_pairs_does_not_move_the_pose() {
        let a = Pose::looking_at(Point3::new(20.0, 4.0, 3.0), Point3::new(0.0, 9.0, 1.0));
        let b = Pose::looking_at(Point3::new(-19.0, 6.0, 2.5), Point3::new(0.0, 9.0, 1.0));
        let truth = b.compose(&a.inverse());
        for seed in 0..10 {
            let mut rng = Pcg64Mcg::seed_from_u64(seed);
            let noise = Normal::new(0.0, 0.3 / 1800.0).unwrap();
            let pairs: Vec<[Normalized; 2]> = (0..160)
                .map(|i| {
                    let p = Point3::new(
                        rng.random_range(-3.0..3.0),
                        rng.random_range(0.0..18.0),
                        rng.random_range(0.0..3.0),
                    );
                    [a, b].map(|pose| {
                        let c = pose.transform(&p);
                        let wrong = if i % 4 == 0 {
                            rng.random_range(-0.1..0.1)
                        } else {
                            0.0
                        };
                        Normalized {
                            x: c.x / c.z + noise.sample(&mut rng),
                            y: c.y / c.z + noise.sample(&mut rng) + wrong,
                        }
                    })
                })
                .collect();
            let options = MlesacOptions {
                samples: 60,
                sigma_px: 0.3,
                outlier_range_px: 400.0,
                seed,
                focal_px: [1800.0; 2],
                refinements: 3,
            };
            let found = mlesac(&pairs, &[], &options).unwrap().unwrap();
            let again = mlesac(&pairs, &[], &options).unwrap().unwrap();
            assert_eq!(found.second_from_first, again.second_from_first);
            let turn = found
                .second_from_first
                .rotation
                .angle_to(&truth.rotation)
                .to_degrees();
            let t = found
                .second_from_first
                .translation_m
                .angle(&truth.translation_m)
                .to_degrees();
            assert!(turn < 0.1 && t < 0.1, "seed {seed}: {turn}° {t}°");
            assert!((112..=125).contains(&found.inliers), "{}", found.inliers);
        }
    }
}
