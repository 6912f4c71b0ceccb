//! The share of the sphere's light in each picture of a track: where the ball flies into the shade the sun is gone and the light
//! of the sky is left, so that it is not only darker there but lit otherwise. With the sun's light kept its centre was drawn by
//! 0.3 to 0.5 px, the same way for the rest of the flight.

use super::super::median::median;
use super::{DRIFT, DRIFTING, Edge, OWN_STEPS_POOLED, Picture, Shared, SharedMatrix, first_fit, fit_shared};

/// Shares that are tried, relative to what the shared light has.
const SHARES: [f64; 9] = [0.0, 0.25, 0.5, 0.75, 1.0, 1.35, 1.8, 2.5, 4.0];
/// Of them those that tell whether the others need be tried.
const TOLD_BY: [f64; 3] = [0.0, 1.0, 2.5];
/// ... by one picture in so many.
const TOLD_STEP: usize = 3;
/// What all pictures gain by shares of their own is more than this, in cost (half of χ²).
const GAIN_MIN: f64 = 20.0;
/// One picture says no more than this.
const SAY_MAX: f64 = 20.0;
/// From one share to the next from picture to picture costs so much: the light does not change at random.
const STEP_COST: f64 = 1.5;
/// A picture with less than this share is in the shade.
const SHADED_MAX: f64 = 0.5;
/// A picture whose cost is still so many times the usual is not told by its share: something hides the ball.
const UNTOLD_COST: f64 = 5.0;
/// Holds a term of the light at nothing.
const STEADY_WEIGHT: f64 = 1e6;
/// Times that the shares are told from the ball, and the ball from the shares.
const PASSES_MAX: usize = 2;
/// The light is told by one picture in so many.
const LIGHT_STEP: usize = 3;
/// So many pictures at least have the share that becomes one.
const FULL_MIN: usize = 4;

impl Picture {
    /// The same with this share of the sphere's light.
    pub fn lit(mut self, share: f64) -> Self {
        self.share = share;
        self
    }

    /// Place in the track, and its share of the sphere's light.
    pub fn share(&self) -> (f64, f64) {
        (self.place, self.share)
    }

    /// Robust cost at the centre and the level that suit this share best.
    fn cost_at(&self, share: f64, shared: &Shared, edge: &Edge) -> f64 {
        let mut own = self.own;
        let sums = self.settle((&mut own, share), shared, edge, OWN_STEPS_POOLED);
        sums.map_or(f64::INFINITY, |sums| sums.cost)
    }

    /// The cost of each of [`SHARES`], from the share that it has to both sides until one costs so much more than the best
    /// that it says no more: those beyond it say the same.
    fn costs_by_share(&self, now: f64, shared: &Shared, edge: &Edge) -> [f64; SHARES.len()] {
        let from = SHARES.partition_point(|share| *share < self.share);
        let mut costs = [f64::INFINITY; SHARES.len()];
        let mut least = now;
        let mut walk = |places: &mut dyn Iterator<Item = usize>| {
            let mut beyond = None;
            for place in places {
                let (Some(share), Some(slot)) = (SHARES.get(place), costs.get_mut(place)) else {
                    continue;
                };
                *slot = beyond.unwrap_or_else(|| self.cost_at(*share, shared, edge));
                least = least.min(*slot);
                // Where the ball was not found at one share it may be at the next.
                if slot.is_finite() && *slot > least + SAY_MAX {
                    beyond = Some(*slot);
                }
            }
        };
        walk(&mut (from..SHARES.len()));
        walk(&mut (0..from).rev());
        costs
    }
}

/// Robust cost of all pictures, each with the share that it has, and of the shared parameters' prior. A picture in which the
/// ball is not found costs more than any other.
pub fn misfit(pictures: &[Picture], shared: &Shared, edge: &Edge) -> f64 {
    let costs = costs_now(pictures, shared, edge);
    let found = costs.iter().copied().filter(|cost| cost.is_finite());
    let lost = costs.iter().filter(|cost| !cost.is_finite()).count() as f64;
    let most = found.clone().fold(0.0, f64::max);
    shared.prior_cost() + found.sum::<f64>() + lost * (most + SAY_MAX)
}

