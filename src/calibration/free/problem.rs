//! The joint problem of a free motion: cameras, clocks and one spline, against every 2-D sighting at its own
//! true exposure midpoint. Cost and normal equations.

use nalgebra::{Vector2, Vector3};

use super::arrow::{Normal, Step};
use super::spline::{ORDER, Spline};
use super::view::{CameraState, Column, Prediction, Priors, Sighting, View};
use crate::scene::ParameterKind;

/// Cameras (those calibrated so far) and motion.
#[derive(Debug, Clone)]
pub(super) struct State {
    pub cameras: Vec<Option<CameraState>>,
    pub spline: Spline,
}

/// A known distance between two cameras' centres.
#[derive(Debug, Clone, Copy)]
pub(super) struct Distance {
    pub cameras: (usize, usize),
    pub distance: f64,
    pub sigma: f64,
}

/// Everything but the state.
pub(super) struct Problem<'a> {
    pub views: &'a [View],
    pub columns: Vec<Column>,
    pub distances: Vec<Distance>,
    pub priors: Priors,
    /// Precision of the jerk, 1/(unit²/s⁵).
    pub jerk_precision: f64,
    /// Precision of the acceleration, 1/(unit²/s³): only bridges gaps.
    pub acceleration_precision: f64,
    /// Degrees of freedom of Student's t of the residuals.
    pub tail: f64,
    /// Sightings per independent sighting: errors that last (a lens, a lamp seen from the side) do not average
    /// out. It weighs the cameras' priors, and widens the covariance.
    pub redundancy: f64,
}

/// Third difference of B-spline coefficients.
pub(super) const JERK: [f64; ORDER] = [-1.0, 3.0, -3.0, 1.0];

