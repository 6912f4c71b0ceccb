//! Sessions on disk: what is written comes back bit by bit; what is broken is counted, never guessed.

#![allow(clippy::unwrap_used, clippy::panic)]

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use pitchd::recording::{
    CameraGeometry, LostFrames, PixelEncoding, RecordedFrame, SessionOptions, SessionReader, SessionWriter,
    repair_session,
};
use pitchd::scene::{CameraId, Frame, FrameStamp};
use pitchd::time::{ArrivalTime, DeviceTime, StampedMidpoint};

const PERIOD_NS: i64 = 5_714_286;

fn camera(name: &str) -> CameraId {
    CameraId::new(name).unwrap()
}

/// Frame `number` of a made-up camera: pixels differ from frame to frame and from camera to camera.
fn frame(salt: u64, number: u64, geometry: CameraGeometry) -> RecordedFrame {
    let count = u64::from(geometry.width_px) * u64::from(geometry.height_px);
    let mut state = (salt << 32 | number).wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let pixels: Vec<u8> = (0..count)
        .map(|_| {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (60 + state % 40) as u8
        })
        .collect();
    let stamped = 1_000_000_000_000 + salt as i64 * 777 + number as i64 * PERIOD_NS;
    RecordedFrame {
        frame: Frame {
            stamp: FrameStamp {
                frame: number,
                device: Some(DeviceTime::from_nanos(stamped - 999)),
                arrival: number
                    .is_multiple_of(2)
                    .then(|| ArrivalTime::from_nanos(stamped + 12_345)),
                stamped: StampedMidpoint::from_nanos(stamped),
            },
            width_px: geometry.width_px,
            height_px: geometry.height_px,
            pixels: Arc::new(pixels),
        },
        exposure_s: Some(0.001),
        flags: Default::default(),
    }
}

const SMALL: CameraGeometry = CameraGeometry {
    width_px: 64,
    height_px: 48,
};

/// A session of cameras `a` and `b`.
fn write_session(folder: &Path, encoding: PixelEncoding, geometry: CameraGeometry, frames: u64) {
    let options = SessionOptions {
        rig_toml: "[site]\nname = \"x\"\n".to_owned(),
        calibration_json: Some("{}".to_owned()),
        encoding,
        ..Default::default()
    };
    let mut session = SessionWriter::create(folder, options).unwrap();
    for (salt, name) in [(1, "a"), (2, "b")] {
        let mut writer = session.camera(&camera(name), geometry).unwrap();
        for number in 0..frames {
            writer.write(&frame(salt, number, geometry)).unwrap();
        }
        writer.finish().unwrap();
    }
    session.finish().unwrap();
}

fn same(got: &RecordedFrame, wanted: &RecordedFrame) -> bool {
    got.frame.stamp == wanted.frame.stamp
        && (got.frame.width_px, got.frame.height_px) == (wanted.frame.width_px, wanted.frame.height_px)
        && got.frame.bytes() == wanted.frame.bytes()
        && (got.exposure_s.unwrap() - wanted.exposure_s.unwrap()).abs() < 1e-12
        && got.flags == wanted.flags
}

/// Reads camera `a`; every frame given must be exactly the one that was written. Numbers of the frames.
fn read_a(reader: &SessionReader, geometry: CameraGeometry) -> Vec<u64> {
    let Some(frames) = reader.frames(&camera("a")) else {
        return Vec::new();
    };
    frames
        .map(|got| {
            let number = got.frame.stamp.frame;
            assert!(
                same(&got, &frame(1, number, geometry)),
                "frame {number} is not what was written"
            );
            number
        })
        .collect()
}

fn file_of(folder: &Path, name: &str) -> PathBuf {
    folder.join(name)
}

#[test]
fn round_trip_is_bit_exact() {
    for encoding in [PixelEncoding::Raw, PixelEncoding::Png] {
        for (geometry, frames) in [
            (SMALL, 40),
            (
                CameraGeometry {
                    width_px: 1,
                    height_px: 1,
                },
                3,
            ),
            (
                CameraGeometry {
                    width_px: 1999,
                    height_px: 1011,
                },
                4,
            ),
        ] {
            let folder = tempfile::tempdir().unwrap();
            write_session(folder.path(), encoding, geometry, frames);
            let reader = SessionReader::open(folder.path()).unwrap();
            assert_eq!(read_a(&reader, geometry), (0..frames).collect::<Vec<_>>());
            assert_eq!(reader.frames(&camera("b")).unwrap().count() as u64, frames);
            assert_eq!(reader.damage(), []);
            assert_eq!(reader.rig_toml(), Some("[site]\nname = \"x\"\n"));
            assert_eq!(reader.calibration_json(), Some("{}"));
            let a = reader.cameras().next().unwrap();
            assert_eq!((a.frames, a.geometry), (Some(frames), Some(geometry)));
        }
    }
}