/// A track's fit with the share of the sphere's light that each picture has, where shares explain it better than one light does;
/// the pictures stand in the order of their places.
pub fn fit_shares(
    pictures: &[Picture],
    shared: &Shared,
    edge: &Edge,
    steps_max: usize,
) -> Option<(Vec<Picture>, Shared, SharedMatrix)> {
    if !may_be_shaded(pictures, shared, edge) {
        return None;
    }
    // A light that drifts would be taken for shade, and a polynomial for the sun.
    let mut part: Vec<Picture> = pictures.iter().step_by(LIGHT_STEP).cloned().collect();
    let mut trial = first_fit(&mut part, &shared.steady(), edge, steps_max)?;
    let mut tried = pictures.to_vec();
    let mut passes = 0;
    while passes < PASSES_MAX && find_shares(&mut tried, &mut trial, edge) {
        fit_shared(&mut tried, &mut trial, edge, steps_max)?;
        passes += 1;
    }
    if passes == 0 {
        return None;
    }
    trial.weights = shared.weights;
    // What is left of the light in the shade and a polynomial against it are nearly the same: none is tried too.
    let full_shade = tried
        .iter()
        .map(|p| p.clone().lit(if p.share < SHADED_MAX { 0.0 } else { p.share }));
    let mut best = (misfit(pictures, shared, edge) - GAIN_MIN, None);
    for mut tried in [full_shade.collect(), tried] {
        let mut trial = trial;
        let Some((covariance, _)) = fit_shared(&mut tried, &mut trial, edge, steps_max) else {
            continue;
        };
        let cost = misfit(&tried, &trial, edge);
        if cost < best.0 {
            best = (cost, Some((tried, trial, covariance)));
        }
    }
    let (mut tried, mut trial, covariance) = best.1?;
    if !light_hidden(&mut tried, &trial, edge) {
        return Some((tried, trial, covariance));
    }
    let (covariance, _) = fit_shared(&mut tried, &mut trial, edge, steps_max)?;
    let better = misfit(&tried, &trial, edge) + GAIN_MIN < misfit(pictures, shared, edge);
    better.then_some((tried, trial, covariance))
}

/// Gives pictures that their share does not tell the full light again; whether there are any.
fn light_hidden(pictures: &mut [Picture], shared: &Shared, edge: &Edge) -> bool {
    let costs = costs_now(pictures, shared, edge);
    let untold = UNTOLD_COST * usual(&costs);
    let hidden = pictures.iter_mut().zip(&costs);
    let mut any = false;
    for (picture, _) in hidden.filter(|(picture, cost)| picture.share != 1.0 && **cost > untold) {
        picture.share = 1.0;
        any = true;
    }
    any
}

/// Whether some pictures one after the other are told better by another share: of one in so many, and of those beside the ones
/// that are. One picture alone does not tell: a hand or an edge is in it.
fn may_be_shaded(pictures: &[Picture], shared: &Shared, edge: &Edge) -> bool {
    let gain = |picture: &Picture| {
        let now = picture.cost_at(picture.share, shared, edge);
        let costs = TOLD_BY.iter().map(|share| picture.cost_at(*share, shared, edge));
        let gain = now - costs.fold(now, f64::min);
        // Where the ball is not found nothing is told.
        if gain.is_finite() { gain.min(SAY_MAX) } else { 0.0 }
    };
    let told: Vec<f64> = pictures.iter().step_by(TOLD_STEP).map(gain).collect();
    if best_run(told.iter().copied()) * TOLD_STEP as f64 <= GAIN_MIN {
        return false;
    }
    let gains_at = |at: usize| told.get(at).copied().filter(|gain| *gain > 0.0);
    let all = pictures.iter().enumerate().map(|(index, picture)| {
        let (before, between) = (index / TOLD_STEP, !index.is_multiple_of(TOLD_STEP));
        match gains_at(before) {
            own if !between => own.unwrap_or(0.0),
            None if gains_at(before + 1).is_none() => 0.0,
            _ => gain(picture),
        }
    });
    best_run(all) > GAIN_MIN
}

/// Cost of each picture with the share that it has.
fn costs_now(pictures: &[Picture], shared: &Shared, edge: &Edge) -> Vec<f64> {
    let costs = pictures.iter().map(|p| p.cost_at(p.share, shared, edge));
    costs.collect()
}

