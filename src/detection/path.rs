//! Where a ball must have been, by the fitted centres around that frame.

use nalgebra::{Matrix3, Vector2, Vector3};

use super::fit::FittedCentre;
use super::median::median;
use crate::scene::{BALL_RADIUS_M, Track, TrackPoint};
use crate::time::StampedMidpoint;

/// Fitted centres used, the nearest in time.
const NEIGHBOURS: usize = 10;
/// Fewest that give a path.
const NEIGHBOURS_MIN: usize = 5;
/// Centres that tell the level.
const LEVELS: usize = 5;
/// Neighbours further than this from the path are left out, worst first.
const STRAY_PX: f64 = 0.6;
/// What a parabola does not know, 1σ: the force on a knuckleball, 10 m/s², changes within a twentieth of a second.
const JERK_SIGMA_MPS3: f64 = 200.0;
/// How far a sure centre is from its path, 1σ: next to players backgrounds are unsure.
const PATH_SIGMA_PX: f64 = 0.06;

/// Where a ball must be in a frame.
#[derive(Debug, Clone, Copy)]
pub struct Place {
    /// Centre, pixels.
    pub centre_px: Vector2<f64>,
    /// Velocity, pixels per second.
    pub velocity_px_per_s: Vector2<f64>,
    /// Level of the ball in the frames around ([`FittedCentre::level`]).
    pub level: f64,
    /// How unsure the centre is, no less than one fitted centre, pixels.
    pub sigma_px: f64,
    /// Variance of the place over that of one centre of the path: what all centres are off at random, it is off so much of.
    pub share_of_one: f64,
    /// How far off the centre is for a path whose acceleration changes by 1 px/s³, s³: a parabola leaves that out.
    pub bend_s3: f64,
}

impl Place {
    /// 1σ of what the parabola leaves out for a ball of this radius, pixels.
    pub fn bend_sigma_px(&self, radius_px: f64) -> f64 {
        JERK_SIGMA_MPS3 * radius_px / BALL_RADIUS_M * self.bend_s3
    }
}

/// The place of point `index` on a parabola through the fitted centres nearest to it in time, without its own.
pub fn between(track: &Track, centres: &[Option<FittedCentre>], index: usize) -> Option<Place> {
    let epoch = track.points.get(index)?.stamped.nanos();
    let near = track.points.iter().zip(centres).enumerate();
    let near = near
        .filter(|(i, _)| *i != index)
        .filter_map(|(_, (point, centre))| Some(Near::new(epoch, point.stamped, centre.as_ref()?)));
    place(near.collect())
}

/// A fitted centre near the time that is asked for.
#[derive(Clone, Copy)]
pub struct Near {
    t_s: f64,
    centre_px: Vector2<f64>,
    /// How much it says about the path, 1/px².
    weight: f64,
    level: f64,
}

impl Near {
    /// Of a frame with this stamp.
    pub fn new(epoch_ns: i64, stamped: StampedMidpoint, centre: &FittedCentre) -> Self {
        Self {
            t_s: stamped.seconds_since(epoch_ns),
            centre_px: centre.centre_px,
            weight: 1.0 / (0.5 * centre.covariance_px2.trace() + PATH_SIGMA_PX.powi(2)),
            level: centre.level,
        }
    }

    /// A point of a track, by the covariance that it has.
    pub fn of_point(epoch_ns: i64, point: &TrackPoint) -> Option<Self> {
        Some(Self {
            t_s: point.stamped.seconds_since(epoch_ns),
            centre_px: point.pixel.vector(),
            weight: 1.0 / (0.5 * point.covariance_px2?.trace() + PATH_SIGMA_PX.powi(2)),
            level: 0.0,
        })
    }
}

