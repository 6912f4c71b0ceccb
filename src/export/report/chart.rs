//! A small plotter: data in, inline SVG out; axes with ticks and units, colours by the page's style classes.

use std::fmt::Write as _;

use nalgebra::Matrix2;

use super::html::{escape, number};

/// How data become a position along an axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Spacing {
    Linear,
    /// Only for a range above zero.
    Logarithmic,
}

/// A range of data along one axis. `from` may exceed `to`: the axis then runs the other way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Scale {
    pub from: f64,
    pub to: f64,
    pub spacing: Spacing,
}

impl Scale {
    pub(super) fn linear(from: f64, to: f64) -> Self {
        let wide = (to - from).is_finite() && (to - from).abs() > 1e-12;
        Self {
            from: if wide { from } else { 0.0 },
            to: if wide { to } else { 1.0 },
            spacing: Spacing::Linear,
        }
    }

    pub(super) fn logarithmic(from: f64, to: f64) -> Self {
        let good = from > 0.0 && to.is_finite() && to > from;
        Self {
            from: if good { from } else { 0.1 },
            to: if good { to } else { 10.0 },
            spacing: Spacing::Logarithmic,
        }
    }

    /// 0 at `from`, 1 at `to`.
    fn share(&self, value: f64) -> f64 {
        match self.spacing {
            Spacing::Linear => (value - self.from) / (self.to - self.from),
            Spacing::Logarithmic => {
                (value.max(1e-300).ln() - self.from.ln()) / (self.to.ln() - self.from.ln())
            }
        }
    }

    /// Round values inside the range, about `wanted` of them, and the decimals to write them with.
    fn ticks(&self, wanted: usize) -> (Vec<f64>, usize) {
        let (low, high) = (self.from.min(self.to), self.from.max(self.to));
        match self.spacing {
            Spacing::Linear => {
                let step = round_step((high - low) / wanted.max(1) as f64);
                let first = (low / step - 1e-9).ceil() as i64;
                let last = (high / step + 1e-9).floor() as i64;
                let decimals = (-step.log10().floor()).clamp(0.0, 6.0) as usize;
                (
                    (first..=last).take(200).map(|i| i as f64 * step).collect(),
                    decimals,
                )
            }
            Spacing::Logarithmic => {
                let decades = (low.log10().floor() as i32)..=(high.log10().ceil() as i32);
                let all: Vec<f64> = decades
                    .flat_map(|d| [1.0, 2.0, 5.0].map(|m| m * 10f64.powi(d)))
                    .filter(|v| *v >= low * 0.999 && *v <= high * 1.001)
                    .collect();
                let decimals = (-low.log10().floor()).clamp(0.0, 6.0) as usize;
                (all, decimals)
            }
        }
    }
}

/// 1, 2 or 5 times a power of ten, at least `rough`.
fn round_step(rough: f64) -> f64 {
    let power = 10f64.powf(rough.max(1e-12).log10().floor());
    let over = rough / power;
    let factor = [1.0, 2.0, 5.0]
        .into_iter()
        .find(|f| over <= f + 1e-9)
        .unwrap_or(10.0);
    factor * power
}

/// Room around the plot for ticks and labels, in drawing units.
#[derive(Debug, Clone, Copy)]
pub(super) struct Margins {
    pub left: f64,
    pub top: f64,
    pub right: f64,
    pub bottom: f64,
}

/// One plot being drawn. Data are clipped to the plot; labels are not.
pub(super) struct Chart {
    width: f64,
    height: f64,
    margins: Margins,
    x: Scale,
    y: Scale,
    axes: String,
    inside: String,
    labels: String,
}

impl Chart {
    /// A plot of the given drawing size; y grows upwards.
    pub(super) fn new(size: [f64; 2], margins: Margins, x: Scale, y: Scale) -> Self {
        Self {
            width: size[0],
            height: size[1],
            margins,
            x,
            y,
            axes: String::new(),
            inside: String::new(),
            labels: String::new(),
        }
    }

