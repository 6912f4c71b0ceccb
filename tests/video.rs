//! A video that somebody imports: cuts, pans, flashes, a crowd of moving things. Nothing in it is a pitch, and nothing of it
//! may crash or flood what comes after.

#![allow(clippy::unwrap_used, clippy::panic)]

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use opencv::core::{Mat, MatTraitConst, Point, Scalar, Size};
use opencv::imgproc::{FILLED, LINE_8, circle, rectangle_points};
use opencv::videoio::{VideoWriter, VideoWriterTrait, VideoWriterTraitConst};
use pitchd::eye::{CameraEye, EyeConfig};
use pitchd::recording::SessionReader;
use pitchd::scene::CameraId;

const WIDTH: i32 = 640;
const HEIGHT: i32 = 360;
const FRAMES: i32 = 240;
/// Frames of one shot; the next is another place.
const SHOT: i32 = 60;
/// Moving things of a shot.
const MOVERS: i32 = 40;

const RIG: &str = r#"
[site]
name = "somebody's video"
[[camera]]
id = "phone"
width_px = 640
height_px = 360
frame_rate_hz = 60.0
[camera.intrinsics]
fx_px = 600.0
fy_px = 600.0
cx_px = 319.5
cy_px = 179.5
distortion = [0.0, 0.0, 0.0, 0.0, 0.0]
"#;

/// A number that looks random, 0..modulus.
fn mixed(a: i32, b: i32, modulus: i32) -> i32 {
    let mut h = (a as u32).wrapping_mul(0x9e37_79b9) ^ (b as u32).wrapping_mul(0x85eb_ca6b);
    h = (h ^ (h >> 15)).wrapping_mul(0x2c1b_3c6d);
    ((h ^ (h >> 13)) % modulus as u32) as i32
}

/// One picture: a textured place that pans, things that cross it, now and then a flash.
fn picture(frame: i32) -> Mat {
    let shot = frame / SHOT;
    // Every second shot is filmed by hand.
    let pan = if shot % 2 == 1 { 3 * frame } else { 0 };
    let pixels: Vec<u8> = (0..WIDTH * HEIGHT)
        .map(|i| {
            let (x, y) = (i % WIDTH + pan, i / WIDTH);
            let texture = mixed(x / 6, y / 6 + 977 * shot, 120) + mixed(x / 37, y / 29 + shot, 60);
            let noise = mixed(i, frame, 7);
            let flash = if frame % 41 == 20 { 90 } else { 0 };
            (30 + texture + noise + flash).min(255) as u8
        })
        .collect();
    let flat = Mat::from_slice(&pixels).unwrap();
    let mut image = flat.reshape(1, HEIGHT).unwrap().try_clone().unwrap();
    for mover in 0..MOVERS {
        let speed = |k: i32| mixed(mover, shot + 11 * k, 29) - 14;
        let at = |k: i32, size: i32| (mixed(mover, shot + 31 * k, size) + speed(k) * frame).rem_euclid(size);
        let (x, y) = (at(1, WIDTH), at(2, HEIGHT));
        let light = Scalar::all(f64::from(mixed(mover, 5, 256)));
        let radius = 2 + mixed(mover, 7, 9);
        if mover % 3 == 0 {
            let corner = Point::new(x + 4 * radius, y + 9 * radius);
            rectangle_points(&mut image, Point::new(x, y), corner, light, FILLED, LINE_8, 0).unwrap();
        } else {
            circle(&mut image, Point::new(x, y), radius, light, FILLED, LINE_8, 0).unwrap();
        }
    }
    image
}

fn write_video(file: &Path) {
    let codec = VideoWriter::fourcc('M', 'J', 'P', 'G').unwrap();
    let size = Size::new(WIDTH, HEIGHT);
    let mut writer = VideoWriter::new(file.to_str().unwrap(), codec, 60.0, size, false).unwrap();
    assert!(writer.is_opened().unwrap());
    for frame in 0..FRAMES {
        writer.write(&picture(frame)).unwrap();
    }
    writer.release().unwrap();
}

fn pitchd(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_pitchd"));
    command.current_dir(folder).args(arguments).output().unwrap()
}

#[test]
fn a_video_of_anything_neither_crashes_nor_floods() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    fs::write(path.join("rig.toml"), RIG).unwrap();
    write_video(&path.join("game.avi"));
    let import = [
        "import",
        "session",
        "--rig",
        "rig.toml",
        "--camera",
        "phone=game.avi",
        "--fps",
        "60",
    ];
    let imported = pitchd(path, &import);
    assert!(
        imported.status.success(),
        "{}",
        String::from_utf8_lossy(&imported.stderr)
    );

    // The whole way: one line says why there are no pitches.
    let replayed = pitchd(path, &["replay", "session", "--out", "result"]);
    let told = String::from_utf8_lossy(&replayed.stderr);
    assert_eq!(replayed.status.code(), Some(1), "{told}");
    assert!(told.lines().any(|line| line.starts_with("pitchd: ")), "{told}");
    assert!(
        told.contains("warning: camera phone: ") && told.contains("were not searched"),
        "{told}"
    );
    let written = fs::read_to_string(path.join("result/pitches.jsonl")).unwrap_or_default();
    assert_eq!(written, "");

    // And the eye by itself: what it leaves out it counts.
    let session = SessionReader::open(&path.join("session")).unwrap();
    let camera = CameraId::new("phone").unwrap();
    let mut eye = CameraEye::new(camera.clone(), EyeConfig::default(), WIDTH as u32, HEIGHT as u32);
    let mut frames = 0;
    for read in session.frames(&camera).unwrap() {
        eye.push(&read.frame).unwrap();
        frames += 1;
    }
    eye.finish();
    let (detector, tracker) = eye.counters();
    let balls = eye.drain_balls();
    println!("{detector:?} {tracker:?}, {} smooth movements", balls.len());
    assert_eq!(frames, FRAMES as usize);
    assert!(
        detector.global_changes > 0,
        "panning and flashes change everything"
    );
    assert!(balls.len() <= 3 * MOVERS as usize, "{} balls", balls.len());
}
