//! Stills of home plate on their way from a camera's frames to where calibrations are made.

use crossbeam_channel::{bounded, unbounded};

use super::*;
use crate::detection::StillPicture;
use crate::scene::{FrameStamp, PixelFormat, PixelRect};

const SIZE: (u32, u32) = (64, 48);
/// Part of the picture that a still is wanted of.
const PLACE: PixelRect = PixelRect {
    x_px: 11,
    y_px: 7,
    width_px: 20,
    height_px: 10,
};
/// A still is told of when 32 frames of it are there, of which every eighth is taken.
const UNTIL_TOLD: u64 = 31 * 8 + 1;

/// Levels of an even slope over the picture.
fn level(x: u32, y: u32) -> u8 {
    (40 + 2 * x + y) as u8
}

fn live(number: u64, clock_epoch: u32, format: PixelFormat) -> LiveFrame {
    let levels = (0..SIZE.1).flat_map(|y| (0..SIZE.0).map(move |x| level(x, y)));
    let pixels: Vec<u8> = match format {
        PixelFormat::Mono8 => levels.collect(),
        // Little-endian words of ten bits; the still is of the upper eight.
        _ => levels
            .flat_map(|level| (u16::from(level) << 2 | 3).to_le_bytes())
            .collect(),
    };
    let frame = RawFrame {
        stamp: FrameStamp {
            frame: number,
            device: None,
            arrival: None,
            stamped: StampedMidpoint::from_nanos(5_714_286 * number as i64),
        },
        width_px: SIZE.0,
        height_px: SIZE.1,
        format,
        pixels: Arc::new(pixels),
    };
    LiveFrame {
        frame,
        stamp_sigma_s: 1e-5,
        clock_epoch,
        clock: None,
        exposure_s: 1e-3,
        lost_before: 0,
    }
}

/// The stills that an eye with a queue of so many tells of, and those that it lost.
fn told(still: Option<Still>, queue: usize, frames: impl Iterator<Item = LiveFrame>) -> (Vec<Still>, u64) {
    let (stills_in, stills) = bounded(queue);
    let channels = EyeChannels {
        look: bounded(LOOK_QUEUE).0,
        in_flight: bounded(1).0,
        steps: bounded(1).1,
        foreseen: bounded(1).1,
        stills: stills_in,
    };
    let camera = CameraId::new("first").unwrap();
    let health = Arc::new(CameraHealth::new(camera.clone()));
    let (frames_in, frames_out) = unbounded();
    frames.for_each(|frame| frames_in.send(frame).unwrap());
    drop(frames_in);
    let eye = EyeConfig::default();
    watch(&frames_out, &channels, Wanted { eye, still }, &health);
    drop(channels);
    let stills = stills.into_iter().map(|(of, still)| {
        assert_eq!(of, camera);
        still
    });
    (stills.collect(), health.stills_lost.load(Ordering::Relaxed))
}

fn wanted() -> Option<Still> {
    Some(Still::new(PLACE))
}

fn is_the_slope(picture: &StillPicture) -> bool {
    let rows = PLACE.y_px..PLACE.y_px + PLACE.height_px;
    let mut places = rows.flat_map(|y| (PLACE.x_px..PLACE.x_px + PLACE.width_px).map(move |x| (x, y)));
    picture.place == PLACE && places.all(|(x, y)| picture.at(x, y) == Some(f32::from(level(x, y))))
}

#[test]
fn a_still_is_told_of_when_it_has_all_its_frames() {
    for format in [PixelFormat::Mono8, PixelFormat::Mono10] {
        let frames = |count: u64| (0..count).map(move |number| live(number, 1, format));
        assert_eq!(told(wanted(), 4, frames(UNTIL_TOLD - 1)).0.len(), 0, "{format}");
        let (stills, lost) = told(wanted(), 4, frames(UNTIL_TOLD));
        assert_eq!((stills.len(), lost), (1, 0), "{format}");
        assert!(is_the_slope(&stills[0].picture().unwrap()), "{format}");
        assert_eq!(told(None, 4, frames(UNTIL_TOLD)).0.len(), 0);
    }
}

#[test]
fn a_still_begins_anew_with_the_clock() {
    let frames =
        |count: u64| (0..count).map(|number| live(number, 1 + u32::from(number >= 200), PixelFormat::Mono8));
    assert_eq!(told(wanted(), 4, frames(200 + UNTIL_TOLD - 1)).0.len(), 0);
    assert_eq!(told(wanted(), 4, frames(200 + UNTIL_TOLD)).0.len(), 1);
}

#[test]
fn stills_that_nobody_takes_are_counted() {
    // The second one is there after as many frames again: every sixteenth is taken then.
    let frames = (0..2 * UNTIL_TOLD + 16).map(|number| live(number, 1, PixelFormat::Mono8));
    let (stills, lost) = told(wanted(), 1, frames);
    assert_eq!((stills.len(), lost), (1, 1));
}
