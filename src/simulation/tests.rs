//! Signs, determinism and hand-computed numbers of simulated tracks.

use super::*;
use crate::geometry::Pixel;

fn noiseless(layout: Layout, delays: &[f64]) -> Scenario {
    let mut scenario = Scenario::stock(layout, delays, 2).with_detection(DetectionNoise::gaussian(0.0));
    scenario.landmarks.sigma_px = 0.0;
    scenario
}

#[test]
fn a_pinhole_sees_the_ball_where_it_was_a_delay_before_the_stamp() {
    // Camera 20 m to the right of the path, looking along −x, no distortion, f = 1000 px: the image's right is +y
    // (world), one metre is 50 px. Ball at y = 10 − 40·t without air or gravity.
    let mut camera = stock_camera("side", [20.0, 10.0, 1.0], [0.0, 10.0, 1.0], 1000.0).unwrap();
    camera.intrinsics.distortion = [0.0; 5];
    camera.intrinsics.cx_px = 1000.0;
    camera.intrinsics.cy_px = 500.0;
    let reference = CameraSpec {
        id: crate::scene::CameraId::new("reference").unwrap(),
        ..camera.clone()
    };
    camera.capture_delay_s = 0.002;
    let pitch = PitchSpec {
        start_s: Some(1.0),
        release_m: Some([0.0, 10.0, 1.0]),
        velocity_mps: Some([0.0, -40.0, 0.0]),
        drag_coefficient: Some(0.0),
        ..PitchSpec::default()
    };
    let mut scenario =
        Scenario::new(vec![reference, camera], vec![pitch]).with_detection(DetectionNoise::gaussian(0.0));
    scenario.site.gravity_mps2 = 0.0;
    let simulated = simulate_tracks(&scenario).unwrap();
    let mut seen = 0;
    for track in &simulated.tracks {
        let tau = if track.camera.as_str() == "side" {
            0.002
        } else {
            0.0
        };
        for p in &track.points {
            let t = p.stamped.seconds_since(scenario.epoch_ns) - tau - 1.0;
            let Pixel { x, y } = p.pixel;
            // y falls with time, so does the column. 1e-5 px: stamps are whole nanoseconds.
            assert!((x - (1000.0 - 50.0 * 40.0 * t)).abs() < 1e-5, "{x} at {t}");
            assert!((y - 500.0).abs() < 1e-9);
            seen += 1;
        }
    }
    assert!(seen > 80, "{seen}");
}

#[test]
fn truth_timing_and_pose_explain_every_noiseless_point() {
    let mut scenario = noiseless(Layout::Three, &[0.7, -1.3]);
    scenario.cameras[1].clock_skew_ppm = 20.0;
    scenario.cameras[1].clock_offset_s = 7.25;
    scenario.cameras[2].readout_s = 0.004;
    scenario.cameras[2].frame_rate_hz = 119.88;
    let simulated = simulate_tracks(&scenario).unwrap();
    let mut checked = 0;
    for track in &simulated.tracks {
        let camera = simulated.truth.camera(&track.camera).unwrap();
        let timing = crate::time::CameraTiming {
            capture_delay_s: camera.capture_delay_s,
            clock_skew_ppm: camera.clock_skew_ppm,
            skew_epoch_ns: camera.skew_epoch_ns,
            readout_s: camera.readout_s,
            height_px: camera.height_px,
        };
        for p in &track.points {
            let t = timing.true_seconds(p.stamped, p.pixel.y, scenario.epoch_ns);
            let miss = |ball: &ThrownBall| {
                let at = camera.camera_from_world.transform(&ball.position_m(t));
                let seen = camera.intrinsics.project(&at);
                seen.map_or(1e9, |q| (q.vector() - p.pixel.vector()).norm())
            };
            let best = simulated.truth.balls.iter().map(miss).fold(1e9, f64::min);
            assert!(best < 1e-5, "{} frame {}: {best} px", track.camera, p.frame);
            checked += 1;
        }
    }
    assert!(checked > 300, "{checked}");
    assert_eq!(simulated.tracks.len(), 6);
}

