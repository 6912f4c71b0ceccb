//! A session of two pitches and three cameras for the fault drill, and what was thrown in it.

use std::path::Path;
use std::process::Command;

use pitchd::recording::SessionReader;
use pitchd::scene::CameraId;

/// Its cameras.
pub const CAMERAS: [&str; 3] = ["first", "third", "far"];
const SCENE: &str = r#"
seed = 5
[site]
field = "professional"
[landmarks]
sigma_px = 0.5
[render]
preset = "clean"
lead_s = 0.15
tail_s = 0.15
read_noise_dn = 0.4
electrons_per_dn = 3000.0
[[pitch]]
start_s = 1.0
release_m = [-0.55, 16.6, 1.83]
speed_mps = 41.0
target_m = [0.1, 0.95]
spin_rpm = 2350
spin_axis_deg = 208
active_spin = 0.95
[[pitch]]
start_s = 3.2
release_m = [-0.6, 16.75, 1.78]
speed_mps = 36.0
target_m = [0.28, 0.5]
spin_rpm = 2450
spin_axis_deg = 118
active_spin = 0.38
"#;

/// Cropped sensors at 80 fps: position, target, focal length, delay in frames.
const PLACES: [([f64; 3], [f64; 3], f64, f64); 3] = [
    ([20.1, 6.2, 3.3], [0.0, 8.6, 0.9], 1190.0, 0.0),
    ([-19.4, 7.4, 3.6], [0.0, 8.8, 1.0], 1205.0, 0.65),
    ([17.6, 14.3, 3.1], [0.0, 8.4, 0.9], 1080.0, -0.3),
];

/// A pitch as it was thrown: plate, seconds after the session's begin, x and z at its front, speed at release.
pub struct Thrown {
    pub after_s: f64,
    pub plate_m: [f64; 2],
    pub speed_mps: f64,
}

fn pitchd(arguments: &[&str]) {
    let output = Command::new(env!("CARGO_BIN_EXE_pitchd"))
        .args(arguments)
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{arguments:?}: {}",
        String::from_utf8_lossy(&output.stderr)
    );
}

/// Renders the session and tells what was thrown in it.
pub fn session(folder: &Path) -> Vec<Thrown> {
    let mut scene = SCENE.to_owned();
    for (id, (position, target, focal, delay)) in CAMERAS.iter().zip(PLACES) {
        scene += &format!(
            "[[camera]]\nid = \"{id}\"\nwidth_px = 1056\nheight_px = 176\nframe_rate_hz = 80.0\nexposure_s = 0.001\n\
             position_m = {position:?}\nlook_at_m = {target:?}\ncapture_delay_frames = {delay}\n[camera.intrinsics]\n\
             fx_px = {focal}\nfy_px = {focal}\ncx_px = 528.0\ncy_px = 88.0\n"
        );
    }
    let path = |name: &str| folder.join(name).to_str().unwrap().to_owned();
    std::fs::write(path("scene.toml"), scene).unwrap();
    pitchd(&["simulate", &path("scene.toml"), "--frames", "--out", &path("sim")]);
    let frames = CAMERAS.map(|id| format!("{id}={}", path(&format!("sim/frames/{id}"))));
    let mut import = vec![
        "import".to_owned(),
        path("session"),
        "--rig".to_owned(),
        path("sim/rig.toml"),
    ];
    for camera in frames {
        import.extend(["--camera".to_owned(), camera]);
    }
    pitchd(&import.iter().map(String::as_str).collect::<Vec<_>>());
    std::fs::remove_dir_all(path("sim/frames")).unwrap();
    std::fs::copy(path("sim/rig.toml"), path("rig.toml")).unwrap();
    let reader = SessionReader::open(&folder.join("session")).unwrap();
    let begins = CAMERAS.map(|id| {
        let first = reader
            .frames(&CameraId::new(id).unwrap())
            .unwrap()
            .next()
            .unwrap();
        first.frame.stamp.stamped.nanos() - 500_000
    });
    let begin_ns = begins.into_iter().min().unwrap();
    let truth = std::fs::read_to_string(path("sim/truth/truth.json")).unwrap();
    let truth: serde_json::Value = serde_json::from_str(&truth).unwrap();
    let pitches = truth["pitches"].as_array().unwrap();
    let thrown = pitches.iter().map(|p| Thrown {
        after_s: 1e-9 * (p["plate_time_ns"].as_i64().unwrap() - begin_ns) as f64,
        plate_m: [0, 1].map(|k| p["plate_front_m"][k].as_f64().unwrap()),
        speed_mps: p["release_speed_mps"].as_f64().unwrap(),
    });
    thrown.collect()
}
