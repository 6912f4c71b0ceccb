//! Cameras without landmarks: placed from the ball alone, or from the ball and the cameras that have landmarks.

use super::CalibrationError;
use super::delay_search::{DelayWindow, delay_window, search_delay, skew_matters};
use super::initial::InitialOptions;
use super::metric::{Air, Motion, Upgrade, anchored, upgrade, upright};
use super::path::{Path, PathPrior};
use super::polish::{Clock, Evidence, State, Unknown, WithSkew};
use super::resection::{Sighting, refine_pose};
use super::two_view::{Pair, skews_within, two_view_candidates};
use crate::geometry::{Normalized, Pose, triangulate_dlt};
use crate::scene::Rig;
use crate::vision::resection_candidates;
use nalgebra::{Point3, Vector3};

/// Fewest pitches for a pose from the ball alone.
pub(crate) const PITCHES_NEEDED: usize = 3;
/// Points of the paths that a resection takes at most.
const RESECTION_POINTS: usize = 48;
/// Places of a camera found by resection that are followed.
const PLACES_KEPT: usize = 2;
/// Weight of a violation of physics against the image residuals (both standardised).
const PENALTY_WEIGHT: f64 = 30.0;

/// A state with its robust cost.
pub(crate) type Scored = (f64, State);

/// Reconstructions from the ball alone in the coordinates of the first camera of the pair (its pose is the
/// identity) with the pair's baseline as unit; best first. `anchor`: the camera to start from.
pub(crate) fn from_ball(
    rig: &Rig,
    evidence: &mut Evidence,
    anchor: usize,
    options: &InitialOptions,
) -> Result<Vec<Scored>, CalibrationError> {
    let (seed, polish_steps) = (options.seed, options.polish_steps);
    let others: Vec<usize> = (0..rig.cameras.len()).filter(|&c| c != anchor).collect();
    let mut partners: Vec<(usize, usize)> = others
        .iter()
        .map(|&c| (evidence.curves.common(anchor, c).len(), c))
        .filter(|(n, _)| *n > 0)
        .collect();
    partners.sort_by_key(|(n, c)| (std::cmp::Reverse(*n), *c));
    let most = partners.first().map_or(0, |p| p.0);
    if most < PITCHES_NEEDED {
        return Err(CalibrationError::TooFewPitches {
            found: most,
            needed: PITCHES_NEEDED,
        });
    }
    let mut drafts: Vec<Scored> = Vec::new();
    for (common, partner) in partners.iter().copied().skip(options.partner) {
        if common < PITCHES_NEEDED || !drafts.is_empty() {
            break;
        }
        drafts = pair_drafts(rig, evidence, [anchor, partner], (seed, polish_steps))?;
    }
    if drafts.is_empty() {
        let other = partners.get(options.partner).unwrap_or(&partners[0]).1;
        return Err(CalibrationError::NoRelativePose {
            first: rig.cameras[anchor].id.clone(),
            second: rig.cameras[other].id.clone(),
            reason: "no delay searched gives an essential matrix with the ball in front of both".to_owned(),
        });
    }
    add_the_rest(rig, evidence, drafts, (anchor, polish_steps))
}

/// Adds every camera without a pose that shares pitches, from the paths of the others.
pub(crate) fn add_the_rest(
    rig: &Rig,
    evidence: &Evidence,
    mut drafts: Vec<Scored>,
    (fixed, polish_steps): (usize, usize),
) -> Result<Vec<Scored>, CalibrationError> {
    let Some((_, first)) = drafts.first() else {
        return Ok(drafts);
    };
    let open: Vec<usize> = (0..rig.cameras.len())
        .filter(|&c| first.poses[c].is_none())
        .collect();
    for camera in open {
        let mut next: Vec<Scored> = Vec::new();
        for (_, draft) in &drafts {
            for mut state in by_resection(rig, evidence, draft, camera)? {
                let cost = polish_all(rig, evidence, &mut state, (&[fixed], polish_steps));
                next.push((cost, state));
            }
        }
        if !next.is_empty() {
            drafts = best_of(next, 3);
        }
    }
    Ok(drafts)
}

