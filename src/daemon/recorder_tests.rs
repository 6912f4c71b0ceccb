//! The recorder against a disk that works, one that does not, and a memory that is too small.

use std::path::Path;

use crossbeam_channel::{bounded, unbounded};

use super::*;
use crate::daemon::clip_disk::ClipDisk;
use crate::recording::{FrameFlags, Holes, SessionReader};
use crate::scene::{FrameStamp, PixelFormat};
use crate::time::StampedMidpoint;

const BYTES: usize = 64 * 32;

fn config(folder: &Path, mode: RecordMode) -> RecordConfig {
    RecordConfig {
        mode,
        folder: folder.to_owned(),
        memory_bytes: 200 * BYTES,
        quota_bytes: 1 << 30,
        before_s: 0.5,
        after_s: 0.5,
    }
}

fn live(camera: &str, k: i64) -> RecordedLive {
    RecordedLive {
        camera: CameraId::new(camera).unwrap(),
        frame: RawFrame {
            stamp: FrameStamp {
                frame: k as u64,
                device: None,
                arrival: None,
                stamped: StampedMidpoint::from_nanos(k * 10_000_000),
            },
            width_px: 64,
            height_px: 32,
            format: PixelFormat::Mono8,
            pixels: Arc::new(vec![7_u8; BYTES]),
        },
        exposure_s: 0.001,
    }
}

/// The disk's thread of a session that has neither rig nor calibration.
fn disk_thread_of(config: RecordConfig, health: &Arc<RecorderHealth>) -> ClipDisk {
    ClipDisk {
        configs: crossbeam_channel::never(),
        config,
        rig_toml: String::new(),
        calibration: "none".into(),
        health: health.clone(),
        session_bytes_least: 1 << 40,
    }
}

/// Runs recorder and disk over `count` frames (100 Hz) of two cameras; a ball flies in 1.0–1.4 s.
fn record(config: RecordConfig, count: i64) -> Arc<RecorderHealth> {
    let health = Arc::new(RecorderHealth::default());
    let (disk_in, disk) = bounded(4);
    let cameras = ["first", "third"].map(|c| CameraId::new(c).unwrap()).to_vec();
    let recorder = Recorder::new(config.clone(), cameras, disk_in, health.clone());
    let (frames_in, frames) = unbounded();
    let (triggers_in, triggers) = unbounded();
    let ball = ClipTrigger {
        first_ns: 1_000_000_000,
        last_ns: 1_400_000_000,
    };
    for k in 1..=count {
        for camera in ["first", "third"] {
            frames_in.send(live(camera, k)).unwrap();
        }
    }
    triggers_in.send(ball).unwrap();
    drop((frames_in, triggers_in));
    let most = std::thread::scope(|scope| {
        let disk_thread = disk_thread_of(config, &health);
        scope.spawn(move || disk_thread.run(&disk));
        recorder.run(&frames, &triggers, &crossbeam_channel::never());
        health.held_bytes.load(Ordering::Relaxed)
    });
    assert!(most <= 200 * BYTES, "{most}");
    health
}

fn sessions(folder: &Path) -> Vec<std::path::PathBuf> {
    let mut found: Vec<_> = std::fs::read_dir(folder)
        .unwrap()
        .map(|e| e.unwrap().path())
        .collect();
    found.sort();
    found
}

#[test]
fn bytes_that_do_not_fill_a_frame_are_told_and_not_counted() {
    let folder = tempfile::tempdir().unwrap();
    let health = Arc::new(RecorderHealth::default());
    let disk = disk_thread_of(config(folder.path(), RecordMode::Clips), &health);
    let mut open = disk.open("pitch").unwrap();
    let mut write = |k: i64, format: PixelFormat, bytes: usize| {
        let RecordedLive { camera, frame, .. } = live("first", k);
        let pixels = Arc::new(vec![7; bytes]);
        let frame = RawFrame {
            format,
            pixels,
            ..frame
        };
        let written = open.write(&HeldFrame::new(camera, frame, 0.001, &health));
        (written.map_err(|error| error.to_string()), open.bytes)
    };
    let counted = BYTES as u64;
    assert_eq!(write(1, PixelFormat::Mono8, BYTES), (Ok(()), counted));
    let told = "camera first, frame 2: has 100 bytes of pixels, 64x32 need 3072";
    assert_eq!(
        write(2, PixelFormat::Mono12p, 100),
        (Err(told.to_owned()), counted)
    );
    // The disk's own refusal: the stamps do not rise.
    assert_eq!(write(1, PixelFormat::Mono8, BYTES).1, counted);
    assert_eq!(write(3, PixelFormat::Mono12p, 3072), (Ok(()), 2 * counted));
}

