//! 2-D tracks to pitches, all at once: the second half of the pipeline, for recordings and track files.

use crate::calibration::association::{Association, AssociationOptions, associate};
use crate::calibration::kim2019::{self, Kim2019Options};
use crate::calibration::recipe::{CalibrationOptions, CalibrationOutcome, calibrate};
use crate::calibration::resection::LANDMARKS_NEEDED;
use crate::calibration::trust::doubts;
use crate::calibration::{CalibrationError, PitchTracks};
use crate::export::report::{Residual, TrajectoryRow};
use crate::export::table::FlightRow;
use crate::flight::{
    FlightError, FlightOptions, NumbersError, PitchOptions, SolvedFlight, flight_samples, pitch_from_flight,
    residuals, solve_flight, speed_at,
};
use crate::scene::{
    Calibration, CalibrationMethod, CameraId, Pitch, PitchQuality, Rig, Track, TrackPoint, WorldFrame,
};
use crate::time::NANOS_PER_SECOND;

/// A flight is seen again within this long or not at all, seconds: release to plate takes half of it.
const PAUSE_S: f64 = 1.0;

/// How tracks become pitches.
#[derive(Debug, Clone, Default)]
pub struct BatchOptions {
    /// Estimator, where a calibration has to be made.
    pub method: CalibrationMethod,
    /// A calibration to use as it is; `None`: calibrate from these very pitches.
    pub calibration: Option<Calibration>,
}