    fn plot_width(&self) -> f64 {
        self.width - self.margins.left - self.margins.right
    }

    fn plot_height(&self) -> f64 {
        self.height - self.margins.top - self.margins.bottom
    }

    /// Drawing position of a data point.
    pub(super) fn place(&self, x: f64, y: f64) -> [f64; 2] {
        [
            self.margins.left + self.x.share(x) * self.plot_width(),
            self.margins.top + (1.0 - self.y.share(y)) * self.plot_height(),
        ]
    }

    /// Drawing units in one unit of x and of y.
    pub(super) fn units(&self) -> [f64; 2] {
        [
            self.plot_width() / (self.x.to - self.x.from).abs(),
            self.plot_height() / (self.y.to - self.y.from).abs(),
        ]
    }

    /// Grid lines, tick values and the two labels ("what, unit"); about so many ticks each way.
    pub(super) fn axes(&mut self, labels: [&str; 2], ticks: [usize; 2]) {
        let (left, top) = (self.margins.left, self.margins.top);
        let (right, bottom) = (left + self.plot_width(), top + self.plot_height());
        let (values, decimals) = self.x.ticks(ticks[0]);
        for value in values {
            let [x, _] = self.place(value, self.y.from);
            let _ = write!(
                self.axes,
                "<path class=\"grid\" d=\"M{x:.1} {top:.1}V{bottom:.1}\"/>\
                 <text class=\"tick\" x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
                bottom + 16.0,
                number(value, decimals)
            );
        }
        let (values, decimals) = self.y.ticks(ticks[1]);
        for value in values {
            let [_, y] = self.place(self.x.from, value);
            let _ = write!(
                self.axes,
                "<path class=\"grid\" d=\"M{left:.1} {y:.1}H{right:.1}\"/>\
                 <text class=\"tick\" x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
                left - 7.0,
                y + 4.0,
                number(value, decimals)
            );
        }
        let _ = write!(
            self.axes,
            "<text class=\"axis\" x=\"{right:.1}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>\
             <text class=\"axis\" x=\"{:.1}\" y=\"{:.1}\">{}</text>",
            bottom + 33.0,
            escape(labels[0]),
            (left - 38.0).max(0.0),
            top - 9.0,
            escape(labels[1])
        );
    }

    /// A line through data points.
    pub(super) fn line(&mut self, class: &str, points: &[[f64; 2]]) {
        let d = self.outline(points);
        let _ = write!(self.inside, "<path class=\"{class}\" d=\"{d}\"/>");
    }

    /// A closed shape through data points.
    pub(super) fn shape(&mut self, class: &str, points: &[[f64; 2]]) {
        let d = self.outline(points);
        let _ = write!(self.inside, "<path class=\"{class}\" d=\"{d}Z\"/>");
    }

    fn outline(&self, points: &[[f64; 2]]) -> String {
        let mut d = String::new();
        for [x, y] in points.iter().filter(|p| p.iter().all(|v| v.is_finite())) {
            let [px, py] = self.place(*x, *y);
            let _ = write!(d, "{}{px:.1} {py:.1}", if d.is_empty() { "M" } else { "L" });
        }
        d
    }

    /// Many points as one path of round-capped dots (a circle each would be ten times the size).
    pub(super) fn dots(&mut self, class: &str, points: &[[f64; 2]]) {
        let mut d = String::new();
        for [x, y] in points.iter().filter(|p| p.iter().all(|v| v.is_finite())) {
            let [px, py] = self.place(*x, *y);
            let _ = write!(d, "M{px:.1} {py:.1}h0");
        }
        let _ = write!(self.inside, "<path class=\"{class}\" d=\"{d}\"/>");
    }

    /// Many points as crosses.
    pub(super) fn crosses(&mut self, class: &str, points: &[[f64; 2]]) {
        let mut d = String::new();
        for [x, y] in points.iter().filter(|p| p.iter().all(|v| v.is_finite())) {
            let [px, py] = self.place(*x, *y);
            let _ = write!(d, "M{:.1} {:.1}l6 6m0-6l-6 6", px - 3.0, py - 3.0);
        }
        let _ = write!(self.inside, "<path class=\"{class}\" d=\"{d}\"/>");
    }

