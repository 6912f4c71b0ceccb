//! Plain text for the terminal: one line a pitch, one line a camera.

use crate::flight::MPH_MPS;
use crate::scene::{Calibration, Pitch, Rig};

use super::statcast::{PlatePlane, quality_name};

const TEXT_COLUMNS: [&str; 3] = ["camera", "quality", ""];

/// The pitches, aligned, with a heading; plate positions at `plane`, in cm with 1σ in mm.
pub fn pitches(pitches: &[Pitch], plane: PlatePlane) -> String {
    let heading = [
        "pitch",
        "speed mph",
        "±",
        "plate x cm",
        "plate z cm",
        "± x mm",
        "± z mm",
        "strike",
        "cameras",
        "points",
        "rms px",
        "quality",
    ];
    let rows = pitches.iter().map(|pitch| {
        let [x_m, z_m] = plane.crossing_m(pitch);
        let [sigma_x_m, sigma_z_m] = plane.sigma_m(pitch);
        let reasons = if pitch.reasons.is_empty() {
            String::new()
        } else {
            format!(": {}", pitch.reasons.join("; "))
        };
        vec![
            pitch.pitch.to_string(),
            format!("{:.2}", pitch.release_speed_mps / MPH_MPS),
            format!("{:.2}", pitch.sigma.release_speed_mps / MPH_MPS),
            format!("{:.1}", 100.0 * x_m),
            format!("{:.1}", 100.0 * z_m),
            format!("{:.1}", 1e3 * sigma_x_m),
            format!("{:.1}", 1e3 * sigma_z_m),
            format!("{:.0} %", 100.0 * pitch.strike_probability),
            pitch.cameras.len().to_string(),
            pitch.points.values().sum::<usize>().to_string(),
            format!("{:.2}", pitch.reprojection_rms_px),
            format!("{}{reasons}", quality_name(pitch.quality)),
        ]
    });
    aligned(&heading, rows.collect())
}

/// One line a camera: delay with 1σ in milliseconds and frames, clock, residuals.
pub fn cameras(calibration: &Calibration, rig: &Rig) -> String {
    let heading = [
        "camera",
        "delay ms",
        "± ms",
        "frames",
        "± frames",
        "skew ppm",
        "rms px",
        "noise px",
        "points",
        "",
    ];
    let rows = calibration.cameras.iter().map(|camera| {
        let rate_hz = rig.camera(&camera.id).map(|setup| setup.frame_rate_hz);
        let frames = |seconds: f64| rate_hz.map_or(String::new(), |rate| format!("{:.4}", seconds * rate));
        let is_reference = camera.id == calibration.reference;
        vec![
            camera.id.to_string(),
            format!("{:.4}", 1e3 * camera.capture_delay_s),
            format!("{:.4}", 1e3 * camera.capture_delay_sigma_s),
            frames(camera.capture_delay_s),
            frames(camera.capture_delay_sigma_s),
            format!("{:.2}", camera.clock_skew_ppm),
            format!("{:.3}", camera.reprojection_rms_px),
            format!("{:.3}", camera.noise_sigma_px),
            camera.points.to_string(),
            if is_reference {
                "reference".to_owned()
            } else {
                String::new()
            },
        ]
    });
    aligned(&heading, rows.collect())
}

/// Columns padded to their widest cell; numbers to the right, the columns of `TEXT_COLUMNS` to the left.
fn aligned(heading: &[&str], rows: Vec<Vec<String>>) -> String {
    let mut all: Vec<Vec<String>> = vec![heading.iter().map(|h| (*h).to_owned()).collect()];
    all.extend(rows);
    let widths: Vec<usize> = (0..heading.len())
        .map(|i| {
            all.iter()
                .filter_map(|row| row.get(i))
                .map(|c| c.chars().count())
                .max()
                .unwrap_or(0)
        })
        .collect();
    let mut text = String::new();
    for row in &all {
        let mut line = String::new();
        for (i, (cell, width)) in row.iter().zip(&widths).enumerate() {
            if i > 0 {
                line += "  ";
            }
            line += &if heading.get(i).is_some_and(|h| TEXT_COLUMNS.contains(h)) {
                format!("{cell:<width$}")
            } else {
                format!("{cell:>width$}")
            };
        }
        text += line.trim_end();
        text.push('\n');
    }
    text
}
