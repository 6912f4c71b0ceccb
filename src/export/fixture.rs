//! Pitches for this room's tests, from the nine parameters of real ones (domain §4).

use std::collections::BTreeMap;

use nalgebra::{Point3, Vector3};

use crate::flight::{FOOT_M, MPH_MPS, NineParameter, PLATE_FRONT_Y_FT, PLATE_MIDDLE_Y_FT, StrikeZone};
use crate::geometry::{Intrinsics, Pose};
use crate::scene::{
    Calibration, CalibrationMethod, CameraCalibration, CameraId, CameraSetup, FieldPreset, FlightSample,
    Motion, Parameter, ParameterKind, Pitch, PitchQuality, PitchSigma, Rig, RollingShutter, Site, WorldFrame,
};

/// A real pitch: type, x0 z0 vx0 vy0 vz0 ax ay az, release y; feet and seconds.
pub(super) struct RealPitch(pub &'static str, pub [f64; 8], pub f64);

/// The six pitches of domain §4.
pub(super) const REAL: [RealPitch; 6] = [
    RealPitch(
        "RHP FF",
        [
            -0.9001, 6.1657, 3.8351, -128.8867, -6.0460, -3.8055, 27.5059, -12.9495,
        ],
        54.31,
    ),
    RealPitch(
        "RHP CU",
        [
            -1.1480, 5.9186, 1.2845, -117.0051, -0.0903, 2.3033, 21.7438, -38.0715,
        ],
        53.96,
    ),
    RealPitch(
        "LHP CH",
        [
            0.9814, 5.5593, -3.6367, -120.7126, -2.7090, 12.4747, 23.6924, -25.7908,
        ],
        54.35,
    ),
    RealPitch(
        "RHP SL",
        [
            -1.9511, 5.7177, 5.1864, -129.1777, -5.6475, 4.9379, 26.1753, -27.6022,
        ],
        54.03,
    ),
    RealPitch(
        "RHP EP",
        [
            -1.1849, 5.7138, 3.5024, -92.1384, 4.6877, 6.3260, 14.8070, -40.6506,
        ],
        55.15,
    ),
    RealPitch(
        "LHP SI",
        [
            1.7936, 6.1527, -3.8655, -128.4064, -4.8056, 14.2663, 25.7934, -21.4067,
        ],
        54.58,
    ),
];

pub(super) fn nine(real: &RealPitch) -> NineParameter {
    let [x0, z0, vx, vy, vz, ax, ay, az] = real.1;
    NineParameter {
        position_ft: Vector3::new(x0, 50.0, z0),
        velocity_ftps: Vector3::new(vx, vy, vz),
        acceleration_ftps2: Vector3::new(ax, ay, az),
    }
}

/// The pitch as the solver would have it, were the flight exactly its nine parameters.
pub(super) fn pitch(number: u32, real: &RealPitch) -> Pitch {
    let nine = nine(real);
    let metres = |v: Vector3<f64>| -> [f64; 3] { (v * FOOT_M).into() };
    let at = |y_ft: f64| nine.time_at_y(y_ft).unwrap();
    let (release_s, front_s) = (at(real.2), at(PLATE_FRONT_Y_FT));
    let front = metres(nine.position(front_s));
    let mid = metres(nine.position(at(PLATE_MIDDLE_Y_FT)));
    let zone = StrikeZone {
        top_m: 3.4 * FOOT_M,
        bottom_m: 1.6 * FOOT_M,
    };
    let covariance = nalgebra::Matrix2::new(9e-6, 2e-6, 2e-6, 4e-6);
    let start_ns = 1_775_001_600_000_000_000 + i64::from(number) * 12_345_678_900;
    let ns = |t: f64| start_ns + ((t - release_s) * 1e9).round() as i64;
    let movement = nine.movement(real.2).unwrap();
    let [vx, vy, vz]: [f64; 3] = nine.velocity_ftps.into();
    let [ax, ay, az]: [f64; 3] = nine.acceleration_ftps2.into();
    let statcast = [
        ("release_speed", nine.speed_at_y_mph(real.2).unwrap()),
        ("release_pos_y", real.2),
        ("x0", nine.position_ft.x),
        ("y0", 50.0),
        ("z0", nine.position_ft.z),
        ("vx0", vx),
        ("vy0", vy),
        ("vz0", vz),
        ("ax", ax),
        ("ay", ay),
        ("az", az),
        ("pfx_x", movement.x_ft),
        ("pfx_z", movement.z_ft),
        ("sz_top", 3.4),
        ("sz_bot", 1.6),
        ("spin_axis", 212.0),
    ];
    Pitch {
        pitch: number,
        cameras: ["first", "third"].map(|c| CameraId::new(c).unwrap()).to_vec(),
        release_time_ns: ns(release_s),
        plate_time_ns: ns(front_s),
        release_m: metres(nine.position(release_s)),
        release_velocity_mps: metres(nine.velocity(release_s)),
        release_speed_mps: nine.velocity(release_s).norm() * FOOT_M,
        release_y_m: real.2 * FOOT_M,
        first_seen_y_m: 17.0,
        plate_front_m: [front[0], front[2]],
        plate_mid_m: [mid[0], mid[2]],
        plate_velocity_mps: metres(nine.velocity(front_s)),
        sigma: PitchSigma {
            release_m: [0.004, 0.02, 0.003],
            release_velocity_mps: [0.03, 0.04, 0.03],
            release_speed_mps: 0.05 * MPH_MPS,
            plate_front_m: [0.0031, 0.0021],
            plate_mid_m: [0.003, 0.002],
            plate_velocity_mps: [0.05, 0.06, 0.05],
            plate_time_s: 5e-5,
            pfx_m: [0.004, 0.004],
        },
        plate_mid_covariance_m2: [[9e-6, 2e-6], [2e-6, 4e-6]],
        strike_margin_m: zone.margin_m(mid[0], mid[2]),
        strike_probability: zone.strike_probability([mid[0], mid[2]], &covariance),
        drag_coefficient: [0.35, 0.02],
        flight: (0..=140)
            .map(|i| {
                let t = release_s + f64::from(i) / 175.0;
                FlightSample {
                    time_ns: ns(t),
                    position_m: metres(nine.position(t)),
                    sigma_m: [0.003, 0.01, 0.003],
                }
            })
            .take_while(|s| s.position_m[1] > 0.0)
            .collect(),
        statcast: statcast.iter().map(|(k, v)| ((*k).to_owned(), *v)).collect(),
        reprojection_rms_px: 0.31,
        points: counts([74, 71]),
        outliers: counts([1, 0]),
        calibration_version: 3,
        quality: if number == 2 {
            PitchQuality::Degraded
        } else {
            PitchQuality::Good
        },
        reasons: if number == 2 {
            vec!["first points <late> & few".to_owned()]
        } else {
            Vec::new()
        },
    }
}

fn counts(values: [usize; 2]) -> BTreeMap<CameraId, usize> {
    ["first", "third"]
        .map(|c| CameraId::new(c).unwrap())
        .into_iter()
        .zip(values)
        .collect()
}

/// All six.
pub(super) fn pitches() -> Vec<Pitch> {
    (1..)
        .zip(&REAL)
        .map(|(number, real)| pitch(number, real))
        .collect()
}

fn intrinsics() -> Intrinsics {
    Intrinsics {
        fx_px: 1790.0,
        fy_px: 1790.0,
        cx_px: 1023.5,
        cy_px: 511.5,
        distortion: [0.0; 5],
    }
}

const PLACES: [(&str, [f64; 3]); 2] = [("first", [14.0, 5.0, 2.5]), ("third", [-14.0, 6.0, 3.0])];

/// Two cameras by the dugouts; the second is `third`.
pub(super) fn rig() -> Rig {
    let camera = |(id, _): &(&str, [f64; 3])| CameraSetup {
        id: CameraId::new(id).unwrap(),
        width_px: 2048,
        height_px: 1024,
        frame_rate_hz: 175.0,
        exposure_s: Some(0.001),
        time_offset_s: None,
        rolling_shutter: RollingShutter::Global,
        intrinsics: intrinsics(),
        focal_sigma_relative: 0.0,
        position: None,
        landmarks: Vec::new(),
        regions: Vec::new(),
        masks: Vec::new(),
    };
    Rig {
        site: Site {
            name: "Bullpen <A> & B".to_owned(),
            field: FieldPreset::Professional,
            motion: Motion::Flight,
            gravity_mps2: 9.80665,
            air_density_kgpm3: 1.194,
        },
        reference: 0,
        cameras: PLACES.iter().map(camera).collect(),
        distances: Vec::new(),
    }
}

/// `third` is 3.21 ms late; the covariance has its delay and the positions of both.
pub(super) fn calibration() -> Calibration {
    use ParameterKind::{CaptureDelay, RotationX, TranslationX, TranslationY, TranslationZ};
    let cameras: Vec<CameraCalibration> = PLACES
        .iter()
        .map(|(id, centre)| CameraCalibration {
            id: CameraId::new(id).unwrap(),
            camera_from_world: Pose::looking_at(Point3::from(*centre), Point3::new(0.0, 8.0, 1.2)),
            capture_delay_s: if *id == "third" { 0.003_21 } else { 0.0 },
            capture_delay_sigma_s: if *id == "third" { 1.2e-5 } else { 0.0 },
            clock_skew_ppm: 0.0,
            skew_epoch_ns: 0,
            network_clock: false,
            readout_s: 0.0,
            intrinsics: intrinsics(),
            width_px: 2048,
            height_px: 1024,
            reprojection_rms_px: 0.31,
            points: 440,
            noise_sigma_px: 0.22,
            jitter_sigma_s: 1.1e-5,
        })
        .collect();
    let parameters: Vec<Parameter> = cameras
        .iter()
        .flat_map(|c| {
            [RotationX, TranslationX, TranslationY, TranslationZ, CaptureDelay].map(|kind| Parameter {
                camera: c.id.clone(),
                kind,
            })
        })
        .collect();
    let variance = |kind: ParameterKind| match kind {
        RotationX => 4e-8,
        CaptureDelay => 1.44e-10,
        _ => 1e-4,
    };
    let covariance = (0..parameters.len())
        .map(|i| {
            (0..parameters.len())
                .map(|j| if i == j { variance(parameters[i].kind) } else { 0.0 })
                .collect()
        })
        .collect();
    Calibration {
        version: 3,
        method: CalibrationMethod::Joint,
        reference: CameraId::new("first").unwrap(),
        world: WorldFrame::HomePlate,
        cameras,
        parameters,
        covariance,
        condition: 4.1e3,
        variance_factor: 1.04,
        pitches_used: (1..=6).collect(),
        warnings: vec!["camera third: <weak> geometry".to_owned()],
        cost_trace: Vec::new(),
    }
}
