//! The single-pitch solver against flights it did not make.

use super::equations::{FlightEquations, Loss};
use super::sighting::{CAMERA_COLUMNS, CameraModel, Sight};
use super::solve::{FlightOptions, fit_flight, gather};
use super::synthetic::{Spoil, observe, seeded, three_cameras, throw};
use super::trajectory::{FLIGHT_PARAMETERS, FlightPrior, Trajectory};
use super::{Aerodynamics, Physics};

const CLEAN: Spoil = Spoil {
    noise_px: 0.0,
    outliers: 0.0,
    misses: 0.0,
    jitter_s: 0.0,
};

fn tracks(
    cameras: &[CameraModel],
    kind: &str,
    seed: u64,
    spoil: &Spoil,
) -> (Vec<crate::scene::Track>, super::synthetic::Flown) {
    let mut random = seeded(seed);
    let flown = throw(kind, &mut random).fly();
    let tracks = cameras
        .iter()
        .map(|c| observe(c, &flown, 1_000_000_000, spoil, &mut random))
        .collect();
    (tracks, flown)
}

/// Noise-free pixels with the weights of 0.3 px: what is left is the model's error. Returns (max mm over
/// the observed flight, plate error mm, release speed error m/s).
fn model_error(kind: &str, seed: u64) -> (f64, f64, f64) {
    let cameras = three_cameras();
    let (mut tracks, flown) = tracks(&cameras, kind, seed, &CLEAN);
    for p in tracks.iter_mut().flat_map(|t| &mut t.points) {
        p.covariance_px2 = Some(nalgebra::Matrix2::identity() * 0.09);
    }
    let sightings = gather(&cameras, &tracks).unwrap();
    let state = fit_flight(&cameras, &sightings, 1_000_000_000, &FlightOptions::default()).unwrap();
    let mut worst: f64 = 0.0;
    let steps = (flown.duration_s() / 0.002) as usize;
    for i in 5..steps - 1 {
        let t = i as f64 * 0.002;
        worst = worst.max((state.trajectory.position_m(t) - flown.position_m(t)).norm());
    }
    let (_, plate, _) = flown.at_y(0.4318);
    let t = state.trajectory.time_at_y(0.4318).unwrap();
    let plate_error = (state.trajectory.position_m(t) - plate).norm();
    let (_, _, v) = flown.at_y(16.0);
    let t = state.trajectory.time_at_y(16.0).unwrap();
    let speed_error = state.trajectory.velocity_mps(t).norm() - v.norm();
    println!(
        "{kind} {seed}: worst {:.3} mm, plate {:.3} mm, speed {:.4} m/s, level {}",
        1e3 * worst,
        1e3 * plate_error,
        speed_error,
        state.prior.acceleration_sigma_mps2
    );
    (1e3 * worst, 1e3 * plate_error, speed_error)
}

#[test]
fn model_error_is_below_a_fifth_of_a_millimetre() {
    let mut cases = 0;
    for kind in ["fastball", "sinker", "slider", "curve", "change", "eephus"] {
        for seed in 0..3 {
            let (worst, plate, speed) = model_error(kind, seed);
            assert!(worst < 0.2 && plate < 0.2, "{kind} {seed}: {worst} {plate} mm");
            assert!(speed.abs() < 0.004, "{kind} {seed}: {speed} m/s");
            cases += 1;
        }
    }
    assert_eq!(cases, 18);
}

#[test]
fn knuckleballs_are_followed() {
    for seed in 0..6 {
        let (worst, plate, _) = model_error("knuckle", seed);
        // 4 m/s² of wobble at 3 Hz, 0.3 px: half of the freer flight's own sigma.
        assert!(worst < 2.0 && plate < 0.5, "{worst} {plate} mm");
    }
}

