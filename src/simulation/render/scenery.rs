//! What disturbs: people in the stands who twinkle, and wires and poles before the camera.

use rand::Rng;
use rand_pcg::Pcg64Mcg;

use super::canvas::Canvas;
use super::texture::hash;

/// At most so many places in the stands change.
const TWINKLES: usize = 420;

/// A place in the stands whose brightness changes.
#[derive(Debug, Clone, Copy)]
struct Twinkle {
    x: f64,
    y: f64,
    radius: [f64; 2],
    /// Frames between changes.
    hold: u64,
}

/// A pole or wire: the strip |n·(p − c)| ≤ half width.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bar {
    centre: [f64; 2],
    normal: [f64; 2],
    half_px: f64,
    tone: f32,
}

/// Poles stand close to the camera, out of focus: their edges are this soft, pixels.
const BAR_EDGE_PX: f64 = 2.0;

impl Bar {
    /// Coverage of a pixel.
    pub(super) fn at(&self, x: f64, y: f64) -> f32 {
        let off = (x - self.centre[0]) * self.normal[0] + (y - self.centre[1]) * self.normal[1];
        ((self.half_px - off.abs()) / BAR_EDGE_PX + 0.5).clamp(0.0, 1.0) as f32
    }

    fn draw(&self, canvas: &mut Canvas) {
        let reach = self.half_px + BAR_EDGE_PX;
        let width = canvas.width as f64;
        for y in 0..canvas.height {
            let row = y as f64;
            let shift = (row - self.centre[1]) * self.normal[1];
            let (left, right) = if self.normal[0].abs() > 1e-3 {
                let middle = self.centre[0] - shift / self.normal[0];
                let spread = reach / self.normal[0].abs();
                (middle - spread, middle + spread)
            } else if shift.abs() < reach {
                (0.0, width)
            } else {
                continue;
            };
            if right < 0.0 || left >= width {
                continue;
            }
            let Some(region) = canvas.region(left, row, right, row) else {
                continue;
            };
            for (x, tone) in (region.left..).zip(canvas.row(&region, y)) {
                let coverage = self.at(x as f64, row);
                *tone += coverage * (self.tone - *tone);
            }
        }
    }
}

/// Something small that crosses the picture again and again on a wavy line.
#[derive(Debug, Clone, Copy)]
struct Bird {
    start: [f64; 2],
    speed_pxps: [f64; 2],
    wave_px: f64,
    wave_hz: f64,
    radius_px: f64,
    tone: f32,
}

impl Bird {
    fn draw(&self, true_s: f64, canvas: &mut Canvas) {
        let size = [canvas.width as f64, canvas.height as f64];
        let place = |k: usize| {
            let margin = 40.0;
            (self.start[k] + self.speed_pxps[k] * true_s).rem_euclid(size[k] + 2.0 * margin) - margin
        };
        let flap = (std::f64::consts::TAU * self.wave_hz * true_s).sin();
        let (x, y) = (place(0), place(1) + self.wave_px * flap);
        let (rx, ry) = (self.radius_px * (1.2 + 0.4 * flap), self.radius_px * 0.7);
        let Some(region) = canvas.region(x - rx - 1.0, y - ry - 1.0, x + rx + 1.0, y + ry + 1.0) else {
            return;
        };
        for row in region.top..region.bottom {
            let v = (row as f64 - y) / ry;
            for (column, tone) in (region.left..).zip(canvas.row(&region, row)) {
                let u = (column as f64 - x) / rx;
                let coverage = ((1.0 - u.hypot(v)) * ry + 0.5).clamp(0.0, 1.0) as f32;
                *tone += coverage * (self.tone - *tone);
            }
        }
    }
}

/// Everything that disturbs one camera.
#[derive(Debug, Clone, Default)]
pub(super) struct Scenery {
    twinkles: Vec<Twinkle>,
    amplitude: f32,
    birds: Vec<Bird>,
    pub bars: Vec<Bar>,
}

impl Scenery {
    /// Picks places among the crowd's pixels.
    pub(super) fn with_twinkles(mut self, crowd: &[(u32, u32)], amplitude: f32, rng: &mut Pcg64Mcg) -> Self {
        self.amplitude = amplitude;
        if amplitude > 0.0 && !crowd.is_empty() {
            let place = |_| {
                let (x, y) = crowd[rng.random_range(0..crowd.len())];
                Twinkle {
                    x: f64::from(x) + rng.random_range(-3.0..3.0),
                    y: f64::from(y) + rng.random_range(-3.0..3.0),
                    radius: [rng.random_range(2.5..7.5), rng.random_range(3.0..10.0)],
                    hold: rng.random_range(1..12),
                }
            };
            self.twinkles = (0..TWINKLES.min(crowd.len())).map(place).collect();
        }
        self
    }

    /// Three bars across a path in the picture that hide `share` of its length in all.
    pub(super) fn with_bars(mut self, path: ([f64; 2], [f64; 2]), share: f64, rng: &mut Pcg64Mcg) -> Self {
        let (from, to) = path;
        let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
        let length = dx.hypot(dy);
        if share <= 0.0 || length < 1.0 {
            return self;
        }
        for place in [0.24, 0.5, 0.74] {
            let place = place + rng.random_range(-0.07..0.07);
            let tilt: f64 = dy.atan2(dx) + rng.random_range(-0.25..0.25);
            self.bars.push(Bar {
                centre: [from[0] + place * dx, from[1] + place * dy],
                normal: [tilt.cos(), tilt.sin()],
                half_px: 0.5 * share / 3.0 * length,
                tone: rng.random_range(35.0..75.0),
            });
        }
        self
    }

    /// Adds small things in the air.
    pub(super) fn with_birds(mut self, count: usize, size_px: [f64; 2], rng: &mut Pcg64Mcg) -> Self {
        let bird = |_| Bird {
            start: size_px.map(|s| rng.random_range(0.0..s)),
            speed_pxps: [rng.random_range(-700.0..700.0), rng.random_range(-120.0..120.0)],
            wave_px: rng.random_range(0.0..12.0),
            wave_hz: rng.random_range(1.0..6.0),
            radius_px: rng.random_range(1.5..5.0),
            tone: if rng.random::<bool>() { 28.0 } else { 215.0 },
        };
        self.birds = (0..count).map(bird).collect();
        self
    }

    /// Draws the twinkling places and the birds; they lie behind everything that moves.
    pub(super) fn draw_behind(&self, frame: u64, true_s: f64, canvas: &mut Canvas) {
        for (i, t) in (0i64..).zip(&self.twinkles) {
            let change = 2.0 * hash(i, (frame / t.hold) as i64, 151) - 1.0;
            let bounds = (t.x - t.radius[0], t.y - t.radius[1]);
            let Some(region) = canvas.region(bounds.0, bounds.1, t.x + t.radius[0], t.y + t.radius[1]) else {
                continue;
            };
            for y in region.top..region.bottom {
                let v = (y as f64 - t.y) / t.radius[1];
                for (x, tone) in (region.left..).zip(canvas.row(&region, y)) {
                    let u = (x as f64 - t.x) / t.radius[0];
                    let mask = (1.0 - u * u - v * v).max(0.0) as f32;
                    *tone *= 1.0 + self.amplitude * change * (2.0 * mask).min(1.0);
                }
            }
        }
        for bird in &self.birds {
            bird.draw(true_s, canvas);
        }
    }

    /// Draws what stands before the camera.
    pub(super) fn draw_before(&self, canvas: &mut Canvas) {
        for bar in &self.bars {
            bar.draw(canvas);
        }
    }
}
