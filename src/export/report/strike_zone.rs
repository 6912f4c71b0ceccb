//! The strike-zone plot: the catcher's view at mid-plate, ball and zone to scale.

use nalgebra::Matrix2;

use crate::flight::{FOOT_M, HALF_PLATE_M, StrikeZone};
use crate::scene::BALL_RADIUS_M;
use crate::scene::Pitch;

use super::chart::{Chart, Margins, Scale};
use super::html::{figure, number};

/// √χ² of 95 % in two dimensions: −2·ln(0.05).
const SIGMAS_95: f64 = 2.447_746_83;

/// Half the picture's width and its height at least and at most, metres; a pitch farther out is drawn at the edge.
const HALF_WIDTH_M: [f64; 2] = [0.62, 1.1];
const HEIGHT_M: [f64; 2] = [1.45, 2.3];

/// The zone of the pitches: one when they share it, else the mean, and whether it is shared.
fn zone(pitches: &[Pitch]) -> Option<(StrikeZone, Shared)> {
    let zones: Vec<[f64; 2]> = pitches
        .iter()
        .filter_map(|p| {
            Some([
                p.statcast.get("sz_bot")? * FOOT_M,
                p.statcast.get("sz_top")? * FOOT_M,
            ])
        })
        .collect();
    let n = zones.len() as f64;
    let mean = |k: usize| zones.iter().map(|z| z[k]).sum::<f64>() / n;
    let zone = (!zones.is_empty()).then(|| StrikeZone {
        bottom_m: mean(0),
        top_m: mean(1),
    })?;
    let same = zones
        .iter()
        .all(|z| (z[0] - zone.bottom_m).abs() < 1e-3 && (z[1] - zone.top_m).abs() < 1e-3);
    Some((
        zone,
        if same {
            Shared::ByAll
        } else {
            Shared::MeanOfSeveral
        },
    ))
}

#[derive(PartialEq)]
enum Shared {
    ByAll,
    MeanOfSeveral,
}

/// `strike` or `ball`, by the likelier call; and whether to trust it.
pub(super) fn call_class(pitch: &Pitch) -> &'static str {
    if pitch.strike_probability >= 0.5 {
        "strike"
    } else {
        "ball"
    }
}

/// The figure; nothing without pitches.
pub(super) fn plot(pitches: &[Pitch]) -> String {
    if pitches.is_empty() {
        return String::new();
    }
    let reach = |k: usize, [least, most]: [f64; 2]| {
        let seen = pitches.iter().map(|p| p.plate_mid_m[k].abs() + 0.12);
        seen.filter(|v| v.is_finite()).fold(least, f64::max).min(most)
    };
    let (half_width, height) = (reach(0, HALF_WIDTH_M), reach(1, HEIGHT_M));
    let floor = -0.14;
    let margins = Margins {
        left: 44.0,
        top: 26.0,
        right: 12.0,
        bottom: 42.0,
    };
    let width = 440.0;
    let unit = (width - margins.left - margins.right) / (2.0 * half_width);
    let size = [width, (height - floor) * unit + margins.top + margins.bottom];
    let mut chart = Chart::new(
        size,
        margins,
        Scale::linear(-half_width, half_width),
        Scale::linear(floor, height),
    );
    chart.axes(["x, m (catcher’s right →)", "z, m ↑"], [6, 8]);
    draw_plate(&mut chart, half_width);
    let zone = zone(pitches);
    if let Some((zone, _)) = &zone {
        draw_zone(&mut chart, zone);
    }
    let mut outside = Vec::new();
    for pitch in pitches {
        let limits = [half_width, height];
        if !draw_pitch(&mut chart, pitch, limits) {
            outside.push(pitch.pitch.to_string());
        }
    }
    let mut caption = "<b>Catcher’s view at mid-plate</b> (y = 21.6 cm), ball to scale. \
        <span class=\"key strike\">strike</span> <span class=\"key ball\">ball</span> by the likelier call; \
        the dark spot is the 95 % ellipse of the centre. A ball whose centre lies inside the dashed line touches the zone."
        .to_owned();
    match &zone {
        Some((zone, shared)) => {
            caption += &format!(
                " Zone {} to {} m{}.",
                number(zone.bottom_m, 3),
                number(zone.top_m, 3),
                if *shared == Shared::ByAll {
                    ""
                } else {
                    ", the mean of the batters’"
                }
            );
        }
        None => caption += " The pitches carry no zone (sz_bot, sz_top).",
    }
    if !outside.is_empty() {
        caption += &format!(" Off the picture, drawn at its edge: {}.", outside.join(", "));
    }
    figure(
        "zone",
        &chart.finish("Plate locations as the catcher sees them"),
        &caption,
    )
}

