//! The picture of a ball ([`super::disc`]) and its derivatives for sixteen pixels side by side, written so that the
//! compiler keeps them in vectors: most of a second look is spent here.
//!
//! In single precision, with places counted from the picture's own corner: a level is right to 1e-5, a place to 4e-6 px,
//! a thousandth of what the noise leaves open. The sums over all pixels are in double precision.

#![allow(
    clippy::needless_range_loop,
    reason = "one index runs over several arrays side by side"
)]

use nalgebra::Vector2;

use super::disc::{
    EDGE_REACH_SIGMAS, Edge, Information, LEVEL, LIGHT, OWN, PARAMETERS, Parameters, RADIUS, STREAK_SCALE,
    Sweep, TERMS,
};

use shine::shine;

/// Pixels side by side.
const LANES: usize = 16;
type Lane = [f32; LANES];
/// Nearer to the centre than this there is no direction, pixels.
const MIDDLE_PX: f32 = 1e-6;
/// Less of a pixel is nothing.
const COVERAGE_MIN: f32 = 1e-9;

/// One pixel to fit.
#[derive(Clone, Copy)]
pub struct Observation {
    /// Place, pixels.
    pub at: Vector2<f64>,
    /// Level.
    pub value: f64,
    /// Level without the ball.
    pub background: f64,
    /// Variance of their difference, levels².
    pub variance: f64,
}

/// Sixteen pixels.
#[derive(Debug, Clone)]
struct Block {
    x: Lane,
    y: Lane,
    value: Lane,
    background: Lane,
    variance: Lane,
    count: usize,
}

/// The pixels of a picture in sixteens; the last block is filled up with pixels of no weight.
#[derive(Debug, Clone)]
pub struct PixelLanes {
    /// Where places are counted from, pixels.
    corner: Vector2<f64>,
    blocks: Vec<Block>,
}

impl PixelLanes {
    /// From pixels one by one.
    pub fn new(observations: &[Observation]) -> Self {
        let corner = observations.first().map_or(Vector2::zeros(), |o| o.at);
        let blocks = observations.chunks(LANES).map(|chunk| {
            let of = |get: &dyn Fn(&Observation) -> f64| -> Lane {
                std::array::from_fn(|i| chunk.get(i).or(chunk.first()).map_or(0.0, |o| get(o) as f32))
            };
            Block {
                x: of(&|o| o.at.x - corner.x),
                y: of(&|o| o.at.y - corner.y),
                value: of(&|o| o.value),
                background: of(&|o| o.background),
                variance: of(&|o| o.variance),
                count: chunk.len(),
            }
        });
        Self {
            corner,
            blocks: blocks.collect(),
        }
    }

    /// Every pixel with the level that it should have, and how much of it the ball covers.
    pub fn modelled(&self, look: &Look<'_>) -> Vec<(Observation, f64, f64)> {
        let mut all = Vec::with_capacity(LANES * self.blocks.len());
        for block in &self.blocks {
            let seen = see::<false>(block, self.corner, look);
            for l in 0..block.count.min(LANES) {
                let observation = Observation {
                    at: self.corner + Vector2::new(f64::from(block.x[l]), f64::from(block.y[l])),
                    value: f64::from(block.value[l]),
                    background: f64::from(block.background[l]),
                    variance: f64::from(block.variance[l]),
                };
                all.push((observation, f64::from(seen.value[l]), f64::from(seen.coverage[l])));
            }
        }
        all
    }
}

/// What all pixels of a picture have in common.
pub struct Look<'a> {
    centre: Vector2<f64>,
    level: f32,
    radius: f32,
    streak_scale: f32,
    light: [f32; TERMS],
    sweep: &'a Sweep,
    blur_px: f32,
    per_blur: f32,
    /// Distance from the edge beyond which there is nothing of the ball, pixels.
    reach_px: f32,
    /// Variance of the model itself, levels².
    model_variance: f32,
    /// Residuals beyond this many σ count linearly.
    huber_sigmas: f32,
    edge_radius_px: f32,
    edge_by_radius: f32,
    /// (σ/r)²: variance of the blur in radii.
    spread: f32,
}

