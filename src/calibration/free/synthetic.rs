//! Test scenes of a free motion: a smooth random 3-D path, free-running cameras around it, and the truth.

use nalgebra::{Point3, Vector2, Vector3};
use rand::{Rng, SeedableRng};
use rand_distr::{Distribution, Normal as Gauss};
use rand_pcg::Pcg64;

use super::problem::{Problem, State};
use super::spline::Spline;
use super::view::{CameraState, Priors, Sighting, View};
use crate::geometry::{Intrinsics, Pixel, Pose};
use crate::scene::{
    CameraId, CameraSetup, FieldPreset, Motion, Rig, RollingShutter, Site, Track, TrackPoint,
};
use crate::time::{CameraTiming, StampedMidpoint};

/// What to make.
#[derive(Debug, Clone)]
pub(super) struct Scene {
    pub seed: u64,
    pub duration_s: f64,
    pub noise_px: f64,
    /// Fraction of false points and of missed frames.
    pub outliers: f64,
    pub misses: f64,
    /// Per camera: rate (Hz), delay (s), skew (ppm), readout (s); the first is the reference.
    pub clocks: Vec<(f64, f64, f64, f64)>,
    /// Round to whole pixels.
    pub integer: bool,
}

/// Truth of a scene.
pub(super) struct Truth {
    pub poses: Vec<Pose>,
    pub timings: Vec<CameraTiming>,
    waves: Vec<(Vector3<f64>, f64, f64)>,
}

pub(super) const LENS: Intrinsics = Intrinsics {
    fx_px: 1600.0,
    fy_px: 1595.0,
    cx_px: 962.0,
    cy_px: 537.0,
    distortion: [-0.06, 0.03, 0.0004, -0.0003, 0.0],
};
const WIDTH: u32 = 1920;
const HEIGHT: u32 = 1080;

impl Truth {
    /// Where the thing is, metres.
    pub fn position(&self, t_s: f64) -> Point3<f64> {
        let mut p = Vector3::new(0.0, 0.0, 8.0);
        for (amplitude, rate, phase) in &self.waves {
            p += amplitude * (rate * t_s + phase).sin();
        }
        Point3::from(p)
    }
}

impl Scene {
    pub fn drone(seed: u64) -> Self {
        Self {
            seed,
            duration_s: 60.0,
            noise_px: 0.5,
            outliers: 0.0,
            misses: 0.1,
            clocks: vec![
                (29.97, 0.0, 0.0, 0.02),
                (25.0, -3.4567, 40.0, 0.0),
                (50.0, 17.2346, -25.0, 0.015),
            ],
            integer: false,
        }
    }

    /// Rig with rough offsets (off by up to `rough_s`), tracks and truth.
    pub fn make(&self, rough_s: f64) -> (Rig, Vec<Track>, Truth) {
        let mut rng = Pcg64::seed_from_u64(self.seed);
        let waves = (0..7)
            .map(|k| {
                let rate = 0.15 * 1.6f64.powi(k);
                let size = 14.0 / (1.0 + 3.0 * rate * rate);
                let a = Vector3::new(
                    rng.random_range(-1.0..1.0),
                    rng.random_range(-1.0..1.0),
                    rng.random_range(-0.4..0.4),
                ) * size;
                (a, rate, rng.random_range(0.0..std::f64::consts::TAU))
            })
            .collect();
        let count = self.clocks.len();
        let poses: Vec<_> = (0..count)
            .map(|k| {
                let angle = 5.2 * k as f64 / count as f64 + rng.random_range(-0.3..0.3);
                let away = rng.random_range(35.0..50.0);
                let centre = Point3::new(away * angle.cos(), away * angle.sin(), 1.5 + 0.8 * k as f64);
                Pose::looking_at(centre, Point3::new(0.0, 0.0, 8.0))
            })
            .collect();
        let timings: Vec<_> = self
            .clocks
            .iter()
            .map(|&(_, delay, skew, readout)| CameraTiming {
                capture_delay_s: delay,
                clock_skew_ppm: skew,
                skew_epoch_ns: 40_000_000_000,
                readout_s: readout,
                height_px: HEIGHT,
            })
            .collect();
        let truth = Truth {
            poses,
            timings,
            waves,
        };
        let tracks = (0..count).map(|k| self.track(k, &truth, &mut rng)).collect();
        let cameras = (0..count)
            .map(|k| {
                let rough = rng.random_range(-1.0..1.0) * rough_s;
                let readout = self.clocks[k].3;
                setup(
                    k,
                    self.clocks[k].0,
                    -self.clocks[k].1 + if k == 0 { 0.0 } else { rough },
                    readout,
                )
            })
            .collect();
        let site = Site {
            name: "synthetic".to_owned(),
            field: FieldPreset::Professional,
            motion: Motion::Free,
            gravity_mps2: 9.8,
            air_density_kgpm3: 1.2,
        };
        let rig = Rig {
            site,
            reference: 0,
            cameras,
            distances: vec![],
        };
        (rig, tracks, truth)
    }

