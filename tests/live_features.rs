//! Settings that only some cameras have: a clock that follows the network's (PTP), and features by their own names.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may")]

#[path = "lab/small.rs"]
mod small;

use std::time::{Duration, Instant};

use pitchd::capture::aravis::{CameraAddress, CameraMemory, LiveCamera, LiveFrame, LiveOptions, Ptp};
use pitchd::emulation::{Drill, Emulator, Faults};
use pitchd::scene::FeatureValue;
use pitchd::time::PtpDomain;
use small::frame;

fn emulator(last: u8, serial: &str, faults: Faults) -> (Emulator, LiveOptions) {
    small::emulator([91, last], serial, faults)
}

/// Frames until one is of this clock epoch, at most for eight seconds.
fn frame_of_epoch(camera: &mut LiveCamera, memory: &mut CameraMemory, wanted: u32) -> LiveFrame {
    let until = Instant::now() + Duration::from_secs(8);
    loop {
        let next = frame(camera, memory).unwrap();
        if next.clock_epoch == wanted {
            return next;
        }
        assert!(Instant::now() < until, "epoch {} stays", next.clock_epoch);
    }
}

#[test]
fn clocks_of_one_network_stamp_on_one_scale() {
    let faults = |clock_offset_s, skew_ppm, ptp_apart_s| Faults {
        clock_offset_s,
        skew_ppm,
        ptp_apart_s,
        ..Faults::default()
    };
    let network = PtpDomain::default();
    let start = |last, serial, faults| {
        let (emulator, mut options) = emulator(last, serial, faults);
        options.ptp = Ptp::WhereAvailable(network.clone());
        (emulator, options)
    };
    let (first_emulator, first_options) = start(20, "P1", faults(70.0, 80.0, 0.0));
    let (_third_emulator, third_options) = start(21, "P2", faults(7.0, -60.0, 0.0));
    let (_other_emulator, other_options) = start(22, "P3", faults(1.0, 5.0, 0.3));
    let mut memories = [(); 3].map(|()| CameraMemory::default());
    let [first_memory, third_memory, other_memory] = &mut memories;
    let mut first = LiveCamera::start(&first_options, first_memory).unwrap();
    // Before it follows, its own clock stamps.
    let before = frame(&mut first, first_memory).unwrap();
    assert!(before.clock_epoch > 0 && before.stamp_sigma_s > 1e-5);
    let a = frame_of_epoch(&mut first, first_memory, 0);
    let mut third = LiveCamera::start(&third_options, third_memory).unwrap();
    let b = frame_of_epoch(&mut third, third_memory, 0);
    // As far apart as their clocks say, which no arrival on a shared host tells: 10 s of a rate of 1e-7 at most.
    let apart_ns = |a: &LiveFrame, b: &LiveFrame| {
        let device = |f: &LiveFrame| f.frame.stamp.device.unwrap().nanos();
        let stamped = |f: &LiveFrame| f.frame.stamp.stamped.nanos();
        let passed_ns = device(b) - device(a);
        (stamped(b) - stamped(a) - passed_ns, passed_ns)
    };
    let (off_ns, passed_ns) = apart_ns(&a, &b);
    assert!(passed_ns > 1_000_000_000, "{passed_ns}");
    assert!(
        (off_ns as f64 / passed_ns as f64).abs() < 100e-6,
        "{off_ns} ns off after {passed_ns}"
    );
    let (a, b) = (
        frame(&mut first, first_memory).unwrap(),
        frame(&mut third, third_memory).unwrap(),
    );
    let (near_ns, near_passed_ns) = apart_ns(&a, &b);
    assert!(
        near_ns.abs() <= 2 + near_passed_ns.abs() / 10_000,
        "{near_ns} ns off after {near_passed_ns}"
    );
    assert!(a.stamp_sigma_s < 2e-6 && b.stamp_sigma_s < 2e-6);
    // One that is its own network's: told, and stamped by its own clock.
    let mut other = LiveCamera::start(&other_options, other_memory).unwrap();
    let until = Instant::now() + Duration::from_secs(4);
    while Instant::now() < until {
        let stamped = frame(&mut other, other_memory).unwrap();
        assert!(stamped.clock_epoch > 0);
    }
    // After a restart it is on the scale again: the same epoch, the same delay.
    first_emulator.drill(Drill::Reboot(Duration::from_millis(300)));
    first.abandon();
    std::thread::sleep(Duration::from_millis(600));
    let mut first = LiveCamera::start(&first_options, first_memory).unwrap();
    let again = frame_of_epoch(&mut first, first_memory, 0);
    let (off_ns, passed_ns) = apart_ns(&b, &again);
    assert!(
        (off_ns as f64 / passed_ns as f64).abs() < 100e-6,
        "{off_ns} ns off after {passed_ns}"
    );
    for camera in [first, third, other] {
        camera.stop();
    }
}

#[test]
fn features_are_set_in_order_or_refused_by_name() {
    let (_emulator, options) = emulator(30, "P4", Faults::default());
    let with = |features: &[(&str, FeatureValue)]| LiveOptions {
        features: features
            .iter()
            .map(|(name, value)| ((*name).to_owned(), value.clone()))
            .collect(),
        ..options.clone()
    };
    let mut memory = CameraMemory::default();
    let good = with(&[
        ("Gain", FeatureValue::Float(7.5)),
        ("DeviceUserID", FeatureValue::Text("dugout".into())),
        ("DeviceUserID", FeatureValue::Text("mound".into())),
        ("GevSCPD", FeatureValue::Integer(20)),
        ("TriggerMode", FeatureValue::Text("Off".into())),
        ("PtpEnable", FeatureValue::Switch(true)),
        ("PtpDataSetLatch", FeatureValue::Switch(true)),
    ]);
    let mut camera = LiveCamera::start(&good, &mut memory).unwrap();
    assert!(frame(&mut camera, &mut memory).is_some());
    camera.stop();
    // The last of its names is the one that it answers to.
    for (name, is_there) in [("dugout", false), ("mound", true)] {
        let named = LiveOptions {
            which: CameraAddress {
                user_name: Some(name.into()),
                ..options.which.clone()
            },
            ..options.clone()
        };
        let camera = LiveCamera::start(&named, &mut memory);
        assert_eq!(camera.is_ok(), is_there, "{name}: {:?}", camera.err());
    }
    for (features, words) in [
        (
            with(&[("Hue", FeatureValue::Integer(3))]),
            "Hue = 3: the camera has no such feature",
        ),
        (with(&[("Gain", FeatureValue::Float(90.0))]), "Gain = 90.0: "),
        (
            with(&[("TriggerMode", FeatureValue::Text("On".into()))]),
            "TriggerMode = \"On\": ",
        ),
        (with(&[("Gain", FeatureValue::Switch(true))]), "Gain = true: "),
    ] {
        let error = LiveCamera::start(&features, &mut memory)
            .err()
            .unwrap()
            .to_string();
        assert!(
            error.starts_with(&format!("camera first: features: {words}")),
            "{error}"
        );
    }
}
