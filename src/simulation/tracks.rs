//! 2-D tracks of a scenario: true centres plus what a detector does to them.

use nalgebra::{Matrix2, Point3};
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;

use super::clock::{CameraClock, Purpose, stream};
use super::scenario::{CameraSpec, Scenario};
use super::truth::{self, TrueCentre, Truth};
use super::{DetectionNoise, SimulationError};
use crate::geometry::Pixel;
use crate::scene::{
    CameraSetup, Landmark, LandmarkPosition, Motion, Rig, RollingShutter, Site, Track, TrackPoint,
};

/// A simulated session in 2-D.
#[derive(Debug, Clone)]
pub struct Simulated {
    /// What a person would know of the site: clicked landmarks, no poses.
    pub rig: Rig,
    /// Tracks of every camera, cameras in rig order, by rising stamp.
    pub tracks: Vec<Track>,
    /// The truth.
    pub truth: Truth,
}

/// Tracks, rig and truth of a scenario.
pub fn simulate_tracks(scenario: &Scenario) -> Result<Simulated, SimulationError> {
    scenario.check()?;
    let truth = truth::truth(scenario)?;
    let mut tracks = Vec::new();
    for (index, camera) in scenario.cameras.iter().enumerate() {
        let mut own: Vec<Track> = truth
            .centres_of(&camera.id)
            .chunk_by(|a, b| a.pitch == b.pitch)
            .map(|of_ball| track(scenario, index, camera, of_ball))
            .chain(clutter(scenario, index, camera, &truth))
            .filter(|t| !t.points.is_empty())
            .collect();
        own.sort_by_key(Track::span);
        for (number, track) in (1..).zip(&mut own) {
            track.track = number;
        }
        tracks.extend(own);
    }
    Ok(Simulated {
        rig: rig(scenario)?,
        tracks,
        truth,
    })
}

fn track(scenario: &Scenario, index: usize, camera: &CameraSpec, centres: &[TrueCentre]) -> Track {
    let noise = &scenario.detection;
    let points = centres
        .iter()
        .filter(|c| c.visible)
        .filter_map(|c| {
            let mut rng = stream(
                scenario.seed,
                Purpose::Detection,
                index as u64,
                (u64::from(c.pitch) << 40) ^ c.frame,
            );
            Some(TrackPoint {
                frame: c.frame,
                stamped: c.stamped,
                pixel: detected(c.pixel, noise, &mut rng)?,
                covariance_px2: covariance(noise),
            })
        })
        .collect();
    Track {
        camera: camera.id.clone(),
        track: 0,
        points,
    }
}

/// The centre as detected; `None`: missed.
fn detected(truth: Pixel, noise: &DetectionNoise, rng: &mut Pcg64Mcg) -> Option<Pixel> {
    // All numbers are drawn whatever happens: the noise of one run is that of another with other rates.
    let (miss, outlier): (f64, f64) = (rng.random(), rng.random());
    let normal: [f64; 2] = [StandardNormal.sample(rng), StandardNormal.sample(rng)];
    let uniform: [f64; 2] = [rng.random(), rng.random()];
    if miss < noise.miss_probability {
        return None;
    }
    let shift = |i: usize| {
        if outlier < noise.outlier_probability {
            (2.0 * uniform[i] - 1.0) * noise.outlier_range_px
        } else {
            noise.sigma_px * normal[i]
        }
    };
    let rounded = |value: f64| match noise.quantisation_px {
        q if q > 0.0 => (value / q).round() * q,
        _ => value,
    };
    Some(Pixel::new(
        rounded(truth.x + shift(0)),
        rounded(truth.y + shift(1)),
    ))
}

/// The sigma the detector would report: its Gaussian noise and the rounding's q²/12.
fn covariance(noise: &DetectionNoise) -> Option<Matrix2<f64>> {
    let variance = noise.sigma_px.powi(2) + noise.quantisation_px.powi(2) / 12.0;
    (noise.report_sigma && variance > 0.0).then(|| Matrix2::from_diagonal_element(variance))
}

