//! Soft solids: tapered limbs in the world, drawn as lit capsules in the picture.

use nalgebra::Point3;

use super::canvas::Canvas;
use crate::geometry::{Intrinsics, Pose};

/// A tapered capsule in the world.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limb {
    /// One end, metres.
    pub a: Point3<f64>,
    /// The other.
    pub b: Point3<f64>,
    /// Radius at a and b, metres.
    pub radius_m: [f64; 2],
    /// Grey level in full light.
    pub tone: f32,
}

/// A limb in the picture.
#[derive(Debug, Clone, Copy)]
pub(super) struct Shape {
    a: [f64; 2],
    along: [f64; 2],
    length2: f64,
    radius: [f64; 2],
    tone: f32,
    /// Distance from the camera, metres.
    pub depth_m: f64,
}

/// Width of the soft edge, pixels: about that of a lens blur of 0.5 px.
const EDGE_PX: f64 = 1.3;

impl Shape {
    /// Projects a limb; `None` behind the camera. `light` is the share of the sun on it.
    pub(super) fn of(limb: &Limb, pose: &Pose, lens: &Intrinsics, light: f32) -> Option<Self> {
        let (a, b) = (pose.transform(&limb.a), pose.transform(&limb.b));
        let (pa, pb) = (lens.project(&a).ok()?, lens.project(&b).ok()?);
        let focal = 0.5 * (lens.fx_px + lens.fy_px);
        let along = [pb.x - pa.x, pb.y - pa.y];
        Some(Self {
            a: [pa.x, pa.y],
            along,
            length2: along[0] * along[0] + along[1] * along[1],
            radius: [limb.radius_m[0] * focal / a.z, limb.radius_m[1] * focal / b.z],
            tone: limb.tone * light,
            depth_m: 0.5 * (a.norm() + b.norm()),
        })
    }

    /// Coverage and grey level at a pixel: brighter where the surface faces up, with folds along the limb.
    pub(super) fn at(&self, x: f64, y: f64) -> (f32, f32) {
        let (dx, dy) = (x - self.a[0], y - self.a[1]);
        let s = if self.length2 > 1e-9 {
            ((dx * self.along[0] + dy * self.along[1]) / self.length2).clamp(0.0, 1.0)
        } else {
            0.0
        };
        let (ox, oy) = (dx - s * self.along[0], dy - s * self.along[1]);
        let radius = self.radius[0] + s * (self.radius[1] - self.radius[0]);
        let coverage = ((radius - ox.hypot(oy)) / EDGE_PX + 0.5).clamp(0.0, 1.0) as f32;
        if coverage <= 0.0 {
            return (0.0, 0.0);
        }
        let up = (-oy / radius.max(0.3)) as f32;
        let fold = (13.0 * s + 2.5 * ox / radius.max(0.3)).sin() as f32;
        (coverage, self.tone * (0.80 + 0.20 * up + 0.035 * fold))
    }

    /// Lays the shape over the picture.
    pub(super) fn draw(&self, canvas: &mut Canvas) {
        let reach = self.radius[0].max(self.radius[1]) + EDGE_PX;
        let (b0, b1) = (self.a[0] + self.along[0], self.a[1] + self.along[1]);
        let bounds = (
            (self.a[0].min(b0) - reach, self.a[1].min(b1) - reach),
            (self.a[0].max(b0) + reach, self.a[1].max(b1) + reach),
        );
        let Some(region) = canvas.region(bounds.0.0, bounds.0.1, bounds.1.0, bounds.1.1) else {
            return;
        };
        for y in region.top..region.bottom {
            for (x, tone) in (region.left..).zip(canvas.row(&region, y)) {
                let (coverage, shade) = self.at(x as f64, y as f64);
                *tone += coverage * (shade - *tone);
            }
        }
    }
}
