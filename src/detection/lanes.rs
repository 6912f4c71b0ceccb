//! The picture of a ball ([`super::disc`]) and its derivatives for eight pixels side by side, written so that the
//! compiler keeps them in vectors: nine tenths of a second look are spent here.

#![allow(
    clippy::needless_range_loop,
    reason = "one index runs over several arrays side by side"
)]

use nalgebra::Vector2;

use super::disc::{
    EDGE_REACH_SIGMAS, EDGE_STEPS_PER_PX, Edge, Information, LEVEL, LIGHT, OWN, PARAMETERS, Parameters,
    RADIUS, RIM_DEPTH_MIN, STREAK_SCALE, Sweep, TERMS,
};

/// Pixels side by side.
const LANES: usize = 8;
type Lane = [f64; LANES];

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

/// Eight pixels.
#[derive(Debug, Clone)]
struct Block {
    x: Lane,
    y: Lane,
    value: Lane,
    background: Lane,
    variance: Lane,
    count: usize,
}

/// The pixels of a picture in eights; the last block is filled up with pixels of no weight.
#[derive(Debug, Clone)]
pub struct PixelLanes {
    blocks: Vec<Block>,
}

impl PixelLanes {
    /// From pixels one by one.
    pub fn new(observations: &[Observation]) -> Self {
        let blocks = observations.chunks(LANES).map(|chunk| {
            let of = |get: fn(&Observation) -> f64| -> Lane {
                std::array::from_fn(|i| chunk.get(i).or(chunk.first()).map_or(0.0, get))
            };
            Block {
                x: of(|o| o.at.x),
                y: of(|o| o.at.y),
                value: of(|o| o.value),
                background: of(|o| o.background),
                variance: of(|o| o.variance),
                count: chunk.len(),
            }
        });
        Self {
            blocks: blocks.collect(),
        }
    }
}

/// What all pixels of a picture have in common.
pub struct Look<'a> {
    parameters: &'a Parameters,
    sweep: &'a Sweep,
    edge: &'a Edge,
    /// Variance of the model itself, levels².
    model_variance: f64,
    /// Residuals beyond this many σ count linearly.
    huber_sigmas: f64,
    edge_radius_px: f64,
    edge_by_radius: f64,
    softness: f64,
    /// |(l_x, l_y)|: how fast the light falls across the line between lit and unlit, and over the blur's width.
    light_slope: f64,
    light_width: f64,
    per_light_width: f64,
    softness_over_slope: f64,
}

