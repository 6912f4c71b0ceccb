//! One camera's sightings as a smooth path of directions over time: what the search for offsets interpolates.
//! Only the search: the final estimate uses every sighting at its own instant.

use nalgebra::{Matrix3, Vector2, Vector3};

use super::view::View;
use crate::geometry::{Normalized, Pixel};

/// Longest gap that is bridged, seconds.
pub(super) const BRIDGE_S: f64 = 0.3;
/// Half the window of the local parabola, seconds.
const WINDOW_S: f64 = 0.16;

#[derive(Debug, Clone, Copy)]
struct Knot {
    time_s: f64,
    direction: Vector2<f64>,
    /// Per second.
    rate: Vector2<f64>,
}

/// Directions over the rough common time (stamp + rough offset).
#[derive(Debug, Clone)]
pub(super) struct Path {
    knots: Vec<Knot>,
    /// Mean focal length, pixels: turns directions into pixels.
    pub focal_px: f64,
    /// Median distance of a sighting from its local parabola, pixels.
    pub scatter_px: f64,
}

impl Path {
    /// Robust local parabolas through a view's sightings; a sighting that its neighbours contradict makes none.
    pub fn new(view: &View, offset_s: f64) -> Self {
        let focal_px = 0.5 * (view.lens.fx_px + view.lens.fy_px);
        let points: Vec<(f64, Vector2<f64>)> = view
            .sightings
            .iter()
            .filter_map(|s| {
                let n = view.lens.direction(Pixel::new(s.pixel_px.x, s.pixel_px.y)).ok()?;
                Some((s.stamped_s + offset_s, Vector2::new(n.x, n.y)))
            })
            .collect();
        let mut knots = Vec::with_capacity(points.len());
        let mut distances_px = vec![];
        let (mut low, mut high) = (0, 0);
        for &(time_s, seen) in &points {
            while points[low].0 < time_s - WINDOW_S {
                low += 1;
            }
            while high < points.len() && points[high].0 <= time_s + WINDOW_S {
                high += 1;
            }
            let Some((direction, rate, scale)) = parabola(&points[low..high], time_s, focal_px) else {
                continue;
            };
            distances_px.push(focal_px * (seen - direction).norm());
            if (seen - direction).norm() < 4.0 * scale {
                knots.push(Knot {
                    time_s,
                    direction,
                    rate,
                });
            }
        }
        distances_px.sort_by(f64::total_cmp);
        Self {
            knots,
            focal_px,
            scatter_px: distances_px.get(distances_px.len() / 2).copied().unwrap_or(0.0),
        }
    }

    /// Direction at a time; `None` in gaps.
    pub fn at(&self, time_s: f64) -> Option<Normalized> {
        let next = self.knots.partition_point(|k| k.time_s <= time_s);
        let (a, b) = (self.knots.get(next.checked_sub(1)?)?, self.knots.get(next)?);
        let span = b.time_s - a.time_s;
        if span > BRIDGE_S {
            return None;
        }
        let u = (time_s - a.time_s) / span;
        let (u2, u3) = (u * u, u * u * u);
        let x = a.direction * (2.0 * u3 - 3.0 * u2 + 1.0)
            + a.rate * (span * (u3 - 2.0 * u2 + u))
            + b.direction * (3.0 * u2 - 2.0 * u3)
            + b.rate * (span * (u3 - u2));
        Some(Normalized { x: x.x, y: x.y })
    }

    /// Knots spread evenly over the way the image travels (and a little over time), at most `count`, among
    /// those where `other` is seen at the same time plus `shift_s`; and the seconds that both see.
    pub fn common(&self, other: &Path, shift_s: f64, count: usize) -> (Vec<f64>, f64) {
        let mut way = vec![];
        let (mut total, mut common_s) = (0.0, 0.0);
        let mut last: Option<&Knot> = None;
        for knot in &self.knots {
            if other.at(knot.time_s + shift_s).is_none() {
                continue;
            }
            if let Some(last) = last {
                let moved = self.focal_px * (knot.direction - last.direction).norm();
                total += moved.min(60.0) + 2.0 * (knot.time_s - last.time_s).min(0.5);
                common_s += (knot.time_s - last.time_s).min(BRIDGE_S);
            }
            last = Some(knot);
            way.push((total, knot.time_s));
        }
        let step = total / count as f64;
        let mut next = 0.0;
        let mut chosen = vec![];
        for (length, time_s) in way {
            if length >= next {
                chosen.push(time_s);
                next = length + step;
            }
        }
        (chosen, common_s)
    }

