//! Polynomials of time fitted to image points, with the uncertainty of what they predict.

use nalgebra::{DMatrix, DVector, Vector2};

/// One point to fit: time, position, variance per axis.
#[derive(Debug, Clone, Copy)]
pub struct Sample {
    /// Time in units of the caller (frames or seconds).
    pub t: f64,
    /// Position, pixels.
    pub position_px: Vector2<f64>,
    /// Variance per axis, px².
    pub variance_px2: f64,
}

/// A polynomial per axis around `t0`, time scaled by `scale`.
#[derive(Debug, Clone)]
pub struct Curve {
    t0: f64,
    scale: f64,
    coefficients: DMatrix<f64>,
    covariance: DMatrix<f64>,
}

/// How stiff the curve is beyond what its samples say: prior standard deviations of the second derivative
/// (px per unit time²) and the degree.
#[derive(Debug, Clone, Copy)]
pub struct Stiffness {
    /// Polynomial degree.
    pub degree: usize,
    /// Prior σ of the acceleration; infinite for none.
    pub acceleration_sigma: f64,
}

impl Curve {
    /// Weighted least squares; `None` for too few samples.
    pub fn fit(samples: &[Sample], stiffness: Stiffness) -> Option<Self> {
        let (first, last) = (samples.first()?, samples.last()?);
        let t0 = 0.5 * (first.t + last.t);
        let scale = (0.5 * (last.t - first.t)).abs();
        let size = stiffness.degree + 1;
        if scale <= 0.0 || !scale.is_finite() {
            return None;
        }
        let mut normal = DMatrix::<f64>::zeros(size, size);
        let mut right = DMatrix::<f64>::zeros(size, 2);
        for sample in samples {
            let row = powers((sample.t - t0) / scale, size);
            let weight = 1.0 / sample.variance_px2;
            normal.ger(weight, &row, &row, 1.0);
            right.column_mut(0).axpy(weight * sample.position_px.x, &row, 1.0);
            right.column_mut(1).axpy(weight * sample.position_px.y, &row, 1.0);
        }
        if stiffness.acceleration_sigma.is_finite() && size > 2 {
            // Second derivative of the quadratic term in scaled time is 2·c2/scale².
            let per_coefficient = 2.0 / (scale * scale) / stiffness.acceleration_sigma;
            normal[(2, 2)] += per_coefficient * per_coefficient;
        }
        let covariance = normal.cholesky()?.inverse();
        let coefficients = &covariance * right;
        coefficients.iter().all(|c| c.is_finite()).then_some(Self {
            t0,
            scale,
            coefficients,
            covariance,
        })
    }

    /// Position at `t`, pixels.
    pub fn position(&self, t: f64) -> Vector2<f64> {
        let row = powers((t - self.t0) / self.scale, self.coefficients.nrows());
        Vector2::new(
            row.dot(&self.coefficients.column(0)),
            row.dot(&self.coefficients.column(1)),
        )
    }

    /// Variance per axis of the position at `t`, px².
    pub fn variance_px2(&self, t: f64) -> f64 {
        let row = powers((t - self.t0) / self.scale, self.coefficients.nrows());
        (&self.covariance * &row).dot(&row).max(0.0)
    }
}

fn powers(u: f64, size: usize) -> DVector<f64> {
    DVector::from_fn(size, |i, _| u.powi(i as i32))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cubic_is_reproduced() {
        let at = |t: f64| Vector2::new(3.0 + 2.0 * t - 0.1 * t.powi(3), 100.0 - 4.0 * t + 0.3 * t * t);
        let samples: Vec<Sample> = (0..12)
            .map(|i| Sample {
                t: f64::from(i),
                position_px: at(f64::from(i)),
                variance_px2: 0.04,
            })
            .collect();
        let free = Stiffness {
            degree: 3,
            acceleration_sigma: f64::INFINITY,
        };
        let curve = Curve::fit(&samples, free).unwrap();
        for t in [-2.0, 0.5, 11.0, 14.0] {
            assert!((curve.position(t) - at(t)).norm() < 1e-6, "position at {t}");
        }
        assert!(curve.variance_px2(5.0) < 0.04 && curve.variance_px2(20.0) > 0.04);
    }
}
