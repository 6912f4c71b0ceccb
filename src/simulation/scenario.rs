//! The scenario: everything a simulated session is made from. One TOML file, or built by a program.
//!
//! Lengths in metres of the home-plate frame, times in seconds, angles in degrees. `start_s` and all other
//! instants count from `epoch_ns` on the reference camera's true time.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::error::SimulationError;
use super::options::{ClutterSpec, DetectionNoise, LandmarkClicks, RenderOptions};
use crate::geometry::{Intrinsics, Pose};
use crate::scene::{CameraId, FieldPreset};

/// A whole simulated session.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scenario {
    /// Everything random follows from it.
    #[serde(default = "one")]
    pub seed: u64,
    /// True time 0 of the session, nanoseconds (Unix).
    #[serde(default = "default_epoch_ns")]
    pub epoch_ns: i64,
    /// The place.
    #[serde(default)]
    pub site: SiteSpec,
    /// Cameras; the first is the reference unless another says `reference = true`.
    #[serde(rename = "camera")]
    pub cameras: Vec<CameraSpec>,
    /// Pitches, by rising start.
    #[serde(rename = "pitch", default)]
    pub pitches: Vec<PitchSpec>,
    /// Balls that are no pitches: throws back, pick-offs.
    #[serde(rename = "throw", default)]
    pub throws: Vec<PitchSpec>,
    /// Pitches in Statcast numbers, from a file.
    #[serde(default)]
    pub pitch_file: Option<PitchFile>,
    /// What a 2-D detector adds to the true centres.
    #[serde(default)]
    pub detection: DetectionNoise,
    /// Landmarks as a person would click them.
    #[serde(default)]
    pub landmarks: LandmarkClicks,
    /// False tracks.
    #[serde(default)]
    pub clutter: ClutterSpec,
    /// Pictures.
    #[serde(default)]
    pub render: RenderOptions,
}

/// The place.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SiteSpec {
    /// For people.
    pub name: String,
    /// Landmarks.
    pub field: FieldPreset,
    /// m/s².
    pub gravity_mps2: f64,
    /// kg/m³ (domain §2).
    pub air_density_kgpm3: f64,
    /// Uniform wind, m/s.
    pub wind_mps: [f64; 3],
}

impl Default for SiteSpec {
    fn default() -> Self {
        Self {
            name: "Simulated park".to_owned(),
            field: FieldPreset::Professional,
            gravity_mps2: 9.80665,
            air_density_kgpm3: 1.194,
            wind_mps: [0.0; 3],
        }
    }
}

/// One camera.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraSpec {
    /// Name.
    pub id: CameraId,
    /// τ = 0 here. At most one; none: the first camera.
    #[serde(default)]
    pub reference: bool,
    /// Columns.
    pub width_px: u32,
    /// Rows.
    pub height_px: u32,
    /// By the camera's own clock, Hz.
    pub frame_rate_hz: f64,
    /// Exposure time, seconds.
    #[serde(default = "one_millisecond")]
    pub exposure_s: f64,
    /// The true lens, which the rig file also gets.
    pub intrinsics: Intrinsics,
    /// Centre, metres.
    pub position_m: [f64; 3],
    /// Seen in the picture's middle, metres.
    pub look_at_m: [f64; 3],
    /// Turn about the optical axis, degrees; positive: the picture turns anticlockwise.
    #[serde(default)]
    pub roll_deg: f64,
    /// τ in seconds (true = stamped − τ).
    #[serde(default)]
    pub capture_delay_s: f64,
    /// τ in frames of this camera, added to the seconds.
    #[serde(default)]
    pub capture_delay_frames: f64,
    /// Constant error of the camera's clock, seconds, added to τ: for stamps that are off by whole seconds.
    #[serde(default)]
    pub clock_offset_s: f64,
    /// Positive: the camera's clock runs fast.
    #[serde(default)]
    pub clock_skew_ppm: f64,
    /// First stamped midpoint after the epoch, seconds: where in the frame period this camera's grid lies.
    #[serde(default)]
    pub stamp_phase_s: f64,
    /// 1σ of the stamps, seconds.
    #[serde(default)]
    pub jitter_s: f64,
    /// Chance that a frame is lost.
    #[serde(default)]
    pub drop_probability: f64,
    /// Chance that a frame carries its predecessor's stamp.
    #[serde(default)]
    pub repeat_stamp_probability: f64,
    /// Rolling-shutter readout of the whole frame, seconds; 0: global shutter.
    #[serde(default)]
    pub readout_s: f64,
    /// `time_offset_s` of the rig file is −τ plus this error, seconds; none: the rig file gives no offset.
    #[serde(default)]
    pub rough_offset_error_s: Option<f64>,
    /// 1σ of a surveyed position for the rig file, metres; none: no position given.
    #[serde(default)]
    pub survey_sigma_m: Option<f64>,
}