    /// Times of all knots.
    pub fn times_s(&self) -> impl Iterator<Item = f64> + '_ {
        self.knots.iter().map(|k| k.time_s)
    }
}

/// Value, rate and scatter at `time_s` of a robust parabola; a line for three points, nothing for fewer.
fn parabola(
    points: &[(f64, Vector2<f64>)],
    time_s: f64,
    focal_px: f64,
) -> Option<(Vector2<f64>, Vector2<f64>, f64)> {
    if points.len() < 3 {
        return None;
    }
    let bend = if points.len() > 4 { 1e-9 } else { 1e6 };
    let floor = 1.0 / focal_px;
    let mut scale = f64::INFINITY;
    let (mut a, mut b) = (Vector3::zeros(), Vector3::zeros());
    for round in 0..4 {
        let mut normal = Matrix3::from_diagonal(&Vector3::new(1e-9, 1e-9, bend));
        let (mut x, mut y) = (Vector3::zeros(), Vector3::zeros());
        for (t, p) in points {
            let u = (t - time_s) / WINDOW_S;
            let row = Vector3::new(1.0, u, u * u);
            let miss = (p - Vector2::new(a.dot(&row), b.dot(&row))).norm();
            let weight = if round == 0 {
                1.0
            } else {
                1.0 / (1.0 + (miss / scale).powi(2)).powi(2)
            };
            normal += weight * row * row.transpose();
            x += weight * p.x * row;
            y += weight * p.y * row;
        }
        let inverse = normal.try_inverse()?;
        (a, b) = (inverse * x, inverse * y);
        let mut misses: Vec<f64> = points
            .iter()
            .map(|(t, p)| {
                let u = (t - time_s) / WINDOW_S;
                let row = Vector3::new(1.0, u, u * u);
                (p - Vector2::new(a.dot(&row), b.dot(&row))).norm()
            })
            .collect();
        misses.sort_by(f64::total_cmp);
        scale = (1.5 * misses[misses.len() / 2]).max(floor);
    }
    Some((
        Vector2::new(a[0], b[0]),
        Vector2::new(a[1], b[1]) / WINDOW_S,
        scale,
    ))
}

#[cfg(test)]
mod tests {
    use super::super::synthetic::LENS;
    use super::super::view::Sighting;
    use super::*;

    #[test]
    fn a_false_point_is_left_out_and_a_gap_is_not_bridged() {
        let mut sightings = vec![];
        for k in 0..100 {
            let t = 0.04 * f64::from(k);
            if (2.0..3.0).contains(&t) {
                continue;
            }
            let mut pixel = LENS.pixel(Normalized {
                x: 0.05 * t,
                y: 0.1 * (t - 1.0).powi(2),
            });
            if k == 20 {
                pixel.x += 100.0;
            }
            sightings.push(Sighting {
                stamped_s: t,
                pixel_px: pixel.vector(),
                sigma_px: 1.0,
            });
        }
        let view = View {
            sightings,
            height_px: 1080.0,
            epoch_s: 0.0,
            lens: LENS,
        };
        let path = Path::new(&view, 5.0);
        assert!(path.at(5.0 + 2.5).is_none());
        for t in [0.5, 0.8, 0.81, 1.37, 3.5] {
            let n = path.at(5.0 + t).unwrap();
            let miss = LENS.fx_px * (n.x - 0.05 * t).hypot(n.y - 0.1 * (t - 1.0).powi(2));
            assert!(miss < 0.5, "{miss} px at {t}");
        }
    }
}
