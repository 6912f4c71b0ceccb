//! Live cameras through Aravis, against the emulated camera on loopback addresses: real protocol, real threads.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may")]

#[path = "lab/small.rs"]
mod small;

use std::net::Ipv4Addr;
use std::sync::Arc;
use std::time::{Duration, Instant};

use crossbeam_channel::{bounded, unbounded};
use pitchd::capture::aravis::{
    CameraAddress, CameraMemory, LiveCamera, LiveError, LiveFrame, LiveOptions, Next, is_held, ping,
};
use pitchd::config::{RecordConfig, RecordMode};
use pitchd::daemon::clip_disk::DiskJob;
use pitchd::daemon::recorder::{ClipTrigger, RecordedLive, Recorder, RecorderHealth};
use pitchd::emulation::{Drill, Emulator, EmulatorOptions, Faults, pattern};
use pitchd::eye::{EyeConfig, FirstLook};
use pitchd::time::SystemClock;
use small::{SHAPE, frame};

/// Pixel formats by their numbers.
const MONO8: u32 = 0x0108_0001;
const BAYER: u32 = 0x0108_0009;

fn emulator(last: u8, serial: &str, faults: Faults) -> (Emulator, LiveOptions) {
    small::emulator([92, last], serial, faults)
}

#[test]
fn frames_come_whole_in_order_and_in_place() {
    let (emulator, options) = emulator(
        1,
        "L1",
        Faults {
            clock_offset_s: 77.0,
            skew_ppm: 80.0,
            ..Faults::default()
        },
    );
    let expected: Vec<_> = pattern(SHAPE).take(16).map(|f| f.pixels).collect();
    let mut memory = CameraMemory::default();
    let mut camera = LiveCamera::start(&options, &mut memory).unwrap();
    let mut places = std::collections::BTreeSet::new();
    let mut last: Option<LiveFrame> = None;
    for _ in 0..150 {
        let now = frame(&mut camera, &mut memory).unwrap();
        let bytes = now.frame.bytes();
        assert_eq!(bytes.len(), 640 * 320);
        assert!(
            expected.iter().any(|e| e[..] == *bytes),
            "the frame that was sent"
        );
        places.insert(bytes.as_ptr() as usize);
        if let Some(last) = &last {
            assert!(now.frame.stamp.frame > last.frame.stamp.frame);
            let frames = (now.frame.stamp.frame - last.frame.stamp.frame) as f64;
            let apart_s = now
                .frame
                .stamp
                .stamped
                .seconds_since(last.frame.stamp.stamped.nanos());
            // The device's clock spaces the stamps; before it is known the envelope may still fall by some ms.
            assert!(
                (apart_s * 60.0 - frames).abs() < 0.5,
                "{apart_s} s for {frames} frames"
            );
        }
        let device = now.frame.stamp.device.unwrap().nanos();
        assert!((77_000_000_000..100_000_000_000).contains(&device), "{device}");
        last = Some(now);
    }
    // Eight buffers serve all frames: they are read where they were assembled.
    assert!(places.len() <= 8, "{} places", places.len());
    camera.stop();
    let counters = memory.counters();
    println!("{counters:?} {:?}", emulator.counters());
    assert!(counters.frames == 150 && counters.underruns == 0);
}

#[test]
fn a_reader_that_keeps_all_buffers_costs_frames_and_nothing_else() {
    let (_emulator, options) = emulator(2, "L2", Faults::default());
    let mut memory = CameraMemory::default();
    let mut camera = LiveCamera::start(&options, &mut memory).unwrap();
    let kept: Vec<_> = (0..8).filter_map(|_| frame(&mut camera, &mut memory)).collect();
    assert_eq!(kept.len(), 8);
    let before: Vec<u8> = kept[0].frame.bytes().to_vec();
    std::thread::sleep(Duration::from_millis(300));
    assert!(matches!(
        camera.next(&mut memory, &SystemClock, Duration::from_millis(50)),
        Next::Nothing
    ));
    assert_eq!(kept[0].frame.bytes(), before, "a kept frame does not change");
    let numbers = kept.last().unwrap().frame.stamp.frame;
    // Readers let go on other threads.
    std::thread::spawn(move || drop(kept)).join().unwrap();
    let again = frame(&mut camera, &mut memory).unwrap();
    assert!(again.lost_before >= 10 && again.frame.stamp.frame == numbers + again.lost_before + 1);
    let underruns = memory.counters().underruns;
    assert!(
        (10..=again.lost_before + 1).contains(&underruns),
        "frames, not packets: {:?}",
        memory.counters()
    );
}

