//! Fits the picture of a ball ([`super::disc`]) to the cut-outs of one track together.
//!
//! Centre and level are each frame's own; radius, streak length and light belong to the ball and are shared, so
//! seventy frames determine them and one frame only has to find its centre. Gauss–Newton on the shared
//! parameters with the own ones eliminated (Schur complement); the centre's covariance contains both parts.

use nalgebra::{Matrix2, Matrix3, SMatrix, Vector2, Vector3};

use super::background::observe;
use super::disc::{Edge, LEVEL, OWN, PARAMETERS, Sweep};
use super::lanes::{Look, PixelLanes, Sums};
use super::median::median;
use super::patches::Patch;
use super::view::View;

pub use shade::{fit_shares, misfit};
use shared::{DRIFT, DRIFTING, LIGHT_STARTS};
pub use shared::{SHARED, Shared, SharedMatrix, SharedVector};

/// Most Gauss–Newton steps of a centre.
const OWN_STEPS_MAX: usize = 10;
/// ... while the shared parameters still move.
const OWN_STEPS_POOLED: usize = 3;
/// Converged when the centre would move less than this, pixels, and the level by less than this share.
const STEP_MIN_PX: f64 = 0.002;
const STEP_MIN_SHARE: f64 = 0.002;
/// The shared parameters are found when a step gains less than this share of the cost.
const GAIN_MIN: f64 = 1e-5;
/// The picture is never better than this share of the ball's contrast (optics, seams, steps of the light).
const MODEL_ERROR_SHARE: f64 = 0.02;
/// Residuals beyond this many σ count linearly.
const HUBER_SIGMAS: f64 = 2.5;
/// One frame's pixels and its own parameters.
#[derive(Debug, Clone)]
pub struct Picture {
    pixels: PixelLanes,
    sweep: Sweep,
    place: f64,
    /// The light, from the camera's axes to the line of sight's.
    turn: Matrix3<f64>,
    /// Share of the sphere's light: none in the shade.
    share: f64,
    start_px: Vector2<f64>,
    reach_px: f64,
    model_variance: f64,
    own: Vector3<f64>,
    /// How the own parameters follow the shared ones.
    follow: SMatrix<f64, OWN, SHARED>,
    chi2: f64,
    say: f64,
}

/// What is known of one frame before the fit.
#[derive(Debug, Clone, Copy)]
pub struct PictureStart {
    /// Centre to start from, pixels (no pull).
    pub centre_px: Vector2<f64>,
    /// Streak from start to end of the exposure at scale 1, pixels.
    pub streak_px: Vector2<f64>,
    /// Radius that decides which pixels are fitted.
    pub radius_px: f64,
    /// What the lens makes of it there.
    pub view: View,
    /// Place in the track, −½ at its begin, ½ at its end.
    pub place: f64,
}

impl PictureStart {
    /// Farthest that the fit may move the centre, pixels.
    fn reach_px(&self) -> f64 {
        self.radius_px + 0.5 * self.streak_px.norm() + 1.0
    }
}

/// A fitted centre.
#[derive(Debug, Clone, Copy)]
pub struct FittedCentre {
    /// Geometric centre at the exposure midpoint, pixels.
    pub centre_px: Vector2<f64>,
    /// Covariance of the centre, px²: this frame's noise and the shared parameters'.
    pub covariance_px2: Matrix2<f64>,
    /// Mean squared residual over its expectation.
    pub chi2: f64,
    /// Level of the ball before its light ([`LEVEL`]).
    pub level: f64,
}

impl Picture {
    /// Selects the pixels and guesses the level; `None` where there is too little to fit.
    pub fn new(patch: &Patch<'_>, start: &PictureStart, edge: &Edge) -> Option<Self> {
        let (observations, contrast) = observe(patch, start, edge.sigma_px);
        if observations.len() < 12 || contrast < 1.0 {
            return None;
        }
        let near = observations
            .iter()
            .filter(|o| (o.at - start.centre_px).norm() < 0.6 * start.radius_px + 0.7)
            .fold((0.0, 0.0), |(sum, n), o| (sum + o.value, n + 1.0));
        let level = near.0 / f64::max(near.1, 1.0);
        Some(Self {
            pixels: PixelLanes::new(&observations),
            sweep: Sweep::new(start.streak_px, edge.sigma_px, &start.view.shape),
            place: start.place,
            turn: start.view.turn,
            share: 1.0,
            start_px: start.centre_px,
            reach_px: start.reach_px(),
            model_variance: (MODEL_ERROR_SHARE * contrast).powi(2),
            own: Vector3::new(start.centre_px.x, start.centre_px.y, level.max(1.0) / 1.2),
            follow: SMatrix::zeros(),
            chi2: 1.0,
            say: 1.0,
        })
    }

    /// How unlike the ball it is: mean squared residual over its expectation.
    pub fn unlike(&self) -> f64 {
        self.chi2
    }

    /// For an edge of another blur.
    pub fn blur(&mut self, edge: &Edge) {
        self.sweep.blur(edge.sigma_px);
    }