/// Where the ball is at time 0, on a parabola through those of the centres that are nearest to it.
pub fn place(mut near: Vec<Near>) -> Option<Place> {
    near.sort_by(|a, b| a.t_s.abs().total_cmp(&b.t_s.abs()));
    near.truncate(NEIGHBOURS);
    let level = median(near.iter().take(LEVELS).map(|n| n.level))?;
    while near.len() >= NEIGHBOURS_MIN {
        let curve = Parabola::through(&near)?;
        let worst = near
            .iter()
            .map(|n| (curve.at(n.t_s) - n.centre_px).norm())
            .enumerate()
            .max_by(|a, b| a.1.total_cmp(&b.1))?;
        if worst.1 < STRAY_PX {
            return Some(Place {
                centre_px: curve.at(0.0),
                velocity_px_per_s: Vector2::new(curve.x.y, curve.y.y) / curve.scale_s,
                level,
                sigma_px: curve.sigma_px.max(PATH_SIGMA_PX),
                share_of_one: curve.share_of_one,
                bend_s3: curve.bend_s3,
            });
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
    /// Standard deviation at time 0, pixels.
    sigma_px: f64,
    /// Its square over the mean variance of a centre.
    share_of_one: f64,
    /// Distance at time 0 from a cubic that is t³/6 in seconds, s³.
    bend_s3: f64,
}

impl Parabola {
    fn through(near: &[Near]) -> Option<Self> {
        let scale_s = near.iter().map(|n| n.t_s.abs()).fold(1e-6, f64::max);
        let mut normal = Matrix3::zeros();
        let (mut x, mut y, mut cubic) = (Vector3::zeros(), Vector3::zeros(), Vector3::zeros());
        for near in near {
            let row = powers(near.t_s / scale_s);
            let weighted = row * near.weight;
            normal += weighted * row.transpose();
            x += weighted * near.centre_px.x;
            y += weighted * near.centre_px.y;
            cubic += weighted * (near.t_s / scale_s).powi(3);
        }
        let cholesky = normal.cholesky()?;
        let variance = cholesky.solve(&powers(0.0)).x;
        let weight = near.iter().map(|n| n.weight).sum::<f64>() / near.len() as f64;
        Some(Self {
            scale_s,
            x: cholesky.solve(&x),
            y: cholesky.solve(&y),
            sigma_px: variance.sqrt(),
            share_of_one: variance * weight,
            bend_s3: cholesky.solve(&cubic).x.abs() * scale_s.powi(3) / 6.0,
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
    use crate::scene::CameraId;
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
                    covariance_px2: nalgebra::Matrix2::identity() * 1e-4,
                    chi2: 1.0,
                    level: 90.0 + i as f64,
                })
            })
            .collect();
        for (i, off) in [(8, 5.0), (10, -4.0)] {
            if let Some(centre) = &mut centres[i] {
                centre.centre_px.y += off;
            }
        }
        let found = between(&track, &centres, 10).unwrap();
        let off = found.centre_px - at(10);
        assert!(off.norm() < 1e-3, "{found:?} is not {}", at(10));
        // x′ = 16 − 0.1·10 = 15, y′ = 0.8·10 = 8 px a frame; the levels near are 98 to 103 without 100.
        let velocity = Vector2::new(15.0, 8.0) * 175.0;
        assert!((found.velocity_px_per_s - velocity).norm() < 0.1, "{found:?}");
        assert!((98.0..=103.0).contains(&found.level), "{found:?}");
        centres.truncate(4);
        assert!(between(&track, &centres, 2).is_none());
    }

    #[test]
    fn beyond_its_points_a_path_is_as_unsure_as_a_parabola_is() {
        let near = |frames: std::ops::RangeInclusive<i32>| {
            let near = frames.map(|frame| Near {
                t_s: f64::from(frame),
                centre_px: Vector2::new(f64::from(frame), 0.0),
                weight: 0.04_f64.powi(-2),
                level: 90.0,
            });
            place(near.collect()).unwrap()
        };
        // Five points −2..2, 0.04 px each: Σt⁰ = 5, Σt² = 10, Σt⁴ = 34; the inverse's first element is 34 / (5·34 − 10²) = 34/70,
        // but one fitted centre is no surer than 0.06 px.
        assert!((near(-2..=2).sigma_px - 0.06).abs() < 1e-9);
        // The same points one frame ahead of their last (u = 3): (34 − 2·10·9 + 5·81)/70 + 9/10 = 259/70 + 9/10.
        let ahead = near(-5..=-1);
        assert!(
            (ahead.sigma_px - 0.04 * (259.0_f64 / 70.0 + 0.9).sqrt()).abs() < 1e-9,
            "{ahead:?}"
        );
        assert!(near(-16..=-12).sigma_px > 0.4);
        assert!(
            (ahead.share_of_one - (259.0 / 70.0 + 0.9)).abs() < 1e-9,
            "{ahead:?}"
        );
        // u³ on −2..2 is 3.4 u (Σu⁴/Σu² = 34/10) and nothing else: at u = 3 it is off by 27 − 10.2, at u = 0 by nothing.
        assert!((ahead.bend_s3 - 16.8 / 6.0).abs() < 1e-9, "{ahead:?}");
        assert!(near(-2..=2).bend_s3 < 1e-9);
    }
}
