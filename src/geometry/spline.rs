//! Least-squares spline through noisy points of a plane (de Boor 1978; the semantics of SPLINEFIT).

use nalgebra::{DMatrix, Vector2};

/// A spline of given degree on given breaks, C^(degree−1) at every inner break, plane-valued.
#[derive(Debug, Clone, PartialEq)]
pub struct PlaneSpline {
    degree: usize,
    /// Breaks with the ends repeated `degree` times more.
    knots: Vec<f64>,
    coefficients: Vec<Vector2<f64>>,
}

/// What to fit.
#[derive(Debug, Clone, Copy)]
pub struct SplineShape {
    /// Polynomial degree of a piece: 3 is cubic.
    pub degree: usize,
    /// Number of pieces; breaks are spread evenly over the points (not over the time), as SPLINEFIT does.
    pub pieces: usize,
    /// Weight of a roughness penalty on differences of order degree+1 of the coefficients, relative to one point;
    /// 0: plain least squares.
    pub roughness: f64,
}

impl PlaneSpline {
    /// Weighted least squares. `times` rising (equal ones are welcome), one weight ≥ 0 per point.
    /// `None` where the points do not determine the spline.
    pub fn fit(times: &[f64], points: &[Vector2<f64>], weights: &[f64], shape: SplineShape) -> Option<Self> {
        let n = times.len();
        if n == 0 || points.len() != n || weights.len() != n || shape.pieces == 0 {
            return None;
        }
        let (first, last) = (times[0], times[n - 1]);
        if !(last > first) {
            return None;
        }
        let mut knots = vec![first; shape.degree + 1];
        for piece in 1..shape.pieces {
            let place = piece as f64 / shape.pieces as f64 * (n - 1) as f64;
            let below = place.floor() as usize;
            let share = place - below as f64;
            knots.push(times[below] * (1.0 - share) + times[(below + 1).min(n - 1)] * share);
        }
        knots.extend(std::iter::repeat_n(last, shape.degree + 1));
        let size = shape.pieces + shape.degree;
        let mut spline = Self {
            degree: shape.degree,
            knots,
            coefficients: vec![Vector2::zeros(); size],
        };
        let mut normal = DMatrix::<f64>::zeros(size, size);
        let mut right = DMatrix::<f64>::zeros(size, 2);
        for ((&t, p), &w) in times.iter().zip(points).zip(weights) {
            let (span, basis) = spline.basis(t);
            for (i, bi) in basis.iter().enumerate() {
                for (j, bj) in basis.iter().enumerate() {
                    normal[(span + i, span + j)] += w * bi * bj;
                }
                right[(span + i, 0)] += w * bi * p.x;
                right[(span + i, 1)] += w * bi * p.y;
            }
        }
        add_roughness(&mut normal, shape);
        let solution = normal.cholesky()?.solve(&right);
        for (i, c) in spline.coefficients.iter_mut().enumerate() {
            *c = Vector2::new(solution[(i, 0)], solution[(i, 1)]);
        }
        spline
            .coefficients
            .iter()
            .all(|c| c.x.is_finite() && c.y.is_finite())
            .then_some(spline)
    }

    /// First and last time of the points.
    pub fn span(&self) -> (f64, f64) {
        (self.knots[0], self.knots[self.knots.len() - 1])
    }

    /// Value; beyond the ends the end pieces' polynomials go on.
    pub fn at(&self, t: f64) -> Vector2<f64> {
        let (span, basis) = self.basis(t);
        basis
            .iter()
            .zip(&self.coefficients[span..])
            .fold(Vector2::zeros(), |sum, (b, c)| sum + c * *b)
    }

