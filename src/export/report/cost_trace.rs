//! The paper's search: mean reprojection error over its evaluations.

use crate::scene::{Calibration, CostStep};

use super::chart::{Chart, Margins, Scale};
use super::html::{count, escape, figure, number};

/// The figure; nothing for a calibration that has no trace.
pub(super) fn plot(calibration: &Calibration) -> String {
    let trace: Vec<&CostStep> = calibration
        .cost_trace
        .iter()
        .filter(|s| s.cost_px.is_finite() && s.cost_px > 0.0)
        .collect();
    let (Some(first), Some(last)) = (trace.first(), trace.last()) else {
        return String::new();
    };
    let mut best: Vec<[f64; 2]> = Vec::with_capacity(trace.len());
    let mut best_step = *first;
    for step in &trace {
        if step.cost_px < best_step.cost_px {
            best_step = step;
        }
        best.push([step.evaluation as f64, best_step.cost_px]);
    }
    let worst = trace.iter().map(|s| s.cost_px).fold(0.0, f64::max);
    let margins = Margins {
        left: 52.0,
        top: 26.0,
        right: 20.0,
        bottom: 42.0,
    };
    let mut chart = Chart::new(
        [1120.0, 260.0],
        margins,
        Scale::linear(
            first.evaluation as f64,
            (last.evaluation as f64).max(first.evaluation as f64 + 1.0),
        ),
        Scale::logarithmic(0.8 * best_step.cost_px, 1.25 * worst),
    );
    chart.axes(
        ["evaluation", "mean reprojection error, px (logarithmic)"],
        [8, 5],
    );
    let dots: Vec<[f64; 2]> = trace.iter().map(|s| [s.evaluation as f64, s.cost_px]).collect();
    chart.dots("dots", &dots);
    chart.line("trend", &best);
    let others = calibration
        .cameras
        .iter()
        .filter(|c| c.id != calibration.reference);
    let delays: Vec<String> = others
        .zip(&best_step.capture_delay_s)
        .map(|(camera, delay)| format!("{} {} ms", escape(camera.id.as_str()), number(1e3 * delay, 3)))
        .collect();
    let caption = format!(
        "<b>The search</b>: {}, from {} to {} px; the line is the best so far. Best at evaluation {}: {}.",
        count(trace.len(), "evaluation", "evaluations"),
        number(first.cost_px, 3),
        number(best_step.cost_px, 3),
        best_step.evaluation,
        if delays.is_empty() {
            "no delay was free".to_owned()
        } else {
            delays.join(", ")
        }
    );
    figure("wide", &chart.finish("Cost of the search"), &caption)
}
