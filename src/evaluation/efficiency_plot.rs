//! A study of efficiency as one SVG picture: errors in stated sigmas beside the normal law, a panel a quantity.

use std::fmt::Write;

use super::efficiency::{Efficiency, Summary};

const WIDTH: f64 = 330.0;
const HEIGHT: f64 = 170.0;
const COLUMNS: usize = 3;
/// Errors are drawn within ± this many sigmas; the outermost bars hold the rest.
const RANGE_SIGMAS: f64 = 4.0;
const BARS: usize = 32;

/// The picture; empty panels for a study without trials.
pub(super) fn svg(study: &Efficiency) -> String {
    let panels = study.summaries.len().max(1);
    let (columns, rows) = (panels.min(COLUMNS), panels.div_ceil(COLUMNS));
    let (w, h) = (WIDTH * columns as f64, HEIGHT * rows as f64 + 20.0);
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {w} {h}\" font-family=\"sans-serif\" font-size=\"10\">\
         <rect width=\"100%\" height=\"100%\" fill=\"#fff\"/><text x=\"6\" y=\"13\">error in stated sigmas (bars) and the \
         normal law (line); {} failure(s)</text>\n",
        study.failures.len()
    );
    for (k, summary) in study.summaries.iter().enumerate() {
        let (x, y) = (WIDTH * (k % COLUMNS) as f64, 20.0 + HEIGHT * (k / COLUMNS) as f64);
        let _ = writeln!(text, "<g transform=\"translate({x} {y})\">");
        panel(&mut text, summary, &study.errors_in_sigmas(summary));
        text.push_str("</g>\n");
    }
    text + "</svg>\n"
}

fn panel(text: &mut String, summary: &Summary, errors: &[f64]) {
    let (left, base, tall) = (10.0, HEIGHT - 20.0, HEIGHT - 60.0);
    let bar = (WIDTH - 2.0 * left) / BARS as f64;
    let x_of = |sigmas: f64| left + (sigmas / RANGE_SIGMAS + 1.0) * 0.5 * bar * BARS as f64;
    // Half as high again as the normal law's peak fills the panel.
    let share_of_bar = 2.0 * RANGE_SIGMAS / BARS as f64;
    let full = 1.5 / (2.0 * std::f64::consts::PI).sqrt();
    let y_of = |density: f64| base - tall * (density / full).min(1.0);
    for (k, count) in histogram(errors).into_iter().enumerate() {
        let density = count as f64 / errors.len().max(1) as f64 / share_of_bar;
        let top = y_of(density);
        let _ = writeln!(
            text,
            "<rect x=\"{:.1}\" y=\"{top:.1}\" width=\"{:.1}\" height=\"{:.1}\" fill=\"#9bc\"/>",
            left + bar * k as f64,
            bar - 1.0,
            base - top
        );
    }
    let curve: Vec<String> = (0..=80)
        .map(|k| {
            let sigmas = RANGE_SIGMAS * (f64::from(k) / 40.0 - 1.0);
            let density = (-0.5 * sigmas * sigmas).exp() / (2.0 * std::f64::consts::PI).sqrt();
            format!("{:.1},{:.1}", x_of(sigmas), y_of(density))
        })
        .collect();
    let _ = writeln!(
        text,
        "<polyline points=\"{}\" fill=\"none\" stroke=\"#c33\"/>",
        curve.join(" ")
    );
    for sigmas in [-2.0, 0.0, 2.0] {
        let _ = writeln!(
            text,
            "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{sigmas}</text>",
            x_of(sigmas),
            base + 12.0
        );
    }
    let _ = writeln!(
        text,
        "<text x=\"{left}\" y=\"14\" font-weight=\"bold\">{:?}, {} (n = {})</text>\
         <text x=\"{left}\" y=\"27\">rms / bound {:.3}, 95 % interval holds {:.1} %, NEES {:.2}</text>",
        summary.quantity,
        summary.of,
        summary.count,
        summary.ratio,
        100.0 * summary.coverage_95,
        summary.nees
    );
}

/// Errors per bar; those beyond the range in the outermost.
fn histogram(errors: &[f64]) -> Vec<usize> {
    let mut bars = vec![0; BARS];
    for error in errors.iter().filter(|e| e.is_finite()) {
        let place = (error / RANGE_SIGMAS + 1.0) * 0.5 * BARS as f64;
        // A cast of a negative number is 0.
        bars[(place as usize).min(BARS - 1)] += 1;
    }
    bars
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_error_is_in_its_bar() {
        // Bars of a quarter sigma from −4 on: −9 falls in the first, 0 in the 17th, 0.3 in the 18th, 4 in the last.
        let bars = histogram(&[-9.0, 0.0, 0.3, 4.0, f64::NAN]);
        assert_eq!(bars.iter().sum::<usize>(), 4);
        assert_eq!((bars[0], bars[16], bars[17], bars[31]), (1, 1, 1, 1));
    }
}
