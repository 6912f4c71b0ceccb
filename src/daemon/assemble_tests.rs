//! Late tracks: none makes a second pitch of one throw.

use super::*;
use crate::config::parse_rig;
use crate::geometry::Pixel;
use crate::scene::TrackPoint;
use crossbeam_channel::bounded;
use std::path::Path;

fn camera(id: &str) -> String {
    format!(
        "[[camera]]\nid = \"{id}\"\nwidth_px = 2048\nheight_px = 1024\nframe_rate_hz = 175.0\nexposure_s = 0.001\n\
         [camera.intrinsics]\nfx_px = 1790.0\nfy_px = 1790.0\ncx_px = 1023.5\ncy_px = 511.5\n\
         distortion = [0.0, 0.0, 0.0, 0.0, 0.0]\n"
    )
}

/// An assembler without a calibration, and where it sends its requests.
fn assembler() -> (Assembler, crossbeam_channel::Receiver<CalibrationRequest>) {
    let text = format!(
        "[site]\nname = \"T\"\n{}{}{}",
        camera("first"),
        camera("third"),
        camera("home")
    );
    let rig = parse_rig(Path::new("rig.toml"), &text).unwrap();
    let health = ["first", "third", "home"].map(|id| {
        let health = CameraHealth::new(CameraId::new(id).unwrap());
        health.set_state(CameraState::Streaming);
        Arc::new(health)
    });
    let (requests, asked) = bounded(1);
    let assembler = Assembler {
        rig,
        numbers_before: 0,
        calibration: None,
        plan: CalibrationPlan {
            first_pitches: 2,
            window_pitches: 8,
            every_pitches: 4,
        },
        health: health.to_vec(),
        requests,
        clips: None,
        publish: bounded(8).0,
        versions: bounded(8).0,
        foresee: bounded(8).0,
    };
    (assembler, asked)
}

fn seen(camera: &str, begin_ns: i64) -> SeenTrack {
    let point = |k: i64| TrackPoint {
        frame: k as u64,
        stamped: StampedMidpoint::from_nanos(begin_ns + k * 5_714_286),
        pixel: Pixel::new(k as f64, 0.0),
        covariance_px2: None,
    };
    SeenTrack {
        track: Track {
            camera: CameraId::new(camera).unwrap(),
            track: 0,
            points: (0..70).map(point).collect(),
        },
        clock_epoch: 1,
        complete: ArrivalTime::from_nanos(begin_ns),
    }
}

#[test]
fn a_track_that_comes_late_joins_its_ball() {
    let (mut assembler, _asked) = assembler();
    let mut desk = Desk::default();
    for camera in ["first", "third"] {
        assembler.take(seen(camera, 0), &mut desk);
    }
    // The third camera was lost: the ball is closed without it.
    let two: Vec<Watched> = assembler.watched().into_iter().take(2).collect();
    assembler.close_decided(&mut desk, Some(&two));
    assert_eq!((desk.open.len(), desk.window.len()), (0, 1));
    assembler.take(seen("home", 30_000_000), &mut desk);
    assert_eq!((desk.open.len(), desk.window.len()), (0, 1));
    assert_eq!(desk.window[0].cameras().len(), 3);
    // What a camera tells of that has told is another ball.
    assembler.take(seen("first", 500_000_000), &mut desk);
    assert_eq!((desk.open.len(), desk.window.len()), (1, 1));
}

#[test]
fn a_ball_of_one_camera_waits_for_those_that_come_back() {
    let (mut assembler, _asked) = assembler();
    let mut desk = Desk::default();
    assembler.take(seen("first", 0), &mut desk);
    let one: Vec<Watched> = assembler.watched().into_iter().take(1).collect();
    assembler.close_decided(&mut desk, Some(&one));
    assert_eq!((desk.open.len(), desk.alone.len(), desk.window.len()), (0, 1, 0));
    assembler.take(seen("third", 20_000_000), &mut desk);
    assert_eq!((desk.open.len(), desk.alone.len()), (1, 0));
    assembler.take(seen("home", 20_000_000), &mut desk);
    let all = assembler.watched();
    assembler.close_decided(&mut desk, Some(&all));
    assert_eq!((desk.open.len(), desk.window.len()), (0, 1));
    assert_eq!(desk.window[0].cameras().len(), 3);
}
