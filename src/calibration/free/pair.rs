//! Two cameras from nothing: relative pose and offset of their clocks, by five-point inside a coarse search
//! over the offset, then least squares over both (the offset moves one path along itself).

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};
use rand::SeedableRng;
use rand::seq::index::sample;
use rand_pcg::Pcg64Mcg;

use super::path::Path;
use crate::calibration::CalibrationError;
use crate::calibration::relative_pose::moved;
use crate::geometry::{Normalized, Pose, cheirality, essential_matrix, sampson_px};
use crate::vision::five_point;

/// How the offset is searched.
#[derive(Debug, Clone, Copy)]
pub(super) struct PairSearch {
    /// Offsets from −range to +range about the rough one, seconds.
    pub range_s: f64,
    /// Step of the coarse search, seconds.
    pub step_s: f64,
    /// Five-point samples at every offset.
    pub samples: usize,
    /// Correspondences used at most.
    pub points: usize,
    pub seed: u64,
}

/// A relative pose and offset, and how well they explain the two paths.
#[derive(Debug, Clone, Copy)]
pub(super) struct PairGuess {
    /// |t| = 1.
    pub second_from_first: Pose,
    /// Rough time of the second camera minus rough time of the first, at the same true instant, seconds.
    pub shift_s: f64,
    /// Mean truncated cost per correspondence, 0 (perfect) to 1.
    pub cost: f64,
    /// Fraction of correspondences within the last threshold.
    pub inlier_share: f64,
    /// Correspondences tried.
    pub points: usize,
    /// 1σ of the shift as the epipolar residuals tell it, seconds.
    pub shift_sigma_s: f64,
    /// Median angle between the two rays, degrees.
    pub parallax_deg: f64,
    /// Times, in the first camera's rough time, of common sightings: first to last knots both see, seconds in all.
    pub common_s: f64,
}

/// The best pose at one shift of the coarse search.
struct Coarse {
    cost: f64,
    shift_s: f64,
    pose: Pose,
    /// Seconds that both see.
    overlap_s: f64,
}

/// Truncation of epipolar distances: coarse, then finer as the offset settles, pixels.
const COARSE_PX: f64 = 10.0;
/// Shifts with less than this of the longest overlap prove nothing.
const OVERLAP_SHARE: f64 = 0.25;
const ANNEALED_PX: [f64; 4] = [12.0, 6.0, 3.0, 3.0];

/// The best guesses, best first, with distinct shifts; empty where the two share too little.
pub(super) fn search(
    first: &Path,
    second: &Path,
    options: &PairSearch,
) -> Result<Vec<PairGuess>, CalibrationError> {
    let mut rng = Pcg64Mcg::seed_from_u64(options.seed);
    let steps = (options.range_s / options.step_s).ceil() as i32;
    let mut coarse: Vec<Coarse> = vec![];
    for k in -steps..=steps {
        let shift_s = f64::from(k) * options.step_s;
        let (times_s, overlap_s) = first.common(second, shift_s, options.points);
        let pairs = correspondences(first, second, &times_s, shift_s);
        if pairs.len() < 30 {
            continue;
        }
        if let Some((cost, pose)) = sampled(&pairs, (first, second), options.samples, &mut rng)? {
            coarse.push(Coarse {
                cost,
                shift_s,
                pose,
                overlap_s,
            });
        }
    }
    // Where hardly anything overlaps, any pose explains it.
    let most_s = coarse.iter().map(|c| c.overlap_s).fold(0.0, f64::max);
    coarse.retain(|c| c.overlap_s > OVERLAP_SHARE * most_s);
    coarse.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    let mut guesses: Vec<PairGuess> = vec![];
    for Coarse { shift_s, pose, .. } in coarse.into_iter().take(8) {
        let Some(guess) = settled(first, second, (pose, shift_s), options.points) else {
            continue;
        };
        if guess.shift_s.abs() > options.range_s + 2.0 * options.step_s {
            continue;
        }
        match guesses
            .iter_mut()
            .find(|g| (g.shift_s - guess.shift_s).abs() < 0.03 && same_direction(g, &guess))
        {
            Some(known) if guess.cost < known.cost => *known = guess,
            Some(_) => {}
            None => guesses.push(guess),
        }
    }
    guesses.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    Ok(guesses)
}

fn same_direction(a: &PairGuess, b: &PairGuess) -> bool {
    let turn = a.second_from_first.rotation.matrix() - b.second_from_first.rotation.matrix();
    turn.norm() < 0.1
}

fn correspondences(first: &Path, second: &Path, times_s: &[f64], shift_s: f64) -> Vec<[Normalized; 2]> {
    times_s
        .iter()
        .filter_map(|&t| Some([first.at(t)?, second.at(t + shift_s)?]))
        .collect()
}

