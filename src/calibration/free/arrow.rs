//! Normal equations of arrow shape: a banded block (the spline) and a small dense border (the cameras).
//!
//! ```text
//! [ A  B ] [x]   [f]      A = L·Lᵀ banded,  W = L⁻¹B,
//! [ Bᵀ C ] [y] = [g]      S = C − WᵀW dense: growth is linear in the length of the spline.
//! ```

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// Scalar half-bandwidth with the diagonal: four coefficients of three coordinates.
pub(super) const BAND: usize = 12;

/// A symmetric banded matrix; `rows[i][BAND − 1 − (i − j)]` is element (i, j), j ≤ i.
#[derive(Debug, Clone)]
pub(super) struct Banded {
    pub rows: Vec<[f64; BAND]>,
}

impl Banded {
    pub fn zeros(n: usize) -> Self {
        Self {
            rows: vec![[0.0; BAND]; n],
        }
    }

    /// Element (i, j) with j ≤ i < j + BAND.
    pub fn at(&mut self, i: usize, j: usize) -> &mut f64 {
        &mut self.rows[i][BAND - 1 + j - i]
    }

    /// Element (i, j), either order, inside the band.
    pub fn get(&self, i: usize, j: usize) -> f64 {
        let (i, j) = if i >= j { (i, j) } else { (j, i) };
        self.rows[i][BAND - 1 + j - i]
    }

    /// Cholesky factor L in the same storage; `None` when not positive definite.
    fn cholesky(mut self) -> Option<Self> {
        for i in 0..self.rows.len() {
            let first = (i + 1).saturating_sub(BAND);
            let (above, rest) = self.rows.split_at_mut(i);
            let row = &mut rest[0];
            for j in first..i {
                let other = &above[j];
                let start = first.max((j + 1).saturating_sub(BAND));
                let mut sum = row[BAND - 1 + j - i];
                for k in start..j {
                    sum -= row[BAND - 1 + k - i] * other[BAND - 1 + k - j];
                }
                row[BAND - 1 + j - i] = sum / other[BAND - 1];
            }
            let mut diagonal = row[BAND - 1];
            for k in first..i {
                diagonal -= row[BAND - 1 + k - i].powi(2);
            }
            if !(diagonal > 0.0) {
                return None;
            }
            row[BAND - 1] = diagonal.sqrt();
        }
        Some(self)
    }

    /// L⁻¹x in place, for `columns` right-hand sides stored row by row.
    fn forward(&self, x: &mut [f64], columns: usize) {
        if columns == 0 {
            return;
        }
        for i in 0..self.rows.len() {
            let first = (i + 1).saturating_sub(BAND);
            let (done, rest) = x.split_at_mut(i * columns);
            let target = &mut rest[..columns];
            for j in first..i {
                let l = self.rows[i][BAND - 1 + j - i];
                let source = &done[j * columns..(j + 1) * columns];
                for (t, s) in target.iter_mut().zip(source) {
                    *t -= l * s;
                }
            }
            let inverse = 1.0 / self.rows[i][BAND - 1];
            target.iter_mut().for_each(|t| *t *= inverse);
        }
    }

    /// L⁻ᵀx in place, for `columns` right-hand sides stored row by row.
    fn backward(&self, x: &mut [f64], columns: usize) {
        if columns == 0 {
            return;
        }
        for i in (0..self.rows.len()).rev() {
            let first = (i + 1).saturating_sub(BAND);
            let (before, rest) = x.split_at_mut(i * columns);
            let source = &mut rest[..columns];
            let inverse = 1.0 / self.rows[i][BAND - 1];
            source.iter_mut().for_each(|t| *t *= inverse);
            for j in first..i {
                let l = self.rows[i][BAND - 1 + j - i];
                let target = &mut before[j * columns..(j + 1) * columns];
                for (t, s) in target.iter_mut().zip(source.iter()) {
                    *t -= l * s;
                }
            }
        }
    }

