//! Delays of cameras whose poses are known: coarse to fine, over the reprojection error of cubic paths.

use super::polish::{Clock, Evidence, State, WithSkew};
use crate::scene::Rig;

/// Where a delay is looked for.
#[derive(Debug, Clone, Copy)]
pub(crate) struct DelayWindow {
    pub centre_s: f64,
    pub half_s: f64,
    /// Step of the coarse search.
    pub step_s: f64,
}

/// A delay (and skew) that may be the right one.
#[derive(Debug, Clone, Copy)]
pub(crate) struct DelayCandidate {
    pub clock: Clock,
    /// Mean over the pitches of the capped rms residual, sigmas.
    pub cost: f64,
}

/// Largest skew looked for, seconds per second.
const SKEW_MAX: f64 = 100e-6;
/// A session whose clocks cannot drift by this much, in frames, has no skew worth a search.
const DRIFT_FRAMES: f64 = 0.25;
/// Capped cost of a pitch, sigmas: a whole wrong pitch cannot outvote the right ones.
const PITCH_CAP: f64 = 60.0;

/// The window of a camera's delay against cameras already on the true time scale, from the middles of the curves;
/// `None` where no pitch is common.
pub(crate) fn delay_window(
    rig: &Rig,
    evidence: &Evidence,
    state: &State,
    placed: &[usize],
    camera: usize,
) -> Option<DelayWindow> {
    let frames_s = |c: usize| 1.0 / rig.cameras[c].frame_rate_hz.max(1.0);
    let mut apart: Vec<f64> = Vec::new();
    for pitch in 0..evidence.curves.of.len() {
        let Some(own) = evidence.curves.get(pitch, camera) else {
            continue;
        };
        for &other in placed {
            if let Some(curve) = evidence.curves.get(pitch, other) {
                apart.push(own.middle_s() - state.clocks[other].true_s(curve.middle_s()));
            }
        }
    }
    if apart.is_empty() {
        return None;
    }
    apart.sort_by(f64::total_cmp);
    let median = apart[apart.len() / 2];
    let slowest_s = placed
        .iter()
        .map(|&c| frames_s(c))
        .fold(frames_s(camera), f64::max);
    let thirty_s = 32.0 * slowest_s;
    let step_s = 0.5 * frames_s(camera).min(1.0 / 100.0);
    let rough = rig.cameras.iter().any(|c| c.time_offset_s.is_some());
    // Cameras see different parts of a flight, which moves the middles by up to a quarter of a second.
    if !rough && median.abs() < thirty_s + 0.2 {
        return Some(DelayWindow {
            centre_s: 0.0,
            half_s: thirty_s,
            step_s,
        });
    }
    Some(DelayWindow {
        centre_s: median,
        half_s: 0.3,
        step_s,
    })
}

/// Whether the session is long enough for a skew to matter.
pub(crate) fn skew_matters(rig: &Rig, evidence: &Evidence, camera: usize) -> WithSkew {
    let middles = evidence
        .curves
        .of
        .iter()
        .filter_map(|p| p.get(camera)?.as_ref())
        .map(|c| c.middle_s());
    let (low, high) = middles.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), m| {
        (l.min(m), h.max(m))
    });
    let drift_frames = SKEW_MAX * (high - low) * rig.cameras[camera].frame_rate_hz;
    if drift_frames > DRIFT_FRAMES {
        WithSkew::Yes
    } else {
        WithSkew::No
    }
}

