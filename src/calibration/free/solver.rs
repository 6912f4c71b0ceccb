//! Robust Levenberg–Marquardt on the joint problem, and the noise and smoothness that the data ask for.

use nalgebra::{Matrix3, Vector2, Vector3};

use super::arrow::{Banded, Factor, Normal};
use super::problem::{JERK, Problem, State};
use super::spline::{ORDER, Spline};
use super::view::{CameraState, View};

/// Minimises the cost; returns it. Stops at a relative gain below `tolerance` or after `iterations`.
pub(super) fn minimise(problem: &Problem, state: &mut State, iterations: usize, tolerance: f64) -> f64 {
    let mut damping = 1e-4;
    let (mut normal, mut cost) = problem.linearise(state);
    for _ in 0..iterations {
        let mut gain = None;
        while damping < 1e12 {
            let Some(factor) = normal.factor(damping) else {
                damping = f64::max(damping, 1e-8) * 10.0;
                continue;
            };
            let candidate = problem.moved(state, &factor.descend(&normal));
            let next = problem.cost(&candidate);
            if next < cost {
                gain = Some(cost - next);
                *state = candidate;
                damping = (damping * 0.1).max(1e-12);
                break;
            }
            // Rounding alone parts the two: this is the minimum.
            if next - cost < 1e-12 * cost.abs() {
                break;
            }
            damping *= 10.0;
        }
        let Some(gain) = gain else { break };
        if gain < tolerance * cost.abs() {
            break;
        }
        (normal, cost) = problem.linearise(state);
    }
    problem.cost(state)
}

/// Covariance of the spline with the cameras held, ready for any instant.
pub(super) struct Held {
    inverse: Banded,
}

impl Held {
    pub fn new(factor: &Factor) -> Self {
        Self {
            inverse: factor.band_inverse(),
        }
    }

    /// Covariance of Σ weight_m·c_{first+m}.
    pub fn covariance(&self, first: usize, weight: &[f64; ORDER]) -> Matrix3<f64> {
        let mut sum = Matrix3::zeros();
        for m in 0..ORDER {
            for n in 0..ORDER {
                let scale = weight[m] * weight[n];
                for a in 0..3 {
                    for b in 0..3 {
                        sum[(a, b)] += scale * self.inverse.get(3 * (first + m) + a, 3 * (first + n) + b);
                    }
                }
            }
        }
        sum
    }
}

/// Sets the noise of every camera and the jerk's precision to what the residuals and the curve say,
/// by one step of expectation–maximisation for the noise (Student's t) and of MacKay's evidence for the jerk.
pub(super) fn update_scales(problem: &mut Problem, state: &mut State) -> Option<()> {
    let (normal, _) = problem.linearise(state);
    let held = Held::new(&normal.factor(0.0)?);
    for (index, view) in problem.views.iter().enumerate() {
        let Some(camera) = &mut state.cameras[index] else {
            continue;
        };
        if let Some(noise) = noise_of(problem, view, (camera, &state.spline), &held) {
            camera.noise = noise;
        }
    }
    update_jerk(problem, &state.spline, &held);
    Some(())
}

/// Length of the blocks over which lasting errors are told from fleeting ones, seconds.
const BLOCK_S: f64 = 4.0;

/// Sightings per independent sighting, at least 1: mean over blocks, cameras and axes of (Σr)²/Σr².
pub(super) fn redundancy(problem: &Problem, state: &State) -> f64 {
    let (mut ratio, mut blocks) = (0.0, 0.0);
    for (view, camera) in problem.views.iter().zip(&state.cameras) {
        let Some(camera) = camera else { continue };
        let (mut sum, mut squares, mut count) = (Vector2::zeros(), Vector2::zeros(), 0);
        let mut block = None;
        for s in &view.sightings {
            let Some(p) = view.predict(camera, &state.spline, s) else {
                continue;
            };
            let own = Some((s.stamped_s / BLOCK_S).floor() as i64);
            if own != block {
                add_block(&mut ratio, &mut blocks, (&sum, &squares, count));
                (sum, squares, count, block) = (Vector2::zeros(), Vector2::zeros(), 0, own);
            }
            let sigma = s.sigma_px * camera.noise;
            let weight = problem.robust((p.residual_px / sigma).norm_squared()).1;
            let r = p.residual_px * (weight / sigma);
            sum += r;
            squares += r.component_mul(&r);
            count += 1;
        }
        add_block(&mut ratio, &mut blocks, (&sum, &squares, count));
    }
    if blocks > 0.0 {
        f64::max(ratio / blocks, 1.0)
    } else {
        1.0
    }
}

