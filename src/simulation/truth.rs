//! The truth beside every product: cameras, clocks, flights and every centre.

use serde::Serialize;

use super::clock;
use super::scenario::Scenario;
use super::throw::{PLATE_FRONT_Y_M, PLATE_MIDDLE_Y_M, RELEASE_PLANE_Y_M, ThrownBall, throw};
use super::{SimulationError, clock::CameraClock};
use crate::geometry::{Intrinsics, Pixel, Pose};
use crate::scene::CameraId;
use crate::time::StampedMidpoint;

/// A camera as it truly is.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CameraTruth {
    /// Name.
    pub id: CameraId,
    /// Pose.
    pub camera_from_world: Pose,
    /// Centre, metres.
    pub position_m: [f64; 3],
    /// τ, seconds.
    pub capture_delay_s: f64,
    /// ppm, positive: fast.
    pub clock_skew_ppm: f64,
    /// Stamp at which τ is stated.
    pub skew_epoch_ns: i64,
    /// Rolling shutter, seconds.
    pub readout_s: f64,
    /// Frame rate, Hz.
    pub frame_rate_hz: f64,
    /// Exposure, seconds.
    pub exposure_s: f64,
    /// Lens.
    pub intrinsics: Intrinsics,
    /// Columns.
    pub width_px: u32,
    /// Rows.
    pub height_px: u32,
}

/// A sample of a true flight.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TrueSample {
    /// True time, nanoseconds.
    pub time_ns: i64,
    /// Metres.
    pub position_m: [f64; 3],
    /// m/s.
    pub velocity_mps: [f64; 3],
}

/// A ball as it truly flew. The plate and release planes are `None` where the flight does not pass them.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PitchTruth {
    /// Number, from 1.
    pub pitch: u32,
    /// Type.
    pub name: String,
    /// True time of the hand's release, nanoseconds.
    pub start_time_ns: i64,
    /// Position there, metres.
    pub start_m: [f64; 3],
    /// Velocity there, m/s.
    pub start_velocity_mps: [f64; 3],
    /// End of the flight (glove), nanoseconds.
    pub end_time_ns: i64,
    /// True time at y = 54.5 ft (before the hand's release when that is nearer), nanoseconds.
    pub release_time_ns: Option<i64>,
    /// Position at y = 54.5 ft, metres.
    pub release_m: Option<[f64; 3]>,
    /// Velocity at y = 54.5 ft, m/s.
    pub release_velocity_mps: Option<[f64; 3]>,
    /// Speed at y = 54.5 ft, m/s.
    pub release_speed_mps: Option<f64>,
    /// True time at y = 17/12 ft, nanoseconds.
    pub plate_time_ns: Option<i64>,
    /// x and z at y = 17/12 ft, metres.
    pub plate_front_m: Option<[f64; 2]>,
    /// x and z at y = 8.5/12 ft, metres.
    pub plate_mid_m: Option<[f64; 2]>,
    /// Velocity at y = 17/12 ft, m/s.
    pub plate_velocity_mps: Option<[f64; 3]>,
    /// Cd.
    pub drag_coefficient: f64,
    /// Spin vector, rpm, where there is one.
    pub spin_rpm: Option<[f64; 3]>,
    /// Every 2 ms from release to glove.
    pub flight: Vec<TrueSample>,
}

/// Where a ball's centre truly is in one frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrueCentre {
    /// Number of the pitch; throws go on counting after the last pitch.
    pub pitch: u32,
    /// Frame number.
    pub frame: u64,
    /// Stamp of the frame.
    pub stamped: StampedMidpoint,
    /// Centre at the exposure midpoint, distorted pixels.
    pub pixel: Pixel,
    /// In the picture, in flight and not hidden.
    pub visible: bool,
    /// Radius in the picture, pixels.
    pub radius_px: f64,
    /// Velocity in the picture, px/s.
    pub velocity_pxps: [f64; 2],
}

/// Centres of one camera, by frame.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraCentres {
    /// Whose.
    pub camera: CameraId,
    /// By rising frame within a pitch.
    pub centres: Vec<TrueCentre>,
}

/// All truth of one simulated session.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Truth {
    /// Scenario seed.
    pub seed: u64,
    /// True time 0, nanoseconds.
    pub epoch_ns: i64,
    /// The camera with τ = 0.
    pub reference: CameraId,
    /// m/s².
    pub gravity_mps2: f64,
    /// Cameras in rig order.
    pub cameras: Vec<CameraTruth>,
    /// Pitches.
    pub pitches: Vec<PitchTruth>,
    /// Balls that are no pitches.
    pub throws: Vec<PitchTruth>,
    /// The flights themselves: pitches, then throws.
    #[serde(skip)]
    pub balls: Vec<ThrownBall>,
    /// Centres of every camera.
    #[serde(skip)]
    pub centres: Vec<CameraCentres>,
}

