//! A camera's pose from its landmarks: all plausible poses, and the click that does not fit, by name.

use nalgebra::{Matrix2, Matrix6, Point3, Vector2, Vector6};

use super::CalibrationError;
use crate::geometry::{Intrinsics, Normalized, Pixel, Pose, skew};
use crate::scene::CameraSetup;
use crate::vision::resection_candidates;

/// Fewest landmarks for a pose that can be checked.
pub const LANDMARKS_NEEDED: usize = 4;
/// A click is suspect from this many of its sigmas on.
const SUSPECT_SIGMAS: f64 = 4.5;
/// A pose whose χ² exceeds the best's by more than this (and by more than its triple) is no alternative.
const CHI2_ALTERNATIVE: f64 = 60.0;

/// A point of known position seen by a camera.
#[derive(Debug, Clone, Copy)]
pub struct Sighting {
    /// World, metres.
    pub world_m: Point3<f64>,
    /// Its sigma per axis, metres.
    pub world_sigma_m: f64,
    /// Distorted pixel.
    pub pixel: Pixel,
    /// Sigma along x and y, pixels.
    pub sigma_px: [f64; 2],
}

/// One pose that explains the landmarks.
#[derive(Debug, Clone)]
pub struct Resection {
    /// The pose.
    pub pose: Pose,
    /// Sum of squared standardised residuals of the landmarks kept.
    pub chi2: f64,
    /// Root mean square residual (norm) of the landmarks kept, pixels.
    pub rms_px: f64,
    /// Covariance of [`Pose::perturbed`]'s six numbers.
    pub covariance: Matrix6<f64>,
    /// Landmarks left out as wrongly clicked.
    pub rejected: Vec<String>,
}

/// All plausible poses of a camera from its landmarks, the best first (at most three).
///
/// Few landmarks in nearly one plane allow two poses: both are returned with their cost, and the ball decides.
/// A click that alone spoils the fit is left out and named in [`Resection::rejected`].
pub fn resect_camera(camera: &CameraSetup) -> Result<Vec<Resection>, CalibrationError> {
    let few = |found| CalibrationError::TooFewLandmarks {
        camera: camera.id.clone(),
        found,
        needed: LANDMARKS_NEEDED,
    };
    let sightings: Vec<(String, Sighting)> = camera
        .landmarks
        .iter()
        .map(|l| {
            let seen = Sighting {
                world_m: l.position.world_m,
                world_sigma_m: l.position.world_sigma_m,
                pixel: l.pixel,
                sigma_px: l.sigma_px.map(|sigma| sigma.max(1e-3)),
            };
            (l.name.clone(), seen)
        })
        .collect();
    if sightings.len() < LANDMARKS_NEEDED {
        return Err(few(sightings.len()));
    }
    let mut kept: Vec<usize> = (0..sightings.len()).collect();
    let mut poses = fit_all(&camera.intrinsics, &sightings, &kept)?;
    while let Some(wrong) = wrong_click(&camera.intrinsics, &sightings, &kept, poses.first())? {
        kept.retain(|&i| i != wrong);
        poses = fit_all(&camera.intrinsics, &sightings, &kept)?;
    }
    let rejected: Vec<String> = (0..sightings.len())
        .filter(|i| !kept.contains(i))
        .map(|i| sightings[i].0.clone())
        .collect();
    let Some(best) = poses.first() else {
        return Err(few(kept.len()));
    };
    if best.rms_px > 0.05 * f64::from(camera.width_px) {
        let residual = |i: &usize| standardised(&camera.intrinsics, &best.pose, &sightings[*i].1);
        let worst = kept.iter().max_by(|a, b| residual(a).total_cmp(&residual(b)));
        return Err(CalibrationError::LandmarksDisagree {
            camera: camera.id.clone(),
            rms_px: best.rms_px,
            worst: worst.map_or_else(String::new, |&i| sightings[i].0.clone()),
        });
    }
    let ceiling = best.chi2 + CHI2_ALTERNATIVE.max(2.0 * best.chi2);
    poses.retain(|p| p.chi2 <= ceiling);
    poses.truncate(3);
    for pose in &mut poses {
        pose.rejected.clone_from(&rejected);
    }
    Ok(poses)
}

