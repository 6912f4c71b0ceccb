//! The last stage: the reference camera's world and clock, every unknown free, and the answer with its sigmas.

use nalgebra::{DMatrix, DVector, Matrix3};

use super::agreement::AGREES_PX;
use super::grow::{Grown, Phase, Session};
use super::problem::{Distance, Problem, State};
use super::solver::{Held, fit_spline, minimise, redundancy, update_scales};
use super::spline::{ORDER, Spline};
use super::support::Support;
use super::view::{CameraState, View};
use crate::calibration::CalibrationError;
use crate::geometry::Pose;

/// A finished solution with what its uncertainty needs.
pub(super) struct Solution {
    pub state: State,
    /// Sightings that went in.
    pub views: Vec<View>,
    pub support: Support,
    /// Unknowns of the border, in the order of the covariance.
    pub columns: Vec<super::view::Column>,
    pub covariance: DMatrix<f64>,
    pub condition: f64,
    /// Factor by which lasting errors widen the covariance.
    pub redundancy: f64,
    held: Held,
    /// A⁻¹B, row by row.
    response: Vec<f64>,
}

/// Most rounds of "minimise, then rescale noise and smoothness".
const ROUNDS: usize = 12;

fn stuck(reason: &str) -> CalibrationError {
    CalibrationError::NotConverged {
        stage: "joint estimate of the free motion",
        reason: reason.to_owned(),
    }
}

/// Turns a grown rig into the final solution. `distances` fix the scale; without them the first baseline is 1.
pub(super) fn finish(
    session: &Session,
    grown: &Grown,
    (reference, distances): (usize, &[Distance]),
) -> Result<Solution, CalibrationError> {
    let mut state = grown.state.clone();
    let scale = regauge(session, &mut state, (reference, distances))
        .ok_or_else(|| stuck("the reference camera is not among the calibrated ones"))?;
    let mut precision = grown.jerk_precision / (scale * scale);
    let knots = session.options.knot_s.map_or_else(|| vec![0.1], |k| vec![k]);
    let mut last = None;
    for knot_s in knots {
        let (solution, jerk) = refined(session, state, (reference, distances), (knot_s, precision))?;
        precision = jerk;
        state = solution.state.clone();
        last = Some(solution);
    }
    last.ok_or_else(|| stuck("no knots"))
}

/// Moves world and clock to the reference camera's and the scale to the distances'; returns the factor.
fn regauge(
    session: &Session,
    state: &mut State,
    (reference, distances): (usize, &[Distance]),
) -> Option<f64> {
    let home = state.cameras[reference].clone()?;
    let back = home.pose.inverse();
    let home_epoch_s = session.views[reference].epoch_s;
    for (index, camera) in state.cameras.iter_mut().enumerate() {
        let Some(camera) = camera else { continue };
        camera.pose = camera.pose.compose(&back);
        // t = s − τ − k·(s − e); the new time scale is t' = t + τ_r + k_r·(t + τ_r − e_r) to first order.
        let rate = 1e-6 * home.skew_ppm;
        let at_epoch = session.views[index].epoch_s - camera.delay_s;
        camera.delay_s -= home.delay_s + rate * (at_epoch + home.delay_s - home_epoch_s);
        camera.skew_ppm -= home.skew_ppm;
    }
    let scale = scale_of(state, (reference, distances))?;
    for camera in state.cameras.iter_mut().flatten() {
        camera.pose.translation_m *= scale;
    }
    if let Some(camera) = &mut state.cameras[reference] {
        // What the subtraction leaves is rounding (or −0).
        camera.pose = Pose::identity();
        camera.delay_s = 0.0;
        camera.skew_ppm = 0.0;
    }
    Some(scale)
}

/// Factor from the state's units to the distances', or to a first baseline of 1.
fn scale_of(state: &State, (reference, distances): (usize, &[Distance])) -> Option<f64> {
    let between = |a: usize, b: usize| {
        let centre = |c: usize| state.cameras.get(c)?.as_ref().map(|c| c.pose.centre_m());
        Some((centre(a)? - centre(b)?).norm())
    };
    let ratios: Vec<f64> = distances
        .iter()
        .filter_map(|d| between(d.cameras.0, d.cameras.1).map(|length| d.distance / length))
        .collect();
    if ratios.is_empty() {
        let other = (0..state.cameras.len()).find(|&c| c != reference && state.cameras[c].is_some())?;
        return between(reference, other).map(|length| 1.0 / length);
    }
    Some(ratios.iter().sum::<f64>() / ratios.len() as f64)
}

