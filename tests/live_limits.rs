//! Where a camera, or this host, gives less than was asked: payloads below the stated size, a small socket buffer, a camera
//! that does not answer when it is to stop.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may")]

#[path = "lab/small.rs"]
mod small;

use std::time::{Duration, Instant};

use pitchd::capture::aravis::{CameraMemory, LiveCamera, LiveOptions, granted_socket_buffer};
use pitchd::emulation::{Drill, Emulator, EmulatorOptions, Faults, pattern};
use small::{SHAPE, frame};

fn emulator(last: u8, serial: &str) -> (Emulator, LiveOptions) {
    small::emulator([97, last], serial, Faults::default())
}

#[test]
fn frames_below_the_stated_payload_come_home_like_others() {
    // Cameras with chunks, or with slack, state more bytes than a frame has.
    let (model, options) = emulator(9, "L9");
    let genicam = model.genicam();
    drop(model);
    let stated = "<Integer Name=\"PayloadSize\"><Value>208896</Value>";
    let at = genicam.find("<Integer Name=\"PayloadSize\">").unwrap();
    let value = at + genicam[at..].find("<pValue>").unwrap();
    let end = value + genicam[value..].find("</pValue>").unwrap() + "</pValue>".len();
    let genicam = format!("{}{stated}{}", &genicam[..at], &genicam[end..]);
    let emulator_options = EmulatorOptions {
        genicam: Some(genicam.into()),
        ..EmulatorOptions::new(options.which.address.unwrap(), "L9")
    };
    let _emulator = Emulator::start(&emulator_options, SHAPE, pattern(SHAPE)).unwrap();
    let mut memory = CameraMemory::default();
    let mut camera = LiveCamera::start(&options, &mut memory).unwrap();
    let mut places = std::collections::BTreeSet::new();
    for _ in 0..60 {
        let now = frame(&mut camera, &mut memory).unwrap();
        places.insert(now.frame.bytes().as_ptr() as usize);
    }
    println!("{:?}", memory.counters());
    assert!(
        places.len() <= 8,
        "buffers do not come home: {} places",
        places.len()
    );
    assert!(camera.stop());
}

#[test]
fn a_camera_that_does_not_answer_is_waited_for_a_second_at_its_end() {
    let (emulator, options) = emulator(11, "L11");
    let mut memory = CameraMemory::default();
    let mut camera = LiveCamera::start(&options, &mut memory).unwrap();
    assert!(frame(&mut camera, &mut memory).is_some());
    emulator.drill(Drill::Disconnect(Duration::from_secs(30)));
    std::thread::sleep(Duration::from_millis(50));
    let told = Instant::now();
    assert!(!camera.stop(), "nobody answers");
    assert!(
        told.elapsed() < Duration::from_millis(1500),
        "{:?}",
        told.elapsed()
    );
}

#[test]
fn a_socket_buffer_smaller_than_asked_is_known() {
    let (_emulator, options) = emulator(10, "L10");
    for (asked, granted) in [(1 << 16, None), (1 << 30, granted_socket_buffer(1 << 30).ok())] {
        let options = LiveOptions {
            socket_buffer_bytes: asked,
            ..options.clone()
        };
        let mut memory = CameraMemory::default();
        let mut camera = LiveCamera::start(&options, &mut memory).unwrap();
        assert!(frame(&mut camera, &mut memory).is_some());
        let small = granted.filter(|g| *g < asked);
        assert_eq!(camera.small_socket_buffer(), small, "asked {asked}");
        camera.stop();
    }
}
