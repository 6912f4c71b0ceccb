//! The frames' distance in time changes while frames go on: every frame is answered once and in order, and as if it had
//! always been so.

use std::collections::BTreeMap;

use proptest::prelude::*;

use super::painter::{Ball, Canvas};
use super::{Answers, Detector, DetectorConfig};
use crate::scene::{CameraId, Detection, Frame, FrameStamp, Track, TrackPoint};

const WIDTH: usize = 224;
const HEIGHT: usize = 64;
const RATE_HZ: f64 = 175.0;

#[derive(Default)]
struct InOrder {
    frames: Vec<u64>,
    found: BTreeMap<u64, Vec<Detection>>,
}

impl Answers for InOrder {
    fn answer(&mut self, stamp: FrameStamp, detections: &[Detection]) {
        self.frames.push(stamp.frame);
        self.found.insert(stamp.frame, detections.to_vec());
    }
}

/// A ball on its way across the picture.
fn ball(frames: u64) -> Ball {
    Ball {
        centre: [8.0 + 10.7 * frames as f64, 30.0],
        streak: [2.0, 0.0],
        radius: 3.1,
        light: 215.0,
        shade: 100.0,
        to_light: [0.2, -1.0, -0.3],
    }
}

/// Balls cross the picture, each for 20 frames of 40.
fn frames(count: u64) -> impl Iterator<Item = Frame> {
    let stand = Canvas::stand(WIDTH, HEIGHT, 5, 20.0);
    (0..count).map(move |number| {
        let mut canvas = stand.clone();
        if number % 40 >= 20 {
            canvas.ball(&ball(number % 40 - 20));
        }
        canvas.frame(number, RATE_HZ, 1.2)
    })
}

fn detector(lag_frames: usize) -> Detector {
    let config = DetectorConfig {
        lag_frames,
        ..DetectorConfig::default()
    };
    Detector::new(config, WIDTH as u32, HEIGHT as u32)
}

/// Asks for this lag.
fn ask(detector: &mut Detector, lag_frames: usize) {
    detector.adapt_lag(1.0, lag_frames as f64 - 3.0);
}

#[test]
fn the_lag_changes_in_a_stream_without_a_pause() {
    for (before, after) in [(6, 2), (2, 9), (1, 10), (10, 1)] {
        let (mut changed, mut always) = (detector(before), detector(after));
        let (mut answers, mut expected) = (InOrder::default(), InOrder::default());
        for frame in frames(120) {
            let number = frame.stamp.frame;
            if number == 30 {
                ask(&mut changed, after);
            }
            changed.detect(&frame, &mut answers).unwrap();
            always.detect(&frame, &mut expected).unwrap();
            // In frame 30 a ball is in the picture; its last one is 39, and the answer to frame 40 is quiet.
            let lag = if number < 40 + before as u64 {
                before
            } else {
                after
            };
            assert_eq!(changed.lag_frames(), lag, "{before} to {after}, frame {number}");
            if number >= 60 {
                assert_eq!(answers.frames.last(), Some(&(number - after as u64)), "{number}");
            }
        }
        let ball = |found: &Vec<Detection>| !found.is_empty();
        assert_eq!(
            answers.found.values().filter(|found| ball(found)).count(),
            60 - after
        );
        for (number, found) in answers.found.range(41..) {
            assert_eq!(
                Some(found),
                expected.found.get(number),
                "{before} to {after}, frame {number}"
            );
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn every_frame_is_answered_once_and_in_order(
        asked in prop::collection::vec((0_u64..100, 1_usize..=12), 0..12),
        first in 1_usize..=10,
        flush_at in 20_u64..100,
    ) {
        let mut detector = detector(first);
        let mut answers = InOrder::default();
        for frame in frames(100) {
            let number = frame.stamp.frame;
            for (_, lag) in asked.iter().filter(|(at, _)| *at == number) {
                ask(&mut detector, *lag);
            }
            if number == flush_at {
                detector.flush(&mut answers);
            }
            detector.detect(&frame, &mut answers).unwrap();
        }
        detector.flush(&mut answers);
        // The last window is too short to compare with itself, and says so.
        let unanswered = detector.counters().unanswered;
        prop_assert!(unanswered <= if flush_at > 97 { 2 } else { 0 }, "{unanswered} frames are not answered");
        let all: Vec<u64> = (0..100 - unanswered).collect();
        prop_assert_eq!(answers.frames, all);
    }
}

/// A track of one point.
fn track_of(seen: &Detection) -> Track {
    Track {
        camera: CameraId::new("a").unwrap(),
        track: 0,
        points: vec![TrackPoint {
            frame: seen.frame,
            stamped: seen.stamped,
            pixel: seen.centre,
            covariance_px2: None,
        }],
    }
}

#[test]
fn where_lamps_flicker_a_ball_is_kept_with_frames_of_like_light() {
    let mismatch = |flicker: f64| {
        let stand = Canvas::stand(WIDTH, HEIGHT, 5, 20.0);
        let (mut detector, mut found) = (detector(1), InOrder::default());
        let mut came = Vec::new();
        for number in 0..120 {
            let turn = std::f64::consts::TAU * 120.0 * number as f64 / RATE_HZ;
            let mut canvas = stand.clone();
            if number >= 100 {
                canvas.ball(&ball(number - 100));
            }
            for (i, level) in canvas.light.iter_mut().enumerate() {
                // A board, and the stand beside it, which is darkest when the board is brightest.
                let sign = if i % WIDTH < WIDTH / 4 { -1.0 } else { 1.0 };
                *level *= (1.0 + sign * flicker * turn.sin()) as f32;
            }
            let frame = canvas.frame(number, RATE_HZ, 1.2);
            detector.detect(&frame, &mut found).unwrap();
            came.push(frame);
        }
        let off = |(frame, all): (&u64, &Vec<Detection>)| {
            let [x, y] = ball(frame.checked_sub(100)?).centre;
            let near = |d: &&Detection| (d.centre.x - x).hypot(d.centre.y - y) < 2.0;
            let seen = all.iter().find(near)?;
            let cut_outs = detector.point_cut_outs(&track_of(seen));
            let patch = cut_outs.find(seen.stamped, seen.centre)?;
            // As the frame came.
            let row = patch.top * WIDTH + patch.left;
            let bytes = &came[*frame as usize].bytes()[row..row + patch.width];
            assert_eq!(&patch.current[..patch.width], bytes, "frame {frame}");
            // Three rows above the ball.
            let pairs = patch.current.iter().zip(patch.one).take(3 * patch.width);
            let sum: f64 = pairs.map(|(a, b)| f64::from(a.abs_diff(*b))).sum();
            Some(sum / (3 * patch.width) as f64)
        };
        let off: Vec<f64> = found.found.iter().filter_map(off).collect();
        assert!(off.len() > 10, "{} balls", off.len());
        off.iter().sum::<f64>() / off.len() as f64
    };
    // One frame is 0.69 periods of the lamps, three are 2.06: 8 % of 70 levels change by 2·5.6·sin(0.69π) = 9 levels and by 2 at
    // most, the mean over time being 2/π of that.
    let (still, flickering) = (mismatch(0.0), mismatch(0.08));
    println!("without flicker {still:.2} levels, with {flickering:.2}");
    assert!(still < 2.0 && flickering < still + 1.5, "{still} {flickering}");
}
