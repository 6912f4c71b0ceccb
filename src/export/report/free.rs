//! The page of a free motion (`motion = "free"`): one trajectory instead of pitches.

use crate::scene::{Calibration, Rig, WorldFrame};

use super::chart::{Chart, Margins, Scale};
use super::html::{count, escape, figure, median, number};
use super::{Residual, camera_section, conventions, page};

/// One row of `trajectory.csv`: the object at one frame of the reference camera.
#[derive(Debug, Clone, PartialEq)]
pub struct TrajectoryRow {
    /// Reference camera's true time, nanoseconds.
    pub time_ns: i64,
    /// World, metres (or baselines, where nothing fixes the scale).
    pub position_m: [f64; 3],
    /// 1σ per axis.
    pub sigma_m: [f64; 3],
    /// How many cameras saw the object then.
    pub cameras: u32,
}

/// Everything on the page.
#[derive(Debug, Clone, Copy)]
pub struct FreeReportInput<'a> {
    /// What was solved.
    pub title: &'a str,
    /// Site and cameras as the rig file has them.
    pub rig: &'a Rig,
    /// The calibration used.
    pub calibration: &'a Calibration,
    /// The trajectory by rising time; gaps where nobody saw enough.
    pub rows: &'a [TrajectoryRow],
    /// Residuals of every point, outliers too.
    pub residuals: &'a [Residual],
    /// What a person must know, besides `calibration.warnings`.
    pub warnings: &'a [String],
    /// More facts for the head of the page: name and value.
    pub facts: &'a [(String, String)],
}

/// The page.
pub fn free_html(input: &FreeReportInput<'_>) -> String {
    let calibration = input.calibration;
    let pieces = pieces(input.rows);
    let mut facts = page::facts(input.title, calibration);
    facts.extend_from_slice(input.facts);
    let headline = format!(
        "A trajectory of {} s from {}",
        number(span_s(input.rows), 1),
        count(calibration.cameras.len(), "camera", "cameras")
    );
    let warnings: Vec<String> = calibration
        .warnings
        .iter()
        .chain(input.warnings)
        .map(|w| escape(w))
        .collect();
    let mut body = page::head(&input.rig.site.name, &headline, &facts);
    body += &page::warnings(&warnings);
    body += &key_figures(input, pieces.len());
    body += "<section><h2>Where it went</h2>\n";
    if input.rows.is_empty() {
        body += "<p class=\"empty\">No part of the motion was solved.</p>\n";
    } else {
        body += "<div class=\"views even\">";
        // Without a plate or gravity nobody knows which way is up.
        let titles = match calibration.world {
            WorldFrame::HomePlate => ["From above", "From behind home plate"],
            WorldFrame::ReferenceCamera => ["First and second axis", "First and third axis"],
        };
        body += &plan(&pieces, calibration, ([0, 1], titles[0]));
        body += &plan(&pieces, calibration, ([0, 2], titles[1]));
        body += "</div>\n";
        body += &over_time(&pieces);
    }
    body += "</section>\n";
    body += &camera_section(calibration, input.rig, (input.residuals, &[]));
    body += &conventions::of_trajectory(calibration);
    page::page(&format!("{} · {}", input.title, input.rig.site.name), &body)
}

fn span_s(rows: &[TrajectoryRow]) -> f64 {
    match (rows.first(), rows.last()) {
        (Some(first), Some(last)) => last.time_ns.saturating_sub(first.time_ns) as f64 / 1e9,
        _ => 0.0,
    }
}

/// The rows cut where a gap is longer than five usual steps.
fn pieces(rows: &[TrajectoryRow]) -> Vec<&[TrajectoryRow]> {
    let step = |w: &[TrajectoryRow]| w[1].time_ns.saturating_sub(w[0].time_ns) as f64;
    let usual = median(rows.windows(2).map(step)).unwrap_or(0.0);
    let mut pieces = Vec::new();
    let mut rest = rows;
    while !rest.is_empty() {
        let cut = rest
            .windows(2)
            .position(|w| step(w) > 5.0 * usual)
            .map_or(rest.len(), |i| i + 1);
        let (piece, after) = rest.split_at(cut);
        pieces.push(piece);
        rest = after;
    }
    pieces
}

fn key_figures(input: &FreeReportInput<'_>, pieces: usize) -> String {
    let rows = input.rows;
    let length: f64 = rows
        .windows(2)
        .map(|w| {
            let [a, b] = [w[0].position_m, w[1].position_m];
            (0..3).map(|k| (b[k] - a[k]) * (b[k] - a[k])).sum::<f64>().sqrt()
        })
        .filter(|d| d.is_finite())
        .sum();
    let sigma = median(
        rows.iter()
            .map(|r| r.sigma_m.iter().map(|s| s * s).sum::<f64>().sqrt()),
    );
    let delays = input
        .calibration
        .cameras
        .iter()
        .filter(|c| c.id != input.calibration.reference);
    let delay_us = delays
        .map(|c| 1e6 * c.capture_delay_sigma_s)
        .filter(|sigma| *sigma > 0.0)
        .fold(f64::NAN, f64::max);
    let rms = median(input.calibration.cameras.iter().map(|c| c.reprojection_rms_px));
    let or_dash = |value: Option<f64>, decimals| value.map_or("–".to_owned(), |v| number(v, decimals));
    page::tiles(&[
        (
            rows.len().to_string(),
            "samples, one per frame of the reference camera",
        ),
        (pieces.to_string(), "unbroken pieces"),
        (
            format!("{} <small>m</small>", number(length, 1)),
            "length of the path",
        ),
        (
            format!("± {} <small>mm</small>", or_dash(sigma.map(|s| 1e3 * s), 1)),
            "position, median 1σ in space",
        ),
        (
            format!("± {} <small>µs</small>", number(delay_us, 1)),
            "delay, worst camera, 1σ",
        ),
        (
            format!("{} <small>px</small>", or_dash(rms, 2)),
            "reprojection, median rms of the cameras",
        ),
    ])
}

