//! Two cameras without landmarks: relative pose and delay from the ball alone, coarse to fine over the delay.

use nalgebra::{DMatrix, DVector};

use super::CalibrationError;
use super::curves::Curves;
use super::delay_search::DelayWindow;
use super::polish::{Clock, WithSkew};
use super::relative_pose::{MlesacOptions, RelativePose, judge, mlesac, moved};
use crate::geometry::{Normalized, Pose, essential_matrix, sampson_px};
use crate::scene::Rig;

/// Shortest common part of a flight that is used, seconds.
const OVERLAP_S: f64 = 0.08;
/// Starts with delays side by side and turned by less than this lead to the same place.
const SAME_VALLEY_RAD: f64 = 0.1;
/// Correspondences per pitch.
const PER_PITCH: usize = 10;

/// A relative pose (`b_from_a`, |t| = 1) with b's clock against a's.
#[derive(Debug, Clone, Copy)]
pub(crate) struct TwoView {
    pub b_from_a: Pose,
    pub clock: Clock,
    /// Robust mean Sampson distance, pixels.
    pub cost_px: f64,
}

/// The two cameras and what is known of them.
pub(crate) struct Pair<'a> {
    pub curves: &'a Curves,
    pub cameras: [usize; 2],
    pub focal_px: [f64; 2],
    pub sigma_px: f64,
    pub seed: u64,
}

impl<'a> Pair<'a> {
    pub(crate) fn new(rig: &Rig, curves: &'a Curves, cameras: [usize; 2], seed: u64) -> Self {
        let focal_px = cameras.map(|c| {
            let lens = &rig.cameras[c].intrinsics;
            0.5 * (lens.fx_px + lens.fy_px)
        });
        let sigmas: Vec<f64> = curves
            .common(cameras[0], cameras[1])
            .iter()
            .flat_map(|&p| cameras.map(|c| curves.get(p, c).map_or(0.0, |c| c.sample_sigma_px)))
            .collect();
        let sigma_px = sigmas.iter().sum::<f64>() / sigmas.len().max(1) as f64;
        Self {
            curves,
            cameras,
            focal_px,
            sigma_px: sigma_px.max(0.1),
            seed,
        }
    }

    /// Correspondences at a clock: the same instants in both images, all pitches in common.
    pub(crate) fn correspondences(&self, clock: &Clock) -> Vec<[Normalized; 2]> {
        let [a, b] = self.cameras;
        let mut pairs = Vec::new();
        for pitch in self.curves.common(a, b) {
            let (Some(first), Some(second)) = (self.curves.get(pitch, a), self.curves.get(pitch, b)) else {
                continue;
            };
            // Within one pitch the skew is a constant delay.
            let delay_s = clock.delay_s + clock.skew * (second.middle_s() - clock.zero_s);
            let from = first.start_s.max(second.start_s - delay_s);
            let to = first.end_s.min(second.end_s - delay_s);
            if to - from < OVERLAP_S {
                continue;
            }
            for i in 0..PER_PITCH {
                let t = from + (to - from) * (i as f64 + 0.5) / PER_PITCH as f64;
                pairs.push([first.direction(t), second.direction(t + delay_s)]);
            }
        }
        pairs
    }

    fn options(&self, samples: usize, sigma_px: f64) -> MlesacOptions {
        MlesacOptions {
            samples,
            sigma_px,
            outlier_range_px: 300.0,
            seed: self.seed,
            focal_px: self.focal_px,
            refinements: 2,
        }
    }

    fn judged(&self, pose: &Pose, clock: Clock) -> (RelativePose, TwoView) {
        let pairs = self.correspondences(&clock);
        let options = self.options(0, self.sigma_px);
        let found = judge(pose, &pairs, &options);
        let e = essential_matrix(pose);
        let cap = 20.0;
        let sum: f64 = pairs
            .iter()
            .map(|p| sampson_px(&e, p, self.focal_px).abs().min(cap))
            .sum();
        let cost_px = sum / pairs.len().max(1) as f64;
        (
            found,
            TwoView {
                b_from_a: found.second_from_first,
                clock,
                cost_px,
            },
        )
    }
}