impl CameraSpec {
    /// The true pose.
    pub fn pose(&self) -> Pose {
        let level = Pose::looking_at(self.position_m.into(), self.look_at_m.into());
        let turn = nalgebra::Vector3::new(0.0, 0.0, self.roll_deg.to_radians());
        level.perturbed(&[turn.x, turn.y, turn.z, 0.0, 0.0, 0.0])
    }

    /// Whole τ, seconds.
    pub fn total_delay_s(&self) -> f64 {
        self.capture_delay_s + self.capture_delay_frames / self.frame_rate_hz + self.clock_offset_s
    }

    /// The same camera with this delay in frames and no other.
    #[must_use]
    pub fn with_delay_frames(mut self, frames: f64) -> Self {
        self.capture_delay_s = 0.0;
        self.clock_offset_s = 0.0;
        self.capture_delay_frames = frames;
        self
    }
}

/// How the flight is made.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FlightLaw {
    /// Gravity, drag and Magnus or other transverse force, by RK4.
    #[default]
    Physics,
    /// The nine numbers as they stand (`statcast` only).
    ConstantAcceleration,
}

/// Nine numbers at y = 50 ft, feet and seconds (domain §4).
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)]
pub struct NineNumbers {
    pub x0: f64,
    pub z0: f64,
    pub vx0: f64,
    pub vy0: f64,
    pub vz0: f64,
    pub ax: f64,
    pub ay: f64,
    pub az: f64,
    /// y of the release, feet.
    #[serde(default = "default_release_y_ft")]
    pub release_pos_y: f64,
}

/// The unsteady transverse force of a knuckleball: lift coefficients that swing while the ball turns slowly.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Knuckle {
    /// Amplitude of the lift coefficient, sideways and vertical.
    pub amplitude: [f64; 2],
    /// Swings per second.
    pub frequency_hz: f64,
    /// Phase at release, degrees, sideways and vertical.
    #[serde(default)]
    pub phase_deg: [f64; 2],
}

/// One thrown ball. Give `velocity_mps`, or `speed_mps` with `target_m`, or `statcast`.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PitchSpec {
    /// For people: FF, SL, …
    pub name: String,
    /// Release, seconds after the epoch; none: `5 + 15·i`.
    pub start_s: Option<f64>,
    /// Release position, metres.
    pub release_m: Option<[f64; 3]>,
    /// Release velocity, m/s.
    pub velocity_mps: Option<[f64; 3]>,
    /// Release speed, m/s; the direction is found so that the ball meets `target_m`.
    pub speed_mps: Option<f64>,
    /// x and z at the target plane (y = 17/12 ft, or `target_y_m`), metres.
    pub target_m: Option<[f64; 2]>,
    /// Plane of the target, y in metres.
    pub target_y_m: Option<f64>,
    /// Spin vector, rpm, world axes (right-hand rule).
    pub spin_vector_rpm: Option<[f64; 3]>,
    /// Spin rate, rpm, with `spin_axis_deg` and `active_spin`.
    pub spin_rpm: Option<f64>,
    /// 180 pure backspin, 0 topspin, as the catcher sees the tilt (domain §4).
    pub spin_axis_deg: Option<f64>,
    /// Share of the spin that is across the flight; the rest is gyro spin. 0–1, none: 1.
    pub active_spin: Option<f64>,
    /// Drag coefficient; none: 0.297 + 0.0292·(rpm/1000).
    pub drag_coefficient: Option<f64>,
    /// Unsteady force.
    pub knuckle: Option<Knuckle>,
    /// Nine numbers.
    pub statcast: Option<NineNumbers>,
    /// Law of flight.
    pub model: FlightLaw,
    /// The flight ends at this y, metres; none: the catcher's glove, −0.45 m, for pitches.
    pub end_y_m: Option<f64>,
    /// The flight ends after this time, seconds, if it has not ended before.
    pub end_after_s: Option<f64>,
}