impl<'a> Look<'a> {
    /// At a ball of these parameters.
    pub fn new(
        parameters: &Parameters,
        (sweep, edge): (&'a Sweep, &Edge),
        (model_variance, huber_sigmas): (f64, f64),
    ) -> Self {
        let radius = parameters[RADIUS];
        // A Gaussian edge at r covers π(r² + σ²): at √(r² − σ²) the area is the disc's.
        let edge_radius_px = (radius * radius - edge.sigma_px * edge.sigma_px)
            .max(0.04 * radius * radius)
            .sqrt();
        Self {
            centre: Vector2::new(parameters[0], parameters[1]),
            level: parameters[LEVEL] as f32,
            radius: radius as f32,
            streak_scale: parameters[STREAK_SCALE] as f32,
            light: std::array::from_fn(|i| parameters[LIGHT + i] as f32),
            sweep,
            blur_px: edge.sigma_px as f32,
            per_blur: (1.0 / edge.sigma_px) as f32,
            reach_px: (EDGE_REACH_SIGMAS * edge.sigma_px) as f32,
            model_variance: model_variance as f32,
            huber_sigmas: huber_sigmas as f32,
            edge_radius_px: edge_radius_px as f32,
            edge_by_radius: (radius / edge_radius_px) as f32,
            spread: (edge.sigma_px / radius).powi(2) as f32,
        }
    }
}

/// Normal equations of one linearisation.
pub struct Sums {
    /// Jᵀ·W·J.
    pub information: Information,
    /// Jᵀ·W·r.
    pub gradient: Parameters,
    /// Robust cost.
    pub cost: f64,
    /// Weighted squared residuals, in variances.
    pub squares: f64,
    /// Pixels that the ball reaches.
    pub used: f64,
}

/// The model at sixteen pixels.
struct Seen {
    value: Lane,
    coverage: Lane,
    gradient: [Lane; PARAMETERS],
}

/// Linearises a picture about the parameters of `look`.
#[inline(always)]
pub fn linearise(pixels: &PixelLanes, look: &Look<'_>) -> Sums {
    sums::<true>(pixels, look)
}

/// As [`linearise`] for the frame's own parameters alone; what concerns the others is left zero.
#[inline(always)]
pub fn locate(pixels: &PixelLanes, look: &Look<'_>) -> Sums {
    sums::<false>(pixels, look)
}

#[inline(always)]
fn sums<const ALL: bool>(pixels: &PixelLanes, look: &Look<'_>) -> Sums {
    let mut sums = Sums {
        information: Information::zeros(),
        gradient: Parameters::zeros(),
        cost: 0.0,
        squares: 0.0,
        used: 0.0,
    };
    let mut slopes: Vec<[Lane; PARAMETERS]> = Vec::with_capacity(pixels.blocks.len());
    let mut weights: Vec<(Lane, Lane)> = Vec::with_capacity(pixels.blocks.len());
    for block in &pixels.blocks {
        let seen = see::<ALL>(block, pixels.corner, look);
        let (mut weight, mut pull) = ([0.0; LANES], [0.0; LANES]);
        for l in 0..block.count.min(LANES) {
            if seen.coverage[l] <= 0.0 {
                let off = block.value[l] - block.background[l];
                sums.cost += f64::from(huber(off * off / block.variance[l], look.huber_sigmas).0);
                continue;
            }
            let variance = block.variance[l] + look.model_variance;
            let residual = block.value[l] - seen.value[l];
            let squared = residual * residual / variance;
            let (cost, robust) = huber(squared, look.huber_sigmas);
            weight[l] = robust / variance;
            pull[l] = weight[l] * residual;
            sums.cost += f64::from(cost);
            sums.squares += f64::from(robust * squared);
            sums.used += 1.0;
        }
        if seen.coverage.iter().any(|c| *c > 0.0) {
            slopes.push(seen.gradient);
            weights.push((weight, pull));
        }
    }
    // One sum after the other over all blocks: block by block the compiler gathers across the sums.
    let parameters = if ALL { PARAMETERS } else { OWN };
    let mut weighted: Vec<Lane> = vec![[0.0; LANES]; slopes.len()];
    for i in 0..parameters {
        let mut pulled = [0.0; LANES];
        for ((slopes, (weight, pull)), weighted) in slopes.iter().zip(&weights).zip(&mut weighted) {
            for l in 0..LANES {
                pulled[l] += slopes[i][l] * pull[l];
                weighted[l] = slopes[i][l] * weight[l];
            }
        }
        sums.gradient[i] = total(&pulled);
        for j in i..parameters {
            let mut products = [0.0; LANES];
            for (slopes, weighted) in slopes.iter().zip(&weighted) {
                for l in 0..LANES {
                    products[l] += weighted[l] * slopes[j][l];
                }
            }
            let sum = total(&products);
            sums.information[(i, j)] = sum;
            sums.information[(j, i)] = sum;
        }
    }
    sums
}

#[inline(always)]
fn total(lane: &Lane) -> f64 {
    lane.iter().map(|v| f64::from(*v)).sum()
}

/// Huber cost and weight of a squared normalised residual.
#[inline(always)]
fn huber(squared: f32, sigmas: f32) -> (f32, f32) {
    let size = squared.sqrt();
    if size <= sigmas {
        (0.5 * squared, 1.0)
    } else {
        (sigmas * (size - 0.5 * sigmas), sigmas / size)
    }
}

/// The blurred edge at one place: how much of the blur is on the ball, and mean and variance of that part across the edge.
struct Rim {
    coverage: f32,
    slope: f32,
    /// The mean lies so much further in, pixels.
    shift_px: f32,
    /// Its variance as a share of the blur's; also how far the mean follows the place.
    follow: f32,
    /// Derivative of `follow` by the place, outwards, 1/px.
    follow_slope: f32,
}

#[inline(always)]
fn rim(inside_px: f32, look: &Look<'_>) -> Rim {
    let z = inside_px * look.per_blur;
    let (coverage, density) = share_and_density(z);
    let cut = density / coverage.max(COVERAGE_MIN);
    Rim {
        coverage,
        slope: density * look.per_blur,
        shift_px: look.blur_px * cut,
        follow: (1.0 - cut * (z + cut)).max(0.0),
        follow_slope: (cut - cut * (z + cut) * (z + 2.0 * cut)) * look.per_blur,
    }
}

#[inline(always)]
fn see<const ALL: bool>(block: &Block, corner: Vector2<f64>, look: &Look<'_>) -> Seen {
    let (level, scale) = (look.level, look.streak_scale);
    let per_radius = 1.0 / look.radius;
    let centre = look.centre - corner;
    let (centre_x, centre_y) = (centre.x as f32, centre.y as f32);
    let on_axis = &look.sweep.on_axis;
    let (xx, xy) = (on_axis.m11 as f32, on_axis.m12 as f32);
    let (yx, yy) = (on_axis.m21 as f32, on_axis.m22 as f32);
    let (mut excess, mut coverage) = ([0.0; LANES], [0.0; LANES]);
    let mut gradient = [[0.0; LANES]; PARAMETERS];
    for (instant, share) in &look.sweep.instants {
        let moved = look.sweep.streak_px * *instant;
        let (moved_x, moved_y, share) = (moved.x as f32, moved.y as f32, *share as f32);
        let px: Lane = std::array::from_fn(|l| block.x[l] - centre_x - moved_x * scale);
        let py: Lane = std::array::from_fn(|l| block.y[l] - centre_y - moved_y * scale);
        let rx: Lane = std::array::from_fn(|l| xx * px[l] + xy * py[l]);
        let ry: Lane = std::array::from_fn(|l| yx * px[l] + yy * py[l]);
        let distance: Lane = std::array::from_fn(|l| (rx[l] * rx[l] + ry[l] * ry[l]).sqrt());
        if distance.iter().all(|d| *d >= look.edge_radius_px + look.reach_px) {
            continue;
        }
        for l in 0..LANES {
            let rim = rim(look.edge_radius_px - distance[l], look);
            let inverse = 1.0 / distance[l].max(MIDDLE_PX);
            let (nx, ny) = (rx[l] * inverse, ry[l] * inverse);
            let followed = (distance[l] - rim.shift_px).max(0.0) * inverse;
            // In the very middle there is no direction, and the shift is nothing.
            let tangential = if distance[l] <= MIDDLE_PX { 1.0 } else { followed };
            let (u, v) = (rx[l] * tangential * per_radius, ry[l] * tangential * per_radius);
            let shine = shine((u, v), (nx, ny), rim.follow, look);
            let s = level * shine.value;
            let (s_u, s_v) = (level * shine.by_u * per_radius, level * shine.by_v * per_radius);
            let (d, slope) = (share * rim.coverage, share * rim.slope);
            let lift = s - block.background[l];
            excess[l] += d * lift;
            coverage[l] += d;
            // The place seen follows the pixel fully along the rim, partly across it.
            let outward = s_u * nx + s_v * ny;
            // The part on the ball is narrower near the edge.
            let narrower = level * shine.by_follow * rim.follow_slope;
            let across = outward * (rim.follow - tangential) + narrower;
            let by_rx = lift * slope * nx - d * (s_u * tangential + across * nx);
            let by_ry = lift * slope * ny - d * (s_v * tangential + across * ny);
            let (by_x, by_y) = (xx * by_rx + yx * by_ry, xy * by_rx + yy * by_ry);
            gradient[0][l] += by_x;
            gradient[1][l] += by_y;
            gradient[LEVEL][l] += d * shine.value;
            if !ALL {
                continue;
            }
            gradient[RADIUS][l] += lift * slope * look.edge_by_radius
                + d * ((outward * (1.0 - rim.follow) - narrower) * look.edge_by_radius
                    - (s_u * u + s_v * v)
                    - 2.0 * level * shine.by_spread * look.spread * per_radius);
            gradient[STREAK_SCALE][l] += by_x * moved_x + by_y * moved_y;
            // One by one: as an array they would be scattered.
            let dl = d * level;
            gradient[LIGHT][l] += dl * u;
            gradient[LIGHT + 1][l] += dl * v;
            gradient[LIGHT + 2][l] += dl * shine.uu;
            gradient[LIGHT + 3][l] += dl * shine.uv;
            gradient[LIGHT + 4][l] += dl * shine.vv;
            gradient[LIGHT + 5][l] += dl * shine.by_lx;
            gradient[LIGHT + 6][l] += dl * shine.by_ly;
            gradient[LIGHT + 7][l] += dl * shine.by_lz;
        }
    }
    Seen {
        value: std::array::from_fn(|l| block.background[l] + excess[l]),
        coverage,
        gradient,
    }
}

/// Φ(z) (to 1e-6, Abramowitz and Stegun 7.1.26) and φ(z); beyond the edge's reach 0 or 1, and 0.
#[inline(always)]
fn share_and_density(z: f32) -> (f32, f32) {
    const REACH: f32 = EDGE_REACH_SIGMAS as f32;
    /// 1/√(2π).
    const PER_ROOT_TAU: f32 = 0.398_942_3;
    let size = z.abs();
    let within = size <= REACH;
    let near = size.min(REACH);
    let bell = exp_small(-0.5 * near * near);
    let x = near * std::f32::consts::FRAC_1_SQRT_2;
    let t = 1.0 / (1.0 + 0.327_591_1 * x);
    let series =
        t * (0.254_829_6 + t * (-0.284_496_74 + t * (1.421_413_7 + t * (-1.453_152 + t * 1.061_405_4))));
    let tail = if within { 0.5 * series * bell } else { 0.0 };
    let share = if z >= 0.0 { 1.0 - tail } else { tail };
    let density = if within { bell * PER_ROOT_TAU } else { 0.0 };
    (share, density)
}

/// eˣ for −80 < x < 80 without a call: x = n·ln 2 + r, a series for eʳ, and n as the exponent's bits.
#[inline(always)]
fn exp_small(x: f32) -> f32 {
    /// Added to a small number its integer part stands in the last bits.
    const ROUND: f32 = 12_582_912.0;
    const LN2_HIGH: f32 = 0.693_359_4;
    const LN2_LOW: f32 = -2.121_944_4e-4;
    let shifted = x * std::f32::consts::LOG2_E + ROUND;
    let n = shifted - ROUND;
    let r = x - n * LN2_HIGH - n * LN2_LOW;
    let series = [
        1.0 / 5_040.0,
        1.0 / 720.0,
        1.0 / 120.0,
        1.0 / 24.0,
        1.0 / 6.0,
        0.5,
        1.0,
        1.0,
    ];
    let mut sum = 0.0;
    for term in series {
        sum = sum * r + term;
    }
    sum * f32::from_bits(shifted.to_bits().wrapping_add(127) << 23)
}

/// One pixel alone: value, gradient; `None` where the ball does not reach.
#[cfg(test)]
pub fn one_pixel(
    at: Vector2<f64>,
    background: f64,
    parameters: &Parameters,
    (sweep, edge): (&Sweep, &Edge),
) -> Option<(f64, Parameters)> {
    let observation = Observation {
        at,
        value: 0.0,
        background,
        variance: 1.0,
    };
    let pixels = PixelLanes::new(&[observation]);
    let look = Look::new(parameters, (sweep, edge), (0.0, 2.5));
    let seen = see::<true>(&pixels.blocks[0], pixels.corner, &look);
    (seen.coverage[0] > 0.0).then(|| {
        let gradient = Parameters::from_fn(|i, _| f64::from(seen.gradient[i][0]));
        (f64::from(seen.value[0]), gradient)
    })
}

mod shine;
#[cfg(test)]
mod tests;