/// Relative poses with delays, best first; several where the geometry is ambiguous.
pub(crate) fn two_view_candidates(
    pair: &Pair,
    window: &DelayWindow,
    with_skew: WithSkew,
    keep: usize,
) -> Result<Vec<TwoView>, CalibrationError> {
    let zero_s = pair.curves.middle_s(pair.cameras[1]);
    let step_s = 2.0 * window.step_s;
    let steps = (2.0 * window.half_s / step_s).ceil() as i64;
    let mut starts: Vec<TwoView> = Vec::new();
    for skew in coarse_skews(pair, with_skew, step_s) {
        let mut coarse: Vec<Vec<TwoView>> = Vec::new();
        let mut known: Vec<Pose> = Vec::new();
        for i in 0..=steps {
            let delay_s = window.centre_s - window.half_s + step_s * i as f64;
            let here = at_delay(
                pair,
                Clock {
                    delay_s,
                    skew,
                    zero_s,
                },
                &known,
            )?;
            known = here.iter().map(|f| f.b_from_a).collect();
            coarse.push(here);
        }
        starts.extend(valley_floors(&coarse));
    }
    starts.sort_by(|a, b| a.cost_px.total_cmp(&b.cost_px));
    let starts = one_a_valley(&starts, step_s, 6 * keep);
    let mut refined: Vec<TwoView> = Vec::new();
    for start in starts {
        let found = refine(pair, &start, with_skew);
        let known = |f: &TwoView| {
            (f.clock.delay_s - found.clock.delay_s).abs() < 0.5 * window.step_s
                && (f.b_from_a.rotation.matrix() - found.b_from_a.rotation.matrix()).norm() < 0.01
        };
        if !refined.iter().any(known) {
            refined.push(found);
        }
    }
    refined.sort_by(|a, b| a.cost_px.total_cmp(&b.cost_px));
    refined.truncate(keep);
    Ok(refined)
}

/// Robust relative poses at one clock; `known`: answers at the neighbouring delay.
fn at_delay(pair: &Pair, clock: Clock, known: &[Pose]) -> Result<Vec<TwoView>, CalibrationError> {
    let pairs = pair.correspondences(&clock);
    let common = pair.curves.common(pair.cameras[0], pair.cameras[1]).len();
    if pairs.len() < 10.max(common * PER_PITCH / 2) {
        return Ok(Vec::new());
    }
    // Neighbouring delays start from each other's answers, so few fresh samples do.
    let samples = if known.is_empty() { 16 } else { 6 };
    let mut here = Vec::new();
    // A delay that is half a step off moves the ball by many pixels: the second sigma is the delay's.
    for (round, sigma_px) in [4.0 * pair.sigma_px, 2.0].into_iter().enumerate() {
        let options = MlesacOptions {
            seed: pair.seed + round as u64,
            ..pair.options(samples, sigma_px)
        };
        if let Some(found) = mlesac(&pairs, known, &options)? {
            here.push(pair.judged(&found.second_from_first, clock).1);
        }
    }
    Ok(here)
}

/// Answers at the delays where the cost is lower than at both neighbours.
fn valley_floors(coarse: &[Vec<TwoView>]) -> Vec<TwoView> {
    let least: Vec<f64> = coarse
        .iter()
        .map(|all| all.iter().map(|f| f.cost_px).fold(f64::INFINITY, f64::min))
        .collect();
    let mut floors = Vec::new();
    for (i, here) in coarse.iter().enumerate() {
        let left = i.checked_sub(1).map_or(f64::INFINITY, |k| least[k]);
        let right = least.get(i + 1).copied().unwrap_or(f64::INFINITY);
        if least[i].is_finite() && least[i] <= left && least[i] <= right {
            floors.extend(here.iter().copied());
        }
    }
    floors
}

/// The best start of every valley, at most `most`. With skews a false valley has many starts, and a grid this
/// coarse can put all of them before the true one's.
fn one_a_valley(starts: &[TwoView], step_s: f64, most: usize) -> Vec<TwoView> {
    let mut kept: Vec<TwoView> = Vec::new();
    for start in starts {
        let same = |k: &TwoView| {
            (k.clock.delay_s - start.clock.delay_s).abs() < 2.5 * step_s
                && k.b_from_a.rotation.angle_to(&start.b_from_a.rotation) < SAME_VALLEY_RAD
        };
        if kept.len() < most && !kept.iter().any(same) {
            kept.push(*start);
        }
    }
    kept
}

