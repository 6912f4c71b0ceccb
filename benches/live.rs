//! Is a frame copied after the library has assembled it? Processor time of everything that the daemon does with a frame
//! between the library's buffer and the eye's search (capture, hand-off, recorder's ring and clip), against one copy of it.
//! A camera in software sends 2048×1024 frames over loopback; the bench fails if the way costs half of a copy.
#![allow(missing_docs)]

use std::hint::black_box;
use std::net::Ipv4Addr;
use std::sync::Arc;
use std::time::{Duration, Instant};

use crossbeam_channel::{bounded, unbounded};
use pitchd::capture::aravis::{CameraAddress, CameraMemory, LiveCamera, LiveOptions, Next};
use pitchd::config::{RecordConfig, RecordMode};
use pitchd::daemon::recorder::{ClipTrigger, RecordedLive, Recorder, RecorderHealth};
use pitchd::emulation::{Emulator, EmulatorOptions, ScriptShape, pattern};
use pitchd::scene::CameraId;
use pitchd::time::SystemClock;
use rustix::time::{ClockId, clock_gettime};

const SIZE: (u32, u32) = (2048, 1024);
const RATE_HZ: f64 = 100.0;
const FRAMES: usize = 400;

/// Processor time of the calling thread, microseconds.
fn own_us() -> f64 {
    let now = clock_gettime(ClockId::ThreadCPUTime);
    1e6 * now.tv_sec as f64 + 1e-3 * now.tv_nsec as f64
}

/// One copy of a frame, from a ring of 32 to another place: neither is in a cache.
fn copy_us() -> f64 {
    let bytes = SIZE.0 as usize * SIZE.1 as usize;
    let ring: Vec<Vec<u8>> = (0..32).map(|k| vec![k; bytes]).collect();
    let mut to = vec![vec![0; bytes]; 32];
    let mut best = f64::INFINITY;
    for _ in 0..8 {
        let begun = own_us();
        for (from, to) in ring.iter().zip(&mut to) {
            to.copy_from_slice(black_box(from));
        }
        best = best.min((own_us() - begun) / 32.0);
    }
    black_box(&to);
    best
}

fn main() {
    let address = Ipv4Addr::new(127, 0, 95, 1);
    let shape = ScriptShape {
        width_px: SIZE.0,
        height_px: SIZE.1,
        rate_hz: RATE_HZ,
        exposure_s: 0.001,
    };
    let options = EmulatorOptions::new(address, "B1");
    let _emulator = Emulator::start(&options, shape, pattern(shape)).expect("an address of loopback");
    let camera = CameraId::new("bench").expect("a good id");
    let which = CameraAddress {
        address: Some(address),
        ..CameraAddress::default()
    };
    let options = LiveOptions {
        buffers: 200,
        packet_size: Some(9000),
        ..LiveOptions::new(camera.clone(), which, SIZE, RATE_HZ)
    };
    let mut memory = CameraMemory::default();
    let mut live = LiveCamera::start(&options, &mut memory).expect("the emulated camera");

    let health = Arc::new(RecorderHealth::default());
    let config = RecordConfig {
        mode: RecordMode::Clips,
        folder: "unused".into(),
        memory_bytes: 200 << 20,
        quota_bytes: 0,
        before_s: 0.1,
        after_s: 0.1,
    };
    let (jobs_in, jobs) = bounded(4);
    let recorder = Recorder::new(config, vec![camera.clone()], jobs_in, health);
    let (record_in, record) = bounded::<RecordedLive>(64);
    let (triggers_in, triggers) = unbounded();
    // The queue to the eye, here only emptied: what the eye reads is its own bench.
    let (eye_in, eye) = bounded(64);
    let eye = std::thread::spawn(move || eye.into_iter().count());
    let recording = std::thread::spawn(move || {
        let begun = own_us();
        recorder.run(&record, &triggers, &crossbeam_channel::never());
        own_us() - begun
    });
    let clips = std::thread::spawn(move || jobs.into_iter().count());

    let (begun_us, begun) = (own_us(), Instant::now());
    let mut frames = 0;
    while frames < FRAMES && begun.elapsed() < Duration::from_secs(30) {
        let Next::Frame(frame) = live.next(&mut memory, &SystemClock, Duration::from_millis(100)) else {
            continue;
        };
        frames += 1;
        let at = frame.frame.stamp.stamped.nanos();
        if frames % 50 == 0 {
            let _ = triggers_in.send(ClipTrigger {
                first_ns: at - 200_000_000,
                last_ns: at,
            });
        }
        let recorded = RecordedLive {
            camera: camera.clone(),
            frame: frame.frame.clone(),
            exposure_s: frame.exposure_s,
        };
        assert!(record_in.try_send(recorded).is_ok() && eye_in.try_send(frame).is_ok());
    }
    let capture_us = (own_us() - begun_us) / frames.max(1) as f64;
    live.stop();
    drop((record_in, triggers_in, eye_in));
    let record_us = recording.join().expect("the recorder") / frames.max(1) as f64;
    let (seen, cut) = (eye.join().expect("the eye"), clips.join().expect("the clips"));
    let copy_us = copy_us();
    println!("{frames} frames of {}x{}, {cut} clips cut out", SIZE.0, SIZE.1);
    println!("capture and hand-off {capture_us:7.1} us a frame");
    println!("recorder, ring+clips {record_us:7.1} us a frame");
    println!("one copy of a frame  {copy_us:7.1} us");
    let share = (capture_us + record_us) / copy_us;
    println!("the way to the eye costs {share:.3} of one copy");
    assert!(
        frames == FRAMES && seen == FRAMES && cut >= 4,
        "{frames} frames, {cut} clips"
    );
    assert!(share < 0.5, "a frame is copied on its way");
}
