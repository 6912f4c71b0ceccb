//! The ball: a lit sphere swept along its true path over the exposure, with the lens's blur.
//!
//! Coverage and light are integrated over time on a grid of sub-pixels, blurred there, then averaged over each
//! pixel's area: out = behind·(1 − coverage) + light.

use nalgebra::{Point3, Vector3};

use super::background::{blur, gaussian_half_kernel};
use super::canvas::Patch;
use crate::geometry::{Intrinsics, Pose};
use crate::scene::BALL_RADIUS_M;

/// Sub-pixels per pixel and axis.
const FINE: usize = 4;
/// Sub-pixels between two time samples, at most.
const TIME_STEP_PX: f64 = 0.2;
/// A ball that all but hits the camera is left out, and needs no more time samples than this: it would take minutes.
const STREAK_MAX_PX: f64 = 400.0;
const REACH_MAX_PX: f64 = 80.0;
const STEPS_MAX: usize = 200;
/// Light that reaches the unlit side.
const AMBIENT: f32 = 0.4;
/// Where the light comes from (world): above, a little from the first-base side and from behind home.
const SUN: [f64; 3] = [0.25, -0.2, 0.95];

/// How the ball is lit.
#[derive(Debug, Clone, Copy)]
pub(super) struct BallLight {
    /// Grey level of white in full light.
    pub white_dn: f32,
    /// 0: flat disc; 1: Lambert.
    pub shading: f32,
}

/// The sphere at one instant: centre and shape in the picture, light in its own axes.
struct Disc {
    x: f64,
    y: f64,
    /// Pixel offset to disc coordinates (unit circle), row by row.
    inverse: [f64; 4],
    /// Light along the disc's axes and towards the camera.
    sun: [f32; 3],
    reach_px: f64,
    radius_px: f64,
    light: f32,
}

fn disc(pose: &Pose, lens: &Intrinsics, at: &Point3<f64>, light: f32) -> Option<Disc> {
    let camera = pose.transform(at);
    let seen = lens.project_with_jacobian(&camera).ok()?;
    let toward = -camera.normalize();
    let right = toward.cross(&Vector3::y()).normalize();
    let other = toward.cross(&right);
    let (a, b) = (
        seen.by_camera_point * right * BALL_RADIUS_M,
        seen.by_camera_point * other * BALL_RADIUS_M,
    );
    let determinant = a.x * b.y - a.y * b.x;
    if determinant.abs() < 1e-6 {
        return None;
    }
    let sun = pose.rotation * Vector3::from(SUN).normalize();
    Some(Disc {
        x: seen.pixel.x,
        y: seen.pixel.y,
        inverse: [
            b.y / determinant,
            -b.x / determinant,
            -a.y / determinant,
            a.x / determinant,
        ],
        sun: [
            right.dot(&sun) as f32,
            other.dot(&sun) as f32,
            toward.dot(&sun) as f32,
        ],
        reach_px: a.norm().hypot(b.norm()),
        radius_px: determinant.abs().sqrt(),
        light,
    })
}

/// The ball over one exposure; `path` gives position and share of light at a time. `None` where it is not seen.
pub(super) fn ball_patch(
    view: (&Pose, &Intrinsics),
    exposure: (f64, f64),
    blur_sigma_px: f64,
    look: BallLight,
    path: impl Fn(f64) -> (Point3<f64>, f32),
) -> Option<Patch> {
    let (begin_s, end_s) = exposure;
    let at = |s: f64| {
        let (p, light) = path(begin_s + (end_s - begin_s) * s);
        disc(view.0, view.1, &p, light)
    };
    let (first, last) = (at(0.0)?, at(1.0)?);
    let streak_px = (last.x - first.x).hypot(last.y - first.y);
    if !(streak_px < STREAK_MAX_PX) || first.reach_px > REACH_MAX_PX {
        return None;
    }
    let steps = ((streak_px / TIME_STEP_PX).ceil() as usize).clamp(1, STEPS_MAX);
    let discs: Vec<Disc> = (0..steps)
        .map(|i| at((i as f64 + 0.5) / steps as f64))
        .collect::<Option<_>>()?;
    let margin = first.reach_px.max(last.reach_px) + 4.0 * blur_sigma_px + 1.0;
    let left = (first.x.min(last.x) - margin).floor();
    let top = (first.y.min(last.y) - margin).floor();
    let width = (first.x.max(last.x) + margin - left).ceil() as usize + 1;
    let height = (first.y.max(last.y) + margin - top).ceil() as usize + 1;
    let mut fine = FineGrid::new(left, top, width, height);
    let weight = 1.0 / steps as f32;
    for disc in &discs {
        fine.stamp(disc, weight, look);
    }
    let sigma = blur_sigma_px * FINE as f64;
    if gaussian_half_kernel(sigma).len() > 1 {
        blur(&mut fine.coverage, fine.width, sigma);
        blur(&mut fine.light, fine.width, sigma);
    }
    Some(fine.averaged())
}