    /// The same pixels for another place in the track, and the streak as it is known there; `None` where the ball that
    /// chose them was another by more than `change_max_px`.
    pub fn moved_to(&self, start: &PictureStart, edge: &Edge, change_max_px: f64) -> Option<Self> {
        let reach_px = start.reach_px();
        ((reach_px - self.reach_px).abs() < change_max_px).then(|| Self {
            sweep: Sweep::new(start.streak_px, edge.sigma_px, &start.view.shape),
            place: start.place,
            turn: start.view.turn,
            ..self.clone()
        })
    }

    /// Sums over the pixels: for all parameters, or for the own ones alone at half the cost.
    fn sums(&self, own: &Vector3<f64>, (shared, edge): (&Shared, &Edge), all: bool) -> Sums {
        self.sums_lit((own, self.share), (shared, edge), all)
    }

    /// The same with another share of the sphere's light.
    fn sums_lit(
        &self,
        (own, share): (&Vector3<f64>, f64),
        (shared, edge): (&Shared, &Edge),
        all: bool,
    ) -> Sums {
        let parameters = shared.fill((self.place, &self.turn, share), own);
        let noise = (self.model_variance, HUBER_SIGMAS);
        let look = Look::new(&parameters, (&self.sweep, edge), noise);
        if all {
            edge.kernels.linearise(&self.pixels, &look)
        } else {
            edge.kernels.locate(&self.pixels, &look)
        }
    }

    /// Finds centre and level for given shared parameters and share, from these on; gives the final sums over them alone.
    fn settle(
        &self,
        (own, share): (&mut Vector3<f64>, f64),
        shared: &Shared,
        edge: &Edge,
        steps_max: usize,
    ) -> Option<Sums> {
        let mut state = self.sums_lit((own, share), (shared, edge), false);
        let mut damping = 1e-3;
        for _ in 0..steps_max {
            let mut block: Matrix3<f64> = state.information.fixed_view::<OWN, OWN>(0, 0).into_owned();
            for i in 0..OWN {
                block[(i, i)] *= 1.0 + damping;
            }
            let step = block
                .cholesky()?
                .solve(&state.gradient.fixed_rows::<OWN>(0).into_owned());
            if step.xy().norm() < STEP_MIN_PX && step[LEVEL].abs() < STEP_MIN_SHARE * own[LEVEL] {
                break;
            }
            let trial = *own + step;
            let next = self.sums_lit((&trial, share), (shared, edge), false);
            if next.cost <= state.cost {
                *own = trial;
                state = next;
                damping = (damping * 0.2).max(1e-9);
            } else {
                damping *= 8.0;
                if damping > 1e5 {
                    break;
                }
            }
        }
        let away = (own.xy() - self.start_px).norm();
        (away.is_finite() && away < self.reach_px && own[LEVEL] > 0.0).then_some(state)
    }

    /// Finds centre and level for given shared parameters; gives the final linearisation.
    fn solve_own(&mut self, shared: &Shared, edge: &Edge, steps_max: usize) -> Option<Sums> {
        let mut own = self.own;
        let settled = self.settle((&mut own, self.share), shared, edge, steps_max);
        self.own = own;
        let state = self.sums(&self.own, (shared, edge), true);
        self.chi2 = match settled {
            Some(_) => state.squares / (state.used - 3.0).max(1.0),
            None => f64::INFINITY,
        };
        settled.map(|_| state)
    }

    /// See [`Shared::chain`].
    fn chain(&self, shared: &Shared) -> SMatrix<f64, { PARAMETERS - OWN }, SHARED> {
        shared.chain((self.place, &self.turn, self.share))
    }
}

/// One step's pooled equations with every frame's own parameters eliminated.
struct Pooled {
    information: SharedMatrix,
    gradient: SharedVector,
    cost: f64,
}

/// Every frame's own parameters for these shared ones; `None` where the picture is not a ball's.
fn look(pictures: &mut [Picture], shared: &Shared, edge: &Edge) -> Vec<Option<Sums>> {
    let solve = |picture: &mut Picture| {
        let before = picture.own;
        let sums = picture.solve_own(shared, edge, OWN_STEPS_POOLED);
        if sums.is_none() {
            picture.own = before;
        }
        sums
    };
    pictures.iter_mut().map(solve).collect()
}