/// Why there are no pitches.
#[derive(Debug, thiserror::Error)]
pub enum BatchError {
    /// No calibration could be made.
    #[error("calibration: {0}")]
    Calibration(#[from] CalibrationError),
    /// Tracks of a camera nobody knows.
    #[error("tracks of camera `{camera}`, which is not in the rig ({known})")]
    UnknownCamera {
        /// The camera.
        camera: CameraId,
        /// The rig's cameras.
        known: String,
    },
}

/// One flight that was solved, in whatever world the calibration has.
#[derive(Debug, Clone)]
pub struct BatchFlight {
    /// Number, from 1.
    pub number: u32,
    /// The flight.
    pub flight: SolvedFlight,
    /// What it was solved from.
    pub tracks: Vec<Track>,
}

/// What came of a set of tracks.
#[derive(Debug, Clone)]
pub struct Batch {
    /// Made here, or the one given.
    pub calibration: Calibration,
    /// Pitches in time order (empty where the world is not the home-plate frame).
    pub pitches: Vec<Pitch>,
    /// Every flight, pitches or not.
    pub flights: Vec<BatchFlight>,
    /// Residuals of every point of every pitch.
    pub residuals: Vec<Residual>,
    /// What a person must know.
    pub warnings: Vec<String>,
    /// Groups of tracks that became no pitch, and why.
    pub left_out: Vec<String>,
    /// What is doubtful about the calibration, and so about every pitch.
    doubts: Vec<(PitchQuality, String)>,
}

/// Calibrates if need be and solves every pitch.
///
/// # Errors
/// [`BatchError`] where nothing can be had; a single bad pitch is only a warning.
pub fn solve_tracks(rig: &Rig, tracks: &[Track], options: &BatchOptions) -> Result<Batch, BatchError> {
    if let Some(stranger) = tracks.iter().find(|t| rig.index_of(&t.camera).is_none()) {
        return Err(BatchError::UnknownCamera {
            camera: stranger.camera.clone(),
            known: rig
                .cameras
                .iter()
                .map(|c| c.id.as_str())
                .collect::<Vec<_>>()
                .join(", "),
        });
    }
    let tracks = &split_at_pauses(tracks);
    let mut warnings = silent_cameras(rig, tracks);
    let mut left_out = Vec::new();
    let seeing = rig.only(|c| has_points(&c.id, tracks));
    let rig = seeing.as_ref().unwrap_or(rig);
    let (calibration, solved) = match &options.calibration {
        Some(calibration) => {
            let tracks = of_calibrated(calibration, tracks, &mut warnings);
            let groups = group_by(rig, calibration, &tracks);
            let solved = groups.into_iter().map(|g| (g, None)).collect();
            (calibration.clone(), solved)
        }
        None => {
            let outcome = match options.method {
                CalibrationMethod::Joint => calibrate(rig, tracks, &CalibrationOptions::default())?,
                CalibrationMethod::Kim2019 => {
                    kim2019::calibrate_session(rig, tracks, &Kim2019Options::default())?
                }
            };
            warnings.extend(outcome.wrong_tracks.iter().map(|w| {
                format!(
                    "camera {} track {}: not the ball of its pitch (fits in {:.0} % of its points), left out",
                    w.camera,
                    w.track,
                    100.0 * w.kept_share
                )
            }));
            // A group whose tracks were all taken out has been told of above.
            left_out.extend(
                outcome
                    .unsolved
                    .iter()
                    .filter_map(|u| Some((outcome.pitches.get(u.pitch)?, u)))
                    .filter(|(group, _)| !group.tracks.is_empty())
                    .map(|(tracks, u)| format!("{}: not solved: {}", name_of(tracks), u.reason)),
            );
            (outcome.calibration.clone(), pair_up(outcome))
        }
    };
    let doubts = doubts(rig, &calibration);
    warnings.extend(doubts.iter().map(|(_, doubt)| format!("calibration: {doubt}")));
    let mut batch = Batch {
        doubts,
        calibration,
        pitches: Vec::new(),
        flights: Vec::new(),
        residuals: Vec::new(),
        warnings,
        left_out,
    };
    batch.fly(rig, solved);
    Ok(batch)
}

/// Root mean square reprojection error over all cameras of a calibration, pixels.
pub(super) fn usual_rms_px(calibration: &Calibration) -> f64 {
    let points: usize = calibration.cameras.iter().map(|c| c.points).sum();
    let sum: f64 = calibration
        .cameras
        .iter()
        .map(|c| c.points as f64 * c.reprojection_rms_px * c.reprojection_rms_px)
        .sum();
    (sum / points.max(1) as f64).sqrt()
}

type Group = (PitchTracks, Option<SolvedFlight>);

/// The pitches of a calibration with the flights that were solved with it.
fn pair_up(outcome: CalibrationOutcome) -> Vec<Group> {
    let CalibrationOutcome { pitches, flights, .. } = outcome;
    flights
        .into_iter()
        .filter_map(|f| Some((pitches.get(f.pitch)?.clone(), Some(f.flight))))
        .collect()
}

fn silent_cameras(rig: &Rig, tracks: &[Track]) -> Vec<String> {
    rig.cameras
        .iter()
        .filter(|c| !has_points(&c.id, tracks))
        .map(|c| {
            let is_reference = rig.reference_camera().id == c.id;
            let heir = rig.cameras.iter().find(|h| has_points(&h.id, tracks));
            match heir.filter(|_| is_reference) {
                Some(heir) => format!(
                    "camera {}, the reference, has no track of a ball: times and delays are by camera {}",
                    c.id, heir.id
                ),
                None => format!("camera {} has no track of a ball: going on without it", c.id),
            }
        })
        .collect()
}

/// A number that a program gives to several balls of a camera is several tracks: no flight pauses this long.
fn split_at_pauses(tracks: &[Track]) -> Vec<Track> {
    let mut split: Vec<Track> = Vec::with_capacity(tracks.len());
    for track in tracks {
        let next_number = |split: &[Track]| {
            let same = |t: &&Track| t.camera == track.camera;
            let used = tracks.iter().chain(split).filter(same).map(|t| t.track).max();
            used.map_or(0, |n| n.saturating_add(1))
        };
        let goes_on = |a: &TrackPoint, b: &TrackPoint| b.stamped.seconds_since(a.stamped.nanos()) <= PAUSE_S;
        for (i, points) in track.points.chunk_by(goes_on).enumerate() {
            let number = if i == 0 { track.track } else { next_number(&split) };
            split.push(Track {
                camera: track.camera.clone(),
                track: number,
                points: points.to_vec(),
            });
        }
    }
    split
}

fn has_points(camera: &CameraId, tracks: &[Track]) -> bool {
    tracks.iter().any(|t| t.camera == *camera && !t.points.is_empty())
}

fn of_calibrated(calibration: &Calibration, tracks: &[Track], warnings: &mut Vec<String>) -> Vec<Track> {
    let known = |t: &&Track| calibration.camera(&t.camera).is_some();
    let mut strangers: Vec<_> = tracks.iter().filter(|t| !known(t)).map(|t| &t.camera).collect();
    strangers.sort();
    strangers.dedup();
    for camera in strangers {
        warnings.push(format!(
            "camera {camera} is not in the calibration given: its tracks are not used"
        ));
    }
    tracks.iter().filter(known).cloned().collect()
}

/// Tracks of the same ball, by the known delays.
fn group_by(rig: &Rig, calibration: &Calibration, tracks: &[Track]) -> Vec<PitchTracks> {
    let mut timed = rig.clone();
    for camera in &mut timed.cameras {
        if let Some(known) = calibration.camera(&camera.id) {
            camera.time_offset_s = Some(-known.capture_delay_s);
        }
    }
    let Association { pitches, .. } = associate(&timed, tracks, &AssociationOptions::default());
    pitches
}

impl Batch {
    /// Every flight as rows of `trajectory.csv`: what there is to show where the world has no plate.
    pub fn trajectory(&self, rate_hz: f64) -> Vec<TrajectoryRow> {
        let mut rows = Vec::new();
        for BatchFlight { flight, .. } in &self.flights {
            let mut cameras: Vec<_> = flight
                .tracks
                .iter()
                .filter(|t| t.kept > 0)
                .map(|t| &t.camera)
                .collect();
            cameras.sort();
            cameras.dedup();
            let seen = u32::try_from(cameras.len()).unwrap_or(u32::MAX);
            rows.extend(
                flight_samples(flight, rate_hz)
                    .into_iter()
                    .map(|s| TrajectoryRow {
                        time_ns: s.time_ns,
                        position_m: s.position_m,
                        sigma_m: s.sigma_m,
                        cameras: seen,
                    }),
            );
        }
        rows
    }

