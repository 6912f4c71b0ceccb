//! One pitch from its tracks and a known calibration.

use nalgebra::{DMatrix, DVector};

use super::FlightError;
use super::equations::{FlightEquations, Loss, Sighting};
use super::outcome::{SolvedFlight, summarise};
use super::physics::Physics;
use super::sighting::{CAMERA_KINDS, CameraModel, Sight};
use super::start::linear_start;
use super::trajectory::{FLIGHT_PARAMETERS, FlightPrior, Trajectory};
use crate::scene::{Calibration, Site, Track, WorldFrame};

/// Points in or out, in sigmas of the two-dimensional residual: loses 4 in 100,000 good points.
pub const KEEP_LIMIT: f64 = 4.5;
/// Fewest points that fix a flight with a point to spare.
const POINTS_NEEDED: usize = 6;

/// What −2·ln(evidence) must gain before more residual acceleration is believed. Normal pitches outnumber
/// knuckleballs; without it half of the normal ones at 0.3 px were given 0.15 m/s².
const FREEDOM_PENALTY: f64 = 8.0;

/// A step that promises less (squared sigmas) is taken and is the last: the one after it would promise its
/// square.
const PROMISE_LITTLE: f64 = 1e-2;
/// A step that promises less is not taken.
const PROMISE_NOTHING: f64 = 1e-8;

/// Levels of residual acceleration tried while the ball flies.
const IN_FLIGHT_LEVELS: usize = 3;

/// How a flight is solved.
#[derive(Debug, Clone, PartialEq)]
pub struct FlightOptions {
    /// Air and gravity.
    pub physics: Physics,
    /// Prior of drag, lift and residual acceleration (its sigma is the first of the levels).
    pub prior: FlightPrior,
    /// Sizes of residual acceleration tried, m/s², from rigid physics to a wild knuckleball; the one with
    /// the best marginal likelihood is kept.
    pub acceleration_levels_mps2: Vec<f64>,
    /// y range to cover besides the points, metres: from behind the plate to before the release. `None`
    /// where the world is not the home-plate frame.
    pub cover_y_m: Option<(f64, f64)>,
}

impl Default for FlightOptions {
    fn default() -> Self {
        Self {
            physics: Physics::default(),
            prior: FlightPrior::default(),
            acceleration_levels_mps2: vec![0.02, 0.15, 1.0, 5.0, 20.0],
            cover_y_m: Some((-0.1, 16.9)),
        }
    }
}

impl FlightOptions {
    /// For a ball still in flight: the unseen rest of the way is flown by the physics, so what is seen may not be
    /// explained by much else.
    pub fn in_flight(mut self) -> Self {
        self.acceleration_levels_mps2.truncate(IN_FLIGHT_LEVELS);
        self
    }

    /// With the site's gravity and air, for flights in this kind of world.
    pub fn for_site(site: &Site, world: WorldFrame) -> Self {
        Self {
            physics: Physics::new(site.gravity_mps2, site.air_density_kgpm3),
            cover_y_m: (world == WorldFrame::HomePlate).then_some((-0.1, 16.9)),
            ..Self::default()
        }
    }
}

/// A flight, its prior and its equations' robust state while it is being solved.
#[derive(Debug, Clone)]
pub struct FlightState {
    /// Where the flight is.
    pub trajectory: Trajectory,
    /// With the level of residual acceleration now held.
    pub prior: FlightPrior,
}

/// Solves one pitch with a known calibration; the calibration's own covariance is carried into the
/// flight's. Tracks of one camera may come in pieces.
pub fn solve_flight(
    calibration: &Calibration,
    tracks: &[Track],
    options: &FlightOptions,
) -> Result<SolvedFlight, FlightError> {
    let cameras: Vec<CameraModel> = calibration
        .cameras
        .iter()
        .map(CameraModel::from_calibration)
        .collect();
    let sightings = gather(&cameras, tracks)?;
    let epoch_ns = epoch(&sightings);
    let state = fit_flight(&cameras, &sightings, epoch_ns, options)?;
    let limit = KEEP_LIMIT * misfit_scale(&cameras, &state.trajectory, &sightings);
    let loss = Loss::Truncated { limit };
    let equations =
        FlightEquations::with_cameras(&cameras, &state.trajectory, &sightings, loss, &state.prior);
    let own = equations.factor(0.0).ok_or(FlightError::Unobservable)?.inverse();
    let mut solved = summarise(&cameras, tracks, &sightings, &state, loss);
    solved.covariance = add_calibration_uncertainty(calibration, &equations, own);
    check(&solved, sightings.len())?;
    Ok(solved)
}

