//! `report.html`: one page, no outside resources, for the operator and the analyst.

mod cameras;
mod chart;
mod conventions;
mod cost_trace;
mod flights;
mod free;
mod html;
mod page;
mod pitch_tables;
mod residuals;
mod strike_zone;

use crate::flight::MPH_MPS;
use crate::scene::{Calibration, CameraId, Pitch, PitchQuality, Rig, WorldFrame};

use super::date::UtcDate;
use super::statcast::PlatePlane;
pub use free::{FreeReportInput, TrajectoryRow, free_html};
use html::{count, escape, median, number};

/// One reprojection residual (predicted − observed).
#[derive(Debug, Clone, PartialEq)]
pub struct Residual {
    /// Camera.
    pub camera: CameraId,
    /// Pitch number; 0 for a motion that is no pitch.
    pub pitch: u32,
    /// Reference camera's true time, seconds: within the pitch's flight; of a free motion since any fixed instant.
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
    let calibration = input.calibration;
    let at_home = calibration.world == WorldFrame::HomePlate;
    let mut body = head(input);
    body += &warnings(input);
    body += &key_figures(input);
    body += "<section><h2>Pitches</h2>\n";
    if input.pitches.is_empty() {
        body += "<p class=\"empty\">No pitch was solved.</p>\n";
    } else {
        body += &pitch_tables::pitches(input.pitches);
    }
    body += "</section>\n";
    if at_home && !input.pitches.is_empty() {
        body += "<section><h2>Where they went</h2>\n<div class=\"views\">";
        body += &strike_zone::plot(input.pitches);
        body += "<div class=\"stack\">";
        body += &flights::plots(input.pitches, input.rig.site.field);
        body += "</div></div></section>\n";
    }
    if !input.pitches.is_empty() {
        body += "<section><h2>How they were measured</h2>\n";
        body += &pitch_tables::measured(input.pitches);
        body += "</section>\n";
    }
    body += &camera_section(calibration, input.rig, (input.residuals, input.pitches));
    body += &conventions::of_pitches(calibration);
    page::page(&format!("{} · {}", input.title, input.rig.site.name), &body)
}

/// Delays, poses, residuals and, where there was one, the search.
fn camera_section(
    calibration: &Calibration,
    rig: &Rig,
    (residuals, pitches): (&[Residual], &[Pitch]),
) -> String {
    format!(
        "<section><h2>Cameras</h2>\n{}<div class=\"cards\">{}{}</div>\n{}</section>\n",
        cameras::delay_and_pose_table(calibration, rig),
        cameras::map(calibration, rig.site.field),
        residuals::cards(residuals, pitches, calibration),
        cost_trace::plot(calibration)
    )
}

fn head(input: &ReportInput<'_>) -> String {
    let headline = format!(
        "{} from {}",
        count(input.pitches.len(), "pitch", "pitches"),
        count(input.calibration.cameras.len(), "camera", "cameras")
    );
    let mut facts = page::facts(input.title, input.calibration);
    let start = input.pitches.iter().map(|p| p.release_time_ns).min();
    if let Some(when) = start.and_then(UtcDate::from_unix_nanos) {
        facts.push((
            "First pitch".to_owned(),
            format!("{} {} UTC", when.day(), when.time()),
        ));
    }
    facts.extend_from_slice(input.facts);
    page::head(&input.rig.site.name, &headline, &facts)
}

/// Warnings before any number.
fn warnings(input: &ReportInput<'_>) -> String {
    let mut all: Vec<String> = input
        .calibration
        .warnings
        .iter()
        .chain(input.warnings)
        .map(|w| escape(w))
        .collect();
    all.dedup();
    for (quality, what) in [
        (PitchQuality::Poor, "not to be used"),
        (PitchQuality::Degraded, "weaker than the rest"),
    ] {
        let numbers: Vec<String> = input
            .pitches
            .iter()
            .filter(|p| p.quality == quality)
            .map(|p| format!("<a href=\"#pitch-{0}\">{0}</a>", p.pitch))
            .collect();
        if !numbers.is_empty() {
            let noun = if numbers.len() == 1 { "Pitch" } else { "Pitches" };
            all.push(format!(
                "{noun} {}: {what}; the table says why.",
                numbers.join(", ")
            ));
        }
    }
    page::warnings(&all)
}

/// The few numbers that tell how good the session is.
fn key_figures(input: &ReportInput<'_>) -> String {
    let good = input
        .pitches
        .iter()
        .filter(|p| p.quality == PitchQuality::Good)
        .count();
    let middle = |of: fn(&Pitch) -> f64, decimals: usize| {
        median(input.pitches.iter().map(of)).map_or("–".to_owned(), |v| number(v, decimals))
    };
    let delays = input
        .calibration
        .cameras
        .iter()
        .filter(|c| c.id != input.calibration.reference);
    let worst_delay_us = delays
        .map(|c| 1e6 * c.capture_delay_sigma_s)
        .filter(|sigma| *sigma > 0.0)
        .fold(f64::NAN, f64::max);
    let (location, speed) = if input.calibration.covariance.is_empty() {
        (
            "plate location x, z, median 1σ, calibration taken as exact",
            "release speed, median 1σ, calibration taken as exact",
        )
    } else {
        ("plate location x, z, median 1σ", "release speed, median 1σ")
    };
    let tiles = [
        (
            format!("{good} <small>of {}</small>", input.pitches.len()),
            "good pitches",
        ),
        (
            format!(
                "± {}, {} <small>mm</small>",
                middle(|p| 1e3 * p.sigma.plate_mid_m[0], 1),
                middle(|p| 1e3 * p.sigma.plate_mid_m[1], 1)
            ),
            location,
        ),
        (
            format!(
                "± {} <small>mph</small>",
                middle(|p| p.sigma.release_speed_mps / MPH_MPS, 2)
            ),
            speed,
        ),
        (
            format!("± {} <small>µs</small>", number(worst_delay_us, 1)),
            "delay, worst camera, 1σ",
        ),
        (
            format!("{} <small>px</small>", middle(|p| p.reprojection_rms_px, 2)),
            "reprojection, median rms",
        ),
    ];
    page::tiles(&tiles)
}

#[cfg(test)]
mod tests;
