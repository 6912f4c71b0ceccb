//! The paper's peaks on frames whose peak is known, and what they do not see.

use std::sync::Arc;

use super::*;
use crate::detection::painter::{Ball, Canvas};

#[derive(Default)]
struct All(Vec<(u64, Vec<Detection>)>);

impl Answers for All {
    fn answer(&mut self, stamp: FrameStamp, detections: &[Detection]) {
        self.0.push((stamp.frame, detections.to_vec()));
    }
}

/// What is found in each frame; the first has no answer.
fn search(config: &DetectorConfig, frames: &[Frame]) -> Vec<(u64, Vec<Detection>)> {
    let mut found = All::default();
    let first = frames.first().unwrap();
    let mut detector = PeakDetector::new(config, first.width_px, first.height_px);
    for frame in frames {
        detector.detect(frame, &mut found).unwrap();
    }
    found.0
}

/// The places of the peaks.
fn places(found: &[(u64, Vec<Detection>)]) -> Vec<Option<(f64, f64)>> {
    let place = |found: &Vec<Detection>| found.first().map(|d| (d.centre.x, d.centre.y));
    found.iter().map(|(_, found)| place(found)).collect()
}

/// Frames at 175 Hz, level 60 but for the pixels given of each: column, row, level.
fn flat(width: usize, height: usize, pixels: &[&[(usize, usize, u8)]]) -> Vec<Frame> {
    let frame = |(number, given): (usize, &&[(usize, usize, u8)])| {
        let canvas = Canvas {
            width,
            height,
            light: vec![60.0; width * height],
        };
        let mut frame = canvas.frame(number as u64, 175.0, 0.0);
        let mut levels = frame.bytes().to_vec();
        for (x, y, level) in *given {
            levels[y * width + x] = *level;
        }
        frame.pixels = Arc::new(levels);
        frame
    };
    pixels.iter().enumerate().map(frame).collect()
}

#[test]
fn the_pixel_that_brightens_most_is_the_answer() {
    // A ball of nine pixels, its middle (21, 11), lit from above; it moves by (30, 1). What it leaves darkens by more
    // than it brightens anything.
    let ball = |x: usize, y: usize| {
        let lit = [(0, 0, 170), (1, 0, 210), (2, 0, 169), (0, 1, 120), (1, 1, 130)];
        let dark = [(2, 1, 119), (0, 2, 90), (1, 2, 91), (2, 2, 89)];
        let all = lit.into_iter().chain(dark);
        all.map(move |(dx, dy, level)| (x + dx, y + dy, level))
            .collect::<Vec<_>>()
    };
    let (one, two) = (ball(20, 10), ball(50, 11));
    for (width, height) in [(100, 40), (64, 16), (97, 33), (400, 300)] {
        let found = search(
            &DetectorConfig::default(),
            &flat(width, height, &[&[], &one, &two, &two, &[]]),
        );
        assert_eq!(found.len(), 4, "the first frame has none before it");
        let expected = [Some((21.0, 10.0)), Some((51.0, 11.0)), None, None];
        assert_eq!(places(&found), expected, "{width}x{height}");
        assert_eq!(found[1].0, 2);
    }
}

#[test]
fn of_equal_peaks_the_first_counts_and_noise_is_none() {
    let config = DetectorConfig::default();
    // In two tiles side by side and in two below each other.
    let equal = [(90, 12, 200), (33, 12, 200), (31, 13, 200), (2, 25, 200)];
    assert_eq!(
        places(&search(&config, &flat(128, 64, &[&[], &equal]))),
        [Some((33.0, 12.0))]
    );
    // The threshold is 5 σ of the noise assumed at the start, and one level: 16.
    for (level, expected) in [(76, None), (77, Some((7.0, 7.0)))] {
        assert_eq!(
            places(&search(&config, &flat(128, 64, &[&[], &[(7, 7, level)]]))),
            [expected]
        );
    }
}

#[test]
fn regions_and_masks_are_kept_to_the_pixel() {
    let rect = |x_px, y_px, width_px, height_px| PixelRect {
        x_px,
        y_px,
        width_px,
        height_px,
    };
    let spots = [(40, 20, 240), (41, 20, 230), (42, 20, 220), (90, 50, 210)];
    let frames = flat(128, 64, &[&[], &spots]);
    let with = |regions: Vec<PixelRect>, masks: Vec<PixelRect>| {
        let config = DetectorConfig {
            regions,
            masks,
            ..DetectorConfig::default()
        };
        places(&search(&config, &frames))[0]
    };
    assert_eq!(with(vec![], vec![]), Some((40.0, 20.0)));
    assert_eq!(with(vec![], vec![rect(40, 20, 1, 1)]), Some((41.0, 20.0)));
    assert_eq!(with(vec![], vec![rect(32, 16, 32, 8)]), Some((90.0, 50.0)));
    assert_eq!(with(vec![rect(42, 0, 86, 64)], vec![]), Some((42.0, 20.0)));
    assert_eq!(with(vec![rect(0, 40, 90, 24)], vec![]), None);
}

