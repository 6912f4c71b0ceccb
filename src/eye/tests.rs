//! The eye on painted pitches.

use nalgebra::Vector2;

use super::*;
use crate::detection::painter::{Ball, Canvas};
use crate::tracking::TrackKind;

fn flight(frame: f64) -> [f64; 2] {
    [
        20.0 + 9.0 * frame - 0.01 * frame * frame,
        90.0 + 0.6 * frame + 0.012 * frame * frame,
    ]
}

fn ball(frame: f64) -> Ball {
    Ball {
        centre: flight(frame),
        streak: [1.6, 0.15],
        radius: 2.6,
        light: 190.0,
        shade: 60.0,
        to_light: [0.2, -1.0, -0.4],
    }
}

/// The ball flies while a textured player walks at this place: the points of the one pitch found.
fn with_player(left_px: f64, top_px: f64) -> Vec<crate::scene::TrackPoint> {
    let stand = Canvas::stand(640, 240, 3, 40.0);
    let player = Canvas::stand(60, 150, 9, 60.0);
    let mut eye = CameraEye::new(CameraId::new("side").unwrap(), EyeConfig::default(), 640, 240);
    for number in 0..80u64 {
        let mut canvas = stand.clone();
        canvas.paste(&player, left_px + 1.3 * number as f64, top_px);
        if (10..75).contains(&number) {
            canvas.ball(&ball(number as f64 - 10.0));
        }
        eye.push(&canvas.frame(number, 175.0, 2.0)).unwrap();
    }
    eye.finish();
    let balls = eye.drain_balls();
    for b in &balls {
        let first = b.track.points[0];
        println!(
            "{:?} {:?} points {} from {:?}",
            b.kind,
            b.shape,
            b.track.points.len(),
            first.pixel
        );
    }
    let mut pitches = balls.into_iter().filter(|b| b.kind == TrackKind::Pitch);
    let pitch = pitches.next().unwrap();
    assert!(pitches.next().is_none());
    pitch.track.points
}

#[test]
fn a_pitch_above_a_walking_player_is_one_track_with_all_points() {
    let points = with_player(100.0, 175.0);
    let score = Score::of(&points, |frame| flight(frame as f64 - 10.0));
    println!("{score:?}");
    assert!(score.points >= 62, "{} of 65 points", score.points);
    assert!(score.worst_px < 0.4, "{score:?}");
}

#[test]
fn a_pitch_before_a_walking_player_is_one_track_with_all_points() {
    // Twelve balls are before the player, whose blocks are brighter than the ball's dark side.
    let points = with_player(280.0, 60.0);
    let score = Score::of(&points, |frame| flight(frame as f64 - 10.0));
    println!("{score:?}");
    assert!(score.points >= 60, "{} of 65 points", score.points);
    // Worst at the player's edge: neither the player's motion nor the stand's rest explains the background there.
    assert!(score.worst_px < 0.8 && score.rms_px < 0.15, "{score:?}");
}

/// Centre errors of a track against the truth.
#[derive(Debug)]
struct Score {
    points: usize,
    bias_px: [f64; 2],
    rms_px: f64,
    worst_px: f64,
    /// Mean squared error over its covariance: 1 where that is honest.
    nees: f64,
}

impl Score {
    fn of(points: &[crate::scene::TrackPoint], truth: impl Fn(u64) -> [f64; 2]) -> Self {
        let mut score = Self {
            points: points.len(),
            bias_px: [0.0; 2],
            rms_px: 0.0,
            worst_px: 0.0,
            nees: 0.0,
        };
        let n = points.len() as f64;
        for point in points {
            let [x, y] = truth(point.frame);
            let off = nalgebra::Vector2::new(point.pixel.x - x, point.pixel.y - y);
            score.bias_px[0] += off.x / n;
            score.bias_px[1] += off.y / n;
            score.rms_px += off.norm_squared() / n;
            score.worst_px = score.worst_px.max(off.norm());
            let information = point.covariance_px2.unwrap().try_inverse().unwrap();
            score.nees += (off.transpose() * information * off)[0] / (2.0 * n);
        }
        score.rms_px = score.rms_px.sqrt();
        score
    }
}

