//! The calibration worker, and the calibration in use with the clocks that it holds for.

use std::collections::BTreeMap;
use std::time::Instant;

use crossbeam_channel::{Receiver, Sender};

use super::batch::{BatchOptions, solve_tracks};
use super::plates::add_plate;
use crate::detection::Still;
use crate::scene::{Calibration, CameraId, ParameterKind, Rig, Track, WorldFrame};
use crate::time::is_of_network;

/// Clock epoch per camera.
pub type Epochs = BTreeMap<CameraId, u32>;

/// A calibration, and the clock epochs that it holds for.
pub type CalibrationInUse = (Calibration, Epochs);

/// Work for the calibration worker.
pub struct CalibrationRequest {
    /// Tracks of all its pitches.
    pub tracks: Vec<Track>,
    /// Clocks that they were stamped by.
    pub epochs: Epochs,
    /// Version that the calibration gets.
    pub version: u32,
}

/// Its answer.
pub struct CalibrationAnswer {
    /// The calibration, if there is one.
    pub calibration: Option<Calibration>,
    /// Clocks that it holds for.
    pub epochs: Epochs,
    /// Why there is none.
    pub reason: String,
}

/// Stills of home plate that may wait: they are taken at once but while a calibration is made.
pub const STILLS_QUEUE: usize = 16;

/// The calibration worker's thread: one request at a time, never in the way of a pitch. Where stills show home plate it is one
/// more landmark.
pub fn calibrate(
    mut rig: Rig,
    (requests, stills): (&Receiver<CalibrationRequest>, &Receiver<(CameraId, Still)>),
    answers: &Sender<CalibrationAnswer>,
) {
    // Of each camera the newest counts.
    let mut newest: BTreeMap<CameraId, Still> = BTreeMap::new();
    loop {
        let request = crossbeam_channel::select! {
            recv(stills) -> still => match still {
                Ok((camera, still)) => {
                    newest.insert(camera, still);
                    continue;
                }
                // No camera is left: what was asked for is still answered.
                Err(_) => match requests.recv() {
                    Ok(request) => request,
                    Err(_) => return,
                },
            },
            recv(requests) -> request => match request {
                Ok(request) => request,
                Err(_) => return,
            },
        };
        newest.extend(stills.try_iter());
        let begun = Instant::now();
        for (camera, still) in std::mem::take(&mut newest) {
            let told = still
                .picture()
                .and_then(|still| add_plate(&mut rig, &camera, &still));
            tracing::info!(%camera, "{}", told.as_deref().unwrap_or("home plate not seen"));
        }
        let made = solve_tracks(&rig, &request.tracks, &BatchOptions::default());
        let (calibration, reason) = match made {
            Ok(batch) if batch.calibration.world != WorldFrame::HomePlate => (
                None,
                "the rig's landmarks do not fix the home-plate frame".to_owned(),
            ),
            Ok(batch) => {
                let mut calibration = batch.calibration;
                calibration.version = request.version;
                for camera in &mut calibration.cameras {
                    camera.network_clock = request.epochs.get(&camera.id).is_some_and(|e| is_of_network(*e));
                }
                tracing::info!(
                    pitches = batch.flights.len(),
                    seconds = begun.elapsed().as_secs_f64(),
                    "calibrated"
                );
                (Some(calibration), String::new())
            }
            Err(error) => (None, error.to_string()),
        };
        let answer = CalibrationAnswer {
            calibration,
            epochs: request.epochs,
            reason,
        };
        if answers.send(answer).is_err() {
            return;
        }
    }
}

/// A calibration that was read from a file as it holds for live stamps, and for which clock epochs: the
/// network's clock where it was made by that, else each camera's own first.
///
/// Live stamps are on this host's clock, so there is no skew between them; a skew that another session had would move a
/// delay that is stated hours ago by seconds.
pub fn from_file(mut calibration: Calibration) -> CalibrationInUse {
    for camera in &mut calibration.cameras {
        camera.clock_skew_ppm = 0.0;
    }
    let kept: Vec<bool> = calibration
        .parameters
        .iter()
        .map(|p| p.kind != ParameterKind::ClockSkew)
        .collect();
    let keep = |row: Vec<f64>| -> Vec<f64> {
        let kept = row.into_iter().zip(&kept).filter(|(_, kept)| **kept);
        kept.map(|(value, _)| value).collect()
    };
    let rows = std::mem::take(&mut calibration.covariance);
    let kept_rows = rows.into_iter().zip(&kept).filter(|(_, kept)| **kept);
    calibration.covariance = kept_rows.map(|(row, _)| keep(row)).collect();
    calibration
        .parameters
        .retain(|p| p.kind != ParameterKind::ClockSkew);
    let epoch_of = |network_clock: bool| if network_clock { 0 } else { 1 };
    let cameras = calibration.cameras.iter();
    let epochs = cameras
        .map(|c| (c.id.clone(), epoch_of(c.network_clock)))
        .collect();
    (calibration, epochs)
}

#[cfg(test)]
#[path = "calibrating_tests.rs"]
mod tests;
