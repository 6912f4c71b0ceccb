//! When each camera exposes: the stamped grid, its true times, lost frames and bad stamps.

use rand::Rng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;

use super::scenario::{CameraSpec, Scenario};
use crate::time::{CameraTiming, StampedMidpoint};

/// What a random stream is for; streams of different purposes never share numbers.
#[derive(Debug, Clone, Copy)]
pub(super) enum Purpose {
    Frame = 1,
    Detection = 2,
    Landmarks = 3,
    Survey = 4,
    Clutter = 5,
    Scenery = 6,
    PixelNoise = 7,
}

/// A random stream of its own for (seed, purpose, a, b): products do not change each other's numbers.
pub(super) fn stream(seed: u64, purpose: Purpose, a: u64, b: u64) -> Pcg64Mcg {
    let mut state = seed;
    for word in [purpose as u64, a, b] {
        // SplitMix64 between words.
        state = state.wrapping_add(word).wrapping_add(0x9e37_79b9_7f4a_7c15);
        state = (state ^ (state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        state = (state ^ (state >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        state ^= state >> 31;
    }
    Pcg64Mcg::new((u128::from(state) << 64) | u128::from(state.rotate_left(17) ^ seed) | 1)
}

/// One exposure.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Exposure {
    /// Frame number, from 0 at the session's begin.
    pub frame: u64,
    /// Midpoint by the stamps, as the frame carries it: with jitter, perhaps its predecessor's.
    pub stamped: StampedMidpoint,
    /// True midpoint (of the middle row), seconds after the epoch.
    pub true_s: f64,
    /// Never reached the host.
    pub lost: bool,
}

/// The exposures of one camera.
#[derive(Debug, Clone)]
pub struct CameraClock {
    timing: CameraTiming,
    epoch_ns: i64,
    rate_hz: f64,
    first_stamp_s: f64,
    jitter_s: f64,
    drop_probability: f64,
    repeat_stamp_probability: f64,
    seed: u64,
    camera: u64,
}

impl CameraClock {
    /// The clock of camera `index`.
    pub fn new(scenario: &Scenario, index: usize, camera: &CameraSpec) -> Self {
        // Frame 0 lies near true time 0 however far off the clock is.
        let whole_frames = (camera.clock_offset_s * camera.frame_rate_hz).round();
        Self {
            timing: timing(scenario, camera),
            epoch_ns: scenario.epoch_ns,
            rate_hz: camera.frame_rate_hz,
            first_stamp_s: camera.stamp_phase_s + whole_frames / camera.frame_rate_hz,
            jitter_s: camera.jitter_s,
            drop_probability: camera.drop_probability,
            repeat_stamp_probability: camera.repeat_stamp_probability,
            seed: scenario.seed,
            camera: index as u64,
        }
    }

    /// The true relation of stamps to true time.
    pub fn timing(&self) -> &CameraTiming {
        &self.timing
    }

    /// Midpoint on the camera's grid, free of jitter.
    fn grid(&self, frame: u64) -> StampedMidpoint {
        StampedMidpoint::from_seconds_since(self.epoch_ns, self.first_stamp_s + frame as f64 / self.rate_hz)
    }

    /// True midpoint of a frame for a point in row `row_px`, seconds after the epoch.
    pub fn true_s(&self, frame: u64, row_px: f64) -> f64 {
        self.timing.true_seconds(self.grid(frame), row_px, self.epoch_ns)
    }

    /// The exposure with that number.
    pub fn exposure(&self, frame: u64) -> Exposure {
        let mut rng = stream(self.seed, Purpose::Frame, self.camera, frame);
        let lost = rng.random::<f64>() < self.drop_probability;
        let repeats = rng.random::<f64>() < self.repeat_stamp_probability && frame > 0;
        let stamped = if repeats {
            self.jittered(frame - 1)
        } else {
            self.jittered(frame)
        };
        let middle_row = 0.5 * (f64::from(self.timing.height_px) - 1.0);
        Exposure {
            frame,
            stamped,
            true_s: self.true_s(frame, middle_row),
            lost,
        }
    }

    fn jittered(&self, frame: u64) -> StampedMidpoint {
        let mut rng = stream(self.seed, Purpose::Frame, self.camera | 1 << 40, frame);
        let error: f64 = StandardNormal.sample(&mut rng);
        let shift_ns = (error * self.jitter_s * 1e9).round() as i64;
        StampedMidpoint::from_nanos(self.grid(frame).nanos() + shift_ns)
    }

    /// Frames whose true midpoints (of any row) lie within a span, seconds after the epoch.
    pub fn frames_within(&self, begin_s: f64, end_s: f64) -> std::ops::Range<u64> {
        // stamped − epoch = (true + τ)/(1 − skew); a frame more at either end for rows and rounding.
        let frame_at = |true_s: f64| {
            let skew = 1e-6 * self.timing.clock_skew_ppm;
            let stamp = (true_s + self.timing.capture_delay_s) / (1.0 - skew);
            (stamp - self.first_stamp_s) * self.rate_hz
        };
        let slack = 1.0 + self.timing.readout_s * self.rate_hz;
        let first = (frame_at(begin_s) - slack).floor().max(0.0) as u64;
        let last = (frame_at(end_s) + slack).ceil().max(0.0) as u64;
        first..last + 1
    }
}

/// The true clock relation of a camera.
pub(super) fn timing(scenario: &Scenario, camera: &CameraSpec) -> CameraTiming {
    CameraTiming {
        capture_delay_s: camera.total_delay_s(),
        clock_skew_ppm: camera.clock_skew_ppm,
        skew_epoch_ns: scenario.epoch_ns,
        readout_s: camera.readout_s,
        height_px: camera.height_px,
    }
}
