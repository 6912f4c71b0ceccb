//! Light and mount that change: thresholds follow within a second, candidates stay bounded, the ball is found.

use std::collections::BTreeMap;

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::painter::{Ball, Canvas};
use super::{Answers, Detector, DetectorConfig, DetectorCounters};
use crate::scene::{Detection, Frame, FrameStamp};

const WIDTH: usize = 320;
const HEIGHT: usize = 160;
const RATE_HZ: f64 = 175.0;
/// Frames of a second.
const SECOND: u64 = 175;

#[derive(Default)]
struct ByFrame(BTreeMap<u64, Vec<Detection>>);

impl Answers for ByFrame {
    fn answer(&mut self, stamp: FrameStamp, detections: &[Detection]) {
        self.0.insert(stamp.frame, detections.to_vec());
    }
}

/// A ball that crosses the picture again and again.
fn ball(number: u64) -> Ball {
    Ball {
        centre: [15.0 + (11.3 * number as f64) % 290.0, 70.0],
        streak: [2.0, 0.0],
        radius: 3.1,
        light: 215.0,
        shade: 100.0,
        to_light: [0.2, -1.0, -0.3],
    }
}

/// Searches frames 0..count; `picture` changes what is behind the ball, `gain` the light of a column.
fn search(
    count: u64,
    picture: impl Fn(u64, &Canvas) -> Canvas,
    gain: impl Fn(u64, usize) -> f32,
) -> (ByFrame, DetectorCounters) {
    search_for(ball, count, picture, gain)
}

fn search_for(
    ball: impl Fn(u64) -> Ball,
    count: u64,
    picture: impl Fn(u64, &Canvas) -> Canvas,
    gain: impl Fn(u64, usize) -> f32,
) -> (ByFrame, DetectorCounters) {
    let stand = Canvas::stand(WIDTH + 100, HEIGHT, 9, 20.0);
    let mut detector = Detector::new(DetectorConfig::default(), WIDTH as u32, HEIGHT as u32);
    let mut found = ByFrame::default();
    for number in 0..count {
        let mut canvas = picture(number, &stand);
        canvas.ball(&ball(number));
        for (i, level) in canvas.light.iter_mut().enumerate() {
            *level *= gain(number, i % WIDTH);
        }
        let frame = canvas.frame(number, RATE_HZ, 1.2);
        detector.detect(&frame, &mut found).unwrap();
    }
    detector.flush(&mut found);
    let most = DetectorConfig::default().candidates_max;
    assert!(found.0.values().all(|all| all.len() <= most));
    (found, detector.counters())
}

/// The left part of the stand.
fn still(_: u64, stand: &Canvas) -> Canvas {
    moved(stand, 0.0)
}

fn moved(stand: &Canvas, shift_px: f64) -> Canvas {
    let mut canvas = Canvas {
        width: WIDTH,
        height: HEIGHT,
        light: vec![60.0; WIDTH * HEIGHT],
    };
    canvas.paste(stand, -shift_px, 0.0);
    canvas
}

/// Share of these frames with the ball among the candidates, and the mean number of other candidates.
fn score(found: &ByFrame, frames: std::ops::Range<u64>) -> (f64, f64) {
    score_of((found, ball), frames)
}

fn score_of((found, ball): (&ByFrame, impl Fn(u64) -> Ball), frames: std::ops::Range<u64>) -> (f64, f64) {
    let (mut hits, mut others) = (0.0, 0.0);
    let count = (frames.end - frames.start) as f64;
    for number in frames {
        let [x, y] = ball(number).centre;
        let all = found.0.get(&number).map_or(&[][..], |all| all);
        let near = |d: &&Detection| (d.centre.x - x).hypot(d.centre.y - y) < 3.0;
        let of_ball = all.iter().filter(near).count();
        hits += f64::from(u8::from(of_ball > 0));
        others += (all.len() - of_ball) as f64;
    }
    (hits / count, others / count)
}

fn assert_followed(name: &str, found: &ByFrame, frames: std::ops::Range<u64>) {
    assert_followed_along(name, (found, ball), frames);
}

fn assert_followed_along(name: &str, found: (&ByFrame, impl Fn(u64) -> Ball), frames: std::ops::Range<u64>) {
    let (recall, others) = score_of(found, frames);
    println!("{name}: recall {recall:.3}, {others:.2} other candidates a frame");
    assert!(recall > 0.97, "{name}: recall {recall}");
    assert!(others < 1.0, "{name}: {others} other candidates a frame");
}

#[test]
fn lamps_that_flicker_are_followed_within_a_second() {
    // 120 Hz at 175 Hz, two phases across the picture.
    let flicker = |number: u64, x: usize| {
        let turn = std::f64::consts::TAU * 120.0 * number as f64 / RATE_HZ + 2.0 * x as f64 / WIDTH as f64;
        1.0 + 0.06 * turn.sin() as f32
    };
    let (found, _) = search(2 * SECOND, still, flicker);
    assert_followed("flicker", &found, SECOND..2 * SECOND - 6);
}

/// The same in less light.
fn dim_ball(number: u64) -> Ball {
    Ball {
        light: 105.0,
        shade: 85.0,
        ..ball(number)
    }
}

