//! Where a ball must have been, by the fitted centres around that frame.

use nalgebra::{Matrix3, Vector2, Vector3};

use super::fit::FittedCentre;
use crate::scene::Track;

/// Fitted centres used, the nearest in time.
const NEIGHBOURS: usize = 10;
/// Fewest that give a path.
const NEIGHBOURS_MIN: usize = 5;
/// Neighbours further than this from the path are left out, worst first.
const STRAY_PX: f64 = 0.6;

/// The place of point `index` on a parabola through the fitted centres nearest to it in time, without its own.
pub fn between(track: &Track, centres: &[Option<FittedCentre>], index: usize) -> Option<Vector2<f64>> {
    let epoch = track.points.get(index)?.stamped.nanos();
    let mut near: Vec<(f64, Vector2<f64>)> = track
        .points
        .iter()
        .zip(centres)
        .enumerate()
        .filter(|(i, _)| *i != index)
        .filter_map(|(_, (point, centre))| {
            Some((point.stamped.seconds_since(epoch), centre.as_ref()?.centre_px))
        })
        .collect();
    near.sort_by(|a, b| a.0.abs().total_cmp(&b.0.abs()));
    near.truncate(NEIGHBOURS);
    while near.len() >= NEIGHBOURS_MIN {
        let curve = Parabola::through(&near)?;
        let worst = near
            .iter()
            .map(|(t, at)| (curve.at(*t) - at).norm())
            .enumerate()
            .max_by(|a, b| a.1.total_cmp(&b.1))?;
        if worst.1 < STRAY_PX {
            return Some(curve.at(0.0));
        }
        near.remove(worst.0);
    }
    None
}

/// Position as a quadratic of time.
struct Parabola {
    scale_s: f64,
    x: Vector3<f64>,
    y: Vector3<f64>,
}

impl Parabola {
    fn through(near: &[(f64, Vector2<f64>)]) -> Option<Self> {
        let scale_s = near.iter().map(|(t, _)| t.abs()).fold(1e-6, f64::max);
        let mut normal = Matrix3::zeros();
        let (mut x, mut y) = (Vector3::zeros(), Vector3::zeros());
        for (t, at) in near {
            let row = powers(t / scale_s);
            normal += row * row.transpose();
            x += row * at.x;
            y += row * at.y;
        }
        let cholesky = normal.cholesky()?;
        Some(Self {
            scale_s,
            x: cholesky.solve(&x),
            y: cholesky.solve(&y),
        })
    }

    fn at(&self, t_s: f64) -> Vector2<f64> {
        let row = powers(t_s / self.scale_s);
        Vector2::new(row.dot(&self.x), row.dot(&self.y))
    }
}

fn powers(u: f64) -> Vector3<f64> {
    Vector3::new(1.0, u, u * u)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pixel;
    use crate::scene::{CameraId, TrackPoint};
    use crate::time::StampedMidpoint;

    #[test]
    fn the_path_ignores_the_point_itself_and_a_stray() {
        let at = |i: usize| {
            let t = i as f64;
            Vector2::new(100.0 + 16.0 * t - 0.05 * t * t, 50.0 + 0.4 * t * t)
        };
        let track = Track {
            camera: CameraId::new("a").unwrap(),
            track: 0,
            points: (0..20)
                .map(|i| TrackPoint {
                    frame: i as u64,
                    stamped: StampedMidpoint::from_seconds_since(0, i as f64 / 175.0),
                    pixel: Pixel::new(0.0, 0.0),
                    covariance_px2: None,
                })
                .collect(),
        };
        let mut centres: Vec<Option<FittedCentre>> = (0..20)
            .map(|i| {
                Some(FittedCentre {
                    centre_px: at(i),
                    covariance_px2: nalgebra::Matrix2::identity(),
                    chi2: 1.0,
                })
            })
            .collect();
        for (i, off) in [(8, 5.0), (10, -4.0)] {
            if let Some(centre) = &mut centres[i] {
                centre.centre_px.y += off;
            }
        }
        let found = between(&track, &centres, 10).unwrap();
        assert!((found - at(10)).norm() < 1e-3, "{found} is not {}", at(10));
        centres.truncate(4);
        assert!(between(&track, &centres, 2).is_none());
    }
}
