//! Where the ball of a flight, seen by some cameras, will be in the picture of any camera of the calibration.

use nalgebra::{Matrix2, Matrix2x3, Matrix3};

use super::trajectory::TERMS;
use super::{SolvedFlight, Trajectory};
use crate::scene::BALL_RADIUS_M;
use crate::scene::{CameraCalibration, ForeseenPath, ForeseenPlace};
use crate::time::TrueMidpoint;

/// A place in every so many seconds: the picture of a pitch bends by less than 0.1 px between two.
const STEP_S: f64 = 0.004;
/// A place that is worse than this (1σ) tells nobody where to look, pixels.
const SIGMA_MAX_PX: f64 = 5.0;

/// The way of this ball through a camera's picture, from where it was first seen to the plate.
pub fn foresee(camera: &CameraCalibration, flight: &SolvedFlight) -> ForeseenPath {
    let (begin_s, end_s) = flight.trajectory.span_s();
    let steps = ((end_s - begin_s) / STEP_S).clamp(0.0, 1000.0) as usize;
    let mut places: Vec<ForeseenPlace> = Vec::with_capacity(steps + 1);
    for step in 0..=steps {
        let Some(place) = place(camera, flight, begin_s + STEP_S * step as f64) else {
            continue;
        };
        if places.last().is_none_or(|last| last.stamped < place.stamped) {
            places.push(place);
        }
    }
    ForeseenPath::new(places)
}

/// The ball's picture at a true time, if it is in the picture and known well enough.
fn place(camera: &CameraCalibration, flight: &SolvedFlight, t_s: f64) -> Option<ForeseenPlace> {
    let path = &flight.trajectory;
    let basis = path.basis(t_s);
    let seen = camera.camera_from_world.transform(&path.position_at(&basis));
    let projected = camera.intrinsics.project_with_jacobian(&seen).ok()?;
    let centre = projected.pixel;
    let inside = (0.0..f64::from(camera.width_px)).contains(&centre.x)
        && (0.0..f64::from(camera.height_px)).contains(&centre.y);
    if !inside || seen.z <= 0.0 {
        return None;
    }
    let by_position: Matrix2x3<f64> = projected.by_camera_point * camera.camera_from_world.rotation.matrix();
    let velocity = by_position * path.velocity_at(&basis);
    let clock_s2 = camera.capture_delay_sigma_s.powi(2) + camera.jitter_sigma_s.powi(2);
    let covariance: Matrix2<f64> =
        by_position * position_covariance_m2(path, flight, t_s) * by_position.transpose()
            + velocity * velocity.transpose() * clock_s2;
    let sigma_px = covariance.symmetric_eigenvalues().max().max(0.0).sqrt();
    if !(sigma_px < SIGMA_MAX_PX) {
        return None;
    }
    let truth = TrueMidpoint::from_seconds_since(path.epoch_ns(), t_s);
    let focal_px = 0.5 * (camera.intrinsics.fx_px + camera.intrinsics.fy_px);
    Some(ForeseenPlace {
        stamped: camera.timing().stamped_midpoint(truth, centre.y),
        centre,
        sigma_px,
        radius_px: focal_px * BALL_RADIUS_M / seen.z,
    })
}

/// Covariance of the position at a fixed time, m².
fn position_covariance_m2(path: &Trajectory, flight: &SolvedFlight, t_s: f64) -> Matrix3<f64> {
    let basis = path.basis(t_s).value;
    Matrix3::from_fn(|row, column| {
        let mut sum = 0.0;
        for (i, a) in basis.iter().enumerate() {
            for (j, b) in basis.iter().enumerate() {
                let of_both = flight.covariance.get((row * TERMS + i, column * TERMS + j));
                sum += a * b * of_both.copied().unwrap_or(0.0);
            }
        }
        sum
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flight::synthetic::{Spoil, calibrated, observe, seeded, three_cameras, throw};
    use crate::flight::{FlightOptions, flight_so_far};
    use crate::scene::{Calibration, Track};

    const RELEASE_NS: i64 = 1_000_000_000;

    /// Two cameras have seen it for 120 ms: the third's places are as far off as their sigmas say.
    #[test]
    fn the_third_camera_sees_the_ball_where_two_foresee_it() {
        let cameras = three_cameras();
        let calibration = Calibration::without_covariance(cameras.iter().map(calibrated).collect());
        let (mut squares, mut count) = (0.0, 0.0);
        for (seed, kind) in (60..).zip(["fastball", "sinker", "slider", "curve", "change", "knuckle"]) {
            let mut random = seeded(seed);
            let flown = throw(kind, &mut random).fly();
            let spoil = Spoil {
                noise_px: 0.5,
                outliers: 0.0,
                misses: 0.1,
                jitter_s: 0.0,
            };
            let seen: Vec<Track> = cameras
                .iter()
                .map(|camera| observe(camera, &flown, RELEASE_NS, &spoil, &mut random))
                .collect();
            let mut begun = seen.clone();
            begun.truncate(2);
            for (track, camera) in begun.iter_mut().zip(&cameras) {
                let t_s =
                    |p: &crate::scene::TrackPoint| camera.timing.true_seconds(p.stamped, 0.0, RELEASE_NS);
                track.points.retain(|p| t_s(p) < 0.12);
            }
            let options = FlightOptions::default().in_flight();
            let flight = flight_so_far(&calibration, &begun, &options).unwrap();
            let home = calibration.camera(&cameras[2].id).unwrap();
            let path = foresee(home, &flight);
            let mut told = 0;
            for point in &seen[2].points {
                let Some(place) = path.at(point.stamped) else {
                    continue;
                };
                told += 1;
                let variance = 2.0 * (place.sigma_px.powi(2) + 0.25);
                squares += (place.centre.vector() - point.pixel.vector()).norm_squared() / variance;
                count += 1.0;
            }
            println!(
                "{kind}: {told} of {} frames, {:?}",
                seen[2].points.len(),
                path.places().last()
            );
            assert!(told >= 20, "{kind}: {told} frames");
        }
        let spread = f64::sqrt(squares / count);
        println!("places are {spread:.2} sigmas off");
        assert!((0.3..1.5).contains(&spread), "{spread}");
    }
}