impl Problem<'_> {
    /// Student's t: half the negative log-likelihood (up to a constant) of a squared normalised residual,
    /// and the weight that makes it a least-squares problem.
    pub fn robust(&self, squared: f64) -> (f64, f64) {
        let nu = self.tail;
        let cost = 0.5 * (nu + 2.0) * (squared / nu).ln_1p();
        (cost, (nu + 2.0) / (nu + squared))
    }

    /// Cost of a point that the state puts behind its camera: a gross outlier's.
    const BEHIND: f64 = 1e6;

    /// Half the negative log posterior, up to a constant.
    pub fn cost(&self, state: &State) -> f64 {
        let mut cost = 0.0;
        for (view, camera) in self.views.iter().zip(&state.cameras) {
            let Some(camera) = camera else { continue };
            for s in &view.sightings {
                let sigma = s.sigma_px * camera.noise;
                let squared = self
                    .residual(view, camera, &state.spline, s)
                    .map_or(Self::BEHIND, |r| r.norm_squared() / (sigma * sigma));
                cost += self.robust(squared).0;
            }
        }
        for column in &self.columns {
            if let Some((offset, sigma)) = self.prior_of(state, *column) {
                cost += 0.5 * self.redundancy * (offset / sigma).powi(2);
            }
        }
        for d in &self.distances {
            if let Some((miss, _)) = distance_miss(state, d) {
                cost += 0.5 * self.redundancy * (miss / d.sigma).powi(2);
            }
        }
        cost + self.roughness_cost(&state.spline)
    }

    fn residual(
        &self,
        view: &View,
        camera: &CameraState,
        spline: &Spline,
        sighting: &Sighting,
    ) -> Option<Vector2<f64>> {
        let world = spline.position(view.true_s(camera, sighting));
        let pixel = camera.lens.project(&camera.pose.transform(&world)).ok()?;
        Some(pixel.vector() - sighting.pixel_px)
    }

    fn prior_of(&self, state: &State, column: Column) -> Option<(f64, f64)> {
        let camera = state.cameras[column.camera].as_ref()?;
        camera.prior(column, &self.views[column.camera].lens, &self.priors)
    }

    fn roughness_cost(&self, spline: &Spline) -> f64 {
        let (jerk, acceleration) = self.roughness_scales(spline.knot_s);
        let mut cost = 0.0;
        for k in spline.segments() {
            cost += 0.5 * self.jerk_precision * jerk * spline.combine(k, &JERK).norm_squared();
        }
        for k in spline.triples() {
            cost += 0.5 * acceleration * bend(spline, k).norm_squared();
        }
        cost
    }

    /// ∫|X‴|²dt = Σ|Δ³c|²/h⁵ exactly; ∫|X″|²dt ≈ Σ|Δ²c|²/h³.
    fn roughness_scales(&self, knot_s: f64) -> (f64, f64) {
        (knot_s.powi(-5), self.acceleration_precision * knot_s.powi(-3))
    }

    /// Normal equations of the reweighted problem, and the cost.
    pub fn linearise(&self, state: &State) -> (Normal, f64) {
        let border = self.columns.len();
        let mut normal = Normal::zeros(3 * state.spline.coefficients.len(), border);
        let mut cost = 0.0;
        for (index, view) in self.views.iter().enumerate() {
            let Some(camera) = &state.cameras[index] else {
                continue;
            };
            let columns: Vec<(usize, ParameterKind)> = self
                .columns
                .iter()
                .enumerate()
                .filter(|(_, c)| c.camera == index)
                .map(|(k, c)| (k, c.kind))
                .collect();
            let mut derivatives = vec![Vector2::zeros(); columns.len()];
            for s in &view.sightings {
                let Some(p) = view.predict(camera, &state.spline, s) else {
                    cost += self.robust(Self::BEHIND).0;
                    continue;
                };
                let precision = 1.0 / (s.sigma_px * camera.noise).powi(2);
                let (own, weight) = self.robust(p.residual_px.norm_squared() * precision);
                cost += own;
                for (d, (_, kind)) in derivatives.iter_mut().zip(&columns) {
                    *d = p.by(*kind, &camera.lens);
                }
                accumulate(&mut normal, &p, (&columns, &derivatives), weight * precision);
            }
        }
        self.add_priors(state, &mut normal, &mut cost);
        self.add_roughness(&state.spline, &mut normal);
        (normal, cost + self.roughness_cost(&state.spline))
    }

    fn add_priors(&self, state: &State, normal: &mut Normal, cost: &mut f64) {
        for (k, column) in self.columns.iter().enumerate() {
            if let Some((offset, sigma)) = self.prior_of(state, *column) {
                let precision = self.redundancy / (sigma * sigma);
                normal.border[(k, k)] += precision;
                normal.border_gradient[k] += precision * offset;
                *cost += 0.5 * precision * offset * offset;
            }
        }
        for d in &self.distances {
            let Some((miss, direction)) = distance_miss(state, d) else {
                continue;
            };
            let precision = self.redundancy / (d.sigma * d.sigma);
            *cost += 0.5 * precision * miss * miss;
            let mut row = vec![];
            for (k, column) in self.columns.iter().enumerate() {
                let sign = match column.camera {
                    c if c == d.cameras.0 => 1.0,
                    c if c == d.cameras.1 => -1.0,
                    _ => continue,
                };
                let axis = match column.kind {
                    ParameterKind::TranslationX => 0,
                    ParameterKind::TranslationY => 1,
                    ParameterKind::TranslationZ => 2,
                    _ => continue,
                };
                let Some(camera) = &state.cameras[column.camera] else {
                    continue;
                };
                // ∂centre/∂υ = −Rᵀ, ∂centre/∂ω = 0.
                let r = camera.pose.rotation.matrix();
                row.push((k, -sign * (r * direction)[axis]));
            }
            for &(a, da) in &row {
                normal.border_gradient[a] += precision * da * miss;
                for &(b, db) in &row {
                    normal.border[(a, b)] += precision * da * db;
                }
            }
        }
    }

    /// Adds the smoothness prior to A and its gradient.
    pub fn add_roughness(&self, spline: &Spline, normal: &mut Normal) {
        let (jerk, acceleration) = self.roughness_scales(spline.knot_s);
        for k in spline.segments() {
            let difference = spline.combine(k, &JERK);
            add_difference(normal, k, &JERK, self.jerk_precision * jerk, &difference);
        }
        for k in spline.triples() {
            add_difference(normal, k, &[1.0, -2.0, 1.0], acceleration, &bend(spline, k));
        }
    }

    /// The state after a step.
    pub fn moved(&self, state: &State, step: &Step) -> State {
        let mut next = state.clone();
        for (c, d) in next.spline.coefficients.iter_mut().zip(step.band.chunks_exact(3)) {
            *c += Vector3::new(d[0], d[1], d[2]);
        }
        for (index, camera) in next.cameras.iter_mut().enumerate() {
            let Some(camera) = camera else { continue };
            let mut twist = [0.0; 6];
            for (k, column) in self.columns.iter().enumerate() {
                if column.camera == index {
                    camera.moved(column.kind, step.border[k], &mut twist);
                }
            }
            camera.pose = camera.pose.perturbed(&twist);
        }
        next
    }
}