/// Best of five-point samples by truncated Sampson distance.
fn sampled(
    pairs: &[[Normalized; 2]],
    (first, second): (&Path, &Path),
    samples: usize,
    rng: &mut Pcg64Mcg,
) -> Result<Option<(f64, Pose)>, CalibrationError> {
    let focal = [first.focal_px, second.focal_px];
    let mut best: Option<(f64, Matrix3<f64>)> = None;
    for _ in 0..samples {
        let picked = sample(rng, pairs.len(), 5);
        let five = std::array::from_fn(|k| pairs[picked.index(k)]);
        for e in five_point(&five)? {
            let cost = truncated(&e, pairs, focal, COARSE_PX);
            if best.is_none_or(|(least, _)| cost < least) {
                best = Some((cost, e));
            }
        }
    }
    let Some((cost, e)) = best else { return Ok(None) };
    let close: Vec<_> = pairs
        .iter()
        .filter(|p| sampson_px(&e, p, focal).abs() < COARSE_PX)
        .copied()
        .collect();
    let thinned: Vec<_> = close
        .iter()
        .step_by(close.len().div_ceil(40).max(1))
        .copied()
        .collect();
    Ok(cheirality(&e, &thinned).map(|(pose, _)| (cost, pose)))
}

fn truncated(e: &Matrix3<f64>, pairs: &[[Normalized; 2]], focal: [f64; 2], limit_px: f64) -> f64 {
    let sum: f64 = pairs
        .iter()
        .map(|p| (sampson_px(e, p, focal) / limit_px).powi(2).min(1.0))
        .sum();
    sum / pairs.len() as f64
}

type Six = SVector<f64, 6>;

/// Least squares over pose and shift with a threshold that tightens; judged at the last one.
fn settled(first: &Path, second: &Path, start: (Pose, f64), points: usize) -> Option<PairGuess> {
    let (mut pose, mut shift_s) = start;
    let mut inverse = SMatrix::<f64, 6, 6>::zeros();
    for limit_px in ANNEALED_PX {
        let (times_s, _) = first.common(second, shift_s, points);
        let anchor_s = shift_s;
        for _ in 0..6 {
            let (normal, gradient) = linearised(first, second, (&pose, shift_s), &times_s, limit_px);
            let mut damped = normal;
            for k in 0..6 {
                damped[(k, k)] += 1e-4 * normal[(k, k)] + 1e-12;
            }
            let step: Six = -(damped.cholesky()?.solve(&gradient));
            let change = step[5].clamp(-0.08, 0.08);
            pose = moved(&pose, &step.as_slice()[..5]);
            shift_s += change;
            if step.norm() < 1e-6 || (shift_s - anchor_s).abs() > 0.25 {
                break;
            }
        }
        inverse = linearised(first, second, (&pose, shift_s), &times_s, limit_px)
            .0
            .try_inverse()?;
    }
    judged(first, second, (&pose, shift_s), points).map(|mut guess| {
        guess.shift_sigma_s = inverse[(5, 5)].max(0.0).sqrt();
        guess
    })
}

/// Gauss–Newton equations (unit pixel noise) of the Sampson distances, Geman–McClure weighted.
fn linearised(
    first: &Path,
    second: &Path,
    (pose, shift_s): (&Pose, f64),
    times_s: &[f64],
    limit_px: f64,
) -> (SMatrix<f64, 6, 6>, Six) {
    let focal = [first.focal_px, second.focal_px];
    const STEP: f64 = 1e-6;
    let e = essential_matrix(pose);
    let turned: [Matrix3<f64>; 5] = std::array::from_fn(|k| {
        let mut delta = [0.0; 5];
        delta[k] = STEP;
        essential_matrix(&moved(pose, &delta))
    });
    let mut normal = SMatrix::zeros();
    let mut gradient = Six::zeros();
    for &t in times_s {
        let (Some(a), Some(b), Some(later)) =
            (first.at(t), second.at(t + shift_s), second.at(t + shift_s + 1e-4))
        else {
            continue;
        };
        let r = sampson_px(&e, &[a, b], focal);
        let weight = 1.0 / (1.0 + (r / limit_px).powi(2)).powi(2);
        let mut row = Six::zeros();
        for (k, turned) in turned.iter().enumerate() {
            row[k] = (sampson_px(turned, &[a, b], focal) - r) / STEP;
        }
        row[5] = (sampson_px(&e, &[a, later], focal) - r) / 1e-4;
        normal += weight * row * row.transpose();
        gradient += weight * r * row;
    }
    (normal, gradient)
}

