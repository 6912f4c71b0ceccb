//! The paper's simulation space [Kim19 §II]: three pinhole cameras, four quadratic trajectories, seven presets of
//! noise. Made anew here, apart from the simulator, because it is the paper's and not the world's.

use nalgebra::{Point3, Vector3};
use rand::SeedableRng;
use rand_distr::{Distribution, Normal};
use rand_pcg::Pcg64Mcg;

use crate::calibration::PitchTracks;
use crate::geometry::{Intrinsics, Pixel, Pose};
use crate::scene::{
    CameraId, CameraIdError, CameraSetup, FieldPreset, Motion, Rig, RollingShutter, Site, Track, TrackPoint,
};
use crate::time::StampedMidpoint;

/// Frames per second [Kim19 §II-B].
pub const RATE_HZ: f64 = 179.0;
/// Flight time, seconds.
pub const END_S: f64 = 0.6;
/// 1 January 2019; any instant would do.
pub const EPOCH_NS: i64 = 1_546_300_800_000_000_000;
/// Pause between two pitches, seconds.
const PAUSE_S: f64 = 2.0;

/// Which noise is added [Kim19 Table 2].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NoisePreset {
    /// N1 … N7.
    pub name: &'static str,
    /// N_c: 1σ of the capture time, frames.
    pub capture_sigma_frames: f64,
    /// N_Q: centres rounded to whole pixels.
    pub rounded: bool,
    /// N_D: 1σ of the detected centre, pixels.
    pub detection_sigma_px: f64,
}

impl NoisePreset {
    /// Whether anything is drawn or rounded.
    pub fn is_noisy(&self) -> bool {
        self.rounded || self.capture_sigma_frames > 0.0 || self.detection_sigma_px > 0.0
    }
}

/// N1–N7. The paper does not give σ_c: it is a parameter.
pub fn presets(capture_sigma_frames: f64) -> [NoisePreset; 7] {
    let preset = |name, capture: bool, rounded, detection_sigma_px| NoisePreset {
        name,
        capture_sigma_frames: if capture { capture_sigma_frames } else { 0.0 },
        rounded,
        detection_sigma_px,
    };
    [
        preset("N1", false, false, 0.0),
        preset("N2", true, false, 0.0),
        preset("N3", false, true, 0.0),
        preset("N4", false, false, 0.5),
        preset("N5", true, true, 0.5),
        preset("N6", false, false, 1.0),
        preset("N7", true, true, 1.0),
    ]
}

/// T(t) = x0 + v·t + a·t²/2 per axis [Kim19 eq. 1].
#[derive(Debug, Clone, Copy)]
pub struct Quadratic {
    start: Vector3<f64>,
    velocity: Vector3<f64>,
    acceleration: Vector3<f64>,
}

impl Quadratic {
    /// Through release (t = 0), the highest point at `high_s` and the end at [`END_S`].
    fn through(release: [f64; 3], (high_s, high): (f64, [f64; 3]), end: [f64; 3]) -> Self {
        let (start, high, end) = (Vector3::from(release), Vector3::from(high), Vector3::from(end));
        // Two equations per axis: p(t) − p(0) = v·t + a·t²/2 at both times.
        let (a, b) = ((high - start) / high_s, (end - start) / END_S);
        let acceleration = (b - a) * (2.0 / (END_S - high_s));
        Self {
            start,
            velocity: a - acceleration * (0.5 * high_s),
            acceleration,
        }
    }

    /// Position at a time after release, metres.
    pub fn at(&self, t_s: f64) -> Point3<f64> {
        Point3::from(self.start + self.velocity * t_s + self.acceleration * (0.5 * t_s * t_s))
    }
}

/// Four pitches of 0.6 s. The paper's points are only drawn (Fig. 4); these have its three kinds of points, gravity
/// with lift, and a baseball's drag (4.2 to 5.0 m/s² along y: drag coefficients of 0.32 to 0.37); spread wide, because alike pitches leave the delays open (with noise of 0.5 px the bound is
/// 0.3 frame for four ordinary pitches and 0.09 for these).
pub fn trajectories() -> [Quadratic; 4] {
    [
        Quadratic::through(
            [-0.75, 16.9, 1.60],
            (0.10, [-0.56, 14.045, 1.65]),
            [0.35, 0.40, 0.45],
        ),
        Quadratic::through(
            [-0.30, 16.8, 2.05],
            (0.17, [-0.35, 11.982, 2.22]),
            [-0.45, 0.40, 0.75],
        ),
        Quadratic::through(
            [0.80, 16.7, 1.35],
            (0.13, [0.62, 13.016, 1.42]),
            [-0.35, 0.40, 0.95],
        ),
        Quadratic::through(
            [-0.90, 17.0, 1.10],
            (0.22, [-0.68, 10.734, 1.36]),
            [0.15, 0.40, 1.00],
        ),
    ]
}

/// Camera centres, targets and focal lengths: near the dugouts' home ends and high behind home, close enough for the
/// strong perspective that the paper's 6 px of F1 misfit tell of. "Set empirically" in the paper.
const CAMERAS: [(&str, [f64; 3], [f64; 3], f64); 3] = [
    ("c1", [11.0, -2.0, 2.6], [0.0, 7.2, 1.2], 800.0),
    ("c2", [-10.5, -1.0, 3.0], [0.0, 7.3, 1.2], 800.0),
    ("c3", [3.0, -14.0, 5.0], [0.0, 7.0, 1.0], 1200.0),
];

