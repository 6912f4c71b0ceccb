//! A pitch from a solved flight: every number of `pitches.jsonl`, with its sigma and what is weak about it.

use std::collections::BTreeMap;

use super::gate::check_pitch;
use super::nine_parameter::{FOOT_M, MPH_MPS, PLATE_FRONT_Y_FT, STATCAST_GRAVITY_FTPS2};
use super::numbers::{
    NineParameterView, NumbersError, PLATE_FRONT_Y_M, PLATE_MIDDLE_Y_M, PlaneState, RELEASE_Y_M,
    nine_parameter_view, position_sigma_m, state_at_plane,
};
use super::outcome::SolvedFlight;
use super::trajectory::DRAG_ROW;
use super::zone::StrikeZone;
use crate::scene::{FlightSample, Pitch, PitchQuality, PitchSigma, StatcastRow};
use crate::time::TrueMidpoint;

/// Standing height of the batter where nobody said, metres: 6 ft.
const DEFAULT_BATTER_HEIGHT_M: f64 = 1.83;
/// From this 1σ at the plate on, the location is not one to call a pitch by: a ball's radius is 37 mm.
const WEAK_PLATE_SIGMA_M: f64 = 0.020;
/// From here on it is no location at all.
const USELESS_PLATE_SIGMA_M: f64 = 0.150;
/// Points this far off the flight, and this many times farther than when the cameras were calibrated, tell of
/// cameras that stand elsewhere.
const FAR_OFF_PX: f64 = 1.0;
/// ... and above this, in pixels, something is not as it was: a clock, most likely.
const OFF_PX: f64 = 0.25;
const FAR_OFF_RATIO: f64 = 5.0;
/// The ball must have been followed to this close to the plate, or the last part is extrapolated.
const FOLLOWED_TO_Y_M: f64 = 3.0;

/// What a pitch needs beside its flight.
#[derive(Debug, Clone, PartialEq)]
pub struct PitchOptions {
    /// y at which release is stated, metres.
    pub release_y_m: f64,
    /// Zone for margin and probability.
    pub zone: StrikeZone,
    /// Rate at which the flight is sampled, Hz: the reference camera's.
    pub sample_rate_hz: f64,
    /// Version of the calibration the flight was solved with.
    pub calibration_version: u32,
    /// Root mean square reprojection error of the calibration's own points, pixels; 0: not told.
    pub calibration_rms_px: f64,
    /// What is doubtful about every pitch of this calibration.
    pub doubts: Vec<(PitchQuality, String)>,
}

impl Default for PitchOptions {
    fn default() -> Self {
        Self {
            release_y_m: RELEASE_Y_M,
            zone: StrikeZone::for_height(DEFAULT_BATTER_HEIGHT_M),
            sample_rate_hz: 175.0,
            calibration_version: 1,
            calibration_rms_px: 0.0,
            doubts: Vec::new(),
        }
    }
}

/// Makes pitch number `pitch` of a flight in the home-plate frame.
///
/// # Errors
/// [`NumbersError`] for a flight that is no pitch: it misses a plane, or flies away from the plate.
pub fn pitch_from_flight(
    flight: &SolvedFlight,
    pitch: u32,
    options: &PitchOptions,
) -> Result<Pitch, NumbersError> {
    let (path, covariance) = (&flight.trajectory, &flight.covariance);
    let release = state_at_plane(path, covariance, (options.release_y_m, "release"))?;
    let front = state_at_plane(path, covariance, (PLATE_FRONT_Y_M, "front of the plate"))?;
    let middle = state_at_plane(path, covariance, (PLATE_MIDDLE_Y_M, "middle of the plate"))?;
    check_pitch(flight, (options.release_y_m, &release), &front)?;
    let view = nine_parameter_view(path, covariance, options.release_y_m)?;
    let plate_mid_m = [middle.position_m.x, middle.position_m.z];
    let mid_covariance = middle.xz_covariance_m2();
    let true_ns = |t: f64| TrueMidpoint::from_seconds_since(path.epoch_ns(), t).nanos();
    let mut points = BTreeMap::new();
    let mut outliers = BTreeMap::new();
    for track in &flight.tracks {
        *points.entry(track.camera.clone()).or_insert(0) += track.kept;
        *outliers.entry(track.camera.clone()).or_insert(0) += track.outliers;
    }
    outliers.retain(|_, n| *n > 0);
    let drag_sigma = covariance[(DRAG_ROW, DRAG_ROW)].max(0.0).sqrt();
    let mut made = Pitch {
        pitch,
        cameras: flight.cameras(),
        release_time_ns: true_ns(release.time_s),
        plate_time_ns: true_ns(front.time_s),
        release_m: release.position_m.into(),
        release_velocity_mps: release.velocity_mps.into(),
        release_speed_mps: release.speed_mps,
        release_y_m: options.release_y_m,
        first_seen_y_m: path.position_m(flight.observed_s.0).y,
        plate_front_m: [front.position_m.x, front.position_m.z],
        plate_mid_m,
        plate_velocity_mps: front.velocity_mps.into(),
        sigma: sigmas(&release, &front, &middle, &view),
        plate_mid_covariance_m2: [
            [mid_covariance[(0, 0)], mid_covariance[(0, 1)]],
            [mid_covariance[(1, 0)], mid_covariance[(1, 1)]],
        ],
        strike_margin_m: options.zone.margin_m(plate_mid_m[0], plate_mid_m[1]),
        strike_probability: options.zone.strike_probability(plate_mid_m, &mid_covariance),
        drag_coefficient: [path.aerodynamics().drag_coefficient, drag_sigma],
        flight: samples(flight, release.time_s, options.sample_rate_hz),
        statcast: statcast(&release, &front, &view, options),
        reprojection_rms_px: flight.rms_px(),
        points,
        outliers,
        calibration_version: options.calibration_version,
        quality: PitchQuality::Good,
        reasons: Vec::new(),
    };
    judge(&mut made, flight, options);
    Ok(made)
}