/// Every point of the tracks with its camera's index.
pub fn gather(cameras: &[CameraModel], tracks: &[Track]) -> Result<Vec<Sighting>, FlightError> {
    let mut sightings = Vec::new();
    for (track, t) in tracks.iter().enumerate() {
        let camera =
            cameras
                .iter()
                .position(|c| c.id == t.camera)
                .ok_or_else(|| FlightError::UnknownCamera {
                    camera: t.camera.clone(),
                })?;
        sightings.extend(t.points.iter().map(|p| Sighting {
            camera,
            track,
            point: *p,
        }));
    }
    if sightings.len() < POINTS_NEEDED {
        let mut seen: Vec<_> = sightings.iter().map(|s| s.camera).collect();
        seen.dedup();
        return Err(FlightError::TooFewPoints {
            points: sightings.len(),
            cameras: seen.len(),
            needed: POINTS_NEEDED,
        });
    }
    Ok(sightings)
}

/// Zero of a flight's time axis: its first stamp.
pub fn epoch(sightings: &[Sighting]) -> i64 {
    sightings
        .iter()
        .map(|s| s.point.stamped.nanos())
        .min()
        .unwrap_or(0)
}

/// Robust fit of one flight with the cameras held: linear start, broad loss, then in-or-out; the residual
/// acceleration's size by marginal likelihood.
pub fn fit_flight(
    cameras: &[CameraModel],
    sightings: &[Sighting],
    epoch_ns: i64,
    options: &FlightOptions,
) -> Result<FlightState, FlightError> {
    let (start, median_px) =
        linear_start(cameras, sightings, options.physics, epoch_ns).ok_or(FlightError::Unobservable)?;
    let levels = &options.acceleration_levels_mps2;
    let first = levels
        .first()
        .copied()
        .unwrap_or(options.prior.acceleration_sigma_mps2);
    let mut state = FlightState {
        trajectory: cover(start, options),
        prior: FlightPrior {
            acceleration_sigma_mps2: first,
            ..options.prior
        },
    };
    let sigma_px = cameras.iter().map(|c| c.noise.sigma_px).fold(0.1, f64::max);
    let mut scale = (2.0 * median_px / sigma_px).clamp(3.0, 1000.0);
    loop {
        state.descend(cameras, sightings, Loss::Cauchy { scale }, 6)?;
        if scale <= 3.0 {
            break;
        }
        scale = (scale / 4.0).max(3.0);
    }
    state.settle(cameras, sightings)?;
    choose_level(state, cameras, sightings, levels)
}

/// Moves to the size of residual acceleration with the best marginal likelihood. A look ahead along one
/// Newton step chooses the size to try; for a normal pitch it ends the search.
pub fn choose_level(
    mut best: FlightState,
    cameras: &[CameraModel],
    sightings: &[Sighting],
    levels: &[f64],
) -> Result<FlightState, FlightError> {
    let loss = Loss::Truncated { limit: KEEP_LIMIT };
    for _ in 0..levels.len() {
        let points = FlightEquations::of_points(cameras, &best.trajectory, sightings, loss);
        let now = points.with_prior(&best.trajectory, &best.prior);
        let best_cost = now.evidence_cost(&best.prior).unwrap_or(f64::INFINITY);
        let promising = levels
            .iter()
            .filter(|level| **level > best.prior.acceleration_sigma_mps2)
            .map(|level| FlightPrior {
                acceleration_sigma_mps2: *level,
                ..best.prior
            })
            .map(|prior| (evidence_ahead(&points, &best.trajectory, &prior), prior))
            .min_by(|a, b| a.0.total_cmp(&b.0));
        let Some((ahead, prior)) = promising else { break };
        if !(ahead + FREEDOM_PENALTY < best_cost) {
            break;
        }
        let mut freer = FlightState {
            prior,
            ..best.clone()
        };
        freer.settle(cameras, sightings)?;
        if !(freer.evidence_cost(cameras, sightings) + FREEDOM_PENALTY < best_cost) {
            break;
        }
        best = freer;
    }
    Ok(best)
}

/// The evidence cost that a full step promises under a prior, points kept as they are.
fn evidence_ahead(points: &FlightEquations, path: &Trajectory, prior: &FlightPrior) -> f64 {
    let equations = points.with_prior(path, prior);
    let promised = equations
        .factor(0.0)
        .map_or(0.0, |f| f.solve(&equations.gradient).dot(&equations.gradient));
    equations
        .evidence_cost(prior)
        .map_or(f64::INFINITY, |cost| cost - promised)
}

impl FlightState {
    fn evidence_cost(&self, cameras: &[CameraModel], sightings: &[Sighting]) -> f64 {
        let loss = Loss::Truncated { limit: KEEP_LIMIT };
        FlightEquations::new(cameras, &self.trajectory, sightings, loss, &self.prior)
            .evidence_cost(&self.prior)
            .unwrap_or(f64::INFINITY)
    }

    /// In-or-out passes until the kept points no longer change.
    pub fn settle(&mut self, cameras: &[CameraModel], sightings: &[Sighting]) -> Result<(), FlightError> {
        for _ in 0..2 {
            self.trajectory = self.trajectory.clone().with_own_exponent();
            let limit = KEEP_LIMIT * misfit_scale(cameras, &self.trajectory, sightings);
            self.descend(cameras, sightings, Loss::Truncated { limit }, 12)?;
            if limit <= KEEP_LIMIT {
                break;
            }
        }
        Ok(())
    }