/// The cost that half of the pictures do not exceed.
fn usual(costs: &[f64]) -> f64 {
    median(costs.iter().copied()).unwrap_or(f64::INFINITY)
}

/// Finds the shares of the pictures; whether they explain them better than those they have. The fullest becomes one, and the
/// shared light what it then is.
fn find_shares(pictures: &mut [Picture], shared: &mut Shared, edge: &Edge) -> bool {
    let now = costs_now(pictures, shared, edge);
    let costs: Vec<[f64; SHARES.len()]> = pictures
        .iter()
        .zip(&now)
        .map(|(picture, now)| picture.costs_by_share(*now, shared, edge))
        .collect();
    let (path, gain) = likeliest(&costs, &now);
    if !(gain > GAIN_MIN) {
        return false;
    }
    let full = (0..SHARES.len())
        .rev()
        .find(|state| path.iter().filter(|s| *s >= state).count() >= FULL_MIN);
    let full = full
        .and_then(|state| SHARES.get(state))
        .copied()
        .unwrap_or(1.0)
        .max(0.25);
    for (picture, state) in pictures.iter_mut().zip(path) {
        picture.share = SHARES.get(state).copied().unwrap_or(1.0) / full;
    }
    shared.scale_light(full);
    true
}

/// The largest sum of neighbouring values.
fn best_run(values: impl Iterator<Item = f64>) -> f64 {
    let (mut best, mut sum) = (0.0, 0.0);
    for value in values.filter(|value| value.is_finite()) {
        // What the other shares do not help speaks against them, a little.
        sum = f64::max(sum + value - 0.5, 0.0);
        best = f64::max(best, sum);
    }
    best
}

/// The likeliest shares from picture to picture (Viterbi), and what they gain over the costs now.
fn likeliest(costs: &[[f64; SHARES.len()]], now: &[f64]) -> (Vec<usize>, f64) {
    let emission = |costs: &[f64; SHARES.len()], now: f64| -> [f64; SHARES.len()] {
        let least = costs.iter().copied().fold(now, f64::min);
        costs.map(|cost| (cost - least).min(SAY_MAX))
    };
    let mut total = [0.0; SHARES.len()];
    let mut back: Vec<[usize; SHARES.len()]> = Vec::with_capacity(costs.len());
    let mut before = 0.0;
    for (costs, now) in costs.iter().zip(now) {
        let least = costs.iter().copied().fold(*now, f64::min);
        if !least.is_finite() {
            back.push(std::array::from_fn(|state| state));
            continue;
        }
        before += (now - least).min(SAY_MAX);
        let own = emission(costs, *now);
        let mut next = [f64::INFINITY; SHARES.len()];
        let mut from = [0; SHARES.len()];
        for (state, (next, from)) in next.iter_mut().zip(&mut from).enumerate() {
            for (other, total) in total.iter().enumerate() {
                let cost = total + STEP_COST * state.abs_diff(other) as f64 + own[state];
                if cost < *next {
                    (*next, *from) = (cost, other);
                }
            }
        }
        total = next;
        back.push(from);
    }
    let last = total.iter().enumerate().min_by(|a, b| a.1.total_cmp(b.1));
    let (mut state, least) = last.map_or((4, 0.0), |(state, cost)| (state, *cost));
    let mut path = Vec::with_capacity(back.len());
    for from in back.iter().rev() {
        path.push(state);
        state = from[state];
    }
    path.reverse();
    (path, before - least)
}

impl Shared {
    /// With the light of the sphere alone, which does not drift.
    fn steady(&self) -> Self {
        let mut steady = *self;
        let light = steady
            .values
            .iter_mut()
            .zip(steady.weights.iter_mut())
            .enumerate();
        let held = |index: usize| (3..3 + DRIFTING).contains(&index) || index >= DRIFT;
        for (_, (value, weight)) in light.filter(|(index, _)| held(*index)) {
            (*value, *weight) = (0.0, STEADY_WEIGHT);
        }
        steady
    }

    /// The sphere's light so many times as strong.
    fn scale_light(&mut self, by: f64) {
        for value in self.values.iter_mut().skip(3 + DRIFTING) {
            *value *= by;
        }
    }
}
