//! A ball still in flight: where it is, and where it will cross the front of the plate.
//!
//! It is the flight of [`super::solve`], with the points that are there so far: the prior of drag and lift says how the
//! rest goes, and its width is in the sigma.

use super::numbers::{NumbersError, PLATE_FRONT_Y_M, PlaneState, position_sigma_m, state_at_plane};
use super::solve::{FlightOptions, solve_flight};
use super::{FlightError, SolvedFlight};
use crate::scene::{Calibration, Outlook, Track};
use crate::time::TrueMidpoint;

/// Points this far off the common flight (rms, pixels) are not of one ball.
const ONE_BALL_PX: f64 = 2.0;
/// Slowest and fastest ball that is a pitch, m/s.
const SPEED_MPS: [f64; 2] = [15.0, 60.0];
/// A pitch crosses the plate's plane no further than this from the plate's middle, and no higher or lower, metres.
const ASIDE_M: f64 = 3.0;
const HEIGHT_M: [f64; 2] = [-2.0, 5.0];
/// A plate location that is worse than this (1σ, metres) is none.
const SIGMA_MAX_M: f64 = 0.5;
/// Share of the points that must be on the flight.
const KEPT_MIN: f64 = 0.7;

/// Why the points so far tell of no pitch.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum OutlookError {
    /// No flight.
    #[error(transparent)]
    Flight(#[from] FlightError),
    /// A flight that misses the plate's plane.
    #[error(transparent)]
    Numbers(#[from] NumbersError),
    /// A flight, but not of a pitched ball.
    #[error("no pitch: {0}")]
    NoPitch(&'static str),
    /// The points do not tell enough yet.
    #[error("the plate location is only good to {sigma_m:.2} m yet")]
    TooEarly {
        /// 1σ, the larger axis.
        sigma_m: f64,
    },
}

/// The flight of the pitched ball of these tracks, as far as it is seen.
///
/// # Errors
/// [`OutlookError`]; the next frames may mend it.
pub fn flight_so_far(
    calibration: &Calibration,
    tracks: &[Track],
    options: &FlightOptions,
) -> Result<SolvedFlight, OutlookError> {
    let solved = solve_flight(calibration, tracks, options)?;
    let plate = plate_of(&solved)?;
    plausible(&solved, plate.position_m.x, plate.position_m.z)?;
    Ok(solved)
}

/// Where a ball in flight is, and where it will cross the plate.
///
/// # Errors
/// [`OutlookError`]; the next frames may mend it.
pub fn outlook_of(solved: &SolvedFlight) -> Result<Outlook, OutlookError> {
    let (path, covariance) = (&solved.trajectory, &solved.covariance);
    let plate = plate_of(solved)?;
    let now_s = solved.observed_s.1;
    let position = path.position_m(now_s);
    let sigma_m = [plate.sigma(0), plate.sigma(2)];
    let worst = sigma_m[0].max(sigma_m[1]);
    if !(worst < SIGMA_MAX_M) {
        return Err(OutlookError::TooEarly { sigma_m: worst });
    }
    let true_ns = |t: f64| TrueMidpoint::from_seconds_since(path.epoch_ns(), t).nanos();
    Ok(Outlook {
        cameras: solved.cameras(),
        points: solved.kept(),
        time_ns: true_ns(now_s),
        position_m: position.into(),
        position_sigma_m: position_sigma_m(path, covariance, now_s),
        velocity_mps: path.velocity_mps(now_s).into(),
        plate_time_ns: true_ns(plate.time_s),
        plate_time_sigma_s: plate.sigma(7),
        plate_front_m: [plate.position_m.x, plate.position_m.z],
        plate_front_sigma_m: sigma_m,
        plate_speed_mps: plate.speed_mps,
    })
}

fn plate_of(solved: &SolvedFlight) -> Result<PlaneState, NumbersError> {
    state_at_plane(
        &solved.trajectory,
        &solved.covariance,
        (PLATE_FRONT_Y_M, "front of the plate"),
    )
}

/// Whether the tracks are of one ball, and that ball is pitched.
fn plausible(solved: &SolvedFlight, plate_x_m: f64, plate_z_m: f64) -> Result<(), OutlookError> {
    let refused = |why| Err(OutlookError::NoPitch(why));
    let kept = solved.kept() as f64;
    let all = kept + solved.outliers() as f64;
    if solved.cameras().len() < 2 || solved.tracks.iter().any(|t| t.kept < t.outliers) {
        return refused("the tracks are not of one ball");
    }
    if solved.rms_px() > ONE_BALL_PX || kept < KEPT_MIN * all {
        return refused("the points do not lie on one flight");
    }
    let velocity = solved.trajectory.velocity_mps(solved.observed_s.1);
    if !(SPEED_MPS[0]..SPEED_MPS[1]).contains(&velocity.norm()) {
        return refused("too slow or too fast");
    }
    if plate_x_m.abs() > ASIDE_M || !(HEIGHT_M[0]..HEIGHT_M[1]).contains(&plate_z_m) {
        return refused("it goes elsewhere");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flight::sighting::CameraModel;
    use crate::flight::synthetic::{Spoil, calibrated, observe, seeded, three_cameras, throw};

    const RELEASE_NS: i64 = 1_000_000_000;

    fn calibration(cameras: &[CameraModel]) -> Calibration {
        Calibration::without_covariance(cameras.iter().map(calibrated).collect())
    }

    /// Points until `before_s` before the plate: the outlook's miss at the plate over its sigma, and in metres.
    fn miss(kind: &str, seed: u64, before_s: f64) -> ([f64; 2], f64) {
        let cameras = three_cameras();
        let mut random = seeded(seed);
        let flown = throw(kind, &mut random).fly();
        let (plate_s, plate, _) = flown.at_y(PLATE_FRONT_Y_M);
        let spoil = Spoil {
            noise_px: 0.3,
            outliers: 0.0,
            misses: 0.0,
            jitter_s: 0.0,
        };
        let tracks: Vec<Track> = cameras
            .iter()
            .map(|camera| {
                let mut track = observe(camera, &flown, RELEASE_NS, &spoil, &mut random);
                track
                    .points
                    .retain(|p| camera.timing.true_seconds(p.stamped, 0.0, RELEASE_NS) < plate_s - before_s);
                track
            })
            .collect();
        let begun = std::time::Instant::now();
        let options = FlightOptions::default().in_flight();
        let solved = flight_so_far(&calibration(&cameras), &tracks, &options).unwrap();
        let outlook = outlook_of(&solved).unwrap();
        let took = begun.elapsed();
        let off = [
            outlook.plate_front_m[0] - plate.x,
            outlook.plate_front_m[1] - plate.z,
        ];
        let sigma = outlook.plate_front_sigma_m;
        let miss_m = off[0].hypot(off[1]);
        let late_s = outlook.plate_time_ns as f64 * 1e-9 - 1.0 - plate_s;
        println!(
            "{kind} {seed}: {:.1} mm off, sigma {:.1} {:.1} mm, {:.2} ms late, {} points, {took:?}",
            1e3 * miss_m,
            1e3 * sigma[0],
            1e3 * sigma[1],
            1e3 * late_s,
            outlook.points
        );
        assert!(late_s.abs() < 0.004, "{kind} {seed}: {late_s} s late");
        ([off[0] / sigma[0], off[1] / sigma[1]], miss_m)
    }

    /// 150 ms before the plate the newest point is some 40 ms old: six frames of lag and the fit.
    #[test]
    fn the_plate_is_foretold_within_five_centimetres() {
        let (mut squares, mut count) = (0.0_f64, 0.0_f64);
        for kind in ["fastball", "sinker", "slider", "curve", "change"] {
            for seed in 0..6 {
                let (sigmas, miss_m) = miss(kind, 40 + seed, 0.190);
                assert!(miss_m < 0.05, "{kind} {seed}: {miss_m} m");
                squares += sigmas[0] * sigmas[0] + sigmas[1] * sigmas[1];
                count += 2.0;
            }
        }
        let spread = (squares / count).sqrt();
        println!("misses are {spread:.2} sigmas");
        assert!(count > 50.0 && (0.4..1.6).contains(&spread), "{spread}");
    }
}