/// A bright stand, and before a dark wall in its middle the ball: a region has both.
fn wall_in_a_stand(_: u64, stand: &Canvas) -> Canvas {
    let mut canvas = moved(stand, 0.0);
    for (i, level) in canvas.light.iter_mut().enumerate() {
        *level = if (60..80).contains(&(i / WIDTH)) {
            50.0
        } else {
            2.0 * *level
        };
    }
    canvas
}

#[test]
fn a_ball_as_dim_as_the_stand_is_found_while_lamps_flicker() {
    let wave = |number: u64, phase: f64| {
        let turn = std::f64::consts::TAU * 120.0 * number as f64 / RATE_HZ + phase;
        1.0 + 0.1 * turn.sin() as f32
    };
    let (found, _) = search_for(dim_ball, 2 * SECOND, wall_in_a_stand, |number, _| {
        wave(number, 0.0)
    });
    assert_followed("before a wall", &found, SECOND..2 * SECOND - 6);
    // The border of what they light is that of a cell: light is even within one.
    let two = |number: u64, x: usize| wave(number, if x < 128 { 0.0 } else { 2.0 });
    let (found, _) = search_for(dim_ball, 2 * SECOND, wall_in_a_stand, two);
    assert_followed("two lamps", &found, SECOND..2 * SECOND - 6);
    // Before the bright stand itself, a ball darker than it.
    let stand = |number: u64, stand: &Canvas| {
        let mut canvas = still(number, stand);
        canvas.light.iter_mut().for_each(|level| *level *= 2.0);
        canvas
    };
    let (found, _) = search_for(dim_ball, 2 * SECOND, stand, |number, _| wave(number, 0.0));
    assert_followed("before a bright stand", &found, SECOND..2 * SECOND - 6);
}

#[test]
fn a_dim_ball_is_found_where_two_lamps_meet_in_a_cell() {
    // A bright board above the dark ground, at row 72 of the cell of rows 64 to 95: one is brightest when the other is darkest.
    let board = |number: u64, stand: &Canvas| {
        let mut canvas = moved(stand, 0.0);
        let turn = std::f64::consts::TAU * 120.0 * number as f64 / RATE_HZ;
        let rise = 0.1 * turn.sin() as f32;
        for (i, level) in canvas.light.iter_mut().enumerate() {
            *level = match i / WIDTH {
                ..72 => (100.0 + *level) * (1.0 - rise),
                _ => (40.0 + 0.1 * *level) * (1.0 + rise),
            };
        }
        canvas
    };
    // Along the border, its top before the board, in the two whole cells of a row.
    let along = |number: u64| Ball {
        centre: [15.0 + (11.3 * number as f64) % 230.0, 74.0],
        ..dim_ball(number)
    };
    let (found, _) = search_for(along, 2 * SECOND, board, |_, _| 1.0);
    assert_followed_along("two lamps in a cell", (&found, along), SECOND..2 * SECOND - 6);
}

#[test]
fn lamps_that_switch_and_a_new_exposure_pass() {
    let lamp = |number: u64, x: usize| {
        if (60..120).contains(&number) && x < WIDTH / 2 {
            0.6
        } else {
            1.0
        }
    };
    let (found, _) = search(120 + SECOND, still, lamp);
    assert_followed("lamp off, lamp on", &found, 135..120 + SECOND - 6);
    let step = |number: u64, _: usize| if number < 60 { 0.7 } else { 1.0 };
    let (found, _) = search(60 + SECOND, still, step);
    assert_followed("exposure step", &found, 75..60 + SECOND - 6);
}

#[test]
fn a_slow_pan_and_a_shaking_mount_are_bounded_and_pass() {
    let pan = |number: u64, stand: &Canvas| moved(stand, 0.4 * (number.clamp(40, 160) - 40) as f64);
    let (found, counters) = search(160 + 2 * SECOND, pan, |_, _| 1.0);
    println!("pan: {counters:?}");
    assert_followed("after a pan", &found, 160 + SECOND..160 + 2 * SECOND - 6);
    let shake = |number: u64, stand: &Canvas| {
        moved(
            stand,
            5.0 + 0.4 * (std::f64::consts::TAU * 13.0 * number as f64 / RATE_HZ).sin(),
        )
    };
    let (found, counters) = search(2 * SECOND, shake, |_, _| 1.0);
    let (recall, others) = score(&found, SECOND..2 * SECOND - 6);
    println!("shaking: recall {recall:.3}, {others:.2} other candidates a frame, {counters:?}");
    assert!(recall > 0.9, "shaking: recall {recall}");
}

#[test]
fn cuts_noise_and_nonsense_are_bounded() {
    let mut random = Pcg64Mcg::seed_from_u64(4);
    let mut detector = Detector::new(DetectorConfig::default(), WIDTH as u32, HEIGHT as u32);
    let mut found = ByFrame::default();
    for number in 0..120u64 {
        let mut frame: Frame = Canvas::stand(WIDTH, HEIGHT, number / 20, 40.0).frame(number, RATE_HZ, 1.0);
        if number % 20 > 14 {
            let noise: Vec<u8> = (0..WIDTH * HEIGHT).map(|_| random.random()).collect();
            frame.pixels = std::sync::Arc::new(noise);
        }
        detector.detect(&frame, &mut found).unwrap();
    }
    detector.flush(&mut found);
    let counters = detector.counters();
    println!("{counters:?}");
    assert!(counters.global_changes > 0, "{counters:?}");
    let most = DetectorConfig::default().candidates_max;
    assert!(found.0.values().all(|all| all.len() <= most));
}