/// Sub-pixels of the patch.
struct FineGrid {
    left: f64,
    top: f64,
    width: usize,
    coverage: Vec<f32>,
    light: Vec<f32>,
}

impl FineGrid {
    fn new(left: f64, top: f64, width_px: usize, height_px: usize) -> Self {
        let (width, height) = (width_px * FINE, height_px * FINE);
        Self {
            left,
            top,
            width,
            coverage: vec![0.0; width * height],
            light: vec![0.0; width * height],
        }
    }

    fn stamp(&mut self, disc: &Disc, weight: f32, look: BallLight) {
        // Centre of sub-pixel i of the patch is left − ½ + (i + ½)/FINE.
        let fine = FINE as f64;
        let index = |value: f64, origin: f64| (value - origin + 0.5) * fine - 0.5;
        let height = self.coverage.len() / self.width;
        let reach = disc.reach_px * fine + 1.0;
        let radius = disc.radius_px * fine;
        let span = |centre: f64, length: usize| {
            let low = (centre - reach).floor().max(0.0) as usize;
            let high = ((centre + reach).ceil().max(0.0) as usize + 1).min(length);
            low..high.max(low)
        };
        let (cx, cy) = (index(disc.x, self.left), index(disc.y, self.top));
        let [ixx, ixy, iyx, iyy] = disc.inverse;
        for j in span(cy, height) {
            let dy = (j as f64 - cy) / fine;
            for i in span(cx, self.width) {
                let dx = (i as f64 - cx) / fine;
                let (u, v) = (ixx * dx + ixy * dy, iyx * dx + iyy * dy);
                let rho = u.hypot(v);
                // A soft edge of one sub-pixel: hard ones shift the centroid by up to 0.02 px.
                let share = ((1.0 - rho) * radius + 0.5).clamp(0.0, 1.0) as f32 * weight;
                if share <= 0.0 {
                    continue;
                }
                let depth = (1.0 - rho * rho).max(0.0).sqrt() as f32;
                let lit = disc.sun[0] * u as f32 + disc.sun[1] * v as f32 + disc.sun[2] * depth;
                let lambert = AMBIENT + (1.0 - AMBIENT) * lit.max(0.0);
                let tone = look.white_dn * disc.light * (1.0 - look.shading + look.shading * lambert);
                let at = j * self.width + i;
                self.coverage[at] += share;
                self.light[at] += share * tone;
            }
        }
    }