/// The frames of a lone ball, which flies into shade at this frame.
fn frames(shade_from: u64) -> impl Iterator<Item = crate::scene::Frame> {
    let stand = Canvas::stand(640, 240, 3, 40.0);
    (0..100u64).map(move |number| {
        let mut canvas = stand.clone();
        if (10..60).contains(&number) {
            let lit = ball(number as f64 - 10.0);
            canvas.ball(&if number < shade_from { lit } else { in_shade(lit) });
        }
        canvas.frame(number, 175.0, 2.0)
    })
}

/// Before a sunny stand its lower side stands out.
fn in_shade(lit: Ball) -> Ball {
    Ball {
        light: 0.5 * lit.light,
        shade: 0.5 * lit.shade,
        ..lit
    }
}

#[test]
fn a_look_before_the_end_is_the_look_after_it() {
    for shade_from in [100, 44] {
        looked_at_early_and_late(shade_from);
    }
}

fn looked_at_early_and_late(shade_from: u64) {
    let config = EyeConfig::default();
    let camera = CameraId::new("side").unwrap();
    let (mut first, mut second) = (
        FirstLook::new(camera.clone(), &config, 640, 240),
        SecondLook::new(&config),
    );
    let mut eye = CameraEye::new(camera, config, 640, 240);
    let (mut ahead, mut early, mut found) = (0, 0, Vec::new());
    for frame in frames(shade_from) {
        first.push(&frame).unwrap();
        eye.push(&frame).unwrap();
        let open = first.open();
        for flying in first.flying(&open) {
            second.look_ahead(&flying);
            ahead += 1;
        }
        for ending in first.ending() {
            second.look_early(ending);
            early += 1;
        }
        found.extend(first.drain().into_iter().map(|ended| second.look(ended).0));
    }
    let tracks = |balls: Vec<TrackedBall>| balls.into_iter().map(|b| b.track).collect::<Vec<_>>();
    let (found, expected) = (tracks(found), tracks(eye.drain_balls()));
    assert_eq!((ahead, early), (1, 1), "shade from {shade_from}");
    assert_eq!(expected.len(), 1, "{expected:?}");
    let score = Score::of(&expected[0].points, |frame| flight(frame as f64 - 10.0));
    println!("shade from {shade_from}: {score:?}");
    assert!(
        score.points > 46 && score.worst_px < 0.5,
        "shade from {shade_from}: {score:?}"
    );
    assert_eq!(found, expected);
}

#[test]
fn a_ball_looked_at_in_flight_is_the_ball_looked_at_at_once() {
    let config = EyeConfig::default();
    let camera = CameraId::new("side").unwrap();
    let mut first = FirstLook::new(camera, &config, 640, 240);
    let (mut at_once, mut in_flight) = (SecondLook::new(&config), SecondLook::new(&config));
    let (mut ahead, mut balls) = (0, 0);
    for frame in frames(100) {
        first.push(&frame).unwrap();
        let open = first.open();
        for flying in first.flying(&open) {
            ahead += usize::from(in_flight.look_ahead(&flying));
        }
        for ended in first.drain() {
            let again = EndedBall {
                ball: ended.ball.clone(),
                cut_outs: ended.cut_outs.clone(),
                size: ended.size,
            };
            let (one, other) = (at_once.look(ended).0.track, in_flight.look(again).0.track);
            assert!(one.points.len() > 40 && one.points.len() == other.points.len());
            for (a, b) in one.points.iter().zip(&other.points) {
                let apart = (a.pixel.vector() - b.pixel.vector()).norm();
                assert!(apart < 0.003, "frame {}: {apart} px apart", a.frame);
            }
            balls += 1;
        }
    }
    assert_eq!((ahead, balls), (1, 1));
}

