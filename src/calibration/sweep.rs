//! The last resort of a session full of false tracks: poses from the landmarks alone, and per camera the delay
//! at which most pairs of tracks meet on a flight.

use super::matching::{first_misfits, match_tracks};
use super::resection::{LANDMARKS_NEEDED, resect_camera};
use super::{InitialEstimate, PitchTracks};
use crate::flight::FlightOptions;
use crate::flight::sighting::CameraModel;
use crate::scene::{Rig, Track, WorldFrame};

/// Delays tried on either side of the expected one, frames.
const REACH_FRAMES: f64 = 32.0;
/// Between delays tried, frames: half of it shifts a fastball's picture by 5 px at 80 px/m.
const STEP_FRAMES: f64 = 0.5;
/// Pairs that miss by more than this at a delay do not count there, pixels.
const MISFIT_PX: f64 = 8.0;

/// Pitches by geometry and a start, from landmarks and tracks; `None` where a camera lacks landmarks or
/// nothing meets.
pub(super) fn sweep(rig: &Rig, tracks: &[Track]) -> Option<(Vec<PitchTracks>, InitialEstimate)> {
    let mut models: Vec<Option<CameraModel>> = rig
        .cameras
        .iter()
        .map(|setup| {
            if setup.landmarks.len() < LANDMARKS_NEEDED {
                return None;
            }
            let pose = resect_camera(setup).ok()?.first()?.pose;
            let delay_s = -setup.time_offset_s.unwrap_or(0.0);
            Some(CameraModel::from_setup(setup, pose, delay_s))
        })
        .collect();
    let reference = models.get(rig.reference)?.clone()?;
    let options = FlightOptions::for_site(&rig.site, WorldFrame::HomePlate);
    for (index, model) in models.iter_mut().enumerate() {
        if index == rig.reference {
            if let Some(own) = model {
                own.timing.capture_delay_s = 0.0;
            }
            continue;
        }
        let Some(camera) = model else { continue };
        let step_s = STEP_FRAMES / rig.cameras[index].frame_rate_hz;
        let expected_s = camera.timing.capture_delay_s;
        let steps = (REACH_FRAMES / STEP_FRAMES) as i32;
        let mut best = (0.0, expected_s);
        for i in -steps..=steps {
            camera.timing.capture_delay_s = expected_s + f64::from(i) * step_s;
            let pair = [reference.clone(), camera.clone()];
            let score: f64 = first_misfits(&pair, tracks, &options)
                .iter()
                .map(|misfit_px| (1.0 - misfit_px / MISFIT_PX).max(0.0))
                .sum();
            if score > best.0 {
                best = (score, camera.timing.capture_delay_s);
            }
        }
        camera.timing.capture_delay_s = best.1;
        if best.0 <= 0.0 {
            *model = None;
        }
    }
    let placed: Vec<CameraModel> = models.iter().flatten().cloned().collect();
    if placed.len() < 2 {
        return None;
    }
    let pitches = match_tracks(&placed, tracks, &options);
    let delays = models
        .iter()
        .map(|m| m.as_ref().map_or(0.0, |m| m.timing.capture_delay_s));
    let start = InitialEstimate {
        poses: models.iter().map(|m| m.as_ref().map(|m| m.pose)).collect(),
        capture_delay_s: delays.collect(),
        clock_skew_ppm: vec![0.0; models.len()],
        skew_epoch_ns: vec![0; models.len()],
        world: WorldFrame::HomePlate,
        score_px: 0.0,
        notes: vec!["many tracks are not the ball: delays were found by the pairs that meet".to_owned()],
    };
    Some((pitches, start))
}