fn sigmas(
    release: &PlaneState,
    front: &PlaneState,
    middle: &PlaneState,
    view: &NineParameterView,
) -> PitchSigma {
    PitchSigma {
        release_m: std::array::from_fn(|i| release.sigma(i)),
        release_velocity_mps: std::array::from_fn(|i| release.sigma(3 + i)),
        release_speed_mps: release.sigma(6),
        plate_front_m: [front.sigma(0), front.sigma(2)],
        plate_mid_m: [middle.sigma(0), middle.sigma(2)],
        plate_velocity_mps: std::array::from_fn(|i| front.sigma(3 + i)),
        plate_time_s: front.sigma(7),
        pfx_m: view.movement_sigma_ft.map(|s| s * FOOT_M),
    }
}

/// From the first point seen (or release, if that is earlier) to the plate's back tip.
fn samples(flight: &SolvedFlight, release_s: f64, rate_hz: f64) -> Vec<FlightSample> {
    let path = &flight.trajectory;
    let (span_begin, span_end) = path.span_s();
    let begin = flight.observed_s.0.min(release_s).max(span_begin);
    let end = path.time_at_y(0.0).unwrap_or(span_end);
    sampled(flight, (begin, end), rate_hz)
}

/// A flight in any world, from the first point seen to the last.
pub fn flight_samples(flight: &SolvedFlight, rate_hz: f64) -> Vec<FlightSample> {
    sampled(flight, flight.observed_s, rate_hz)
}

fn sampled(flight: &SolvedFlight, (begin, end): (f64, f64), rate_hz: f64) -> Vec<FlightSample> {
    let path = &flight.trajectory;
    let count = ((end - begin) * rate_hz).floor().clamp(0.0, 100_000.0) as usize;
    (0..=count)
        .map(|i| {
            let t = begin + i as f64 / rate_hz;
            FlightSample {
                time_ns: TrueMidpoint::from_seconds_since(path.epoch_ns(), t).nanos(),
                position_m: path.position_m(t).into(),
                sigma_m: position_sigma_m(path, &flight.covariance, t),
            }
        })
        .collect()
}

