//! The frames' distance in time changes while frames go on: every frame is answered once and in order, and as if it had
//! always been so.

use std::collections::BTreeMap;

use proptest::prelude::*;

use super::painter::{Ball, Canvas};
use super::{Answers, Detector, DetectorConfig};
use crate::scene::{Detection, Frame, FrameStamp};

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

/// Balls cross the picture, each for 20 frames of 40.
fn frames(count: u64) -> impl Iterator<Item = Frame> {
    let stand = Canvas::stand(WIDTH, HEIGHT, 5, 20.0);
    (0..count).map(move |number| {
        let mut canvas = stand.clone();
        if number % 40 >= 20 {
            canvas.ball(&Ball {
                centre: [8.0 + 10.7 * (number % 40 - 20) as f64, 30.0],
                streak: [2.0, 0.0],
                radius: 3.1,
                light: 215.0,
                shade: 100.0,
                to_light: [0.2, -1.0, -0.3],
            });
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
