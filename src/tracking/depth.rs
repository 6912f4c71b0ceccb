//! Smooth curves in the picture of what comes near or goes far.

use nalgebra::Vector2;

use super::curve::{Curve, Sample, Stiffness};

/// How much further off a ball may be at its end than at its begin: a camera behind home, beside the way, behind the mound.
const RATIOS: [f64; 7] = [0.125, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0];
/// From the best of them on, steps up and down by this ratio and its roots.
const STEP: f64 = 1.4;
const REFINEMENTS: usize = 4;
/// Degree of the curve that chooses among them.
const DEGREE: usize = 3;
/// Samples that choose, evenly among all: hundreds of paths of a player end every second.
const SAMPLES_MAX: usize = 32;
/// A sample further than this from it, in σ, is no ball's.
const SIGMAS_MAX: f64 = 5.0;

/// How a ball's depth changes: as 1 + (r − 1)τ, τ from 0 to 1 between first and last sample. Seen at that depth a flight that is
/// a polynomial of time in space is one in the picture when divided by the depth; no polynomial alone follows it to its near
/// end. Only r is chosen: that whose cubic is nearest to the samples.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Depth {
    begin: f64,
    length: f64,
    ratio: f64,
}

impl Depth {
    /// Of a ball with these samples, by rising or falling time.
    pub fn of(samples: &[Sample]) -> Self {
        let span = samples.first().zip(samples.last());
        let (begin, end) = span.map_or((0.0, 0.0), |(first, last)| (first.t, last.t));
        let with = |ratio| Self {
            begin,
            length: end - begin,
            ratio,
        };
        let some: Vec<Sample> = samples
            .iter()
            .step_by(samples.len().div_ceil(SAMPLES_MAX).max(1))
            .copied()
            .collect();
        let costed = |ratio| Some((with(ratio).cost(&some)?, ratio));
        let nearest = |ratios: &mut dyn Iterator<Item = f64>| {
            let all = ratios.filter_map(costed);
            all.min_by(|a, b| a.0.total_cmp(&b.0))
        };
        let Some(mut best) = nearest(&mut RATIOS.into_iter()) else {
            return with(1.0);
        };
        let mut step = STEP;
        for _ in 0..REFINEMENTS {
            let beside = nearest(&mut [best.1 * step, best.1 / step].into_iter());
            best = beside.filter(|beside| beside.0 < best.0).unwrap_or(best);
            step = step.sqrt();
        }
        with(best.1)
    }

    /// The depth at a time, in depths at the first sample.
    fn at(&self, t: f64) -> f64 {
        let share = if self.length == 0.0 {
            0.0
        } else {
            (t - self.begin) / self.length
        };
        // Beyond the samples it does not reach the camera.
        (1.0 + (self.ratio - 1.0) * share).max(0.5 * self.ratio.min(1.0))
    }

    /// A curve through samples of this ball.
    pub fn fit(&self, samples: &[Sample], stiffness: Stiffness) -> Option<DepthCurve> {
        let spatial = samples.iter().map(|sample| {
            let depth = self.at(sample.t);
            Sample {
                t: sample.t,
                position_px: sample.position_px * depth,
                variance_px2: sample.variance_px2 * depth * depth,
            }
        });
        let curve = Curve::fit(&spatial.collect::<Vec<_>>(), stiffness)?;
        Some(DepthCurve { depth: *self, curve })
    }

    /// How far the samples are from a cubic; `None` for too few of them.
    fn cost(&self, samples: &[Sample]) -> Option<f64> {
        let stiffness = Stiffness {
            degree: DEGREE,
            acceleration_sigma: f64::INFINITY,
        };
        let curve = self.fit(samples, stiffness)?;
        let costs = samples.iter().map(|sample| {
            let off_px = (sample.position_px - curve.position(sample.t)).norm();
            (off_px / sample.variance_px2.sqrt()).min(SIGMAS_MAX).powi(2)
        });
        Some(costs.sum())
    }
}

/// A polynomial of time divided by a depth.
#[derive(Debug, Clone, Copy)]
pub struct DepthCurve {
    depth: Depth,
    curve: Curve,
}

impl DepthCurve {
    /// Position at `t`, pixels.
    pub fn position(&self, t: f64) -> Vector2<f64> {
        self.curve.position(t) / self.depth.at(t)
    }

    /// Variance per axis of the position at `t`, px².
    pub fn variance_px2(&self, t: f64) -> f64 {
        self.curve.variance_px2(t) / self.depth.at(t).powi(2)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flight_that_comes_near_is_a_parabola_at_its_depth() {
        // From 25 m off to 6 m, falling from 1.9 m to 0.7 m below the camera's axis.
        let at = |share: f64| {
            let depth_m = 25.0 - 19.0 * share;
            Vector2::new(1024.0, 512.0)
                + Vector2::new(0.3, -0.1 + 0.3 * share + 0.9 * share * share) * 1800.0 / depth_m
        };
        let samples: Vec<Sample> = (0..40)
            .map(|i| Sample {
                t: 3.0 + 0.4 * f64::from(i) / 39.0,
                position_px: at(f64::from(i) / 39.0),
                variance_px2: 0.01,
            })
            .collect();
        let depth = Depth::of(&samples);
        assert!((depth.ratio - 0.24).abs() < 0.01, "{depth:?}");
        let depth = Depth { ratio: 0.24, ..depth };
        assert!((depth.at(3.2) - 0.62).abs() < 1e-9);
        let parabola = Stiffness {
            degree: 2,
            acceleration_sigma: f64::INFINITY,
        };
        let curve = depth.fit(&samples, parabola).unwrap();
        for sample in &samples {
            let off = sample.position_px - curve.position(sample.t);
            assert!(off.norm() < 1e-6, "{off:?} at {}", sample.t);
        }
        // At the same depth the noise is that of the samples: 40 of them, 3 coefficients per axis.
        let variances = samples.iter().map(|s| curve.variance_px2(s.t) / s.variance_px2);
        assert!((variances.sum::<f64>() - 3.0).abs() < 1e-6);
        // A polynomial alone is far off, and the ball does not reach the camera beyond its end.
        let alone = Curve::fit(
            &samples,
            Stiffness {
                degree: 4,
                ..parabola
            },
        )
        .unwrap();
        assert!((alone.position(3.4) - at(1.0)).norm() > 1.0);
        assert!(curve.position(9.0).norm().is_finite());
    }
}
