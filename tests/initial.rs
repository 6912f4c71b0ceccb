//! Initial values on simulated sessions of many seeds: the right basin every time.
#![allow(clippy::unwrap_used)]

use pitchd::calibration::association::group_pitches;
use pitchd::calibration::initial::{InitialOptions, hypotheses};
use pitchd::simulation::{DetectionNoise, Layout, Scenario, Simulated, simulate_tracks};

#[derive(Debug, Clone, Copy)]
struct Case {
    layout: Layout,
    delays_frames: &'static [f64],
    sigma_px: f64,
    /// Error of the delay that still is the right basin, frames.
    basin_frames: f64,
}

fn simulate(case: &Case, seed: u64) -> Simulated {
    // Spread around the named delays, so that no seed sees the same phase.
    let phase = (seed as f64 * 0.618_034).fract() - 0.5;
    let delays: Vec<f64> = case.delays_frames.iter().map(|d| d + phase).collect();
    let scenario = Scenario::stock(case.layout, &delays, 8)
        .with_seed(seed)
        .with_detection(DetectionNoise::gaussian(case.sigma_px));
    simulate_tracks(&scenario).unwrap()
}

/// Worst delay error in frames and pose error in degrees of the best hypothesis.
fn errors(case: &Case, seed: u64) -> (f64, f64) {
    let s = simulate(case, seed);
    let pitches = group_pitches(&s.rig, &s.tracks);
    let found = hypotheses(&s.rig, &pitches, &InitialOptions::default()).unwrap();
    let best = &found[0];
    let (mut delay_frames, mut turn_deg) = (0f64, 0f64);
    for (i, camera) in s.truth.cameras.iter().enumerate() {
        let pose = best.poses[i].unwrap();
        delay_frames =
            delay_frames.max((best.capture_delay_s[i] - camera.capture_delay_s).abs() * camera.frame_rate_hz);
        turn_deg = turn_deg.max(
            pose.rotation
                .angle_to(&camera.camera_from_world.rotation)
                .to_degrees(),
        );
    }
    (delay_frames, turn_deg)
}

fn study(name: &str, case: &Case, seeds: std::ops::Range<u64>) {
    let (mut right, mut count) = (0, 0);
    let (mut worst_delay, mut worst_turn) = (0f64, 0f64);
    let started = std::time::Instant::now();
    for seed in seeds {
        let (delay_frames, turn_deg) = errors(case, seed);
        if delay_frames < case.basin_frames && turn_deg < 1.0 {
            right += 1;
        } else {
            println!("{name} seed {seed}: {delay_frames:.3} frame {turn_deg:.2}°");
        }
        count += 1;
        worst_delay = worst_delay.max(delay_frames);
        worst_turn = worst_turn.max(turn_deg);
    }
    let each = started.elapsed().as_secs_f64() / f64::from(count);
    println!("{name}: {right}/{count} worst {worst_delay:.3} frame {worst_turn:.3}°, {each:.3} s each");
    assert!(count > 0);
    assert_eq!(right, count, "{name}");
}

/// `PITCHD_SEEDS=200 cargo test --release --test initial -- --nocapture` for the whole study.
const SEEDS: std::ops::Range<u64> = 0..3;

#[test]
fn with_landmarks_the_right_basin_is_found_from_any_layout() {
    let seeds = std::env::var("PITCHD_SEEDS")
        .ok()
        .and_then(|n| n.parse().ok())
        .map_or(SEEDS, |n| 0..n);
    for (name, layout) in [
        ("opposite", Layout::TwoOpposite),
        ("same side", Layout::TwoSameSide),
        ("three", Layout::Three),
    ] {
        for sigma_px in [0.15, 1.0] {
            for delays_frames in [&[1.3, -1.7][..], &[-28.0, 29.0][..]] {
                // Two cameras on one side leave the delay to the curvature of the flights: at 1 px the
                // Cramér–Rao bound itself is 0.17 frame (0.052 at 0.3 px), so four of those.
                let weak = layout == Layout::TwoSameSide && sigma_px > 0.5;
                let basin_frames = if weak { 0.7 } else { 0.3 };
                let case = Case {
                    layout,
                    delays_frames,
                    sigma_px,
                    basin_frames,
                };
                study(
                    &format!("{name} {sigma_px} px {delays_frames:?}"),
                    &case,
                    seeds.clone(),
                );
            }
        }
    }
}