fn refined(
    session: &Session,
    mut state: State,
    (reference, distances): (usize, &[Distance]),
    (knot_s, jerk_precision): (f64, f64),
) -> Result<(Solution, f64), CalibrationError> {
    let agreeing = session.agreeing(&state, AGREES_PX);
    let support = Support::new(&agreeing, &state);
    let spans = support.spans();
    if spans.is_empty() {
        return Err(stuck("no stretch of time is seen by two cameras"));
    }
    let views = support.restricted(&agreeing, &state, 0.0);
    state.spline = Spline::covering(&spans, knot_s);
    let mut problem = session.problem(&views, &state, (reference, Phase::Full));
    problem.distances = distances
        .iter()
        .filter(|d| state.cameras[d.cameras.0].is_some() && state.cameras[d.cameras.1].is_some())
        .copied()
        .collect();
    if problem.distances.is_empty() {
        problem.distances.extend(session.gauge(&state, reference));
    }
    problem.jerk_precision = jerk_precision;
    let depth = session.depth(&views, &state, reference);
    fit_spline(&problem, &mut state, depth, 6).ok_or_else(|| stuck("the curve's equations are singular"))?;
    for _ in 0..ROUNDS {
        let before = problem.jerk_precision;
        let cost = minimise(&problem, &mut state, 4, 1e-5);
        update_scales(&mut problem, &mut state).ok_or_else(|| stuck("the normal matrix is singular"))?;
        problem.redundancy = redundancy(&problem, &state);
        let settled = (problem.cost(&state) - cost).abs() < 1e-3 * cost.abs();
        if settled && (problem.jerk_precision / before).ln().abs() < 0.02 {
            break;
        }
    }
    minimise(&problem, &mut state, 20, 1e-9);
    let (normal, _) = problem.linearise(&state);
    let factor = normal
        .factor(0.0)
        .ok_or_else(|| stuck("the normal matrix is singular"))?;
    let Problem {
        columns,
        redundancy,
        jerk_precision,
        ..
    } = problem;
    let support = Support::new(&session.agreeing(&state, AGREES_PX), &state);
    Ok((
        Solution {
            covariance: factor.border_covariance() * redundancy,
            redundancy,
            condition: factor.border_condition(),
            held: Held::new(&factor),
            response: factor.response(),
            state,
            views,
            support,
            columns,
        },
        jerk_precision,
    ))
}

impl Solution {
    /// Covariance of the position at an instant, cameras' uncertainty included, units².
    pub fn position_covariance(&self, t_s: f64) -> Matrix3<f64> {
        let basis = self.state.spline.basis(t_s);
        let columns = self.columns.len();
        let follow: [DVector<f64>; 3] = std::array::from_fn(|axis| {
            let mut row = DVector::zeros(columns);
            for m in 0..ORDER {
                let start = (3 * (basis.first + m) + axis) * columns;
                for (r, v) in row.iter_mut().zip(&self.response[start..start + columns]) {
                    *r += basis.value[m] * v;
                }
            }
            row
        });
        let spread = follow.each_ref().map(|row| &self.covariance * row);
        self.held.covariance(basis.first, &basis.value) + Matrix3::from_fn(|a, b| follow[a].dot(&spread[b]))
    }

    /// Kept sightings and outliers of a camera, and the root mean square reprojection error of those kept.
    pub fn residuals(&self, index: usize, camera: &CameraState) -> (usize, usize, f64) {
        let (mut kept, mut outliers, mut squares) = (0, 0, 0.0);
        for s in &self.views[index].sightings {
            let view = &self.views[index];
            let squared = view
                .predict(camera, &self.state.spline, s)
                .map_or(f64::INFINITY, |p| p.residual_px.norm_squared());
            // Five sigma: what Student's t already gives a weight below a quarter.
            if squared < 25.0 * (camera.noise * s.sigma_px).powi(2) {
                kept += 1;
                squares += squared;
            } else {
                outliers += 1;
            }
        }
        (kept, outliers, (squares / f64::from(kept.max(1) as u32)).sqrt())
    }
}
