//! A small camera in software on a loopback address, and how the daemon opens it: 640×320 at 60 Hz.

#![allow(dead_code, reason = "every test uses its own part of it")]

use std::net::Ipv4Addr;
use std::time::{Duration, Instant};

use pitchd::capture::aravis::{CameraAddress, CameraMemory, LiveCamera, LiveFrame, LiveOptions, Next};
use pitchd::emulation::{Emulator, EmulatorOptions, Faults, ScriptShape, pattern};
use pitchd::scene::CameraId;
use pitchd::time::SystemClock;

/// What it sees: a pattern.
pub const SHAPE: ScriptShape = ScriptShape {
    width_px: 640,
    height_px: 320,
    rate_hz: 60.0,
    exposure_s: 0.002,
};

/// One at 127.0.`net`.`last`.
pub fn emulator([net, last]: [u8; 2], serial: &str, faults: Faults) -> (Emulator, LiveOptions) {
    let address = Ipv4Addr::new(127, 0, net, last);
    let options = EmulatorOptions {
        faults,
        ..EmulatorOptions::new(address, serial)
    };
    let emulator = Emulator::start(&options, SHAPE, pattern(SHAPE)).unwrap();
    let which = CameraAddress {
        address: Some(address),
        ..CameraAddress::default()
    };
    let camera = CameraId::new("first").unwrap();
    let live = LiveOptions {
        buffers: 8,
        packet_size: Some(1500),
        realtime_priority: None,
        ..LiveOptions::new(camera, which, (SHAPE.width_px, SHAPE.height_px), SHAPE.rate_hz)
    };
    (emulator, live)
}

/// The next whole frame within two seconds.
pub fn frame(camera: &mut LiveCamera, memory: &mut CameraMemory) -> Option<LiveFrame> {
    let until = Instant::now() + Duration::from_secs(2);
    while Instant::now() < until {
        if let Next::Frame(frame) = camera.next(memory, &SystemClock, Duration::from_millis(100)) {
            camera.look_at_clock();
            return Some(frame);
        }
    }
    None
}