#[test]
fn sight_derivatives_match_central_differences() {
    let cameras = three_cameras();
    let (tracks, flown) = tracks(&cameras, "curve", 3, &CLEAN);
    let aerodynamics = Aerodynamics {
        drag_coefficient: 0.35,
        lift: nalgebra::Vector3::new(0.1, 0.0, -0.1),
        lift_exponent: 0.5,
    };
    let samples: Vec<_> = (0..30)
        .map(|i| 0.013 * f64::from(i))
        .map(|t| (t, flown.position_m(t)))
        .collect();
    let path = Trajectory::through(Physics::default(), 1_000_000_000, &samples, &aerodynamics);
    for (camera, track) in cameras.iter().zip(&tracks) {
        let mut camera = camera.clone();
        camera.timing.skew_epoch_ns = -3_000_000_000;
        camera.timing.height_px = 1024;
        let point = &track.points[20];
        let sight = Sight::new(&camera, point, &path).unwrap();
        let exact = sight.by_camera(&camera, point);
        for k in 0..CAMERA_COLUMNS {
            let h = if k == 7 { 1.0 } else { 1e-5 };
            let at = |s: f64| {
                let mut step = [0.0; CAMERA_COLUMNS];
                step[k] = s * h;
                Sight::new(&camera.perturbed(&step), point, &path)
                    .unwrap()
                    .residual_px
            };
            let numeric = (at(1.0) - at(-1.0)) / (2.0 * h);
            let scale = 1.0 + numeric.norm();
            assert!(
                (numeric - exact.column(k)).norm() < 1e-5 * scale,
                "column {k}: {numeric} {}",
                exact.column(k)
            );
        }
    }
}

#[test]
fn flight_gradient_and_hessian_match_central_differences() {
    let cameras = three_cameras();
    let spoil = Spoil {
        noise_px: 0.3,
        ..CLEAN
    };
    let (tracks, _) = tracks(&cameras, "slider", 5, &spoil);
    let sightings = gather(&cameras, &tracks).unwrap();
    let state = fit_flight(&cameras, &sightings, 1_000_000_000, &FlightOptions::default()).unwrap();
    let prior = FlightPrior::default();
    let loss = Loss::Cauchy { scale: 3.0 };
    // Away from the minimum, so that the gradient is not zero.
    let away = state.trajectory.parameters().map(|p| p * 1.001 + 1e-4);
    let at = state.trajectory.with_parameters(away.clone());
    let equations = FlightEquations::new(&cameras, &at, &sightings, loss, &prior);
    let cost = |p: nalgebra::DVector<f64>| {
        let moved = state.trajectory.with_parameters(p);
        FlightEquations::new(&cameras, &moved, &sightings, loss, &prior).cost()
    };
    for k in 0..FLIGHT_PARAMETERS {
        let h = 1e-7;
        let (mut up, mut down) = (away.clone(), away.clone());
        up[k] += h;
        down[k] -= h;
        let numeric = (cost(up) - cost(down)) / (2.0 * h);
        let exact = 2.0 * equations.gradient[k];
        assert!(
            (numeric - exact).abs() < 2e-4 * (exact.abs() + 0.01 * equations.gradient.norm()),
            "parameter {k}: {numeric} {exact}"
        );
    }
}

#[test]
fn outliers_are_left_out_and_good_points_are_not() {
    let cameras = three_cameras();
    let mut lost = 0;
    for seed in 0..20 {
        let spoil = Spoil {
            noise_px: 0.3,
            outliers: 0.1,
            misses: 0.2,
            jitter_s: 0.0,
        };
        let (tracks, flown) = tracks(&cameras, "fastball", 100 + seed, &spoil);
        let sightings = gather(&cameras, &tracks).unwrap();
        let state = fit_flight(&cameras, &sightings, 1_000_000_000, &FlightOptions::default()).unwrap();
        let t = state.trajectory.time_at_y(0.4318).unwrap();
        let error = (state.trajectory.position_m(t) - flown.at_y(0.4318).1).norm();
        assert!(error < 0.006, "seed {seed}: plate error {error} m");
        let spoil = Spoil {
            noise_px: 0.3,
            ..CLEAN
        };
        let (tracks, _) = super::solve_tests::tracks(&cameras, "fastball", 100 + seed, &spoil);
        let sightings = gather(&cameras, &tracks).unwrap();
        let state = fit_flight(&cameras, &sightings, 1_000_000_000, &FlightOptions::default()).unwrap();
        lost += sightings
            .iter()
            .filter(|s| {
                Sight::new(&cameras[s.camera], &s.point, &state.trajectory)
                    .unwrap()
                    .distance2
                    > super::solve::KEEP_LIMIT * super::solve::KEEP_LIMIT
            })
            .count();
    }
    // Over 4,000 points, 4e-5 expected each.
    assert!(lost <= 2, "{lost} good points lost");
}