fn best_of(mut drafts: Vec<Scored>, keep: usize) -> Vec<Scored> {
    drafts.sort_by(|a, b| a.0.total_cmp(&b.0));
    let best = drafts.first().map_or(0.0, |d| d.0);
    drafts.retain(|d| d.0 < 4.0 * best + 200.0);
    drafts.truncate(keep);
    drafts
}

/// Polishes poses and clocks of all placed cameras, but the poses of `fixed`.
pub(crate) fn polish_all(
    rig: &Rig,
    evidence: &Evidence,
    state: &mut State,
    (fixed, steps): (&[usize], usize),
) -> f64 {
    let placed = Evidence::placed(state);
    let reference = if placed.contains(&rig.reference) {
        rig.reference
    } else {
        placed[0]
    };
    let long = placed
        .iter()
        .any(|&c| skew_matters(rig, evidence, c) == WithSkew::Yes);
    let with_skew = if long { WithSkew::Yes } else { WithSkew::No };
    let unknowns = Unknown::all(state, reference, fixed, with_skew);
    evidence.polish(state, &unknowns, steps)
}

fn pair_drafts(
    rig: &Rig,
    evidence: &mut Evidence,
    cameras: [usize; 2],
    (seed, polish_steps): (u64, usize),
) -> Result<Vec<Scored>, CalibrationError> {
    let [a, b] = cameras;
    let clocks = (0..rig.cameras.len())
        .map(|c| Clock {
            delay_s: 0.0,
            skew: 0.0,
            zero_s: evidence.curves.middle_s(c),
        })
        .collect();
    let mut start = State {
        poses: vec![None; rig.cameras.len()],
        clocks,
    };
    start.poses[a] = Some(Pose::identity());
    let Some(window) = delay_window(rig, evidence, &start, &[a], b) else {
        return Ok(Vec::new());
    };
    let pair = Pair::new(rig, evidence.curves, cameras, seed);
    let with_skew = skew_matters(rig, evidence, b);
    evidence.unit_baseline = Some((a, b));
    let mut drafts = Vec::new();
    let mut least = f64::INFINITY;
    for found in two_view_candidates(&pair, &window, with_skew, 4)? {
        // Far worse in the image than the best: not worth a polish.
        least = least.min(found.cost_px);
        if found.cost_px > 6.0 * least + 0.5 {
            continue;
        }
        let pairs = pair.correspondences(&found.clock);
        let mut depths: Vec<f64> = pairs
            .iter()
            .filter_map(|p| triangulate_dlt(&[(Pose::identity(), p[0]), (found.b_from_a, p[1])]).ok())
            .map(|x| x.z)
            .collect();
        depths.sort_by(f64::total_cmp);
        let Some(&depth) = depths.get(depths.len() / 2) else {
            continue;
        };
        evidence.prior = PathPrior::smooth(depth);
        let mut state = start.clone();
        state.poses[b] = Some(found.b_from_a);
        state.clocks[b] = found.clock;
        let cost = polish_all(rig, evidence, &mut state, (&[a], polish_steps));
        drafts.push((cost, state));
    }
    Ok(best_of(drafts, 3))
}

