//! Error matrices as heat maps (SVG): blue is nothing, red the largest error of the picture.

use std::fmt::Write;

/// A 2-D grid of numbers with its title.
pub struct Panel {
    /// Above the panel.
    pub title: String,
    /// `[row][column]`; NaN is drawn grey.
    pub values: Vec<Vec<f64>>,
}

const CELL: usize = 14;
const MARGIN: usize = 34;

/// Panels side by side in rows of `columns`, one colour scale from 0 to `most`; axes are τ2 (across) and τ3 (down).
pub fn svg(title: &str, panels: &[Panel], columns: usize, most: f64, unit: &str) -> String {
    let size = panels.iter().map(|p| p.values.len()).max().unwrap_or(0);
    let (width, height) = (MARGIN + CELL * size, MARGIN + CELL * size);
    let rows = panels.len().div_ceil(columns.max(1));
    let total = (columns * width + MARGIN, rows * height + 2 * MARGIN);
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {0} {1}\" width=\"{0}\" height=\"{1}\" \
         font-family=\"sans-serif\" font-size=\"10\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n\
         <text x=\"8\" y=\"16\" font-size=\"12\">{title}; blue 0, red {most:.3} {unit}</text>\n",
        total.0, total.1
    );
    for (k, panel) in panels.iter().enumerate() {
        let (x0, y0) = (
            MARGIN / 2 + (k % columns) * width,
            MARGIN + (k / columns) * height,
        );
        // Writing to a string cannot fail.
        let _ = writeln!(text, "<text x=\"{x0}\" y=\"{}\">{}</text>", y0 + 10, panel.title);
        for (r, row) in panel.values.iter().enumerate() {
            for (c, value) in row.iter().enumerate() {
                let _ = writeln!(
                    text,
                    "<rect x=\"{}\" y=\"{}\" width=\"{CELL}\" height=\"{CELL}\" fill=\"{}\"><title>{value:.4}</title></rect>",
                    x0 + c * CELL,
                    y0 + 14 + r * CELL,
                    colour(value / most)
                );
            }
        }
    }
    text.push_str("</svg>\n");
    text
}

/// Blue → cyan → yellow → red.
fn colour(share: f64) -> String {
    if !share.is_finite() {
        return "#aaaaaa".to_owned();
    }
    let stops = [
        [40.0, 60.0, 160.0],
        [70.0, 180.0, 200.0],
        [250.0, 220.0, 90.0],
        [200.0, 30.0, 30.0],
    ];
    let place = share.clamp(0.0, 1.0) * 3.0;
    let below = (place.floor() as usize).min(2);
    let part = place - below as f64;
    let mix = |k: usize| (stops[below][k] * (1.0 - part) + stops[below + 1][k] * part).round() as u8;
    format!("#{:02x}{:02x}{:02x}", mix(0), mix(1), mix(2))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_has_every_cell_in_its_colour() {
        let panel = Panel {
            title: "N1".to_owned(),
            values: vec![vec![0.0, 1.0], vec![f64::NAN, 0.5]],
        };
        let text = svg("errors", &[panel], 1, 1.0, "frame");
        assert_eq!(text.matches("<title>").count(), 4);
        assert!(text.contains("#283ca0") && text.contains("#c81e1e") && text.contains("#aaaaaa"));
        assert!(text.starts_with("<svg") && text.ends_with("</svg>\n"));
    }
}
