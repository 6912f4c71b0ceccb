//! The joint problem: what is unknown, what is observed, and where the estimate stands.

use crate::calibration::{CalibrationError, InitialEstimate, PitchTracks};
use crate::flight::equations::{Loss, Sighting};
use crate::flight::sighting::{CAMERA_KINDS, CameraModel, CameraNoise};
use crate::flight::solve::{FlightState, cover};
use crate::flight::{FlightOptions, FlightPrior, linear_start};
use crate::scene::{CameraId, ParameterKind, Rig, RollingShutter, WorldFrame};
use crate::time::CameraTiming;

use super::JointOptions;
use super::camera_terms::CameraTerms;

/// Noise assumed for points that do not say, until the residuals tell, pixels.
const FIRST_SIGMA_PX: f64 = 0.5;

/// One unknown of one camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Column {
    /// Index among the problem's cameras.
    pub(super) camera: usize,
    /// Index into `CAMERA_KINDS`.
    pub(super) kind: usize,
}

impl Column {
    /// What it is.
    pub(super) fn parameter(self) -> ParameterKind {
        CAMERA_KINDS[self.kind]
    }
}

/// One pitch in the problem.
#[derive(Debug, Clone)]
pub(super) struct FlightUnknown {
    /// Index into the pitches given.
    pub(super) pitch: usize,
    /// Path and prior.
    pub(super) state: FlightState,
    /// Its points; `track` indexes the pitch's tracks.
    pub(super) sightings: Vec<Sighting>,
}

/// Everything that the estimator changes.
#[derive(Debug, Clone)]
pub(super) struct JointState {
    /// Cameras in the problem.
    pub(super) cameras: Vec<CameraModel>,
    /// Pitches in the problem.
    pub(super) flights: Vec<FlightUnknown>,
}

/// Everything that it does not.
#[derive(Debug, Clone)]
pub(super) struct JointProblem {
    /// Rig index of each camera of the problem.
    pub(super) rig_cameras: Vec<usize>,
    /// Problem index of the reference camera.
    pub(super) reference: usize,
    /// Camera unknowns, camera by camera.
    pub(super) columns: Vec<Column>,
    /// Landmarks, positions, distances, priors, gauge.
    pub(super) terms: CameraTerms,
    /// Coordinates.
    pub(super) world: WorldFrame,
    /// How flights are modelled.
    pub(super) flight: FlightOptions,
}

impl JointProblem {
    /// Sets the problem up at a start. Cameras without a pose and pitches that two placed cameras do not
    /// see are left out.
    pub(super) fn new(
        rig: &Rig,
        pitches: &[PitchTracks],
        start: &InitialEstimate,
        options: &JointOptions,
    ) -> Result<(Self, JointState), CalibrationError> {
        let mut rig_cameras = Vec::new();
        let mut cameras = Vec::new();
        for (index, setup) in rig.cameras.iter().enumerate() {
            let Some(Some(pose)) = start.poses.get(index) else {
                continue;
            };
            let readout_s = match setup.rolling_shutter {
                RollingShutter::Global => 0.0,
                RollingShutter::Estimate => options.readout_prior_s.0,
                RollingShutter::ReadoutSeconds(s) => s,
            };
            let at = |values: &[f64]| values.get(index).copied().unwrap_or(0.0);
            let stated_ns = start.skew_epoch_ns.get(index).copied().unwrap_or(0);
            let skew_epoch_ns = first_stamp(pitches, &setup.id);
            let clock_skew_ppm = at(&start.clock_skew_ppm);
            let since_s = (skew_epoch_ns - stated_ns) as f64 / crate::time::NANOS_PER_SECOND;
            rig_cameras.push(index);
            cameras.push(CameraModel {
                id: setup.id.clone(),
                pose: *pose,
                intrinsics: setup.intrinsics,
                timing: CameraTiming {
                    capture_delay_s: at(&start.capture_delay_s) + 1e-6 * clock_skew_ppm * since_s,
                    clock_skew_ppm,
                    skew_epoch_ns,
                    readout_s,
                    height_px: setup.height_px,
                },
                noise: CameraNoise {
                    sigma_px: FIRST_SIGMA_PX,
                    variance_factor: 1.0,
                    jitter_s: 0.0,
                },
            });
        }
        let reference = rig_cameras
            .iter()
            .position(|c| *c == rig.reference)
            .ok_or_else(|| CalibrationError::NoCommonPitches {
                camera: rig.reference_camera().id.clone(),
            })?;
        let flight = FlightOptions::for_site(&rig.site, start.world);
        let mut problem = Self {
            rig_cameras,
            reference,
            columns: Vec::new(),
            terms: CameraTerms::default(),
            world: start.world,
            flight,
        };
        let flights = problem.start_flights(&cameras, pitches);
        if flights.len() < options.pitches_needed {
            return Err(CalibrationError::TooFewPitches {
                found: flights.len(),
                needed: options.pitches_needed,
            });
        }
        problem.columns = problem.free_columns(rig, pitches, options);
        problem.terms = CameraTerms::new(rig, &problem, &cameras, options);
        Ok((problem, JointState { cameras, flights }))
    }