/// The landmark whose removal mends a bad fit, if there is exactly one such.
fn wrong_click(
    lens: &Intrinsics,
    sightings: &[(String, Sighting)],
    kept: &[usize],
    best: Option<&Resection>,
) -> Result<Option<usize>, CalibrationError> {
    // After the removal, two residuals must be left over to say that the rest agrees.
    if kept.len() <= LANDMARKS_NEEDED {
        return Ok(None);
    }
    let all_chi2 = best.map_or(f64::INFINITY, |b| b.chi2);
    if let Some(best) = best {
        let largest = kept
            .iter()
            .map(|&i| standardised(lens, &best.pose, &sightings[i].1))
            .fold(0.0, f64::max);
        if largest < SUSPECT_SIGMAS {
            return Ok(None);
        }
    }
    let mut without: Vec<(f64, usize)> = Vec::new();
    for &i in kept {
        let rest: Vec<usize> = kept.iter().copied().filter(|&k| k != i).collect();
        let chi2 = fit_all(lens, sightings, &rest)?
            .first()
            .map_or(f64::INFINITY, |p| p.chi2);
        without.push((chi2, i));
    }
    without.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (lowest, wrong) = without[0];
    let freedom = (2 * kept.len() - 8) as f64;
    let before = all_chi2 / (freedom + 2.0);
    let after = lowest / freedom;
    let clear = all_chi2 - lowest > SUSPECT_SIGMAS * SUSPECT_SIGMAS && before > 2.5 * after.max(0.5);
    Ok(clear.then_some(wrong))
}

/// Every local minimum found over the landmarks `kept`, best first.
fn fit_all(
    lens: &Intrinsics,
    sightings: &[(String, Sighting)],
    kept: &[usize],
) -> Result<Vec<Resection>, CalibrationError> {
    let mut seen: Vec<Sighting> = Vec::new();
    let mut directions: Vec<Normalized> = Vec::new();
    for &i in kept {
        if let Ok(direction) = lens.direction(sightings[i].1.pixel) {
            seen.push(sightings[i].1);
            directions.push(direction);
        }
    }
    let world: Vec<_> = seen.iter().map(|s| s.world_m).collect();
    let mut fits: Vec<Resection> = Vec::new();
    for start in resection_candidates(&world, &directions)? {
        let Some(fit) = refine_pose(lens, &seen, &start) else {
            continue;
        };
        let known = |f: &Resection| {
            (f.pose.rotation.matrix() - fit.pose.rotation.matrix()).norm() < 3e-3
                && (f.chi2 - fit.chi2).abs() <= 1e-2 * (1.0 + fit.chi2)
        };
        if !fits.iter().any(known) {
            fits.push(fit);
        }
    }
    fits.sort_by(|a, b| a.chi2.total_cmp(&b.chi2));
    Ok(fits)
}

/// Sigma of a sighting in the image along x and y: the click and the landmark's own uncertainty.
pub(super) fn sigma_px(lens: &Intrinsics, seen: &Sighting, depth_m: f64) -> Vector2<f64> {
    let own_px = lens.fx_px * seen.world_sigma_m / depth_m;
    seen.sigma_px.map(|sigma| sigma.hypot(own_px)).into()
}

fn standardised(lens: &Intrinsics, pose: &Pose, seen: &Sighting) -> f64 {
    let camera_m = pose.transform(&seen.world_m);
    match lens.project(&camera_m) {
        Ok(p) => (p.vector() - seen.pixel.vector())
            .component_div(&sigma_px(lens, seen, camera_m.z))
            .norm(),
        Err(_) => f64::INFINITY,
    }
}

struct Normal {
    chi2: f64,
    sum_px2: f64,
    matrix: Matrix6<f64>,
    gradient: Vector6<f64>,
}