fn add_block(
    ratio: &mut f64,
    blocks: &mut f64,
    (sum, squares, count): (&Vector2<f64>, &Vector2<f64>, usize),
) {
    if count >= 20 {
        for axis in 0..2 {
            *ratio += sum[axis].powi(2) / squares[axis].max(f64::MIN_POSITIVE);
            *blocks += 1.0;
        }
    }
}

/// Standard deviation factor of one camera: weighted squares over the freedom the curve leaves.
fn noise_of(
    problem: &Problem,
    view: &View,
    (camera, spline): (&CameraState, &Spline),
    held: &Held,
) -> Option<f64> {
    let (mut squares, mut freedom) = (0.0, 0.0);
    for s in &view.sightings {
        let Some(p) = view.predict(camera, spline, s) else {
            continue;
        };
        let precision = 1.0 / (s.sigma_px * s.sigma_px);
        let normalised = p.residual_px.norm_squared() * precision;
        let (_, weight) = problem.robust(normalised / camera.noise.powi(2));
        let curve =
            p.by_world_point * held.covariance(p.basis.first, &p.basis.value) * p.by_world_point.transpose();
        let leverage = weight * precision / camera.noise.powi(2) * curve.trace();
        squares += weight * normalised;
        freedom += 2.0 - leverage.min(1.9);
    }
    (freedom > 20.0).then(|| (squares / freedom).sqrt().max(1e-3))
}

/// α ← (rank − α·tr(K·A⁻¹)) / cᵀKc (MacKay 1992), bounded to a hundredfold step.
fn update_jerk(problem: &mut Problem, spline: &Spline, held: &Held) {
    let scale = spline.knot_s.powi(-5);
    let (mut energy, mut trace, mut count) = (0.0, 0.0, 0.0);
    for first in spline.segments() {
        energy += scale * spline.combine(first, &JERK).norm_squared();
        trace += scale * held.covariance(first, &JERK).trace();
        count += 3.0;
    }
    let determined = count - problem.jerk_precision * trace;
    if energy > 0.0 && determined > 0.0 {
        let ratio = determined / energy / problem.jerk_precision;
        problem.jerk_precision *= ratio.clamp(0.01, 100.0);
    }
}

/// Fits the spline to posed cameras by linear least squares: every sighting asks the curve to cross its ray
/// at its own instant, with the depth of the last round as weight and Student's t against outliers.
pub(super) fn fit_spline(problem: &Problem, state: &mut State, depth: f64, rounds: usize) -> Option<()> {
    let mut depths: Vec<Vec<f64>> = problem
        .views
        .iter()
        .map(|v| vec![depth; v.sightings.len()])
        .collect();
    for round in 0..rounds {
        let mut normal = Normal::zeros(3 * state.spline.coefficients.len(), 0);
        for c in &mut state.spline.coefficients {
            *c = if round == 0 { Vector3::zeros() } else { *c };
        }
        for ((view, camera), depths) in problem.views.iter().zip(&state.cameras).zip(&mut depths) {
            let Some(camera) = camera else { continue };
            for (s, depth) in view.sightings.iter().zip(depths) {
                add_ray(
                    &mut normal,
                    (problem, view, camera),
                    (&state.spline, s),
                    (round, depth),
                );
            }
        }
        problem.add_roughness(&state.spline, &mut normal);
        let step = normal.factor(1e-12)?.descend(&normal);
        for (c, d) in state
            .spline
            .coefficients
            .iter_mut()
            .zip(step.band.chunks_exact(3))
        {
            *c += Vector3::new(d[0], d[1], d[2]);
        }
    }
    Some(())
}