    /// Index of the first coefficient that matters at `t`, and the `degree + 1` basis values (Cox–de Boor).
    fn basis(&self, t: f64) -> (usize, Vec<f64>) {
        let (k, p) = (&self.knots, self.degree);
        let pieces = k.len() - 2 * p - 1;
        let inner = &k[p + 1..p + pieces];
        let span = inner.iter().take_while(|break_s| **break_s <= t).count();
        let mut basis = vec![0.0; p + 1];
        basis[0] = 1.0;
        for level in 1..=p {
            let mut carried = 0.0;
            for r in 0..level {
                let right = k[span + p + r + 1];
                let left = k[span + p + 1 + r - level];
                let share = if right > left {
                    basis[r] / (right - left)
                } else {
                    0.0
                };
                basis[r] = carried + (right - t) * share;
                carried = (t - left) * share;
            }
            basis[level] = carried;
        }
        (span, basis)
    }
}

fn add_roughness(normal: &mut DMatrix<f64>, shape: SplineShape) {
    let size = normal.nrows();
    let order = shape.degree + 1;
    if shape.roughness <= 0.0 || size <= order {
        return;
    }
    let mut stencil = vec![1.0];
    for _ in 0..order {
        let mut next = vec![0.0; stencil.len() + 1];
        for (i, s) in stencil.iter().enumerate() {
            next[i] -= s;
            next[i + 1] += s;
        }
        stencil = next;
    }
    for at in 0..size - order {
        for (i, a) in stencil.iter().enumerate() {
            for (j, b) in stencil.iter().enumerate() {
                normal[(at + i, at + j)] += shape.roughness * a * b;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cubic(t: f64) -> Vector2<f64> {
        Vector2::new(1.0 - 2.0 * t + 3.0 * t * t - 4.0 * t * t * t, t * t * t)
    }

    #[test]
    fn a_cubic_is_reproduced_inside_and_beyond() {
        let times: Vec<f64> = (0..60).map(|i| f64::from(i * i) / 3600.0).collect();
        let points: Vec<_> = times.iter().map(|t| cubic(*t)).collect();
        let ones = vec![1.0; 60];
        for roughness in [0.0, 1.0] {
            // Uneven breaks make "equal differences" another thing than a cubic; even ones are tested penalised.
            let pieces = if roughness > 0.0 { 1 } else { 8 };
            let s = PlaneSpline::fit(
                &times,
                &points,
                &ones,
                SplineShape {
                    degree: 3,
                    pieces,
                    roughness,
                },
            )
            .unwrap();
            for i in -5..70 {
                let t = f64::from(i) / 60.0;
                assert!(
                    (s.at(t) - cubic(t)).norm() < 1e-8,
                    "{t}: {}",
                    (s.at(t) - cubic(t)).norm()
                );
            }
        }
    }

    #[test]
    fn pieces_join_smoothly() {
        let times: Vec<f64> = (0..100).map(|i| f64::from(i) / 99.0).collect();
        let points: Vec<_> = times
            .iter()
            .map(|t| Vector2::new((9.0 * t).sin(), (7.0 * t).cos()))
            .collect();
        let shape = SplineShape {
            degree: 3,
            pieces: 8,
            roughness: 0.0,
        };
        let s = PlaneSpline::fit(&times, &points, &[1.0; 100], shape).unwrap();
        let h = 1e-3;
        let second = |t: f64| (s.at(t - h) - 2.0 * s.at(t) + s.at(t + h)) / (h * h);
        for piece in 1..8 {
            let at = f64::from(piece) / 8.0;
            let jump = (second(at - 1.1 * h) - second(at + 1.1 * h)).norm();
            assert!(jump < 2.0, "break {piece}: second derivative jumps by {jump}");
            assert!((s.at(at) - Vector2::new((9.0 * at).sin(), (7.0 * at).cos())).norm() < 6e-3);
        }
    }

    #[test]
    fn too_few_points_are_refused() {
        let times = [0.0, 0.1, 0.2];
        let points = [Vector2::zeros(); 3];
        let shape = SplineShape {
            degree: 3,
            pieces: 8,
            roughness: 0.0,
        };
        assert!(PlaneSpline::fit(&times, &points, &[1.0; 3], shape).is_none());
        assert!(PlaneSpline::fit(&[], &[], &[], shape).is_none());
        assert!(PlaneSpline::fit(&[1.0, 1.0], &points[..2], &[1.0; 2], shape).is_none());
    }
}
