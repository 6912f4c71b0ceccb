//! The blur of a camera's optics: the one that explains its balls best.

use super::disc::Edge;
use super::fit::{Picture, Shared, first_fit, fit_shared, fit_shares, misfit};
use super::median::median;

/// Blurs of the disc's edge that are tried (σ, pixels): pixel area alone to soft optics.
pub const EDGE_SIGMAS_PX: [f64; 10] = [0.3, 0.36, 0.43, 0.52, 0.62, 0.74, 0.88, 1.05, 1.25, 1.5];
/// Points of a track that has a say in the blur.
const BLUR_POINTS_MIN: usize = 30;
/// ... and its costs do not differ by more than this between the best blur and those beside it.
const BLUR_RATIO_MAX: f64 = 4.0;
/// Blurs on each side of the best that are compared with it.
const BESIDE: usize = 2;
/// The blur tried first where none is known.
const USUAL: usize = 4;
/// A picture this many times as unlike the ball as most has no say.
const UNLIKE_MAX: f64 = 2.5;
/// Tracks on which all blurs are tried.
const BLUR_TRACKS: usize = 3;
/// Gauss–Newton steps of a trial.
const STEPS: usize = 8;

/// How well each blur explains one ball.
pub type BlurCosts = [f64; EDGE_SIGMAS_PX.len()];

/// How well each blur has explained the balls so far; the camera's optics do not change from pitch to pitch.
#[derive(Debug, Clone, Copy, Default)]
pub struct BlurChoice {
    costs: BlurCosts,
    tracks: usize,
}

impl BlurChoice {
    /// Whether a ball has taught it.
    pub fn is_known(&self) -> bool {
        self.tracks > 0
    }

    /// With one ball more, while more are of use.
    pub fn learn(&mut self, own: &BlurCosts) {
        if self.tracks >= BLUR_TRACKS {
            return;
        }
        // Of every ball how many times: one that fits badly says no more than another.
        let low = own.iter().copied().fold(f64::INFINITY, f64::min).max(1e-9);
        for (sum, cost) in self.costs.iter_mut().zip(own) {
            *sum += (cost / low).ln();
        }
        self.tracks += 1;
    }

    /// Index of the likeliest blur tried.
    fn best(&self) -> usize {
        least(&self.costs)
    }

    /// The likeliest blur: where a parabola through the best and its neighbours is lowest.
    fn sigma_px(&self) -> Option<f64> {
        let best = self.best();
        let middle = EDGE_SIGMAS_PX.get(best).copied()?;
        let side =
            |i: Option<usize>| i.and_then(|i| EDGE_SIGMAS_PX.get(i).copied().zip(self.costs.get(i).copied()));
        let (Some((low, cost_low)), Some((high, cost_high))) =
            (side(best.checked_sub(1)), side(Some(best + 1)))
        else {
            return Some(middle);
        };
        let cost = self.costs.get(best).copied()?;
        let (a, b) = (
            (middle - low) * (cost - cost_high),
            (middle - high) * (cost - cost_low),
        );
        let shift = 0.5 * ((middle - low) * a - (middle - high) * b) / (a - b);
        Some(if shift.is_finite() {
            (middle - shift).clamp(low, high)
        } else {
            middle
        })
    }

    /// Whether these costs are those of a ball: no blur explains it many times as well as those beside it.
    fn plausible(costs: &BlurCosts) -> bool {
        let (best, low) = costs
            .iter()
            .copied()
            .enumerate()
            .min_by(|a, b| a.1.total_cmp(&b.1))
            .unwrap_or((0, f64::INFINITY));
        let beside = costs
            .iter()
            .skip(best.saturating_sub(BESIDE))
            .take(2 * BESIDE + 1);
        beside.copied().fold(0.0, f64::max) < BLUR_RATIO_MAX * low
    }
}

/// Fits a few pictures of a track with every blur (later only with the best) and takes the likeliest over all tracks. With
/// it how well each blur explains this track, if it is to have a say. The pictures are of the same pixels for every blur, or
/// their costs could not be compared.
pub fn choose_edge(
    mut pictures: Vec<Picture>,
    first: &Shared,
    points: usize,
    blur: &BlurChoice,
) -> Option<(Edge, Shared, Option<BlurCosts>)> {
    let settled = blur.tracks >= BLUR_TRACKS || (blur.tracks > 0 && points < BLUR_POINTS_MIN);
    if settled {
        let (_, shared) = Comparison::new(&mut pictures, first).hold(blur.best())?;
        return Some((Edge::new(blur.sigma_px()?), shared, None));
    }
    let begin = if blur.tracks > 0 { blur.best() } else { USUAL };
    let (mut own, mut held) = compare(&mut pictures, first, begin)?;
    if look_closer(&mut pictures, &own, &held) {
        (own, held) = compare(&mut pictures, first, least(&own))?;
    }
    let mut total = *blur;
    total.learn(&own);
    let mut comparison = Comparison::new(&mut pictures, first);
    comparison.held = Some(held);
    let (_, shared) = comparison.hold(total.best())?;
    // Only a long track is surely a ball.
    let has_a_say = points >= BLUR_POINTS_MIN && BlurChoice::plausible(&own);
    Some((Edge::new(total.sigma_px()?), shared, has_a_say.then_some(own)))
}