    fn start_flights(&self, cameras: &[CameraModel], pitches: &[PitchTracks]) -> Vec<FlightUnknown> {
        let mut flights = Vec::new();
        for (pitch, tracks) in pitches.iter().enumerate() {
            let sightings = sightings(cameras, tracks);
            let mut seen: Vec<_> = sightings.iter().map(|s| s.camera).collect();
            seen.sort_unstable();
            seen.dedup();
            if seen.len() < 2 || sightings.len() < 12 {
                continue;
            }
            if let Some(state) = start_flight(cameras, &sightings, &self.flight) {
                flights.push(FlightUnknown {
                    pitch,
                    state,
                    sightings,
                });
            }
        }
        flights
    }

    /// Which unknowns each camera has.
    fn free_columns(&self, rig: &Rig, pitches: &[PitchTracks], options: &JointOptions) -> Vec<Column> {
        let span_s = stamp_span_s(pitches);
        let mut columns = Vec::new();
        for (camera, rig_index) in self.rig_cameras.iter().enumerate() {
            let setup = &rig.cameras[*rig_index];
            let is_reference = camera == self.reference;
            let drift_frames = 1e-6 * options.skew_sigma_ppm * span_s * setup.frame_rate_hz;
            for (kind, parameter) in CAMERA_KINDS.iter().enumerate() {
                let free = match parameter {
                    ParameterKind::CaptureDelay => !is_reference,
                    ParameterKind::ClockSkew => !is_reference && drift_frames > options.drift_noticed_frames,
                    ParameterKind::Readout => setup.rolling_shutter == RollingShutter::Estimate,
                    ParameterKind::FocalScale => setup.focal_sigma_relative > 0.0,
                    ParameterKind::PrincipalX | ParameterKind::PrincipalY => false,
                    _ => true,
                };
                if free {
                    columns.push(Column { camera, kind });
                }
            }
        }
        columns
    }

    /// Takes an unknown out: it keeps its present value.
    pub(super) fn fix(&mut self, camera: usize, parameter: ParameterKind) {
        self.columns
            .retain(|c| c.camera != camera || c.parameter() != parameter);
    }
}

/// Every point of the pitch that a camera of the problem saw.
pub(super) fn sightings(cameras: &[CameraModel], pitch: &PitchTracks) -> Vec<Sighting> {
    let mut all = Vec::new();
    for (track, t) in pitch.tracks.iter().enumerate() {
        if let Some(camera) = cameras.iter().position(|c| c.id == t.camera) {
            all.extend(t.points.iter().map(|p| Sighting {
                camera,
                track,
                point: *p,
            }));
        }
    }
    all
}

/// A first flight through the points, rigid physics.
pub(super) fn start_flight(
    cameras: &[CameraModel],
    sightings: &[Sighting],
    options: &FlightOptions,
) -> Option<FlightState> {
    let epoch_ns = crate::flight::solve::epoch(sightings);
    let (path, median_px) = linear_start(cameras, sightings, options.physics, epoch_ns)?;
    let first = options.acceleration_levels_mps2.first().copied();
    let mut state = FlightState {
        trajectory: cover(path, options),
        prior: FlightPrior {
            acceleration_sigma_mps2: first.unwrap_or(options.prior.acceleration_sigma_mps2),
            ..options.prior
        },
    };
    let scale = (2.0 * median_px / FIRST_SIGMA_PX).clamp(3.0, 1000.0);
    state
        .descend(cameras, sightings, Loss::Cauchy { scale }, 4)
        .ok()?;
    Some(state)
}

fn stamps(pitches: &[PitchTracks]) -> impl Iterator<Item = i64> + '_ {
    pitches
        .iter()
        .flat_map(|p| &p.tracks)
        .filter_map(|t| t.points.first())
        .map(|p| p.stamped.nanos())
}

fn stamp_span_s(pitches: &[PitchTracks]) -> f64 {
    let first = stamps(pitches).min().unwrap_or(0);
    let last = stamps(pitches).max().unwrap_or(0);
    (last - first) as f64 / crate::time::NANOS_PER_SECOND
}

/// First stamp of a camera: where its delay is stated. The middle would tie the delay less to the skew, but
/// whoever compares delays of a session has its beginning at hand.
fn first_stamp(pitches: &[PitchTracks], camera: &CameraId) -> i64 {
    pitches
        .iter()
        .flat_map(|p| p.of(camera))
        .filter_map(|t| t.points.first())
        .map(|p| p.stamped.nanos())
        .min()
        .unwrap_or(0)
}
