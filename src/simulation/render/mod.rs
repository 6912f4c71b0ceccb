//! Rendered frames: a still stadium, what moves in it, the ball as the exposure saw it, the sensor's noise.
//!
//! The background is made once per camera. A frame is: restore what was drawn last time, draw what moves from
//! far to near, then one pass of light, noise and rounding. Every frame follows from (seed, camera, frame
//! number) alone, so frames can be rendered in any order.

mod background;
mod ball;
mod canvas;
mod ground;
mod idle;
mod limb;
mod look;
mod people;
mod scenery;
mod sensor;
mod stands;
mod texture;
mod weather;
mod write;

pub use self::write::write_frames;

use std::sync::Arc;

use rand::Rng;

use self::background::{Background, View};
use self::ball::{BallLight, ball_patch};
use self::canvas::{Canvas, Patch};
use self::ground::Ground;
use self::idle::Idle;
use self::limb::Shape;
use self::look::Look;
use self::people::Play;
use self::scenery::Scenery;
use self::sensor::Sensor;
use self::weather::Weather;
use super::clock::{CameraClock, Exposure, Purpose, stream};
use super::error::SimulationError;
use super::scenario::{CameraSpec, Scenario};
use super::throw::{PLATE_FRONT_Y_M, ThrownBall};
use super::truth::{self, TrueCentre};
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
    scenery: Scenery,
    weather: Weather,
    idle: Option<Idle>,
    plays: Vec<Play>,
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
        let mut rng = stream(scenario.seed, Purpose::Scenery, index as u64 + 1, 0);
        let size_px = [f64::from(camera.width_px), f64::from(camera.height_px)];
        let scenery = Scenery::default()
            .with_twinkles(&background.crowd, look.crowd_flicker, &mut rng)
            .with_bars(usual_path(camera), look.occlusion, &mut rng)
            .with_birds(look.birds, size_px, &mut rng);
        let lens = (camera.intrinsics.fx_px, camera.exposure_s);
        let weather = Weather::default()
            .with_flags(look.flags, size_px, &mut rng)
            .with_rain(look.rain, lens, size_px, &mut rng);
        let mut of_all_cameras = stream(scenario.seed, Purpose::Scenery, 0, 1);
        let idle = look
            .idle_play
            .then(|| Idle::new(look.white_dn, &mut of_all_cameras));
        let pitches = scenario.pitches.len().min(balls.len());
        let plays = plays(&balls[..pitches], &look, scenario);
        Ok(Self {
            pose: camera.pose(),
            clock: CameraClock::new(scenario, index, camera),
            windows_s: windows(scenario, &look, &balls),
            canvas: Canvas::new(&background.tones, width),
            sensor: Sensor::new(scenario.seed, width, look.read_noise_dn, look.electrons_per_dn),
            scenery,
            weather,
            idle,
            plays,
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
        self.scenery
            .draw_behind(exposure.frame, exposure.true_s, &mut self.canvas);
        self.weather.draw_behind(exposure.true_s, &mut self.canvas);
        self.draw_movers(exposure);
        self.scenery.draw_before(&mut self.canvas);
        self.weather.draw_before(exposure.true_s, &mut self.canvas);
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

    /// People and balls, far to near.
    fn draw_movers(&mut self, exposure: &Exposure) {
        let mut people = self.people(exposure.true_s);
        people.sort_by(|a, b| b.depth_m.total_cmp(&a.depth_m));
        let mut balls = self.balls_in(exposure);
        balls.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut balls = balls.into_iter().peekable();
        for shape in people {
            while let Some((_, patch)) = balls.next_if(|(depth_m, _)| *depth_m > shape.depth_m) {
                self.canvas.compose(&patch);
            }
            shape.draw(&mut self.canvas);
        }
        for (_, patch) in balls {
            self.canvas.compose(&patch);
        }
    }

    /// The four players, and who else is on the field, at a true time, as shapes in the picture.
    fn people(&self, true_s: f64) -> Vec<Shape> {
        let Some((play, t)) = self.play_at(true_s) else {
            return Vec::new();
        };
        let project = |limb: &limb::Limb| {
            let light = self.ground.light(&limb.a);
            Shape::of(limb, &self.pose, &self.camera.intrinsics, light)
        };
        let practising = self.idle.as_ref().and_then(|_| idle::practice(play, t));
        let mut swinging = *play;
        swinging.swing |= practising.is_some();
        let mut limbs = swinging.limbs(t, practising.unwrap_or((t, t)), self.look.white_dn);
        limbs.extend(self.idle.iter().flat_map(|idle| match practising {
            Some(_) => idle.between_pitches(true_s),
            None => idle.during_pitch(true_s),
        }));
        limbs.iter().filter_map(project).collect()
    }

    /// The pitch that is nearest in time, and the time after its release.
    fn play_at(&self, true_s: f64) -> Option<(&Play, f64)> {
        let pitches = self.plays.iter().zip(&self.balls);
        let timed = pitches.map(|(play, ball)| (play, true_s - ball.start_s));
        timed.min_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))
    }

    /// Every ball that this exposure sees, in flight or in the pitcher's hand: distance and patch.
    fn balls_in(&self, exposure: &Exposure) -> Vec<(f64, Patch)> {
        let lens = &self.camera.intrinsics;
        let half_s = 0.5 * self.camera.exposure_s;
        let mut all = Vec::new();
        for (number, ball) in self.balls.iter().enumerate() {
            let (begin_s, end_s) = ball.span_s();
            if exposure.true_s < begin_s - 0.5 || exposure.true_s > end_s + 0.1 {
                continue;
            }
            let play = self.plays.get(number);
            let row_time = truth::sight_in_frame(&self.pose, lens, &self.clock, ball, exposure.frame);
            let true_s = row_time.map_or(exposure.true_s, |(t, _)| t);
            let held = |t: f64| play.and_then(|p| p.held_ball(t - begin_s));
            if true_s > end_s || (true_s < begin_s && held(true_s).is_none()) {
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
                    // A ball whose exposure spans the release is taken as flying: the truth's midpoint rules.
                    let p = match held(t) {
                        Some(hand) if true_s < begin_s => hand,
                        _ => ball.position_m(t),
                    };
                    (p, self.ground.light(&p))
                },
            );
            let at = held(true_s).unwrap_or_else(|| ball.position_m(true_s));
            let depth_m = self.pose.transform(&at).norm();
            all.extend(patch.map(|patch| (depth_m, patch)));
        }
        all
    }

    /// Share of a ball's picture (its disc along the way of the exposure) that people, poles and wires hide, 0..1.
    pub fn hidden_share(&self, centre: &TrueCentre) -> f64 {
        let Some(ball) = (centre.pitch as usize)
            .checked_sub(1)
            .and_then(|i| self.balls.get(i))
        else {
            return 0.0;
        };
        let row_px = centre.pixel.y;
        let true_s = self.clock.true_s(centre.frame, row_px);
        let depth_m = self.pose.transform(&ball.position_m(true_s)).norm();
        let mut people = self.people(true_s);
        people.retain(|shape| shape.depth_m < depth_m);
        let hidden_at = |x: f64, y: f64| {
            let shapes = people.iter().map(|shape| shape.at(x, y).0);
            let bars = self.scenery.bars.iter().map(|bar| bar.at(x, y));
            let clear: f32 = shapes.chain(bars).map(|coverage| 1.0 - coverage).product();
            f64::from(1.0 - clear)
        };
        let mut hidden = 0.0;
        for part in SWEEP {
            let [x, y] = [0, 1].map(|k| part * self.camera.exposure_s * centre.velocity_pxps[k]);
            let (x, y) = (centre.pixel.x + x, centre.pixel.y + y);
            let disc = DISC.map(|(u, v)| hidden_at(x + u * centre.radius_px, y + v * centre.radius_px));
            hidden += disc.iter().sum::<f64>() / (SWEEP.len() * DISC.len()) as f64;
        }
        hidden
    }

    /// Marks as not visible every centre of this camera that is hidden by more than half.
    pub fn mark_hidden(&self, centres: &mut [TrueCentre]) {
        for centre in centres.iter_mut().filter(|c| c.visible) {
            centre.visible = self.hidden_share(centre) <= 0.5;
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

/// Instants of an exposure that stand for all of it.
const SWEEP: [f64; 3] = [-1.0 / 3.0, 0.0, 1.0 / 3.0];

/// Points of a disc of radius 1 that stand for its area.
const DISC: [(f64, f64); 13] = [
    (0.0, 0.0),
    (0.5, 0.0),
    (-0.5, 0.0),
    (0.0, 0.5),
    (0.0, -0.5),
    (0.85, 0.0),
    (-0.85, 0.0),
    (0.0, 0.85),
    (0.0, -0.85),
    (0.6, 0.6),
    (-0.6, 0.6),
    (0.6, -0.6),
    (-0.6, -0.6),
];

/// Where pitches pass in a camera's picture.
fn usual_path(camera: &CameraSpec) -> ([f64; 2], [f64; 2]) {
    let pose = camera.pose();
    let at = |p: [f64; 3]| {
        let pixel = camera.intrinsics.project(&pose.transform(&p.into()));
        pixel.map_or([0.0; 2], |q| [q.x, q.y])
    };
    (at([0.0, 16.5, 1.8]), at([0.0, 0.43, 0.75]))
}

/// What the players do for every pitch: every other batter swings; later ones stand at x > 0.
fn plays(pitches: &[ThrownBall], look: &Look, scenario: &Scenario) -> Vec<Play> {
    if !look.people {
        return Vec::new();
    }
    let rubber = scenario.site.field.landmark("rubber_front_right");
    let mound_m = rubber.map_or(0.0, |p| p.z);
    let play = |(i, ball): (usize, &ThrownBall)| {
        let start = ball.flight.state(0.0);
        let plate_s = ball.flight.time_at_y(PLATE_FRONT_Y_M);
        Play {
            release_m: start.position_m,
            release_mps: start.velocity_mps,
            glove_m: ball.flight.position_m(ball.flight.end_s),
            plate_s: plate_s.unwrap_or(ball.flight.end_s),
            batter_side: if 2 * i < pitches.len() { -1.0 } else { 1.0 },
            swing: i % 2 == 1,
            batter_y_m: look.batter_y_m,
            mound_m,
        }
    };
    pitches.iter().enumerate().map(play).collect()
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