/// States in which `camera` has been placed by resection from the paths of the cameras already placed.
pub(crate) fn by_resection(
    rig: &Rig,
    evidence: &Evidence,
    state: &State,
    camera: usize,
) -> Result<Vec<State>, CalibrationError> {
    let placed = Evidence::placed(state);
    let Some(window) = delay_window(rig, evidence, state, &placed, camera) else {
        return Ok(Vec::new());
    };
    let paths: Vec<Option<Path>> = (0..evidence.curves.of.len())
        .map(|p| Some(evidence.fit(state, p, &placed)?.0))
        .collect();
    let with_skew = skew_matters(rig, evidence, camera);
    let step_s = 2.0 * window.step_s;
    let mut floors = Vec::new();
    for skew in skews_within(with_skew, evidence.curves.half_span_s(camera), step_s) {
        floors.extend(resection_floors(evidence, &paths, camera, (&window, skew))?);
    }
    floors.sort_by(|a, b| a.rms_px.total_cmp(&b.rms_px));
    let mut kept: Vec<Floor> = Vec::new();
    for floor in floors {
        let apart = |k: &Floor| (k.clock.delay_s - floor.clock.delay_s).abs() > 2.5 * step_s;
        if kept.len() < PLACES_KEPT && kept.iter().all(apart) {
            kept.push(floor);
        }
    }
    let mut states = Vec::new();
    for floor in kept {
        let mut next = state.clone();
        next.poses[camera] = Some(floor.pose);
        // With a pose, the fine search over paths is sharper.
        let near = DelayWindow {
            centre_s: floor.clock.delay_s,
            half_s: 2.0 * step_s,
            ..window
        };
        let finer = search_delay(evidence, &next, camera, &near, (with_skew, 1));
        next.clocks[camera] = finer.first().map_or(floor.clock, |c| c.clock);
        states.push(next);
    }
    Ok(states)
}

/// A camera's pose at a clock where its neighbours in delay fit worse.
#[derive(Clone, Copy)]
struct Floor {
    rms_px: f64,
    pose: Pose,
    clock: Clock,
}

/// The floors along the delays of a window, at one skew.
fn resection_floors(
    evidence: &Evidence,
    paths: &[Option<Path>],
    camera: usize,
    (window, skew): (&DelayWindow, f64),
) -> Result<Vec<Floor>, CalibrationError> {
    let step_s = 2.0 * window.step_s;
    let steps = (2.0 * window.half_s / step_s).ceil() as i64;
    let zero_s = evidence.curves.middle_s(camera);
    let mut coarse: Vec<Option<Floor>> = Vec::new();
    for i in 0..=steps {
        let delay_s = window.centre_s - window.half_s + step_s * i as f64;
        let clock = Clock {
            delay_s,
            skew,
            zero_s,
        };
        coarse.push(resect_at(evidence, paths, camera, clock)?);
    }
    let cost = |i: usize| coarse.get(i).and_then(|c| *c).map_or(f64::INFINITY, |c| c.rms_px);
    Ok((0..coarse.len())
        .filter(|&i| cost(i) <= i.checked_sub(1).map_or(f64::INFINITY, cost) && cost(i) <= cost(i + 1))
        .filter_map(|i| coarse[i])
        .collect())
}

fn resect_at(
    evidence: &Evidence,
    paths: &[Option<Path>],
    camera: usize,
    clock: Clock,
) -> Result<Option<Floor>, CalibrationError> {
    let mut seen: Vec<(Point3<f64>, Normalized)> = Vec::new();
    for (pitch, path) in paths.iter().enumerate() {
        if let (Some(path), Some(curve)) = (path, evidence.curves.get(pitch, camera)) {
            let timed = curve.samples.iter().map(|(s, d)| (clock.true_s(*s), *d));
            let inside = timed.filter(|(t, _)| path.covers(*t));
            seen.extend(inside.map(|(t, d)| (path.position(t), d)));
        }
    }
    if seen.len() < 12 {
        return Ok(None);
    }
    let few = seen.iter().step_by(seen.len().div_ceil(RESECTION_POINTS));
    let (world, directions): (Vec<_>, Vec<_>) = few.copied().unzip();
    let lens = &evidence.lenses[camera];
    let sightings: Vec<Sighting> = world
        .iter()
        .zip(&directions)
        .map(|(&world_m, d)| Sighting {
            world_m,
            world_sigma_m: 0.0,
            pixel: lens.pixel(*d),
            sigma_px: [1.0; 2],
        })
        .collect();
    let fits = resection_candidates(&world, &directions)?.into_iter();
    let best = fits.filter_map(|pose| refine_pose(lens, &sightings, &pose));
    let best = best.min_by(|a, b| a.chi2.total_cmp(&b.chi2));
    Ok(best.map(|r| Floor {
        rms_px: r.rms_px,
        pose: r.pose,
        clock,
    }))
}

