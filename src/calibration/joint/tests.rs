//! The joint estimator from perturbed truth.

use super::problem::JointProblem;
use super::{JointOptions, refine};
use crate::calibration::association::group_pitches;
use crate::calibration::{CalibrationError, InitialEstimate, PitchTracks};
use crate::flight::equations::Loss;
use crate::flight::sighting::CAMERA_COLUMNS;
use crate::scene::{DistanceMeasurement, RollingShutter, WorldFrame};
use crate::simulation::{DetectionNoise, Layout, Scenario, Simulated, simulate_tracks};
use crate::time::StampedMidpoint;

fn start(simulated: &Simulated, seed: u64) -> InitialEstimate {
    use rand::Rng;
    let mut random = crate::flight::synthetic::seeded(seed);
    let mut near = |s: f64| s * (random.random::<f64>() - 0.5) * 2.0;
    InitialEstimate {
        poses: simulated
            .truth
            .cameras
            .iter()
            .map(|c| {
                let step = [
                    near(0.005),
                    near(0.005),
                    near(0.005),
                    near(0.1),
                    near(0.1),
                    near(0.1),
                ];
                Some(c.camera_from_world.perturbed(&step))
            })
            .collect(),
        capture_delay_s: simulated
            .truth
            .cameras
            .iter()
            .map(|c| {
                if c.capture_delay_s == 0.0 {
                    0.0
                } else {
                    c.capture_delay_s + near(0.003)
                }
            })
            .collect(),
        clock_skew_ppm: vec![0.0; simulated.truth.cameras.len()],
        skew_epoch_ns: vec![simulated.truth.epoch_ns; simulated.truth.cameras.len()],
        world: WorldFrame::HomePlate,
        score_px: 1.0,
        notes: Vec::new(),
    }
}

#[test]
fn three_cameras_reach_the_reference_numbers() {
    let (mut delay, mut plate) = (Vec::new(), Vec::new());
    for seed in 1..=3 {
        let scenario = Scenario::stock(Layout::Three, &[0.73, -1.31], 8)
            .with_seed(seed)
            .with_detection(DetectionNoise::gaussian(0.3));
        let simulated = simulate_tracks(&scenario).unwrap();
        let pitches = group_pitches(&simulated.rig, &simulated.tracks);
        let clock = std::time::Instant::now();
        let solved = refine(
            &simulated.rig,
            &pitches,
            &start(&simulated, seed),
            &JointOptions::default(),
        )
        .unwrap();
        println!("took {:?}", clock.elapsed());
        println!(
            "{:?} {}",
            solved.wrong_tracks,
            solved.calibration.warnings.join("; ")
        );
        for (camera, truth) in solved.calibration.cameras.iter().zip(&simulated.truth.cameras) {
            let error = (camera.capture_delay_s - truth.capture_delay_s) * 175.0;
            println!(
                "{}: delay error {:+.4} ± {:.4} frame, noise {:.3} px, jitter {:.1} µs, rms {:.3} px, {} points",
                camera.id,
                error,
                camera.capture_delay_sigma_s * 175.0,
                camera.noise_sigma_px,
                1e6 * camera.jitter_sigma_s,
                camera.reprojection_rms_px,
                camera.points
            );
            delay.push(error);
        }
        for (flight, pitch) in solved.flights.iter().zip(&solved.flight_pitches) {
            let truth = simulated.truth.pitches[*pitch].plate_front_m.unwrap();
            let t = flight.trajectory.time_at_y(0.4318).unwrap();
            let at = flight.trajectory.position_m(t);
            println!(
                "pitch {pitch} {}: plate {:+.2} {:+.2} mm, level {}, outliers {}",
                simulated.truth.pitches[*pitch].name,
                1e3 * (at.x - truth[0]),
                1e3 * (at.z - truth[1]),
                flight.acceleration_sigma_mps2,
                flight.outliers()
            );
            plate.push(1e3 * (at.x - truth[0]).hypot(at.z - truth[1]));
        }
    }
    assert_eq!(plate.len(), 24);
    assert!(delay.iter().all(|d| d.abs() < 0.06), "{delay:?}");
    assert!(plate.iter().sum::<f64>() / 24.0 < 3.5, "{plate:?}");
}

