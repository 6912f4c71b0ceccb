//! Flags in the wind and rain before the camera: small things that move smoothly and are no ball.

use rand::Rng;
use rand_pcg::Pcg64Mcg;

use super::canvas::Canvas;

/// Width of a stripe of a flag, pixels.
const STRIPE_PX: f64 = 11.0;
/// Drops fall at this speed (m/s), from so near to so far (m), and are so thick (m).
const FALL_MPS: std::ops::Range<f64> = 5.0..9.0;
const DROP_DEPTH_M: std::ops::Range<f64> = 1.5..14.0;
const DROP_M: f64 = 0.0025;
/// A drop takes on this much of the sky's light.
const DROP_TONE: f32 = 190.0;

/// Striped cloth that waves.
#[derive(Debug, Clone, Copy)]
struct Flag {
    left: f64,
    top: f64,
    size: [f64; 2],
    wave_hz: f64,
    tones: [f32; 2],
}

impl Flag {
    fn draw(&self, true_s: f64, canvas: &mut Canvas) {
        let [width, height] = self.size;
        let (top, bottom) = (self.top - 0.3 * height, self.top + 1.3 * height);
        let Some(region) = canvas.region(self.left, top, self.left + width, bottom) else {
            return;
        };
        for row in region.top..region.bottom {
            for (column, tone) in (region.left..).zip(canvas.row(&region, row)) {
                let u = (column as f64 - self.left) / width;
                let phase = std::f64::consts::TAU * (1.6 * u - self.wave_hz * true_s);
                // Held at the pole, free at the other end.
                let off = 0.22 * height * u * phase.sin();
                let inside = 0.5 * height - (row as f64 - self.top - 0.5 * height - off).abs();
                let coverage = (inside + 0.5).clamp(0.0, 1.0) as f32;
                let stripe = (u * width / STRIPE_PX) as usize % 2;
                let shade = 1.0 + 0.25 * (u * phase.cos()) as f32;
                let cloth = self.tones.get(stripe).copied().unwrap_or(0.0) * shade;
                *tone += coverage * (cloth - *tone);
            }
        }
    }
}

/// A drop that falls through the picture again and again.
#[derive(Debug, Clone, Copy)]
struct Drop {
    x: f64,
    top: f64,
    speed_pxps: f64,
    drift: f64,
    width_px: f64,
}

impl Drop {
    fn draw(&self, true_s: f64, exposure_s: f64, canvas: &mut Canvas) {
        let size = [canvas.width as f64, canvas.height as f64];
        let fallen = self.top + self.speed_pxps * true_s;
        let turn = (fallen / (size[1] + 80.0)).floor();
        let y = fallen - turn * (size[1] + 80.0) - 40.0;
        // Each time elsewhere.
        let x = (self.x + 0.618 * size[0] * turn + self.drift * y).rem_euclid(size[0]);
        let half = 0.5 * (self.speed_pxps * exposure_s + self.width_px);
        let Some(region) = canvas.region(x - self.width_px, y - half, x + self.width_px, y + half) else {
            return;
        };
        // A thin drop covers a part of its pixels, and each for a part of the exposure.
        let stays = (self.width_px / (2.0 * half)).min(1.0) as f32;
        for row in region.top..region.bottom {
            for (column, tone) in (region.left..).zip(canvas.row(&region, row)) {
                let across = (0.5 * self.width_px + 0.5 - (column as f64 - x).abs()).clamp(0.0, 1.0);
                let coverage = stays * (across * self.width_px.min(1.0)) as f32;
                *tone += coverage * (DROP_TONE - *tone);
            }
        }
    }
}

/// The weather of one camera.
#[derive(Debug, Clone, Default)]
pub(super) struct Weather {
    flags: Vec<Flag>,
    drops: Vec<Drop>,
    exposure_s: f64,
}

impl Weather {
    /// Flags in the upper part of the picture.
    pub(super) fn with_flags(mut self, count: usize, size_px: [f64; 2], rng: &mut Pcg64Mcg) -> Self {
        let flag = |_| Flag {
            left: rng.random_range(0.0..size_px[0]),
            top: rng.random_range(0.05..0.45) * size_px[1],
            size: [rng.random_range(30.0..90.0), rng.random_range(18.0..50.0)],
            wave_hz: rng.random_range(1.0..4.0),
            tones: [rng.random_range(30.0..120.0), rng.random_range(140.0..230.0)],
        };
        self.flags = (0..count).map(flag).collect();
        self
    }

    /// Drops in the air before a lens of this focal length.
    pub(super) fn with_rain(
        mut self,
        count: usize,
        (focal_px, exposure_s): (f64, f64),
        size_px: [f64; 2],
        rng: &mut Pcg64Mcg,
    ) -> Self {
        let drop = |_| {
            let depth_m = rng.random_range(DROP_DEPTH_M);
            Drop {
                x: rng.random_range(0.0..size_px[0]),
                top: rng.random_range(0.0..size_px[1]),
                speed_pxps: rng.random_range(FALL_MPS) * focal_px / depth_m,
                drift: rng.random_range(-0.15..0.15),
                width_px: DROP_M * focal_px / depth_m,
            }
        };
        self.drops = (0..count).map(drop).collect();
        self.exposure_s = exposure_s;
        self
    }

    /// Draws the flags, which lie behind everything else that moves.
    pub(super) fn draw_behind(&self, true_s: f64, canvas: &mut Canvas) {
        for flag in &self.flags {
            flag.draw(true_s, canvas);
        }
    }

    /// Draws the rain, which falls before everything.
    pub(super) fn draw_before(&self, true_s: f64, canvas: &mut Canvas) {
        for drop in &self.drops {
            drop.draw(true_s, self.exposure_s, canvas);
        }
    }
}
