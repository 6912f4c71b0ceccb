//! Pixel formats over the wire: cameras of ten and twelve bits give what those of eight give, and what does not fit is said.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may")]

#[path = "lab/small.rs"]
mod small;

use std::net::Ipv4Addr;
use std::path::Path;
use std::time::{Duration, Instant};

use pitchd::capture::aravis::{CameraAddress, CameraMemory, LiveCamera, LiveError, LiveOptions, Next};
use pitchd::emulation::{
    Emulator, EmulatorOptions, Idle, Script, ScriptShape, ScriptedFrame, pattern, session_script,
};
use pitchd::eye::{EyeConfig, FirstLook, SecondLook};
use pitchd::recording::SessionReader;
use pitchd::scene::{CameraId, Frame, PixelFormat, RawFrame, TrackPoint};
use pitchd::time::SystemClock;
use small::{SHAPE, frame};

const BUNDLED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/recordings/bullpen");

/// A camera that has these formats.
fn emulator(last: u8, formats: &[PixelFormat], (shape, script): (ScriptShape, Script)) -> Emulator {
    let options = EmulatorOptions {
        pixel_formats: formats.to_vec(),
        between: Idle::Silent,
        ..EmulatorOptions::new(Ipv4Addr::new(127, 0, 98, last), "F")
    };
    Emulator::start(&options, shape, script).unwrap()
}

/// How it is opened.
fn live_options(last: u8, shape: ScriptShape, pixel_format: PixelFormat) -> LiveOptions {
    let which = CameraAddress {
        address: Some(Ipv4Addr::new(127, 0, 98, last)),
        ..CameraAddress::default()
    };
    let size_px = (shape.width_px, shape.height_px);
    LiveOptions {
        pixel_format,
        buffers: 64,
        buffers_ready: 64,
        realtime_priority: None,
        ..LiveOptions::new(CameraId::new("first").unwrap(), which, size_px, shape.rate_hz)
    }
}

/// The first clip of the bundled recording: its frames, and as a script.
fn clip(camera: &CameraId) -> (Vec<Frame>, ScriptShape, Vec<ScriptedFrame>) {
    let session = SessionReader::open(Path::new(BUNDLED)).unwrap();
    let (shape, script) = session_script(Path::new(BUNDLED), camera).unwrap();
    let shown: Vec<_> = script.take_while(|f| f.begin_ns < 2_000_000_000).collect();
    let frames = session.frames(camera).unwrap().take(shown.len());
    (frames.map(|f| f.frame).collect(), shape, shown)
}

/// What the camera sends, whole; `None` if this host lost a frame.
fn received(
    last: u8,
    format: PixelFormat,
    (shape, shown): (ScriptShape, &[ScriptedFrame]),
) -> Option<Vec<RawFrame>> {
    let script: Script = Box::new(Vec::from(shown).into_iter());
    let _emulator = emulator(last, &[format], (shape, script));
    let options = live_options(last, shape, format);
    let mut memory = CameraMemory::default();
    let mut camera = LiveCamera::start(&options, &mut memory).unwrap();
    let mut frames = Vec::new();
    let until = Instant::now() + Duration::from_secs(3);
    while frames.len() < shown.len() && Instant::now() < until {
        if let Next::Frame(live) = camera.next(&mut memory, &SystemClock, Duration::from_millis(50)) {
            frames.push(live.frame);
        }
    }
    camera.stop();
    (frames.len() == shown.len()).then_some(frames)
}

/// The 2-D points of everything that flies.
fn points(camera: &CameraId, frames: &[RawFrame]) -> Vec<TrackPoint> {
    let config = EyeConfig::default();
    let (width_px, height_px) = (frames[0].width_px, frames[0].height_px);
    let mut first = FirstLook::new(camera.clone(), &config, width_px, height_px);
    let mut second = SecondLook::new(&config);
    for frame in frames {
        first.push_raw(frame).unwrap();
    }
    first.finish();
    let balls = first.drain().into_iter().map(|ended| second.look(ended).0);
    balls.flat_map(|ball| ball.track.points).collect()
}

