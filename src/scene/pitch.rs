//! A pitch: one flight and its numbers (`pitches.jsonl`).

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::CameraId;

/// How far to trust a pitch.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PitchQuality {
    /// Nothing to say against it.
    Good,
    /// Usable; `reasons` say what is weak.
    Degraded,
    /// Do not use; `reasons` say why.
    Poor,
}

/// 1σ of the pitch's numbers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PitchSigma {
    /// Release position, metres.
    pub release_m: [f64; 3],
    /// Release velocity, m/s.
    pub release_velocity_mps: [f64; 3],
    /// Release speed, m/s.
    pub release_speed_mps: f64,
    /// x and z at the front of the plate, metres.
    pub plate_front_m: [f64; 2],
    /// x and z at the middle of the plate, metres.
    pub plate_mid_m: [f64; 2],
    /// Velocity at the front of the plate, m/s.
    pub plate_velocity_mps: [f64; 3],
    /// Time at the front of the plate, seconds.
    pub plate_time_s: f64,
    /// Movement pfx_x, pfx_z, metres.
    pub pfx_m: [f64; 2],
}

/// A point of the flight.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FlightSample {
    /// Reference camera's true time, nanoseconds.
    pub time_ns: i64,
    /// Home-plate frame, metres.
    pub position_m: [f64; 3],
    /// 1σ per axis, metres.
    pub sigma_m: [f64; 3],
}

/// Statcast columns by name, in Statcast's units (domain §4). A plain map keeps the file open to new columns.
pub type StatcastRow = BTreeMap<String, f64>;

/// One line of `pitches.jsonl` (design §5).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Pitch {
    /// Number in the session, from 1.
    pub pitch: u32,
    /// Cameras whose points went in.
    pub cameras: Vec<CameraId>,
    /// Reference camera's true time at `release_m`, nanoseconds.
    pub release_time_ns: i64,
    /// Reference camera's true time at the front of the plate (y = 17/12 ft), nanoseconds.
    pub plate_time_ns: i64,
    /// Position at the release plane y, metres.
    pub release_m: [f64; 3],
    /// Velocity there, m/s.
    pub release_velocity_mps: [f64; 3],
    /// Speed there, m/s.
    pub release_speed_mps: f64,
    /// y of the release plane, metres: 54.5 ft, or the detected release where it was seen.
    pub release_y_m: f64,
    /// First point any camera saw: y, metres.
    pub first_seen_y_m: f64,
    /// x and z at y = 17/12 ft, metres.
    pub plate_front_m: [f64; 2],
    /// x and z at y = 8.5/12 ft, metres.
    pub plate_mid_m: [f64; 2],
    /// Velocity at y = 17/12 ft, m/s.
    pub plate_velocity_mps: [f64; 3],
    /// 1σ of the above.
    pub sigma: PitchSigma,
    /// Covariance of (plate_mid x, plate_mid z), m².
    pub plate_mid_covariance_m2: [[f64; 2]; 2],
    /// Distance from the ball's surface to the zone's edge at mid-plate, metres; positive: a strike by that much.
    pub strike_margin_m: f64,
    /// Probability that any of the ball touches the zone.
    pub strike_probability: f64,
    /// Drag coefficient and its 1σ.
    pub drag_coefficient: [f64; 2],
    /// Samples at the reference camera's frame rate, from the first point seen to the plate's back tip.
    pub flight: Vec<FlightSample>,
    /// Statcast columns.
    pub statcast: StatcastRow,
    /// Root mean square reprojection error over all points kept, pixels.
    pub reprojection_rms_px: f64,
    /// Points kept per camera.
    pub points: BTreeMap<CameraId, usize>,
    /// Points left out as outliers per camera.
    pub outliers: BTreeMap<CameraId, usize>,
    /// Version of the calibration used.
    pub calibration_version: u32,
    /// Trust.
    pub quality: PitchQuality,
    /// What is weak, in words.
    pub reasons: Vec<String>,
}

/// A ball still in flight, as it is published: where it was last seen, and where it will cross the front of the plate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Outlook {
    /// Cameras whose points went in.
    pub cameras: Vec<CameraId>,
    /// Points that went in.
    pub points: usize,
    /// Reference camera's true time of the newest point, nanoseconds.
    pub time_ns: i64,
    /// Position then, metres.
    pub position_m: [f64; 3],
    /// 1σ of it, metres.
    pub position_sigma_m: [f64; 3],
    /// Velocity then, m/s.
    pub velocity_mps: [f64; 3],
    /// Reference camera's true time at which it will cross the front of the plate (y = 17/12 ft), nanoseconds.
    pub plate_time_ns: i64,
    /// 1σ of it, seconds.
    pub plate_time_sigma_s: f64,
    /// x and z there, metres.
    pub plate_front_m: [f64; 2],
    /// 1σ of them, metres.
    pub plate_front_sigma_m: [f64; 2],
    /// Speed there, m/s.
    pub plate_speed_mps: f64,
}