    /// The elements of A⁻¹ inside the band, from the factor (Takahashi, Fagan and Chin 1973).
    fn selected_inverse(&self) -> Banded {
        let n = self.rows.len();
        let mut inverse = Banded::zeros(n);
        for i in (0..n).rev() {
            let diagonal = self.rows[i][BAND - 1];
            let last = (i + BAND - 1).min(n - 1);
            // Column i of L below the diagonal, over its diagonal.
            let mut scaled = [0.0; BAND];
            for k in i + 1..=last {
                scaled[k - i] = self.rows[k][BAND - 1 + i - k] / diagonal;
            }
            for j in (i + 1..=last).rev() {
                let mut sum = 0.0;
                for k in i + 1..=last {
                    sum -= scaled[k - i] * inverse.get(k, j);
                }
                *inverse.at(j, i) = sum;
            }
            let mut own = 1.0 / (diagonal * diagonal);
            for k in i + 1..=last {
                own -= scaled[k - i] * inverse.get(k, i);
            }
            *inverse.at(i, i) = own;
        }
        inverse
    }
}

/// Normal matrix and gradient of one linearisation.
#[derive(Debug, Clone)]
pub(super) struct Normal {
    /// A, over the spline's scalars.
    pub band: Banded,
    /// B row by row: `band.rows.len()` × `border`.
    pub coupling: Vec<f64>,
    /// C, border × border.
    pub border: DMatrix<f64>,
    /// Gradient over the spline's scalars.
    pub band_gradient: Vec<f64>,
    /// Gradient over the border.
    pub border_gradient: DVector<f64>,
}

/// A factored normal matrix.
pub(super) struct Factor {
    band: Banded,
    /// W = L⁻¹B, row by row.
    coupling: Vec<f64>,
    schur: Cholesky<f64, Dyn>,
}

/// A step: spline scalars and border.
pub(super) struct Step {
    pub band: Vec<f64>,
    pub border: DVector<f64>,
}

impl Normal {
    pub fn zeros(band: usize, border: usize) -> Self {
        Self {
            band: Banded::zeros(band),
            coupling: vec![0.0; band * border],
            border: DMatrix::zeros(border, border),
            band_gradient: vec![0.0; band],
            border_gradient: DVector::zeros(border),
        }
    }

    /// Factors with Marquardt's damping: every diagonal element times (1 + λ).
    pub fn factor(&self, damping: f64) -> Option<Factor> {
        let mut band = self.band.clone();
        for row in &mut band.rows {
            row[BAND - 1] *= 1.0 + damping;
        }
        let band = band.cholesky()?;
        let columns = self.border.nrows();
        let mut coupling = self.coupling.clone();
        band.forward(&mut coupling, columns);
        let mut schur = self.border.clone();
        for k in 0..columns {
            schur[(k, k)] *= 1.0 + damping;
        }
        subtract_gram(&mut schur, &coupling);
        Some(Factor {
            band,
            coupling,
            schur: Cholesky::new(schur)?,
        })
    }
}

/// S ← S − WᵀW, W row by row; rows are taken four at a time to keep S in cache and the adders busy.
fn subtract_gram(schur: &mut DMatrix<f64>, coupling: &[f64]) {
    let n = schur.nrows();
    if n == 0 {
        return;
    }
    for rows in coupling.chunks(8 * n) {
        for c in 0..n {
            let mut column = schur.column_mut(c);
            let target = &mut column.as_mut_slice()[c..];
            for row in rows.chunks_exact(n) {
                let scale = row[c];
                if scale != 0.0 {
                    for (t, s) in target.iter_mut().zip(&row[c..]) {
                        *t -= scale * s;
                    }
                }
            }
        }
    }
    for c in 0..n {
        for r in c + 1..n {
            schur[(c, r)] = schur[(r, c)];
        }
    }
}

impl Factor {
    /// −H⁻¹·gradient.
    pub fn descend(&self, normal: &Normal) -> Step {
        let columns = normal.border.nrows();
        let mut band = normal.band_gradient.clone();
        self.band.forward(&mut band, 1);
        let mut right = normal.border_gradient.clone();
        for (i, value) in band.iter().enumerate() {
            for (k, r) in right.iter_mut().enumerate() {
                *r -= self.coupling[i * columns + k] * value;
            }
        }
        let border = -self.schur.solve(&right);
        for (i, value) in band.iter_mut().enumerate() {
            let mut sum = -*value;
            for (k, y) in border.iter().enumerate() {
                sum -= self.coupling[i * columns + k] * y;
            }
            *value = sum;
        }
        self.band.backward(&mut band, 1);
        Step { band, border }
    }

