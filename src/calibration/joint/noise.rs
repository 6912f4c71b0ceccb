//! How noisy each camera's points are, as the residuals tell: a factor on their covariance and the jitter of
//! the stamps, which shows as extra noise along the motion.

use nalgebra::{DMatrix, DVector, Matrix2};

use crate::flight::equations::Loss;
use crate::flight::sighting::{CameraNoise, Sight};
use crate::flight::solve::KEEP_LIMIT;
use crate::flight::trajectory::{FLIGHT_PARAMETERS, TERMS};

use super::problem::{JointProblem, JointState};
use super::solver::Linearised;

/// Fewer points than this do not tell a camera's noise.
const POINTS_NEEDED: usize = 30;
/// Jitter is believed when its variance is this many of its own sigmas above zero: without any, one camera
/// in 500 would be given some, which costs it little.
const JITTER_SIGMAS: f64 = 3.0;

/// No camera is believed to be quieter, pixels: points without any noise would weigh without limit, and the normal
/// equations would be singular to working accuracy.
const SIGMA_MIN_PX: f64 = 1e-3;

/// One point's residual along and across its motion.
struct Component {
    /// Squared residual, px², made up for the share of it that the fit took.
    square: f64,
    /// Variance the point claims in that direction, px².
    claimed: f64,
    /// Squared speed in the image along that direction, px²/s².
    speed2: f64,
}

/// Points in the problem.
pub(super) fn points(state: &JointState) -> usize {
    state.flights.iter().map(|f| f.sightings.len()).sum()
}

/// Sum over all points of the logarithm of their covariance's determinant.
pub(super) fn log_determinants(state: &JointState) -> f64 {
    let mut sum = 0.0;
    for flight in &state.flights {
        for s in &flight.sightings {
            if let Ok(sight) = Sight::new(&state.cameras[s.camera], &s.point, &flight.state.trajectory) {
                sum += sight.covariance_px2.determinant().max(1e-300).ln();
            }
        }
    }
    sum
}

/// Median over all points of the residual in sigmas.
pub(super) fn median_distance(state: &JointState) -> f64 {
    let mut distances: Vec<f64> = Vec::with_capacity(points(state));
    for flight in &state.flights {
        for s in &flight.sightings {
            let sight = Sight::new(&state.cameras[s.camera], &s.point, &flight.state.trajectory);
            distances.push(sight.map_or(f64::INFINITY, |s| s.distance2));
        }
    }
    distances.sort_by(f64::total_cmp);
    distances.get(distances.len() / 2).map_or(1.0, |d| d.sqrt())
}

/// Sets every camera's variance factor from the median residual, before anything else is known.
pub(super) fn scale_by_median(state: &mut JointState) {
    for camera in 0..state.cameras.len() {
        let mut distances = Vec::new();
        for flight in &state.flights {
            for s in flight.sightings.iter().filter(|s| s.camera == camera) {
                if let Ok(sight) = Sight::new(&state.cameras[camera], &s.point, &flight.state.trajectory) {
                    distances.push(sight.distance2);
                }
            }
        }
        if distances.len() < POINTS_NEEDED {
            continue;
        }
        distances.sort_by(f64::total_cmp);
        let ratio = distances[distances.len() / 2] / (2.0 * std::f64::consts::LN_2);
        state.cameras[camera].noise = scaled(state.cameras[camera].noise, ratio.max(1e-6));
    }
}

fn scaled(noise: CameraNoise, ratio: f64) -> CameraNoise {
    let ratio = ratio.max((SIGMA_MIN_PX / noise.sigma_px).powi(2));
    CameraNoise {
        sigma_px: noise.sigma_px * ratio.sqrt(),
        variance_factor: noise.variance_factor * ratio,
        jitter_s: noise.jitter_s,
    }
}

/// Re-estimates every camera's variance factor and jitter from the kept points by maximum likelihood, with
/// the leverage of each point taken out. Returns the largest relative change of a variance.
pub(super) fn estimate(problem: &JointProblem, state: &mut JointState, loss: Loss) -> f64 {
    let at = problem.linearise(state, loss);
    let Some(components) = components(problem, state, &at, loss) else {
        return 0.0;
    };
    let mut change: f64 = 0.0;
    for (camera, own) in components.iter().enumerate() {
        if own.len() < 2 * POINTS_NEEDED {
            continue;
        }
        let before = state.cameras[camera].noise;
        let (factor, jitter2) = likeliest(own, before.jitter_s);
        let ratio = factor / before.variance_factor;
        let mut after = scaled(before, ratio);
        after.jitter_s = jitter2.sqrt();
        let typical = own.iter().map(|c| c.speed2).sum::<f64>() / own.len() as f64;
        let jitter_change = (jitter2 - before.jitter_s.powi(2)).abs() * typical
            / own.iter().map(|c| c.claimed * factor).sum::<f64>()
            * own.len() as f64;
        change = change.max((ratio - 1.0).abs()).max(jitter_change);
        state.cameras[camera].noise = after;
    }
    change
}