/// False tracks: things that cross the picture on a gentle curve around every pitch.
fn clutter(scenario: &Scenario, index: usize, camera: &CameraSpec, truth: &Truth) -> Vec<Track> {
    let clock = CameraClock::new(scenario, index, camera);
    let mut all = Vec::new();
    for (number, ball) in truth.balls.iter().enumerate() {
        for which in 0..scenario.clutter.tracks_per_pitch {
            let key = ((number as u64) << 16) | which as u64;
            let mut rng = stream(scenario.seed, Purpose::Clutter, index as u64, key);
            let begin_s = ball.start_s + rng.random_range(-0.4..0.5);
            let duration_s = rng.random_range(0.08..0.6);
            let size = [f64::from(camera.width_px), f64::from(camera.height_px)];
            let from: [f64; 2] = size.map(|s| s * rng.random_range(0.05..0.95));
            let speed: [f64; 2] = size.map(|s| s * rng.random_range(-0.8..0.8));
            let bend: [f64; 2] = size.map(|s| s * rng.random_range(-0.6..0.6));
            let points = clock
                .frames_within(begin_s, begin_s + duration_s)
                .map(|frame| clock.exposure(frame))
                .filter(|exposure| !exposure.lost)
                .filter_map(|exposure| {
                    let t = exposure.true_s - begin_s;
                    let at = |i: usize| from[i] + speed[i] * t + 0.5 * bend[i] * t * t;
                    let (x, y) = (at(0), at(1));
                    let inside = x > 0.0 && y > 0.0 && x < size[0] - 1.0 && y < size[1] - 1.0;
                    let pixel = inside.then(|| detected(Pixel::new(x, y), &scenario.detection, &mut rng));
                    Some(TrackPoint {
                        frame: exposure.frame,
                        stamped: exposure.stamped,
                        pixel: pixel??,
                        covariance_px2: covariance(&scenario.detection),
                    })
                })
                .collect();
            all.push(Track {
                camera: camera.id.clone(),
                track: 0,
                points,
            });
        }
    }
    all
}

/// The rig as a person would write it: landmarks clicked with noise, no poses, no delays.
pub fn rig(scenario: &Scenario) -> Result<Rig, SimulationError> {
    let site = &scenario.site;
    let mut cameras = Vec::with_capacity(scenario.cameras.len());
    for (index, camera) in scenario.cameras.iter().enumerate() {
        cameras.push(CameraSetup {
            id: camera.id.clone(),
            width_px: camera.width_px,
            height_px: camera.height_px,
            frame_rate_hz: camera.frame_rate_hz,
            exposure_s: Some(camera.exposure_s),
            time_offset_s: camera
                .rough_offset_error_s
                .map(|error| error - camera.total_delay_s()),
            rolling_shutter: if camera.readout_s == 0.0 {
                RollingShutter::Global
            } else {
                RollingShutter::Estimate
            },
            intrinsics: camera.intrinsics,
            focal_sigma_relative: 0.0,
            position: camera
                .survey_sigma_m
                .map(|sigma| (surveyed(scenario, index, camera, sigma), sigma)),
            landmarks: clicked(scenario, index, camera),
            regions: Vec::new(),
            masks: Vec::new(),
        });
    }
    Ok(Rig {
        site: Site {
            name: site.name.clone(),
            field: site.field,
            motion: Motion::Flight,
            gravity_mps2: site.gravity_mps2,
            air_density_kgpm3: site.air_density_kgpm3,
        },
        reference: scenario.reference(),
        cameras,
        distances: Vec::new(),
    })
}

fn surveyed(scenario: &Scenario, index: usize, camera: &CameraSpec, sigma_m: f64) -> Point3<f64> {
    let mut rng = stream(scenario.seed, Purpose::Survey, index as u64, 0);
    Point3::from(camera.position_m.map(|v| {
        let error: f64 = StandardNormal.sample(&mut rng);
        v + sigma_m * error
    }))
}

fn clicked(scenario: &Scenario, index: usize, camera: &CameraSpec) -> Vec<Landmark> {
    let clicks = &scenario.landmarks;
    let pose = camera.pose();
    let (right, bottom) = (
        f64::from(camera.width_px) - 1.0,
        f64::from(camera.height_px) - 1.0,
    );
    let wanted = |name: &str| match &clicks.names {
        Some(names) => names.iter().any(|n| n == name),
        None => true,
    };
    let mut found = Vec::new();
    for (number, (name, world_m)) in scenario.site.field.landmarks().into_iter().enumerate() {
        let mut rng = stream(scenario.seed, Purpose::Landmarks, index as u64, number as u64);
        let error: [f64; 2] = [StandardNormal.sample(&mut rng), StandardNormal.sample(&mut rng)];
        let camera_m = pose.transform(&world_m);
        let Ok(pixel) = camera.intrinsics.project(&camera_m) else {
            continue;
        };
        let unfolded = camera.intrinsics.direction(pixel).is_ok_and(|d| {
            (d.x - camera_m.x / camera_m.z).abs() + (d.y - camera_m.y / camera_m.z).abs() < 1e-6
        });
        let inside = pixel.x >= 0.0 && pixel.y >= 0.0 && pixel.x <= right && pixel.y <= bottom;
        if wanted(&name) && inside && unfolded {
            found.push(Landmark {
                name,
                position: LandmarkPosition {
                    world_m,
                    world_sigma_m: 0.0,
                },
                pixel: Pixel::new(
                    pixel.x + clicks.sigma_px * error[0],
                    pixel.y + clicks.sigma_px * error[1],
                ),
                sigma_px: [clicks.sigma_px.max(0.01); 2],
            });
        }
    }
    found
}
