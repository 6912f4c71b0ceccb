//! The tracker's own tests.

use super::*;
use crate::time::StampedMidpoint;

/// One frame: an arm as a row of spots that all go on the same way, and a ball.
fn frame(number: u64) -> (FrameStamp, Vec<Detection>) {
    let stamp = FrameStamp {
        frame: number,
        device: None,
        arrival: None,
        stamped: StampedMidpoint::from_seconds_since(0, number as f64 / 175.0),
    };
    let t = number as f64;
    let spot = |x: f64, y: f64, strength: f64| Detection {
        frame: number,
        stamped: stamp.stamped,
        centre: Pixel::new(x, y),
        covariance_px2: nalgebra::Matrix2::identity() * 0.2,
        radius_px: 3.0,
        streak_px: [0.0; 2],
        strength,
    };
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
            assert!(family(&tracker.alive, hypothesis) <= FAMILY_MAX);
        }
    }
    assert!(tracker.counters().hypotheses_dropped > 0, "the arm was too small");
    let balls = tracker.finish();
    let ball = balls.iter().max_by_key(|b| b.track.points.len()).unwrap();
    let first = ball.track.points.first().unwrap();
    assert!(
        (first.pixel.y - 500.0).abs() < 1.0,
        "the longest path is at {:?}",
        first.pixel
    );
    assert!(
        ball.track.points.len() >= 55,
        "{} points of the ball",
        ball.track.points.len()
    );
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
