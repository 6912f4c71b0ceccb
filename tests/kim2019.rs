//! The paper's recipe on simulated sessions.
#![allow(clippy::unwrap_used)]

use pitchd::calibration::kim2019::search::Optimizer;
use pitchd::calibration::kim2019::trajectory::TrajectoryModel;
use pitchd::calibration::kim2019::{Kim2019Options, calibrate_session};
use pitchd::scene::WorldFrame;
use pitchd::simulation::{DetectionNoise, Layout, Scenario, simulate_tracks};

#[test]
fn f2_finds_delays_and_world_and_f1_is_worse() {
    for layout in [Layout::TwoOpposite, Layout::Three] {
        let scenario = Scenario::stock(layout, &[1.3, -0.7], 6)
            .with_seed(3)
            .with_detection(DetectionNoise::gaussian(0.2));
        let s = simulate_tracks(&scenario).unwrap();
        let mut delay_errors = Vec::new();
        for trajectory in [TrajectoryModel::PAPER, TrajectoryModel::Quadratic] {
            for optimizer in [Optimizer::NelderMead, Optimizer::QuasiNewton] {
                let options = Kim2019Options {
                    trajectory,
                    optimizer,
                    stride: 2,
                    ..Kim2019Options::default()
                };
                let clock = std::time::Instant::now();
                let found = calibrate_session(&s.rig, &s.tracks, &options).unwrap();
                let c = &found.calibration;
                assert_eq!(c.world, WorldFrame::HomePlate);
                // F1's poses leave flights that are no pitch; F2's do not.
                if trajectory == TrajectoryModel::PAPER {
                    assert_eq!(found.flights.len(), 6, "{:?}", found.unsolved);
                }
                let error =
                    |i: usize| (c.cameras[i].capture_delay_s - s.truth.cameras[i].capture_delay_s) * 175.0;
                let centre = |i: usize| {
                    (c.cameras[i].camera_from_world.centre_m()
                        - s.truth.cameras[i].camera_from_world.centre_m())
                    .norm()
                };
                let worst = (1..c.cameras.len()).map(|i| error(i).abs()).fold(0.0, f64::max);
                println!(
                    "{layout:?} {trajectory:?} {optimizer:?}: {worst:.4} frame, centres {:.3} {:.3} m, {} evaluations, {:.2?}",
                    centre(0),
                    centre(1),
                    c.cost_trace.len(),
                    clock.elapsed()
                );
                if trajectory == TrajectoryModel::PAPER {
                    // The high home camera sees the ball come at it: its delay is the weak one.
                    assert!(
                        worst < if layout == Layout::Three { 0.2 } else { 0.05 },
                        "{worst}"
                    );
                    assert!(centre(1) < 0.3);
                }
                delay_errors.push(worst);
            }
        }
        assert!(delay_errors[2] > delay_errors[0]);
    }
}
