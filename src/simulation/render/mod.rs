//! Rendered frames: a still stadium, what moves in it, the ball as the exposure saw it, the sensor's noise.
//!
//! The background is made once per camera. A frame is: restore what was drawn last time, draw what moves from
//! far to near, then one pass of light, noise and rounding. Every frame follows from (seed, camera, frame
//! number) alone, so frames can be rendered in any order.

mod background;
mod ball;
mod canvas;
mod ground;
mod look;
mod sensor;
mod stands;
mod texture;
mod write;

pub use self::write::write_frames;

use std::sync::Arc;

use rand::Rng;

use self::background::{Background, View};
use self::ball::{BallLight, ball_patch};
use self::canvas::Canvas;
use self::ground::Ground;
use self::look::Look;
use self::sensor::Sensor;
use super::clock::{CameraClock, Exposure, Purpose, stream};
use super::error::SimulationError;
use super::scenario::{CameraSpec, Scenario};
use super::throw::ThrownBall;
use super::truth;
use crate::geometry::Pose;
use crate::scene::{CameraId, Frame, FrameStamp};

/// Renders the frames of one camera.
pub struct CameraRenderer {
    camera: CameraSpec,
    pose: Pose,
    clock: CameraClock,
    look: Look,
    windows_s: Vec<(f64, f64)>,
    balls: Vec<ThrownBall>,
    ground: Ground,
    background: Background,
    canvas: Canvas,
    sensor: Sensor,
    column_light: Vec<[f32; 2]>,
    seed: u64,
    index: u64,
}

impl CameraRenderer {
    /// Prepares camera `index` of a scenario (paints the still picture).
    pub fn new(scenario: &Scenario, index: usize) -> Result<Self, SimulationError> {
        scenario.check()?;
        let camera = scenario
            .cameras
            .get(index)
            .ok_or_else(|| SimulationError::value(format!("camera[{index}]"), "there is no such camera"))?;
        let look = Look::of(&scenario.render);
        let balls = truth::balls(scenario)?;
        let ground = Ground::new(scenario.site.field, look.white_dn, look.shadow);
        let background = View {
            pose: camera.pose(),
            lens: camera.intrinsics,
            width_px: camera.width_px,
            height_px: camera.height_px,
            ground: &ground,
            board_dn: look.board_dn,
            blur_sigma_px: look.blur_sigma_px,
        }
        .paint();
        let width = camera.width_px as usize;
        Ok(Self {
            pose: camera.pose(),
            clock: CameraClock::new(scenario, index, camera),
            windows_s: windows(scenario, &look, &balls),
            canvas: Canvas::new(&background.tones, width),
            sensor: Sensor::new(scenario.seed, width, look.read_noise_dn, look.electrons_per_dn),
            column_light: column_light(width),
            camera: camera.clone(),
            look,
            balls,
            ground,
            background,
            seed: scenario.seed,
            index: index as u64,
        })
    }

    /// The camera's name.
    pub fn camera(&self) -> &CameraId {
        &self.camera.id
    }

    /// Columns and rows.
    pub fn size_px(&self) -> (u32, u32) {
        (self.camera.width_px, self.camera.height_px)
    }

    /// Exposures that reach the host, by rising frame: those around every ball, or all if `continuous`.
    pub fn exposures(&self) -> impl Iterator<Item = Exposure> + use<> {
        let clock = self.clock.clone();
        let mut next = 0;
        let spans: Vec<_> = self
            .windows_s
            .iter()
            .map(|(begin_s, end_s)| {
                let span = clock.frames_within(*begin_s, *end_s);
                let from = span.start.max(next);
                next = span.end.max(next);
                from..span.end
            })
            .collect();
        let all = spans.into_iter().flatten();
        all.map(move |frame| clock.exposure(frame)).filter(|e| !e.lost)
    }

    /// Renders one exposure into `out` (`width·height` bytes, rows from the top).
    pub fn render(&mut self, exposure: &Exposure, out: &mut [u8]) {
        let mut rng = stream(self.seed, Purpose::PixelNoise, self.index + 1, exposure.frame);
        self.canvas.restore(&self.background.tones);
        self.draw_balls(exposure);
        let gains = self.gains(exposure.true_s);
        self.sensor.expose(&self.canvas.tones, &gains, &mut rng, out);
    }