    /// Levenberg–Marquardt on the flight alone.
    pub fn descend(
        &mut self,
        cameras: &[CameraModel],
        sightings: &[Sighting],
        loss: Loss,
        iterations: usize,
    ) -> Result<(), FlightError> {
        // A broad loss is only the way to the next one.
        let little = match loss {
            Loss::Cauchy { .. } => 1.0,
            Loss::Truncated { .. } => PROMISE_LITTLE,
        };
        let mut damping = 1e-6;
        let mut equations = FlightEquations::new(cameras, &self.trajectory, sightings, loss, &self.prior);
        for _ in 0..iterations {
            let step: DVector<f64> = match equations.factor(damping) {
                Some(factor) => -factor.solve(&equations.gradient),
                None if damping < 1e6 => {
                    damping = (damping * 100.0).max(1e-3);
                    continue;
                }
                None => return Err(FlightError::Unobservable),
            };
            let promised = -step.dot(&equations.gradient);
            if promised < PROMISE_NOTHING {
                break;
            }
            let trial = self
                .trajectory
                .with_parameters(self.trajectory.parameters() + &step);
            // Derivatives along with the cost: nearly every step is accepted and needs them next.
            let there = FlightEquations::new(cameras, &trial, sightings, loss, &self.prior);
            if there.cost() <= equations.cost() {
                self.trajectory = trial;
                equations = there;
                damping = (damping * 0.1).max(1e-9);
            } else {
                damping = (damping * 20.0).max(1e-4);
            }
            if promised < little {
                break;
            }
        }
        Ok(())
    }
}

/// Robust ratio of the residuals to their sigmas, at least 1: the median of d² is 2·ln 2 for honest sigmas.
pub fn misfit_scale(cameras: &[CameraModel], trajectory: &Trajectory, sightings: &[Sighting]) -> f64 {
    let mut distances: Vec<f64> = sightings
        .iter()
        .map(|s| Sight::new(&cameras[s.camera], &s.point, trajectory).map_or(f64::INFINITY, |s| s.distance2))
        .collect();
    distances.sort_by(f64::total_cmp);
    let median = distances.get(distances.len() / 2).copied().unwrap_or(0.0);
    let scale = (median / (2.0 * std::f64::consts::LN_2)).sqrt();
    // The median of a hundred points wanders by a tenth; only a clear excess is one.
    if scale > 1.15 { scale.min(1e6) } else { 1.0 }
}

/// Widens the span to the y range asked for, by the physics, but not by more than half a second a side.
pub fn cover(trajectory: Trajectory, options: &FlightOptions) -> Trajectory {
    let Some((plate_y, release_y)) = options.cover_y_m else {
        return trajectory;
    };
    let (mut begin, mut end) = trajectory.span_s();
    let step = 0.01;
    let y = |t: f64| trajectory.extended_position_m(t).y;
    for _ in 0..50 {
        if y(begin) >= release_y {
            break;
        }
        begin -= step;
    }
    for _ in 0..50 {
        if y(end) <= plate_y {
            break;
        }
        end += step;
    }
    if (begin, end) == trajectory.span_s() {
        trajectory
    } else {
        trajectory.with_span(begin, end)
    }
}

/// Flight covariance given exact cameras → with the calibration's covariance: G·Σ·Gᵀ, G = H⁻¹·Hᶠᶜ.
fn add_calibration_uncertainty(
    calibration: &Calibration,
    equations: &FlightEquations,
    own: DMatrix<f64>,
) -> DMatrix<f64> {
    let n = calibration.parameters.len();
    let rows = &calibration.covariance;
    if n == 0 || rows.len() != n || rows.iter().any(|r| r.len() != n) {
        return own;
    }
    let mut ties = DMatrix::zeros(FLIGHT_PARAMETERS, n);
    for (column, parameter) in calibration.parameters.iter().enumerate() {
        let camera = calibration.cameras.iter().position(|c| c.id == parameter.camera);
        let kind = CAMERA_KINDS.iter().position(|k| *k == parameter.kind);
        if let (Some(camera), Some(kind)) = (camera, kind) {
            ties.set_column(column, &equations.cameras[camera].cross.row(kind).transpose());
        }
    }
    let covariance = DMatrix::from_fn(n, n, |r, c| rows[r][c]);
    let gain = &own * ties;
    let mut total = own + &gain * covariance * gain.transpose();
    total = 0.5 * (&total + total.transpose());
    total
}

fn check(solved: &SolvedFlight, points: usize) -> Result<(), FlightError> {
    let kept = solved.kept();
    if kept < POINTS_NEEDED || 2 * kept < points {
        return Err(FlightError::NoFit {
            kept,
            points,
            rms_px: solved.rms_px(),
        });
    }
    Ok(())
}