/// The one pitch that is found where this is painted.
fn pitch_of(paint: impl Fn(u64) -> Canvas) -> Vec<crate::scene::TrackPoint> {
    let mut eye = CameraEye::new(CameraId::new("side").unwrap(), EyeConfig::default(), 640, 240);
    for number in 0..80u64 {
        eye.push(&paint(number).frame(number, 175.0, 2.0)).unwrap();
    }
    eye.finish();
    let mut pitches = eye
        .drain_balls()
        .into_iter()
        .filter(|b| b.kind == TrackKind::Pitch);
    let pitch = pitches.next().unwrap();
    assert!(pitches.next().is_none());
    pitch.track.points
}

#[test]
fn a_wire_that_hides_half_of_a_ball_does_not_draw_its_centre() {
    // Five pixels wide and level: the ball sinks past it for a fifth of its flight.
    let stand = Canvas::stand(640, 240, 3, 40.0);
    let points = pitch_of(|number| {
        let mut canvas = stand.clone();
        if (10..75).contains(&number) {
            canvas.ball(&ball(number as f64 - 10.0));
        }
        canvas.light[640 * 103..640 * 108].fill(35.0);
        canvas
    });
    let score = Score::of(&points, |frame| flight(frame as f64 - 10.0));
    println!("{score:?}");
    assert!(score.points >= 55, "{} of 65 points", score.points);
    assert!(score.worst_px < 0.3 && score.rms_px < 0.08, "{score:?}");
}

#[test]
fn a_ball_is_found_again_in_frames_that_its_track_lacks() {
    let config = EyeConfig::default();
    let camera = CameraId::new("side").unwrap();
    let mut first = FirstLook::new(camera, &config, 640, 240);
    let mut second = SecondLook::new(&config);
    for frame in frames(100) {
        first.push(&frame).unwrap();
    }
    let mut ended = first.drain().remove(0);
    let whole: Vec<u64> = ended.ball.track.points.iter().map(|p| p.frame).collect();
    assert_eq!((whole[0], whole.len()), (10, 50));
    let lost = [10, 11, 30, 31, 32, 40, 58, 59];
    ended.ball.track.points.retain(|p| !lost.contains(&p.frame));
    let points = second.look(ended).0.track.points;
    assert_eq!(points.iter().map(|p| p.frame).collect::<Vec<_>>(), whole);
    let found: Vec<_> = points.into_iter().filter(|p| lost.contains(&p.frame)).collect();
    let score = Score::of(&found, |frame| flight(frame as f64 - 10.0));
    assert!(score.worst_px < 0.2 && score.nees < 2.0, "{score:?}");
}

#[test]
fn the_lag_changes_among_limbs_that_move_but_not_under_a_ball() {
    let stand = Canvas::stand(640, 240, 3, 40.0);
    let limb = Canvas::stand(22, 60, 9, 60.0);
    let changed_at = |with_ball: bool| {
        let camera = CameraId::new("side").unwrap();
        let mut first = FirstLook::new(camera, &EyeConfig::default(), 640, 240);
        let before = first.lag_frames();
        (0..600u64).find(|&number| {
            let mut canvas = stand.clone();
            // Two legs and two arms swing once in 0.4 s, 30 px to either side; nobody stands still.
            for limb_number in 0..4 {
                let phase = 2.5 * f64::from(limb_number) + 0.09 * number as f64;
                let left = 150.0 + 90.0 * f64::from(limb_number) + 30.0 * phase.sin();
                canvas.paste(&limb, left, 150.0 + 20.0 * f64::from(limb_number % 2));
            }
            if with_ball && number < 70 {
                canvas.ball(&ball(number as f64));
            }
            first.push(&canvas.frame(number, 175.0, 2.0)).unwrap();
            if number == 30 {
                first.adapt(BallStep {
                    step_px: 12.0,
                    length_px: 8.0,
                    off_light_px: Vector2::zeros(),
                });
            }
            first.lag_frames() < before
        })
    };
    let (limbs, ball) = (changed_at(false), changed_at(true));
    println!("limbs only: {limbs:?}; under a ball to frame 69: {ball:?}");
    assert!(limbs.is_some_and(|frame| frame < 30 + 175), "{limbs:?}");
    assert!(
        ball.is_some_and(|frame| (70..70 + 175).contains(&frame)),
        "{ball:?}"
    );
}