fn normal_equations(lens: &Intrinsics, seen: &[Sighting], pose: &Pose) -> Option<Normal> {
    let mut n = Normal {
        chi2: 0.0,
        sum_px2: 0.0,
        matrix: Matrix6::zeros(),
        gradient: Vector6::zeros(),
    };
    for s in seen {
        let c = pose.transform(&s.world_m);
        let projected = lens.project_with_jacobian(&c).ok()?;
        let residual: Vector2<f64> = projected.pixel.vector() - s.pixel.vector();
        let weight = Matrix2::from_diagonal(&sigma_px(lens, s, c.z).map(|sigma| sigma.powi(-2)));
        let by_turn = -projected.by_camera_point * skew(&c);
        let mut j = nalgebra::Matrix2x6::zeros();
        j.fixed_view_mut::<2, 3>(0, 0).copy_from(&by_turn);
        j.fixed_view_mut::<2, 3>(0, 3)
            .copy_from(&projected.by_camera_point);
        n.matrix += j.transpose() * weight * j;
        n.gradient += j.transpose() * weight * residual;
        n.chi2 += residual.dot(&(weight * residual));
        n.sum_px2 += residual.norm_squared();
    }
    Some(n)
}

/// Levenberg–Marquardt on the pixels, with distortion; `None` where the start is behind a point or degenerate.
pub fn refine_pose(lens: &Intrinsics, seen: &[Sighting], start: &Pose) -> Option<Resection> {
    let mut pose = *start;
    let mut here = normal_equations(lens, seen, &pose)?;
    let mut damping = 1e-4;
    for _ in 0..60 {
        let mut damped = here.matrix;
        for i in 0..6 {
            damped[(i, i)] += damping * here.matrix[(i, i)].max(1e-12);
        }
        let step = -(damped.cholesky()?.solve(&here.gradient));
        let next_pose = pose.perturbed(&step.into());
        match normal_equations(lens, seen, &next_pose) {
            Some(next) if next.chi2 < here.chi2 => {
                let gain = here.chi2 - next.chi2;
                (pose, here) = (next_pose, next);
                damping = (damping * 0.2).max(1e-12);
                if gain < 1e-10 * (1.0 + here.chi2) {
                    break;
                }
            }
            _ => {
                damping *= 8.0;
                if damping > 1e10 {
                    break;
                }
            }
        }
    }
    Some(Resection {
        pose,
        chi2: here.chi2,
        rms_px: (here.sum_px2 / seen.len() as f64).sqrt(),
        covariance: here.matrix.try_inverse()?,
        rejected: Vec::new(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{CameraId, FieldPreset, Landmark, LandmarkPosition, RollingShutter};
    use rand::SeedableRng;
    use rand_distr::{Distribution, Normal};

    fn camera(centre: [f64; 3], names: &[&str], seed: u64) -> (CameraSetup, Pose) {
        let lens = Intrinsics {
            fx_px: 1790.0,
            fy_px: 1790.0,
            cx_px: 1031.0,
            cy_px: 505.0,
            distortion: [-0.083, 0.021, 0.0004, -0.0003, 0.0],
        };
        let pose = Pose::looking_at(Point3::from(centre), Point3::new(0.0, 9.0, 0.8));
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(seed);
        let noise = Normal::new(0.0, 0.5).unwrap();
        let landmarks = names
            .iter()
            .map(|name| {
                let world_m = FieldPreset::Professional.landmark(name).unwrap();
                let p = lens.project(&pose.transform(&world_m)).unwrap();
                Landmark {
                    name: (*name).to_owned(),
                    position: LandmarkPosition {
                        world_m,
                        world_sigma_m: 0.0,
                    },
                    pixel: Pixel::new(p.x + noise.sample(&mut rng), p.y + noise.sample(&mut rng)),
                    sigma_px: [0.5; 2],
                }
            })
            .collect();
        let setup = CameraSetup {
            id: CameraId::new("first").unwrap(),
            width_px: 2048,
            height_px: 1024,
            frame_rate_hz: 175.0,
            exposure_s: None,
            time_offset_s: None,
            rolling_shutter: RollingShutter::Global,
            intrinsics: lens,
            focal_sigma_relative: 0.0,
            position: None,
            landmarks,
            regions: Vec::new(),
            masks: Vec::new(),
        };
        (setup, pose)
    }

    const MANY: [&str; 9] = [
        "plate_tip",
        "plate_front_left",
        "plate_front_right",
        "rubber_front_left",
        "rubber_back_right",
        "box_left_front_outer",
        "box_right_front_outer",
        "box_left_back_outer",
        "box_right_back_outer",
    ];
    const CENTRES: [[f64; 3]; 3] = [[20.0, 6.0, 3.3], [-18.0, 4.0, 3.0], [1.0, -20.0, 8.0]];

    #[test]
    fn clicks_of_half_a_pixel_give_the_pose_to_a_tenth_of_a_degree() {
        for seed in 0..20 {
            for centre in CENTRES {
                let (setup, truth) = camera(centre, &MANY, seed);
                let best = &resect_camera(&setup).unwrap()[0];
                let miss = best.pose.rotation.angle_to(&truth.rotation).to_degrees();
                assert!(best.rejected.is_empty(), "seed {seed}: {:?}", best.rejected);
                assert!(miss < 0.4, "seed {seed} {centre:?}: {miss}°");
            }
        }
    }

    #[test]
    fn each_axis_counts_by_its_own_sigma() {
        let (setup, pose) = camera(CENTRES[0], &MANY[..1], 1);
        let (lens, mark) = (&setup.intrinsics, &setup.landmarks[0]);
        let camera_m = pose.transform(&mark.position.world_m);
        let true_px = lens.project(&camera_m).unwrap();
        let seen = Sighting {
            world_m: mark.position.world_m,
            world_sigma_m: 0.0,
            pixel: Pixel::new(true_px.x + 0.3, true_px.y - 0.2),
            sigma_px: [0.1, 0.05],
        };
        // 3 and 4 sigmas.
        assert!((standardised(lens, &pose, &seen) - 5.0).abs() < 1e-9);
        let normal = normal_equations(lens, &[seen], &pose).unwrap();
        assert!((normal.chi2 - 25.0).abs() < 1e-9, "{}", normal.chi2);
        // What the landmark's own place adds: 1790 px · 4 cm over the depth, to both.
        let unsure = Sighting {
            world_sigma_m: 0.04,
            ..seen
        };
        let own_px = 71.6 / camera_m.z;
        let sigma = sigma_px(lens, &unsure, camera_m.z);
        assert!((sigma.x - own_px.hypot(0.1)).abs() < 1e-12 && (sigma.y - own_px.hypot(0.05)).abs() < 1e-12);
    }

    #[test]
    fn a_wrong_click_is_named_and_left_out() {
        for seed in 0..10 {
            for (k, name) in MANY.iter().enumerate() {
                let (mut setup, truth) = camera(CENTRES[seed as usize % 3], &MANY, seed);
                setup.landmarks[k].pixel.x += 40.0;
                setup.landmarks[k].pixel.y -= 25.0;
                let best = &resect_camera(&setup).unwrap()[0];
                assert_eq!(best.rejected, [*name], "seed {seed}");
                assert!(best.pose.rotation.angle_to(&truth.rotation).to_degrees() < 0.6);
            }
        }
    }

    #[test]
    fn a_small_plane_far_away_keeps_both_its_poses() {
        let names = [
            "plate_tip",
            "plate_left",
            "plate_right",
            "plate_front_left",
            "plate_front_right",
        ];
        let mut ambiguous = 0;
        for seed in 0..20 {
            let (setup, truth) = camera([0.5, -25.0, 9.0], &names, seed);
            let found = resect_camera(&setup).unwrap();
            let nearest = found
                .iter()
                .map(|f| f.pose.rotation.angle_to(&truth.rotation).to_degrees())
                .fold(f64::INFINITY, f64::min);
            assert!(nearest < 15.0, "seed {seed}: {nearest}° of {}", found.len());
            ambiguous += usize::from(found.len() > 1);
        }
        assert!(ambiguous >= 10, "two poses in {ambiguous} of 20 seeds");
    }

    #[test]
    fn too_few_landmarks_are_counted() {
        let (setup, _) = camera(CENTRES[0], &MANY[..3], 1);
        let error = resect_camera(&setup).unwrap_err().to_string();
        assert_eq!(
            error,
            "camera first has 3 usable landmark(s), 4 needed for a pose"
        );
    }
}