    /// Every flight as a line of the terminal's table.
    pub fn flight_rows(&self) -> Vec<FlightRow> {
        let begins_s = |f: &SolvedFlight| f.trajectory.epoch_ns() as f64 / NANOS_PER_SECOND + f.observed_s.0;
        let first_s = self.flights.first().map_or(0.0, |f| begins_s(&f.flight));
        self.flights
            .iter()
            .map(|BatchFlight { number, flight, .. }| {
                let (begin, end) = flight.observed_s;
                FlightRow {
                    number: *number,
                    begin_s: begins_s(flight) - first_s,
                    seen_s: end - begin,
                    speed_mps: speed_at(&flight.trajectory, &flight.covariance, 0.5 * (begin + end)),
                    points: flight.kept(),
                    rms_px: flight.rms_px(),
                }
            })
            .collect()
    }

    fn fly(&mut self, rig: &Rig, groups: Vec<Group>) {
        let home_plate = self.calibration.world == WorldFrame::HomePlate;
        if !home_plate {
            let clicked = rig.cameras.iter().map(|c| c.landmarks.len()).max().unwrap_or(0);
            self.warnings.push(format!(
                "no place in the home-plate frame ({LANDMARKS_NEEDED} landmarks in a camera are needed, {clicked} are there): \
                 positions are relative to camera {}, and there are no plate numbers",
                self.calibration.reference
            ));
        }
        let flight_options = FlightOptions::for_site(&rig.site, self.calibration.world);
        let mut number = 0;
        for (group, flight) in groups {
            let solved = match flight {
                Some(flight) => Ok(flight),
                None => solve_flight(&self.calibration, &group.tracks, &flight_options),
            };
            let flight = match solved {
                Ok(flight) => flight,
                Err(error) => {
                    self.leave_out(&group, &error);
                    continue;
                }
            };
            if home_plate && !self.keep_pitch(rig, &flight, &group, number + 1) {
                continue;
            }
            number += 1;
            self.residuals.extend(
                residuals(&self.calibration, &flight, &group.tracks)
                    .into_iter()
                    .map(|r| Residual {
                        camera: r.camera,
                        pitch: number,
                        time_s: r.time_s,
                        dx_px: r.dx_px,
                        dy_px: r.dy_px,
                        kept: r.kept,
                    }),
            );
            self.flights.push(BatchFlight {
                number,
                flight,
                tracks: group.tracks,
            });
        }
    }

    fn keep_pitch(&mut self, rig: &Rig, flight: &SolvedFlight, group: &PitchTracks, number: u32) -> bool {
        let options = PitchOptions {
            sample_rate_hz: rig.reference_camera().frame_rate_hz,
            calibration_version: self.calibration.version,
            calibration_rms_px: usual_rms_px(&self.calibration),
            doubts: self.doubts.clone(),
            ..PitchOptions::default()
        };
        match pitch_from_flight(flight, number, &options) {
            Ok(pitch) => {
                self.pitches.push(pitch);
                true
            }
            Err(error) => {
                self.not_a_pitch(group, &error);
                false
            }
        }
    }

    fn leave_out(&mut self, group: &PitchTracks, error: &FlightError) {
        self.left_out
            .push(format!("{}: not solved: {error}", name_of(group)));
    }

    fn not_a_pitch(&mut self, group: &PitchTracks, error: &NumbersError) {
        self.left_out
            .push(format!("{}: a flight, but no pitch: {error}", name_of(group)));
    }
}

/// "camera first track 3 (frame 812), camera third track 2 (frame 810)": enough to find it in the recording.
fn name_of(group: &PitchTracks) -> String {
    let parts: Vec<_> = group
        .tracks
        .iter()
        .map(|t| {
            let frame = t.points.first().map_or(0, |p| p.frame);
            format!("camera {} track {} (from frame {frame})", t.camera, t.track)
        })
        .collect();
    parts.join(", ")
}