/// The index of the least cost.
fn least(costs: &BlurCosts) -> usize {
    let costs = costs.iter().enumerate();
    costs.min_by(|a, b| a.1.total_cmp(b.1)).map_or(0, |(i, _)| i)
}

/// Fits pictures with one blur after the other, each from where the last has ended: from blur to blur a ball changes little.
struct Comparison<'a> {
    pictures: &'a mut [Picture],
    first: &'a Shared,
    held: Option<Shared>,
    released: Option<Shared>,
    costs: [Option<f64>; EDGE_SIGMAS_PX.len()],
}

impl<'a> Comparison<'a> {
    fn new(pictures: &'a mut [Picture], first: &'a Shared) -> Self {
        Self {
            pictures,
            first,
            held: None,
            released: None,
            costs: [None; EDGE_SIGMAS_PX.len()],
        }
    }

    fn blur(&mut self, index: usize) -> Option<Edge> {
        let edge = Edge::new(EDGE_SIGMAS_PX.get(index).copied()?);
        for picture in self.pictures.iter_mut() {
            picture.blur(&edge);
        }
        Some(edge)
    }

    /// The ball by the sphere's light alone, with a blur: the polynomial would match the light to a wrong blur.
    fn hold(&mut self, index: usize) -> Option<(Edge, Shared)> {
        let edge = self.blur(index)?;
        let held = match self.held {
            Some(mut held) => fit_shared(self.pictures, &mut held, &edge, STEPS).map(|_| held),
            None => first_fit(self.pictures, self.first, &edge, STEPS),
        };
        self.held = held.or(self.held);
        Some((edge, held?))
    }

    /// How well a blur explains the pictures; what the light then makes of it only compares the blurs.
    fn cost(&mut self, index: usize) -> Option<f64> {
        if let Some(cost) = self.costs.get(index).copied().flatten() {
            return Some(cost);
        }
        let (edge, mut shared) = match self.released {
            Some(released) => (self.blur(index)?, released),
            None => self.hold(index)?,
        };
        shared.release_light();
        fit_shared(self.pictures, &mut shared, &edge, STEPS)?;
        self.released = Some(shared);
        let cost = misfit(self.pictures, &shared, &edge);
        *self.costs.get_mut(index)? = Some(cost);
        Some(cost)
    }
}

/// The pictures with blurs from one on, to the better side until those beside the best are worse; the others are taken as no
/// better than the worst. With the costs the ball by the sphere's light alone, with the best blur.
fn compare(pictures: &mut [Picture], first: &Shared, begin: usize) -> Option<(BlurCosts, Shared)> {
    let mut comparison = Comparison::new(pictures, first);
    let mut best = begin;
    loop {
        let beside = best.saturating_sub(1)..=(best + 1).min(EDGE_SIGMAS_PX.len() - 1);
        let costs = beside.map(|index| (index, comparison.cost(index).unwrap_or(f64::INFINITY)));
        let least = costs.min_by(|a, b| a.1.total_cmp(&b.1));
        match least {
            Some((index, cost)) if index != best && cost.is_finite() => best = index,
            _ => break,
        }
    }
    let (_, held) = comparison.hold(best)?;
    let costs = comparison.costs;
    // None where none could be fitted.
    costs.iter().flatten().next()?;
    let worst = costs.iter().copied().flatten().fold(0.0, f64::max);
    Some((costs.map(|cost| cost.unwrap_or(worst)), held))
}

/// Leaves out pictures that look less like the ball than most, and finds those in the shade, which a wrong blur would else
/// explain; whether the blurs have to be compared again.
fn look_closer(pictures: &mut Vec<Picture>, costs: &BlurCosts, held: &Shared) -> bool {
    let Some(sigma_px) = EDGE_SIGMAS_PX.get(least(costs)) else {
        return false;
    };
    let (edge, mut shared) = (Edge::new(*sigma_px), *held);
    for picture in pictures.iter_mut() {
        picture.blur(&edge);
    }
    if fit_shared(pictures, &mut shared, &edge, STEPS).is_none() {
        return false;
    }
    let shaded = fit_shares(pictures, &shared, &edge, STEPS);
    let mut again = shaded.is_some();
    if let Some((lit, _, _)) = shaded {
        *pictures = lit;
    }
    let usual = median(pictures.iter().map(Picture::unlike))
        .unwrap_or(1.0)
        .max(0.5);
    let like = |picture: &Picture| picture.unlike() < UNLIKE_MAX * usual;
    let (kept, count) = (pictures.iter().filter(|p| like(p)).count(), pictures.len());
    if kept < count && 2 * kept > count {
        pictures.retain(like);
        again = true;
    }
    again
}
