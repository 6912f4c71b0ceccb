//! The quick look at a blob: centroid, size and streak from the moments of its change.
//!
//! The centroid follows the light, not the ball: it is off by up to a quarter of the radius on a ball lit from
//! one side, and its covariance says so. [`super::refine`] removes that once the ball is tracked.

use nalgebra::{Matrix2, Vector2};

use super::blobs::Images;
use super::kernel::{WEIGHT_STEPS, WINDOW_MAX_PX, WindowSums};

/// Centroid may be off the geometric centre by this share of the radius (measured 0.25–0.75 px at 3 px).
const LIGHT_OFFSET_OF_RADIUS: f64 = 0.15;
/// Variance that pixel area and optics add to each axis, px².
const BLUR_VARIANCE_PX2: f64 = 0.3;

/// Change below this many σ has no weight.
const FLOOR_SIGMAS: f64 = 1.5;

/// Moments of one blob.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moments {
    /// Centroid of the change, pixels.
    pub centre_px: Vector2<f64>,
    /// Radius of the disc, pixels.
    pub radius_px: f64,
    /// Blur streak along its axis (sign arbitrary), pixels.
    pub streak_px: Vector2<f64>,
    /// Covariance of the centroid as a measure of the ball's centre, px².
    pub covariance_px2: Matrix2<f64>,
    /// Change summed over its noise: larger is surer.
    pub strength: f64,
}

/// Most steps of a window towards the change it contains.
const SHIFTS_MAX: usize = 2;

/// Weighted sums of |change| over some pixels. A ball lit from one side may be brighter than the background on that side and
/// darker on the other: both count.
pub struct Sums {
    sum: f64,
    first: Vector2<f64>,
    second: Matrix2<f64>,
    count: f64,
}

impl Sums {
    /// Of what was read with so many steps of weight per level.
    pub fn of(read: &WindowSums, steps: u32) -> Self {
        let real = |sum: u64| sum as f64 / f64::from(steps);
        let [x, y] = read.first.map(real);
        let [xx, xy, yy] = read.second.map(real);
        Self {
            sum: real(read.sum),
            first: Vector2::new(x, y),
            second: Matrix2::new(xx, xy, xy, yy),
            count: read.count as f64,
        }
    }

    /// Moments with offsets from `origin`; `None` where nothing changed.
    pub fn moments(&self, origin: Vector2<f64>, difference_sigma: f64) -> Option<Moments> {
        if self.sum <= 0.0 {
            return None;
        }
        let mean = self.first / self.sum;
        let spread = self.second / self.sum - mean * mean.transpose();
        // Eigenvalues and the long axis of a symmetric 2×2 matrix.
        let (half, mixed) = (0.5 * (spread.m11 - spread.m22), spread.m12);
        let (middle, apart) = (0.5 * (spread.m11 + spread.m22), half.hypot(mixed));
        let (long, wide) = (middle + apart, middle - apart);
        let axis = if half >= 0.0 {
            Vector2::new(half + apart, mixed)
        } else {
            Vector2::new(mixed, apart - half)
        };
        let along = axis.try_normalize(1e-12).unwrap_or_else(Vector2::x);
        let across_variance = (wide - BLUR_VARIANCE_PX2).max(0.15);
        let excess = (long - wide).max(0.0);
        let radius_px = 2.0 * across_variance.sqrt();
        let sigma = (LIGHT_OFFSET_OF_RADIUS * radius_px).max(0.2);
        let along_sigma = sigma.hypot(0.1 * (12.0 * excess).sqrt());
        let across = Vector2::new(-along.y, along.x);
        Some(Moments {
            centre_px: origin + mean,
            radius_px,
            streak_px: along * (12.0 * excess).sqrt(),
            covariance_px2: along * along.transpose() * along_sigma.powi(2)
                + across * across.transpose() * sigma.powi(2),
            strength: self.sum / (difference_sigma.max(0.5) * self.count.sqrt()),
        })
    }
}

/// The rows of a window, each as first column and length counted from the window's first column.
type Rows = [(usize, usize); WINDOW_MAX_PX];

