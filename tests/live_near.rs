//! Cameras that are not GigE Vision: opened by the library's own name for them, without ping and packet filter. There is no
//! USB3 camera here; the library's fake camera goes the same way through our code, and is enabled by this test alone.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may")]

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use crossbeam_channel::bounded;
use pitchd::capture::aravis::{
    CameraAddress, CameraMemory, LiveCamera, LiveError, LiveFrame, LiveOptions, Next, Place, UsbMode,
    enable_fake_camera, list_near_devices,
};
use pitchd::daemon::health::{CameraHealth, CameraState};
use pitchd::daemon::supervise::Supervisor;
use pitchd::scene::CameraId;
use pitchd::time::SystemClock;

const SIZE: (u32, u32) = (512, 256);
const RATE_HZ: f64 = 40.0;

fn options(serial: &str) -> LiveOptions {
    let which = CameraAddress {
        serial: Some(serial.to_owned()),
        ..CameraAddress::default()
    };
    LiveOptions {
        buffers: 8,
        exposure_s: Some(0.002),
        realtime_priority: None,
        usb_mode: UsbMode::Async,
        ..LiveOptions::new(CameraId::new("near").unwrap(), which, SIZE, RATE_HZ)
    }
}

fn frame(camera: &mut LiveCamera, memory: &mut CameraMemory) -> LiveFrame {
    let until = Instant::now() + Duration::from_secs(3);
    while Instant::now() < until {
        if let Next::Frame(frame) = camera.next(memory, &SystemClock, Duration::from_millis(100)) {
            return frame;
        }
    }
    panic!("no frame");
}

/// One test: what is enabled is enabled for the whole process.
#[test]
fn a_camera_that_is_not_on_the_network_streams_stops_and_comes_back() {
    let fakes = || list_near_devices().into_iter().filter(|d| d.protocol == "Fake");
    assert_eq!(fakes().count(), 0, "nobody is shown a camera that is not there");
    enable_fake_camera();
    let device = fakes().next().unwrap();
    println!("{device:?}");
    let options = options(&device.serial);
    let mut memory = CameraMemory::default();
    let mut camera = LiveCamera::start(&options, &mut memory).unwrap();
    assert_eq!(*camera.place(), Place::Device(device.id.clone()));
    assert_eq!((camera.packet_size(), camera.small_socket_buffer()), (0, None));
    assert_eq!(camera.is_held(), None, "no GVCP there to ask");
    let mut places = std::collections::BTreeSet::new();
    let mut last: Option<LiveFrame> = None;
    for _ in 0..60 {
        let now = frame(&mut camera, &mut memory);
        assert_eq!(now.frame.bytes().len(), 512 * 256);
        assert!((now.exposure_s - 0.002).abs() < 1e-6);
        places.insert(now.frame.bytes().as_ptr() as usize);
        if let Some(last) = last {
            assert!(now.frame.stamp.frame > last.frame.stamp.frame);
            assert!(now.frame.stamp.stamped > last.frame.stamp.stamped);
        }
        last = Some(now);
    }
    assert!(places.len() <= 8, "{} places", places.len());
    assert!(camera.stop(), "a live camera stops at once");
    let stopped_at = last.unwrap().frame.stamp.frame;

    // By its serial number, with the memory that it had; abandoned as if it had died, and opened once more.
    for round in 0..2 {
        let mut camera = LiveCamera::start(&options, &mut memory).unwrap();
        let again = frame(&mut camera, &mut memory);
        assert!(again.frame.stamp.frame > stopped_at, "numbers go on");
        let place = again.frame.bytes().as_ptr() as usize;
        assert!(places.contains(&place), "round {round}: memory of its own again");
        camera.abandon();
    }
    println!("{:?}", memory.counters());
    assert_eq!(memory.counters().underruns, 0);

    let other = LiveOptions {
        which: CameraAddress {
            serial: Some("no such".to_owned()),
            ..CameraAddress::default()
        },
        ..options.clone()
    };
    let error = LiveCamera::start(&other, &mut CameraMemory::default())
        .err()
        .unwrap();
    assert!(matches!(error, LiveError::Absent { .. }), "{error}");
    supervised(options);
}

/// The same under the daemon's own supervision, to its end.
fn supervised(options: LiveOptions) {
    let health = Arc::new(CameraHealth::new(options.camera.clone()));
    let stop = Arc::new(AtomicBool::new(false));
    let (frames_in, frames) = bounded(64);
    let supervisor = Supervisor {
        options,
        frames: frames_in,
        record: None,
        health: health.clone(),
        stop: stop.clone(),
    };
    let thread = std::thread::spawn(move || supervisor.run());
    for _ in 0..20 {
        frames.recv_timeout(Duration::from_secs(3)).unwrap();
    }
    assert_eq!(health.state(), CameraState::Streaming);
    stop.store(true, Ordering::Relaxed);
    let told = Instant::now();
    thread.join().unwrap();
    assert!(told.elapsed() < Duration::from_secs(1), "{:?}", told.elapsed());
    assert_eq!(health.losses.load(Ordering::Relaxed), 0);
}