fn components(
    problem: &JointProblem,
    state: &JointState,
    at: &Linearised,
    loss: Loss,
) -> Option<Vec<Vec<Component>>> {
    let reduced = at.reduce(0.0)?;
    let camera_covariance = reduced.cameras.inverse();
    let mut all: Vec<Vec<Component>> = (0..state.cameras.len()).map(|_| Vec::new()).collect();
    for ((flight, share), factor) in state.flights.iter().zip(&at.flights).zip(&reduced.flights) {
        let own = factor.inverse();
        let gain = &own * &share.ties;
        let with_cameras = -(&gain * &camera_covariance);
        let full = own - &with_cameras * gain.transpose();
        for s in &flight.sightings {
            let camera = &state.cameras[s.camera];
            let Ok(sight) = Sight::new(camera, &s.point, &flight.state.trajectory) else {
                continue;
            };
            if loss.apply(sight.distance2).1 < 0.5 {
                continue;
            }
            let mut by_flight = DMatrix::zeros(2, FLIGHT_PARAMETERS);
            for axis in 0..3 {
                for k in 0..TERMS {
                    for r in 0..2 {
                        by_flight[(r, axis * TERMS + k)] =
                            sight.by_position[(r, axis)] * sight.basis.value[k];
                    }
                }
            }
            let by_camera = sight.by_camera(camera, &s.point);
            let mut by_columns = DMatrix::zeros(2, problem.columns.len());
            for (i, column) in problem.columns.iter().enumerate() {
                if column.camera == s.camera {
                    by_columns.set_column(i, &by_camera.column(column.kind));
                }
            }
            let cross = &by_flight * &with_cameras * by_columns.transpose();
            let predicted = &by_flight * &full * by_flight.transpose()
                + &by_columns * &camera_covariance * by_columns.transpose()
                + &cross
                + cross.transpose();
            let predicted = Matrix2::new(
                predicted[(0, 0)],
                predicted[(0, 1)],
                predicted[(1, 0)],
                predicted[(1, 1)],
            );
            all[s.camera].extend(split(&sight, &predicted, s.point.covariance_px2, camera.noise));
        }
    }
    Some(all)
}

/// A point's residual along and across its motion.
fn split(
    sight: &Sight,
    predicted: &Matrix2<f64>,
    given: Option<Matrix2<f64>>,
    noise: CameraNoise,
) -> [Component; 2] {
    let speed2 = sight.velocity_px_per_s.norm_squared();
    let along = sight.velocity_px_per_s / speed2.sqrt().max(1e-9);
    let across = nalgebra::Vector2::new(-along.y, along.x);
    // What a point without a covariance claims is its share at variance factor one.
    let claimed = given.unwrap_or_else(|| {
        Matrix2::identity() * (noise.sigma_px * noise.sigma_px / noise.variance_factor.max(1e-12))
    });
    [(along, speed2), (across, 0.0)].map(|(e, speed2)| {
        let total = e.dot(&(sight.covariance_px2 * e));
        let left = (total - e.dot(&(predicted * e))).max(0.05 * total) / total;
        Component {
            square: e.dot(&sight.residual_px).powi(2) / left,
            claimed: e.dot(&(claimed * e)),
            speed2,
        }
    })
}

/// Variance factor f and jitter variance q that make the squares likeliest: var = f·claimed + q·speed².
fn likeliest(components: &[Component], jitter_s: f64) -> (f64, f64) {
    let plain = |own: &mut dyn Iterator<Item = &Component>| {
        let (mut sum, mut n) = (0.0, 0.0);
        for c in own {
            sum += c.square / c.claimed;
            n += 1.0;
        }
        sum / f64::max(n, 1.0)
    };
    let both = plain(&mut components.iter());
    let across = plain(&mut components.iter().filter(|c| c.speed2 == 0.0));
    let (mut f, mut q) = (across.max(1e-6), jitter_s * jitter_s);
    let mut sigma_q = f64::INFINITY;
    for _ in 0..30 {
        let mut normal = nalgebra::Matrix2::<f64>::zeros();
        let mut right = nalgebra::Vector2::<f64>::zeros();
        for c in components {
            let variance = f * c.claimed + q * c.speed2;
            let row = nalgebra::Vector2::new(c.claimed, c.speed2) / variance;
            normal += row * row.transpose();
            right += row * (c.square / variance);
        }
        let Some(inverse) = normal.try_inverse() else {
            break;
        };
        let next: nalgebra::Vector2<f64> = inverse * right;
        sigma_q = (2.0 * inverse[(1, 1)]).sqrt();
        let moved = (next.x - f).abs() / f;
        (f, q) = (next.x.max(0.05 * f), next.y.max(0.0));
        if moved < 1e-4 {
            break;
        }
    }
    if q < JITTER_SIGMAS * sigma_q {
        (both.max(1e-6), 0.0)
    } else {
        (f, q)
    }
}

/// Points in or out at the present noise.
pub(super) const KEPT: Loss = Loss::Truncated { limit: KEEP_LIMIT };

/// Which points are kept, flight by flight.
pub(super) fn kept(state: &JointState) -> Vec<Vec<bool>> {
    let keep = |s: &crate::flight::equations::Sighting, path| {
        Sight::new(&state.cameras[s.camera], &s.point, path)
            .is_ok_and(|sight| KEPT.apply(sight.distance2).1 > 0.5)
    };
    state
        .flights
        .iter()
        .map(|f| {
            let path = &f.state.trajectory;
            f.sightings.iter().map(|s| keep(s, path)).collect()
        })
        .collect()
}

/// Standard deviations of the camera unknowns.
pub(super) fn sigmas(covariance: &DMatrix<f64>) -> DVector<f64> {
    covariance.diagonal().map(|v| v.max(0.0).sqrt())
}
