//! What the cameras of a full-rate run see: rendered once, kept below the target folder, and what was thrown in it.

use std::path::{Path, PathBuf};
use std::process::Command;

use pitchd::recording::SessionReader;
use pitchd::scene::CameraId;

/// The session is shown again every so many seconds.
pub const EVERY_S: f64 = 9.0;

const HEAD: &str = r#"seed = 1
[site]
name = "Full rate"
field = "professional"
[landmarks]
sigma_px = 0.5
[render]
preset = "clean"
lead_s = 0.2
tail_s = 0.2
"#;

type Throw = (f64, [f64; 3], f64, [f64; 2], f64, f64);

/// Begin, release, speed, target, spin axis, active spin: fastball, slider, curve and changeup.
const PITCHES: [Throw; 4] = [
    (1.0, [-0.55, 16.6, 1.83], 42.6, [0.1, 0.95], 208.0, 0.95),
    (3.0, [-0.6, 16.75, 1.78], 38.3, [0.28, 0.5], 118.0, 0.38),
    (5.0, [-0.48, 16.8, 1.9], 35.4, [0.02, 0.4], 42.0, 0.82),
    (7.0, [-0.62, 16.62, 1.76], 37.8, [-0.18, 0.62], 238.0, 0.92),
];

/// Id, position, target, focal length, delay in frames.
type Place = (&'static str, [f64; 3], [f64; 3], f64, f64);

const LARGE: [Place; 3] = [
    ("first", [20.1, 6.2, 3.3], [0.0, 8.6, 0.9], 1790.0, 0.0),
    ("third", [-19.4, 7.4, 3.6], [0.0, 8.8, 1.0], 1810.0, -1.35),
    ("home", [1.4, -15.5, 8.2], [-0.1, 9.0, 0.6], 2350.0, 0.8),
];
const SMALL: [Place; 4] = [
    ("first", [20.1, 6.2, 3.3], [0.0, 8.6, 0.9], 1100.0, 0.0),
    ("third", [-19.4, 7.4, 3.6], [0.0, 8.8, 1.0], 1110.0, -1.35),
    ("far", [17.6, 14.3, 3.1], [0.0, 8.4, 0.9], 1000.0, 0.4),
    ("left", [-18.2, 2.5, 3.2], [0.0, 8.6, 0.9], 1020.0, 0.7),
];

/// A pitch as it was thrown: plate, seconds after the session's begin, x and z at its front.
pub struct Thrown {
    pub after_s: f64,
    pub plate_m: [f64; 2],
}

/// A rendered session.
pub struct Scene {
    pub folder: PathBuf,
    pub cameras: Vec<&'static str>,
    pub size_px: (u32, u32),
    pub rate_hz: f64,
    pub thrown: Vec<Thrown>,
}

pub fn pitchd(arguments: &[&str]) {
    let output = Command::new(env!("CARGO_BIN_EXE_pitchd"))
        .args(arguments)
        .output()
        .expect("the program");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "pitchd {arguments:?}: {said}");
}

impl Scene {
    /// Two or three cameras of 2048×1024, or four of 1280×512, at 175 Hz; rendered unless that has been done.
    pub fn of(cameras: usize) -> Self {
        let (places, size_px): (&[Place], _) = match cameras {
            4 => (&SMALL, (1280, 512)),
            n => (&LARGE[..n.clamp(2, 3)], (2048, 1024)),
        };
        let target = std::env::var("CARGO_TARGET_DIR").unwrap_or_else(|_| "target".to_owned());
        let scene = Self {
            folder: Path::new(&target).join(format!("full_rate/{cameras}")),
            cameras: places.iter().map(|p| p.0).collect(),
            size_px,
            rate_hz: 175.0,
            thrown: Vec::new(),
        };
        let text = scene.text(places);
        let made = scene.path("scene.toml");
        if std::fs::read_to_string(&made).unwrap_or_default() != text {
            scene.render(&text);
            std::fs::write(made, text).expect("the target folder");
        }
        let thrown = scene.read_thrown();
        Self { thrown, ..scene }
    }

    pub fn path(&self, name: &str) -> String {
        self.folder.join(name).display().to_string()
    }

    fn text(&self, places: &[Place]) -> String {
        let (width, height) = self.size_px;
        let mut text = HEAD.to_owned();
        for (id, position, target, focal, delay) in places {
            text += &format!(
                "[[camera]]\nid = \"{id}\"\nwidth_px = {width}\nheight_px = {height}\nframe_rate_hz = {:.1}\n\
                 exposure_s = 0.001\nposition_m = {position:?}\nlook_at_m = {target:?}\ncapture_delay_frames = {delay:?}\n\
                 [camera.intrinsics]\nfx_px = {focal:?}\nfy_px = {focal:?}\ncx_px = {:.1}\ncy_px = {:.1}\n",
                self.rate_hz,
                0.5 * f64::from(width) - 0.5,
                0.5 * f64::from(height) - 0.5,
            );
        }
        for (start, release, speed, target, axis, active) in PITCHES {
            text += &format!(
                "[[pitch]]\nstart_s = {start:?}\nrelease_m = {release:?}\nspeed_mps = {speed:?}\ntarget_m = {target:?}\n\
                 spin_rpm = 2350\nspin_axis_deg = {axis:?}\nactive_spin = {active:?}\n"
            );
        }
        text
    }

    /// Frames, the session of them, and its calibration.
    fn render(&self, text: &str) {
        println!("rendering {} (once)", self.folder.display());
        let _ = std::fs::remove_dir_all(&self.folder);
        std::fs::create_dir_all(&self.folder).expect("the target folder");
        let (input, sim) = (self.path("input.toml"), self.path("sim"));
        std::fs::write(&input, text).expect("the target folder");
        pitchd(&["simulate", &input, "--frames", "--out", &sim]);
        let (session, rig) = (self.path("session"), self.path("sim/rig.toml"));
        let frames = |id: &&str| format!("{id}={}", self.path(&format!("sim/frames/{id}")));
        let frames: Vec<String> = self.cameras.iter().map(frames).collect();
        let mut import = vec!["import", &session, "--rig", &rig];
        import.extend(frames.iter().flat_map(|f| ["--camera", f]));
        pitchd(&import);
        std::fs::remove_dir_all(self.path("sim/frames")).expect("frames");
        pitchd(&["replay", &session, "--out", &self.path("replay")]);
    }

    fn read_thrown(&self) -> Vec<Thrown> {
        let reader = SessionReader::open(&self.folder.join("session")).expect("the session");
        let begin_ns = self.cameras.iter().map(|id| {
            let frames = reader.frames(&CameraId::new(id).expect("an id")).expect("frames");
            let first = frames.into_iter().next().expect("a frame");
            first.frame.stamp.stamped.nanos() - 500_000
        });
        let begin_ns = begin_ns.min().expect("a camera");
        let truth = std::fs::read_to_string(self.path("sim/truth/truth.json")).expect("the truth");
        let truth: serde_json::Value = serde_json::from_str(&truth).expect("JSON");
        let pitches = truth["pitches"].as_array().expect("pitches");
        let number = |value: &serde_json::Value| value.as_f64().expect("a number");
        let thrown = pitches.iter().map(|pitch| Thrown {
            after_s: 1e-9 * (number(&pitch["plate_time_ns"]) - begin_ns as f64),
            plate_m: [0, 1].map(|k| number(&pitch["plate_front_m"][k])),
        });
        thrown.collect()
    }
}