    /// A⁻¹ inside the band: the covariance of the spline with the border held.
    pub fn band_inverse(&self) -> Banded {
        self.band.selected_inverse()
    }

    /// Covariance of the border.
    pub fn border_covariance(&self) -> DMatrix<f64> {
        self.schur.inverse()
    }

    /// A⁻¹B row by row: how the spline follows the border (x = −A⁻¹B·y).
    pub fn response(&self) -> Vec<f64> {
        let mut response = self.coupling.clone();
        self.band.backward(&mut response, self.schur.l_dirty().nrows());
        response
    }

    /// Condition number of the diagonally scaled Schur complement.
    pub fn border_condition(&self) -> f64 {
        let l = self.schur.l();
        let mut s = &l * l.transpose();
        let d: Vec<f64> = (0..s.nrows()).map(|k| s[(k, k)].sqrt()).collect();
        for r in 0..s.nrows() {
            for c in 0..s.ncols() {
                s[(r, c)] /= d[r] * d[c];
            }
        }
        if s.is_empty() {
            return 1.0;
        }
        let values = s.symmetric_eigenvalues();
        values.max() / values.min().max(f64::MIN_POSITIVE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};

    /// A random arrow system of 30 band and 5 border unknowns, and the same as one dense matrix.
    fn sample(seed: u64) -> (Normal, DMatrix<f64>, DVector<f64>) {
        let (n, m) = (30, 5);
        let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
        let mut normal = Normal::zeros(n, m);
        let mut dense = DMatrix::zeros(n + m, n + m);
        let mut gradient = DVector::zeros(n + m);
        for _ in 0..200 {
            let first = rng.random_range(0..=n - BAND);
            let mut row = DVector::zeros(n + m);
            for k in 0..BAND {
                row[first + k] = rng.random_range(-1.0..1.0);
            }
            for k in 0..m {
                row[n + k] = rng.random_range(-1.0..1.0);
            }
            let r: f64 = rng.random_range(-1.0..1.0);
            dense += &row * row.transpose();
            gradient += r * &row;
        }
        for i in 0..n {
            for j in (i + 1).saturating_sub(BAND)..=i {
                *normal.band.at(i, j) = dense[(i, j)];
            }
            for k in 0..m {
                normal.coupling[i * m + k] = dense[(i, n + k)];
            }
            normal.band_gradient[i] = gradient[i];
        }
        normal.border.copy_from(&dense.view((n, n), (m, m)));
        normal.border_gradient.copy_from(&gradient.rows(n, m));
        (normal, dense, gradient)
    }

    #[test]
    fn step_and_covariances_equal_the_dense_solution() {
        for seed in 0..10 {
            let (normal, dense, gradient) = sample(seed);
            let factor = normal.factor(0.0).unwrap();
            let step = factor.descend(&normal);
            let inverse = dense.clone().try_inverse().unwrap();
            let expected = -&inverse * gradient;
            for i in 0..30usize {
                assert!((step.band[i] - expected[i]).abs() < 1e-9, "seed {seed} row {i}");
            }
            for k in 0..5 {
                assert!((step.border[k] - expected[30 + k]).abs() < 1e-9);
            }
            let border = factor.border_covariance();
            assert!((&border - inverse.view((30, 30), (5, 5))).norm() < 1e-9);
            // Full covariance of the band: A⁻¹ + V·S⁻¹·Vᵀ.
            let held = factor.band_inverse();
            let response = factor.response();
            for i in 0..30usize {
                for j in (i + 1).saturating_sub(BAND)..=i {
                    let v = |r: usize| DVector::from_row_slice(&response[r * 5..(r + 1) * 5]);
                    let full = held.get(i, j) + (v(i).transpose() * &border * v(j))[0];
                    assert!((full - inverse[(i, j)]).abs() < 1e-9, "seed {seed} ({i}, {j})");
                }
            }
        }
    }

    #[test]
    fn an_indefinite_band_is_refused() {
        let mut normal = Normal::zeros(12, 0);
        for i in 0..12 {
            *normal.band.at(i, i) = 1.0;
        }
        *normal.band.at(5, 4) = 2.0;
        assert!(normal.factor(0.0).is_none());
    }
}