#[test]
fn a_pitch_begins_where_it_leaves_the_hand() {
    let stand = Canvas::stand(640, 240, 3, 40.0);
    let arm = Canvas {
        width: 9,
        height: 60,
        light: vec![150.0; 9 * 60],
    };
    let points = pitch_of(|number| {
        let mut canvas = stand.clone();
        // The hand carries the ball until frame 20 and then falls behind.
        let since = number as f64 - 20.0;
        // Before, both come up from below on a curve of their own: no free flight.
        let rise = 0.9 * since.min(0.0).powi(2);
        let [x, y] = flight(since.min(0.0) + 4.0);
        let y = y + rise;
        let behind = if since > 0.0 {
            5.0 * since - 0.04 * since * since
        } else {
            0.0
        };
        if number < 70 {
            let [x, y] = flight(since + 4.0);
            canvas.ball(&Ball {
                centre: [x, y + rise],
                ..ball(0.0)
            });
        }
        canvas.paste(&arm, x - 4.0 + behind, y + 2.0 + 0.5 * since.max(0.0));
        canvas
    });
    let score = Score::of(&points, |frame| flight(frame as f64 - 16.0));
    println!(
        "from {} to {}: {score:?}",
        points[0].frame,
        points.last().unwrap().frame
    );
    let lacking: Vec<u64> = (22..70)
        .filter(|f| points.iter().all(|p| p.frame != *f))
        .collect();
    assert!(lacking.is_empty(), "lacking {lacking:?}");
    // A frame before the release the hand is 0.9 px off the flight, two before 3.6 px.
    assert!(points[0].frame >= 19, "from {}", points[0].frame);
    assert!(score.worst_px < 0.5, "{score:?}");
}

#[test]
fn a_rig_s_mask_hides_a_ball_and_its_region_holds_it() {
    let rect = |x_px, y_px, width_px, height_px| crate::scene::PixelRect {
        x_px,
        y_px,
        width_px,
        height_px,
    };
    let found = |regions: Vec<_>, masks: Vec<_>| {
        let setup = crate::scene::CameraSetup {
            id: CameraId::new("side").unwrap(),
            width_px: 640,
            height_px: 240,
            frame_rate_hz: 175.0,
            exposure_s: None,
            time_offset_s: None,
            rolling_shutter: crate::scene::RollingShutter::Global,
            intrinsics: crate::geometry::Intrinsics {
                fx_px: 1790.0,
                fy_px: 1790.0,
                cx_px: 319.5,
                cy_px: 119.5,
                distortion: [0.0; 5],
            },
            focal_sigma_relative: 0.0,
            position: None,
            landmarks: vec![],
            regions,
            masks,
        };
        let rig = Rig {
            site: crate::scene::Site {
                name: String::new(),
                field: crate::scene::FieldPreset::Professional,
                motion: crate::scene::Motion::Flight,
                gravity_mps2: 9.80665,
                air_density_kgpm3: 1.2,
            },
            reference: 0,
            cameras: vec![setup],
            distances: vec![],
        };
        let camera = CameraId::new("side").unwrap();
        let mut eye = CameraEye::new(camera.clone(), EyeConfig::of_rig(&rig, &camera), 640, 240);
        for frame in frames(100) {
            eye.push(&frame).unwrap();
        }
        eye.finish();
        eye.drain_pitches()
            .iter()
            .map(|track| track.points.len())
            .sum::<usize>()
    };
    assert_eq!(found(vec![], vec![]), 50);
    assert_eq!(found(vec![rect(0, 64, 640, 112)], vec![]), 50);
    assert_eq!(found(vec![], vec![rect(0, 64, 640, 112)]), 0);
    assert_eq!(found(vec![rect(0, 0, 640, 64)], vec![]), 0);
}

