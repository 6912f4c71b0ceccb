//! Test flights by fine RK4 on drag, Magnus force and spin decay, or with a knuckleball's wobble: never by
//! the model the solver fits.

use nalgebra::{Matrix2, Point3, Vector3};
use rand::{Rng, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

use super::physics::Physics;
use super::sighting::{CameraModel, CameraNoise};
use crate::geometry::{Intrinsics, Pixel, Pose};
use crate::scene::BALL_RADIUS_M;
use crate::scene::{CameraCalibration, CameraId, Track, TrackPoint};
use crate::time::{CameraTiming, StampedMidpoint};

/// A pitch as thrown: state at release, spin vector (rad/s), Cd, and a lateral wobble (m/s², Hz, phase).
#[derive(Debug, Clone, Copy)]
pub(crate) struct Throw {
    pub(crate) release_m: Point3<f64>,
    pub(crate) velocity_mps: Vector3<f64>,
    pub(crate) spin_radps: Vector3<f64>,
    pub(crate) drag_coefficient: f64,
    pub(crate) wobble: Option<(f64, f64, f64)>,
}

/// The truth of a throw, sampled every 0.1 ms.
#[derive(Debug, Clone)]
pub(crate) struct Flown {
    pub(crate) path: Vec<(Point3<f64>, Vector3<f64>)>,
}

pub(crate) const STEP_S: f64 = 1e-4;

impl Throw {
    pub(crate) fn fly(&self) -> Flown {
        let k = Physics::default().drag_per_m;
        let law = |t: f64, v: &Vector3<f64>| {
            let spin = self.spin_radps * (-t / 27.0f64).exp();
            let across = spin.cross(v);
            let s = BALL_RADIUS_M * across.norm() / v.norm_squared();
            let mut a = Vector3::new(0.0, 0.0, -9.80665) - k * self.drag_coefficient * v.norm() * v;
            if across.norm() > 1e-9 {
                a += k * s / (0.4 + 2.32 * s) * v.norm_squared() * across.normalize();
            }
            if let Some((size, rate, phase)) = self.wobble {
                let angle = std::f64::consts::TAU * rate * t + phase;
                a.x += size * angle.sin();
                a.z += 0.7 * size * (0.8 * angle).cos();
            }
            a
        };
        let (mut r, mut v, h) = (self.release_m, self.velocity_mps, STEP_S);
        let mut path = vec![(r, v)];
        let mut i = 0;
        while r.y > -0.3 && i < 20000 {
            let t = i as f64 * h;
            let a1 = law(t, &v);
            let v2 = v + 0.5 * h * a1;
            let a2 = law(t + 0.5 * h, &v2);
            let v3 = v + 0.5 * h * a2;
            let a3 = law(t + 0.5 * h, &v3);
            let v4 = v + h * a3;
            let a4 = law(t + h, &v4);
            r += h / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4);
            v += h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4);
            path.push((r, v));
            i += 1;
        }
        Flown { path }
    }
}

impl Flown {
    pub(crate) fn duration_s(&self) -> f64 {
        (self.path.len() - 1) as f64 * STEP_S
    }

    /// Position at `t` seconds after release, cubic Hermite between samples.
    pub(crate) fn position_m(&self, t_s: f64) -> Point3<f64> {
        let i = ((t_s / STEP_S).floor().max(0.0) as usize).min(self.path.len() - 2);
        let ((a, va), (b, vb)) = (self.path[i], self.path[i + 1]);
        let u = t_s / STEP_S - i as f64;
        let (u2, u3) = (u * u, u * u * u);
        Point3::from(
            (2.0 * u3 - 3.0 * u2 + 1.0) * a.coords
                + (u3 - 2.0 * u2 + u) * STEP_S * va
                + (3.0 * u2 - 2.0 * u3) * b.coords
                + (u3 - u2) * STEP_S * vb,
        )
    }

    /// Position and time at which the ball passes y, by the samples.
    pub(crate) fn at_y(&self, y_m: f64) -> (f64, Point3<f64>, Vector3<f64>) {
        let i = self.path.iter().position(|(r, _)| r.y <= y_m).unwrap();
        let i = i.max(1) - 1;
        let (r, v) = self.path[i];
        let dt = (y_m - r.y) / v.y;
        let t = i as f64 * STEP_S + dt;
        (t, self.position_m(t), v)
    }
}

