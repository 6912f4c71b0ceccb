//! Test images: a lit ball with motion blur by brute-force sampling, movers, noise. Shares nothing with the fit.

use std::sync::Arc;

use rand::{Rng, SeedableRng};
use rand_distr::{Distribution, Normal};
use rand_pcg::Pcg64Mcg;

use crate::scene::{Frame, FrameStamp};
use crate::time::StampedMidpoint;

/// A ball to paint.
#[derive(Debug, Clone, Copy)]
pub struct Ball {
    /// Geometric centre at the exposure midpoint, pixels.
    pub centre: [f64; 2],
    /// Movement over the exposure, pixels.
    pub streak: [f64; 2],
    /// Radius, pixels.
    pub radius: f64,
    /// Level in full light.
    pub light: f64,
    /// Level in shade.
    pub shade: f64,
    /// Direction to the light in camera axes (x right, y down, z forward).
    pub to_light: [f64; 3],
}

/// A canvas of real-valued light.
#[derive(Clone)]
pub struct Canvas {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Light, levels.
    pub light: Vec<f32>,
}

impl Canvas {
    /// A textured stand: smooth shading plus blocks of random brightness.
    pub fn stand(width: usize, height: usize, seed: u64, roughness: f32) -> Self {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let mut light = vec![0f32; width * height];
        for (i, value) in light.iter_mut().enumerate() {
            let (x, y) = (i % width, i / width);
            *value = 70.0 + 30.0 * (x as f32 / 97.0).sin() + 20.0 * (y as f32 / 53.0).cos();
        }
        for _ in 0..(width * height / 300) {
            let (x, y) = (random.random_range(0..width), random.random_range(0..height));
            let (w, h) = (random.random_range(2..14), random.random_range(2..14));
            let change = random.random_range(-roughness..=roughness);
            for yy in y..(y + h).min(height) {
                for xx in x..(x + w).min(width) {
                    light[yy * width + xx] = (light[yy * width + xx] + change).clamp(10.0, 230.0);
                }
            }
        }
        Self { width, height, light }
    }

    /// Copies `patch` onto this canvas with its corner at a sub-pixel place (bilinear).
    pub fn paste(&mut self, patch: &Canvas, left: f64, top: f64) {
        for y in 0..patch.height - 1 {
            for x in 0..patch.width - 1 {
                let (px, py) = (left + x as f64, top + y as f64);
                let (cx, cy) = (px.ceil(), py.ceil());
                if cx < 0.0 || cy < 0.0 || cx >= self.width as f64 || cy >= self.height as f64 {
                    continue;
                }
                let (fx, fy) = ((cx - px) as f32, (cy - py) as f32);
                let at = |dx: usize, dy: usize| patch.light[(y + dy) * patch.width + x + dx];
                let top_light = at(0, 0) * (1.0 - fx) + at(1, 0) * fx;
                let bottom_light = at(0, 1) * (1.0 - fx) + at(1, 1) * fx;
                self.light[cy as usize * self.width + cx as usize] =
                    top_light * (1.0 - fy) + bottom_light * fy;
            }
        }
    }

    /// Paints a lit sphere swept over the exposure: 5×5 points a pixel, 15 instants.
    pub fn ball(&mut self, ball: &Ball) {
        let reach = ball.radius + 0.5 * ball.streak[0].hypot(ball.streak[1]) + 1.5;
        let norm = ball.to_light.iter().map(|l| l * l).sum::<f64>().sqrt();
        let to_light = ball.to_light.map(|l| l / norm);
        let range = |c: f64, n: usize| {
            ((c - reach).floor().max(0.0) as usize)..((c + reach).ceil().max(0.0) as usize + 1).min(n)
        };
        for y in range(ball.centre[1], self.height) {
            for x in range(ball.centre[0], self.width) {
                let (mut covered, mut sum) = (0.0, 0.0);
                for step in 0..15 {
                    let t = (f64::from(step) + 0.5) / 15.0 - 0.5;
                    let centre = [
                        ball.centre[0] + t * ball.streak[0],
                        ball.centre[1] + t * ball.streak[1],
                    ];
                    for i in 0..25 {
                        let dx = x as f64 + (f64::from(i % 5) - 2.0) / 5.0 - centre[0];
                        let dy = y as f64 + (f64::from(i / 5) - 2.0) / 5.0 - centre[1];
                        let (u, v) = (dx / ball.radius, dy / ball.radius);
                        let rest = 1.0 - u * u - v * v;
                        if rest < 0.0 {
                            continue;
                        }
                        let facing = u * to_light[0] + v * to_light[1] - rest.sqrt() * to_light[2];
                        covered += 1.0;
                        sum += ball.shade + (ball.light - ball.shade) * facing.max(0.0);
                    }
                }
                let samples = 15.0 * 25.0;
                let value = &mut self.light[y * self.width + x];
                *value = (f64::from(*value) * (1.0 - covered / samples) + sum / samples) as f32;
            }
        }
    }

    /// The same through optics that blur by a Gaussian of this σ, pixels.
    pub fn blurred(&self, sigma_px: f64) -> Self {
        let reach = (4.0 * sigma_px).ceil() as isize;
        let weights: Vec<f64> = (-reach..=reach)
            .map(|k| (-0.5 * (k as f64 / sigma_px).powi(2)).exp())
            .collect();
        let sum: f64 = weights.iter().sum();
        let (width, height) = (self.width as isize, self.height as isize);
        let along = |light: &[f32], (dx, dy): (isize, isize)| -> Vec<f32> {
            let level = |x: isize, y: isize| {
                let (x, y) = (x.clamp(0, width - 1), y.clamp(0, height - 1));
                f64::from(light[(y * width + x) as usize])
            };
            let blurred = |i: usize| {
                let (x, y) = (i as isize % width, i as isize / width);
                let all = (-reach..=reach).zip(&weights);
                (all.map(|(k, w)| w * level(x + k * dx, y + k * dy)).sum::<f64>() / sum) as f32
            };
            (0..light.len()).map(blurred).collect()
        };
        Self {
            light: along(&along(&self.light, (1, 0)), (0, 1)),
            ..self.clone()
        }
    }

    /// Adds noise and rounds.
    pub fn frame(&self, number: u64, rate_hz: f64, noise_sigma: f32) -> Frame {
        let mut random = Pcg64Mcg::seed_from_u64(number.wrapping_mul(0x9e37_79b9).wrapping_add(7));
        let noise = Normal::new(0.0f32, noise_sigma).unwrap();
        let pixels: Vec<u8> = self
            .light
            .iter()
            .map(|v| (v + noise.sample(&mut random)).round().clamp(0.0, 255.0) as u8)
            .collect();
        Frame {
            stamp: FrameStamp {
                frame: number,
                device: None,
                arrival: None,
                stamped: StampedMidpoint::from_seconds_since(1_000_000_000, number as f64 / rate_hz),
            },
            width_px: self.width as u32,
            height_px: self.height as u32,
            pixels: Arc::new(pixels),
        }
    }
}