/// A ball that hardly differs from what is behind it, in the frames of a camera with too short an exposure; darker than that or
/// brighter, by so many levels at its rim in shade and in full light.
fn weak_frames(shade: f64, light: f64) -> impl Iterator<Item = crate::scene::Frame> {
    let mut stand = Canvas::stand(640, 240, 3, 40.0);
    stand.light.iter_mut().for_each(|v| *v = 50.0 + 0.1 * (*v - 70.0));
    (0..100u64).map(move |number| {
        let mut canvas = stand.clone();
        if (10..70).contains(&number) {
            canvas.ball(&Ball {
                shade: 50.0 + shade,
                light: 50.0 + light,
                ..ball(number as f64 - 10.0)
            });
        }
        canvas.frame(number, 175.0, 1.5)
    })
}

/// Where other cameras say that the ball is, 0.6 px off.
fn told() -> ForeseenPath {
    let places = (0..130).map(|half| {
        let frame = 10.0 + 0.5 * f64::from(half);
        let [x, y] = flight(frame - 10.0);
        crate::scene::ForeseenPlace {
            stamped: crate::time::StampedMidpoint::from_seconds_since(1_000_000_000, frame / 175.0),
            centre: crate::geometry::Pixel::new(x + 0.4, y - 0.4),
            sigma_px: 0.6,
            radius_px: 2.6,
        }
    });
    ForeseenPath::new(places.collect())
}

/// The pitches that an eye finds which is told of a ball with this frame.
fn pitches_told(frames: impl Iterator<Item = crate::scene::Frame>, told_with: Option<u64>) -> Vec<Track> {
    let mut eye = CameraEye::new(CameraId::new("side").unwrap(), EyeConfig::default(), 640, 240);
    for frame in frames {
        if told_with == Some(frame.stamp.frame) {
            eye.foresee(told());
        }
        eye.push(&frame).unwrap();
    }
    eye.finish();
    let pitches = eye.drain_balls().into_iter();
    let pitches = pitches.filter(|ball| ball.kind == TrackKind::Pitch);
    pitches.map(|ball| ball.track).collect()
}

#[test]
fn a_ball_that_a_camera_hardly_sees_is_found_where_the_others_see_it() {
    for (shade, light) in [(1.0, 9.0), (4.0, 9.0), (-8.0, -3.0)] {
        let case = format!("{shade} to {light} levels");
        let count = |tracks: &[Track]| tracks.iter().map(|t| t.points.len()).sum::<usize>();
        let alone = pitches_told(weak_frames(shade, light), None);
        let pitches = pitches_told(weak_frames(shade, light), Some(20));
        println!("{case}: {} and {} of 60", count(&alone), count(&pitches));
        assert!(count(&alone) < 25, "{case} is seen without help");
        assert_eq!(pitches.len(), 1, "{case}");
        let score = Score::of(&pitches[0].points, |frame| flight(frame as f64 - 10.0));
        println!("from frame {}: {score:?}", pitches[0].points[0].frame);
        assert!(
            score.points >= 30 && score.rms_px < 0.35 && score.nees < 2.0,
            "{case}: {score:?}"
        );
    }
}

#[test]
fn what_others_see_is_no_ball_where_there_is_none() {
    let stand = Canvas::stand(640, 240, 3, 40.0);
    let empty = (0..100u64).map(|number| stand.frame(number, 175.0, 2.0));
    assert!(pitches_told(empty, Some(9)).is_empty());
    // Nor where something moves: a crowd that flickers all along the way, a player who walks across it.
    let player = Canvas::stand(120, 150, 9, 60.0);
    let flickering = (0..100u64).map(|number| {
        let other = Canvas::stand(640, 240, number, 12.0);
        let mut canvas = stand.clone();
        for (light, other) in canvas.light.iter_mut().zip(&other.light) {
            *light += 0.4 * (*other - *light);
        }
        canvas.paste(&player, 200.0 + 1.3 * number as f64, 60.0);
        canvas.frame(number, 175.0, 2.0)
    });
    assert!(pitches_told(flickering, Some(9)).is_empty());
}
