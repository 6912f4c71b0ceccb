//! Metres and a world for the paper's reconstruction, which has neither: from landmarks, else from physics.

use nalgebra::{DMatrix, DVector};

use super::reconstruction::Reconstruction;
use crate::calibration::PitchTracks;
use crate::calibration::curves::Curves;
use crate::calibration::path::PathPrior;
use crate::calibration::polish::{Clock, Evidence, State};
use crate::calibration::resection::resect_camera;
use crate::calibration::self_calibration::make_metric;
use crate::geometry::Pose;
use crate::scene::{Landmark, Rig, WorldFrame};

/// Landmarks that fit worse than this, rms in their sigmas, are told of.
const MISFIT_NOTED: f64 = 3.0;

/// Poses in a world, and what made it.
pub(super) struct Placed {
    pub poses: Vec<Option<Pose>>,
    pub world: WorldFrame,
    /// What a person must know of it.
    pub note: Option<String>,
}

/// Puts the reconstruction where the landmarks say; without any, upright around the reference camera.
pub(super) fn place(rig: &Rig, pitches: &[PitchTracks], found: &Reconstruction, delays_s: &[f64]) -> Placed {
    if let Some(placed) = by_landmarks(rig, found) {
        return placed;
    }
    let mut scored = (
        0.0,
        State {
            poses: found.poses.clone(),
            clocks: delays_s
                .iter()
                .map(|&delay_s| Clock {
                    delay_s,
                    skew: 0.0,
                    zero_s: 0.0,
                })
                .collect(),
        },
    );
    let mut depths: Vec<f64> = found.points.iter().flatten().map(|x| x.z).collect();
    depths.sort_by(f64::total_cmp);
    let depth = depths.get(depths.len() / 2).copied().unwrap_or(1.0);
    let unplaced = |note: String| Placed {
        poses: found.poses.clone(),
        world: WorldFrame::ReferenceCamera,
        note: Some(note),
    };
    let Ok(curves) = Curves::new(rig, pitches, 10) else {
        return unplaced("no curve to take gravity from".to_owned());
    };
    let evidence = Evidence {
        curves: &curves,
        lenses: rig.cameras.iter().map(|c| c.intrinsics).collect(),
        sightings: vec![Vec::new(); rig.cameras.len()],
        prior: PathPrior::smooth(depth),
        unit_baseline: None,
        slack_px: 0.05,
    };
    let (note, surveyed) = make_metric(rig, &evidence, &mut scored);
    Placed {
        poses: scored.1.poses,
        world: if surveyed {
            WorldFrame::HomePlate
        } else {
            WorldFrame::ReferenceCamera
        },
        note: Some(format!("no landmarks: {note}")),
    }
}

/// The similarity that lays the reconstruction onto all clicked landmarks: six numbers of the reference camera's
/// pose and the logarithm of the scale, least squares in the image.
fn by_landmarks(rig: &Rig, found: &Reconstruction) -> Option<Placed> {
    let mut rejected: Vec<(usize, String)> = Vec::new();
    let mut start: Option<(Pose, f64)> = None;
    let mut known: Vec<(usize, Pose)> = Vec::new();
    for (c, camera) in rig.cameras.iter().enumerate() {
        if found.poses[c].is_none() {
            continue;
        }
        if let Ok(all) = resect_camera(camera)
            && let Some(best) = all.first()
        {
            rejected.extend(best.rejected.iter().map(|name| (c, name.clone())));
            known.push((c, best.pose));
        }
    }
    let (anchor, anchor_pose) = *known.first()?;
    let anchor_relative = found.poses[anchor]?;
    for (c, pose) in known.iter().skip(1) {
        let relative = found.poses[*c]?;
        let units = (relative.centre_m() - anchor_relative.centre_m()).norm();
        let metres = (pose.centre_m() - anchor_pose.centre_m()).norm();
        if units > 0.0 && start.is_none() {
            start = Some((anchor_pose, metres / units));
        }
    }
    let (anchor_pose, mut scale) = start?;
    let used: Vec<(usize, &Landmark)> = rig
        .cameras
        .iter()
        .enumerate()
        .flat_map(|(c, camera)| camera.landmarks.iter().map(move |l| (c, l)))
        .filter(|(c, l)| found.poses[*c].is_some() && !rejected.contains(&(*c, l.name.clone())))
        .collect();
    // camera_from_world = scaled(camera_from_anchor) ∘ anchor_from_world.
    let pose_of = |c: usize, anchor_from_world: &Pose, scale: f64| -> Option<Pose> {
        let mut relative = found.poses[c]?.compose(&anchor_relative.inverse());
        relative.translation_m *= scale;
        Some(relative.compose(anchor_from_world))
    };
    let residuals = |pose: &Pose, scale: f64| -> Option<DVector<f64>> {
        let mut all = Vec::with_capacity(2 * used.len());
        for (c, l) in &used {
            let seen = pose_of(*c, pose, scale)?.transform(&l.position.world_m);
            let p = rig.cameras[*c].intrinsics.project(&seen).ok()?;
            let [sigma_x, sigma_y] = l.sigma_px.map(|sigma| sigma.max(1e-3));
            all.extend([(p.x - l.pixel.x) / sigma_x, (p.y - l.pixel.y) / sigma_y]);
        }
        Some(DVector::from_vec(all))
    };
    let mut pose = anchor_pose;
    let mut here = residuals(&pose, scale)?;
    for _ in 0..20 {
        let mut jacobian = DMatrix::zeros(here.len(), 7);
        for k in 0..7 {
            let mut delta = [0.0; 6];
            let step = 1e-6;
            let moved = if k < 6 {
                delta[k] = step;
                residuals(&pose.perturbed(&delta), scale)?
            } else {
                residuals(&pose, scale * step.exp())?
            };
            jacobian.set_column(k, &((moved - &here) / step));
        }
        let mut normal = jacobian.tr_mul(&jacobian);
        for i in 0..7 {
            normal[(i, i)] *= 1.0 + 1e-6;
        }
        let step = normal.cholesky()?.solve(&jacobian.tr_mul(&here));
        let delta: [f64; 6] = std::array::from_fn(|i| -step[i]);
        let next_pose = pose.perturbed(&delta);
        let next_scale = scale * (-step[6]).exp();
        match residuals(&next_pose, next_scale) {
            Some(next) if next.norm_squared() < here.norm_squared() => {
                let gain = here.norm_squared() - next.norm_squared();
                (pose, scale, here) = (next_pose, next_scale, next);
                if gain < 1e-8 {
                    break;
                }
            }
            _ => break,
        }
    }
    let rms = (here.norm_squared() / here.len().max(1) as f64).sqrt();
    Some(Placed {
        poses: (0..rig.cameras.len()).map(|c| pose_of(c, &pose, scale)).collect(),
        world: WorldFrame::HomePlate,
        note: (rms > MISFIT_NOTED).then(|| {
            format!(
                "scale and world rest on {} landmark clicks that fit only to {rms:.1} of their sigmas",
                used.len()
            )
        }),
    })
}