/// The space with its three cameras, no landmarks.
///
/// # Errors
/// None with these names.
pub fn rig() -> Result<Rig, CameraIdError> {
    let camera = |(id, _, _, focal_px): &(&str, [f64; 3], [f64; 3], f64)| {
        Ok(CameraSetup {
            id: CameraId::new(id)?,
            width_px: 1280,
            height_px: 720,
            frame_rate_hz: RATE_HZ,
            exposure_s: None,
            time_offset_s: None,
            rolling_shutter: RollingShutter::Global,
            intrinsics: Intrinsics {
                fx_px: *focal_px,
                fy_px: *focal_px,
                cx_px: 639.5,
                cy_px: 359.5,
                distortion: [0.0; 5],
            },
            focal_sigma_relative: 0.0,
            position: None,
            regions: Vec::new(),
            masks: Vec::new(),
            landmarks: Vec::new(),
        })
    };
    Ok(Rig {
        site: Site {
            name: "simulation space of the paper".to_owned(),
            field: FieldPreset::Professional,
            motion: Motion::Flight,
            gravity_mps2: 9.80665,
            air_density_kgpm3: 1.194,
        },
        reference: 0,
        cameras: CAMERAS.iter().map(camera).collect::<Result<_, CameraIdError>>()?,
        distances: Vec::new(),
    })
}

/// The true poses.
pub fn poses() -> [Pose; 3] {
    CAMERAS.map(|(_, centre, target, _)| Pose::looking_at(Point3::from(centre), Point3::from(target)))
}

/// Start of a pitch, seconds after the epoch.
pub fn start_s(pitch: usize) -> f64 {
    PAUSE_S * pitch as f64
}

/// What every camera detects: camera i stamped t sees T(t − τ_i) [Kim19 eq. 2, 3], with noise. Delays in frames. The
/// first frame is stamped `phase_frames` (0 in the paper) after the release: with another phase, rounding is another too.
pub fn pitches(
    rig: &Rig,
    delays_frames: &[f64; 3],
    noise: &NoisePreset,
    (seed, phase_frames): (u64, f64),
) -> Vec<PitchTracks> {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let gauss = Normal::new(0.0, 1.0).expect("a standard normal is always valid");
    let frames = (END_S * RATE_HZ).floor() as u64;
    let poses = poses();
    let mut all = Vec::new();
    for (k, trajectory) in trajectories().iter().enumerate() {
        let mut tracks = Vec::new();
        for ((camera, pose), delay_frames) in rig.cameras.iter().zip(&poses).zip(delays_frames) {
            let mut points = Vec::new();
            for frame in 0..=frames {
                let t_s = (frame as f64 + phase_frames) / RATE_HZ;
                // Drawn in any case, so that one preset's numbers are another's, scaled.
                let draws: [f64; 3] = std::array::from_fn(|_| gauss.sample(&mut rng));
                let captured_s = t_s - (delay_frames - noise.capture_sigma_frames * draws[0]) / RATE_HZ;
                let Ok(mut pixel) = camera
                    .intrinsics
                    .project(&pose.transform(&trajectory.at(captured_s)))
                else {
                    continue;
                };
                pixel.x += noise.detection_sigma_px * draws[1];
                pixel.y += noise.detection_sigma_px * draws[2];
                if noise.rounded {
                    pixel = Pixel::new(pixel.x.round(), pixel.y.round());
                }
                points.push(TrackPoint {
                    frame: (start_s(k) * RATE_HZ).round() as u64 + frame,
                    stamped: StampedMidpoint::from_seconds_since(EPOCH_NS, start_s(k) + t_s),
                    pixel,
                    covariance_px2: None,
                });
            }
            tracks.push(Track {
                camera: camera.id.clone(),
                track: k as u32 + 1,
                points,
            });
        }
        all.push(PitchTracks { tracks });
    }
    all
}

/// The ball at a true time, seconds after the epoch.
pub fn truth_at(pitch: usize, time_s: f64) -> Option<Point3<f64>> {
    Some(trajectories().get(pitch)?.at(time_s - start_s(pitch)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn trajectories_go_through_their_points_and_stay_in_the_pictures() {
        let rig = rig().unwrap();
        let first = trajectories()[0];
        assert!((first.at(0.0) - Point3::new(-0.75, 16.9, 1.60)).norm() < 1e-12);
        assert!((first.at(0.10) - Point3::new(-0.56, 14.045, 1.65)).norm() < 1e-12);
        assert!((first.at(END_S) - Point3::new(0.35, 0.40, 0.45)).norm() < 1e-12);
        let seen = pitches(&rig, &[0.0, -2.0, 2.0], &presets(0.05)[0], (1, 0.0));
        let mut count = 0;
        for point in seen.iter().flat_map(|p| &p.tracks).flat_map(|t| &t.points) {
            assert!((0.0..1280.0).contains(&point.pixel.x) && (0.0..720.0).contains(&point.pixel.y));
            count += 1;
        }
        assert_eq!(count, 4 * 3 * 108);
    }

    #[test]
    fn accelerations_are_those_of_a_pitch() {
        for t in trajectories() {
            assert!((4.0..5.2).contains(&t.acceleration.y), "{}", t.acceleration.y);
            assert!((-16.0..-5.0).contains(&t.acceleration.z), "{}", t.acceleration.z);
            assert!(t.acceleration.x.abs() < 6.0);
        }
    }
}
