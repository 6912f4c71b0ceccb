//! What all pictures of a ball's track share: its size, how long its streak is, its light.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use super::super::disc::{LIGHT, OWN, PARAMETERS, Parameters, RADIUS, STREAK_SCALE, TERMS};

/// Terms of the light that drift along the track: the lit sphere's, in the camera's axes. The view turns by tens of degrees
/// while the ball passes, and the light with it ([`View::turn`]): held still it drew the centre by 0.3 px from end to end.
pub(super) const DRIFTS: usize = 3;
/// Shared parameters: radius in the middle of the track, its growth, streak scale, light, drift of the light.
pub const SHARED: usize = 3 + TERMS + DRIFTS;
/// Index of the first drift.
pub(super) const DRIFT: usize = 3 + TERMS;
/// First term of the light that drifts.
pub(super) const DRIFTING: usize = TERMS - DRIFTS;
/// Prior σ of the drift from begin to end, where no lens tells how the view turns and where one does.
const DRIFT_SIGMA: [f64; 2] = [0.7, 0.15];
/// Prior σ of the light's terms relative to the level: polynomial, then sphere.
const LIGHT_SIGMA: [f64; TERMS] = [0.06, 0.06, 0.03, 0.03, 0.03, 2.0, 2.0, 2.0];
/// Where the sphere's light is begun (right, down, towards the camera): by day and under lamps it comes from above; from one of
/// these alone a ball lit from another side may end with a polynomial for its light and a dark sphere.
pub(super) const LIGHT_STARTS: [[f64; DRIFTS]; 3] = [[0.0, -0.8, 0.3], [0.0, -0.6, 1.3], [0.0, -0.9, -0.4]];
/// The polynomial's prior σ is this many times smaller until the sphere has found its light: else the
/// polynomial takes the light and the sphere stays dark.
const POLYNOMIAL_HELD: f64 = 4.0;
/// Prior σ of the radius' growth over the track.
const GROWTH_SIGMA: f64 = 0.5;
/// Prior σ of ln(radius), and of it and the growth where the distance is known: balls differ by 1 %.
const RADIUS_SIGMA_SHARE: f64 = 0.7;
pub(super) const KNOWN_SIGMA_SHARE: f64 = 0.01;

/// Shared parameters as a vector.
pub type SharedVector = SVector<f64, SHARED>;
/// A matrix over the shared parameters.
pub type SharedMatrix = SMatrix<f64, SHARED, SHARED>;

/// What all frames of a track share.
#[derive(Debug, Clone, Copy)]
pub struct Shared {
    /// Radius mid-track (px), growth, streak scale, light.
    pub values: SharedVector,
    /// Mean of the prior.
    pub prior: SharedVector,
    /// Weights of the prior.
    pub weights: SharedVector,
}

impl Shared {
    /// Before anything was fitted: a radius, how well the streak's length is known, and whether the views are a known lens's.
    pub fn start(radius_px: f64, streak_scale_sigma: f64, lens_known: bool) -> Self {
        let mut values = SharedVector::zeros();
        let mut weights = SharedVector::zeros();
        values[0] = radius_px;
        values[2] = 1.0;
        weights[0] = (RADIUS_SIGMA_SHARE * radius_px).powi(-2);
        weights[1] = GROWTH_SIGMA.powi(-2);
        weights[2] = streak_scale_sigma.powi(-2);
        for (i, (weight, sigma)) in weights.iter_mut().skip(3).zip(LIGHT_SIGMA).enumerate() {
            let held = if i < TERMS - 3 { POLYNOMIAL_HELD } else { 1.0 };
            *weight = (held / sigma).powi(2);
        }
        for weight in weights.iter_mut().skip(DRIFT) {
            *weight = DRIFT_SIGMA[usize::from(lens_known)].powi(-2);
        }
        let prior = values;
        Self {
            values,
            prior,
            weights,
        }
        .lit_from(LIGHT_STARTS[0])
    }

    pub(super) fn lit_from(mut self, light: [f64; DRIFTS]) -> Self {
        let sphere = self.values.iter_mut().skip(3 + DRIFTING);
        sphere.zip(light).for_each(|(value, light)| *value = light);
        self
    }