    /// A circle of a radius in drawing units.
    pub(super) fn circle(&mut self, class: &str, centre: [f64; 2], radius: f64) {
        let [x, y] = self.place(centre[0], centre[1]);
        let _ = write!(
            self.inside,
            "<circle class=\"{class}\" cx=\"{x:.2}\" cy=\"{y:.2}\" r=\"{radius:.2}\"/>"
        );
    }

    /// The curve on which a normal's exponent is `sigmas²`/2 (2.4477 in two dimensions: 95 % inside).
    pub(super) fn ellipse(&mut self, class: &str, centre: [f64; 2], covariance: &Matrix2<f64>, sigmas: f64) {
        // Cholesky by hand: a covariance that is not positive gives a flat ellipse, never a NaN.
        let sigma_x = covariance[(0, 0)].max(0.0).sqrt();
        let slope = if sigma_x > 0.0 {
            covariance[(1, 0)] / sigma_x
        } else {
            0.0
        };
        let rest = (covariance[(1, 1)] - slope * slope).max(0.0).sqrt();
        let points: Vec<[f64; 2]> = (0..48)
            .map(|i| {
                let (s, c) = (f64::from(i) * std::f64::consts::TAU / 48.0).sin_cos();
                [
                    centre[0] + sigmas * sigma_x * c,
                    centre[1] + sigmas * (slope * c + rest * s),
                ]
            })
            .collect();
        let mut d = String::new();
        for [x, y] in points {
            let [px, py] = self.place(x, y);
            let _ = write!(d, "{}{px:.2} {py:.2}", if d.is_empty() { "M" } else { "L" });
        }
        let _ = write!(self.inside, "<path class=\"{class}\" d=\"{d}Z\"/>");
    }

    /// Text at a drawing position; `anchor` is start, middle or end.
    pub(super) fn text(&mut self, class: &str, at: [f64; 2], anchor: &str, text: &str) {
        let _ = write!(
            self.labels,
            "<text class=\"{class}\" x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"{anchor}\">{}</text>",
            at[0],
            at[1],
            escape(text)
        );
    }

    /// A thin line between two drawing positions, outside the clip.
    pub(super) fn leader(&mut self, from: [f64; 2], to: [f64; 2]) {
        let _ = write!(
            self.labels,
            "<path class=\"leader\" d=\"M{:.1} {:.1}L{:.1} {:.1}\"/>",
            from[0], from[1], to[0], to[1]
        );
    }

    /// What is drawn until [`Self::end_group`] shows `tooltip` on hover.
    pub(super) fn begin_group(&mut self, tooltip: &str) {
        let _ = write!(self.inside, "<g><title>{}</title>", escape(tooltip));
    }

    /// Ends [`Self::begin_group`].
    pub(super) fn end_group(&mut self) {
        self.inside += "</g>";
    }

    /// The picture; `description` is for those who cannot see it.
    pub(super) fn finish(self, description: &str) -> String {
        let (x, y, w, h) = (
            self.margins.left,
            self.margins.top,
            self.plot_width(),
            self.plot_height(),
        );
        format!(
            "<svg viewBox=\"0 0 {:.0} {:.0}\" role=\"img\" aria-label=\"{}\">{}\
             <svg x=\"{x:.1}\" y=\"{y:.1}\" width=\"{w:.1}\" height=\"{h:.1}\" viewBox=\"{x:.1} {y:.1} {w:.1} {h:.1}\">{}</svg>\
             {}</svg>",
            self.width,
            self.height,
            escape(description),
            self.axes,
            self.inside,
            self.labels
        )
    }
}