impl<'a> Look<'a> {
    /// At a ball of these parameters.
    pub fn new(
        parameters: &'a Parameters,
        (sweep, edge): (&'a Sweep, &'a Edge),
        (model_variance, huber_sigmas): (f64, f64),
    ) -> Self {
        let radius = parameters[RADIUS];
        // A Gaussian edge at r covers π(r² + σ²): at √(r² − σ²) the area is the disc's.
        let edge_radius_px = (radius * radius - edge.sigma_px * edge.sigma_px)
            .max(0.04 * radius * radius)
            .sqrt();
        let softness = edge.sigma_px / radius;
        let light_slope = parameters[LIGHT + 5].hypot(parameters[LIGHT + 6]).max(1e-9);
        let light_width = softness * light_slope;
        Self {
            parameters,
            sweep,
            edge,
            model_variance,
            huber_sigmas,
            edge_radius_px,
            edge_by_radius: radius / edge_radius_px,
            softness,
            light_slope,
            light_width,
            per_light_width: 1.0 / light_width.max(1e-9),
            softness_over_slope: softness / light_slope,
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

/// The model at eight pixels.
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
    let parameters = if ALL { PARAMETERS } else { OWN };
    let mut sums = Sums {
        information: Information::zeros(),
        gradient: Parameters::zeros(),
        cost: 0.0,
        squares: 0.0,
        used: 0.0,
    };
    let mut information = [[[0.0; LANES]; PARAMETERS]; PARAMETERS];
    let mut gradient = [[0.0; LANES]; PARAMETERS];
    for block in &pixels.blocks {
        let seen = see::<ALL>(block, look);
        let (mut weight, mut pull) = ([0.0; LANES], [0.0; LANES]);
        for l in 0..block.count.min(LANES) {
            if seen.coverage[l] <= 0.0 {
                let off = block.value[l] - block.background[l];
                sums.cost += huber(off * off / block.variance[l], look.huber_sigmas).0;
                continue;
            }
            let variance = block.variance[l] + look.model_variance;
            let residual = block.value[l] - seen.value[l];
            let squared = residual * residual / variance;
            let (cost, robust) = huber(squared, look.huber_sigmas);
            weight[l] = robust / variance;
            pull[l] = weight[l] * residual;
            sums.cost += cost;
            sums.squares += robust * squared;
            sums.used += 1.0;
        }
        for i in 0..parameters {
            for l in 0..LANES {
                gradient[i][l] += seen.gradient[i][l] * pull[l];
            }
            let weighted: Lane = std::array::from_fn(|l| seen.gradient[i][l] * weight[l]);
            for j in i..parameters {
                for l in 0..LANES {
                    information[i][j][l] += weighted[l] * seen.gradient[j][l];
                }
            }
        }
    }
    for i in 0..parameters {
        sums.gradient[i] = gradient[i].iter().sum();
        for j in i..parameters {
            let sum = information[i][j].iter().sum();
            sums.information[(i, j)] = sum;
            sums.information[(j, i)] = sum;
        }
    }
    sums
}

/// Huber cost and weight of a squared normalised residual.
#[inline(always)]
fn huber(squared: f64, sigmas: f64) -> (f64, f64) {
    let size = squared.sqrt();
    if size <= sigmas {
        (0.5 * squared, 1.0)
    } else {
        (sigmas * (size - 0.5 * sigmas), sigmas / size)
    }
}

/// The blurred edge at eight places.
struct Rims {
    coverage: Lane,
    slope: Lane,
    shift_px: Lane,
    follow: Lane,
}

#[inline(always)]
fn rims(edge: &Edge, inside_px: &Lane) -> Rims {
    let last = edge.pairs.len() - 1;
    let mut rims = Rims {
        coverage: [0.0; LANES],
        slope: [0.0; LANES],
        shift_px: [0.0; LANES],
        follow: [0.0; LANES],
    };
    for l in 0..LANES {
        let place = ((inside_px[l] + edge.reach_px) * EDGE_STEPS_PER_PX).max(0.0);
        let index = (place as usize).min(last);
        let [a, b, c, d, da, db, dc, dd] = edge.pairs[index];
        let f = place - index as f64;
        // Where the ball does not reach there is nothing of it.
        let reached = if inside_px[l] > -edge.reach_px { 1.0 } else { 0.0 };
        rims.coverage[l] = (a + f * da) * reached;
        rims.slope[l] = (b + f * db) * reached;
        rims.shift_px[l] = c + f * dc;
        rims.follow[l] = d + f * dd;
    }
    rims
}

#[inline(always)]
fn see<const ALL: bool>(block: &Block, look: &Look<'_>) -> Seen {
    let p = look.parameters;
    let (radius, level, scale) = (p[RADIUS], p[LEVEL], p[STREAK_SCALE]);
    let per_radius = 1.0 / radius;
    let light: [f64; TERMS] = std::array::from_fn(|i| p[LIGHT + i]);
    let (mut excess, mut coverage) = ([0.0; LANES], [0.0; LANES]);
    let mut gradient = [[0.0; LANES]; PARAMETERS];
    for (instant, share) in &look.sweep.instants {
        let moved = look.sweep.streak_px * *instant;
        let rx: Lane = std::array::from_fn(|l| block.x[l] - p[0] - moved.x * scale);
        let ry: Lane = std::array::from_fn(|l| block.y[l] - p[1] - moved.y * scale);
        let distance: Lane = std::array::from_fn(|l| (rx[l] * rx[l] + ry[l] * ry[l]).sqrt());
        let inside: Lane = std::array::from_fn(|l| look.edge_radius_px - distance[l]);
        if inside.iter().all(|i| *i <= -look.edge.reach_px) {
            continue;
        }
        let rim = rims(look.edge, &inside);
        for l in 0..LANES {
            let inverse = 1.0 / distance[l].max(1e-9);
            // In the very middle there is no direction, and the shift is nothing.
            let middle = distance[l] <= 1e-9;
            let (nx, ny) = (rx[l] * inverse, ry[l] * inverse);
            let followed = (distance[l] - rim.shift_px[l]).max(0.0) * inverse;
            let tangential = if middle { 1.0 } else { followed };
            let (u, v) = (rx[l] * tangential * per_radius, ry[l] * tangential * per_radius);
            let shine = shine(u, v, &light, look);
            let s = level * shine.value;
            let (s_u, s_v) = (level * shine.by_u * per_radius, level * shine.by_v * per_radius);
            let (d, slope) = (share * rim.coverage[l], share * rim.slope[l]);
            let lift = s - block.background[l];
            excess[l] += d * lift;
            coverage[l] += d;
            // The place seen follows the pixel fully along the rim, partly across it.
            let outward = s_u * nx + s_v * ny;
            let across = outward * (rim.follow[l] - tangential);
            let by_x = lift * slope * nx - d * (s_u * tangential + across * nx);
            let by_y = lift * slope * ny - d * (s_v * tangential + across * ny);
            gradient[0][l] += by_x;
            gradient[1][l] += by_y;
            gradient[LEVEL][l] += d * shine.value;
            if !ALL {
                continue;
            }
            gradient[RADIUS][l] += lift * slope * look.edge_by_radius
                + d * (outward * (1.0 - rim.follow[l]) * look.edge_by_radius
                    - (s_u * u + s_v * v)
                    - level * shine.by_softness * look.softness * per_radius);
            gradient[STREAK_SCALE][l] += by_x * moved.x + by_y * moved.y;
            let dl = d * level;
            for (i, by_term) in shine.by_term.iter().enumerate() {
                gradient[LIGHT + i][l] += dl * by_term;
            }
        }
    }
    Seen {
        value: std::array::from_fn(|l| block.background[l] + excess[l]),
        coverage,
        gradient,
    }
}

/// The light at one point of the ball relative to its level.
struct Shine {
    value: f64,
    by_u: f64,
    by_v: f64,
    by_softness: f64,
    by_term: [f64; TERMS],
}

/// The blur, σ/r wide in radii, rounds the line between lit and unlit: max(0, f) becomes the mean of max(0, f + ξ) with
/// ξ ~ N(0, σ/r·|(l_x, l_y)|).
#[inline(always)]
fn shine(u: f64, v: f64, light: &[f64; TERMS], look: &Look<'_>) -> Shine {
    let [b, c, d, e, f, lx, ly, lz] = *light;
    let depth = (1.0 - u * u - v * v).max(RIM_DEPTH_MIN * RIM_DEPTH_MIN).sqrt();
    let facing = lx * u + ly * v + lz * depth;
    let (lit, density) = lit_and_density(facing * look.per_light_width);
    let by_slope = density * look.softness_over_slope;
    let towards = lz / depth;
    Shine {
        value: 1.0
            + b * u
            + c * v
            + d * u * u
            + e * u * v
            + f * v * v
            + lit * facing
            + look.light_width * density,
        by_u: b + 2.0 * d * u + e * v + lit * (lx - towards * u),
        by_v: c + e * u + 2.0 * f * v + lit * (ly - towards * v),
        by_softness: density * look.light_slope,
        by_term: [
            u,
            v,
            u * u,
            u * v,
            v * v,
            lit * u + by_slope * lx,
            lit * v + by_slope * ly,
            lit * depth,
        ],
    }
}

/// Φ(z) (to 1e-7, Abramowitz and Stegun 7.1.26) and φ(z); beyond the edge's reach 0 or 1, and 0.
#[inline(always)]
fn lit_and_density(z: f64) -> (f64, f64) {
    let size = z.abs();
    let within = size <= EDGE_REACH_SIGMAS;
    let near = size.min(EDGE_REACH_SIGMAS);
    let bell = exp_small(-0.5 * near * near);
    let x = near * std::f64::consts::FRAC_1_SQRT_2;
    let t = 1.0 / (1.0 + 0.327_591_1 * x);
    let series = t
        * (0.254_829_592
            + t * (-0.284_496_736 + t * (1.421_413_741 + t * (-1.453_152_027 + t * 1.061_405_429))));
    let tail = if within { 0.5 * series * bell } else { 0.0 };
    let lit = if z >= 0.0 { 1.0 - tail } else { tail };
    // 1/√(2π)
    let density = if within {
        bell * 0.398_942_280_401_432_7
    } else {
        0.0
    };
    (lit, density)
}

/// eˣ for −700 < x < 700 without a call: x = n·ln 2 + r, a series for eʳ, and n as the exponent's bits.
#[inline(always)]
fn exp_small(x: f64) -> f64 {
    /// Added to a small number its integer part stands in the last bits.
    const ROUND: f64 = 6_755_399_441_055_744.0;
    const LN2_HIGH: f64 = 0.693_147_180_369_123_8;
    const LN2_LOW: f64 = 1.908_214_929_270_587_7e-10;
    let shifted = x * std::f64::consts::LOG2_E + ROUND;
    let n = shifted - ROUND;
    let r = x - n * LN2_HIGH - n * LN2_LOW;
    let series = [
        1.0 / 479_001_600.0,
        1.0 / 39_916_800.0,
        1.0 / 3_628_800.0,
        1.0 / 362_880.0,
        1.0 / 40_320.0,
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
    sum * f64::from_bits(shifted.to_bits().wrapping_add(1023) << 52)
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
    let seen = see::<true>(
        &pixels.blocks[0],
        &Look::new(parameters, (sweep, edge), (0.0, 2.5)),
    );
    (seen.coverage[0] > 0.0).then(|| {
        let gradient = Parameters::from_fn(|i, _| seen.gradient[i][0]);
        (seen.value[0], gradient)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_exponential_is_that_of_the_library() {
        for k in 0..=4000 {
            let x = -20.0 + 0.01 * f64::from(k);
            let (ours, theirs) = (exp_small(x), x.exp());
            assert!((ours - theirs).abs() < 1e-14 * theirs, "{x}: {ours} {theirs}");
        }
    }

    #[test]
    fn pixels_that_fill_up_a_block_weigh_nothing() {
        let mut p = Parameters::zeros();
        for (i, value) in [
            (0, 5.0),
            (1, 5.0),
            (LEVEL, 120.0),
            (RADIUS, 3.0),
            (STREAK_SCALE, 1.0),
        ] {
            p[i] = value;
        }
        let (sweep, edge) = (Sweep::new(Vector2::new(2.0, 1.0), 0.5), Edge::new(0.5));
        let observations: Vec<Observation> = (0..11)
            .map(|k| Observation {
                at: Vector2::new(f64::from(k), 5.0),
                value: 100.0,
                background: 60.0,
                variance: 4.0,
            })
            .collect();
        let look = Look::new(&p, (&sweep, &edge), (1.0, 2.5));
        let together = linearise(&PixelLanes::new(&observations), &look);
        let (mut gradient, mut cost, mut used) = (Parameters::zeros(), 0.0, 0.0);
        for o in &observations {
            let alone = linearise(&PixelLanes::new(&[*o]), &look);
            gradient += alone.gradient;
            cost += alone.cost;
            used += alone.used;
        }
        let own = locate(&PixelLanes::new(&observations), &look);
        assert_eq!(
            (own.cost, own.squares, own.used),
            (together.cost, together.squares, together.used)
        );
        assert_eq!(
            own.gradient.fixed_rows::<OWN>(0),
            together.gradient.fixed_rows::<OWN>(0)
        );
        assert_eq!(
            own.information.fixed_view::<OWN, OWN>(0, 0),
            together.information.fixed_view::<OWN, OWN>(0, 0)
        );
        assert!((together.gradient - gradient).norm() < 1e-9 * gradient.norm());
        assert!((together.cost - cost).abs() < 1e-9 * cost && together.used == used && used > 5.0);
    }
}