/// A ball that flies from left to right, in front of what `before` paints.
fn flight(before: impl Fn(u64, &mut Canvas)) -> (Vec<Frame>, Vec<[f64; 2]>) {
    let centre = |i: u64| [20.0 + 12.3 * i as f64, 60.0 + 0.37 * i as f64];
    let frame = |i: u64| {
        let mut canvas = Canvas::stand(320, 120, 5, 15.0);
        before(i, &mut canvas);
        canvas.ball(&Ball {
            centre: centre(i),
            streak: [2.1, 0.1],
            radius: 3.1,
            light: 215.0,
            shade: 90.0,
            to_light: [0.2, -1.0, -0.3],
        });
        canvas.frame(i, 175.0, 1.0)
    };
    ((0..24).map(frame).collect(), (0..24).map(centre).collect())
}

#[test]
fn the_peak_of_a_ball_lit_from_above_is_above_its_centre() {
    let (frames, centres) = flight(|_, _| {});
    let found = search(&DetectorConfig::default(), &frames);
    let off: Vec<[f64; 2]> = places(&found)
        .into_iter()
        .zip(centres.iter().skip(1))
        .map(|(place, centre)| {
            let (x, y) = place.unwrap();
            [x - centre[0], y - centre[1]]
        })
        .collect();
    assert_eq!(off.len(), 23);
    assert!(
        off.iter().all(|off| off[0].hypot(off[1]) < 4.5),
        "not on the ball: {off:?}"
    );
    let mean = |axis: usize| off.iter().map(|off| off[axis]).sum::<f64>() / off.len() as f64;
    println!("bias {:+.2} {:+.2} px", mean(0), mean(1));
    assert!((-2.6..-1.0).contains(&mean(1)), "{:+.2} px", mean(1));
    for (_, found) in &found {
        let sigma_px = found[0].covariance_px2.m22.sqrt();
        assert!(sigma_px > 1.0 && found[0].radius_px == 3.0, "{:?}", found[0]);
    }
}

#[test]
fn what_brightens_more_steals_the_peak() {
    let (frames, centres) = flight(|i, canvas| {
        // A white sleeve far from the ball, somewhere else in every frame.
        for y in 0..30 {
            for x in 280..300 {
                canvas.light[(y + 6 * (i as usize % 3)) * canvas.width + x] = 250.0;
            }
        }
    });
    let found = places(&search(&DetectorConfig::default(), &frames));
    let seen = found
        .iter()
        .zip(centres.iter().skip(1))
        .filter(|(place, centre)| place.is_some_and(|(x, y)| (x - centre[0]).hypot(y - centre[1]) < 5.0));
    assert_eq!(seen.count(), 0, "{found:?}");
}

#[test]
fn answers_do_not_depend_on_instructions_and_a_break_begins_anew() {
    let (mut frames, _) = flight(|_, _| {});
    for frame in frames.iter_mut().skip(12) {
        let stamped = frame.stamp.stamped.nanos() + 1_000_000_000;
        frame.stamp.stamped = crate::time::StampedMidpoint::from_nanos(stamped);
    }
    let run = |isa: Isa| {
        let mut found = All::default();
        let mut detector = PeakDetector::with_isa(&DetectorConfig::default(), 320, 120, isa);
        for frame in &frames {
            detector.detect(frame, &mut found).unwrap();
        }
        assert_eq!(
            (detector.counters().windows, detector.counters().unanswered),
            (2, 2)
        );
        let raw: Vec<RawFrame> = frames.iter().cloned().map(RawFrame::from).collect();
        detector.flush();
        let mut again = All::default();
        detector.detect_raw(&raw[0], &mut again).unwrap();
        assert!(again.0.is_empty());
        found.0
    };
    let portable = run(Isa::Portable);
    assert_eq!(portable.len(), 22);
    for isa in Isa::available() {
        assert_eq!(run(*isa), portable, "{isa:?}");
    }
    let small = Canvas::stand(64, 64, 1, 5.0).frame(0, 175.0, 0.0);
    let mut detector = PeakDetector::new(&DetectorConfig::default(), 320, 120);
    assert!(detector.detect(&small, &mut All::default()).is_err());
}
