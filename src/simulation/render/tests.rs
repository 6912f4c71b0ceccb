//! Whole frames: determinism, noise, place of the ball.

use super::*;
use crate::simulation::{Layout, Preset, simulate_tracks};

/// Stock cameras shrunk to a quarter: quick to paint.
fn small(preset: Preset) -> Scenario {
    let mut scenario = Scenario::stock(Layout::TwoOpposite, &[0.4], 1);
    for camera in &mut scenario.cameras {
        camera.width_px /= 4;
        camera.height_px /= 4;
        for value in [
            &mut camera.intrinsics.fx_px,
            &mut camera.intrinsics.fy_px,
            &mut camera.intrinsics.cx_px,
            &mut camera.intrinsics.cy_px,
        ] {
            *value /= 4.0;
        }
    }
    scenario.render.preset = preset;
    scenario.render.lead_s = Some(0.02);
    scenario.render.tail_s = Some(0.02);
    scenario
}

#[test]
fn frames_follow_from_the_seed_alone() {
    for preset in [Preset::Clean, Preset::Hard] {
        let scenario = small(preset);
        let mut renderer = CameraRenderer::new(&scenario, 1).unwrap();
        let exposures: Vec<_> = renderer.exposures().collect();
        let (a, b) = (exposures[20], exposures[60]);
        let first = renderer.frame(&a);
        let _ = renderer.frame(&b);
        let again = renderer.frame(&a);
        assert!(
            first.bytes() == again.bytes(),
            "a frame depends on the one before it"
        );
        let fresh = CameraRenderer::new(&scenario, 1).unwrap().frame(&a);
        assert!(first.bytes() == fresh.bytes());
        let other = CameraRenderer::new(&scenario.with_seed(9), 1).unwrap().frame(&a);
        assert!(first.bytes() != other.bytes());
    }
}

#[test]
fn frames_come_in_order_with_the_stamps_of_the_tracks() {
    let scenario = small(Preset::Clean);
    let truth = simulate_tracks(&scenario).unwrap().truth;
    let frames: Vec<Frame> = camera_frames(&scenario, 1).unwrap().collect();
    assert!(
        frames
            .windows(2)
            .all(|w| w[0].stamp.frame + 1 == w[1].stamp.frame)
    );
    let mut found = 0;
    for centre in truth.centres_of(&scenario.cameras[1].id) {
        let frame = frames.iter().find(|f| f.stamp.frame == centre.frame).unwrap();
        assert_eq!(frame.stamp.stamped, centre.stamped);
        found += 1;
    }
    assert!(found > 60, "{found}");
}

#[test]
fn a_still_pixel_has_the_noise_it_should_have() {
    let mut scenario = small(Preset::Clean);
    scenario.render.read_noise_dn = Some(2.0);
    scenario.render.electrons_per_dn = Some(25.0);
    scenario.render.people = Some(false);
    let mut renderer = CameraRenderer::new(&scenario, 0).unwrap();
    let exposures: Vec<_> = renderer.exposures().collect();
    let width = renderer.size_px().0 as usize;
    let rows: Vec<Vec<u8>> = exposures
        .iter()
        .map(|e| renderer.frame(e).bytes()[200 * width..201 * width].to_vec())
        .collect();
    let tones = &renderer.background.tones[200 * width..201 * width];
    let n = rows.len() as f64;
    let (mut ratio, mut bias) = (0.0, 0.0);
    for (x, tone) in tones.iter().enumerate() {
        let errors: Vec<f64> = rows.iter().map(|r| f64::from(r[x]) - f64::from(*tone)).collect();
        let mean = errors.iter().sum::<f64>() / n;
        let variance = errors.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / (n - 1.0);
        // Read², shot, and a twelfth for the rounding.
        ratio += variance / (4.0 + f64::from(*tone) / 25.0 + 1.0 / 12.0) / width as f64;
        bias += mean / width as f64;
    }
    // 512 columns × ~75 frames: 5 standard errors are 3 % and 0.08 grey levels.
    assert!((ratio - 1.0).abs() < 0.03, "{ratio}");
    assert!(bias.abs() < 0.08, "{bias}");
}