/// A pitch of a kind with small changes from a seeded generator.
pub(crate) fn throw(kind: &str, random: &mut Pcg64) -> Throw {
    let mut jitter = |s: f64| -> f64 {
        let n: f64 = StandardNormal.sample(random);
        s * n
    };
    // speed m/s, vertical angle deg, spin rpm (x: backspin < 0, y: gyro, z: side), Cd
    let (speed, angle, spin_rpm, cd) = match kind {
        "fastball" => (42.0, -2.2, [-2100.0, 300.0, 700.0], 0.355),
        "sinker" => (41.0, -2.0, [-1400.0, 400.0, 1500.0], 0.355),
        "slider" => (38.0, -1.0, [-300.0, 2000.0, -900.0], 0.36),
        "curve" => (35.0, 1.2, [2200.0, 600.0, -1200.0], 0.37),
        "change" => (37.0, -1.0, [-1100.0, 200.0, 1300.0], 0.345),
        "eephus" => (24.0, 12.0, [900.0, 100.0, 0.0], 0.34),
        _ => (33.0, 0.5, [-50.0, 0.0, 20.0], 0.31),
    };
    let speed: f64 = speed + jitter(0.7);
    let down = f64::to_radians(angle + jitter(0.5));
    let side = f64::to_radians(2.0 + jitter(0.8));
    let rpm = std::f64::consts::TAU / 60.0;
    Throw {
        release_m: Point3::new(-0.6 + jitter(0.1), 16.7 + jitter(0.05), 1.8 + jitter(0.08)),
        velocity_mps: speed * Vector3::new(side.sin() * down.cos(), -side.cos() * down.cos(), down.sin()),
        spin_radps: rpm
            * Vector3::new(
                spin_rpm[0] + jitter(100.0),
                spin_rpm[1] + jitter(100.0),
                spin_rpm[2] + jitter(100.0),
            ),
        drag_coefficient: cd + jitter(0.01),
        wobble: (kind == "knuckle").then(|| (4.0, 3.0 + jitter(0.5), jitter(2.0))),
    }
}

/// Eight pitches of varied kinds.
#[allow(dead_code)]
pub(crate) const KINDS: [&str; 8] = [
    "fastball", "slider", "curve", "change", "sinker", "fastball", "curve", "slider",
];

/// A camera at `centre` that looks at `target`, 1790 px focal length, mild distortion.
pub(crate) fn camera(id: &str, centre: [f64; 3], target: [f64; 3], delay_s: f64) -> CameraModel {
    CameraModel {
        id: CameraId::new(id).unwrap(),
        pose: Pose::looking_at(centre.into(), target.into()),
        intrinsics: Intrinsics {
            fx_px: 1790.0,
            fy_px: 1788.0,
            cx_px: 1025.0,
            cy_px: 509.0,
            distortion: [-0.083, 0.021, 0.0004, -0.0003, 0.0],
        },
        timing: CameraTiming::with_delay(delay_s),
        noise: CameraNoise {
            sigma_px: 0.3,
            variance_factor: 1.0,
            jitter_s: 0.0,
        },
    }
}

/// First-base dugout, third-base dugout, high behind home.
pub(crate) fn three_cameras() -> Vec<CameraModel> {
    vec![
        camera("first", [20.0, 6.0, 3.0], [0.0, 8.5, 1.0], 0.0),
        camera("third", [-20.0, 7.0, 3.2], [0.0, 8.5, 1.0], 0.0041),
        camera("home", [1.5, -16.0, 9.0], [0.0, 8.0, 1.2], -0.0067),
    ]
}

/// What goes wrong with the points.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Spoil {
    pub(crate) noise_px: f64,
    pub(crate) outliers: f64,
    pub(crate) misses: f64,
    pub(crate) jitter_s: f64,
}

/// A camera as a calibration without an error knows it.
pub(crate) fn calibrated(c: &CameraModel) -> CameraCalibration {
    CameraCalibration {
        id: c.id.clone(),
        camera_from_world: c.pose,
        capture_delay_s: c.timing.capture_delay_s,
        capture_delay_sigma_s: 0.0,
        clock_skew_ppm: 0.0,
        skew_epoch_ns: 0,
        network_clock: false,
        readout_s: 0.0,
        intrinsics: c.intrinsics,
        width_px: 2048,
        height_px: 1024,
        reprojection_rms_px: 0.4,
        points: 500,
        noise_sigma_px: 0.3,
        jitter_sigma_s: 0.0,
    }
}

/// The track (number 1) of a flight in a camera at 175 fps; release at true time `release_ns`.
pub(crate) fn observe(
    camera: &CameraModel,
    flown: &Flown,
    release_ns: i64,
    spoil: &Spoil,
    random: &mut Pcg64,
) -> Track {
    let period_ns = 5_714_286i64;
    let mut points = Vec::new();
    let phase: f64 = random.random();
    let first = ((release_ns as f64 / period_ns as f64) - 10.0) as i64;
    for frame in first.max(0)..first + 200 {
        let mut normal = || -> f64 { StandardNormal.sample(random) };
        let stamped = StampedMidpoint::from_nanos(frame * period_ns + (phase * 5e6) as i64);
        let t = camera.timing.true_seconds(stamped, 0.0, release_ns) + spoil.jitter_s * normal();
        if t < 0.005 || t > flown.duration_s() - 0.001 {
            continue;
        }
        let seen = camera
            .intrinsics
            .project(&camera.pose.transform(&flown.position_m(t)))
            .unwrap();
        let mut pixel = Pixel::new(
            seen.x + spoil.noise_px * normal(),
            seen.y + spoil.noise_px * normal(),
        );
        if random.random::<f64>() < spoil.misses {
            continue;
        }
        if random.random::<f64>() < spoil.outliers {
            pixel.x += 40.0 * (random.random::<f64>() - 0.5);
            pixel.y += 40.0 * (random.random::<f64>() - 0.5);
        }
        points.push(TrackPoint {
            frame: frame as u64,
            stamped,
            pixel,
            covariance_px2: Some(Matrix2::identity() * spoil.noise_px.powi(2).max(1e-6)),
        });
    }
    Track {
        camera: camera.id.clone(),
        track: 1,
        points,
    }
}

pub(crate) fn seeded(seed: u64) -> Pcg64 {
    Pcg64::seed_from_u64(seed)
}