#[test]
fn lost_packets_are_sent_again_and_what_stays_lost_is_counted() {
    let (emulator, options) = emulator(
        3,
        "L3",
        Faults {
            loss: 0.005,
            ..Faults::default()
        },
    );
    let mut memory = CameraMemory::default();
    let mut camera = LiveCamera::start(&options, &mut memory).unwrap();
    let (mut first, mut last) = (None, 0);
    for _ in 0..120 {
        let number = frame(&mut camera, &mut memory).unwrap().frame.stamp.frame;
        first.get_or_insert(number);
        last = number;
    }
    let counters = memory.counters();
    println!("{counters:?} {:?}", emulator.counters());
    // 140 packets a frame, 0.5 % lost: half of all frames would be incomplete without resends.
    assert!(emulator.counters().resent > 20, "{:?}", emulator.counters());
    assert_eq!(last - first.unwrap() + 1, 120 + counters.missing);
    assert!(counters.missing < 30);
}

#[test]
fn a_rebooted_camera_is_opened_again_with_the_same_memory() {
    let (emulator, options) = emulator(
        4,
        "L4",
        Faults {
            clock_offset_s: 500.0,
            ..Faults::default()
        },
    );
    let mut memory = CameraMemory::default();
    let mut camera = LiveCamera::start(&options, &mut memory).unwrap();
    let before = frame(&mut camera, &mut memory).unwrap();
    assert_eq!(camera.is_held(), Some(true));
    emulator.drill(Drill::Reboot(Duration::from_millis(700)));
    let silent = Instant::now();
    while !matches!(
        camera.next(&mut memory, &SystemClock, Duration::from_millis(100)),
        Next::Nothing
    ) {}
    assert_eq!(camera.is_held(), None, "off");
    assert!(silent.elapsed() < Duration::from_secs(1));
    let letting_go = Instant::now();
    camera.abandon();
    assert!(
        letting_go.elapsed() < Duration::from_millis(100),
        "tear-down blocks nobody"
    );
    assert!(matches!(
        LiveCamera::start(&options, &mut memory),
        Err(LiveError::Absent { .. })
    ));
    std::thread::sleep(Duration::from_millis(800).saturating_sub(silent.elapsed()));
    let mut again = None;
    for _ in 0..40 {
        match LiveCamera::start(&options, &mut memory) {
            Ok(camera) => {
                again = Some(camera);
                break;
            }
            Err(error) => println!("{error}"),
        }
        std::thread::sleep(Duration::from_millis(250));
    }
    let after = frame(&mut again.unwrap(), &mut memory).unwrap();
    assert!(
        after.clock_epoch > before.clock_epoch,
        "its delay is to be estimated anew"
    );
    assert!(
        after.frame.stamp.device < before.frame.stamp.device,
        "its clock began anew"
    );
    let passed_s = after
        .frame
        .stamp
        .stamped
        .seconds_since(before.frame.stamp.stamped.nanos());
    let numbers = (after.frame.stamp.frame - before.frame.stamp.frame) as f64;
    assert!(
        (numbers / 60.0 - passed_s).abs() < 0.1,
        "{numbers} frames in {passed_s} s"
    );
}

#[test]
fn what_stands_in_the_way_is_said() {
    let (emulator_itself, options) = emulator(5, "L5", Faults::default());
    let refused = |options: &LiveOptions| {
        LiveCamera::start(options, &mut CameraMemory::default())
            .err()
            .unwrap()
    };
    let nobody = LiveOptions {
        which: CameraAddress {
            address: Some(Ipv4Addr::new(127, 0, 92, 250)),
            ..CameraAddress::default()
        },
        ..options.clone()
    };
    assert!(matches!(refused(&nobody), LiveError::Absent { .. }));
    let fast = LiveOptions {
        frame_rate_hz: 90.0,
        ..options.clone()
    };
    let error = refused(&fast);
    assert!(error.to_string().contains("frame rate"), "{error}");
    let large = LiveOptions {
        size_px: (1280, 720),
        ..options.clone()
    };
    let error = refused(&large);
    assert!(error.to_string().contains("region"), "{error}");
    assert!(error.to_string().contains("the sensor has 640x320"), "{error}");

    let mut memory = CameraMemory::default();
    let mut held = LiveCamera::start(&options, &mut memory).unwrap();
    assert!(frame(&mut held, &mut memory).is_some());
    let error = refused(&options);
    assert!(matches!(error, LiveError::Held { .. }), "{error}");
    assert!(
        error.to_string().contains("another program on 127.0.0.1"),
        "{error}"
    );
    assert!(
        frame(&mut held, &mut memory).is_some(),
        "the one that holds it does not notice"
    );
    held.stop();
    let other_serial = LiveOptions {
        which: CameraAddress {
            serial: Some("L99".into()),
            ..options.which.clone()
        },
        ..options.clone()
    };
    let text = refused(&other_serial).to_string();
    assert!(text.contains("is serial L5, not L99"), "{text}");
    let named = LiveOptions {
        which: CameraAddress {
            serial: Some("L99".into()),
            ..CameraAddress::default()
        },
        ..options.clone()
    };
    let text = refused(&named).to_string();
    println!("{text}");
    assert!(text.contains("no answer from serial L99"), "{text}");

    // A colour camera, and one behind a slow port.
    let colour = |good: String| {
        good.replace("Mono8", "BayerRG8")
            .replace(&MONO8.to_string(), &BAYER.to_string())
    };
    let other = |last: u8, genicam: Option<String>, link_gbps: f64| {
        let address = Ipv4Addr::new(127, 0, 92, last);
        let options = EmulatorOptions {
            genicam: genicam.map(Into::into),
            link_gbps,
            ..EmulatorOptions::new(address, "L")
        };
        let which = CameraAddress {
            address: Some(address),
            ..CameraAddress::default()
        };
        (Emulator::start(&options, SHAPE, pattern(SHAPE)).unwrap(), which)
    };
    let (_colour, which) = other(7, Some(colour(emulator_itself.genicam())), 5.0);
    let text = refused(&LiveOptions {
        which,
        ..options.clone()
    })
    .to_string();
    assert!(text.contains("no pixel format Mono8 (it has BayerRG8)"), "{text}");
    let (_slow, which) = other(8, None, 0.05);
    let text = refused(&LiveOptions {
        which,
        ..options.clone()
    })
    .to_string();
    assert!(
        text.contains("99 Mb/s are needed, its link has 50 Mb/s"),
        "{text}"
    );

    let address = options.which.address.unwrap();
    assert_eq!(ping(address, Duration::from_millis(200)).unwrap().serial, "L5");
    assert_eq!(is_held(address, Duration::from_millis(200)), Some(false));
}