/// Motions in the middle of every path that at least two cameras saw.
fn motions(evidence: &Evidence, state: &State) -> Vec<(Motion, Point3<f64>)> {
    let placed = Evidence::placed(state);
    (0..evidence.curves.of.len())
        .filter_map(|p| {
            let (path, _) = evidence.fit(state, p, &placed)?;
            let at = path.middle_s();
            let motion = Motion {
                velocity: path.velocity(at),
                acceleration: path.acceleration(),
            };
            Some((motion, path.position(at)))
        })
        .collect()
}

/// Metres and up for a reconstruction without landmarks: the poses are turned upright around the reference
/// camera. Returns the cost with the physics' penalty, what fixed the scale, and whether surveyed positions put
/// it into the home-plate frame.
pub(crate) fn make_metric(rig: &Rig, evidence: &Evidence, (cost, state): &mut Scored) -> (String, bool) {
    let level = level(&state.poses);
    let measured = measured_scale(rig, &state.poses);
    let air = air(rig);
    let seen: Vec<Motion> = motions(evidence, state).into_iter().map(|m| m.0).collect();
    let Some(found) = upgrade(&seen, &level.normalize(), air, (measured.map(|m| m.0), None)) else {
        return (
            "nothing fixes the scale: the first baseline is 1".to_owned(),
            false,
        );
    };
    *cost += PENALTY_WEIGHT * found.penalty;
    let placed = Evidence::placed(state);
    let origin = if placed.contains(&rig.reference) {
        rig.reference
    } else {
        placed[0]
    };
    upright(&mut state.poses, origin, &found);
    let surveyed = survey_yaw(rig, &mut state.poses);
    let what = measured.map_or(
        "gravity, drag and the usual speed of a pitch fix the scale (to some 10 %)",
        |m| m.1,
    );
    (what.to_owned(), surveyed)
}

/// Turns and scales a world around the reference camera so that these motions are pitches; whether it could.
pub(crate) fn make_pitches(rig: &Rig, motions: &[Motion], poses: &mut [Option<Pose>]) -> bool {
    let measured = measured_scale(rig, poses).map(|m| m.0);
    let found = upgrade(motions, &level(poses).normalize(), air(rig), (measured, None));
    if let Some(found) = &found {
        upright(poses, rig.reference, found);
    }
    found.is_some()
}

/// Where up is for cameras that stand level on average.
fn level(poses: &[Option<Pose>]) -> Vector3<f64> {
    let own = poses.iter().flatten();
    own.map(|p| p.rotation.inverse() * Vector3::new(0.0, -1.0, 0.0))
        .sum()
}

fn air(rig: &Rig) -> Air {
    Air {
        gravity_mps2: rig.site.gravity_mps2,
        density_kgpm3: rig.site.air_density_kgpm3,
    }
}

/// Scale and pose of a reconstruction whose camera `anchor` has a landmark pose: the world's up is known, metres
/// come from physics and from where pitches fly.
pub(crate) fn make_metric_by_anchor(
    rig: &Rig,
    evidence: &Evidence,
    (cost, state): &mut Scored,
    (anchor, known): (usize, &Pose),
) {
    let Some(here) = state.poses[anchor] else {
        return;
    };
    let old_from_world = here.rotation.inverse() * known.rotation;
    let up = old_from_world * Vector3::z();
    let air = air(rig);
    let seen = motions(evidence, state);
    let moving: Vec<Motion> = seen.iter().map(|m| m.0).collect();
    let measured = measured_scale(rig, &state.poses).map(|m| m.0);
    let penalty = |log_scale: f64| -> f64 {
        let scale = log_scale.exp();
        let physics = upgrade(&moving, &up, air, (Some(scale), Some(up)));
        let place: f64 = seen
            .iter()
            .map(|(_, position)| {
                let p = known.centre_m() + old_from_world.inverse() * (position - here.centre_m()) * scale;
                (p.x / 0.6).powi(2) + ((p.y - 9.0) / 4.0).powi(2) + ((p.z - 1.4) / 0.5).powi(2)
            })
            .sum::<f64>()
            / seen.len().max(1) as f64;
        physics.map_or(1e6, |p: Upgrade| 5.0 * p.penalty) + place
    };
    let scale_m = measured.unwrap_or_else(|| {
        let start = upgrade(&moving, &up, air, (None, Some(up)))
            .map_or(1.0, |u| u.scale_m)
            .ln();
        let coarse = (-20..=20).map(|i| start + 0.05 * f64::from(i));
        let best = coarse
            .min_by(|a, b| penalty(*a).total_cmp(&penalty(*b)))
            .unwrap_or(start);
        super::delay_search::golden(penalty, best, 0.05).exp()
    });
    *cost +=
        PENALTY_WEIGHT * upgrade(&moving, &up, air, (Some(scale_m), Some(up))).map_or(10.0, |u| u.penalty);
    anchored(&mut state.poses, anchor, known, scale_m);
}