fn add_ray(
    normal: &mut Normal,
    (problem, view, camera): (&Problem, &View, &CameraState),
    (spline, s): (&Spline, &super::view::Sighting),
    (round, depth): (usize, &mut f64),
) {
    let Ok(n) = camera
        .lens
        .direction(crate::geometry::Pixel::new(s.pixel_px.x, s.pixel_px.y))
    else {
        return;
    };
    let basis = spline.basis(view.true_s(camera, s));
    let camera_m = camera
        .pose
        .transform(&spline.combine(basis.first, &basis.value).into());
    let mut weight = 1.0;
    let sigma = s.sigma_px * camera.noise / camera.lens.fx_px;
    if round > 0 {
        // A point on the wrong side keeps its depth: its ray still pulls it forwards.
        *depth = if camera_m.z > 0.05 * *depth {
            camera_m.z
        } else {
            *depth
        };
        let miss = (camera_m.x - n.x * camera_m.z).hypot(camera_m.y - n.y * camera_m.z) / *depth;
        weight = problem.robust((miss / sigma).powi(2)).1;
    }
    let r = camera.pose.rotation.matrix();
    let precision = weight / (sigma * *depth).powi(2);
    for (k, value) in [n.x, n.y].into_iter().enumerate() {
        let row: Vector3<f64> = (r.row(k) - value * r.row(2)).transpose();
        let miss = camera_m[k] - value * camera_m.z;
        for m in 0..ORDER {
            let base = 3 * (basis.first + m);
            for a in 0..3 {
                normal.band_gradient[base + a] += precision * basis.value[m] * row[a] * miss;
                for q in 0..=m {
                    let other = 3 * (basis.first + q);
                    let scale = precision * basis.value[m] * basis.value[q] * row[a];
                    for b in 0..if q == m { a + 1 } else { 3 } {
                        *normal.band.at(base + a, other + b) += scale * row[b];
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::problem::Distance;
    use super::super::synthetic::{Scene, at_truth, problem};
    use super::super::view::Column;
    use super::*;
    use crate::scene::ParameterKind as K;

    pub(crate) const FREE: [K; 9] = [
        K::RotationX,
        K::RotationY,
        K::RotationZ,
        K::TranslationX,
        K::TranslationY,
        K::TranslationZ,
        K::CaptureDelay,
        K::ClockSkew,
        K::Readout,
    ];

    #[test]
    fn a_disturbed_truth_is_found_again() {
        let scene = Scene {
            outliers: 0.05,
            ..Scene::drone(2)
        };
        let (views, mut state, truth) = at_truth(&scene, 0.1);
        let between = (truth.poses[0].centre_m() - truth.poses[1].centre_m()).norm();
        let mut problem = Problem {
            columns: [1, 2]
                .into_iter()
                .flat_map(|camera| FREE.iter().map(move |&kind| Column { camera, kind }))
                .chain([Column {
                    camera: 0,
                    kind: K::Readout,
                }])
                .collect(),
            distances: vec![Distance {
                cameras: (0, 1),
                distance: between,
                sigma: 1e-6 * between,
            }],
            ..problem(&views)
        };
        for (k, camera) in state.cameras.iter_mut().flatten().enumerate() {
            if k > 0 {
                camera.pose = camera.pose.perturbed(&[0.01, -0.02, 0.005, 0.3, -0.2, 0.2]);
                camera.delay_s += 0.05;
                camera.skew_ppm = 0.0;
            }
            camera.readout_s = 0.0;
            camera.noise = 5.0;
        }
        fit_spline(&problem, &mut state, 40.0, 6).unwrap();
        for _ in 0..8 {
            minimise(&problem, &mut state, 8, 1e-6);
            update_scales(&mut problem, &mut state).unwrap();
        }
        let (normal, _) = problem.linearise(&state);
        let covariance = normal.factor(0.0).unwrap().border_covariance();
        let mut checked = 0;
        for (i, column) in problem.columns.iter().enumerate() {
            let c = state.cameras[column.camera].as_ref().unwrap();
            let t = &truth.timings[column.camera];
            let miss = match column.kind {
                K::CaptureDelay => c.delay_s - t.capture_delay_s,
                K::ClockSkew => c.skew_ppm - t.clock_skew_ppm,
                K::Readout => c.readout_s - t.readout_s,
                _ => continue,
            };
            let sigma = covariance[(i, i)].sqrt();
            assert!(
                miss.abs() < 3.5 * sigma,
                "{column:?}: off by {miss}, sigma {sigma}"
            );
            assert!((0.35..0.6).contains(&c.noise), "{column:?} noise {}", c.noise);
            checked += 1;
        }
        assert_eq!(checked, 7);
        let mut worst: f64 = 0.0;
        for k in 5..55 {
            let t = 10.0 + f64::from(k);
            worst = worst.max((state.spline.position(t) - truth.position(t)).norm());
        }
        assert!(worst < 0.15, "worst position {worst} m");
    }
}
