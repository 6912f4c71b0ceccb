//! Polynomials of time fitted to image points, with the uncertainty of what they predict.

use nalgebra::Vector2;

/// Most coefficients of a polynomial: degree 5.
const COEFFICIENTS_MAX: usize = 6;

/// A pivot that is smaller than this share of its entry is rounding.
const SINGULAR: f64 = 1e-12;

/// One number per power of time.
type Row = [f64; COEFFICIENTS_MAX];

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

/// A polynomial per axis around `t0`, time scaled by `scale`. It is fitted for every candidate of every frame, so nothing
/// in it is allocated.
#[derive(Debug, Clone, Copy)]
pub struct Curve {
    t0: f64,
    scale: f64,
    size: usize,
    coefficients: [Row; 2],
    covariance: [Row; COEFFICIENTS_MAX],
}

/// How stiff the curve is beyond what its samples say: prior standard deviations of the second derivative
/// (px per unit time²) and the degree.
#[derive(Debug, Clone, Copy)]
pub struct Stiffness {
    /// Polynomial degree, at most 5.
    pub degree: usize,
    /// Prior σ of the acceleration; infinite for none.
    pub acceleration_sigma: f64,
}

/// Where a curve is at some time.
#[derive(Debug, Clone, Copy)]
pub struct Prediction {
    /// Position, pixels.
    pub position_px: Vector2<f64>,
    /// Variance per axis, px².
    pub variance_px2: f64,
}

impl Curve {
    /// Weighted least squares; `None` for too few samples.
    pub fn fit(samples: &[Sample], stiffness: Stiffness) -> Option<Self> {
        let (first, last) = (samples.first()?, samples.last()?);
        let t0 = 0.5 * (first.t + last.t);
        let scale = (0.5 * (last.t - first.t)).abs();
        let size = (stiffness.degree + 1).min(COEFFICIENTS_MAX);
        if scale <= 0.0 || !scale.is_finite() {
            return None;
        }
        let mut normal = [[0.0; COEFFICIENTS_MAX]; COEFFICIENTS_MAX];
        let mut right = [[0.0; COEFFICIENTS_MAX]; 2];
        for sample in samples {
            let row = powers((sample.t - t0) / scale, size);
            let weight = 1.0 / sample.variance_px2;
            for i in 0..size {
                let weighted = weight * row[i];
                right[0][i] += weighted * sample.position_px.x;
                right[1][i] += weighted * sample.position_px.y;
                for j in 0..=i {
                    normal[i][j] += weighted * row[j];
                }
            }
        }
        if stiffness.acceleration_sigma.is_finite() && size > 2 {
            // Second derivative of the quadratic term in scaled time is 2·c2/scale².
            let per_coefficient = 2.0 / (scale * scale) / stiffness.acceleration_sigma;
            normal[2][2] += per_coefficient * per_coefficient;
        }
        let covariance = inverse(&normal, size)?;
        let mut coefficients = [[0.0; COEFFICIENTS_MAX]; 2];
        for (of_axis, right) in coefficients.iter_mut().zip(&right) {
            for (coefficient, row) in of_axis.iter_mut().zip(&covariance) {
                *coefficient = dot(row, right);
            }
        }
        let finite = coefficients.iter().flatten().all(|c| c.is_finite());
        finite.then_some(Self {
            t0,
            scale,
            size,
            coefficients,
            covariance,
        })
    }

    /// Position at `t`, pixels.
    pub fn position(&self, t: f64) -> Vector2<f64> {
        let row = powers((t - self.t0) / self.scale, self.size);
        let [x, y] = &self.coefficients;
        Vector2::new(dot(&row, x), dot(&row, y))
    }

    /// Variance per axis of the position at `t`, px².
    pub fn variance_px2(&self, t: f64) -> f64 {
        let row = powers((t - self.t0) / self.scale, self.size);
        let terms = self.covariance.iter().zip(&row);
        terms
            .map(|(of_row, power)| power * dot(of_row, &row))
            .sum::<f64>()
            .max(0.0)
    }

    /// Position and variance at `t`.
    pub fn predict(&self, t: f64) -> Prediction {
        Prediction {
            position_px: self.position(t),
            variance_px2: self.variance_px2(t),
        }
    }
}

/// Powers of `u` from the zeroth on; those beyond `size` are zero.
fn powers(u: f64, size: usize) -> Row {
    let mut row = [0.0; COEFFICIENTS_MAX];
    let mut power = 1.0;
    for value in row.iter_mut().take(size) {
        *value = power;
        power *= u;
    }
    row
}

fn dot(a: &Row, b: &Row) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Inverse of the positive definite matrix of which the lower triangle is given, by its Cholesky factor; zero beyond `size`.
fn inverse(normal: &[Row; COEFFICIENTS_MAX], size: usize) -> Option<[Row; COEFFICIENTS_MAX]> {
    let mut factor = [[0.0; COEFFICIENTS_MAX]; COEFFICIENTS_MAX];
    for i in 0..size {
        for j in 0..=i {
            let known: f64 = (0..j).map(|k| factor[i][k] * factor[j][k]).sum();
            let left = normal[i][j] - known;
            if i != j {
                factor[i][j] = left / factor[j][j];
            } else if left > SINGULAR * normal[i][i] {
                factor[i][i] = left.sqrt();
            } else {
                return None;
            }
        }
    }
    // The factor's inverse by columns, each as a row here; the matrix's inverse is its square.
    let mut columns = [[0.0; COEFFICIENTS_MAX]; COEFFICIENTS_MAX];
    for (j, column) in columns.iter_mut().enumerate().take(size) {
        for i in j..size {
            let known: f64 = (j..i).map(|k| factor[i][k] * column[k]).sum();
            let unit = if i == j { 1.0 } else { 0.0 };
            column[i] = (unit - known) / factor[i][i];
        }
    }
    let mut result = [[0.0; COEFFICIENTS_MAX]; COEFFICIENTS_MAX];
    for (row, a) in result.iter_mut().zip(&columns) {
        for (value, b) in row.iter_mut().zip(&columns) {
            *value = dot(a, b);
        }
    }
    Some(result)
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
        // A mean of twelve: the covariance is that of the samples.
        let level = Stiffness { degree: 0, ..free };
        let mean = Curve::fit(&samples, level).unwrap();
        assert!((mean.variance_px2(3.0) - 0.04 / 12.0).abs() < 1e-12);
        assert!(
            Curve::fit(&samples[..3], free).is_none(),
            "three samples hold no cubic"
        );
    }
}
