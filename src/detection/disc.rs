//! The picture of a ball: a shaded disc swept over the exposure, before a known background.
//!
//! With q(t) = c + t·s the centre at exposure fraction t ∈ [−½, ½], ρ = x − q(t) and (u, v) = ρ/r:
//!
//! I(x) = B(x) + mean_t { [S′(u′, v′) − B(x)]·D(|ρ|) },   ρ′ = ρ + σ²·∇D/D
//! S(u, v) = a·(1 + b·u + c·v + d·u² + e·u·v + f·v² + max(0, l·n)),   n = (u, v, √(1 − u² − v²))
//!
//! D is the disc of radius r blurred by optics and pixel area (a Gaussian edge of width σ). S is the light on the
//! ball: sky and ground as a polynomial, the sun or the lamps as a lit sphere. Light is fitted, so it cannot pull
//! the centre; the background is what other frames show. `lanes.rs` computes it.
//!
//! A lens draws a sphere away from the middle of its picture as an ellipse (6 % longer than wide 24° off the axis of a
//! usual lens). ρ is the offset as it would be on the axis, [`Sweep::on_axis`]: with a circle the radius was wrong, and
//! the centre followed the side of more contrast, by up to 0.15 px at the end of a flight.
//!
//! The blur mixes the light too: a pixel at the rim sees only the part of its surroundings that is on the ball (of a
//! Gaussian cut off at the edge). ρ′ is the mean of that part, so that a light with a slope is blurred exactly, and S′ is
//! the mean of S over it: squares, the sphere's depth and the line between lit and unlit have the part's variances along
//! and across the rim. With S at ρ itself the centre lay 0.04 px too low (measured on 824 rendered balls); with S at ρ′
//! pictures were up to 6 % of the contrast wrong for a blur of 1 px, and centres by up to 0.2 px where the light comes
//! from behind the ball. Now they are right to 1 % (`the_light_is_blurred_with_the_disc`).

use nalgebra::{Matrix2, SMatrix, SVector, Vector2};

use super::dispatch::{Isa, Kernels};

/// Centre x, y and level a: what each frame has of its own.
pub const OWN: usize = 3;
/// Index of the level a.
pub const LEVEL: usize = 2;
/// Index of the radius.
pub const RADIUS: usize = 3;
/// Index of the streak's scale (1: as long as velocity times exposure says).
pub const STREAK_SCALE: usize = 4;
/// Index of the first term of the light: b, c, d, e, f, then l.
pub const LIGHT: usize = 5;
/// Terms of the light.
pub const TERMS: usize = 8;
/// All parameters of one frame.
pub const PARAMETERS: usize = LIGHT + TERMS;
/// The slope of n_z is that where it is this at least: at the rim it has no end.
pub const RIM_DEPTH_MIN: f64 = 0.1;
/// Instants of a sweep at rest and per blur's width of its length: the picture is then right to 0.3 % of the contrast
/// (streaks of 1 to 10 px, blurs of 0.3 to 0.55 px; as many instants in equal steps: 1 to 5 %).
const INSTANTS: (f64, f64) = (1.2, 0.5);
/// Most instants of a sweep.
const INSTANTS_MAX: usize = 32;
/// The blurred edge ends this many σ from the edge.
pub const EDGE_REACH_SIGMAS: f64 = 4.0;

/// A vector of all parameters.
pub type Parameters = SVector<f64, PARAMETERS>;
/// A matrix over all parameters.
pub type Information = SMatrix<f64, PARAMETERS, PARAMETERS>;

/// The edge of a disc blurred by a Gaussian.
#[derive(Debug, Clone, Copy)]
pub struct Edge {
    /// σ of the blur, pixels.
    pub sigma_px: f64,
    /// Of the machine, for the loops over pixels.
    pub kernels: Kernels,
}

impl Edge {
    /// An edge of this blur.
    pub fn new(sigma_px: f64) -> Self {
        Self {
            sigma_px,
            kernels: Kernels::new(Isa::detect()),
        }
    }
}

/// The exposure as a few instants with weights (Gauss and Legendre's), and what the lens makes of a circle.
#[derive(Debug, Clone)]
pub struct Sweep {
    /// From start to end of the exposure at scale 1, pixels.
    pub streak_px: Vector2<f64>,
    /// Instants from −½ (start of the exposure) to ½, each with its share of the light.
    pub instants: Vec<(f64, f64)>,
    /// Offset in the picture to the offset on the lens's axis.
    pub on_axis: Matrix2<f64>,
}

