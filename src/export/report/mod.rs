//! `report.html`: one page, no outside resources, for the operator and the analyst.

use crate::scene::{Calibration, CameraId, Pitch, Rig};

use super::statcast::PlatePlane;

/// One reprojection residual (predicted − observed).
#[derive(Debug, Clone, PartialEq)]
pub struct Residual {
    /// Camera.
    pub camera: CameraId,
    /// Pitch number; 0 for a motion that is no pitch.
    pub pitch: u32,
    /// Reference camera's true time since any fixed instant of the session, seconds.
    pub time_s: f64,
    /// Predicted − observed column, pixels.
    pub dx_px: f64,
    /// Predicted − observed row, pixels.
    pub dy_px: f64,
    /// False: left out as an outlier.
    pub kept: bool,
}

/// Everything on the page.
#[derive(Debug, Clone, Copy)]
pub struct ReportInput<'a> {
    /// What was solved: a session's or folder's name.
    pub title: &'a str,
    /// Site, field and cameras as the rig file has them.
    pub rig: &'a Rig,
    /// The calibration used.
    pub calibration: &'a Calibration,
    /// Every pitch.
    pub pitches: &'a [Pitch],
    /// Residuals of every point, outliers too.
    pub residuals: &'a [Residual],
    /// What a person must know, besides `calibration.warnings`.
    pub warnings: &'a [String],
    /// More facts for the head of the page: name and value.
    pub facts: &'a [(String, String)],
    /// Where `plate_x` and `plate_z` of `pitches.csv` are stated.
    pub plane: PlatePlane,
}

/// The page.
pub fn html(input: &ReportInput<'_>) -> String {
    format!("<!doctype html><title>{}</title>", input.title)
}
