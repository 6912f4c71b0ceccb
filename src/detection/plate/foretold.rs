//! What a pose foretells of home plate's picture: how much of each fine sample is plate, and how much may be chalk.

use nalgebra::Vector3;

use super::HALF_PLATE_M;
use crate::geometry::{Intrinsics, Pixel, Pose};
use crate::scene::PixelRect;

/// Samples of the foretold picture to a pixel's side.
const FINE: usize = 6;
/// ... and places of four within each (rotated grid).
const SAMPLES: [(f64, f64); 4] = [(-0.125, -0.375), (0.375, -0.125), (-0.375, 0.125), (0.125, 0.375)];
/// Chalk is off by this much, metres.
const CHALK_OFF_M: f64 = 0.03;

/// How much of each fine sample is plate, and how much may be chalk, as the pose foretells it.
pub(super) struct Foretold {
    columns: usize,
    layers: [Vec<f32>; 2],
}

impl Foretold {
    pub(super) fn new(place: PixelRect, lens: &Intrinsics, pose: &Pose) -> Option<Self> {
        let (width, height) = (place.width_px as usize, place.height_px as usize);
        // Where the ground is seen at the pixels' corners; within a pixel it is straight enough.
        let from = pose.centre_m();
        let mut corners = Vec::with_capacity((width + 1) * (height + 1));
        let corner = |first: u32, index: usize| f64::from(first) - 0.5 + index as f64;
        for row in 0..=height {
            for column in 0..=width {
                let seen = lens.direction(Pixel::new(corner(place.x_px, column), corner(place.y_px, row)));
                let seen = seen.ok()?;
                let along = pose.rotation.inverse() * Vector3::new(seen.x, seen.y, 1.0);
                let far = -from.z / along.z;
                if !(far > 0.0) {
                    return None;
                }
                corners.push((from + along * far).xy().coords);
            }
        }
        let ground = |x: f64, y: f64| {
            let (column, row) = ((x as usize).min(width - 1), (y as usize).min(height - 1));
            let (s, t) = (x - column as f64, y - row as f64);
            let at = |dx: usize, dy: usize| corners.get((row + dy) * (width + 1) + column + dx).copied();
            let (a, b, c, d) = (at(0, 0)?, at(1, 0)?, at(0, 1)?, at(1, 1)?);
            Some((a * (1.0 - s) + b * s) * (1.0 - t) + (c * (1.0 - s) + d * s) * t)
        };
        let columns = FINE * width;
        let mut layers = [0, 1].map(|_| Vec::with_capacity(columns * FINE * height));
        let fine = |index: usize, within: f64| (index as f64 + 0.5 + within) / FINE as f64;
        for row in 0..FINE * height {
            for column in 0..columns {
                let mut sums = [0.0; 2];
                for (dx, dy) in SAMPLES {
                    let at = ground(fine(column, dx), fine(row, dy))?;
                    sums[0] += f32::from(u8::from(is_plate(at.x, at.y)));
                    sums[1] += f32::from(u8::from(is_chalk(at.x, at.y)));
                }
                for (layer, sum) in layers.iter_mut().zip(sums) {
                    layer.push(sum / SAMPLES.len() as f32);
                }
            }
        }
        Some(Self { columns, layers })
    }

    /// As a lens of this blur along x and y, and pixels of an area, see it: plate, and chalk.
    pub(super) fn blurred(&self, blur_px: [f64; 2]) -> [Fine; 2] {
        let kernels = blur_px.map(kernel);
        [0, 1].map(|layer| Fine {
            columns: self.columns,
            values: smooth(&self.layers[layer], self.columns, &kernels),
        })
    }
}

pub(super) fn is_plate(x: f64, y: f64) -> bool {
    let half = HALF_PLATE_M;
    x.abs() <= half && y <= 2.0 * half && y >= x.abs()
}

/// Where the lines of the batter's boxes may be: four inches wide within their outer edges.
fn is_chalk(x: f64, y: f64) -> bool {
    const INNER_M: f64 = 0.3683;
    const OUTER_M: f64 = 1.5875;
    const ENDS_M: [f64; 2] = [-0.6985, 1.1303];
    const LINE_M: f64 = 0.1016;
    let inside = (x.abs() - INNER_M)
        .min(OUTER_M - x.abs())
        .min(y - ENDS_M[0])
        .min(ENDS_M[1] - y);
    (-CHALK_OFF_M..=LINE_M + CHALK_OFF_M).contains(&inside)
}