/// Sums over the rows of a window whose first pixel is (left, top), with offsets from that pixel.
fn read_window(
    images: &Images<'_>,
    (left, top): (usize, usize),
    rows: &[(usize, usize)],
    floor: f64,
) -> Sums {
    let floor = (f64::from(WEIGHT_STEPS) * floor).round() as u32;
    let place = (top * images.width_px + left, images.width_px);
    let read = images.kernels.window_sums(images.levels(), place, rows, floor);
    Sums::of(&read, WEIGHT_STEPS)
}

/// Moments within a round window that moves to the change it contains.
pub fn window_moments(
    images: &Images<'_>,
    start_px: Vector2<f64>,
    window_px: f64,
    difference_sigma: f64,
) -> Option<Moments> {
    let window_px = window_px.min(0.5 * WINDOW_MAX_PX as f64 - 1.0);
    let mut centre = start_px;
    let mut found = None;
    for _ in 0..SHIFTS_MAX {
        let (columns, lines) = images.around(centre.x, centre.y, window_px);
        let mut rows: Rows = [(0, 0); WINDOW_MAX_PX];
        let height = lines.len().min(WINDOW_MAX_PX);
        for (row, y) in rows.iter_mut().zip(lines.clone()) {
            let off = y as f64 - centre.y;
            let half = (window_px * window_px - off * off).max(0.0).sqrt();
            let (chord, _) = images.around(centre.x, y as f64, half);
            *row = (chord.start.saturating_sub(columns.start), chord.len());
        }
        let corner = (columns.start, lines.start);
        let floor = FLOOR_SIGMAS * difference_sigma;
        let sums = read_window(images, corner, rows.get(..height)?, floor);
        let origin = Vector2::new(corner.0 as f64, corner.1 as f64);
        let moments = sums.moments(origin, difference_sigma)?;
        let moved = (moments.centre_px - centre).norm();
        centre = moments.centre_px;
        found = Some(moments);
        if moved < 0.2 {
            break;
        }
    }
    found
}

/// Largest reach of a search, pixels.
const REACH_MAX_PX: f64 = 16.0;
/// Columns of the strip that a search reads: 2·reach + 1 places and one more on each side.
const STRIP_PX: usize = 36;

/// Where the change over 3×3 pixels is largest near a place, with that mean change.
pub fn strongest_near(
    images: &Images<'_>,
    x_px: f64,
    y_px: f64,
    reach_px: f64,
) -> Option<(Vector2<f64>, f64)> {
    let reach_px = reach_px.min(REACH_MAX_PX);
    let (columns, _) = images.around(x_px, y_px, reach_px + 1.0);
    let (inner, lines) = images.around(x_px, y_px, reach_px);
    let width = columns.len().min(STRIP_PX);
    let mut best: Option<(Vector2<f64>, u32)> = None;
    let mut strips = [[0u16; STRIP_PX]; 3];
    let first = lines.start.saturating_sub(1);
    // A pixel's three columns in a row, then three such rows; beyond the image nothing changes.
    for y in first..=lines.end {
        let mut sizes = [0u8; STRIP_PX + 2];
        let begin = y * images.width_px + columns.start;
        let levels = [images.current, images.one, images.other].map(|all| all.get(begin..begin + width));
        if let ([Some(c), Some(a), Some(b)], Some(sizes)) = (levels, sizes.get_mut(1..=width)) {
            images.kernels.change_row(c, a, b, sizes);
        }
        strips.rotate_left(1);
        let [_, _, newest] = &mut strips;
        for (sum, three) in newest.iter_mut().zip(sizes.windows(3)) {
            *sum = three.iter().map(|size| u16::from(*size)).sum();
        }
        let Some(middle) = y.checked_sub(1).filter(|middle| lines.contains(middle)) else {
            continue;
        };
        for x in inner.clone() {
            let at = x - columns.start;
            let sum: u32 = strips
                .iter()
                .map(|row| u32::from(row.get(at).copied().unwrap_or(0)))
                .sum();
            if best.is_none_or(|(_, most)| sum >= most) {
                best = Some((Vector2::new(x as f64, middle as f64), sum));
            }
        }
    }
    best.map(|(place, sum)| (place, f64::from(sum) / 9.0))
}
