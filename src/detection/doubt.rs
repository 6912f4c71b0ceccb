//! Centres that are off the path of their neighbours by more than both know: half behind a wire, before a step of the light.
//!
//! Such a centre keeps its place, and its covariance gets what it is off: it then says as little as it knows. Done when all has
//! been judged, since what wavers must not pass for unsure.

use nalgebra::{Matrix2, Vector2};

use super::median::median;
use super::path::{Near, place};
use crate::scene::Track;

/// A centre further off than so many σ of the path and its own is doubted.
const SIGMAS_MAX: f64 = 3.0;
/// ... if that is so many times what half of those beside it are off.
const USUAL_RATIO: f64 = 3.0;
/// Points on each side that are beside it.
const BESIDE: usize = 4;
/// Points on each side among which the nearest are looked for.
const REACH: usize = 12;
/// Passes: in the second the path no longer follows what the first doubted.
const PASSES: usize = 2;

/// Widens the covariance of centres that are off the path of their neighbours; `radius_px` is the ball's. Gives how many are.
pub fn doubt(track: &mut Track, radius_px: f64) -> usize {
    let told: Vec<_> = track.points.iter().map(|point| point.covariance_px2).collect();
    let mut doubted = 0;
    for _ in 0..PASSES {
        let off: Vec<Option<Off>> = (0..track.points.len())
            .map(|index| off_path(track, index, (told.get(index).copied().flatten()?, radius_px)))
            .collect();
        let stands_out: Vec<bool> = (0..off.len()).map(|index| stands_out(&off, index)).collect();
        doubted = stands_out.iter().filter(|stands_out| **stands_out).count();
        let all = track
            .points
            .iter_mut()
            .zip(&told)
            .zip(off.iter().zip(&stands_out));
        for ((point, told), (off, stands_out)) in all {
            let wider = off
                .as_ref()
                .filter(|_| *stands_out)
                .map(|off| off.px * off.px.transpose());
            point.covariance_px2 = told.map(|told| wider.map_or(told, |wider| told + wider));
        }
    }
    doubted
}

/// How far a point is off the path of its neighbours, and what is allowed, pixels.
struct Off {
    px: Vector2<f64>,
    allowed_px: f64,
}

/// Whether a point is further off than it may be, and much further than those beside it: where a ball comes near no parabola
/// follows it, and all are off alike. An end, which the path does not reach from both sides, never does.
fn stands_out(off: &[Option<Off>], index: usize) -> bool {
    if index < BESIDE || index + BESIDE >= off.len() {
        return false;
    }
    let Some(Some(own)) = off.get(index) else {
        return false;
    };
    let beside = off.iter().skip(index.saturating_sub(BESIDE)).take(2 * BESIDE + 1);
    let usual = median(beside.flatten().map(|off| off.px.norm())).unwrap_or(0.0);
    own.px.norm() > own.allowed_px.max(USUAL_RATIO * usual)
}

fn off_path(track: &Track, index: usize, (covariance, radius_px): (Matrix2<f64>, f64)) -> Option<Off> {
    let point = track.points.get(index)?;
    let epoch = point.stamped.nanos();
    let near = track.points.iter().enumerate();
    let near = near.skip(index.saturating_sub(REACH)).take(2 * REACH + 1);
    let near = near.filter(|(i, _)| *i != index);
    let place = place(
        near.filter_map(|(_, point)| Near::of_point(epoch, point))
            .collect(),
    )?;
    let variance = 0.5 * covariance.trace() + place.sigma_px.powi(2) + place.bend_sigma_px(radius_px).powi(2);
    Some(Off {
        px: point.pixel.vector() - place.centre_px,
        allowed_px: SIGMAS_MAX * variance.sqrt(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pixel;
    use crate::scene::{CameraId, TrackPoint};
    use crate::time::StampedMidpoint;

    #[test]
    fn a_centre_off_its_neighbours_path_is_as_unsure_as_it_is_off() {
        let sigma_px = 0.03;
        let mut track = Track {
            camera: CameraId::new("a").unwrap(),
            track: 0,
            points: (0..40)
                .map(|i| TrackPoint {
                    frame: i,
                    stamped: StampedMidpoint::from_seconds_since(0, i as f64 / 175.0),
                    pixel: Pixel::new(16.0 * i as f64, 0.01 * (i * i) as f64),
                    covariance_px2: Some(Matrix2::identity() * sigma_px * sigma_px),
                })
                .collect(),
        };
        let still = track.clone();
        assert_eq!(doubt(&mut track, 3.0), 0);
        assert_eq!(track, still);
        track.points[20].pixel.x += 0.8;
        track.points[21].pixel.y -= 0.4;
        assert_eq!(doubt(&mut track, 3.0), 2, "no neighbour is doubted");
        let along = track.points[20].covariance_px2.unwrap();
        assert!(
            (along.m11.sqrt() - 0.8).abs() < 0.08 && along.m22.sqrt() < 0.1,
            "{along}"
        );
        let across = track.points[21].covariance_px2.unwrap();
        assert!((across.m22.sqrt() - 0.4).abs() < 0.05, "{across}");
        assert_eq!(track.points[22].covariance_px2, still.points[22].covariance_px2);
    }

    #[test]
    fn a_ball_that_comes_near_is_not_doubted() {
        // From 23 m to 6 m, 1.5 m off the axis: x = f·X/Z, without noise.
        let mut track = Track {
            camera: CameraId::new("backstop").unwrap(),
            track: 0,
            points: (0..72)
                .map(|i| {
                    let depth_m = 23.0 - 41.0 * i as f64 / 175.0;
                    TrackPoint {
                        frame: i,
                        stamped: StampedMidpoint::from_seconds_since(0, i as f64 / 175.0),
                        pixel: Pixel::new(1790.0 * 1.5 / depth_m, 1790.0 * 2.0 / depth_m),
                        covariance_px2: Some(Matrix2::identity() * 9e-4),
                    }
                })
                .collect(),
        };
        let still = track.clone();
        assert_eq!(doubt(&mut track, 4.0), 0);
        assert_eq!(track, still);
    }
}