#[test]
fn a_frame_is_one_memory_from_the_receive_thread_to_the_clip() {
    let (_emulator, options) = emulator(6, "L6", Faults::default());
    let options = LiveOptions {
        buffers: 150,
        ..options
    };
    let mut memory = CameraMemory::default();
    let mut camera = LiveCamera::start(&options, &mut memory).unwrap();
    let health = Arc::new(RecorderHealth::default());
    let config = RecordConfig {
        mode: RecordMode::Clips,
        folder: "unused".into(),
        memory_bytes: 100 * 640 * 320,
        quota_bytes: 0,
        before_s: 60.0,
        after_s: 0.0,
    };
    let (jobs_in, jobs) = bounded(4);
    let recorder = Recorder::new(config, vec![options.camera.clone()], jobs_in, health);
    let (record_in, record) = unbounded();
    let (triggers_in, triggers) = unbounded();
    let mut eye = FirstLook::new(options.camera.clone(), &EyeConfig::default(), 640, 320);
    let mut places = std::collections::BTreeMap::new();
    let mut last_ns = 0;
    let mut watched = Vec::new();
    for _ in 0..80 {
        let live = frame(&mut camera, &mut memory).unwrap();
        let stamp = live.frame.stamp;
        last_ns = stamp.stamped.nanos();
        places.insert(stamp.frame, live.frame.bytes().as_ptr() as usize);
        let recorded = RecordedLive {
            camera: options.camera.clone(),
            frame: live.frame.clone(),
            exposure_s: live.exposure_s,
        };
        record_in.send(recorded).unwrap();
        eye.push_raw(&live.frame).unwrap();
        // This reader, the recorder and the eye, which compares frames with those before: all hold the same pixels.
        watched.push((stamp.frame, Arc::strong_count(&live.frame.pixels)));
    }
    assert!(
        watched.iter().skip(20).all(|(_, holders)| *holders >= 3),
        "the eye has memory of its own: {watched:?}"
    );
    triggers_in
        .send(ClipTrigger {
            first_ns: last_ns,
            last_ns,
        })
        .unwrap();
    drop((record_in, triggers_in));
    recorder.run(&record, &triggers, &crossbeam_channel::never());
    let Ok(DiskJob::Clip(clip)) = jobs.recv() else {
        panic!("no clip");
    };
    assert_eq!(clip.len(), places.len());
    for held in &clip {
        let place = held.frame.bytes().as_ptr() as usize;
        assert_eq!(
            places.get(&held.frame.stamp.frame),
            Some(&place),
            "recorded where it arrived"
        );
    }
    let distinct: std::collections::BTreeSet<_> = places.values().collect();
    assert_eq!(
        distinct.len(),
        places.len(),
        "frames that are all held are in places of their own"
    );
    // Until the last holder lets go the library has these buffers no more.
    let pixels = clip[0].frame.pixels.clone();
    let before = pixels.to_vec();
    drop((clip, eye));
    assert_eq!(Arc::strong_count(&pixels), 1);
    for _ in 0..30 {
        assert!(frame(&mut camera, &mut memory).is_some());
    }
    assert!(pixels[..] == before, "a frame that is held does not change");
    camera.stop();
}