#[test]
fn a_clip_has_every_frame_from_before_release_to_after_the_plate() {
    let folder = tempfile::tempdir().unwrap();
    let config = RecordConfig {
        memory_bytes: 1 << 30,
        ..config(folder.path(), RecordMode::Clips)
    };
    let (disk_in, disk) = bounded(4);
    let health = Arc::new(RecorderHealth::default());
    let cameras = ["first", "third"].map(|c| CameraId::new(c).unwrap()).to_vec();
    let mut recorder = Recorder::new(config.clone(), cameras, disk_in, health.clone());
    for k in 1..=250 {
        recorder.take(live("first", k));
        recorder.take(live("third", k));
    }
    recorder.cut(ClipTrigger {
        first_ns: 1_000_000_000,
        last_ns: 1_400_000_000,
    });
    drop(recorder);
    let disk_thread = disk_thread_of(config, &health);
    disk_thread.run(&disk);
    let found = sessions(folder.path());
    assert_eq!(found.len(), 1);
    let session = SessionReader::open(&found[0]).unwrap();
    for camera in ["first", "third"] {
        let frames = session.frames(&CameraId::new(camera).unwrap()).unwrap();
        let numbers: Vec<u64> = frames.map(|f| f.frame.stamp.frame).collect();
        assert_eq!(numbers, (50..=190).collect::<Vec<_>>());
    }
    assert_eq!(
        health.held_bytes.load(Ordering::Relaxed),
        0,
        "all memory is given back"
    );
}

#[test]
fn a_hole_in_a_clip_is_marked() {
    let folder = tempfile::tempdir().unwrap();
    let config = config(folder.path(), RecordMode::Continuous);
    let (disk_in, disk) = bounded(200);
    let health = Arc::new(RecorderHealth::default());
    let cameras = ["first", "third"].map(|c| CameraId::new(c).unwrap());
    let mut recorder = Recorder::new(config.clone(), cameras.to_vec(), disk_in, health.clone());
    for k in 5..=60 {
        recorder.take(live("first", k));
        if !(20..=22).contains(&k) && k != 40 {
            recorder.take(live("third", k));
        }
    }
    drop(recorder);
    disk_thread_of(config, &health).run(&disk);
    let session = SessionReader::open(&sessions(folder.path())[0]).unwrap();
    let marked = session.frames(&cameras[1]).unwrap();
    let marked = marked.filter(|f| f.flags.contains(FrameFlags::AFTER_LOSS));
    assert_eq!(marked.map(|f| f.frame.stamp.frame).collect::<Vec<_>>(), [23, 41]);
    let verified = session.verify();
    let holes = Holes { places: 2, frames: 4 };
    assert_eq!(verified.frames, 108);
    assert_eq!(
        verified.holes.into_iter().collect::<Vec<_>>(),
        [(cameras[1].clone(), holes)]
    );
}

#[test]
fn too_little_memory_cuts_a_clip_short_and_says_so() {
    let folder = tempfile::tempdir().unwrap();
    // 100 frames a camera, and a clip is 140.
    let health = record(config(folder.path(), RecordMode::Clips), 250);
    assert_eq!(health.clips_cut.load(Ordering::Relaxed), 1);
    assert_eq!(health.held_bytes.load(Ordering::Relaxed), 0);
}

#[test]
fn a_disk_that_is_gone_costs_recordings_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("not-a-folder");
    std::fs::write(&file, "x").unwrap();
    let health = record(config(&file, RecordMode::Clips), 160);
    assert_eq!(health.clips.load(Ordering::Relaxed), 0);
    assert_eq!(health.clips_lost.load(Ordering::Relaxed), 1);
    assert!(health.frames_lost.load(Ordering::Relaxed) > 0);
    assert_eq!(health.held_bytes.load(Ordering::Relaxed), 0);
}

#[test]
fn a_continuous_recording_keeps_or_counts_every_frame() {
    let folder = tempfile::tempdir().unwrap();
    let health = record(config(folder.path(), RecordMode::Continuous), 100);
    let written = health.frames.load(Ordering::Relaxed);
    let lost = health.frames_lost.load(Ordering::Relaxed);
    assert_eq!(written + lost, 200);
    assert!(written > 0);
}

#[test]
fn the_quota_removes_the_oldest_and_no_stranger() {
    let folder = tempfile::tempdir().unwrap();
    let small = RecordConfig {
        quota_bytes: 1,
        memory_bytes: 1 << 30,
        ..config(folder.path(), RecordMode::Clips)
    };
    std::fs::create_dir(folder.path().join("my-own")).unwrap();
    for _ in 0..2 {
        let health = Arc::new(RecorderHealth::default());
        let (disk_in, disk) = bounded(1);
        let held = HeldFrame::new(
            CameraId::new("first").unwrap(),
            live("first", 1).frame,
            0.001,
            &health,
        );
        disk_in.send(DiskJob::Clip(vec![Arc::new(held)])).unwrap();
        drop(disk_in);
        let disk_thread = disk_thread_of(small.clone(), &health);
        disk_thread.run(&disk);
        assert_eq!(health.clips.load(Ordering::Relaxed), 1);
        std::thread::sleep(Duration::from_millis(5));
    }
    let names: Vec<_> = sessions(folder.path());
    assert_eq!(names.len(), 2, "{names:?}");
    assert!(folder.path().join("my-own").exists());
}