    /// Takes a radius and its growth that follow from the ball's distance.
    pub fn know_size(&mut self, radius_px: f64, growth: f64) {
        (self.prior[0], self.prior[1]) = (radius_px, growth);
        self.weights[0] = (KNOWN_SIGMA_SHARE * radius_px).powi(-2);
        self.weights[1] = KNOWN_SIGMA_SHARE.powi(-2);
    }

    /// Lets the polynomial of the light go.
    pub fn release_light(&mut self) {
        for (weight, sigma) in self.weights.iter_mut().skip(3).take(TERMS).zip(LIGHT_SIGMA) {
            *weight = sigma.powi(-2);
        }
    }

    /// Radius on the lens's axis at place τ ∈ [−½, ½] of the track: 1/r is linear, as depth is.
    pub fn radius_px(&self, place: f64) -> f64 {
        self.values[0] / (1.0 + self.values[1] * place).max(0.2)
    }

    /// Length of the streak as a share of what the exposure says.
    pub fn streak_scale(&self) -> f64 {
        self.values[2]
    }

    /// The same ball over another stretch of its flight: the place `middle` becomes its middle (place 0), and it is
    /// `stretch` times as long. 1/r and the light are linear in place.
    pub fn over(&self, middle: f64, stretch: f64) -> Self {
        let mut over = *self;
        let by_middle = (1.0 + self.values[1] * middle).max(0.2);
        over.values[0] = self.values[0] / by_middle;
        over.values[1] = self.values[1] * stretch / by_middle;
        // What is known of its size is known of the other stretch; a growth of zero says nothing.
        let by_middle = (1.0 + self.prior[1] * middle).max(0.2);
        over.prior[0] = self.prior[0] / by_middle;
        over.prior[1] = self.prior[1] * stretch / by_middle;
        over.weights[0] = self.weights[0] * by_middle * by_middle;
        for i in 0..DRIFTS {
            over.values[3 + DRIFTING + i] += middle * self.values[DRIFT + i];
            over.values[DRIFT + i] *= stretch;
        }
        over.clamp();
        over
    }

    pub(super) fn fill(
        &self,
        (place, turn, share): (f64, &Matrix3<f64>, f64),
        own: &Vector3<f64>,
    ) -> Parameters {
        let mut parameters = Parameters::zeros();
        parameters.fixed_rows_mut::<OWN>(0).copy_from(own);
        parameters[RADIUS] = self.radius_px(place);
        parameters[STREAK_SCALE] = self.values[2];
        for i in 0..DRIFTING {
            parameters[LIGHT + i] = self.values[3 + i];
        }
        let light =
            self.values.fixed_rows::<DRIFTS>(3 + DRIFTING) + self.values.fixed_rows::<DRIFTS>(DRIFT) * place;
        parameters
            .fixed_rows_mut::<DRIFTS>(LIGHT + DRIFTING)
            .copy_from(&(turn * light * share));
        parameters
    }

    /// ∂(frame's shared parameters)/∂(track's shared parameters): radius by radius and growth.
    pub(super) fn chain(
        &self,
        (place, turn, share): (f64, &Matrix3<f64>, f64),
    ) -> SMatrix<f64, { PARAMETERS - OWN }, SHARED> {
        let mut chain: SMatrix<f64, { PARAMETERS - OWN }, SHARED> = SMatrix::zeros();
        let stretch = (1.0 + self.values[1] * place).max(0.2);
        chain[(0, 0)] = 1.0 / stretch;
        chain[(0, 1)] = -self.values[0] * place / (stretch * stretch);
        for i in 1..LIGHT - OWN + DRIFTING {
            chain[(i, i + 1)] = 1.0;
        }
        let mut sphere = chain.fixed_rows_mut::<DRIFTS>(LIGHT - OWN + DRIFTING);
        sphere
            .fixed_columns_mut::<DRIFTS>(3 + DRIFTING)
            .copy_from(&(turn * share));
        sphere
            .fixed_columns_mut::<DRIFTS>(DRIFT)
            .copy_from(&(turn * share * place));
        chain
    }

    pub(super) fn prior_cost(&self) -> f64 {
        let off = self.values - self.prior;
        0.5 * off.component_mul(&off).dot(&self.weights)
    }

    pub(super) fn clamp(&mut self) {
        self.values[0] = self.values[0].clamp(0.4 * self.prior[0], 3.0 * self.prior[0]);
        self.values[1] = self.values[1].clamp(-1.2, 1.2);
        self.values[2] = self.values[2].clamp(0.0, 6.0);
    }
}