/// Statcast's columns in Statcast's units (domain §4). Speed and release are those of the solved flight, the
/// nine parameters and the movement those of its 9P view.
fn statcast(
    release: &PlaneState,
    front: &PlaneState,
    view: &NineParameterView,
    options: &PitchOptions,
) -> StatcastRow {
    let feet = |m: f64| m / FOOT_M;
    let nine = &view.nine;
    let (plate_x, plate_z) = (feet(front.position_m.x), feet(front.position_m.z));
    let release_y_ft = feet(release.position_m.y);
    let mut row = StatcastRow::new();
    let mut put = |name: &str, value: f64| {
        if value.is_finite() {
            row.insert(name.to_owned(), value);
        }
    };
    put("release_speed", release.speed_mps / MPH_MPS);
    put("release_pos_x", feet(release.position_m.x));
    put("release_pos_y", release_y_ft);
    put("release_pos_z", feet(release.position_m.z));
    put("release_extension", 60.5 - release_y_ft);
    for (name, value) in [
        ("x0", nine.position_ft.x),
        ("z0", nine.position_ft.z),
        ("vx0", nine.velocity_ftps.x),
        ("vy0", nine.velocity_ftps.y),
        ("vz0", nine.velocity_ftps.z),
        ("ax", nine.acceleration_ftps2.x),
        ("ay", nine.acceleration_ftps2.y),
        ("az", nine.acceleration_ftps2.z),
    ] {
        put(name, value);
    }
    put("plate_x", plate_x);
    put("plate_z", plate_z);
    put("pfx_x", view.movement.x_ft);
    put("pfx_z", view.movement.z_ft);
    // Inferred from movement: 180° pure backspin, 0° topspin, as the catcher sees the axis tilt.
    let tilt = view.movement.x_ft.atan2(-view.movement.z_ft).to_degrees();
    put("spin_axis", tilt.rem_euclid(360.0));
    put("sz_top", feet(options.zone.top_m));
    put("sz_bot", feet(options.zone.bottom_m));
    put("zone", f64::from(options.zone.statcast_zone(plate_x, plate_z)));
    let flight_s = nine
        .time_at_y(PLATE_FRONT_Y_FT)
        .zip(nine.time_at_y(release_y_ft))
        .map_or(f64::NAN, |(plate, start)| plate - start);
    let drop_ft = 0.5 * STATCAST_GRAVITY_FTPS2 * flight_s * flight_s;
    put("api_break_z_with_gravity", drop_ft - view.movement.z_ft);
    put("plate_time", flight_s);
    put("plate_speed", front.speed_mps / MPH_MPS);
    row
}

/// Whether points are so far off their flight that the cameras must stand elsewhere than the calibration says.
pub fn is_far_off(rms_px: f64, usual_px: f64) -> bool {
    rms_px > FAR_OFF_PX && rms_px > FAR_OFF_RATIO * usual_px
}

/// Sets quality and reasons.
fn judge(pitch: &mut Pitch, flight: &SolvedFlight, options: &PitchOptions) {
    let mut reasons = Vec::new();
    let mut quality = PitchQuality::Good;
    let mut note = |worst: PitchQuality, reason: String| {
        quality = match (quality, worst) {
            (PitchQuality::Poor, _) | (_, PitchQuality::Poor) => PitchQuality::Poor,
            _ => PitchQuality::Degraded,
        };
        reasons.push(reason);
    };
    if let [only] = pitch.cameras.as_slice() {
        note(
            PitchQuality::Poor,
            format!("only camera {only} saw it: depth comes from the drag alone"),
        );
    }
    let [sigma_x, sigma_z] = pitch.sigma.plate_mid_m;
    let sigma = sigma_x.max(sigma_z);
    if !(sigma < USELESS_PLATE_SIGMA_M) {
        note(
            PitchQuality::Poor,
            format!("plate location is only good to {:.0} mm", 1e3 * sigma),
        );
    } else if sigma > WEAK_PLATE_SIGMA_M {
        note(
            PitchQuality::Degraded,
            format!("plate location is only good to {:.0} mm", 1e3 * sigma),
        );
    }
    for (worst, doubt) in &options.doubts {
        note(*worst, doubt.clone());
    }
    let (rms_px, usual_px) = (pitch.reprojection_rms_px, options.calibration_rms_px);
    if is_far_off(rms_px, usual_px) {
        let reason = format!(
            "its points lie {rms_px:.1} px off the flight, {usual_px:.2} px in the calibration: a camera has moved, or it is another rig's calibration"
        );
        note(PitchQuality::Poor, reason);
    } else if rms_px > OFF_PX && rms_px > FAR_OFF_RATIO * usual_px {
        let reason = format!(
            "its points lie {rms_px:.2} px off the flight, {usual_px:.2} px in the calibration: a camera's clock or pose has moved a little"
        );
        note(PitchQuality::Degraded, reason);
    }
    let last_y = flight.trajectory.position_m(flight.observed_s.1).y;
    if last_y > FOLLOWED_TO_Y_M {
        let reason = format!("last seen {last_y:.1} m before the plate: the end is extrapolated");
        note(PitchQuality::Degraded, reason);
    }
    let (kept, lost): (usize, usize) = (pitch.points.values().sum(), pitch.outliers.values().sum());
    if 4 * lost > kept {
        note(
            PitchQuality::Degraded,
            format!("{lost} of {} points did not fit", kept + lost),
        );
    }
    pitch.quality = quality;
    pitch.reasons = reasons;
}
