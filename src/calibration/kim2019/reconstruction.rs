//! Extrinsics and points at given delays: x* = P(t + τ), five-point with MLESAC, E → R, t, DLT
//! [Kim19 eq. 4, §III-A], and the two costs of §III-B and §IV-B.

use nalgebra::Point3;

use super::trajectory::ImageTrajectory;
use crate::calibration::CalibrationError;
use crate::calibration::relative_pose::{MlesacOptions, mlesac};
use crate::geometry::{Normalized, Pose, align_similarity, triangulate_dlt};

/// An instant of a pitch at which x* is taken.
#[derive(Debug, Clone, PartialEq)]
pub struct Instant {
    /// Index of the pitch.
    pub pitch: usize,
    /// True time (the reference camera's stamps), seconds after the epoch.
    pub time_s: f64,
    /// Cameras that see the ball then, the reference first.
    pub cameras: Vec<usize>,
}

/// Everything but the delays.
pub struct Problem {
    /// `[pitch][camera]`.
    pub trajectories: Vec<Vec<Option<ImageTrajectory>>>,
    /// Instants used; the same for all delays, so that the cost does not jump.
    pub instants: Vec<Instant>,
    /// The reference camera.
    pub reference: usize,
    /// Cameras with unknown delay, in rig order.
    pub others: Vec<usize>,
    /// Focal length per rig camera, pixels.
    pub focal_px: Vec<f64>,
    /// Robust search.
    pub samples: usize,
    /// Seed of the sampling.
    pub seed: u64,
    /// 1σ of x*, pixels, for MLESAC.
    pub sigma_px: f64,
    /// Relative poses that every evaluation starts from beside its samples, one per camera of `others`.
    pub starts: Vec<Vec<Pose>>,
}

/// What the delays lead to.
#[derive(Debug, Clone)]
pub struct Reconstruction {
    /// Camera from reference camera, per rig camera; lengths in units of the first other camera's baseline.
    pub poses: Vec<Option<Pose>>,
    /// X* of every instant, where the rays meet; reference camera coordinates.
    pub points: Vec<Option<Point3<f64>>>,
    /// Mean reprojection error over all points and cameras, pixels.
    pub reprojection_px: f64,
    /// Root mean square reprojection error per rig camera, pixels.
    pub rms_px: Vec<f64>,
}

impl Problem {
    /// x* of a camera at an instant, for the delay of that camera [Kim19 eq. 4].
    pub fn corrected(&self, instant: &Instant, camera: usize, delay_s: f64) -> Option<Normalized> {
        let trajectory = self.trajectories.get(instant.pitch)?.get(camera)?.as_ref()?;
        Some(trajectory.direction(instant.time_s + delay_s))
    }

    fn delay_of(&self, camera: usize, delays_s: &[f64]) -> f64 {
        self.others
            .iter()
            .position(|&c| c == camera)
            .and_then(|i| delays_s.get(i))
            .copied()
            .unwrap_or(0.0)
    }

    fn seen(&self, instant: &Instant, delays_s: &[f64]) -> Vec<(usize, Normalized)> {
        instant
            .cameras
            .iter()
            .filter_map(|&c| Some((c, self.corrected(instant, c, self.delay_of(c, delays_s))?)))
            .collect()
    }

    /// Correspondences of the reference camera with another.
    pub fn pairs(&self, camera: usize, delay_s: f64) -> Vec<[Normalized; 2]> {
        self.instants
            .iter()
            .filter(|i| i.cameras.contains(&camera))
            .filter_map(|i| {
                Some([
                    self.corrected(i, self.reference, 0.0)?,
                    self.corrected(i, camera, delay_s)?,
                ])
            })
            .collect()
    }

    /// Robust relative pose of a camera at a delay.
    pub fn relative_pose(
        &self,
        other: usize,
        delay_s: f64,
        samples: usize,
    ) -> Result<Option<Pose>, CalibrationError> {
        let camera = self.others[other];
        let pairs = self.pairs(camera, delay_s);
        let options = MlesacOptions {
            samples,
            sigma_px: self.sigma_px,
            outlier_range_px: 300.0,
            seed: self.seed.wrapping_add(camera as u64),
            focal_px: [self.focal_px[self.reference], self.focal_px[camera]],
            refinements: 2,
        };
        let none = Vec::new();
        let starts = self.starts.get(other).unwrap_or(&none);
        Ok(mlesac(&pairs, starts, &options)?.map(|r| r.second_from_first))
    }