impl Truth {
    /// A camera's truth.
    pub fn camera(&self, id: &CameraId) -> Option<&CameraTruth> {
        self.cameras.iter().find(|c| c.id == *id)
    }
    /// A camera's true centres.
    pub fn centres_of(&self, id: &CameraId) -> &[TrueCentre] {
        let found = self.centres.iter().find(|c| c.camera == *id);
        found.map_or(&[], |c| &c.centres)
    }
}

/// The true flights of a scenario: pitches, then throws.
pub(super) fn balls(scenario: &Scenario) -> Result<Vec<ThrownBall>, SimulationError> {
    let mut all = Vec::with_capacity(scenario.pitches.len() + scenario.throws.len());
    for (i, spec) in scenario.pitches.iter().enumerate() {
        all.push(throw(
            spec,
            scenario.start_s(i),
            &scenario.site,
            &format!("pitch[{i}]"),
        )?);
    }
    for (i, spec) in scenario.throws.iter().enumerate() {
        let key = format!("throw[{i}]");
        let missing = || SimulationError::value(format!("{key}.start_s"), "a throw needs its start");
        let start_s = spec.start_s.ok_or_else(missing)?;
        all.push(throw(spec, start_s, &scenario.site, &key)?);
    }
    Ok(all)
}

/// The truth of a scenario.
pub(super) fn truth(scenario: &Scenario) -> Result<Truth, SimulationError> {
    let balls = balls(scenario)?;
    let describe = |(i, ball): (usize, &ThrownBall)| pitch_truth(i as u32 + 1, ball, scenario.epoch_ns);
    let described: Vec<PitchTruth> = balls.iter().enumerate().map(describe).collect();
    let (pitches, throws) = described.split_at(scenario.pitches.len());
    let centres = scenario
        .cameras
        .iter()
        .enumerate()
        .map(|(i, camera)| CameraCentres {
            camera: camera.id.clone(),
            centres: centres(scenario, i, &balls),
        })
        .collect();
    let reference = scenario.cameras.get(scenario.reference()).map(|c| c.id.clone());
    Ok(Truth {
        seed: scenario.seed,
        epoch_ns: scenario.epoch_ns,
        reference: reference.ok_or_else(|| SimulationError::value("camera", "at least one is needed"))?,
        gravity_mps2: scenario.site.gravity_mps2,
        cameras: camera_truths(scenario),
        pitches: pitches.to_vec(),
        throws: throws.to_vec(),
        balls,
        centres,
    })
}

fn camera_truths(scenario: &Scenario) -> Vec<CameraTruth> {
    let describe = |camera: &super::scenario::CameraSpec| {
        let timing = clock::timing(scenario, camera);
        CameraTruth {
            id: camera.id.clone(),
            camera_from_world: camera.pose(),
            position_m: camera.position_m,
            capture_delay_s: timing.capture_delay_s,
            clock_skew_ppm: timing.clock_skew_ppm,
            skew_epoch_ns: timing.skew_epoch_ns,
            readout_s: timing.readout_s,
            frame_rate_hz: camera.frame_rate_hz,
            exposure_s: camera.exposure_s,
            intrinsics: camera.intrinsics,
            width_px: camera.width_px,
            height_px: camera.height_px,
        }
    };
    scenario.cameras.iter().map(describe).collect()
}