fn pool(pictures: &mut [Picture], looks: &[Option<Sums>], shared: &Shared) -> Pooled {
    let off = shared.values - shared.prior;
    let mut pooled = Pooled {
        information: SharedMatrix::from_diagonal(&shared.weights),
        gradient: -off.component_mul(&shared.weights),
        cost: shared.prior_cost(),
    };
    for (picture, look) in pictures.iter_mut().zip(looks) {
        picture.follow = SMatrix::zeros();
        let Some(normal) = look else { continue };
        let own: Matrix3<f64> = normal.information.fixed_view::<OWN, OWN>(0, 0).into_owned();
        let Some(inverse) = own.try_inverse() else {
            continue;
        };
        let chain = picture.chain(shared);
        let cross = normal.information.fixed_view::<OWN, { PARAMETERS - OWN }>(0, OWN) * chain;
        let rest = normal
            .information
            .fixed_view::<{ PARAMETERS - OWN }, { PARAMETERS - OWN }>(OWN, OWN);
        let own_gradient = normal.gradient.fixed_rows::<OWN>(0);
        let rest_gradient = chain.transpose() * normal.gradient.fixed_rows::<{ PARAMETERS - OWN }>(OWN);
        let say = picture.say;
        picture.follow = -(inverse * cross);
        let eliminated = cross.transpose() * inverse;
        pooled.information += (chain.transpose() * rest * chain - eliminated * cross) * say;
        pooled.gradient += (rest_gradient - eliminated * own_gradient) * say;
        pooled.cost += normal.cost * say;
    }
    pooled
}

/// A frame that looks less like the ball than most (half hidden, at an edge) has little say.
fn weigh(pictures: &mut [Picture]) {
    let found = pictures.iter().map(|p| p.chi2).filter(|chi2| chi2.is_finite());
    let usual = median(found).unwrap_or(1.0).max(0.5);
    for picture in pictures {
        picture.say = 1.0 / (1.0 + (picture.chi2 / (3.0 * usual)).powi(4));
    }
}

/// Fits the shared parameters of a track; gives their covariance and the cost reached.
pub fn fit_shared(
    pictures: &mut [Picture],
    shared: &mut Shared,
    edge: &Edge,
    steps_max: usize,
) -> Option<(SharedMatrix, f64)> {
    let looks = look(pictures, shared, edge);
    weigh(pictures);
    let mut state = pool(pictures, &looks, shared);
    let mut damping = 1e-2;
    for _ in 0..steps_max {
        let mut damped = state.information;
        for i in 0..SHARED {
            damped[(i, i)] *= 1.0 + damping;
        }
        let step = damped.cholesky()?.solve(&state.gradient);
        let mut trial = *shared;
        trial.values += step;
        trial.clamp();
        let kept: Vec<_> = pictures.iter().map(|p| (p.own, p.follow)).collect();
        for picture in pictures.iter_mut() {
            picture.own += picture.follow * (trial.values - shared.values);
        }
        let looks = look(pictures, &trial, edge);
        let next = pool(pictures, &looks, &trial);
        if next.cost <= state.cost {
            let gain = state.cost - next.cost;
            *shared = trial;
            state = next;
            damping = (damping * 0.2).max(1e-9);
            if gain < GAIN_MIN * state.cost.max(1.0) {
                break;
            }
        } else {
            for (picture, (own, follow)) in pictures.iter_mut().zip(kept) {
                (picture.own, picture.follow) = (own, follow);
            }
            damping *= 8.0;
            if damping > 1e4 {
                break;
            }
        }
    }
    Some((state.information.cholesky()?.inverse(), state.cost))
}

/// [`fit_shared`] of a ball of which nothing is known yet, from several lights: the best shared parameters.
pub fn first_fit(pictures: &mut [Picture], first: &Shared, edge: &Edge, steps_max: usize) -> Option<Shared> {
    let mut best: Option<(f64, Shared, Vec<Picture>)> = None;
    for light in LIGHT_STARTS {
        let (mut tried, mut shared) = (pictures.to_vec(), first.lit_from(light));
        let cost =
            fit_shared(&mut tried, &mut shared, edge, steps_max).map(|_| misfit(&tried, &shared, edge));
        if let Some(cost) = cost.filter(|cost| best.as_ref().is_none_or(|best| *cost < best.0)) {
            best = Some((cost, shared, tried));
        }
    }
    let (_, shared, tried) = best?;
    pictures.clone_from_slice(&tried);
    Some(shared)
}

/// The centre of one picture under the shared parameters found; `None` where it is not a ball.
pub fn fit_centre(
    picture: &mut Picture,
    shared: &Shared,
    covariance: &SharedMatrix,
    edge: &Edge,
) -> Option<FittedCentre> {
    let normal = picture.solve_own(shared, edge, OWN_STEPS_MAX)?;
    let own: Matrix3<f64> = normal.information.fixed_view::<OWN, OWN>(0, 0).into_owned();
    let inverse = own.cholesky()?.inverse();
    let chain = picture.chain(shared);
    let by_shared = inverse * (normal.information.fixed_view::<OWN, { PARAMETERS - OWN }>(0, OWN) * chain);
    let total = inverse * picture.chi2.max(1.0) + by_shared * covariance * by_shared.transpose();
    Some(FittedCentre {
        centre_px: picture.own.xy(),
        covariance_px2: total.fixed_view::<2, 2>(0, 0).into_owned(),
        chi2: picture.chi2,
        level: picture.own[LEVEL],
    })
}

mod hidden;
mod shade;
mod shared;
#[cfg(test)]
mod tests;