    /// The next frame as the rest of the program takes it.
    pub fn frame(&mut self, exposure: &Exposure) -> Frame {
        let (width_px, height_px) = self.size_px();
        let mut pixels = vec![0u8; width_px as usize * height_px as usize];
        self.render(exposure, &mut pixels);
        Frame {
            stamp: FrameStamp {
                frame: exposure.frame,
                device: None,
                arrival: None,
                stamped: exposure.stamped,
            },
            width_px,
            height_px,
            pixels: Arc::new(pixels),
        }
    }

    /// All frames of the camera in time order.
    pub fn frames(self) -> CameraFrames {
        CameraFrames {
            exposures: Box::new(self.exposures()),
            renderer: self,
        }
    }

    fn draw_balls(&mut self, exposure: &Exposure) {
        let half_s = 0.5 * self.camera.exposure_s;
        for ball in &self.balls {
            let (begin_s, end_s) = ball.span_s();
            if exposure.true_s < begin_s - 0.1 || exposure.true_s > end_s + 0.1 {
                continue;
            }
            let lens = &self.camera.intrinsics;
            let seen = truth::sight_in_frame(&self.pose, lens, &self.clock, ball, exposure.frame);
            let Some((true_s, _)) = seen else {
                continue;
            };
            if true_s < begin_s || true_s > end_s {
                continue;
            }
            let patch = ball_patch(
                (&self.pose, lens),
                (true_s - half_s, true_s + half_s),
                self.look.blur_sigma_px,
                BallLight {
                    white_dn: self.look.white_dn,
                    shading: self.look.shading,
                },
                |t| {
                    let p = ball.position_m(t);
                    let light = self.ground.light(&p);
                    (p, light)
                },
            );
            if let Some(patch) = patch {
                self.canvas.compose(&patch);
            }
        }
    }

    /// Light of every column: lamps on two phases of the mains, mixed across the picture.
    fn gains(&self, true_s: f64) -> Vec<f32> {
        let turn = std::f64::consts::TAU * self.look.flicker_hz * true_s;
        let (a, b) = (
            turn.sin() as f32,
            (turn + 2.0 * std::f64::consts::FRAC_PI_3).sin() as f32,
        );
        let amplitude = self.look.flicker_amplitude as f32;
        let gain = |[u, v]: &[f32; 2]| 1.0 + amplitude * (u * a + v * b);
        self.column_light.iter().map(gain).collect()
    }
}

/// Frames of one camera in time order.
pub struct CameraFrames {
    exposures: Box<dyn Iterator<Item = Exposure> + Send>,
    renderer: CameraRenderer,
}

impl CameraFrames {
    /// The renderer behind it.
    pub fn renderer(&self) -> &CameraRenderer {
        &self.renderer
    }
}

impl Iterator for CameraFrames {
    type Item = Frame;
    fn next(&mut self) -> Option<Frame> {
        let exposure = self.exposures.next()?;
        Some(self.renderer.frame(&exposure))
    }
}

/// The frames of camera `index` of a scenario, in time order, made as they are asked for.
pub fn camera_frames(scenario: &Scenario, index: usize) -> Result<CameraFrames, SimulationError> {
    Ok(CameraRenderer::new(scenario, index)?.frames())
}

/// Spans of true time that are rendered, by rising begin.
fn windows(scenario: &Scenario, look: &Look, balls: &[ThrownBall]) -> Vec<(f64, f64)> {
    let mut spans: Vec<(f64, f64)> = balls
        .iter()
        .map(|ball| {
            let (begin_s, end_s) = ball.span_s();
            ((begin_s - look.lead_s).max(0.0), end_s + look.tail_s)
        })
        .collect();
    spans.sort_by(|a, b| a.0.total_cmp(&b.0));
    let last_s = spans.iter().map(|s| s.1).fold(0.0, f64::max);
    if scenario.render.idle_s > 0.0 {
        spans.push((last_s, last_s + scenario.render.idle_s));
    }
    if scenario.render.continuous {
        let begin_s = spans.first().map_or(0.0, |s| s.0);
        spans = vec![(begin_s, last_s + scenario.render.idle_s)];
    }
    spans
}

/// Shares of the two lamp phases in every column, a smooth mix.
fn column_light(width: usize) -> Vec<[f32; 2]> {
    let mut rng = stream(width as u64, Purpose::Scenery, 0, 0);
    let turn: f32 = rng.random_range(0.0..1.0);
    let share = |x: usize| 0.5 + 0.35 * ((x as f32 / width as f32 + turn) * 4.0).sin();
    (0..width).map(|x| [share(x), 1.0 - share(x)]).collect()
}

#[cfg(test)]
mod tests;