/// Worst errors of relative poses without landmarks: delay (frames), turn and baseline direction (degrees), and of
/// the metric upgrade: up (degrees) and log of the scale.
fn errors_without_landmarks(case: &Case, seed: u64) -> [f64; 5] {
    let phase = (seed as f64 * 0.618_034).fract() - 0.5;
    let delays: Vec<f64> = case.delays_frames.iter().map(|d| d + phase).collect();
    let scenario = Scenario::stock(case.layout, &delays, 8)
        .with_seed(seed)
        .with_detection(DetectionNoise::gaussian(case.sigma_px))
        .without_landmarks();
    let s = simulate_tracks(&scenario).unwrap();
    let pitches = group_pitches(&s.rig, &s.tracks);
    let found = hypotheses(&s.rig, &pitches, &InitialOptions::default()).unwrap();
    let best = &found[0];
    let mut worst = [0f64; 5];
    let (first, first_true) = (best.poses[0].unwrap(), s.truth.cameras[0].camera_from_world);
    let up = first.rotation * nalgebra::Vector3::z();
    worst[3] = up
        .angle(&(first_true.rotation * nalgebra::Vector3::z()))
        .to_degrees();
    for (i, camera) in s.truth.cameras.iter().enumerate().skip(1) {
        let relative = best.poses[i].unwrap().compose(&first.inverse());
        let truth = camera.camera_from_world.compose(&first_true.inverse());
        let delay = (best.capture_delay_s[i] - camera.capture_delay_s).abs() * camera.frame_rate_hz;
        let turn = (relative.rotation.inverse() * truth.rotation)
            .angle()
            .to_degrees();
        let direction = relative.translation_m.angle(&truth.translation_m).to_degrees();
        let scale = (relative.translation_m.norm() / truth.translation_m.norm())
            .ln()
            .abs();
        for (w, e) in worst.iter_mut().zip([delay, turn, direction, 0.0, scale]) {
            *w = w.max(e);
        }
    }
    worst
}

#[test]
fn without_landmarks_the_ball_alone_places_the_cameras() {
    let seeds = std::env::var("PITCHD_SEEDS")
        .ok()
        .and_then(|n| n.parse().ok())
        .map_or(0..1, |n| 0..n);
    for (name, layout) in [
        ("opposite", Layout::TwoOpposite),
        ("same side", Layout::TwoSameSide),
        ("three", Layout::Three),
    ] {
        for sigma_px in [0.15, 0.5] {
            for delays_frames in [&[1.3, -1.7][..], &[-28.0, 29.0][..]] {
                let case = Case {
                    layout,
                    delays_frames,
                    sigma_px,
                    basin_frames: 0.3,
                };
                let mut worst = [0f64; 5];
                let (mut right, mut count) = (0, 0);
                let started = std::time::Instant::now();
                for seed in seeds.clone() {
                    let e = errors_without_landmarks(&case, seed);
                    for (w, e) in worst.iter_mut().zip(e) {
                        *w = w.max(e);
                    }
                    count += 1;
                    if e[0] < 0.3 && e[1] < 1.0 && e[2] < 1.0 {
                        right += 1;
                    } else {
                        println!("{name} {sigma_px} px seed {seed}: {e:.3?}");
                    }
                }
                println!(
                    "no landmarks, {name} {sigma_px} px {delays_frames:?}: {right}/{count} worst {worst:.3?}, {:.2} s each",
                    started.elapsed().as_secs_f64() / f64::from(count)
                );
                assert_eq!(right, count, "{name} {sigma_px}");
            }
        }
    }
}

