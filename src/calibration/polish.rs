//! A whole rig's state (poses, delays, skews), its cost over cubic paths, and a small variable-projection
//! Levenberg–Marquardt that brings a rough state into the right basin.

use nalgebra::{DMatrix, DVector};

use super::curves::{Curves, ImageCurve};
use super::path::{Path, PathPrior, Ray};
use super::resection::{Sighting, sigma_px};
use crate::geometry::{Intrinsics, Pose};

/// Residuals are cut off here, sigmas.
const REACH: f64 = 200.0;
/// From here on a sample counts less and less, sigmas.
const CAUCHY: f64 = 4.0;

/// How one camera's stamps map to true time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Clock {
    pub delay_s: f64,
    /// Seconds per second.
    pub skew: f64,
    /// Stamp at which `delay_s` holds, seconds after the epoch.
    pub zero_s: f64,
}

impl Clock {
    pub(crate) fn true_s(&self, stamped_s: f64) -> f64 {
        stamped_s - self.delay_s - self.skew * (stamped_s - self.zero_s)
    }
}

/// Poses and clocks of all rig cameras.
#[derive(Debug, Clone)]
pub(crate) struct State {
    pub poses: Vec<Option<Pose>>,
    pub clocks: Vec<Clock>,
}

/// What stays the same while states are compared.
pub(crate) struct Evidence<'a> {
    pub curves: &'a Curves,
    pub lenses: Vec<Intrinsics>,
    /// Landmarks kept, per camera.
    pub sightings: Vec<Vec<Sighting>>,
    pub prior: PathPrior,
    /// Pair of cameras whose centres are 1 apart, where nothing else fixes the scale.
    pub unit_baseline: Option<(usize, usize)>,
    /// Added to the samples' sigma, pixels: poses not yet polished are off by about this much.
    pub slack_px: f64,
}

impl Evidence<'_> {
    /// Rays of a pitch from the cameras `who` that have a pose and a curve.
    pub(crate) fn rays(&self, state: &State, pitch: usize, who: &[usize]) -> Vec<Ray> {
        let mut rays = Vec::new();
        for &camera in who {
            if state.poses[camera].is_none() {
                continue;
            }
            let Some(curve) = self.curves.get(pitch, camera) else {
                continue;
            };
            let lens = &self.lenses[camera];
            let focal_px = 0.5 * (lens.fx_px + lens.fy_px) / self.sigma_px(curve);
            rays.extend(curve.samples.iter().map(|&(stamped_s, direction)| Ray {
                camera,
                time_s: state.clocks[camera].true_s(stamped_s),
                direction,
                focal_px,
            }));
        }
        rays
    }

    fn sigma_px(&self, curve: &ImageCurve) -> f64 {
        curve.sample_sigma_px.hypot(self.slack_px)
    }

    /// Path of one pitch and the residuals of its rays in sigmas.
    pub(crate) fn fit(&self, state: &State, pitch: usize, who: &[usize]) -> Option<(Path, Vec<[f64; 2]>)> {
        let rays = self.rays(state, pitch, who);
        let seen: std::collections::BTreeSet<_> = rays.iter().map(|r| r.camera).collect();
        if seen.len() < 2 {
            return None;
        }
        let poses: Vec<Pose> = state
            .poses
            .iter()
            .map(|p| p.unwrap_or_else(Pose::identity))
            .collect();
        let path = Path::fit(&poses, &rays, &self.prior)?;
        let residuals = path.residuals(&poses, &rays, REACH);
        Some((path, residuals))
    }

    /// Root mean square residual of one pitch, sigmas, prior included, cut off at [`REACH`];
    /// `None` where fewer than two cameras see it.
    pub(crate) fn pitch_cost(&self, state: &State, pitch: usize, who: &[usize]) -> Option<f64> {
        let (path, residuals) = self.fit(state, pitch, who)?;
        let sum: f64 = residuals.iter().map(|r| r[0] * r[0] + r[1] * r[1]).sum();
        let prior: f64 = path.prior_residuals(&self.prior).iter().map(|r| r * r).sum();
        Some(((sum + prior) / (2 * residuals.len()) as f64).sqrt().min(REACH))
    }

    /// Cameras with a pose.
    pub(crate) fn placed(state: &State) -> Vec<usize> {
        (0..state.poses.len())
            .filter(|&c| state.poses[c].is_some())
            .collect()
    }

    /// Robust reprojection error of a state over all pitches: the median pitch's, in pixels of one sample.
    pub(crate) fn score_px(&self, state: &State) -> f64 {
        let who = Self::placed(state);
        let mut costs: Vec<f64> = (0..self.curves.of.len())
            .filter_map(|p| {
                let sigma = who
                    .iter()
                    .filter_map(|&c| self.curves.get(p, c))
                    .map(|c| self.sigma_px(c));
                let (sum, n) = sigma.fold((0.0, 0), |(s, n), x| (s + x, n + 1));
                Some(self.pitch_cost(state, p, &who)? * sum / f64::from(n.max(1)))
            })
            .collect();
        costs.sort_by(f64::total_cmp);
        match costs.len() {
            0 => f64::INFINITY,
            n => costs[..n.div_ceil(2)].iter().sum::<f64>() / n.div_ceil(2) as f64 * 0.5 + costs[n / 2] * 0.5,
        }
    }

    /// All residuals of a state: samples, path priors, landmarks, unit baseline.
    fn residuals(&self, state: &State, pitches: &[usize]) -> Vec<f64> {
        let who = Self::placed(state);
        let mut all = Vec::new();
        for &pitch in pitches {
            let samples: usize = who
                .iter()
                .filter_map(|&c| self.curves.get(pitch, c))
                .map(|c| c.samples.len())
                .sum();
            match self.fit(state, pitch, &who) {
                Some((path, residuals)) => {
                    all.extend(residuals.into_iter().flatten());
                    all.extend(path.prior_residuals(&self.prior));
                }
                None => all.extend(std::iter::repeat_n(REACH, 2 * samples + 6)),
            }
        }
        for &camera in &who {
            let Some(pose) = &state.poses[camera] else {
                continue;
            };
            for s in &self.sightings[camera] {
                let c = pose.transform(&s.world_m);
                match self.lenses[camera].project(&c) {
                    Ok(p) => {
                        let sigma = sigma_px(&self.lenses[camera], s, c.z);
                        all.extend([(p.x - s.pixel.x) / sigma.x, (p.y - s.pixel.y) / sigma.y]);
                    }
                    Err(_) => all.extend([REACH; 2]),
                }
            }
        }
        if let Some((a, b)) = self.unit_baseline
            && let (Some(a), Some(b)) = (&state.poses[a], &state.poses[b])
        {
            all.push(((a.centre_m() - b.centre_m()).norm() - 1.0) / 1e-4);
        }
        all
    }

    /// Levenberg–Marquardt over `unknowns`; the state never gets worse. Returns the robust cost.
    pub(crate) fn polish(&self, state: &mut State, unknowns: &[Unknown], steps: usize) -> f64 {
        let who = Self::placed(state);
        let pitches: Vec<usize> = (0..self.curves.of.len())
            .filter(|&p| who.iter().filter(|&&c| self.curves.get(p, c).is_some()).count() >= 2)
            .collect();
        let mut here = self.residuals(state, &pitches);
        let mut damping = 1e-3;
        for _ in 0..steps {
            let weights: Vec<f64> = here.iter().map(|r| 1.0 / (1.0 + (r / CAUCHY).powi(2))).collect();
            let rows = here.len();
            let mut jacobian = DMatrix::zeros(rows, unknowns.len());
            for (k, unknown) in unknowns.iter().enumerate() {
                let h = unknown.step(self);
                let moved = self.residuals(&unknown.moved(state, h), &pitches);
                for i in 0..rows {
                    jacobian[(i, k)] = (moved[i] - here[i]) / h;
                }
            }
            let weighted = DMatrix::from_fn(rows, unknowns.len(), |i, k| jacobian[(i, k)] * weights[i]);
            let normal = jacobian.tr_mul(&weighted);
            let gradient = weighted.tr_mul(&DVector::from_column_slice(&here));
            let cost = robust_cost(&here);
            let mut gain = None;
            while damping < 1e9 {
                let mut damped = normal.clone();
                for i in 0..unknowns.len() {
                    damped[(i, i)] += damping * normal[(i, i)].max(1e-9);
                }
                if let Some(factor) = damped.cholesky() {
                    let step = factor.solve(&gradient);
                    let mut next_state = state.clone();
                    for (k, unknown) in unknowns.iter().enumerate() {
                        next_state = unknown.moved(&next_state, -step[k]);
                    }
                    let next = self.residuals(&next_state, &pitches);
                    let next_cost = robust_cost(&next);
                    if next_cost < cost {
                        (*state, here) = (next_state, next);
                        gain = Some(cost - next_cost);
                        damping = (damping * 0.1).max(1e-9);
                        break;
                    }
                }
                damping *= 8.0;
            }
            if gain.is_none_or(|g| g < 1e-4 * (1.0 + cost)) {
                break;
            }
        }
        robust_cost(&here)
    }
}

