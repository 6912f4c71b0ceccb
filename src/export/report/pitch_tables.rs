//! The pitches as tables: what was thrown, and how well it was measured.

use crate::flight::{FOOT_M, MPH_MPS};
use crate::scene::Pitch;

use super::super::statcast::quality_name;
use super::html::{Column, escape, number, table};
use super::strike_zone::call_class;

const INCH_M: f64 = FOOT_M / 12.0;

const PITCHES: [Column; 9] = [
    Column::words("Pitch", "", "Number in the session"),
    Column::numbers("Speed", "mph", "At the release plane, with 1σ"),
    Column::words(
        "Call",
        "probability, margin",
        "Probability of a strike, and how far the ball's surface reaches into the zone (negative: misses it)",
    ),
    Column::numbers("Plate x", "cm (in)", "At mid-plate, to the catcher's right"),
    Column::numbers("Plate z", "cm (in)", "At mid-plate, above the ground"),
    Column::numbers("± x, z", "mm", "1σ of the location at mid-plate"),
    Column::numbers(
        "Break x, z",
        "in",
        "Movement pfx from release to the plate, without gravity",
    ),
    Column::numbers("Speed", "m/s", "At the release plane, with 1σ"),
    Column::words("Quality", "", "How far to trust the pitch, and why not further"),
];

/// What was thrown.
pub(super) fn pitches(pitches: &[Pitch]) -> String {
    let rows: Vec<Vec<String>> = pitches.iter().map(pitch_row).collect();
    table("Pitches", &PITCHES, &rows)
}

fn pitch_row(pitch: &Pitch) -> Vec<String> {
    let [x, z] = pitch.plate_mid_m;
    let [sigma_x, sigma_z] = pitch.sigma.plate_mid_m;
    let location = |v: f64| format!("{} <i>({})</i>", number(100.0 * v, 1), number(v / INCH_M, 1));
    let speed = |unit: f64| {
        format!(
            "{} <i>± {}</i>",
            number(pitch.release_speed_mps / unit, 2),
            number(pitch.sigma.release_speed_mps / unit, 2)
        )
    };
    let movement = |name: &str| {
        pitch
            .statcast
            .get(name)
            .map_or("–".to_owned(), |ft| number(12.0 * ft, 1))
    };
    let likelier = if call_class(pitch) == "strike" {
        ("strike", pitch.strike_probability)
    } else {
        ("ball", 1.0 - pitch.strike_probability)
    };
    vec![
        format!("<span id=\"pitch-{}\">{}</span>", pitch.pitch, pitch.pitch),
        speed(MPH_MPS),
        format!(
            "<span class=\"key {}\">{}</span> {} <i>{} mm</i>",
            likelier.0,
            likelier.0,
            percent(likelier.1),
            signed(1e3 * pitch.strike_margin_m)
        ),
        location(x),
        location(z),
        format!("{}, {}", number(1e3 * sigma_x, 1), number(1e3 * sigma_z, 1)),
        format!("{}, {}", movement("pfx_x"), movement("pfx_z")),
        speed(1.0),
        quality(pitch),
    ]
}

/// Never rounds to certainty.
fn percent(share: f64) -> String {
    match share {
        s if !s.is_finite() => "–".to_owned(),
        s if s >= 0.9995 => "&gt; 99.9 %".to_owned(),
        s => format!("{} %", number(100.0 * s, 1)),
    }
}

fn signed(value: f64) -> String {
    let text = number(value, 0);
    if value > 0.0 && text != "0" {
        format!("+{text}")
    } else {
        text
    }
}

fn quality(pitch: &Pitch) -> String {
    let name = quality_name(pitch.quality);
    let reasons: Vec<String> = pitch.reasons.iter().map(|r| escape(r)).collect();
    let why = if reasons.is_empty() {
        String::new()
    } else {
        format!("<br><span class=\"why\">{}</span>", reasons.join("<br>"))
    };
    format!("<span class=\"quality {name}\">{name}</span>{why}")
}

const MEASURED: [Column; 9] = [
    Column::words("Pitch", "", "Number in the session"),
    Column::numbers(
        "Time",
        "s",
        "Release after the first pitch's, on the reference camera's clock",
    ),
    Column::numbers(
        "Release x, y, z",
        "m",
        "Position at the release plane, with 1σ in mm",
    ),
    Column::numbers("Plate front x, z", "cm", "At y = 17/12 ft, with 1σ in mm"),
    Column::numbers("Flight", "s", "Release plane to the plate's front"),
    Column::numbers("Drag", "C<sub>d</sub>", "Drag coefficient with 1σ"),
    Column::numbers("First seen", "y, m", "Where the first camera saw it first"),
    Column::words("Points", "kept (left out)", "Per camera"),
    Column::numbers(
        "RMS",
        "px",
        "Root mean square reprojection error of the points kept",
    ),
];

/// How well it was measured.
pub(super) fn measured(pitches: &[Pitch]) -> String {
    let start_ns = pitches.iter().map(|p| p.release_time_ns).min().unwrap_or(0);
    let rows: Vec<Vec<String>> = pitches.iter().map(|p| measured_row(p, start_ns)).collect();
    table("How each pitch was measured", &MEASURED, &rows)
}

fn measured_row(pitch: &Pitch, start_ns: i64) -> Vec<String> {
    let list = |values: &[f64], unit: f64, decimals: usize| {
        values
            .iter()
            .map(|v| number(v * unit, decimals))
            .collect::<Vec<_>>()
            .join(", ")
    };
    let points: Vec<String> = pitch
        .cameras
        .iter()
        .map(|camera| {
            let kept = pitch.points.get(camera).copied().unwrap_or(0);
            let left_out = pitch.outliers.get(camera).copied().unwrap_or(0);
            let note = if left_out > 0 {
                format!(" ({left_out})")
            } else {
                String::new()
            };
            format!("{} {kept}{note}", escape(camera.as_str()))
        })
        .collect();
    let seconds = |from: i64, to: i64| to.saturating_sub(from) as f64 / 1e9;
    vec![
        pitch.pitch.to_string(),
        number(seconds(start_ns, pitch.release_time_ns), 2),
        format!(
            "{}<br><i>± {} mm</i>",
            list(&pitch.release_m, 1.0, 3),
            list(&pitch.sigma.release_m, 1e3, 1)
        ),
        format!(
            "{}<br><i>± {} mm</i>",
            list(&pitch.plate_front_m, 100.0, 1),
            list(&pitch.sigma.plate_front_m, 1e3, 1)
        ),
        number(seconds(pitch.release_time_ns, pitch.plate_time_ns), 4),
        format!(
            "{} <i>± {}</i>",
            number(pitch.drag_coefficient[0], 3),
            number(pitch.drag_coefficient[1], 3)
        ),
        number(pitch.first_seen_y_m, 2),
        points.join("<br>"),
        number(pitch.reprojection_rms_px, 3),
    ]
}