#[test]
fn the_disk_takes_settings_while_there_is_nothing_to_write() {
    let folder = tempfile::tempdir().unwrap();
    let config = config(folder.path(), RecordMode::Clips);
    let health = Arc::new(RecorderHealth::default());
    let (configs_in, configs) = bounded(1);
    let (jobs_in, jobs) = bounded::<DiskJob>(1);
    let disk = ClipDisk {
        configs,
        ..disk_thread_of(config.clone(), &health)
    };
    std::thread::scope(|scope| {
        scope.spawn(move || disk.run(&jobs));
        for _ in 0..8 {
            let taken = configs_in.send_timeout(config.clone(), Duration::from_secs(10));
            assert!(taken.is_ok(), "no pitch for an hour, and the quota cannot change");
        }
        drop((configs_in, jobs_in));
    });
}

#[test]
fn a_continuous_recording_keeps_to_its_quota_while_it_runs() {
    let folder = tempfile::tempdir().unwrap();
    let config = RecordConfig {
        quota_bytes: 8 << 20,
        memory_bytes: 1 << 30,
        ..config(folder.path(), RecordMode::Continuous)
    };
    let health = Arc::new(RecorderHealth::default());
    let (jobs_in, jobs) = bounded::<DiskJob>(4);
    let disk = ClipDisk {
        session_bytes_least: 1000,
        ..disk_thread_of(config, &health)
    };
    let mut most = 0;
    std::thread::scope(|scope| {
        scope.spawn(move || disk.run(&jobs));
        // 40 MiB of frames, five times the quota.
        for k in 1..=20_480 {
            let RecordedLive {
                camera,
                frame,
                exposure_s,
            } = live("first", k);
            let held = HeldFrame::new(camera, frame, exposure_s, &health);
            jobs_in.send(DiskJob::Frame(Arc::new(held))).unwrap();
            if k % 512 == 0 {
                most = most.max(bytes_below(folder.path()));
            }
        }
        drop(jobs_in);
    });
    println!("at most {most} bytes; {}", health.line());
    assert_eq!(health.frames.load(Ordering::Relaxed), 20_480);
    assert!((4 << 20..10 << 20).contains(&most), "{most}");
    assert_eq!(health.held_bytes.load(Ordering::Relaxed), 0);
}

fn bytes_below(folder: &Path) -> u64 {
    let files = sessions(folder)
        .into_iter()
        .filter_map(|s| std::fs::read_dir(s).ok());
    let files = files.flatten().flatten().filter_map(|e| e.metadata().ok());
    files.map(|m| m.len()).sum()
}

#[test]
fn packed_frames_are_recorded_as_the_detector_sees_them() {
    let folder = tempfile::tempdir().unwrap();
    let config = config(folder.path(), RecordMode::Clips);
    let (disk_in, disk) = bounded(4);
    let health = Arc::new(RecorderHealth::default());
    let camera = CameraId::new("first").unwrap();
    let mut recorder = Recorder::new(config.clone(), vec![camera.clone()], disk_in, health.clone());
    // Two pixels of twelve bits, 0x7bc and 0x123, again and again.
    let packed: Arc<Vec<u8>> = Arc::new([0xbc, 0x37, 0x12].repeat(BYTES / 2));
    for k in 1..=30 {
        let mut packed_live = live("first", k);
        packed_live.frame.format = PixelFormat::Mono12p;
        packed_live.frame.pixels = packed.clone();
        recorder.take(packed_live);
    }
    assert_eq!(
        health.held_bytes.load(Ordering::Relaxed),
        30 * BYTES * 3 / 2,
        "memory is counted as it is held"
    );
    let (first_ns, last_ns) = (100_000_000, 200_000_000);
    recorder.cut(ClipTrigger { first_ns, last_ns });
    drop(recorder);
    disk_thread_of(config, &health).run(&disk);
    let session = SessionReader::open(&sessions(folder.path())[0]).unwrap();
    let frames: Vec<_> = session.frames(&camera).unwrap().collect();
    assert_eq!(frames.len(), 30);
    for recorded in frames {
        assert_eq!(recorded.frame.bytes(), [0x7b, 0x12].repeat(BYTES / 2));
    }
}