#[test]
fn the_same_seed_gives_the_same_session_and_another_does_not() {
    let mut scenario = Scenario::stock(Layout::TwoOpposite, &[0.4], 3);
    scenario.clutter.tracks_per_pitch = 2;
    scenario.cameras[1].jitter_s = 1e-4;
    scenario.cameras[1].drop_probability = 0.1;
    let first = simulate_tracks(&scenario).unwrap();
    let again = simulate_tracks(&scenario).unwrap();
    let other = simulate_tracks(&scenario.clone().with_seed(2)).unwrap();
    assert_eq!(first.tracks, again.tracks);
    assert_eq!(first.rig, again.rig);
    assert_ne!(first.tracks, other.tracks);
    assert_ne!(first.rig, other.rig);
}

#[test]
fn noise_has_its_sigma_and_points_are_lost_at_their_rate() {
    let mut scenario = Scenario::stock(Layout::Three, &[0.5, 1.5], 8);
    scenario.detection.sigma_px = 0.5;
    scenario.detection.miss_probability = 0.2;
    let noisy = simulate_tracks(&scenario).unwrap();
    let (mut square, mut count) = (0.0, 0);
    for track in &noisy.tracks {
        for p in &track.points {
            let centres = noisy.truth.centres_of(&track.camera);
            let truth = centres.iter().find(|c| c.frame == p.frame).unwrap();
            square += (p.pixel.vector() - truth.pixel.vector()).norm_squared();
            count += 2;
        }
    }
    let visible = |c: &&TrueCentre| c.visible;
    let all: usize = noisy
        .truth
        .centres
        .iter()
        .map(|c| c.centres.iter().filter(visible).count())
        .sum();
    let sigma = (square / f64::from(count)).sqrt();
    // 4 standard errors of about 2900 numbers.
    assert!(
        (sigma - 0.5).abs() < 0.5 * 4.0 / (2.0 * f64::from(count)).sqrt(),
        "{sigma}"
    );
    let kept = f64::from(count) / 2.0 / all as f64;
    assert!((kept - 0.8).abs() < 4.0 * (0.16 / all as f64).sqrt(), "{kept}");
}

#[test]
fn stock_pitches_look_like_pitches() {
    let simulated = simulate_tracks(&noiseless(Layout::Three, &[]).clone()).unwrap();
    assert!(simulated.rig.cameras.iter().all(|c| c.landmarks.len() >= 12));
    let scenario = Scenario::stock(Layout::Three, &[], 8);
    let truth = simulate_tracks(&scenario).unwrap().truth;
    assert_eq!(truth.pitches.len(), 8);
    for p in &truth.pitches {
        let (release, plate) = (p.release_time_ns.unwrap(), p.plate_time_ns.unwrap());
        let flight_s = (plate - release) as f64 * 1e-9;
        // domain §2: 0.37–0.61 s, an eephus longer.
        assert!(flight_s > 0.36 && flight_s < 0.75, "{} {flight_s}", p.name);
        let [x, z] = p.plate_front_m.unwrap();
        assert!(x.abs() < 0.4 && z > 0.3 && z < 1.1);
    }
}

#[test]
fn errors_name_the_key() {
    let text = include_str!("../../config/scenario/two_opposite.toml");
    assert!(Scenario::from_str(text).is_ok());
    for (from, to, wanted) in [
        ("exposure_s", "exposur_s", "exposur_s"),
        ("frame_rate_hz = 175.0", "frame_rate_hz = -1.0", "frame_rate_hz"),
        ("release_m", "# release_m", "pitch[0].release_m"),
        ("seed = 1", "seed = \"x\"", "line "),
    ] {
        let broken = text.replace(from, to);
        assert_ne!(broken, text, "{from}");
        let message = Scenario::from_str(&broken)
            .and_then(|s| simulate_tracks(&s).map(|_| ()))
            .unwrap_err()
            .to_string();
        assert!(message.contains(wanted), "{message}");
        assert!(!message.contains('\n'));
    }
}
