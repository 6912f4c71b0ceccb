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

/// Moments of the blob's change within its box grown by one pixel.
pub fn moments(images: &Images<'_>, blob: &Blob) -> Option<Moments> {
    let floor = 1.5 * f64::from(blob.difference_sigma);
    let sign = if blob.change_sum >= 0 { 1.0 } else { -1.0 };
    let (mut sum, mut first, mut second, mut noise) = (0.0, Vector2::zeros(), Matrix2::zeros(), 0.0);
    let origin = Vector2::new(blob.left as f64, blob.top as f64);
    for y in blob.top.saturating_sub(1)..=(blob.bottom + 1).min(images.height_px.saturating_sub(1)) {
        for x in blob.left.saturating_sub(1)..=(blob.right + 1).min(images.width_px.saturating_sub(1)) {
            let weight = sign * f64::from(images.change(x, y)) - floor;
            if weight <= 0.0 {
                continue;
            }
            let at = Vector2::new(x as f64, y as f64) - origin;
            sum += weight;
            first += weight * at;
            second += weight * at * at.transpose();
            noise += 1.0;
        }
    }
    if sum <= 0.0 {
        return None;
    }
    let mean = first / sum;
    let spread = second / sum - mean * mean.transpose();
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
        strength: sum / (f64::from(blob.difference_sigma.max(0.5)) * f64::sqrt(noise)),
    })
}
