//! The sensor: flicker, shot and read noise, rounding to eight bits. The only pass over the whole frame.

use rand::{Rng, RngCore};
use rand_distr::{Distribution, StandardNormal};

use crate::simulation::clock::{Purpose, stream};

/// Entries of the table of normal numbers; the sum of two stretches at random places, with random signs, makes
/// the noise of a row (tails to 6 sigma, no repeat between rows or frames).
const TABLE: usize = 1 << 16;

/// Turns grey levels into bytes.
pub(super) struct Sensor {
    table: Vec<f32>,
    read_variance: f32,
    dn_per_electron: f32,
}

impl Sensor {
    pub(super) fn new(seed: u64, width: usize, read_noise_dn: f32, electrons_per_dn: f32) -> Self {
        let mut rng = stream(seed, Purpose::PixelNoise, 0, 0);
        let scale = std::f32::consts::FRAC_1_SQRT_2;
        let normal = |_| {
            let value: f32 = StandardNormal.sample(&mut rng);
            value * scale
        };
        Self {
            table: (0..TABLE + width).map(normal).collect(),
            read_variance: read_noise_dn * read_noise_dn,
            dn_per_electron: 1.0 / electrons_per_dn.max(1e-3),
        }
    }

    /// One frame: `gains` is the light of every column. Noise variance is read² + level/(electrons per level).
    pub(super) fn expose(&self, tones: &[f32], gains: &[f32], rng: &mut impl RngCore, out: &mut [u8]) {
        let width = gains.len().max(1);
        for (row, bytes) in tones.chunks_exact(width).zip(out.chunks_exact_mut(width)) {
            let (a, b) = (rng.random_range(0..TABLE), rng.random_range(0..TABLE));
            let signs = rng.next_u32();
            let (Some(first), Some(second)) = (self.table.get(a..a + width), self.table.get(b..b + width))
            else {
                continue;
            };
            let sign = |bit: u32| if signs & bit == 0 { 1.0 } else { -1.0 };
            let row = Row {
                tones: row,
                gains,
                noise: [first, second],
                signs: [sign(1), sign(2)],
            };
            self.expose_row(&row, bytes);
        }
    }

    fn expose_row(&self, row: &Row<'_>, bytes: &mut [u8]) {
        let width = bytes.len();
        let (tones, gains) = (&row.tones[..width], &row.gains[..width]);
        let (first, second) = (&row.noise[0][..width], &row.noise[1][..width]);
        let [sign_a, sign_b] = row.signs;
        for i in 0..width {
            let level = tones[i] * gains[i];
            let sigma = (self.read_variance + level * self.dn_per_electron).sqrt();
            let noisy = level + sigma * (sign_a * first[i] + sign_b * second[i]);
            // Adding 1.5·2²³ leaves the rounded integer in the low bits; plain casts do not vectorise.
            bytes[i] = (noisy.clamp(0.0, 255.0) + 12_582_912.0).to_bits() as u8;
        }
    }
}

struct Row<'a> {
    tones: &'a [f32],
    gains: &'a [f32],
    noise: [&'a [f32]; 2],
    signs: [f32; 2],
}
