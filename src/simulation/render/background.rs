//! The still picture of one camera: rays through every pixel onto ground, walls and sky. Made once.

use nalgebra::{Point3, Vector3};

use super::ground::Ground;
use super::stands;
use crate::geometry::{Intrinsics, Normalized, Pixel, Pose};

/// A still picture in grey levels, before flicker and noise.
pub(super) struct Background {
    /// Row by row.
    pub tones: Vec<f32>,
    /// Pixels that show the crowd, thinned: places for things that twinkle.
    pub crowd: Vec<(u32, u32)>,
}

/// What the picture is taken with and of.
pub(super) struct View<'a> {
    pub pose: Pose,
    pub lens: Intrinsics,
    pub width_px: u32,
    pub height_px: u32,
    pub ground: &'a Ground,
    pub board_dn: f32,
    pub blur_sigma_px: f64,
}

/// Directions are computed on a grid of this step and interpolated: the lens is smooth (error < 1e-3 px).
const GRID_PX: u32 = 16;
/// Places of the samples within a pixel (rotated grid).
const SAMPLES: [(f64, f64); 4] = [(-0.125, -0.375), (0.375, -0.125), (-0.375, 0.125), (0.125, 0.375)];

impl View<'_> {
    pub(super) fn paint(&self) -> Background {
        let (width, height) = (self.width_px as usize, self.height_px as usize);
        let grid = DirectionGrid::new(&self.lens, self.width_px, self.height_px);
        let from = self.pose.centre_m();
        let turn = self.pose.rotation.inverse();
        let mut tones = vec![0.0f32; width * height];
        let mut crowd = Vec::new();
        for (y, row) in tones.chunks_exact_mut(width).enumerate() {
            for (x, tone) in row.iter_mut().enumerate() {
                let mut sum = 0.0;
                let mut seats = 0;
                for (dx, dy) in SAMPLES {
                    let n = grid.at(x as f64 + dx, y as f64 + dy);
                    let along = turn * Vector3::new(n.x, n.y, 1.0);
                    let (sample, in_crowd) = self.sample(&from, &along);
                    sum += sample;
                    seats += usize::from(in_crowd);
                }
                *tone = sum / SAMPLES.len() as f32;
                if seats == SAMPLES.len() && x % 7 == 3 && y % 7 == 3 {
                    crowd.push((x as u32, y as u32));
                }
            }
        }
        blur(&mut tones, width, self.blur_sigma_px);
        Background { tones, crowd }
    }

    /// Grey level along one ray, and whether it ends among the seats. `along` has unit depth.
    fn sample(&self, from: &Point3<f64>, along: &Vector3<f64>) -> (f32, bool) {
        let wall = stands::hit(from, along);
        match self.ground.hit(from, along) {
            Some(t) if t < wall.distance_m => {
                let p = from + along * t;
                // A pixel on the ground is as long as the view is flat; its geometric mean blurs texture.
                let across = t / self.lens.fx_px;
                let slant = (-along.z / along.norm()).clamp(0.02, 1.0);
                let tone = self.ground.tone(&p, across / slant.sqrt());
                (tone * self.ground.light(&p), false)
            }
            _ => {
                let pixel_m = wall.distance_m / self.lens.fx_px;
                (stands::tone(&wall, pixel_m, self.board_dn), wall.in_crowd())
            }
        }
    }
}

/// Viewing directions over the picture.
struct DirectionGrid {
    columns: usize,
    rows: usize,
    directions: Vec<Normalized>,
}

impl DirectionGrid {
    fn new(lens: &Intrinsics, width_px: u32, height_px: u32) -> Self {
        let columns = (width_px / GRID_PX + 3) as usize;
        let rows = (height_px / GRID_PX + 3) as usize;
        let step = f64::from(GRID_PX);
        let mut directions = Vec::with_capacity(columns * rows);
        for j in 0..rows {
            for i in 0..columns {
                let pixel = Pixel::new((i as f64 - 1.0) * step, (j as f64 - 1.0) * step);
                let plain = Normalized {
                    x: (pixel.x - lens.cx_px) / lens.fx_px,
                    y: (pixel.y - lens.cy_px) / lens.fy_px,
                };
                directions.push(lens.direction(pixel).unwrap_or(plain));
            }
        }
        Self {
            columns,
            rows,
            directions,
        }
    }

    fn at(&self, x: f64, y: f64) -> Normalized {
        let step = f64::from(GRID_PX);
        let (u, v) = (x / step + 1.0, y / step + 1.0);
        let i = (u.floor().max(0.0) as usize).min(self.columns - 2);
        let j = (v.floor().max(0.0) as usize).min(self.rows - 2);
        let (s, t) = (u - i as f64, v - j as f64);
        let corner = |di: usize, dj: usize| self.directions[(j + dj) * self.columns + i + di];
        let (a, b, c, d) = (corner(0, 0), corner(1, 0), corner(0, 1), corner(1, 1));
        let mix = |a: f64, b: f64, c: f64, d: f64| {
            (a * (1.0 - s) + b * s) * (1.0 - t) + (c * (1.0 - s) + d * s) * t
        };
        Normalized {
            x: mix(a.x, b.x, c.x, d.x),
            y: mix(a.y, b.y, c.y, d.y),
        }
    }
}

/// Half of a normalised Gaussian kernel: centre first.
pub(super) fn gaussian_half_kernel(sigma: f64) -> Vec<f32> {
    if sigma <= 0.0 {
        return vec![1.0];
    }
    let reach = (3.5 * sigma).ceil() as i32;
    let weight = |i: i32| (-0.5 * (f64::from(i) / sigma).powi(2)).exp();
    let total: f64 = (-reach..=reach).map(weight).sum();
    (0..=reach).map(|i| (weight(i) / total) as f32).collect()
}

/// Separable Gaussian blur in place; edges repeat.
pub(super) fn blur(tones: &mut [f32], width: usize, sigma: f64) {
    let kernel = gaussian_half_kernel(sigma);
    if kernel.len() < 2 || width == 0 {
        return;
    }
    let height = tones.len() / width;
    let mut line = vec![0.0f32; width];
    for row in tones.chunks_exact_mut(width) {
        line.copy_from_slice(row);
        for (x, out) in row.iter_mut().enumerate() {
            *out = filtered(&kernel, x, width, |i| line[i]);
        }
    }
    let source = tones.to_vec();
    for y in 0..height {
        for x in 0..width {
            tones[y * width + x] = filtered(&kernel, y, height, |j| source[j * width + x]);
        }
    }
}

fn filtered(kernel: &[f32], at: usize, length: usize, value: impl Fn(usize) -> f32) -> f32 {
    let mut sum = kernel[0] * value(at);
    for (d, weight) in kernel.iter().enumerate().skip(1) {
        sum += weight * (value(at.saturating_sub(d)) + value((at + d).min(length - 1)));
    }
    sum
}