/// Steps that drift by one coarse step over half a session (`span_s`), up to ±50 ppm.
pub(crate) fn skews_within(with_skew: WithSkew, span_s: f64, step_s: f64) -> Vec<f64> {
    if with_skew == WithSkew::No || 50e-6 * span_s < step_s {
        return vec![0.0];
    }
    let step = step_s / span_s;
    let each_side = (50e-6 / step).ceil().min(12.0) as i64;
    (-each_side..=each_side).map(|k| k as f64 * step).collect()
}

/// Skews to try for the second camera.
fn coarse_skews(pair: &Pair, with_skew: WithSkew, step_s: f64) -> Vec<f64> {
    let [a, b] = pair.cameras;
    let zero_s = pair.curves.middle_s(b);
    let middles = pair
        .curves
        .common(a, b)
        .into_iter()
        .filter_map(|p| pair.curves.get(p, b));
    let span = middles.map(|c| (c.middle_s() - zero_s).abs()).fold(0.0, f64::max);
    skews_within(with_skew, span, step_s)
}

/// Levenberg–Marquardt over the five numbers of the pose, the delay, and the skew where it matters.
fn refine(pair: &Pair, start: &TwoView, with_skew: WithSkew) -> TwoView {
    let size = if with_skew == WithSkew::Yes { 7 } else { 6 };
    let apply = |from: &TwoView, delta: &[f64]| -> TwoView {
        let mut next = *from;
        next.b_from_a = moved(&from.b_from_a, &delta[..5]);
        next.clock.delay_s += delta[5];
        next.clock.skew += delta.get(6).copied().unwrap_or(0.0);
        next
    };
    let steps = [1e-6, 1e-6, 1e-6, 1e-6, 1e-6, 1e-6, 1e-9];
    let count = pair.correspondences(&start.clock).len();
    let residuals = |at: &TwoView| -> Option<DVector<f64>> {
        let e = essential_matrix(&at.b_from_a);
        let pairs = pair.correspondences(&at.clock);
        // Pitches that drop out of the overlap would change the sum: such a step is refused.
        (pairs.len() == count)
            .then(|| DVector::from_iterator(count, pairs.iter().map(|p| sampson_px(&e, p, pair.focal_px))))
    };
    let loss = |r: &DVector<f64>| -> f64 { r.iter().map(|r| (1.0 + r * r / 4.0).ln()).sum() };
    let mut here_state = *start;
    let Some(mut here) = residuals(start) else {
        return *start;
    };
    let mut damping = 1e-3;
    for _ in 0..30 {
        let weights = here.map(|r| 1.0 / (1.0 + r * r / 4.0));
        let mut jacobian = DMatrix::zeros(count, size);
        for k in 0..size {
            let mut delta = [0.0; 7];
            delta[k] = steps[k];
            if let Some(next) = residuals(&apply(&here_state, &delta[..size])) {
                jacobian.set_column(k, &((next - &here) / steps[k]));
            }
        }
        let weighted = DMatrix::from_fn(count, size, |i, k| jacobian[(i, k)] * weights[i]);
        let normal = jacobian.tr_mul(&weighted);
        let gradient = weighted.tr_mul(&here);
        let before = loss(&here);
        let mut gain = 0.0;
        while damping < 1e9 {
            let mut damped = normal.clone();
            for i in 0..size {
                damped[(i, i)] += damping * normal[(i, i)].max(1e-12);
            }
            if let Some(factor) = damped.cholesky() {
                let step = -factor.solve(&gradient);
                let next_state = apply(&here_state, step.as_slice());
                if let Some(next) = residuals(&next_state)
                    && loss(&next) < before
                {
                    gain = before - loss(&next);
                    (here_state, here) = (next_state, next);
                    damping = (damping * 0.1).max(1e-10);
                    break;
                }
            }
            damping *= 8.0;
        }
        if gain < 1e-6 * (1.0 + before) {
            break;
        }
    }
    let (_, judged) = pair.judged(&here_state.b_from_a, here_state.clock);
    judged
}