/// A Gaussian over a pixel's width, in fine samples: the middle first.
fn kernel(blur_px: f64) -> Vec<f32> {
    let sigma = blur_px * FINE as f64;
    let reach = (3.5 * sigma).ceil() as usize + FINE;
    let weight = |at: usize| -> f64 {
        // The pixel's own width, sample by sample.
        let parts = (0..FINE).map(|part| at as f64 + part as f64 - 0.5 * (FINE as f64 - 1.0));
        parts.map(|off| (-0.5 * (off / sigma).powi(2)).exp()).sum()
    };
    let half: Vec<f64> = (0..=reach).map(weight).collect();
    let total = half.iter().sum::<f64>() * 2.0 - half.first().copied().unwrap_or(0.0);
    half.iter().map(|weight| (weight / total) as f32).collect()
}

/// Rows, then columns, each with a kernel that is alike on both sides; beyond the edge is what is at it.
fn smooth(values: &[f32], columns: usize, [along_x, along_y]: &[Vec<f32>; 2]) -> Vec<f32> {
    let columns = columns.max(1);
    let rows = values.len() / columns;
    let pass = |from: &[f32], kernel: &[f32], [count, step]: [usize; 2], [lines, stride]: [usize; 2]| {
        let mut to = vec![0.0; from.len()];
        for line in 0..lines {
            for at in 0..count {
                let value = |at: usize| from.get(line * stride + at * step).copied().unwrap_or(0.0);
                let mut sum = 0.0;
                for (off, weight) in kernel.iter().enumerate() {
                    let (before, after) = (at.saturating_sub(off), (at + off).min(count - 1));
                    let both = if off == 0 {
                        value(at)
                    } else {
                        value(before) + value(after)
                    };
                    sum += weight * both;
                }
                if let Some(slot) = to.get_mut(line * stride + at * step) {
                    *slot = sum;
                }
            }
        }
        to
    };
    let across = pass(values, along_x, [columns, 1], [rows, columns]);
    pass(&across, along_y, [rows, columns], [columns, 1])
}

/// A foretold layer, blurred, in fine samples.
pub(super) struct Fine {
    columns: usize,
    values: Vec<f32>,
}

impl Fine {
    /// At a place of the part, pixels from the centre of its first: value and slopes.
    pub(super) fn at(&self, x: f64, y: f64) -> [f64; 3] {
        let place = |at: f64| (at + 0.5) * FINE as f64 - 0.5;
        let (u, v) = (place(x), place(y));
        let (column, row) = (u.floor(), v.floor());
        let (s, t) = (u - column, v - row);
        let value = |dx: f64, dy: f64| {
            let rows = (self.values.len() / self.columns.max(1)) as f64;
            let column = (column + dx).clamp(0.0, self.columns as f64 - 1.0) as usize;
            let row = (row + dy).clamp(0.0, rows - 1.0) as usize;
            f64::from(
                self.values
                    .get(row * self.columns + column)
                    .copied()
                    .unwrap_or(0.0),
            )
        };
        let (a, b, c, d) = (value(0.0, 0.0), value(1.0, 0.0), value(0.0, 1.0), value(1.0, 1.0));
        let scale = FINE as f64;
        [
            (a * (1.0 - s) + b * s) * (1.0 - t) + (c * (1.0 - s) + d * s) * t,
            scale * ((b - a) * (1.0 - t) + (d - c) * t),
            scale * ((c - a) * (1.0 - s) + (d - b) * s),
        ]
    }

    /// Second derivatives along x and y there, by differences over half a pixel.
    pub(super) fn curves(&self, x: f64, y: f64) -> [f64; 2] {
        const STEP_PX: f64 = 0.5;
        let at = |dx: f64, dy: f64| self.at(x + dx, y + dy)[0];
        let twice = 2.0 * at(0.0, 0.0);
        [
            (at(-STEP_PX, 0.0) - twice + at(STEP_PX, 0.0)) / STEP_PX.powi(2),
            (at(0.0, -STEP_PX) - twice + at(0.0, STEP_PX)) / STEP_PX.powi(2),
        ]
    }
}
