//! Another camera against the motion known so far: pose and delay by robust least squares from several starts.

use nalgebra::{Point3, SMatrix, SVector, Vector3};
use rand::SeedableRng;
use rand::seq::index::sample;
use rand_pcg::Pcg64Mcg;

use super::spline::Spline;
use super::support::inside;
use super::view::{CameraState, Sighting, View};
use crate::calibration::CalibrationError;
use crate::geometry::{Normalized, Pixel, Pose};
use crate::scene::ParameterKind as K;
use crate::vision::resection_candidates;

const KINDS: [K; 7] = [
    K::RotationX,
    K::RotationY,
    K::RotationZ,
    K::TranslationX,
    K::TranslationY,
    K::TranslationZ,
    K::CaptureDelay,
];

/// Thresholds of the robust weights while the fit settles, pixels.
const ANNEALED_PX: [f64; 4] = [60.0, 20.0, 8.0, 4.0];

/// A camera fitted to the motion.
#[derive(Debug, Clone)]
pub(super) struct Fitted {
    pub camera: CameraState,
    /// Share of the sightings (where the motion is known) within the last threshold.
    pub inlier_share: f64,
    /// Sightings where the motion is known.
    pub sightings: usize,
    /// Median residual of those within, pixels.
    pub median_px: f64,
}

/// The motion known so far.
#[derive(Clone, Copy)]
pub(super) struct Known<'a> {
    pub spline: &'a Spline,
    /// Stretches that two cameras saw, seconds.
    pub shared: &'a [(f64, f64)],
}

impl Known<'_> {
    fn position(&self, t_s: f64) -> Option<Point3<f64>> {
        inside(self.shared, t_s).then(|| self.spline.position(t_s))
    }
}

/// The length of the baseline along `relative` (pose of the new camera from a known one, |t| = 1) that puts
/// the known motion on the new camera's rays; the start of a fit. `None` where too little is known.
pub(super) fn scaled_start(
    view: &View,
    known: Known,
    (known_pose, relative): (&Pose, &Pose),
    start: &CameraState,
) -> Option<CameraState> {
    let mut lengths = vec![];
    for s in thinned(view, known, start, 200) {
        let Some(world) = known.position(view.true_s(start, &s)) else {
            continue;
        };
        let Ok(n) = start.lens.direction(Pixel::new(s.pixel_px.x, s.pixel_px.y)) else {
            continue;
        };
        let ray = Vector3::new(n.x, n.y, 1.0);
        // ray × (R·x + λ·t) = 0.
        let without = ray.cross(&(relative.rotation * known_pose.transform(&world)));
        let along = ray.cross(&relative.translation_m);
        if along.norm_squared() > 1e-12 {
            lengths.push(-without.dot(&along) / along.norm_squared());
        }
    }
    if lengths.len() < 20 {
        return None;
    }
    lengths.sort_by(f64::total_cmp);
    let length = lengths[lengths.len() / 2];
    let scaled = Pose {
        rotation: relative.rotation,
        translation_m: relative.translation_m * length,
    };
    (length > 0.0).then(|| CameraState {
        pose: scaled.compose(known_pose),
        ..start.clone()
    })
}

/// Starts from nothing but the rough delay: perspective-n-point from random sightings at every delay.
pub(super) fn searched_starts(
    view: &View,
    known: Known,
    start: &CameraState,
    (range_s, step_s): (f64, f64),
) -> Result<Vec<CameraState>, CalibrationError> {
    let mut rng = Pcg64Mcg::seed_from_u64(17);
    let steps = (range_s / step_s).ceil() as i32;
    let mut starts: Vec<(f64, CameraState)> = vec![];
    for k in -steps..=steps {
        let mut candidate = start.clone();
        candidate.delay_s += f64::from(k) * step_s;
        let (mut world, mut seen) = (vec![], vec![]);
        let sightings = thinned(view, known, &candidate, 120);
        for s in &sightings {
            let position = known.position(view.true_s(&candidate, s));
            let direction = candidate.lens.direction(Pixel::new(s.pixel_px.x, s.pixel_px.y));
            if let (Some(position), Ok(direction)) = (position, direction) {
                world.push(position);
                seen.push(direction);
            }
        }
        if world.len() < 30 {
            continue;
        }
        let mut best: Option<(f64, Pose)> = None;
        for _ in 0..12 {
            let picked = sample(&mut rng, world.len(), 6);
            let points: Vec<Point3<f64>> = picked.iter().map(|i| world[i]).collect();
            let rays: Vec<Normalized> = picked.iter().map(|i| seen[i]).collect();
            for pose in resection_candidates(&points, &rays)? {
                let cost = misses(&pose, &world, &seen, 20.0 / candidate.lens.fx_px);
                if best.is_none_or(|(least, _)| cost < least) {
                    best = Some((cost, pose));
                }
            }
        }
        if let Some((cost, pose)) = best {
            candidate.pose = pose;
            starts.push((cost, candidate));
        }
    }
    starts.sort_by(|a, b| a.0.total_cmp(&b.0));
    Ok(starts.into_iter().take(4).map(|(_, start)| start).collect())
}