#[test]
fn a_new_file_begins_every_ten_seconds_of_stamps() {
    let folder = tempfile::tempdir().unwrap();
    let frames = 21_000_000_000 / PERIOD_NS as u64;
    let tiny = CameraGeometry {
        width_px: 4,
        height_px: 4,
    };
    write_session(folder.path(), PixelEncoding::Raw, tiny, frames);
    let mut names: Vec<_> = fs::read_dir(folder.path())
        .unwrap()
        .map(|e| e.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    let wanted = [
        "a.0000.mcap",
        "a.0001.mcap",
        "a.0002.mcap",
        "b.0000.mcap",
        "b.0001.mcap",
        "b.0002.mcap",
        "session.mcap",
    ];
    assert_eq!(names, wanted);
    let reader = SessionReader::open(folder.path()).unwrap();
    assert_eq!(read_a(&reader, tiny).len() as u64, frames);
    // A file that is gone is told, with the frames that were in it.
    fs::remove_file(folder.path().join("a.0001.mcap")).unwrap();
    let reader = SessionReader::open(folder.path()).unwrap();
    let [damage] = &reader.damage()[..] else {
        panic!("{:?}", reader.damage())
    };
    assert_eq!(damage.reason, "is missing");
    let left = read_a(&reader, tiny).len() as u64;
    assert_eq!(damage.frames_lost, LostFrames::Exactly(frames - left));
}

#[test]
fn truncation_at_any_byte_keeps_the_frames_before_it() {
    let folder = tempfile::tempdir().unwrap();
    write_session(folder.path(), PixelEncoding::Raw, SMALL, 12);
    let file = file_of(folder.path(), "a.0000.mcap");
    let whole = fs::read(&file).unwrap();
    let frame_bytes = whole.len() / 13;
    let mut tried = 0;
    for cut in (0..whole.len()).step_by(97).chain(whole.len() - 200..whole.len()) {
        fs::write(&file, &whole[..cut]).unwrap();
        let reader = SessionReader::open(folder.path()).unwrap();
        let read = read_a(&reader, SMALL);
        // Twelve frames of 3.3 kB, after a head of some kB with schemas and the rig.
        assert!(
            read.len() + 4 >= cut / frame_bytes,
            "cut {cut}: {} frames",
            read.len()
        );
        assert_eq!(read, (0..read.len() as u64).collect::<Vec<_>>());
        let damage = reader.damage();
        let [damage] = &damage[..] else {
            panic!("cut {cut}: {damage:?}")
        };
        assert_eq!(
            damage.frames_lost,
            LostFrames::Exactly(12 - read.len() as u64),
            "cut {cut}"
        );
        assert_eq!(damage.frames_read, read.len() as u64);
        tried += 1;
    }
    assert!(tried > 500);
}

/// Flips bytes all over one file. Frames that come back are right; what is lost is told.
fn flip_everywhere(encoding: PixelEncoding, name: &str, step: usize) {
    let folder = tempfile::tempdir().unwrap();
    write_session(folder.path(), encoding, SMALL, 12);
    let file = file_of(folder.path(), name);
    let whole = fs::read(&file).unwrap();
    let (mut tried, mut unseen) = (0, Vec::new());
    for place in (0..whole.len()).step_by(step) {
        let mut flipped = whole.clone();
        flipped[place] ^= 1 << (place % 8);
        fs::write(&file, &flipped).unwrap();
        let reader = SessionReader::open(folder.path()).unwrap();
        let read = read_a(&reader, SMALL);
        let lost: u64 = reader.damage().iter().map(|d| d.frames_lost.count()).sum();
        assert_eq!(
            read.len() as u64 + lost,
            12,
            "byte {place}: {:?}",
            reader.damage()
        );
        assert!(
            lost <= 1,
            "byte {place}: one flip cost {lost} frames: {:?}",
            reader.damage()
        );
        if reader.damage().is_empty() {
            unseen.push(place);
        }
        tried += 1;
    }
    println!(
        "{name}: {tried} flips, {} without effect: {unseen:?}",
        unseen.len()
    );
    assert!(
        unseen.len() * 20 < tried,
        "{} of {tried} flips went unseen",
        unseen.len()
    );
}

#[test]
fn a_flipped_byte_costs_one_frame_and_is_told() {
    flip_everywhere(PixelEncoding::Raw, "a.0000.mcap", 37);
    flip_everywhere(PixelEncoding::Png, "a.0000.mcap", 41);
}

#[test]
fn a_flipped_byte_in_the_session_file_costs_nothing() {
    flip_everywhere(PixelEncoding::Raw, "session.mcap", 1);
}

/// Breaks a file in several ways at once. Frames that come back must still be right.
fn break_file(whole: &[u8], flips: &[(usize, u8)], cut: usize, hole: (usize, usize)) -> Vec<u8> {
    let mut bytes = whole.to_vec();
    for (place, mask) in flips {
        let count = bytes.len();
        bytes[place % count] ^= mask;
    }
    let (begin, length) = (hole.0 % bytes.len(), hole.1);
    let end = (begin + length).min(bytes.len());
    bytes.drain(begin..end);
    bytes.truncate(cut.min(bytes.len()));
    bytes
}

#[test]
fn no_breakage_gives_a_wrong_frame_or_a_panic() {
    use proptest::prelude::*;
    use proptest::test_runner::{Config, TestRunner};
    for encoding in [PixelEncoding::Raw, PixelEncoding::Png] {
        let folder = tempfile::tempdir().unwrap();
        write_session(folder.path(), encoding, SMALL, 6);
        let file = file_of(folder.path(), "a.0000.mcap");
        let session = file_of(folder.path(), "session.mcap");
        let (whole, session_whole) = (fs::read(&file).unwrap(), fs::read(&session).unwrap());
        let flips = proptest::collection::vec((any::<usize>(), 1..=255u8), 0..12);
        let cut = prop_oneof![Just(usize::MAX), 0..whole.len()];
        let hole = (any::<usize>(), prop_oneof![Just(0usize), 1..5000usize]);
        let mut runner = TestRunner::new(Config {
            cases: 400,
            failure_persistence: None,
            ..Default::default()
        });
        let strategy = (flips, cut, hole, any::<bool>());
        runner
            .run(&strategy, |(flips, cut, hole, session_too)| {
                fs::write(&file, break_file(&whole, &flips, cut, hole)).unwrap();
                let broken = break_file(&session_whole, &flips, cut, hole);
                fs::write(
                    &session,
                    if session_too {
                        broken
                    } else {
                        session_whole.clone()
                    },
                )
                .unwrap();
                let reader = SessionReader::open(folder.path()).unwrap();
                let read = read_a(&reader, SMALL);
                let lost: u64 = reader
                    .damage()
                    .iter()
                    .filter(|d| d.camera == Some(camera("a")))
                    .map(|d| d.frames_lost.count())
                    .sum();
                prop_assert!(read.len() as u64 + lost <= 6);
                if !session_too {
                    prop_assert_eq!(read.len() as u64 + lost, 6, "{:?}", reader.damage());
                }
                Ok(())
            })
            .unwrap();
    }
}

/// What a killed recorder leaves: files without an end.
fn write_killed(folder: &Path, frames: u64) {
    let options = SessionOptions {
        rig_toml: "r".to_owned(),
        ..Default::default()
    };
    let mut session = SessionWriter::create(folder, options).unwrap();
    let mut writer = session.camera(&camera("a"), SMALL).unwrap();
    for number in 0..frames {
        writer.write(&frame(1, number, SMALL)).unwrap();
    }
    // No destructor runs in a killed program.
    std::mem::forget(writer);
    std::mem::forget(session);
    // The disk threads write what they were handed.
    std::thread::sleep(std::time::Duration::from_millis(300));
}

#[test]
fn a_killed_recording_is_read_and_repaired() {
    let folder = tempfile::tempdir().unwrap();
    let frames = 12_000_000_000 / PERIOD_NS as u64;
    write_killed(folder.path(), frames);
    assert!(folder.path().join("a.0001.mcap.part").exists());
    let reader = SessionReader::open(folder.path()).unwrap();
    let read = read_a(&reader, SMALL).len() as u64;
    let second = 1_000_000_000 / PERIOD_NS as u64;
    // A flush every second of stamps, and up to one block of the direct writes stays behind.
    assert!(read + second + 3 >= frames, "{read} of {frames}");
    let damage = reader.damage();
    assert!(
        damage.iter().any(|d| d.reason.contains("was not finished")),
        "{damage:?}"
    );
    let repaired = repair_session(folder.path()).unwrap();
    assert!(!repaired.is_empty());
    assert!(!folder.path().join("a.0001.mcap.part").exists());
    // Only the end was missing, so nothing is worth keeping.
    assert!(repaired.iter().all(|r| r.kept.is_none()), "{repaired:?}");
    let reader = SessionReader::open(folder.path()).unwrap();
    assert_eq!(read_a(&reader, SMALL).len() as u64, read);
    assert_eq!(reader.damage(), []);
    assert_eq!(reader.rig_toml(), Some("r"));
    assert_eq!(repair_session(folder.path()).unwrap(), []);
}

#[test]
fn a_repaired_file_has_all_good_frames_and_the_old_one_is_kept() {
    for encoding in [PixelEncoding::Raw, PixelEncoding::Png] {
        let folder = tempfile::tempdir().unwrap();
        write_session(folder.path(), encoding, SMALL, 10);
        let file = file_of(folder.path(), "a.0000.mcap");
        let mut bytes = fs::read(&file).unwrap();
        let middle = bytes.len() / 2;
        bytes[middle] ^= 0x10;
        fs::write(&file, &bytes).unwrap();
        let repaired = repair_session(folder.path()).unwrap();
        assert_eq!(repaired.len(), 1, "{repaired:?}");
        assert_eq!(repaired[0].damage.frames_lost, LostFrames::Exactly(1));
        assert_eq!(
            fs::read(folder.path().join("a.0000.mcap.damaged")).unwrap(),
            bytes
        );
        let reader = SessionReader::open(folder.path()).unwrap();
        assert_eq!(read_a(&reader, SMALL).len(), 9);
        assert_eq!(reader.damage(), []);
        assert_eq!(reader.losses().len(), 1, "{:?}", reader.losses());
        assert!(reader.losses()[0].contains("a.0000.mcap"));
    }
}

#[test]
fn folders_that_are_no_session_say_so() {
    let folder = tempfile::tempdir().unwrap();
    let told = |path: &Path| SessionReader::open(path).unwrap_err().to_string();
    assert!(told(folder.path()).ends_with("is empty, not a session"));
    assert!(told(&folder.path().join("nowhere")).ends_with("nowhere: there is no such folder"));
    let file = folder.path().join("notes.txt");
    fs::write(&file, "x").unwrap();
    assert!(told(&file).ends_with("is a file; a session is a folder"));
    assert!(told(folder.path()).ends_with("is not a session: it holds no *.mcap file"));
    let error = SessionWriter::create(folder.path(), SessionOptions::default())
        .err()
        .unwrap();
    assert!(error.to_string().ends_with("exists and is not empty"), "{error}");
}

#[test]
fn frames_of_the_wrong_size_or_order_are_refused_and_the_rest_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let mut session = SessionWriter::create(folder.path(), SessionOptions::default()).unwrap();
    let mut writer = session.camera(&camera("a"), SMALL).unwrap();
    assert!(session.camera(&camera("a"), SMALL).is_err());
    writer.write(&frame(1, 0, SMALL)).unwrap();
    let tall = CameraGeometry {
        width_px: 64,
        height_px: 50,
    };
    let error = writer.write(&frame(1, 1, tall)).unwrap_err();
    assert_eq!(
        error.to_string(),
        "camera a, frame 1: is 64x50 pixels, expected 64x48"
    );
    let mut short = frame(1, 1, SMALL);
    short.frame.pixels = std::sync::Arc::new(vec![0; 100]);
    let error = writer.write(&short).unwrap_err();
    assert_eq!(
        error.to_string(),
        "camera a, frame 1: has 100 bytes of pixels, 64x48 need 3072"
    );
    let error = writer.write(&frame(1, 0, SMALL)).unwrap_err();
    assert!(error.to_string().contains("frame 0 (stamp"), "{error}");
    writer.write(&frame(1, 2, SMALL)).unwrap();
    writer.finish().unwrap();
    session.finish().unwrap();
    let reader = SessionReader::open(folder.path()).unwrap();
    assert_eq!(read_a(&reader, SMALL), [0, 2]);
    assert_eq!(reader.damage(), []);
}

#[test]
fn the_mcap_crate_reads_the_files_too() {
    use mcap::MessageStream;
    let folder = tempfile::tempdir().unwrap();
    write_session(folder.path(), PixelEncoding::Raw, SMALL, 5);
    let bytes = fs::read(folder.path().join("a.0000.mcap")).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    assert_eq!(summary.stats.unwrap().message_count, 10);
    let topics: Vec<String> = MessageStream::new(&bytes)
        .unwrap()
        .map(|m| {
            let channel = m.unwrap().channel;
            format!("{} {}", channel.topic, channel.schema.as_ref().unwrap().name)
        })
        .collect();
    assert_eq!(
        topics[..2],
        ["/a/frame_info pitchd.FrameInfo", "/a/image foxglove.RawImage"]
    );
}