fn judged(first: &Path, second: &Path, (pose, shift_s): (&Pose, f64), points: usize) -> Option<PairGuess> {
    let limit_px = ANNEALED_PX[ANNEALED_PX.len() - 1];
    let focal = [first.focal_px, second.focal_px];
    let (times_s, _) = first.common(second, shift_s, points);
    let pairs = correspondences(first, second, &times_s, shift_s);
    if pairs.len() < 30 {
        return None;
    }
    let e = essential_matrix(pose);
    let (mut inliers, mut angles, mut cost) = (0, vec![], 0.0);
    for pair in &pairs {
        let d = sampson_px(&e, pair, focal).abs() / limit_px;
        let rays = rays_of(pose, pair);
        let front = meets_in_front(&rays, &pose.translation_m);
        cost += if front { d.powi(2).min(1.0) } else { 1.0 };
        if d < 1.0 && front {
            inliers += 1;
            angles.push(rays[0].angle(&rays[1]).to_degrees());
        }
    }
    angles.sort_by(f64::total_cmp);
    Some(PairGuess {
        second_from_first: *pose,
        shift_s,
        cost: cost / pairs.len() as f64,
        inlier_share: f64::from(inliers) / pairs.len() as f64,
        points: pairs.len(),
        shift_sigma_s: f64::INFINITY,
        parallax_deg: *angles.get(angles.len() / 2)?,
        common_s: common_s(first, second, shift_s),
    })
}

/// Epipolar distance of two directions, pixels; infinite where the rays meet behind a camera.
pub(super) fn epipolar_miss(second_from_first: &Pose, pair: &[Normalized; 2], focal_px: [f64; 2]) -> f64 {
    if !meets_in_front(
        &rays_of(second_from_first, pair),
        &second_from_first.translation_m,
    ) {
        return f64::INFINITY;
    }
    sampson_px(&essential_matrix(second_from_first), pair, focal_px).abs()
}

/// Both rays in the second camera's axes.
fn rays_of(pose: &Pose, pair: &[Normalized; 2]) -> [Vector3<f64>; 2] {
    [
        pose.rotation * Vector3::new(pair[0].x, pair[0].y, 1.0),
        Vector3::new(pair[1].x, pair[1].y, 1.0),
    ]
}

/// d2·r2 = t + d1·r1 with both depths positive, in least squares.
fn meets_in_front(rays: &[Vector3<f64>; 2], t: &Vector3<f64>) -> bool {
    let (a, b) = (&rays[0], &rays[1]);
    let (aa, bb, ab) = (a.norm_squared(), b.norm_squared(), a.dot(b));
    let (at, bt) = (a.dot(t), b.dot(t));
    let determinant = aa * bb - ab * ab;
    let d1 = ab * bt - bb * at;
    let d2 = aa * bt - ab * at;
    // Parallel rays meet far away: in front.
    determinant < 1e-9 * aa * bb || (d1 > 0.0 && d2 > 0.0)
}

/// Seconds during which both see it.
fn common_s(first: &Path, second: &Path, shift_s: f64) -> f64 {
    let mut last: Option<f64> = None;
    let mut sum = 0.0;
    for t in first.times_s().filter(|t| second.at(t + shift_s).is_some()) {
        if let Some(last) = last {
            sum += (t - last).min(super::path::BRIDGE_S);
        }
        last = Some(t);
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::super::synthetic::{Scene, at_truth};
    use super::*;

    #[test]
    fn pose_and_offset_come_from_nothing() {
        let mut checked = 0;
        for seed in 0..4 {
            let scene = Scene {
                outliers: 0.05,
                ..Scene::drone(seed)
            };
            let (views, _, truth) = at_truth(&scene, 0.2);
            for (i, j) in [(0, 1), (0, 2), (1, 2)] {
                let rough = 0.7;
                let first = Path::new(&views[i], -scene.clocks[i].1);
                let second = Path::new(&views[j], -scene.clocks[j].1 + rough);
                let options = PairSearch {
                    range_s: 2.0,
                    step_s: 0.2,
                    samples: 25,
                    points: 150,
                    seed,
                };
                let found = search(&first, &second, &options).unwrap();
                let best = &found[0];
                assert!(
                    (best.shift_s - rough).abs() < 0.03,
                    "seed {seed} pair {i}-{j}: {best:?}"
                );
                let truth = truth.poses[j].compose(&truth.poses[i].inverse());
                let turn = best
                    .second_from_first
                    .rotation
                    .angle_to(&truth.rotation)
                    .to_degrees();
                let t = best
                    .second_from_first
                    .translation_m
                    .angle(&truth.translation_m)
                    .to_degrees();
                assert!(turn < 1.5 && t < 3.0, "seed {seed} pair {i}-{j}: {turn}° {t}°");
                checked += 1;
            }
        }
        assert_eq!(checked, 12);
    }
}