/// Moves labels along one axis until they are `gap` apart, in order, to both sides alike; the new positions stay
/// within `low..=high` where there is room.
pub(super) fn spread(positions: &[f64], gap: f64, low: f64, high: f64) -> Vec<f64> {
    let gap = gap.min((high - low) / positions.len().max(1) as f64);
    let mirrored: Vec<f64> = positions.iter().map(|p| -p).collect();
    let mut order: Vec<usize> = (0..positions.len()).collect();
    order.sort_by(|a, b| positions[*a].total_cmp(&positions[*b]));
    // One sweep pushes up and its mirror image down; halfway between two good placements is a good one.
    let up = swept(positions, &order, gap, [low, high]);
    order.reverse();
    let down = swept(&mirrored, &order, gap, [-high, -low]);
    up.iter().zip(&down).map(|(u, d)| 0.5 * (u - d)).collect()
}

/// `order` is that of rising positions.
fn swept(positions: &[f64], order: &[usize], gap: f64, [low, high]: [f64; 2]) -> Vec<f64> {
    let mut placed = positions.to_vec();
    let mut floor = low;
    for i in order {
        placed[*i] = placed[*i].max(floor);
        floor = placed[*i] + gap;
    }
    let mut ceiling = high;
    for i in order.iter().rev() {
        placed[*i] = placed[*i].min(ceiling);
        ceiling = placed[*i] - gap;
    }
    placed
}

#[cfg(test)]
mod tests {
    use super::*;

    fn margins() -> Margins {
        Margins {
            left: 10.0,
            top: 20.0,
            right: 30.0,
            bottom: 40.0,
        }
    }

    #[test]
    fn data_land_where_the_scale_says() {
        let chart = Chart::new(
            [140.0, 160.0],
            margins(),
            Scale::linear(0.0, 10.0),
            Scale::linear(-1.0, 1.0),
        );
        assert_eq!(chart.place(0.0, -1.0), [10.0, 120.0]);
        assert_eq!(chart.place(10.0, 1.0), [110.0, 20.0]);
        assert_eq!(chart.place(5.0, 0.0), [60.0, 70.0]);
        let chart = Chart::new(
            [140.0, 160.0],
            margins(),
            Scale::linear(10.0, 0.0),
            Scale::logarithmic(0.1, 10.0),
        );
        assert_eq!(chart.place(10.0, 1.0)[0], 10.0);
        assert!((chart.place(10.0, 1.0)[1] - 70.0).abs() < 1e-9);
    }

    #[test]
    fn ticks_are_round_and_inside() {
        assert_eq!(Scale::linear(0.0, 19.5).ticks(8), (vec![0.0, 5.0, 10.0, 15.0], 0));
        let (values, decimals) = Scale::linear(-0.3, 0.31).ticks(6);
        assert_eq!((values.len(), decimals), (3, 1));
        let (values, _) = Scale::logarithmic(0.5, 30.0).ticks(5);
        assert_eq!(values, [0.5, 1.0, 2.0, 5.0, 10.0, 20.0]);
    }

    #[test]
    fn a_range_that_is_none_still_draws() {
        for scale in [
            Scale::linear(3.0, 3.0),
            Scale::linear(f64::NAN, 1.0),
            Scale::logarithmic(0.0, f64::INFINITY),
        ] {
            let mut chart = Chart::new([140.0, 160.0], margins(), scale, scale);
            chart.axes(["a", "b"], [4, 4]);
            chart.line("l", &[[f64::NAN, 1.0], [0.5, 0.5]]);
            let svg = chart.finish("<x>");
            assert!(
                !svg.contains("NaN") && !svg.contains("inf") && svg.contains("&lt;x&gt;"),
                "{svg}"
            );
        }
    }

    #[test]
    fn labels_keep_their_distance_and_their_order() {
        assert_eq!(spread(&[51.0, 53.0, 20.0], 4.0, 0.0, 100.0), [50.0, 54.0, 20.0]);
        assert_eq!(spread(&[99.0, 98.0], 4.0, 0.0, 100.0), [99.5, 95.5]);
        // No room: as even as it goes.
        let placed = spread(&[1.0; 10], 4.0, 0.0, 10.0);
        assert!(placed.windows(2).all(|w| (w[1] - w[0] - 1.0).abs() < 1e-9));
    }
}
