//! The quick look at a blob: centroid, size and streak from the moments of its change.
//!
//! The centroid follows the light, not the ball: it is off by up to a quarter of the radius on a ball lit from
//! one side, and its covariance says so. [`super::refine`] removes that once the ball is tracked.

use nalgebra::{Matrix2, SymmetricEigen, Vector2};

use super::blobs::{Blob, Images};

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

/// Weighted sums of |change| over some pixels.
#[derive(Default)]
pub struct Sums {
    sum: f64,
    first: Vector2<f64>,
    second: Matrix2<f64>,
    count: f64,
}

impl Sums {
    /// Takes a pixel at an offset from the origin. A ball lit from one side may be brighter than the background
    /// on that side and darker on the other: both count.
    pub fn add(&mut self, offset: Vector2<f64>, change: i32, floor: f64) {
        let weight = f64::from(change.abs()) - floor;
        if weight > 0.0 {
            self.sum += weight;
            self.first += weight * offset;
            self.second += weight * offset * offset.transpose();
            self.count += 1.0;
        }
    }

    /// Sum of the weights, levels.
    pub fn total(&self) -> f64 {
        self.sum
    }

    /// Moments with offsets from `origin`; `None` where nothing changed.
    pub fn moments(&self, origin: Vector2<f64>, difference_sigma: f64) -> Option<Moments> {
        if self.sum <= 0.0 {
            return None;
        }
        let mean = self.first / self.sum;
        let spread = self.second / self.sum - mean * mean.transpose();
        let eigen = SymmetricEigen::new(spread);
        let (long, wide) = if eigen.eigenvalues[0] >= eigen.eigenvalues[1] {
            (0, 1)
        } else {
            (1, 0)
        };
        let along = eigen.eigenvectors.column(long).into_owned();
        let across_variance = (eigen.eigenvalues[wide] - BLUR_VARIANCE_PX2).max(0.15);
        let excess = (eigen.eigenvalues[long] - eigen.eigenvalues[wide]).max(0.0);
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

/// Moments of the blob's change within its box grown by one pixel.
pub fn moments(images: &Images<'_>, blob: &Blob) -> Option<Moments> {
    let sigma = f64::from(blob.difference_sigma);
    let origin = Vector2::new(blob.left as f64, blob.top as f64);
    let mut sums = Sums::default();
    for y in blob.top.saturating_sub(1)..=(blob.bottom + 1).min(images.height_px.saturating_sub(1)) {
        for x in blob.left.saturating_sub(1)..=(blob.right + 1).min(images.width_px.saturating_sub(1)) {
            let at = Vector2::new(x as f64, y as f64) - origin;
            sums.add(at, images.change(x, y), FLOOR_SIGMAS * sigma);
        }
    }
    sums.moments(origin, sigma)
}

/// Moments within a round window that moves to the change it contains.
pub fn window_moments(
    images: &Images<'_>,
    start_px: Vector2<f64>,
    window_px: f64,
    difference_sigma: f64,
) -> Option<Moments> {
    let mut centre = start_px;
    let mut found = None;
    for _ in 0..SHIFTS_MAX {
        let mut sums = Sums::default();
        for (x, y) in images.around(centre.x, centre.y, window_px) {
            let at = Vector2::new(x as f64, y as f64) - centre;
            if at.norm() <= window_px {
                sums.add(at, images.change(x, y), FLOOR_SIGMAS * difference_sigma);
            }
        }
        let moments = sums.moments(centre, difference_sigma)?;
        let moved = (moments.centre_px - centre).norm();
        centre = moments.centre_px;
        found = Some(moments);
        if moved < 0.2 {
            break;
        }
    }
    found
}

/// Where the change over 3×3 pixels is largest near a place, with that mean change.
pub fn strongest_near(
    images: &Images<'_>,
    x_px: f64,
    y_px: f64,
    reach_px: f64,
) -> Option<(Vector2<f64>, f64)> {
    images
        .around(x_px, y_px, reach_px)
        .map(|(x, y)| {
            let around = images.around(x as f64, y as f64, 1.0);
            let sum: i32 = around.map(|(x, y)| images.change(x, y).abs()).sum();
            (Vector2::new(x as f64, y as f64), f64::from(sum) / 9.0)
        })
        .max_by(|a, b| a.1.total_cmp(&b.1))
}