    fn averaged(&self) -> Patch {
        let width = self.width / FINE;
        let height = self.coverage.len() / self.width / FINE;
        let average = |values: &[f32]| {
            let mut out = vec![0.0f32; width * height];
            for (y, rows) in values.chunks_exact(self.width * FINE).enumerate() {
                for row in rows.chunks_exact(self.width) {
                    for (x, cell) in row.chunks_exact(FINE).enumerate() {
                        out[y * width + x] += cell.iter().sum::<f32>() / (FINE * FINE) as f32;
                    }
                }
            }
            out
        };
        Patch {
            left: self.left as i64,
            top: self.top as i64,
            width,
            coverage: average(&self.coverage),
            light: average(&self.light),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view() -> (Pose, Intrinsics) {
        let pose = Pose::looking_at(Point3::new(20.0, 6.0, 3.3), Point3::new(0.0, 9.0, 1.0));
        let lens = Intrinsics {
            fx_px: 1790.0,
            fy_px: 1790.0,
            cx_px: 1031.4,
            cy_px: 505.2,
            distortion: [-0.083, 0.021, 0.0004, -0.0003, 0.0],
        };
        (pose, lens)
    }

    /// Mass, centroid and variance along x and y of a patch's weights.
    fn moments(patch: &Patch, weights: &[f32]) -> (f64, [f64; 2], [f64; 2]) {
        let (mut mass, mut sum, mut square) = (0.0, [0.0; 2], [0.0; 2]);
        for (i, w) in weights.iter().enumerate() {
            let at = [
                (patch.left + (i % patch.width) as i64) as f64,
                (patch.top + (i / patch.width) as i64) as f64,
            ];
            mass += f64::from(*w);
            for k in 0..2 {
                sum[k] += f64::from(*w) * at[k];
                square[k] += f64::from(*w) * at[k] * at[k];
            }
        }
        let centre = sum.map(|s| s / mass);
        (
            mass,
            centre,
            [0, 1].map(|k| square[k] / mass - centre[k] * centre[k]),
        )
    }

    const FLAT: BallLight = BallLight {
        white_dn: 200.0,
        shading: 0.0,
    };

    #[test]
    fn a_still_unshaded_ball_has_its_centroid_and_area_at_the_truth() {
        let (pose, lens) = view();
        for i in 0..25 {
            let p = Point3::new(0.1, 2.0 + 0.37 * f64::from(i), 0.4 + 0.061 * f64::from(i));
            let patch = ball_patch((&pose, &lens), (0.0, 0.001), 0.5, FLAT, |_| (p, 1.0)).unwrap();
            let truth = lens.project(&pose.transform(&p)).unwrap();
            let (mass, centre, _) = moments(&patch, &patch.light);
            // The perspective ellipse's own shift is 0.003 px here; sub-pixel sampling leaves less.
            assert!((centre[0] - truth.x).abs() < 0.01, "{centre:?} {truth:?}");
            assert!((centre[1] - truth.y).abs() < 0.01, "{centre:?} {truth:?}");
            let depth = pose.transform(&p).z;
            let radius = BALL_RADIUS_M * 1790.0 / depth;
            assert!((mass / 200.0 / (std::f64::consts::PI * radius * radius) - 1.0).abs() < 0.08);
        }
    }

    #[test]
    fn the_streak_is_as_long_as_the_ball_flew() {
        let (pose, lens) = view();
        let path = |t: f64| (Point3::new(0.0, 9.0 - 42.0 * t, 1.0), 1.0);
        let still = ball_patch((&pose, &lens), (0.0, 0.0), 0.5, FLAT, path).unwrap();
        let moving = ball_patch((&pose, &lens), (-0.001, 0.001), 0.5, FLAT, path).unwrap();
        let at = |t: f64| lens.project(&pose.transform(&path(t).0)).unwrap();
        let length = at(0.001).x - at(-0.001).x;
        let (_, centre, spread) = moments(&moving, &moving.coverage);
        let (_, _, spread_still) = moments(&still, &still.coverage);
        // A box of length L adds L²/12 to the variance.
        let seen = (12.0 * (spread[0] - spread_still[0])).sqrt();
        assert!((seen / length.abs() - 1.0).abs() < 0.01, "{seen} {length}");
        assert!((centre[0] - at(0.0).x).abs() < 0.01);
    }

    #[test]
    fn a_ball_lit_from_above_is_brighter_at_the_top() {
        let (pose, lens) = view();
        let p = Point3::new(0.0, 9.0, 1.0);
        let lit = BallLight {
            white_dn: 200.0,
            shading: 1.0,
        };
        let patch = ball_patch((&pose, &lens), (0.0, 0.0), 0.5, lit, |_| (p, 1.0)).unwrap();
        let (_, geometric, _) = moments(&patch, &patch.coverage);
        let (_, bright, _) = moments(&patch, &patch.light);
        assert!((geometric[1] - bright[1]) > 0.25, "{geometric:?} {bright:?}");
    }
}