const NAMES: [&str; 3] = ["x", "y", "z"];

/// Two axes against each other at one scale, with the cameras.
fn plan(pieces: &[&[TrajectoryRow]], calibration: &Calibration, view: ([usize; 2], &str)) -> String {
    let ([a, b], title) = view;
    let cameras: Vec<[f64; 2]> = calibration
        .cameras
        .iter()
        .map(|c| {
            let centre = c.camera_from_world.centre_m();
            [centre[a], centre[b]]
        })
        .collect();
    let path = || {
        pieces
            .iter()
            .flat_map(|p| p.iter())
            .map(|r| [r.position_m[a], r.position_m[b]])
    };
    let seen = || {
        path()
            .chain(cameras.iter().copied())
            .filter(|p| p.iter().all(|v| v.is_finite()))
    };
    let limits = |k: usize| {
        let low = seen().map(|p| p[k]).fold(f64::INFINITY, f64::min);
        let high = seen().map(|p| p[k]).fold(f64::NEG_INFINITY, f64::max);
        if low <= high { [low, high] } else { [0.0, 1.0] }
    };
    let ([x_low, x_high], [y_low, y_high]) = (limits(0), limits(1));
    // As high as it needs to be at the width's scale, within reason; then both ranges grow to fit.
    let margins = Margins {
        left: 48.0,
        top: 26.0,
        right: 20.0,
        bottom: 42.0,
    };
    let width = 560.0 - margins.left - margins.right;
    let span = (1.12 * (x_high - x_low)).max(1e-3);
    let height = (width * 1.12 * (y_high - y_low) / span).clamp(0.3 * width, 0.9 * width);
    let unit = (width / span).min(height / (1.12 * (y_high - y_low)).max(1e-3));
    let around = |low: f64, high: f64, length: f64| {
        let (middle, half) = (0.5 * (low + high), 0.5 * length / unit);
        Scale::linear(middle - half, middle + half)
    };
    let size = [560.0, height + margins.top + margins.bottom];
    let mut chart = Chart::new(
        size,
        margins,
        around(x_low, x_high, width),
        around(y_low, y_high, height),
    );
    let metres = if calibration.world == WorldFrame::HomePlate {
        ", m"
    } else {
        ""
    };
    chart.axes(
        [
            &format!("{}{metres} →", NAMES[a]),
            &format!("{}{metres} ↑", NAMES[b]),
        ],
        [7, 6],
    );
    for piece in pieces {
        let points: Vec<[f64; 2]> = piece.iter().map(|r| [r.position_m[a], r.position_m[b]]).collect();
        chart.line("trend", &points);
    }
    for (camera, at) in calibration.cameras.iter().zip(&cameras) {
        chart.circle("camera", *at, 4.5);
        let [px, py] = chart.place(at[0], at[1]);
        chart.text("name", [px, py + 18.0], "middle", camera.id.as_str());
    }
    let caption = format!(
        "<b>{title}</b>: {} against {}, one scale, with the cameras.",
        NAMES[b], NAMES[a]
    );
    figure("", &chart.finish(title), &caption)
}

/// Each axis over time, with its ± 2σ.
fn over_time(pieces: &[&[TrajectoryRow]]) -> String {
    let Some(start_ns) = pieces.first().and_then(|p| p.first()).map(|r| r.time_ns) else {
        return String::new();
    };
    let time_s = |row: &TrajectoryRow| row.time_ns.saturating_sub(start_ns) as f64 / 1e9;
    let all = || pieces.iter().flat_map(|p| p.iter());
    let end_s = all().map(time_s).fold(0.0, f64::max);
    let mut pictures = String::new();
    for (k, name) in NAMES.iter().enumerate() {
        let values = || all().map(|r| r.position_m[k]).filter(|v| v.is_finite());
        let (low, high) = (
            values().fold(f64::INFINITY, f64::min),
            values().fold(f64::NEG_INFINITY, f64::max),
        );
        let pad = 0.08 * (high - low) + 1e-3;
        let margins = Margins {
            left: 52.0,
            top: 26.0,
            right: 20.0,
            bottom: 42.0,
        };
        let scales = (
            Scale::linear(0.0, end_s.max(1e-3)),
            Scale::linear(low - pad, high + pad),
        );
        let mut chart = Chart::new([1120.0, 200.0], margins, scales.0, scales.1);
        chart.axes(["time, s", &format!("{name}, m")], [12, 4]);
        for piece in pieces {
            let edge =
                |side: f64| move |r: &TrajectoryRow| [time_s(r), r.position_m[k] + side * 2.0 * r.sigma_m[k]];
            let mut band: Vec<[f64; 2]> = piece.iter().map(edge(1.0)).collect();
            band.extend(piece.iter().rev().map(edge(-1.0)));
            chart.shape("band", &band);
            let line: Vec<[f64; 2]> = piece.iter().map(edge(0.0)).collect();
            chart.line("trend", &line);
        }
        pictures += &chart.finish(&format!("{name} over time"));
    }
    figure(
        "wide",
        &pictures,
        "<b>Over time</b>, with ± 2σ shaded; the line breaks where too few cameras saw it.",
    )
}