/// Mean truncated squared miss of directions, over the limit.
fn misses(pose: &Pose, world: &[Point3<f64>], seen: &[Normalized], limit: f64) -> f64 {
    let sum: f64 = world
        .iter()
        .zip(seen)
        .map(|(p, n)| {
            let c = pose.transform(p);
            let miss = (c.x / c.z - n.x).hypot(c.y / c.z - n.y);
            if c.z > 0.0 {
                (miss / limit).powi(2).min(1.0)
            } else {
                1.0
            }
        })
        .sum();
    sum / world.len().max(1) as f64
}

/// At most `count` sightings where the motion is known, evenly spread.
fn thinned(view: &View, known: Known, camera: &CameraState, count: usize) -> Vec<Sighting> {
    let usable: Vec<Sighting> = view
        .sightings
        .iter()
        .filter(|s| inside(known.shared, view.true_s(camera, s)))
        .copied()
        .collect();
    let step = usable.len().div_ceil(count).max(1);
    usable.into_iter().step_by(step).collect()
}

/// Fits pose and delay by robust least squares with a threshold that tightens; `None` where it fails.
pub(super) fn fit(view: &View, known: Known, start: &CameraState) -> Option<Fitted> {
    let mut camera = start.clone();
    for limit_px in ANNEALED_PX {
        let anchor_s = camera.delay_s;
        let sightings = thinned(view, known, &camera, 400);
        for _ in 0..8 {
            let step = gauss_newton(view, known, (&camera, limit_px), &sightings)?;
            let delay = step[6].clamp(-0.08, 0.08);
            camera.pose = camera.pose.perturbed(&std::array::from_fn(|k| step[k]));
            camera.delay_s += delay;
            if delay.abs() < 1e-6 || (camera.delay_s - anchor_s).abs() > 0.3 {
                break;
            }
        }
    }
    let limit_px = ANNEALED_PX[ANNEALED_PX.len() - 1];
    let (mut close, mut sightings) = (vec![], 0);
    for s in &view.sightings {
        if !inside(known.shared, view.true_s(&camera, s)) {
            continue;
        }
        sightings += 1;
        if let Some(p) = view.predict(&camera, known.spline, s)
            && p.residual_px.norm() < limit_px
        {
            close.push(p.residual_px.norm());
        }
    }
    close.sort_by(f64::total_cmp);
    Some(Fitted {
        inlier_share: close.len() as f64 / f64::from(sightings.max(1)),
        sightings: sightings as usize,
        median_px: *close.get(close.len() / 2)?,
        camera,
    })
}

fn gauss_newton(
    view: &View,
    known: Known,
    (camera, limit_px): (&CameraState, f64),
    sightings: &[Sighting],
) -> Option<SVector<f64, 7>> {
    let mut normal = SMatrix::<f64, 7, 7>::zeros();
    let mut gradient = SVector::<f64, 7>::zeros();
    for s in sightings {
        let Some(p) = view.predict(camera, known.spline, s) else {
            continue;
        };
        let weight = 1.0 / (1.0 + (p.residual_px.norm() / limit_px).powi(2)).powi(2);
        let by = KINDS.map(|kind| p.by(kind, &camera.lens));
        for (a, da) in by.iter().enumerate() {
            gradient[a] += weight * da.dot(&p.residual_px);
            for (b, db) in by.iter().enumerate() {
                normal[(a, b)] += weight * da.dot(db);
            }
        }
    }
    for k in 0..7 {
        normal[(k, k)] *= 1.0 + 1e-3;
    }
    Some(-normal.cholesky()?.solve(&gradient))
}