/// Delay error (frames, at the middle of the session) and turn (degrees) of every camera, worst of the best hypothesis.
fn worst_errors(s: &Simulated) -> (f64, f64) {
    let pitches = group_pitches(&s.rig, &s.tracks);
    let best = &hypotheses(&s.rig, &pitches, &InitialOptions::default()).unwrap()[0];
    let (mut delay_frames, mut turn_deg) = (0f64, 0f64);
    for (i, camera) in s.truth.cameras.iter().enumerate() {
        let since_s = (best.skew_epoch_ns[i] - camera.skew_epoch_ns) as f64 / 1e9;
        let truth = camera.capture_delay_s + 1e-6 * camera.clock_skew_ppm * since_s;
        let delay = (best.capture_delay_s[i] - truth).abs() * camera.frame_rate_hz;
        let turn = (best.poses[i].unwrap().rotation.inverse() * camera.camera_from_world.rotation).angle();
        delay_frames = delay_frames.max(delay);
        turn_deg = turn_deg.max(turn.to_degrees());
    }
    (delay_frames, turn_deg)
}

#[test]
fn an_hour_of_skew_outliers_misses_and_jitter_do_not_lead_astray() {
    let mut count = 0;
    for (layout, seed) in [(Layout::TwoOpposite, 1), (Layout::Three, 2), (Layout::Three, 3)] {
        let mut scenario = Scenario::stock(layout, &[1.3, -1.7], 8)
            .with_seed(seed)
            .with_detection(DetectionNoise {
                miss_probability: 0.2,
                outlier_probability: 0.1,
                ..DetectionNoise::gaussian(0.3)
            });
        for (k, camera) in scenario.cameras.iter_mut().enumerate() {
            camera.jitter_s = 0.02 / camera.frame_rate_hz;
            camera.drop_probability = 0.05;
            camera.repeat_stamp_probability = 0.02;
            if k > 0 {
                camera.clock_skew_ppm = 20.0;
            }
        }
        for (k, pitch) in scenario.pitches.iter_mut().enumerate() {
            pitch.start_s = Some(10.0 + 510.0 * k as f64);
        }
        let (delay_frames, turn_deg) = worst_errors(&simulate_tracks(&scenario).unwrap());
        println!("{layout:?} seed {seed}: {delay_frames:.3} frame {turn_deg:.3}\u{b0}");
        assert!(
            delay_frames < 0.3 && turn_deg < 1.0,
            "{layout:?}: {delay_frames} frame {turn_deg}"
        );
        count += 1;
    }
    assert_eq!(count, 3);
}

#[test]
fn mixed_rates_and_one_camera_with_landmarks_are_enough() {
    for (layout, seed) in [(Layout::TwoOpposite, 4), (Layout::Three, 5)] {
        let mut scenario = Scenario::stock(layout, &[1.3, -1.7], 8)
            .with_seed(seed)
            .with_detection(DetectionNoise::gaussian(0.3));
        scenario.cameras[1].frame_rate_hz = 119.88;
        let mut s = simulate_tracks(&scenario).unwrap();
        let (delay_frames, turn_deg) = worst_errors(&s);
        println!("{layout:?} mixed rates: {delay_frames:.3} frame {turn_deg:.3}\u{b0}");
        assert!(
            delay_frames < 0.2 && turn_deg < 1.0,
            "{layout:?}: {delay_frames} frame {turn_deg}"
        );
        for camera in &mut s.rig.cameras[1..] {
            camera.landmarks.clear();
        }
        let (delay_frames, turn_deg) = worst_errors(&s);
        println!("{layout:?} one camera with landmarks: {delay_frames:.3} frame {turn_deg:.3}\u{b0}");
        assert!(
            delay_frames < 0.3 && turn_deg < 3.0,
            "{layout:?}: {delay_frames} frame {turn_deg}"
        );
    }
}