fn pitch_truth(number: u32, ball: &ThrownBall, epoch_ns: i64) -> PitchTruth {
    let nanos = |t: f64| epoch_ns + ((ball.start_s + t) * 1e9).round() as i64;
    let flight = &ball.flight;
    let at_y = |y: f64| flight.time_at_y(y).map(|t| (t, flight.state(t)));
    let (release, front, middle) = (
        at_y(RELEASE_PLANE_Y_M),
        at_y(PLATE_FRONT_Y_M),
        at_y(PLATE_MIDDLE_Y_M),
    );
    let start = flight.state(0.0);
    let samples = (flight.end_s / 0.002).floor() as usize;
    PitchTruth {
        pitch: number,
        name: ball.name.clone(),
        start_time_ns: nanos(0.0),
        start_m: start.position_m.coords.into(),
        start_velocity_mps: start.velocity_mps.into(),
        end_time_ns: nanos(flight.end_s),
        release_time_ns: release.map(|(t, _)| nanos(t)),
        release_m: release.map(|(_, s)| s.position_m.coords.into()),
        release_velocity_mps: release.map(|(_, s)| s.velocity_mps.into()),
        release_speed_mps: release.map(|(_, s)| s.velocity_mps.norm()),
        plate_time_ns: front.map(|(t, _)| nanos(t)),
        plate_front_m: front.map(|(_, s)| [s.position_m.x, s.position_m.z]),
        plate_mid_m: middle.map(|(_, s)| [s.position_m.x, s.position_m.z]),
        plate_velocity_mps: front.map(|(_, s)| s.velocity_mps.into()),
        drag_coefficient: ball.drag_coefficient,
        spin_rpm: ball.spin_rpm,
        flight: (0..=samples)
            .map(|i| {
                let t = 0.002 * i as f64;
                let state = flight.state(t);
                TrueSample {
                    time_ns: nanos(t),
                    position_m: state.position_m.coords.into(),
                    velocity_mps: state.velocity_mps.into(),
                }
            })
            .collect(),
    }
}

/// A ball as one camera sees it at one instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Sight {
    pub pixel: Pixel,
    pub velocity_pxps: [f64; 2],
    pub radius_px: f64,
}

/// Projects a ball at a true time; `None` behind the camera or where the lens model folds.
pub(super) fn sight(pose: &Pose, lens: &Intrinsics, ball: &ThrownBall, true_s: f64) -> Option<Sight> {
    let state = ball.flight.state(true_s - ball.start_s);
    let camera = pose.transform(&state.position_m);
    let seen = lens.project_with_jacobian(&camera).ok()?;
    let back = lens.direction(seen.pixel).ok()?;
    // Far outside the picture a barrel lens folds back into it.
    if (back.x - camera.x / camera.z).abs() + (back.y - camera.y / camera.z).abs() > 1e-6 {
        return None;
    }
    let velocity = seen.by_camera_point * (pose.rotation * state.velocity_mps);
    // Radius of the circle with the area of the projected disc facing the camera.
    let across = seen.by_camera_point.fixed_view::<2, 2>(0, 0).determinant();
    Some(Sight {
        pixel: seen.pixel,
        velocity_pxps: velocity.into(),
        radius_px: crate::scene::BALL_RADIUS_M * across.abs().sqrt(),
    })
}

/// True exposure midpoint of the ball itself: under a rolling shutter, that of the row it is in.
pub(super) fn sight_in_frame(
    pose: &Pose,
    lens: &Intrinsics,
    clock: &CameraClock,
    ball: &ThrownBall,
    frame: u64,
) -> Option<(f64, Sight)> {
    let mut row = 0.5 * (f64::from(clock.timing().height_px) - 1.0);
    let rounds = if clock.timing().readout_s == 0.0 { 1 } else { 8 };
    let mut found = None;
    for _ in 0..rounds {
        let true_s = clock.true_s(frame, row);
        let seen = sight(pose, lens, ball, true_s)?;
        row = seen.pixel.y;
        found = Some((true_s, seen));
    }
    found
}

fn centres(scenario: &Scenario, index: usize, balls: &[ThrownBall]) -> Vec<TrueCentre> {
    let Some(camera) = scenario.cameras.get(index) else {
        return Vec::new();
    };
    let clock = CameraClock::new(scenario, index, camera);
    let (pose, lens) = (camera.pose(), camera.intrinsics);
    let (right, bottom) = (
        f64::from(camera.width_px) - 0.5,
        f64::from(camera.height_px) - 0.5,
    );
    let mut all = Vec::new();
    for (number, ball) in (1u32..).zip(balls) {
        let (begin_s, end_s) = ball.span_s();
        for frame in clock.frames_within(begin_s, end_s) {
            let exposure = clock.exposure(frame);
            let Some((true_s, seen)) = sight_in_frame(&pose, &lens, &clock, ball, frame) else {
                continue;
            };
            if exposure.lost || true_s < begin_s || true_s > end_s {
                continue;
            }
            let Pixel { x, y } = seen.pixel;
            all.push(TrueCentre {
                pitch: number,
                frame,
                stamped: exposure.stamped,
                pixel: seen.pixel,
                visible: x >= -0.5 && y >= -0.5 && x < right && y < bottom,
                radius_px: seen.radius_px,
                velocity_pxps: seen.velocity_pxps,
            });
        }
    }
    all
}
