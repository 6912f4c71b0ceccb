//! Every flight from the side (y–z) and from above (y–x), with plate, mound and rubber.

use crate::scene::{FieldPreset, Pitch};

use super::chart::{Chart, Margins, Scale, spread};
use super::html::{figure, number};
use super::strike_zone::call_class;

/// More numbers than this cannot be told apart at the flights' ends.
const NUMBERED_MAX: usize = 24;

/// Which two axes a view shows.
#[derive(Clone, Copy, PartialEq)]
enum View {
    /// y to the right, z up: from the first-base side.
    Side,
    /// y to the right, x down: from above.
    Top,
}

impl View {
    fn across(self, position_m: &[f64; 3]) -> f64 {
        match self {
            Self::Side => position_m[2],
            Self::Top => position_m[0],
        }
    }
}

/// Both figures; nothing without pitches.
pub(super) fn plots(pitches: &[Pitch], field: FieldPreset) -> String {
    if pitches.is_empty() {
        return String::new();
    }
    plot(pitches, field, View::Side) + &plot(pitches, field, View::Top)
}

fn range(pitches: &[Pitch], view: View) -> [f64; 2] {
    let values = || {
        let all = pitches.iter().flat_map(|p| &p.flight);
        all.map(|s| view.across(&s.position_m)).filter(|v| v.is_finite())
    };
    let (low, high) = (
        values().fold(f64::INFINITY, f64::min),
        values().fold(f64::NEG_INFINITY, f64::max),
    );
    match view {
        View::Side => [(low - 0.1).clamp(-1.0, -0.1), (high + 0.25).clamp(2.2, 6.0)],
        View::Top => {
            let half = (low.abs().max(high.abs()) + 0.15).clamp(0.6, 4.0);
            [half, -half]
        }
    }
}

fn plot(pitches: &[Pitch], field: FieldPreset, view: View) -> String {
    let rubber = field
        .landmark("rubber_front_right")
        .map_or([0.3048, 18.4404, 0.254], |p| [p.x, p.y, p.z]);
    let longest = pitches
        .iter()
        .filter_map(|p| p.flight.first())
        .map(|s| s.position_m[1])
        .filter(|v| v.is_finite())
        .fold(rubber[1] + 0.5, f64::max)
        .min(30.0);
    let margins = Margins {
        left: 48.0,
        top: 26.0,
        right: 34.0,
        bottom: 42.0,
    };
    let [low, high] = range(pitches, view);
    let mut chart = Chart::new(
        [920.0, 310.0],
        margins,
        Scale::linear(-0.7, longest + 0.3),
        Scale::linear(low, high),
    );
    let label = if view == View::Side {
        "z, m ↑"
    } else {
        "x, m ↓ (catcher’s right)"
    };
    chart.axes(["y, m (plate tip 0 → pitcher)", label], [10, 5]);
    match view {
        View::Side => draw_side(&mut chart, rubber, longest),
        View::Top => draw_top(&mut chart, rubber),
    }
    for pitch in pitches {
        let points: Vec<[f64; 2]> = pitch
            .flight
            .iter()
            .map(|s| [s.position_m[1], view.across(&s.position_m)])
            .collect();
        let class = call_class(pitch);
        chart.begin_group(&format!(
            "pitch {}: {:.1} m/s",
            pitch.pitch, pitch.release_speed_mps
        ));
        chart.line(&format!("flight {class}"), &points);
        chart.circle(
            &format!("release {class}"),
            [pitch.release_m[1], view.across(&pitch.release_m)],
            2.6,
        );
        chart.end_group();
    }
    if pitches.len() <= NUMBERED_MAX {
        number_flights(&mut chart, pitches, view);
    }
    let [across_units, up_units] = chart.units();
    let stretch = number(up_units / across_units, 1);
    let (title, words) = match view {
        View::Side => (
            "Side view",
            format!("seen from the first-base side; heights stretched {stretch}×"),
        ),
        View::Top => (
            "Top view",
            format!("seen from above; widths stretched {stretch}×"),
        ),
    };
    let caption = format!(
        "<b>{title}</b>, {words}. Each line is the solved flight from the first point seen to the plate’s tip; \
         the dot is the release plane."
    );
    figure("wide", &chart.finish(title), &caption)
}

/// Ground, mound, rubber, plate and the plane where strikes are called.
fn draw_side(chart: &mut Chart, rubber: [f64; 3], longest: f64) {
    let [_, y, z] = rubber;
    // The mound: flat for 6 in. before the rubber, then down 1 in. a foot.
    let slope_end = (y - 0.1524 - z * 12.0).max(0.5);
    chart.shape(
        "mound",
        &[
            [slope_end, 0.0],
            [y - 0.1524, z],
            [y + 0.5, z],
            [longest + 0.3, z * 0.9],
            [longest + 0.3, 0.0],
        ],
    );
    chart.line("ground", &[[-5.0, 0.0], [longest + 5.0, 0.0]]);
    chart.shape(
        "plate",
        &[[0.0, 0.0], [0.4318, 0.0], [0.4318, -0.04], [0.0, -0.04]],
    );
    chart.shape(
        "plate",
        &[[y, z], [y + 0.1524, z], [y + 0.1524, z - 0.06], [y, z - 0.06]],
    );
    chart.line("plane", &[[0.2159, 0.0], [0.2159, 1.2]]);
    let [px, py] = chart.place(0.2159, 1.2);
    chart.text("note", [px + 4.0, py - 3.0], "start", "mid-plate");
    let [px, py] = chart.place(y, z);
    chart.text("note", [px + 6.0, py - 7.0], "middle", "rubber");
}

fn draw_top(chart: &mut Chart, rubber: [f64; 3]) {
    let [x, y, _] = rubber;
    let (h, side, front) = (0.2159, 0.2159, 0.4318);
    chart.line("ground", &[[-5.0, 0.0], [40.0, 0.0]]);
    chart.shape(
        "plate",
        &[[0.0, 0.0], [side, h], [front, h], [front, -h], [side, -h]],
    );
    chart.shape("plate", &[[y, x], [y + 0.1524, x], [y + 0.1524, -x], [y, -x]]);
}

/// Numbers at the release end, moved apart where they would overlap.
fn number_flights(chart: &mut Chart, pitches: &[Pitch], view: View) {
    let starts: Vec<(&Pitch, [f64; 2])> = pitches
        .iter()
        .filter_map(|p| {
            let first = p.flight.first()?;
            let at = chart.place(first.position_m[1], view.across(&first.position_m));
            at.iter().all(|v| v.is_finite()).then_some((p, at))
        })
        .collect();
    let heights: Vec<f64> = starts.iter().map(|(_, at)| at[1]).collect();
    let column = starts.iter().map(|(_, at)| at[0]).fold(0.0, f64::max) + 14.0;
    for ((pitch, at), y) in starts.iter().zip(spread(&heights, 13.0, 30.0, 264.0)) {
        chart.leader(*at, [column - 2.0, y]);
        chart.text(
            &format!("number {}", call_class(pitch)),
            [column, y + 4.0],
            "start",
            &pitch.pitch.to_string(),
        );
    }
}