/// Metres per unit from measured distances and surveyed positions between placed cameras.
fn measured_scale(rig: &Rig, poses: &[Option<Pose>]) -> Option<(f64, &'static str)> {
    let mut ratios: Vec<(f64, f64)> = Vec::new();
    let mut add = |a: usize, b: usize, distance_m: f64, sigma_m: f64| {
        if let (Some(a), Some(b)) = (&poses[a], &poses[b]) {
            let units = (a.centre_m() - b.centre_m()).norm();
            if units > 0.0 && distance_m > 0.0 {
                ratios.push((distance_m / units, (distance_m / sigma_m.max(1e-4)).powi(2)));
            }
        }
    };
    for d in &rig.distances {
        if let (Some(a), Some(b)) = (rig.index_of(&d.between.0), rig.index_of(&d.between.1)) {
            add(a, b, d.distance_m, d.sigma_m);
        }
    }
    let measured = !rig.distances.is_empty();
    for a in 0..rig.cameras.len() {
        for b in a + 1..rig.cameras.len() {
            if let (Some((pa, sa)), Some((pb, sb))) = (rig.cameras[a].position, rig.cameras[b].position) {
                add(a, b, (pa - pb).norm(), sa.hypot(sb));
            }
        }
    }
    let weight: f64 = ratios.iter().map(|r| r.1).sum();
    let what = if measured {
        "a measured distance fixes the scale"
    } else {
        "surveyed positions fix the scale"
    };
    (weight > 0.0).then(|| (ratios.iter().map(|r| r.0 * r.1).sum::<f64>() / weight, what))
}

/// Turns an upright metric world about z onto the surveyed positions of two or more cameras; whether it could.
fn survey_yaw(rig: &Rig, poses: &mut [Option<Pose>]) -> bool {
    let pairs: Vec<(Point3<f64>, Point3<f64>)> = rig
        .cameras
        .iter()
        .zip(poses.iter())
        .filter_map(|(c, p)| Some((p.as_ref()?.centre_m(), c.position?.0)))
        .collect();
    if pairs.len() < 2 {
        return false;
    }
    let n = pairs.len() as f64;
    let from = pairs.iter().map(|p| p.0.coords).sum::<Vector3<f64>>() / n;
    let to = pairs.iter().map(|p| p.1.coords).sum::<Vector3<f64>>() / n;
    let (mut sine, mut cosine) = (0.0, 0.0);
    for (a, b) in &pairs {
        let (a, b) = (a.coords - from, b.coords - to);
        cosine += a.x * b.x + a.y * b.y;
        sine += a.x * b.y - a.y * b.x;
    }
    if sine.hypot(cosine) < 1.0 {
        return false;
    }
    let turn = nalgebra::Rotation3::from_axis_angle(&Vector3::z_axis(), sine.atan2(cosine));
    for pose in poses.iter_mut().flatten() {
        let centre = to + turn * (pose.centre_m().coords - from);
        let rotation = pose.rotation * turn.inverse();
        *pose = Pose {
            rotation,
            translation_m: -(rotation * centre),
        };
    }
    true
}