fn draw_plate(chart: &mut Chart, half_width: f64) {
    chart.line("ground", &[[-half_width, 0.0], [half_width, 0.0]]);
    // The plate seen from behind and above: its tip is nearest.
    let h = HALF_PLATE_M;
    chart.shape(
        "plate",
        &[
            [-h, 0.0],
            [h, 0.0],
            [h * 0.96, -0.03],
            [0.0, -0.075],
            [-h * 0.96, -0.03],
        ],
    );
}

fn draw_zone(chart: &mut Chart, zone: &StrikeZone) {
    let (h, low, high) = (HALF_PLATE_M, zone.bottom_m, zone.top_m);
    chart.shape("zonebox", &[[-h, low], [h, low], [h, high], [-h, high]]);
    for third in [1.0 / 3.0, 2.0 / 3.0] {
        let (x, z) = (-h + 2.0 * h * third, low + (high - low) * third);
        chart.line("thirds", &[[x, low], [x, high]]);
        chart.line("thirds", &[[-h, z], [h, z]]);
    }
    let mut reach = Vec::new();
    let corners = [
        ([h, high], 0.0),
        ([-h, high], 90.0),
        ([-h, low], 180.0),
        ([h, low], 270.0),
    ];
    for (corner, start_deg) in corners {
        for step in 0..=6 {
            let (s, c) = (start_deg + 15.0 * f64::from(step)).to_radians().sin_cos();
            reach.push([corner[0] + BALL_RADIUS_M * c, corner[1] + BALL_RADIUS_M * s]);
        }
    }
    chart.shape("reach", &reach);
}

/// False where the pitch is off the picture and stands at its edge.
fn draw_pitch(chart: &mut Chart, pitch: &Pitch, [half_width, height]: [f64; 2]) -> bool {
    let [x, z] = pitch.plate_mid_m;
    if !x.is_finite() || !z.is_finite() {
        return false;
    }
    let edge = BALL_RADIUS_M;
    let at = [
        x.clamp(-half_width + edge, half_width - edge),
        z.clamp(-0.14 + edge, height - edge),
    ];
    let inside = (at[0] - x).abs() < 1e-9 && (at[1] - z).abs() < 1e-9;
    let radius = BALL_RADIUS_M * chart.units()[0];
    let class = call_class(pitch);
    chart.begin_group(&format!(
        "pitch {}: x {:+.1} cm, z {:.1} cm; strike {:.0} %, margin {:+.0} mm",
        pitch.pitch,
        100.0 * x,
        100.0 * z,
        100.0 * pitch.strike_probability,
        1e3 * pitch.strike_margin_m
    ));
    let off = if inside { "" } else { " off" };
    chart.circle(&format!("pitch {class}{off}"), at, radius);
    if inside {
        let [[a, b], [c, d]] = pitch.plate_mid_covariance_m2;
        chart.ellipse(&format!("spot {class}"), at, &Matrix2::new(a, b, c, d), SIGMAS_95);
    }
    chart.end_group();
    let [px, py] = chart.place(at[0], at[1]);
    let shift = 0.75 * radius + 3.0;
    chart.text(
        &format!("number {class}"),
        [px + shift, py - shift + 3.0],
        "start",
        &pitch.pitch.to_string(),
    );
    inside
}
