//! A calibration: poses, delays and the covariance of all of it (`calibration.json`).

use serde::{Deserialize, Serialize};

use super::CameraId;
use crate::geometry::{Intrinsics, Pose};
use crate::time::CameraTiming;

/// Which estimator made it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CalibrationMethod {
    /// One maximum-likelihood problem over everything.
    #[default]
    Joint,
    /// The paper's recipe.
    Kim2019,
}

/// Coordinates the poses are in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum WorldFrame {
    /// Home-plate frame, metres (domain §1).
    HomePlate,
    /// Origin at the reference camera. z up when gravity fixes it, else the camera's own axes;
    /// metres when a distance or gravity fixes the scale, else the first baseline is 1.
    ReferenceCamera,
}

/// What one row of the covariance is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ParameterKind {
    /// Rotation about camera x, y, z: x_c' = exp([ω]×)·x_c + υ; radians.
    RotationX,
    /// See `RotationX`.
    RotationY,
    /// See `RotationX`.
    RotationZ,
    /// Shift υ along camera x, y, z; metres.
    TranslationX,
    /// See `TranslationX`.
    TranslationY,
    /// See `TranslationX`.
    TranslationZ,
    /// Capture delay, seconds.
    CaptureDelay,
    /// Clock skew, ppm.
    ClockSkew,
    /// Rolling-shutter readout, seconds.
    Readout,
    /// Relative change of both focal lengths.
    FocalScale,
    /// Principal point, column, pixels.
    PrincipalX,
    /// Principal point, row, pixels.
    PrincipalY,
    /// First radial distortion coefficient.
    RadialK1,
    /// Second radial distortion coefficient.
    RadialK2,
}

/// One row and column of the covariance.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Parameter {
    /// Whose.
    pub camera: CameraId,
    /// What.
    pub kind: ParameterKind,
}

/// One camera's share.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CameraCalibration {
    /// Name.
    pub id: CameraId,
    /// Pose.
    pub camera_from_world: Pose,
    /// τ, seconds; true = stamped − τ.
    pub capture_delay_s: f64,
    /// 1σ of τ, seconds.
    pub capture_delay_sigma_s: f64,
    /// Positive: this camera's clock runs fast.
    pub clock_skew_ppm: f64,
    /// Stamp at which τ is stated, nanoseconds.
    pub skew_epoch_ns: i64,
    /// Whether the stamps that τ goes with were the network's (PTP) time, not the camera's own.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub network_clock: bool,
    /// Rolling-shutter readout, seconds; 0: global.
    pub readout_s: f64,
    /// The lens the poses go with.
    pub intrinsics: Intrinsics,
    /// Columns.
    pub width_px: u32,
    /// Rows.
    pub height_px: u32,
    /// Root mean square reprojection error (norm of the 2-D residual) of the points kept, pixels.
    pub reprojection_rms_px: f64,
    /// Points kept.
    pub points: usize,
    /// 1σ of one coordinate's noise as the residuals tell it, pixels.
    pub noise_sigma_px: f64,
    /// 1σ of the stamps' jitter as the residuals along the motion tell it, seconds.
    pub jitter_sigma_s: f64,
}

impl CameraCalibration {
    /// The camera's clock relation.
    pub fn timing(&self) -> CameraTiming {
        CameraTiming {
            capture_delay_s: self.capture_delay_s,
            clock_skew_ppm: self.clock_skew_ppm,
            skew_epoch_ns: self.skew_epoch_ns,
            readout_s: self.readout_s,
            height_px: self.height_px,
        }
    }
}

/// One step of the paper's search.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CostStep {
    /// Evaluation number.
    pub evaluation: usize,
    /// Delays tried, seconds, cameras in order without the reference.
    pub capture_delay_s: Vec<f64>,
    /// Mean reprojection error, pixels.
    pub cost_px: f64,
}

/// A published calibration. Immutable: a better one gets the next version.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// Version, from 1.
    pub version: u32,
    /// Estimator.
    pub method: CalibrationMethod,
    /// The camera with τ = 0.
    pub reference: CameraId,
    /// Coordinates.
    pub world: WorldFrame,
    /// Every camera that could be calibrated.
    pub cameras: Vec<CameraCalibration>,
    /// Rows of `covariance`.
    pub parameters: Vec<Parameter>,
    /// Covariance, row by row, in the parameters' units.
    pub covariance: Vec<Vec<f64>>,
    /// Condition number of the (diagonally scaled) normal matrix.
    pub condition: f64,
    /// Unit-weight variance: about 1 when the sigmas are honest.
    pub variance_factor: f64,
    /// Numbers of the pitches used.
    pub pitches_used: Vec<u32>,
    /// What a person must know: weak geometry, cameras left out, and why.
    pub warnings: Vec<String>,
    /// The paper's cost trace (`kim2019` only).
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub cost_trace: Vec<CostStep>,
}

impl Calibration {
    /// In the home-plate frame, the first camera the reference, without covariance: for tests.
    #[cfg(test)]
    pub fn without_covariance(cameras: Vec<CameraCalibration>) -> Self {
        Self {
            version: 1,
            method: CalibrationMethod::Joint,
            reference: cameras[0].id.clone(),
            world: WorldFrame::HomePlate,
            cameras,
            parameters: Vec::new(),
            covariance: Vec::new(),
            condition: 1.0,
            variance_factor: 1.0,
            pitches_used: Vec::new(),
            warnings: Vec::new(),
            cost_trace: Vec::new(),
        }
    }

    /// The calibration of one camera.
    pub fn camera(&self, id: &CameraId) -> Option<&CameraCalibration> {
        self.cameras.iter().find(|c| c.id == *id)
    }
}
