//! A rig and images of two cameras in a folder of their own, and `pitchd import` run there.

#![allow(dead_code, reason = "every test uses its own part of it")]

use std::fs;
use std::path::PathBuf;
use std::process::{Command, Output};

use pitchd::recording::SessionReader;
use pitchd::scene::CameraId;

pub const WIDTH: usize = 64;
pub const HEIGHT: usize = 48;

const CAMERA: &str = r#"
[[camera]]
id = "ID"
width_px = 64
height_px = 48
frame_rate_hz = 175.0
[camera.intrinsics]
fx_px = 50.0
fy_px = 50.0
cx_px = 31.5
cy_px = 23.5
distortion = [0.0, 0.0, 0.0, 0.0, 0.0]
"#;

/// A folder to import from.
pub struct Place {
    pub folder: tempfile::TempDir,
}

impl Place {
    /// A rig of cameras `first` and `third`, each with five PGM frames and their stamps.
    pub fn new() -> Self {
        let place = Self {
            folder: tempfile::tempdir().unwrap(),
        };
        let rig = format!(
            "[site]\nname = \"x\"\n{}{}",
            CAMERA.replace("ID", "first"),
            CAMERA.replace("ID", "third")
        );
        fs::write(place.path("rig.toml"), rig).unwrap();
        for camera in ["first", "third"] {
            fs::create_dir(place.path(camera)).unwrap();
            for frame in 0..5 {
                fs::write(place.frame(camera, frame), pgm(frame, WIDTH, HEIGHT)).unwrap();
            }
            place.stamp(camera, &[(0, 100), (1, 200), (2, 300), (3, 400), (4, 500)]);
        }
        place
    }
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }
    pub fn frame(&self, camera: &str, frame: usize) -> PathBuf {
        self.path(camera).join(format!("{frame:06}.pgm"))
    }
    pub fn stamp(&self, camera: &str, rows: &[(u64, i64)]) {
        let rows: String = rows.iter().map(|(f, t)| format!("{f},{t}\n")).collect();
        fs::write(
            self.path(camera).join("timestamps.csv"),
            format!("frame,timestamp_ns\n{rows}"),
        )
        .unwrap();
    }
    pub fn import_with(&self, arguments: &[&str]) -> Output {
        Command::new(env!("CARGO_BIN_EXE_pitchd"))
            .current_dir(self.folder.path())
            .args(["import", "out", "--rig", "rig.toml"])
            .args(arguments)
            .output()
            .unwrap()
    }
    pub fn import(&self) -> Output {
        self.import_with(&["--camera", "first=first", "--camera", "third=third"])
    }
    pub fn session(&self) -> SessionReader {
        SessionReader::open(&self.path("out")).unwrap()
    }
    /// The import fails with exit code 1 and one line that ends so.
    #[track_caller]
    pub fn fails(&self, ending: &str) {
        assert_fails(&self.import(), ending);
    }
}

/// Failed with exit code 1 and one line that ends so.
#[track_caller]
pub fn assert_fails(output: &Output, ending: &str) {
    let text = String::from_utf8_lossy(&output.stderr);
    let errors: Vec<&str> = text.lines().filter(|l| !l.contains("warning:")).collect();
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert_eq!(errors.len(), 1, "{text}");
    assert!(errors[0].ends_with(ending), "{text}");
}

pub fn pixels(salt: usize, width: usize, height: usize) -> Vec<u8> {
    (0..width * height)
        .map(|i| (i * 7 + salt * 31 + i / width) as u8)
        .collect()
}

pub fn pgm(salt: usize, width: usize, height: usize) -> Vec<u8> {
    let mut bytes = format!("P5\n# made here\n{width} {height}\n255\n").into_bytes();
    bytes.extend(pixels(salt, width, height));
    bytes
}

/// Numbers, stamps and pixels of a camera's frames.
pub fn frames(session: &SessionReader, camera: &str) -> Vec<(u64, i64, Vec<u8>)> {
    let frames = session.frames(&CameraId::new(camera).unwrap()).unwrap();
    frames
        .map(|r| {
            (
                r.frame.stamp.frame,
                r.frame.stamp.stamped.nanos(),
                r.frame.bytes().to_vec(),
            )
        })
        .collect()
}

#[track_caller]
pub fn assert_done(output: &Output) {
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
}