/// Pitches from a CSV file with Statcast columns.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PitchFile {
    /// File, relative to the scenario file.
    pub path: PathBuf,
    /// Rows to take, from 0; none: all.
    #[serde(default)]
    pub rows: Option<Vec<usize>>,
    /// Seconds between pitches.
    #[serde(default = "fifteen")]
    pub interval_s: f64,
    /// Law of flight.
    #[serde(default)]
    pub model: FlightLaw,
}

fn one() -> u64 {
    1
}
fn fifteen() -> f64 {
    15.0
}
fn default_epoch_ns() -> i64 {
    1_750_000_000_000_000_000
}
fn default_release_y_ft() -> f64 {
    54.5
}
fn one_millisecond() -> f64 {
    0.001
}

impl Scenario {
    /// A scenario of these cameras and pitches with defaults for everything else.
    pub fn new(cameras: Vec<CameraSpec>, pitches: Vec<PitchSpec>) -> Self {
        Self {
            seed: one(),
            epoch_ns: default_epoch_ns(),
            site: SiteSpec::default(),
            cameras,
            pitches,
            throws: Vec::new(),
            pitch_file: None,
            detection: DetectionNoise::default(),
            landmarks: LandmarkClicks::default(),
            clutter: ClutterSpec::default(),
            render: RenderOptions::default(),
        }
    }

    /// The same scenario with another seed.
    #[must_use]
    pub fn with_seed(mut self, seed: u64) -> Self {
        self.seed = seed;
        self
    }

    /// The same scenario with another detector.
    #[must_use]
    pub fn with_detection(mut self, detection: DetectionNoise) -> Self {
        self.detection = detection;
        self
    }

    /// Reads and checks a scenario file; a `pitch_file` is looked for beside it.
    pub fn from_path(path: &Path) -> Result<Self, SimulationError> {
        let text = std::fs::read_to_string(path).map_err(|source| SimulationError::Read {
            path: path.to_owned(),
            source,
        })?;
        Self::parse(path, &text)
    }

    /// Checks a scenario given as text; a `pitch_file` is looked for in the working folder.
    #[allow(clippy::should_implement_trait)]
    pub fn from_str(text: &str) -> Result<Self, SimulationError> {
        Self::parse(Path::new("scenario"), text)
    }

    fn parse(path: &Path, text: &str) -> Result<Self, SimulationError> {
        let mut scenario: Self = toml::from_str(text).map_err(|e| SimulationError::Parse {
            path: path.to_owned(),
            message: one_line(&e, text),
        })?;
        if let Some(file) = scenario.pitch_file.take() {
            let beside = path.parent().unwrap_or(Path::new("")).join(&file.path);
            let more = super::pitch_file::read(&beside, &file)?;
            scenario.pitches.extend(more);
        }
        scenario.check().map_err(|e| e.in_file(path))?;
        Ok(scenario)
    }

    /// Index of the reference camera.
    pub fn reference(&self) -> usize {
        self.cameras.iter().position(|c| c.reference).unwrap_or(0)
    }

    /// Release of pitch `index`, seconds after the epoch.
    pub fn start_s(&self, index: usize) -> f64 {
        let given = self.pitches.get(index).and_then(|p| p.start_s);
        given.unwrap_or(5.0 + 15.0 * index as f64)
    }
}

/// serde's message on one line with its place.
fn one_line(error: &toml::de::Error, text: &str) -> String {
    let message = error.message().replace('\n', " ");
    match error.span() {
        Some(span) => {
            let before = text.get(..span.start).unwrap_or("");
            let line = before.matches('\n').count() + 1;
            format!("line {line}: {message}")
        }
        None => message,
    }
}
