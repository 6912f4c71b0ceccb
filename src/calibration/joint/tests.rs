//! The joint estimator from perturbed truth.

use super::{JointOptions, refine};
use crate::calibration::InitialEstimate;
use crate::calibration::association::group_pitches;
use crate::scene::WorldFrame;
use crate::simulation::{DetectionNoise, Layout, Scenario, Simulated, simulate_tracks};

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