/// Centres to 0.03 px: the wobble of a knuckleball, centimetres, is a thousand sigmas off any rigid flight, in every track.
#[test]
fn a_knuckleball_seen_sharply_keeps_its_tracks() {
    let scenario = Scenario::from_path(std::path::Path::new("config/scenario/three.toml")).unwrap();
    for seed in 1..=2 {
        let scenario = scenario
            .clone()
            .with_seed(seed)
            .with_detection(DetectionNoise::gaussian(0.03));
        let simulated = simulate_tracks(&scenario).unwrap();
        let pitches = group_pitches(&simulated.rig, &simulated.tracks);
        let options = JointOptions::default();
        let solved = refine(&simulated.rig, &pitches, &start(&simulated, seed), &options).unwrap();
        assert!(solved.wrong_tracks.is_empty(), "{:?}", solved.wrong_tracks);
        let names = |i: &usize| simulated.truth.pitches[*i].name.clone();
        let found: Vec<String> = solved.flight_pitches.iter().map(names).collect();
        assert_eq!(found.len(), 8, "{found:?}");
        let knuckle = found.iter().position(|name| name == "KN").unwrap();
        let flight = &solved.flights[knuckle];
        assert!(flight.acceleration_sigma_mps2 > 0.5, "{flight:?}");
        let truth = simulated.truth.pitches[solved.flight_pitches[knuckle]]
            .plate_front_m
            .unwrap();
        let at = flight
            .trajectory
            .position_m(flight.trajectory.time_at_y(0.4318).unwrap());
        let off_mm = 1e3 * (at.x - truth[0]).hypot(at.z - truth[1]);
        assert!(off_mm < 4.0, "{off_mm}");
    }
}

/// Two cameras, four pitches: enough for what is tested, and quick.
fn small(seed: u64) -> (Simulated, Vec<PitchTracks>) {
    let scenario = Scenario::stock(Layout::TwoOpposite, &[0.73], 4)
        .with_seed(seed)
        .with_detection(DetectionNoise::gaussian(0.3));
    let simulated = simulate_tracks(&scenario).unwrap();
    let pitches = group_pitches(&simulated.rig, &simulated.tracks);
    (simulated, pitches)
}

/// Half the cost's gradient by every camera unknown against central differences of the cost, in both worlds
/// and with every kind of term in.
#[test]
fn camera_gradient_matches_central_differences() {
    let (mut simulated, pitches) = small(4);
    let mut checked = 0;
    for world in [WorldFrame::HomePlate, WorldFrame::ReferenceCamera] {
        let rig = &mut simulated.rig;
        for camera in &mut rig.cameras {
            camera.focal_sigma_relative = 0.001;
            camera.rolling_shutter = RollingShutter::Estimate;
            camera.position = Some((nalgebra::Point3::new(10.0, 2.0, 3.0), 0.5));
            for mark in &mut camera.landmarks {
                mark.position.world_sigma_m = 0.02;
            }
        }
        rig.distances = vec![DistanceMeasurement {
            between: (rig.cameras[0].id.clone(), rig.cameras[1].id.clone()),
            distance_m: 39.0,
            sigma_m: 0.1,
        }];
        let mut start = start(&simulated, 4);
        start.world = world;
        if world == WorldFrame::ReferenceCamera {
            // That world begins at the reference camera: 20 m off, the gauge's cost alone would drown the rest.
            let origin = start.poses[0].unwrap().centre_m();
            for pose in start.poses.iter_mut().flatten() {
                pose.translation_m += pose.rotation * origin.coords;
            }
        }
        let (problem, state) =
            JointProblem::new(&simulated.rig, &pitches, &start, &JointOptions::default()).unwrap();
        let loss = Loss::Cauchy { scale: 50.0 };
        let at = problem.linearise(&state, loss);
        for (i, column) in problem.columns.iter().enumerate() {
            let h = match column.kind {
                7 => 1e-2,
                3..=5 => 1e-6,
                _ => 1e-7,
            };
            let cost = |sign: f64| {
                let mut moved = state.clone();
                let mut step = [0.0; CAMERA_COLUMNS];
                step[column.kind] = sign * h;
                moved.cameras[column.camera] = moved.cameras[column.camera].perturbed(&step);
                problem.cost(&moved, loss)
            };
            let numeric = (cost(1.0) - cost(-1.0)) / (4.0 * h);
            // The loose priors of poses and delays have no cost of their own.
            let exact = at.gradient[i];
            let scale = exact.abs() + 1e-3 * at.hessian[(i, i)].sqrt();
            assert!(
                (numeric - exact).abs() < 2e-3 * scale,
                "{world:?} {:?}: {numeric} {exact}",
                column.parameter()
            );
            checked += 1;
        }
    }
    assert!(checked >= 30, "{checked} columns checked");
}