/// Local minima of the cost over the window, best first, refined to some hundredths of a frame; at most `keep`.
pub(crate) fn search_delay(
    evidence: &Evidence,
    state: &State,
    camera: usize,
    window: &DelayWindow,
    (with_skew, keep): (WithSkew, usize),
) -> Vec<DelayCandidate> {
    let mut who = Evidence::placed(state);
    if !who.contains(&camera) {
        who.push(camera);
    }
    let zero_s = evidence.curves.middle_s(camera);
    let pitches: Vec<usize> = (0..evidence.curves.of.len())
        .filter(|&p| {
            evidence.curves.get(p, camera).is_some()
                && who
                    .iter()
                    .any(|&c| c != camera && evidence.curves.get(p, c).is_some())
        })
        .collect();
    let span = pitches
        .iter()
        .filter_map(|&p| evidence.curves.get(p, camera))
        .map(|c| (c.middle_s() - zero_s).abs())
        .fold(0.0, f64::max);
    let drift_s = if with_skew == WithSkew::Yes {
        SKEW_MAX * span
    } else {
        0.0
    };
    let grid = Grid {
        first_s: window.centre_s - window.half_s - drift_s,
        step_s: window.step_s,
        size: (2.0 * (window.half_s + drift_s) / window.step_s).ceil() as usize + 1,
    };
    let cost_at = |pitch: usize, delay_s: f64| -> f64 {
        let mut trial = state.clone();
        trial.clocks[camera] = Clock {
            delay_s,
            skew: 0.0,
            zero_s,
        };
        evidence
            .pitch_cost(&trial, pitch, &who)
            .unwrap_or(PITCH_CAP)
            .min(PITCH_CAP)
    };
    let table: Vec<(f64, Vec<f64>)> = pitches
        .iter()
        .map(|&p| {
            let offset = evidence
                .curves
                .get(p, camera)
                .map_or(0.0, |c| c.middle_s() - zero_s);
            (offset, (0..grid.size).map(|i| cost_at(p, grid.at(i))).collect())
        })
        .collect();
    if table.is_empty() {
        return Vec::new();
    }
    let skews = skew_steps(with_skew, span, window.step_s);
    let total = |delay_s: f64, skew: f64| -> f64 {
        table
            .iter()
            .map(|(offset, costs)| grid.interpolate(costs, delay_s + skew * offset))
            .sum::<f64>()
            / table.len() as f64
    };
    let inner = Grid {
        first_s: window.centre_s - window.half_s,
        size: (2.0 * window.half_s / window.step_s).ceil() as usize + 1,
        ..grid
    };
    // For every delay the best skew; then the minima along the delay.
    let ridge: Vec<(f64, f64)> = (0..inner.size)
        .map(|i| {
            let best = skews.iter().map(|&s| (total(inner.at(i), s), s));
            best.min_by(|a, b| a.0.total_cmp(&b.0))
                .unwrap_or((f64::INFINITY, 0.0))
        })
        .collect();
    let mut found: Vec<DelayCandidate> = minima(&ridge)
        .into_iter()
        .map(|i| {
            let (cost, skew) = ridge[i];
            DelayCandidate {
                clock: Clock {
                    delay_s: inner.at(i),
                    skew,
                    zero_s,
                },
                cost,
            }
        })
        .collect();
    found.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    found.truncate(keep);
    for candidate in &mut found {
        refine(
            evidence,
            state,
            camera,
            candidate,
            (window.step_s, &who, &pitches),
        );
    }
    found.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    found
}

#[derive(Clone, Copy)]
struct Grid {
    first_s: f64,
    step_s: f64,
    size: usize,
}

impl Grid {
    fn at(&self, i: usize) -> f64 {
        self.first_s + self.step_s * i as f64
    }
    fn interpolate(&self, values: &[f64], delay_s: f64) -> f64 {
        let place = ((delay_s - self.first_s) / self.step_s).clamp(0.0, (self.size - 1) as f64);
        let below = (place.floor() as usize).min(self.size.saturating_sub(2));
        let share = place - below as f64;
        match (values.get(below), values.get(below + 1)) {
            (Some(a), Some(b)) => a * (1.0 - share) + b * share,
            _ => PITCH_CAP,
        }
    }
}

fn skew_steps(with_skew: WithSkew, span_s: f64, step_s: f64) -> Vec<f64> {
    if with_skew == WithSkew::No || !(span_s > 0.0) {
        return vec![0.0];
    }
    let step = 0.5 * step_s / span_s;
    let each_side = (SKEW_MAX / step).ceil() as i64;
    (-each_side..=each_side).map(|k| k as f64 * step).collect()
}

fn minima(ridge: &[(f64, f64)]) -> Vec<usize> {
    (0..ridge.len())
        .filter(|&i| {
            let lower_left = i == 0 || ridge[i].0 <= ridge[i - 1].0;
            let lower_right = i + 1 == ridge.len() || ridge[i].0 < ridge[i + 1].0;
            lower_left && lower_right
        })
        .collect()
}

/// Golden sections along the delay, then along the skew.
fn refine(
    evidence: &Evidence,
    state: &State,
    camera: usize,
    candidate: &mut DelayCandidate,
    (step_s, who, pitches): (f64, &[usize], &[usize]),
) {
    let cost = |clock: Clock| -> f64 {
        let mut trial = state.clone();
        trial.clocks[camera] = clock;
        let sum: f64 = pitches
            .iter()
            .map(|&p| {
                evidence
                    .pitch_cost(&trial, p, who)
                    .unwrap_or(PITCH_CAP)
                    .min(PITCH_CAP)
            })
            .sum();
        sum / pitches.len().max(1) as f64
    };
    let from = candidate.clock;
    let delay_s = golden(|d| cost(Clock { delay_s: d, ..from }), from.delay_s, step_s);
    candidate.clock.delay_s = delay_s;
    candidate.cost = cost(candidate.clock);
}

/// Minimum of a function within ± `half` of `centre`, to a hundredth of `half`.
pub(crate) fn golden(f: impl Fn(f64) -> f64, centre: f64, half: f64) -> f64 {
    let ratio = 0.5 * (5f64.sqrt() - 1.0);
    let (mut a, mut b) = (centre - half, centre + half);
    let (mut c, mut d) = (b - ratio * (b - a), a + ratio * (b - a));
    let (mut fc, mut fd) = (f(c), f(d));
    for _ in 0..11 {
        if fc < fd {
            (b, d, fd) = (d, c, fc);
            c = b - ratio * (b - a);
            fc = f(c);
        } else {
            (a, c, fc) = (c, d, fd);
            d = a + ratio * (b - a);
            fd = f(d);
        }
    }
    0.5 * (a + b)
}