#[test]
fn packed_cameras_give_the_points_of_eight_bit_ones() {
    let camera = CameraId::new("first").unwrap();
    let (frames, shape, shown) = clip(&camera);
    let recorded: Vec<RawFrame> = frames.iter().cloned().map(RawFrame::from).collect();
    let expected = points(&camera, &recorded);
    assert!(expected.len() >= 20, "{} points", expected.len());
    for (k, format) in (1..).zip(PixelFormat::ALL) {
        // A frame that this host lost proves nothing.
        let came = (0..3).find_map(|_| received(k, format, (shape, &shown)));
        let mut came = came.unwrap_or_else(|| panic!("{format}: frames were missing three times"));
        for (came, frame) in came.iter_mut().zip(&frames) {
            assert_eq!(came.bytes().len(), format.bytes(frame.bytes().len()), "{format}");
            // This clip at these stamps: only the pixels have come over the wire.
            came.stamp = frame.stamp;
        }
        let found = points(&camera, &came);
        println!("{format}: {} points", found.len());
        assert_eq!(found, expected, "{format}");
    }
}

#[test]
fn a_camera_without_the_format_says_what_to_write() {
    let formats = [PixelFormat::Mono12p, PixelFormat::Mono10Packed];
    let _emulator = emulator(20, &formats, (SHAPE, pattern(SHAPE)));
    let refused = |options: LiveOptions| {
        LiveCamera::start(&options, &mut CameraMemory::default())
            .err()
            .unwrap()
    };
    let text = refused(live_options(20, SHAPE, PixelFormat::Mono8)).to_string();
    assert_eq!(
        text,
        "camera first: no pixel format Mono8 (it has Mono12p, Mono10Packed); write pixel_format = \"Mono12p\" or \
         pixel_format = \"Mono10Packed\" in its part of pitchd.toml"
    );
    let text = refused(live_options(20, SHAPE, PixelFormat::Mono10p)).to_string();
    assert!(
        text.starts_with("camera first: no pixel format Mono10p (it has "),
        "{text}"
    );
    // Not the one that it starts with.
    let mut memory = CameraMemory::default();
    let options = LiveOptions {
        buffers: 8,
        buffers_ready: 8,
        ..live_options(20, SHAPE, PixelFormat::Mono10Packed)
    };
    let mut camera = LiveCamera::start(&options, &mut memory).unwrap();
    let mut places = std::collections::BTreeSet::new();
    for _ in 0..40 {
        let live = frame(&mut camera, &mut memory).unwrap();
        assert_eq!(
            (live.frame.format, live.frame.bytes().len()),
            (PixelFormat::Mono10Packed, 640 * 320 * 3 / 2)
        );
        places.insert(live.frame.bytes().as_ptr() as usize);
    }
    assert!(
        places.len() <= 8,
        "read where they were assembled: {} places",
        places.len()
    );
    camera.stop();
}

#[test]
fn a_payload_of_another_format_is_refused_with_both_sizes() {
    // It says that it sends Mono12p, and states the bytes of Mono8.
    let model = emulator(21, &[PixelFormat::Mono12p], (SHAPE, pattern(SHAPE)));
    let genicam = model.genicam();
    drop(model);
    let stated = "<Integer Name=\"PayloadSize\"><Value>204800</Value>";
    let at = genicam.find("<Integer Name=\"PayloadSize\">").unwrap();
    let value = at + genicam[at..].find("<pValue>").unwrap();
    let end = value + genicam[value..].find("</pValue>").unwrap() + "</pValue>".len();
    let genicam = format!("{}{stated}{}", &genicam[..at], &genicam[end..]);
    let options = EmulatorOptions {
        genicam: Some(genicam.into()),
        pixel_formats: vec![PixelFormat::Mono12p],
        ..EmulatorOptions::new(Ipv4Addr::new(127, 0, 98, 21), "F")
    };
    let _emulator = Emulator::start(&options, SHAPE, pattern(SHAPE)).unwrap();
    let options = live_options(21, SHAPE, PixelFormat::Mono12p);
    let error = LiveCamera::start(&options, &mut CameraMemory::default())
        .err()
        .unwrap();
    assert!(matches!(error, LiveError::Setting { .. }), "{error}");
    assert_eq!(
        error.to_string(),
        "camera first: PayloadSize = 204800 is refused: an image of 640x320 Mono12p has 307200 bytes"
    );
}