    fn track(&self, k: usize, truth: &Truth, rng: &mut Pcg64) -> Track {
        let (rate, delay, ..) = self.clocks[k];
        let noise = Gauss::new(0.0, self.noise_px).unwrap();
        let mut points = vec![];
        for frame in 0..(self.duration_s * rate) as u64 {
            let stamped_s = 10.0 + delay + frame as f64 / rate;
            let stamped = StampedMidpoint::from_seconds_since(0, stamped_s);
            // The row that sees the thing fixes the time, and the time the row.
            let mut pixel = Pixel::new(0.0, f64::from(HEIGHT) / 2.0);
            for _ in 0..6 {
                let t = truth.timings[k].true_seconds(stamped, pixel.y, 0);
                let c = truth.poses[k].transform(&truth.position(t));
                pixel = LENS.project(&c).unwrap();
            }
            let inside =
                (0.0..f64::from(WIDTH)).contains(&pixel.x) && (0.0..f64::from(HEIGHT)).contains(&pixel.y);
            if !inside || rng.random_bool(self.misses) {
                continue;
            }
            let mut seen = pixel.vector() + Vector2::new(noise.sample(rng), noise.sample(rng));
            if rng.random_bool(self.outliers) {
                seen = Vector2::new(rng.random_range(0.0..1900.0), rng.random_range(0.0..1080.0));
            }
            if self.integer {
                seen = seen.map(f64::round);
            }
            points.push(TrackPoint {
                frame,
                stamped,
                pixel: Pixel::new(seen.x, seen.y),
                covariance_px2: None,
            });
        }
        Track {
            camera: CameraId::new(&format!("cam{k}")).unwrap(),
            track: 0,
            points,
        }
    }
}

fn setup(k: usize, frame_rate_hz: f64, offset_s: f64, readout_s: f64) -> CameraSetup {
    CameraSetup {
        id: CameraId::new(&format!("cam{k}")).unwrap(),
        width_px: WIDTH,
        height_px: HEIGHT,
        frame_rate_hz,
        exposure_s: None,
        time_offset_s: Some(offset_s),
        rolling_shutter: if readout_s > 0.0 {
            RollingShutter::Estimate
        } else {
            RollingShutter::Global
        },
        intrinsics: LENS,
        focal_sigma_relative: 0.0,
        position: None,
        landmarks: vec![],
        regions: Vec::new(),
        masks: Vec::new(),
    }
}

/// Views with the truth's cameras and a spline through the truth.
pub(super) fn at_truth(scene: &Scene, knot_s: f64) -> (Vec<View>, State, Truth) {
    let (_, tracks, truth) = scene.make(0.0);
    let views: Vec<_> = tracks
        .iter()
        .map(|t| View {
            sightings: t
                .points
                .iter()
                .map(|p| Sighting {
                    stamped_s: p.stamped.seconds_since(0),
                    pixel_px: p.pixel.vector(),
                    sigma_px: 1.0,
                })
                .collect(),
            height_px: f64::from(HEIGHT),
            epoch_s: 40.0,
            lens: LENS,
        })
        .collect();
    let cameras = truth
        .poses
        .iter()
        .zip(&truth.timings)
        .map(|(pose, timing)| {
            Some(CameraState {
                pose: *pose,
                delay_s: timing.capture_delay_s,
                skew_ppm: timing.clock_skew_ppm,
                readout_s: timing.readout_s,
                lens: LENS,
                noise: 0.5,
            })
        })
        .collect();
    let mut spline = Spline::covering(&[(9.0, 11.0 + scene.duration_s)], knot_s);
    let begin_s = spline.pieces[0].begin_s;
    for (k, c) in spline.coefficients.iter_mut().enumerate() {
        let t = begin_s + (k as f64 - 1.0) * knot_s;
        let x = truth.position(t).coords;
        let around = truth.position(t - knot_s).coords + truth.position(t + knot_s).coords;
        *c = x - (around - 2.0 * x) / 6.0;
    }
    (views, State { cameras, spline }, truth)
}

/// A problem with no columns over some views.
pub(super) fn problem(views: &[View]) -> Problem<'_> {
    Problem {
        views,
        columns: vec![],
        distances: vec![],
        priors: Priors {
            skew_ppm: 500.0,
            readout_s: (0.0, 0.03),
            focal: vec![0.01; views.len()],
            principal_px: 10.0,
            radial: 0.02,
        },
        jerk_precision: 0.01,
        acceleration_precision: 1e-6,
        tail: 4.0,
        redundancy: 1.0,
    }
}