#[test]
fn a_wrong_track_is_named_and_left_out() {
    let scenario = Scenario::stock(Layout::Three, &[0.73, -1.31], 5);
    let simulated = simulate_tracks(&scenario).unwrap();
    let mut pitches = group_pitches(&simulated.rig, &simulated.tracks);
    // The third pitch's track in the second camera becomes something that moves otherwise.
    let wrong = &mut pitches[2].tracks[1];
    for p in &mut wrong.points {
        p.pixel.x = 2000.0 - p.pixel.x;
        p.pixel.y += 60.0;
    }
    let (camera, track) = (wrong.camera.clone(), wrong.track);
    let solved = refine(
        &simulated.rig,
        &pitches,
        &start(&simulated, 1),
        &JointOptions::default(),
    )
    .unwrap();
    assert_eq!(solved.wrong_tracks.len(), 1);
    let found = &solved.wrong_tracks[0];
    assert_eq!((&found.camera, found.track, found.pitch), (&camera, track, 2));
    assert_eq!(solved.flights.len(), 5);
}

#[test]
fn a_wrong_click_is_named_and_left_out() {
    let (mut simulated, pitches) = small(2);
    let name = {
        let mark = &mut simulated.rig.cameras[1].landmarks[3];
        mark.pixel.x += 25.0;
        mark.name.clone()
    };
    let solved = refine(
        &simulated.rig,
        &pitches,
        &start(&simulated, 2),
        &JointOptions::default(),
    )
    .unwrap();
    let warnings = &solved.calibration.warnings;
    assert_eq!(warnings.len(), 1, "{warnings:?}");
    assert!(warnings[0].contains(&name), "{warnings:?}");
    let camera = &solved.calibration.cameras[1];
    let error = camera.capture_delay_s - simulated.truth.cameras[1].capture_delay_s;
    assert!(error.abs() < 4.0 * camera.capture_delay_sigma_s, "{error} s");
}

#[test]
fn a_delay_that_stays_open_is_refused_with_its_numbers() {
    let (simulated, pitches) = small(3);
    let options = JointOptions {
        delay_sigma_frames_max: 1e-4,
        ..JointOptions::default()
    };
    match refine(&simulated.rig, &pitches, &start(&simulated, 3), &options) {
        Err(CalibrationError::NotEnoughParallax {
            camera,
            parallax_deg,
            sigma_frames,
        }) => {
            assert_eq!(camera, simulated.rig.cameras[1].id);
            assert!((90.0..180.0).contains(&parallax_deg), "{parallax_deg}");
            assert!((0.005..0.1).contains(&sigma_frames), "{sigma_frames}");
        }
        other => panic!("{:?}", other.map(|s| s.calibration.warnings)),
    }
}

/// Shifting every stamp by the same hour changes nothing but the epochs.
#[test]
fn a_shift_of_all_stamps_changes_nothing() {
    let (simulated, pitches) = small(5);
    let hour_ns = 3_600_000_000_000;
    let mut shifted = pitches.clone();
    for p in shifted
        .iter_mut()
        .flat_map(|p| &mut p.tracks)
        .flat_map(|t| &mut t.points)
    {
        p.stamped = StampedMidpoint::from_nanos(p.stamped.nanos() + hour_ns);
    }
    let start = start(&simulated, 5);
    let options = JointOptions::default();
    let now = refine(&simulated.rig, &pitches, &start, &options).unwrap();
    let later = refine(&simulated.rig, &shifted, &start, &options).unwrap();
    for (a, b) in now.calibration.cameras.iter().zip(&later.calibration.cameras) {
        assert!((a.capture_delay_s - b.capture_delay_s).abs() < 1e-9);
        let moved = a.camera_from_world.centre_m() - b.camera_from_world.centre_m();
        assert!(moved.norm() < 1e-6, "{moved}");
    }
    assert_eq!(now.flights.len(), later.flights.len());
}
