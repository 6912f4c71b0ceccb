//! The rig file: what reads, and what each mistake is answered with.

use super::*;

const GOOD: &str = r#"
[site]
name = "Bullpen A"
field = "professional"
[[camera]]
id = "first"
width_px = 2048
height_px = 1024
frame_rate_hz = 175.0
[camera.intrinsics]
fx_px = 1790.0
fy_px = 1790.0
cx_px = 1031.4
cy_px = 505.2
distortion = [-0.083, 0.021, 0.0004, -0.0003, 0.0]
[[camera.landmark]]
name = "plate_front_left"
pixel_px = [912.3, 640.8]
sigma_px = 0.5
[[camera]]
id = "third"
width_px = 2048
height_px = 1024
frame_rate_hz = 119.88
rolling_shutter = "estimate"
regions_px = [[0, 100, 2048, 900]]
masks_px = [[1500, 100, 200, 80], [0, 900, 64, 100]]
intrinsics = { fx_px = 1.7e3, fy_px = 1.7e3, cx_px = 1023.5, cy_px = 511.5 }
"#;

fn error_of(text: &str) -> String {
    parse_rig(Path::new("rig.toml"), text).unwrap_err().to_string()
}

#[test]
fn the_contract_s_example_reads() {
    let rig = parse_rig(Path::new("rig.toml"), GOOD).unwrap();
    assert_eq!(rig.cameras.len(), 2);
    assert_eq!(rig.reference_camera().id.as_str(), "first");
    // left = −x, y = 17/12 ft = 0.4318 m
    let front_left = &rig.cameras[0].landmarks[0].position.world_m;
    assert!((front_left - Point3::new(-0.2159, 0.4318, 0.0)).norm() < 1e-12);
    assert_eq!(rig.cameras[1].rolling_shutter, RollingShutter::Estimate);
    assert_eq!(rig.cameras[1].intrinsics.distortion, [0.0; 5]);
    let area = |a: &crate::scene::PixelRect| [a.x_px, a.y_px, a.width_px, a.height_px];
    let areas = |all: &[crate::scene::PixelRect]| all.iter().map(area).collect::<Vec<_>>();
    assert_eq!(areas(&rig.cameras[1].regions), [[0, 100, 2048, 900]]);
    assert_eq!(
        areas(&rig.cameras[1].masks),
        [[1500, 100, 200, 80], [0, 900, 64, 100]]
    );
    assert!(rig.cameras[0].regions.is_empty() && rig.cameras[0].masks.is_empty());
}

#[test]
fn a_click_has_one_sigma_or_one_along_each_axis() {
    let sigma_of = |text: &str| {
        let rig = parse_rig(Path::new("rig.toml"), text).unwrap();
        rig.cameras[0].landmarks[0].sigma_px
    };
    assert_eq!(sigma_of(GOOD), [0.5, 0.5]);
    let each = GOOD.replace("sigma_px = 0.5", "sigma_px = [0.16, 0.05]");
    assert_eq!(sigma_of(&each), [0.16, 0.05]);
}

#[test]
fn each_mistake_names_its_place() {
    let cases = [
        (
            "[0, 900, 64, 100]",
            "[0, 900, 64, 125]",
            "rig.toml:27: camera `third`: `masks_px` has [0, 900, 64, 125]: not a rectangle",
        ),
        (
            "[[0, 100, 2048, 900]]",
            "[[0, 100, 0, 900]]",
            "`regions_px` has [0, 100, 0, 900]: not a rectangle [left, top, width, height] within the picture of 2048x1024",
        ),
        (
            "fx_px = 1790.0",
            "fx_pix = 1790.0",
            "rig.toml:11: unknown key `fx_pix`: did you mean `fx_px`?",
        ),
        (
            "[[camera.landmark]]",
            "[[camera.landmarks]]",
            "unknown key `landmarks`: did you mean `landmark`?",
        ),
        (
            "\"plate_front_left\"",
            "\"plate_frnt_left\"",
            "rig.toml:17: no landmark is called `plate_frnt_left`: did you mean `plate_front_left`?",
        ),
        (
            "sigma_px = 0.5",
            "sigma_px = [0.5, 0.0]",
            "camera `first`, landmark `plate_front_left`: `sigma_px = 0` is out of range",
        ),
        (
            "sigma_px = 0.5",
            "sigma_px = \"half\"",
            "rig.toml:19: expected a number, or two: along x and along y",
        ),
        (
            "id = \"third\"",
            "id = \"first\"",
            "two cameras are called `first`",
        ),
        (
            "[912.3, 640.8]",
            "[9123.0, 640.8]",
            "lies outside the 2048×1024 image",
        ),
        (
            "frame_rate_hz = 119.88",
            "frame_rate_hz = -1.0",
            "camera `third`: `frame_rate_hz = -1` is out of range",
        ),
        (
            "field = \"professional\"",
            "field = \"proffesional\"",
            "unknown value `proffesional`: did you mean `professional`?",
        ),
        (
            "width_px = 2048\nheight_px = 1024\nframe_rate_hz = 175.0",
            "width_px = 2048\nframe_rate_hz = 175.0",
            "missing field `height_px`",
        ),
    ];
    for (from, to, expected) in cases {
        let told = error_of(&GOOD.replacen(from, to, 1));
        assert!(told.contains(expected), "{told}");
        assert_eq!(told.lines().count(), 1, "{told}");
    }
    assert!(error_of("").contains("no [[camera]]"));
}

/// The block in README is config/example.toml, and it reads.
#[test]
fn the_example_beside_the_scenarios_is_the_one_in_the_readme() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let example = root.join("config/example.toml");
    let text = std::fs::read_to_string(&example).unwrap();
    let readme = std::fs::read_to_string(root.join("README.md")).unwrap();
    let block = readme
        .split("```toml\n")
        .nth(1)
        .unwrap()
        .split("```")
        .next()
        .unwrap();
    assert_eq!(text, block);
    let rig = load_rig(&example).unwrap();
    assert_eq!(rig.cameras.len(), 2);
    assert_eq!(rig.distances.len(), 1);
    assert_eq!(rig.cameras[0].landmarks.len(), 4);
}