    /// Extrinsics, points and reprojection error at these delays (seconds, cameras of `others`).
    /// `None` where some camera gets no relative pose or no point can be had.
    pub fn reconstruct(&self, delays_s: &[f64]) -> Result<Option<Reconstruction>, CalibrationError> {
        let mut poses: Vec<Option<Pose>> = vec![None; self.focal_px.len()];
        poses[self.reference] = Some(Pose::identity());
        let mut unit: Option<usize> = None;
        for (k, &camera) in self.others.iter().enumerate() {
            let delay_s = delays_s.get(k).copied().unwrap_or(0.0);
            let Some(mut pose) = self.relative_pose(k, delay_s, self.samples)? else {
                return Ok(None);
            };
            if let Some(first) = unit {
                // E leaves every baseline's length open: the depths of common points set them equal.
                let Some(scale) = self.depth_ratio((first, &poses), (camera, &pose), delays_s) else {
                    return Ok(None);
                };
                pose.translation_m *= scale;
            } else {
                unit = Some(camera);
            }
            poses[camera] = Some(pose);
        }
        Ok(Some(self.intersect(poses, delays_s)))
    }

    fn depth_ratio(
        &self,
        (first, poses): (usize, &[Option<Pose>]),
        (camera, pose): (usize, &Pose),
        delays_s: &[f64],
    ) -> Option<f64> {
        let first_pose = poses.get(first).copied().flatten()?;
        let mut ratios: Vec<f64> = self
            .instants
            .iter()
            .filter(|i| i.cameras.contains(&first) && i.cameras.contains(&camera))
            .filter_map(|i| {
                let n = self.corrected(i, self.reference, 0.0)?;
                let a = self.corrected(i, first, self.delay_of(first, delays_s))?;
                let b = self.corrected(i, camera, self.delay_of(camera, delays_s))?;
                let near = triangulate_dlt(&[(Pose::identity(), n), (first_pose, a)]).ok()?;
                let far = triangulate_dlt(&[(Pose::identity(), n), (*pose, b)]).ok()?;
                Some(near.z / far.z)
            })
            .collect();
        ratios.sort_by(f64::total_cmp);
        ratios.get(ratios.len() / 2).copied()
    }

    /// Points and reprojection error for poses and delays found elsewhere: the measure that all methods share.
    pub fn at_poses(&self, poses: Vec<Option<Pose>>, delays_s: &[f64]) -> Reconstruction {
        self.intersect(poses, delays_s)
    }

    fn intersect(&self, poses: Vec<Option<Pose>>, delays_s: &[f64]) -> Reconstruction {
        let mut points = Vec::with_capacity(self.instants.len());
        let mut sums = vec![(0.0, 0.0, 0usize); poses.len()];
        for instant in &self.instants {
            let seen = self.seen(instant, delays_s);
            let views: Vec<(Pose, Normalized)> =
                seen.iter().filter_map(|(c, n)| Some((poses[*c]?, *n))).collect();
            let point = triangulate_dlt(&views).ok();
            points.push(point);
            let Some(point) = point else {
                continue;
            };
            for (camera, n) in &seen {
                let Some(pose) = poses[*camera] else {
                    continue;
                };
                let c = pose.transform(&point);
                let error = self.focal_px[*camera] * (c.x / c.z - n.x).hypot(c.y / c.z - n.y);
                let sum = &mut sums[*camera];
                *sum = (sum.0 + error, sum.1 + error * error, sum.2 + 1);
            }
        }
        let (total, count) = sums.iter().fold((0.0, 0), |(t, n), s| (t + s.0, n + s.2));
        let reprojection_px = if count > 0 {
            total / count as f64
        } else {
            f64::INFINITY
        };
        let rms_px = sums.iter().map(|s| (s.1 / s.2.max(1) as f64).sqrt()).collect();
        Reconstruction {
            poses,
            points,
            reprojection_px,
            rms_px,
        }
    }

    /// E(−τ) of [Kim19 eq. 5]: mean distance to the true points after the best similarity, in the truth's units.
    pub fn distance(&self, found: &Reconstruction, truth: &[Point3<f64>]) -> Option<f64> {
        let (from, to): (Vec<_>, Vec<_>) = found
            .points
            .iter()
            .zip(truth)
            .filter_map(|(x, t)| Some(((*x)?, *t)))
            .unzip();
        let similarity = align_similarity(&from, &to)?;
        let sum: f64 = from
            .iter()
            .zip(&to)
            .map(|(a, b)| (similarity.transform(a) - b).norm())
            .sum();
        Some(sum / from.len() as f64)
    }
}