impl Sweep {
    /// A sweep along this vector (start to end of the exposure) of a disc with this blur (σ, pixels), to which the lens
    /// does this there (offset on the axis to offset in the picture).
    pub fn new(streak_px: Vector2<f64>, blur_px: f64, shape: &Matrix2<f64>) -> Self {
        Self {
            streak_px,
            instants: instants(&streak_px, blur_px),
            on_axis: shape.try_inverse().unwrap_or_else(Matrix2::identity),
        }
    }

    /// For a disc of another blur.
    pub fn blur(&mut self, blur_px: f64) {
        self.instants = instants(&self.streak_px, blur_px);
    }
}

/// As many instants as a streak needs before this blur.
fn instants(streak_px: &Vector2<f64>, blur_px: f64) -> Vec<(f64, f64)> {
    let (at_rest, per_blur) = INSTANTS;
    let count = at_rest + per_blur * streak_px.norm() / blur_px;
    gauss_legendre((count.ceil() as usize).clamp(1, INSTANTS_MAX))
}

/// Places in [−½, ½] and weights (sum 1) of the rule of `count` points: the zeros of the Legendre polynomial, by Newton's
/// method from Tricomi's guess (Press et al., Numerical Recipes, §4.6).
fn gauss_legendre(count: usize) -> Vec<(f64, f64)> {
    let n = count as f64;
    let point = |i: usize| {
        let mut x = (std::f64::consts::PI * (i as f64 + 0.75) / (n + 0.5)).cos();
        let mut slope = 1.0;
        for _ in 0..4 {
            let (mut value, mut before) = (x, 1.0);
            for k in 2..=count {
                let k = k as f64;
                (value, before) = (((2.0 * k - 1.0) * x * value - (k - 1.0) * before) / k, value);
            }
            slope = n * (x * value - before) / (x * x - 1.0);
            x -= value / slope;
        }
        (-0.5 * x, 1.0 / ((1.0 - x * x) * slope * slope))
    };
    (0..count).map(point).collect()
}

