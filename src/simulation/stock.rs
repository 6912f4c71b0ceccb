//! Stock cameras and pitches for scenarios built by a program (tests, benches, studies).

use super::options::LandmarkClicks;
use super::scenario::{CameraSpec, Knuckle, PitchSpec, Scenario};
use crate::geometry::Intrinsics;
use crate::scene::{CameraId, CameraIdError};

/// Where the cameras stand.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Layout {
    /// First-base and third-base dugout sides.
    TwoOpposite,
    /// Both on the first-base side, 8 m apart.
    TwoSameSide,
    /// Both dugout sides and high behind home.
    Three,
}

impl Layout {
    /// Cameras of 2048×1024 at 175 fps with mild barrel distortion; delays in frames of all but the first,
    /// which is the reference (missing ones are 0).
    pub fn cameras(self, delays_frames: &[f64]) -> Vec<CameraSpec> {
        let places: &[(&str, [f64; 3], [f64; 3], f64)] = match self {
            Self::TwoOpposite => &[FIRST, THIRD],
            Self::TwoSameSide => &[FIRST, FIRST_FAR],
            Self::Three => &[FIRST, THIRD, HOME],
        };
        let delays = std::iter::once(&0.0)
            .chain(delays_frames)
            .chain(std::iter::repeat(&0.0));
        places
            .iter()
            .zip(delays)
            .filter_map(|((id, position_m, look_at_m, focal_px), delay)| {
                let camera = stock_camera(id, *position_m, *look_at_m, *focal_px).ok()?;
                Some(camera.with_delay_frames(*delay))
            })
            .collect()
    }
}

const FIRST: (&str, [f64; 3], [f64; 3], f64) = ("first", [20.1, 6.2, 3.3], [0.0, 8.6, 0.9], 1790.0);
const THIRD: (&str, [f64; 3], [f64; 3], f64) = ("third", [-19.4, 7.4, 3.6], [0.0, 8.8, 1.0], 1810.0);
const FIRST_FAR: (&str, [f64; 3], [f64; 3], f64) = ("first_far", [17.6, 14.3, 3.1], [0.0, 8.4, 0.9], 1620.0);
const HOME: (&str, [f64; 3], [f64; 3], f64) = ("home", [1.4, -15.5, 8.2], [-0.1, 9.0, 0.6], 2350.0);

/// A 2048×1024, 175 fps camera with 1 ms exposure and mild barrel distortion.
pub fn stock_camera(
    id: &str,
    position_m: [f64; 3],
    look_at_m: [f64; 3],
    focal_px: f64,
) -> Result<CameraSpec, CameraIdError> {
    Ok(CameraSpec {
        id: CameraId::new(id)?,
        reference: false,
        width_px: 2048,
        height_px: 1024,
        frame_rate_hz: 175.0,
        exposure_s: 0.001,
        intrinsics: Intrinsics {
            fx_px: focal_px,
            fy_px: focal_px,
            cx_px: 1031.4,
            cy_px: 505.2,
            distortion: [-0.083, 0.021, 0.0004, -0.0003, 0.0],
        },
        position_m,
        look_at_m,
        roll_deg: 0.0,
        capture_delay_s: 0.0,
        capture_delay_frames: 0.0,
        clock_offset_s: 0.0,
        clock_skew_ppm: 0.0,
        stamp_phase_s: 0.0,
        jitter_s: 0.0,
        drop_probability: 0.0,
        repeat_stamp_probability: 0.0,
        readout_s: 0.0,
        rough_offset_error_s: None,
        survey_sigma_m: None,
    })
}

/// Type, release (m), speed (m/s), spin (rpm), tilt (°), active share.
type Arsenal = (&'static str, [f64; 3], f64, [f64; 3]);

const ARSENAL: [Arsenal; 8] = [
    ("FF", [-0.55, 16.60, 1.83], 42.6, [2350.0, 208.0, 0.95]),
    ("SI", [-0.67, 16.65, 1.74], 41.7, [2150.0, 232.0, 0.90]),
    ("SL", [-0.60, 16.75, 1.78], 38.3, [2450.0, 118.0, 0.38]),
    ("CU", [-0.48, 16.80, 1.90], 35.4, [2650.0, 42.0, 0.82]),
    ("CH", [-0.62, 16.62, 1.76], 37.8, [1750.0, 238.0, 0.92]),
    ("FC", [0.58, 16.70, 1.81], 40.3, [2400.0, 195.0, 0.50]),
    ("KN", [-0.45, 16.75, 1.80], 31.2, [0.0, 0.0, 0.0]),
    ("EP", [-0.40, 16.85, 1.75], 25.1, [1400.0, 15.0, 0.60]),
];

/// Plate points that go round the zone, x and z in metres.
const TARGETS: [[f64; 2]; 8] = [
    [0.10, 0.95],
    [-0.22, 0.55],
    [0.28, 0.50],
    [0.02, 0.40],
    [-0.18, 0.62],
    [0.20, 0.85],
    [0.00, 0.75],
    [-0.05, 0.60],
];

/// Seconds between pitches: uneven, as a pitcher's rhythm is.
const PAUSES_S: [f64; 8] = [14.2, 17.9, 12.6, 21.3, 15.4, 19.1, 13.3, 16.7];

/// `count` real-shaped pitches: four-seamer, sinker, slider, curve, change-up, cutter, knuckleball, eephus, and
/// round again with other targets.
pub fn stock_pitches(count: usize) -> Vec<PitchSpec> {
    let mut start_s = 3.0;
    let arsenal = ARSENAL.iter().cycle();
    let pauses = PAUSES_S.iter().cycle();
    let mut pitches = Vec::with_capacity(count);
    for (i, ((name, release, speed, spin), pause)) in arsenal.zip(pauses).take(count).enumerate() {
        let target = TARGETS[(i + i / TARGETS.len()) % TARGETS.len()];
        let [rpm, axis, active] = *spin;
        let knuckle = (*name == "KN").then_some(Knuckle {
            amplitude: [0.11, 0.09],
            frequency_hz: 2.6,
            phase_deg: [25.0, 140.0],
        });
        pitches.push(PitchSpec {
            name: (*name).to_owned(),
            start_s: Some(start_s),
            release_m: Some(*release),
            speed_mps: Some(*speed),
            target_m: Some(target),
            spin_rpm: (rpm > 0.0).then_some(rpm),
            spin_axis_deg: (rpm > 0.0).then_some(axis),
            active_spin: (rpm > 0.0).then_some(active),
            knuckle,
            ..PitchSpec::default()
        });
        start_s += pause;
    }
    pitches
}

impl Scenario {
    /// Stock cameras with these delays (frames; first camera left out) and `pitches` stock pitches.
    pub fn stock(layout: Layout, delays_frames: &[f64], pitches: usize) -> Self {
        Self::new(layout.cameras(delays_frames), stock_pitches(pitches))
    }

    /// The same scenario without clicked landmarks.
    #[must_use]
    pub fn without_landmarks(mut self) -> Self {
        self.landmarks = LandmarkClicks::none();
        self
    }
}
