//! The tracker's own tests.

use super::*;
use crate::time::StampedMidpoint;

/// A frame's stamp, and detections of it by place and strength.
fn detecting(number: u64) -> (FrameStamp, impl Fn(f64, f64, f64) -> Detection) {
    let stamp = FrameStamp {
        frame: number,
        device: None,
        arrival: None,
        stamped: StampedMidpoint::from_seconds_since(0, number as f64 / 175.0),
    };
    let spot = move |x: f64, y: f64, strength: f64| Detection {
        frame: number,
        stamped: stamp.stamped,
        centre: Pixel::new(x, y),
        covariance_px2: nalgebra::Matrix2::identity() * 0.2,
        radius_px: 3.0,
        streak_px: [0.0; 2],
        strength,
    };
    (stamp, spot)
}

/// One frame: an arm as a row of spots that all go on the same way, and a ball.
fn frame(number: u64) -> (FrameStamp, Vec<Detection>) {
    let (stamp, spot) = detecting(number);
    let t = number as f64;
    let arm = (0..20).map(|i| {
        spot(
            700.0 - 9.0 * t + 2.5 * f64::from(i),
            300.0 + 1.5 * f64::from(i),
            90.0,
        )
    });
    let ball = spot(1500.0 - 16.0 * t, 500.0 + 0.02 * t * t, 20.0);
    (stamp, arm.chain([ball]).collect())
}

#[test]
fn no_beginning_takes_all_places() {
    let mut tracker = Tracker::new(CameraId::new("a").unwrap(), TrackerConfig::default());
    for number in 0..60 {
        let (stamp, detections) = frame(number);
        tracker.push(stamp, &detections);
        assert!(tracker.alive.len() <= tracker.config.hypotheses_max);
        for hypothesis in &tracker.alive {
            assert!(family(tracker.alive.iter(), hypothesis) <= FAMILY_MAX);
        }
    }
    assert!(tracker.counters().hypotheses_dropped > 0, "the arm was too small");
    let balls = tracker.finish();
    let of_ball = balls
        .iter()
        .filter(|b| (b.track.points.first().unwrap().pixel.y - 500.0).abs() < 1.0);
    let counts: Vec<usize> = of_ball.map(|b| b.track.points.len()).collect();
    assert!(
        counts.len() == 1 && counts[0] >= 55,
        "{counts:?} points of the ball"
    );
}

#[test]
fn what_has_long_been_followed_leaves_a_place_for_a_ball() {
    let mut tracker = Tracker::new(CameraId::new("a").unwrap(), TrackerConfig::default());
    for number in 0..150 {
        let (stamp, spot) = detecting(number);
        let t = number as f64;
        // Birds: three spots each that are taken for each other.
        let spots = (0..45).map(|i| {
            let (bird, beat) = (i / 3, 2.0 * (1.7 * t * f64::from(i % 3 + 1) + f64::from(i)).sin());
            let (left, top) = (f64::from(bird * 397 % 1600), f64::from(bird * 211 % 660));
            spot(left + 2.0 * t + beat, top + 4.0 * f64::from(i % 3) - beat, 90.0)
        });
        let mut detections: Vec<Detection> = spots.collect();
        if number >= 90 {
            let t = t - 90.0;
            detections.push(spot(1700.0 - 16.0 * t, 700.0 + 0.02 * t * t, 20.0));
        }
        tracker.push(stamp, &detections);
        assert!(tracker.alive.len() <= tracker.config.hypotheses_max);
        let scores = tracker.alive.iter().map(|h| h.score);
        assert!(scores.is_sorted_by(|a, b| a >= b));
    }
    assert!(tracker.counters().hypotheses_dropped > 1000, "too few birds");
    let balls = tracker.finish();
    let pitches = balls.iter().filter(|b| b.kind == TrackKind::Pitch);
    let counts: Vec<usize> = pitches.map(|b| b.track.points.len()).collect();
    assert!(counts.len() == 1 && counts[0] >= 55, "{counts:?}");
}

#[test]
fn a_ball_that_another_path_still_sees_is_not_given_out() {
    let mut tracker = Tracker::new(CameraId::new("a").unwrap(), TrackerConfig::default());
    // A path that ended is followed on to the newest frame, where another path is that goes on.
    let mut points: Vec<Point> = Vec::new();
    for number in 0..40 {
        let (stamp, detections) = frame(number);
        let ball = detections.last().copied().unwrap();
        points.push(Point {
            detection: ball,
            t: number as f64,
            index: 0,
        });
        tracker.push(stamp, &[ball]);
    }
    let ended = Hypothesis::new(points.clone());
    let (points, ball) = conclude(&tracker.config, &tracker.camera, &ended, &tracker.history).unwrap();
    tracker.pending.push((points, ball));
    tracker.release();
    assert_eq!((tracker.pending.len(), tracker.drain().len()), (1, 0));
    // No path comes from there any more.
    tracker.alive.clear();
    tracker.release();
    assert_eq!((tracker.pending.len(), tracker.drain().len()), (0, 1));
}

/// A ball goes on to frame 59. A hypothesis of it ended with frame 24, and another has come through that end since frame 15.
#[test]
fn a_ball_is_held_back_as_long_as_a_path_goes_on_through_its_end() {
    let config = TrackerConfig::default();
    let ball_at = |number: u64| Point {
        detection: frame(number).1.last().copied().unwrap(),
        t: number as f64,
        index: 0,
    };
    let ball: Vec<Point> = (0..60).map(ball_at).collect();
    // Whether the ball to frame 24 waits while this path lives, 20 frames later; then what is given out once it has ended.
    let given_out = |rest: Vec<Point>| {
        let mut tracker = Tracker::new(CameraId::new("a").unwrap(), config.clone());
        for point in &ball {
            let (stamp, _) = detecting(point.detection.frame);
            tracker.push(stamp, &[point.detection]);
        }
        tracker.alive = vec![Hypothesis::new(rest)];
        tracker.alive[0].score = 50.0;
        let begun = Hypothesis::new(ball[..25].to_vec());
        let (_, begin) = conclude(&config, &tracker.camera, &begun, &VecDeque::new()).unwrap();
        tracker.recent.push(ball[..25].to_vec());
        tracker.pending.push((ball[..25].to_vec(), begin));
        tracker.release();
        let waits = tracker.pending.len();
        let last = tracker.alive.remove(0);
        tracker.end(last);
        tracker.release();
        let counts: Vec<usize> = tracker.drain().iter().map(|b| b.track.points.len()).collect();
        (waits, counts)
    };
    let (waits, counts) = given_out(ball[15..].to_vec());
    assert_eq!((waits, counts.len()), (1, 1));
    assert!(counts[0] >= 58, "{counts:?}");
    // Into the glove, and down with it.
    let glove = ball[15..].iter().map(|point| {
        let mut point = *point;
        let since = (point.t - 24.0).max(0.0);
        point.detection.centre.x += 16.0 * since;
        point.detection.centre.y += 3.0 * since;
        point
    });
    let (waits, _) = given_out(glove.collect());
    assert_eq!(waits, 0);
}