#[cfg(test)]
mod tests {
    use super::super::lanes::one_pixel;
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_gradient_is_the_derivative_of_the_value(
            dx in -6.0..6.0f64, dy in -6.0..6.0f64, r in 2.5..5.0f64, sx in -3.0..3.0f64,
            sy in -3.0..3.0f64, wide in 0.9..1.1f64, skew in -0.08..0.08f64, bu in -0.4..0.4f64, bv in -0.4..0.4f64, quadratic in -0.2..0.2f64,
        ) {
            let mut p = Parameters::zeros();
            let values = [10.0, 20.0, 150.0, r, 1.0, bu, bv, quadratic, 0.05, -0.1, 0.2, -0.6, 0.4];
            for (i, value) in values.into_iter().enumerate() {
                p[i] = value;
            }
            let x = Vector2::new(10.0 + dx, 20.0 + dy);
            let edge = Edge::new(0.55);
            let sweep = Sweep::new(Vector2::new(sx, sy), edge.sigma_px, &Matrix2::new(wide, skew, skew, 1.0));
            let Some((_, here)) = one_pixel(x, 60.0, &p, (&sweep, &edge)) else { return Ok(()) };
            for i in 0..PARAMETERS {
                let h = 0.02;
                let (mut up, mut down) = (p, p);
                up[i] += h;
                down[i] -= h;
                let value = |p: &Parameters| one_pixel(x, 60.0, p, (&sweep, &edge)).map_or(60.0, |m| m.0);
                let numeric = (value(&up) - value(&down)) / (2.0 * h);
                let slack = 0.6 + 0.015 * numeric.abs();
                prop_assert!((numeric - here[i]).abs() < slack, "{i}: {numeric} {}", here[i]);
            }
        }
    }
    /// A pixel's level by brute force: light on the disc, blurred by a Gaussian of the edge's width.
    fn by_hand(x: Vector2<f64>, p: &Parameters, sigma: f64) -> f64 {
        let (steps, reach) = (160, 5.0 * sigma);
        let (mut sum, mut weights) = (0.0, 0.0);
        for i in 0..steps * steps {
            let place = |k: i32| (f64::from(k) + 0.5) / f64::from(steps) * 2.0 * reach - reach;
            let off = Vector2::new(place(i % steps), place(i / steps));
            let weight = (-0.5 * off.norm_squared() / (sigma * sigma)).exp();
            let (u, v) = ((x.x + off.x) / p[RADIUS], (x.y + off.y) / p[RADIUS]);
            let rest = 1.0 - u * u - v * v;
            let facing = p[LIGHT + 5] * u + p[LIGHT + 6] * v + p[LIGHT + 7] * rest.max(0.0).sqrt();
            let light = if rest > 0.0 {
                p[LEVEL] * (1.0 + facing.max(0.0))
            } else {
                60.0
            };
            sum += weight * light;
            weights += weight;
        }
        sum / weights
    }

    #[test]
    fn the_rule_integrates_polynomials_exactly() {
        for count in [1, 2, 3, 8, 31] {
            let rule = gauss_legendre(count);
            for power in 0..(2 * count).min(20) {
                let sum: f64 = rule.iter().map(|(t, w)| w * t.powi(power as i32)).sum();
                // The mean of tⁿ over [−½, ½].
                let mean = if power % 2 == 0 {
                    0.5f64.powi(power as i32) / (power as f64 + 1.0)
                } else {
                    0.0
                };
                assert!(
                    (sum - mean).abs() < 1e-14,
                    "{count} points, t^{power}: {sum} {mean}"
                );
            }
        }
        let (first, weight) = gauss_legendre(2)[0];
        assert!((first + 0.5 / 3f64.sqrt()).abs() < 1e-15 && (weight - 0.5).abs() < 1e-15);
    }

    #[test]
    fn a_few_instants_make_the_picture_of_many() {
        let mut p = Parameters::zeros();
        for (i, value) in [
            10.0, 20.0, 150.0, 3.0, 1.0, 0.1, -0.3, 0.05, 0.02, -0.1, 0.2, -0.6, 0.4,
        ]
        .into_iter()
        .enumerate()
        {
            p[i] = value;
        }
        for (streak, sigma) in [(1.0, 0.3), (2.8, 0.3), (2.8, 0.42), (4.0, 0.55), (10.0, 0.42)] {
            let edge = Edge::new(sigma);
            let streak_px = Vector2::new(0.95 * streak, 0.3 * streak);
            let few = Sweep::new(streak_px, sigma, &Matrix2::identity());
            let many = Sweep {
                streak_px,
                instants: gauss_legendre(400),
                on_axis: Matrix2::identity(),
            };
            for i in 0..21 * 21 {
                let x = Vector2::new(f64::from(i % 21), 10.0 + f64::from(i / 21));
                let level = |sweep: &Sweep| one_pixel(x, 60.0, &p, (sweep, &edge)).map_or(60.0, |m| m.0);
                let off = (level(&few) - level(&many)).abs();
                assert!(off < 0.6, "streak {streak}, blur {sigma}: {off} levels at {x}");
            }
        }
    }

    #[test]
    fn the_light_is_blurred_with_the_disc() {
        let mut p = Parameters::zeros();
        for (i, value) in [(LEVEL, 100.0), (RADIUS, 3.2), (STREAK_SCALE, 1.0)] {
            p[i] = value;
        }
        for (i, value) in [0.3, -1.15, 0.1].into_iter().enumerate() {
            p[LIGHT + 5 + i] = value;
        }
        let (sigma, still) = (0.58, Sweep::new(Vector2::zeros(), 0.58, &Matrix2::identity()));
        let edge = Edge::new(sigma);
        let (mut pixels, mut squares, mut pull) = (0.0, 0.0, 0.0);
        for i in 0..121 {
            let x = Vector2::new(f64::from(i % 11) - 5.0, f64::from(i / 11) - 5.2);
            let modelled = one_pixel(x, 60.0, &p, (&still, &edge));
            let off = modelled.map_or(60.0, |m| m.0) - by_hand(x, &p, sigma);
            pull += off * modelled.map_or(0.0, |m| m.1[1]);
            squares += off * off;
            pixels += modelled.map_or(0.0, |m| m.1[1].powi(2));
        }
        let (rms, shift) = (f64::sqrt(squares / 121.0), pull / pixels);
        println!("rms {rms:.2} levels, pull on the centre {shift:.4} px");
        assert!(rms < 0.8, "rms {rms} levels of 155");
        assert!(shift.abs() < 0.01, "pull {shift} px");
    }
}
