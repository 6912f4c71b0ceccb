//! One camera's eye: frames in, tracks of pitched balls out.
//!
//! `first_look` (detection, tracking: every frame, in time) → `second_look` (a ball whose path has ended: its centres
//! fitted, judged again). [`CameraEye`] does both in line; the daemon gives each its own thread, so that no frame waits
//! for a fit.

mod first_look;
mod second_look;

pub use first_look::{BallStep, EndedBall, FirstLook, FlyingBall};
pub use second_look::SecondLook;

use nalgebra::Vector2;

use crate::detection::{DetectionError, DetectorConfig, DetectorCounters};
use crate::scene::{CameraId, ForeseenPath, Frame, Rig, Track};
use crate::tracking::{OpenPath, TrackedBall, TrackerConfig, TrackerCounters};

/// Settings of an eye.
#[derive(Debug, Clone, Default)]
pub struct EyeConfig {
    /// Of its detector.
    pub detector: DetectorConfig,
    /// Of its tracker.
    pub tracker: TrackerConfig,
}

impl EyeConfig {
    /// What the rig knows of a camera; the defaults where it does not know it. Live frames and replayed ones both
    /// take it from here, so that they give the same pitches.
    pub fn of_rig(rig: &Rig, camera: &CameraId) -> Self {
        let mut eye = Self::default();
        if let Some(setup) = rig.camera(camera) {
            eye.detector.exposure_s = setup.exposure_s;
            eye.detector.lens = Some(setup.intrinsics);
            eye.detector.regions.clone_from(&setup.regions);
            eye.detector.masks.clone_from(&setup.masks);
            eye.tracker.frame_rate_hz = setup.frame_rate_hz;
        }
        eye
    }
}

/// Both looks of one camera, one after the other.
pub struct CameraEye {
    first: FirstLook,
    second: SecondLook,
    balls: Vec<TrackedBall>,
}

impl CameraEye {
    /// An eye for frames of this size.
    pub fn new(camera: CameraId, config: EyeConfig, width_px: u32, height_px: u32) -> Self {
        Self {
            first: FirstLook::new(camera, &config, width_px, height_px),
            second: SecondLook::new(&config),
            balls: Vec::new(),
        }
    }

    /// Takes the next frame of the camera.
    ///
    /// # Errors
    /// A frame of another size.
    pub fn push(&mut self, frame: &Frame) -> Result<(), DetectionError> {
        let result = self.first.push(frame);
        self.look_again();
        result
    }

    /// The likeliest balls in flight, and what is to be added to their centres, pixels.
    pub fn open(&self) -> (Vec<OpenPath>, Vector2<f64>) {
        (self.first.open(), self.first.off_light_px())
    }

    /// See [`FirstLook::foresee`].
    pub fn foresee(&mut self, path: ForeseenPath) {
        self.first.foresee(path);
    }

    /// Ends the recording: what was still open is decided.
    pub fn finish(&mut self) {
        self.first.finish();
        self.look_again();
    }

    fn look_again(&mut self) {
        let open = self.first.open();
        for flying in self.first.flying(&open) {
            self.second.look_ahead(&flying);
        }
        for ended in self.first.drain() {
            let (ball, step) = self.second.look(ended);
            if let Some(step) = step {
                self.first.adapt(step);
            }
            self.balls.push(ball);
        }
    }

    /// Everything smooth that moved since the last call, with its kind.
    pub fn drain_balls(&mut self) -> Vec<TrackedBall> {
        std::mem::take(&mut self.balls)
    }

    /// The pitches since the last call; see [`SecondLook::pitches`].
    pub fn drain_pitches(&mut self) -> Vec<Track> {
        let balls = self.drain_balls();
        self.second.pitches(balls)
    }

    /// What was seen and left out.
    pub fn counters(&self) -> (DetectorCounters, TrackerCounters) {
        self.first.counters()
    }
}

#[cfg(test)]
mod tests;