/// Cauchy's loss, so that wrong samples pull less.
fn robust_cost(residuals: &[f64]) -> f64 {
    residuals
        .iter()
        .map(|r| CAUCHY * CAUCHY * (1.0 + (r / CAUCHY).powi(2)).ln())
        .sum()
}

/// One number that may move.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Unknown {
    /// Component 0–5 of a camera's [`Pose::perturbed`].
    Pose(usize, usize),
    /// A camera's delay.
    Delay(usize),
    /// A camera's skew.
    Skew(usize),
}

impl Unknown {
    fn step(self, evidence: &Evidence) -> f64 {
        match self {
            Self::Pose(_, k) if k < 3 => 1e-6,
            Self::Pose(..) => 1e-6 * evidence.prior.depth,
            Self::Delay(_) => 1e-6,
            Self::Skew(_) => 1e-9,
        }
    }

    fn moved(self, state: &State, by: f64) -> State {
        let mut next = state.clone();
        match self {
            Self::Pose(camera, k) => {
                let mut delta = [0.0; 6];
                delta[k] = by;
                if let Some(pose) = &mut next.poses[camera] {
                    *pose = pose.perturbed(&delta);
                }
            }
            Self::Delay(camera) => next.clocks[camera].delay_s += by,
            Self::Skew(camera) => next.clocks[camera].skew += by,
        }
        next
    }

    /// Everything of the cameras with a pose, but the time of `reference` and the poses of `fixed`.
    pub(crate) fn all(state: &State, reference: usize, fixed: &[usize], with_skew: WithSkew) -> Vec<Self> {
        let mut unknowns = Vec::new();
        for camera in Evidence::placed(state) {
            if !fixed.contains(&camera) {
                unknowns.extend((0..6).map(|k| Self::Pose(camera, k)));
            }
            if camera != reference {
                unknowns.push(Self::Delay(camera));
                if with_skew == WithSkew::Yes {
                    unknowns.push(Self::Skew(camera));
                }
            }
        }
        unknowns
    }
}

/// Whether clock skews are searched: only where the session is long enough to show one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum WithSkew {
    Yes,
    No,
}
