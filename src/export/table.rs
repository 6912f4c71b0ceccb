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

/// A flight of a world without a plate.
#[derive(Debug, Clone, PartialEq)]
pub struct FlightRow {
    /// Number, from 1.
    pub number: u32,
    /// True time of its first point, seconds after the first flight's.
    pub begin_s: f64,
    /// How long it was seen, seconds.
    pub seen_s: f64,
    /// Speed in the middle with its 1σ, m/s.
    pub speed_mps: (f64, f64),
    /// Points kept.
    pub points: usize,
    /// Residual rms, pixels.
    pub rms_px: f64,
}

/// The flights of a world without a plate, aligned, with a heading.
pub fn flights(rows: &[FlightRow]) -> String {
    let heading = ["flight", "at s", "seen s", "speed m/s", "±", "points", "rms px"];
    let rows = rows.iter().map(|row| {
        vec![
            row.number.to_string(),
            format!("{:.3}", row.begin_s),
            format!("{:.3}", row.seen_s),
            format!("{:.2}", row.speed_mps.0),
            format!("{:.2}", row.speed_mps.1),
            row.points.to_string(),
            format!("{:.2}", row.rms_px),
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
        // A method without an uncertainty leaves 0: no number is better than that one.
        let sigma_s = camera.capture_delay_sigma_s;
        let known = |text: String| {
            if is_reference || sigma_s > 0.0 {
                text
            } else {
                "-".to_owned()
            }
        };
        vec![
            camera.id.to_string(),
            format!("{:.4}", 1e3 * camera.capture_delay_s),
            known(format!("{:.4}", 1e3 * sigma_s)),
            frames(camera.capture_delay_s),
            known(frames(sigma_s)),
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

#[cfg(test)]
mod tests {
    use super::super::fixture;
    use super::*;

    #[test]
    fn pitches_line_up_below_their_headings() {
        let text = pitches(&fixture::pitches(), PlatePlane::Front);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 7);
        let end = |line: &str, word: &str| {
            let at = line.find(word).unwrap() + word.len();
            line[..at].chars().count()
        };
        assert_eq!(end(lines[0], "speed mph"), end(lines[1], "88.63"));
        // domain §4, first row: 0.314 ft = 9.6 cm, 2.784 ft = 84.9 cm at the front.
        assert_eq!(end(lines[0], "plate x cm"), end(lines[1], " 9.6"));
        assert_eq!(end(lines[0], "plate z cm"), end(lines[1], "84.9"));
        assert!(lines[2].ends_with("degraded: first points <late> & few"));
        assert!(lines.iter().all(|l| !l.ends_with(' ')));
        assert!(pitches(&fixture::pitches(), PlatePlane::Middle).contains(" 10.0 "));
    }

    #[test]
    fn cameras_tell_their_delay_in_both_units() {
        let text = cameras(&fixture::calibration(), &fixture::rig());
        let lines: Vec<&str> = text.lines().collect();
        assert!(lines[1].starts_with("first") && lines[1].ends_with("reference"));
        // 3.21 ms at 175 Hz.
        for word in ["third", "3.2100", "0.0120", "0.5618", "0.0021"] {
            assert!(lines[2].contains(word), "{}", lines[2]);
        }
    }

    #[test]
    fn a_delay_without_a_sigma_shows_none() {
        let mut calibration = fixture::calibration();
        calibration.cameras[1].capture_delay_sigma_s = 0.0;
        let text = cameras(&calibration, &fixture::rig());
        assert!(!text.lines().nth(2).unwrap().contains(" 0.0000"), "{text}");
    }

    #[test]
    fn nothing_is_a_heading_alone() {
        assert_eq!(pitches(&[], PlatePlane::Front).lines().count(), 1);
    }
}
