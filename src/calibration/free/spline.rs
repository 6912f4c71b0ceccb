//! A 3-D cubic B-spline over time with evenly spaced knots: the free motion.

use nalgebra::{Point3, Vector3};

/// Coefficients that one instant depends on.
pub(super) const ORDER: usize = 4;

/// One stretch of motion without a long gap.
#[derive(Debug, Clone, Copy)]
pub(super) struct Piece {
    /// Start of the first segment, seconds.
    pub begin_s: f64,
    /// Polynomial segments.
    pub segments: usize,
    /// Index of its first coefficient; it has `segments + 3`.
    pub first: usize,
}

/// Position over time: X(t) = Σ b_m(u)·c_{segment+m}, u = (t − t_segment)/h, in pieces that long gaps part.
#[derive(Debug, Clone)]
pub(super) struct Spline {
    /// Knot spacing h, seconds.
    pub knot_s: f64,
    /// At least one, by rising time.
    pub pieces: Vec<Piece>,
    /// Of all pieces in order, world units.
    pub coefficients: Vec<Vector3<f64>>,
}

/// Where an instant falls in a spline, with the basis there.
#[derive(Debug, Clone, Copy)]
pub(super) struct Basis {
    /// First of the four coefficients.
    pub first: usize,
    /// b_m(u).
    pub value: [f64; ORDER],
    /// ∂b_m/∂t, 1/s.
    pub rate: [f64; ORDER],
}

impl Spline {
    /// A spline at the origin that covers the spans (begin, end), seconds, rising and apart.
    pub fn covering(spans_s: &[(f64, f64)], knot_s: f64) -> Self {
        let mut pieces = vec![];
        let mut first = 0;
        for &(begin_s, end_s) in spans_s {
            let segments = ((end_s - begin_s) / knot_s).ceil().max(1.0) as usize;
            pieces.push(Piece {
                begin_s,
                segments,
                first,
            });
            first += segments + ORDER - 1;
        }
        Self {
            knot_s,
            pieces,
            coefficients: vec![Vector3::zeros(); first],
        }
    }

    /// The piece that an instant belongs to: the one it is inside or nearest to.
    fn piece_at(&self, t_s: f64) -> &Piece {
        let next = self.pieces.partition_point(|p| p.begin_s <= t_s);
        let Some(before) = next.checked_sub(1) else {
            return &self.pieces[0];
        };
        let before = &self.pieces[before];
        match self.pieces.get(next) {
            Some(after) if t_s - self.end_s(before) > after.begin_s - t_s => after,
            _ => before,
        }
    }

    /// End of a piece's last segment, seconds.
    pub fn end_s(&self, piece: &Piece) -> f64 {
        piece.begin_s + piece.segments as f64 * self.knot_s
    }

    /// First coefficient of every segment of every piece.
    pub fn segments(&self) -> impl Iterator<Item = usize> + '_ {
        self.pieces.iter().flat_map(|p| p.first..p.first + p.segments)
    }

    /// First of every three neighbouring coefficients within a piece.
    pub fn triples(&self) -> impl Iterator<Item = usize> + '_ {
        self.pieces.iter().flat_map(|p| p.first..p.first + p.segments + 1)
    }

    /// Basis at `t_s`; beyond the ends of a piece its outermost polynomial goes on.
    pub fn basis(&self, t_s: f64) -> Basis {
        let piece = self.piece_at(t_s);
        let position = (t_s - piece.begin_s) / self.knot_s;
        let segment = (position.floor().max(0.0) as usize).min(piece.segments - 1);
        let (position, first) = (position - segment as f64, piece.first + segment);
        let u = position;
        let (v, u2) = (1.0 - u, u * u);
        let h = self.knot_s;
        Basis {
            first,
            value: [
                v * v * v / 6.0,
                (3.0 * u2 * u - 6.0 * u2 + 4.0) / 6.0,
                (-3.0 * u2 * u + 3.0 * u2 + 3.0 * u + 1.0) / 6.0,
                u2 * u / 6.0,
            ],
            rate: [
                -0.5 * v * v / h,
                (1.5 * u2 - 2.0 * u) / h,
                (-1.5 * u2 + u + 0.5) / h,
                0.5 * u2 / h,
            ],
        }
    }

    /// Σ weight_m·c_{first+m}.
    pub fn combine(&self, first: usize, weight: &[f64; ORDER]) -> Vector3<f64> {
        let c = &self.coefficients[first..first + ORDER];
        c[0] * weight[0] + c[1] * weight[1] + c[2] * weight[2] + c[3] * weight[3]
    }

    /// Position, world units.
    pub fn position(&self, t_s: f64) -> Point3<f64> {
        let basis = self.basis(t_s);
        Point3::from(self.combine(basis.first, &basis.value))
    }

    /// Velocity, world units per second.
    #[cfg(test)]
    pub fn velocity(&self, t_s: f64) -> Vector3<f64> {
        let basis = self.basis(t_s);
        self.combine(basis.first, &basis.rate)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wavy() -> Spline {
        let mut s = Spline::covering(&[(-1.0, 3.0)], 0.25);
        for (k, c) in s.coefficients.iter_mut().enumerate() {
            let t = -1.0 + (k as f64 - 1.0) * 0.25;
            *c = Vector3::new((2.0 * t).sin(), t * t, (1.5 * t).cos());
        }
        s
    }

    #[test]
    fn basis_sums_to_one_and_rate_is_the_derivative() {
        let s = wavy();
        let mut checked = 0;
        for k in -4..38 {
            let t = 0.0937 * f64::from(k) - 0.4;
            let b = s.basis(t);
            assert!((b.value.iter().sum::<f64>() - 1.0).abs() < 1e-12);
            let d = 1e-6;
            let numeric = (s.position(t + d) - s.position(t - d)) / (2.0 * d);
            assert!((numeric - s.velocity(t)).norm() < 1e-7, "at {t}");
            checked += 1;
        }
        assert_eq!(checked, 42);
    }

    #[test]
    fn coefficients_of_a_line_are_its_points() {
        let mut s = Spline::covering(&[(0.0, 2.0)], 0.5);
        for (k, c) in s.coefficients.iter_mut().enumerate() {
            *c = Vector3::new(0.5 * (k as f64 - 1.0), 0.0, 1.0);
        }
        let x = s.position(1.3);
        assert!((x - Point3::new(1.3, 0.0, 1.0)).norm() < 1e-12);
    }

    #[test]
    fn an_instant_in_a_gap_belongs_to_the_nearer_piece() {
        let s = Spline::covering(&[(0.0, 1.0), (5.0, 6.0)], 0.5);
        assert_eq!(s.coefficients.len(), 10);
        assert_eq!(s.basis(2.0).first, 1);
        assert_eq!(s.basis(4.0).first, 5);
        assert_eq!(s.basis(-3.0).first, 0);
        assert_eq!(s.segments().collect::<Vec<_>>(), [0, 1, 5, 6]);
        assert_eq!(s.triples().collect::<Vec<_>>(), [0, 1, 2, 5, 6, 7]);
    }
}