/// Second difference of three coefficients.
fn bend(spline: &Spline, first: usize) -> Vector3<f64> {
    let c = &spline.coefficients[first..first + 3];
    c[0] - 2.0 * c[1] + c[2]
}

/// |c_a − c_b| − distance, and the unit vector from b to a.
fn distance_miss(state: &State, d: &Distance) -> Option<(f64, Vector3<f64>)> {
    let a = state.cameras[d.cameras.0].as_ref()?.pose.centre_m();
    let b = state.cameras[d.cameras.1].as_ref()?.pose.centre_m();
    let between = a - b;
    let length = between.norm();
    (length > 0.0).then(|| (length - d.distance, between / length))
}

fn add_difference(normal: &mut Normal, first: usize, weights: &[f64], scale: f64, difference: &Vector3<f64>) {
    for (m, wm) in weights.iter().enumerate() {
        for axis in 0..3 {
            let i = 3 * (first + m) + axis;
            normal.band_gradient[i] += scale * wm * difference[axis];
            for (n, wn) in weights.iter().enumerate().take(m + 1) {
                *normal.band.at(i, 3 * (first + n) + axis) += scale * wm * wn;
            }
        }
    }
}

/// Adds one weighted sighting to the normal equations.
fn accumulate(
    normal: &mut Normal,
    p: &Prediction,
    (columns, derivatives): (&[(usize, ParameterKind)], &[Vector2<f64>]),
    weight: f64,
) {
    let border = normal.border.nrows();
    let j = &p.by_world_point;
    let square = weight * j.transpose() * j;
    let pull = weight * j.transpose() * p.residual_px;
    for m in 0..ORDER {
        let base = 3 * (p.basis.first + m);
        let bm = p.basis.value[m];
        for axis in 0..3 {
            normal.band_gradient[base + axis] += bm * pull[axis];
        }
        for n in 0..=m {
            let other = 3 * (p.basis.first + n);
            let b = bm * p.basis.value[n];
            for a in 0..3 {
                for c in 0..if n == m { a + 1 } else { 3 } {
                    *normal.band.at(base + a, other + c) += b * square[(a, c)];
                }
            }
        }
    }
    for ((k, _), d) in columns.iter().zip(derivatives) {
        let cross = weight * j.transpose() * d;
        for m in 0..ORDER {
            let bm = p.basis.value[m];
            let base = 3 * (p.basis.first + m);
            for axis in 0..3 {
                normal.coupling[(base + axis) * border + k] += bm * cross[axis];
            }
        }
        normal.border_gradient[*k] += weight * d.dot(&p.residual_px);
        for ((l, _), e) in columns.iter().zip(derivatives) {
            normal.border[(*k, *l)] += weight * d.dot(e);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::arrow::Step;
    use super::super::synthetic::{Scene, at_truth, problem};
    use super::*;
    use nalgebra::DVector;
    use rand::{Rng, SeedableRng};

    const KINDS: [ParameterKind; 14] = {
        use ParameterKind::*;
        [
            RotationX,
            RotationY,
            RotationZ,
            TranslationX,
            TranslationY,
            TranslationZ,
            CaptureDelay,
            ClockSkew,
            Readout,
            FocalScale,
            PrincipalX,
            PrincipalY,
            RadialK1,
            RadialK2,
        ]
    };

    #[test]
    fn derivatives_of_a_sighting_equal_central_differences() {
        let scene = Scene {
            duration_s: 6.0,
            ..Scene::drone(3)
        };
        let (views, state, _) = at_truth(&scene, 0.1);
        let mut checked = 0;
        for (index, view) in views.iter().enumerate() {
            let columns: Vec<_> = KINDS.iter().map(|&kind| Column { camera: index, kind }).collect();
            let problem = Problem {
                columns: columns.clone(),
                ..problem(&views)
            };
            for s in view.sightings.iter().step_by(7) {
                let camera = state.cameras[index].as_ref().unwrap();
                let p = view.predict(camera, &state.spline, s).unwrap();
                for (k, column) in columns.iter().enumerate() {
                    let h = match column.kind {
                        ParameterKind::ClockSkew => 1e-1,
                        _ => 1e-6,
                    };
                    let at = |delta: f64| {
                        let mut step = Step {
                            band: vec![0.0; 3 * state.spline.coefficients.len()],
                            border: DVector::zeros(columns.len()),
                        };
                        step.border[k] = delta;
                        let moved = problem.moved(&state, &step);
                        let camera = moved.cameras[index].as_ref().unwrap();
                        view.predict(camera, &moved.spline, s).unwrap().residual_px
                    };
                    let numeric = (at(h) - at(-h)) / (2.0 * h);
                    let analytic = p.by(column.kind, &camera.lens);
                    assert!(
                        (numeric - analytic).norm() < 1e-5 * (1.0 + analytic.norm()),
                        "{:?}: {numeric} against {analytic}",
                        column.kind
                    );
                    checked += 1;
                }
            }
        }
        assert!(checked > 500, "{checked}");
    }

    #[test]
    fn the_gradient_is_the_derivative_of_the_cost() {
        let scene = Scene {
            duration_s: 4.0,
            ..Scene::drone(5)
        };
        let (views, state, truth) = at_truth(&scene, 0.2);
        let between = (truth.poses[1].centre_m() - truth.poses[2].centre_m()).norm();
        let problem = Problem {
            columns: [1, 2]
                .into_iter()
                .flat_map(|camera| KINDS.iter().map(move |&kind| Column { camera, kind }))
                .collect(),
            distances: vec![Distance {
                cameras: (1, 2),
                distance: between + 0.3,
                sigma: 0.1,
            }],
            ..problem(&views)
        };
        let (normal, cost) = problem.linearise(&state);
        assert!((cost - problem.cost(&state)).abs() < 1e-9 * cost);
        let mut rng = rand_pcg::Pcg64::seed_from_u64(1);
        for _ in 0..20 {
            let direction = Step {
                band: normal
                    .band_gradient
                    .iter()
                    .map(|_| rng.random_range(-1e-6..1e-6))
                    .collect(),
                border: DVector::from_fn(problem.columns.len(), |_, _| rng.random_range(-1e-7..1e-7)),
            };
            let slope = normal.border_gradient.dot(&direction.border)
                + normal
                    .band_gradient
                    .iter()
                    .zip(&direction.band)
                    .map(|(g, d)| g * d)
                    .sum::<f64>();
            let back = Step {
                band: direction.band.iter().map(|d| -d).collect(),
                border: -&direction.border,
            };
            let numeric = 0.5
                * (problem.cost(&problem.moved(&state, &direction))
                    - problem.cost(&problem.moved(&state, &back)));
            assert!(
                (numeric - slope).abs() < 1e-4 * slope.abs().max(1e-5),
                "{numeric} {slope}"
            );
        }
    }
}
