//! Initial values: ranked hypotheses of every camera's pose and delay, from landmarks where there are any,
//! else from the ball alone.

use super::curves::Curves;
use super::delay_search::{delay_window, search_delay, skew_matters};
use super::metric::orthonormal;
use super::path::PathPrior;
use super::polish::{Clock, Evidence, State};
use super::resection::{LANDMARKS_NEEDED, Resection, Sighting, resect_camera};
use super::self_calibration::{add_the_rest, from_ball, make_metric, make_metric_by_anchor, polish_all};
use super::{CalibrationError, InitialEstimate, PitchTracks};
use crate::scene::{Rig, WorldFrame};

/// How thorough the search is.
#[derive(Debug, Clone, PartialEq)]
pub struct InitialOptions {
    /// Most hypotheses handed on.
    pub hypotheses: usize,
    /// Samples that stand for one curve.
    pub samples: usize,
    /// Levenberg–Marquardt steps that bring a hypothesis near its minimum.
    pub polish_steps: usize,
    /// Seed of the robust sampling.
    pub seed: u64,
    /// Which partner of the reference camera the ball alone is to place first, by pitches in common.
    pub partner: usize,
}

impl Default for InitialOptions {
    fn default() -> Self {
        Self {
            hypotheses: 4,
            samples: 10,
            polish_steps: 6,
            seed: 1,
            partner: 0,
        }
    }
}

/// A state on its way to becoming a hypothesis.
#[derive(Debug, Clone)]
struct Draft {
    state: State,
    /// Which alternative of each camera's resection it uses.
    sightings: Vec<Vec<Sighting>>,
    cost: f64,
    world: WorldFrame,
    score_px: f64,
    notes: Vec<String>,
}

/// Ranked hypotheses, the best first; at least one.
///
/// # Errors
/// [`CalibrationError`] where fewer than two cameras share a pitch, or no geometry explains the tracks.
pub fn hypotheses(
    rig: &Rig,
    pitches: &[PitchTracks],
    options: &InitialOptions,
) -> Result<Vec<InitialEstimate>, CalibrationError> {
    let curves = Curves::new(rig, pitches, options.samples)?;
    let seen: Vec<usize> = (0..rig.cameras.len())
        .filter(|&c| (0..curves.of.len()).any(|p| curves.get(p, c).is_some()))
        .collect();
    match seen.as_slice() {
        [] => return Err(CalibrationError::NoTracks),
        [one] => {
            return Err(CalibrationError::OneCamera {
                camera: rig.cameras[*one].id.clone(),
            });
        }
        _ => {}
    }
    let mut notes = Vec::new();
    let surveyed = resect_all(rig, &seen, &mut notes)?;
    let posed: Vec<usize> = seen
        .iter()
        .copied()
        .filter(|&c| !surveyed[c].is_empty())
        .collect();
    let mut drafts = if posed.len() >= 2 {
        landmark_drafts(rig, &curves, &surveyed, (&posed, options))?
    } else {
        ball_drafts(rig, &curves, &surveyed, (&seen, &posed, options))?
    };
    drafts.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    drafts.truncate(options.hypotheses.max(1));
    if drafts.is_empty() {
        let best = seen
            .iter()
            .flat_map(|&a| seen.iter().map(move |&b| (a, b)))
            .filter(|(a, b)| a != b);
        let found = best.map(|(a, b)| curves.common(a, b).len()).max().unwrap_or(0);
        return Err(CalibrationError::TooFewPitches {
            found,
            needed: found.max(1),
        });
    }
    Ok(drafts.iter().map(|d| publish(rig, &curves, d, &notes)).collect())
}

/// Two or more cameras with landmark poses; the others by resection from the ball's paths.
fn landmark_drafts(
    rig: &Rig,
    curves: &Curves,
    surveyed: &[Vec<Resection>],
    (posed, options): (&[usize], &InitialOptions),
) -> Result<Vec<Draft>, CalibrationError> {
    let mut done = Vec::new();
    for draft in from_landmarks(rig, curves, surveyed, posed) {
        let mut evidence = evidence(rig, curves, draft.sightings.clone());
        let start = vec![(draft.cost, draft.state.clone())];
        for (_, state) in add_the_rest(rig, &evidence, start, (usize::MAX, 0))? {
            let mut next = Draft {
                state,
                ..draft.clone()
            };
            evidence.slack_px = 0.1;
            next.cost = polish_all(rig, &evidence, &mut next.state, (&[], options.polish_steps));
            next.score_px = evidence.score_px(&next.state);
            done.push(next);
        }
    }
    Ok(done)
}

/// No camera, or one, with a landmark pose: relative poses from the ball, then metres.
fn ball_drafts(
    rig: &Rig,
    curves: &Curves,
    surveyed: &[Vec<Resection>],
    (seen, posed, options): (&[usize], &[usize], &InitialOptions),
) -> Result<Vec<Draft>, CalibrationError> {
    let none = vec![Vec::new(); rig.cameras.len()];
    let anchor = match posed.first() {
        Some(&camera) => camera,
        None if seen.contains(&rig.reference) => rig.reference,
        None => seen[0],
    };
    let mut evidence_ball = evidence(rig, curves, none.clone());
    evidence_ball.slack_px = 0.05;
    let found = from_ball(rig, &mut evidence_ball, anchor, options)?;
    let mut drafts = Vec::new();
    for scored in found {
        let score_px = evidence_ball.score_px(&scored.1);
        if posed.is_empty() {
            let mut scored = scored;
            let (scale, surveyed) = make_metric(rig, &evidence_ball, &mut scored);
            let world = if surveyed {
                WorldFrame::HomePlate
            } else {
                WorldFrame::ReferenceCamera
            };
            let note = format!("no landmarks: {scale}");
            drafts.push(Draft {
                state: scored.1,
                sightings: none.clone(),
                cost: scored.0,
                world,
                score_px,
                notes: vec![note],
            });
            continue;
        }
        for resection in &surveyed[anchor] {
            let mut scored = scored.clone();
            make_metric_by_anchor(rig, &evidence_ball, &mut scored, (anchor, &resection.pose));
            let mut sightings = none.clone();
            sightings[anchor] = sightings_of(rig, anchor, resection);
            let mut metric = evidence(rig, curves, sightings.clone());
            metric.slack_px = 0.1;
            let polished = polish_all(rig, &metric, &mut scored.1, (&[], options.polish_steps));
            drafts.push(Draft {
                score_px: metric.score_px(&scored.1),
                cost: polished,
                state: scored.1,
                sightings,
                world: WorldFrame::HomePlate,
                notes: vec![format!(
                    "only camera {} has landmarks: physics fixes the scale",
                    rig.cameras[anchor].id
                )],
            });
        }
    }
    Ok(drafts)
}

/// Landmark poses of the cameras that have enough; what had to be left out goes to `notes`.
fn resect_all(
    rig: &Rig,
    seen: &[usize],
    notes: &mut Vec<String>,
) -> Result<Vec<Vec<Resection>>, CalibrationError> {
    let mut all = vec![Vec::new(); rig.cameras.len()];
    for &camera in seen {
        let setup = &rig.cameras[camera];
        if setup.landmarks.len() < LANDMARKS_NEEDED {
            continue;
        }
        match resect_camera(setup) {
            Ok(found) => {
                if let Some(best) = found.first() {
                    notes.extend(best.rejected.iter().map(|name| {
                        format!(
                            "camera {}: landmark {name:?} does not fit the others and was left out",
                            setup.id
                        )
                    }));
                }
                all[camera] = found;
            }
            Err(error @ CalibrationError::Vision(_)) => return Err(error),
            Err(error) => notes.push(format!("landmarks not used: {error}")),
        }
    }
    Ok(all)
}

fn evidence<'a>(rig: &Rig, curves: &'a Curves, sightings: Vec<Vec<Sighting>>) -> Evidence<'a> {
    Evidence {
        curves,
        lenses: rig.cameras.iter().map(|c| c.intrinsics).collect(),
        sightings,
        prior: PathPrior::pitch(rig.site.gravity_mps2),
        unit_baseline: None,
        slack_px: 1.0,
    }
}

/// Landmarks of a camera as sightings, without those its resection left out.
fn sightings_of(rig: &Rig, camera: usize, resection: &Resection) -> Vec<Sighting> {
    rig.cameras[camera]
        .landmarks
        .iter()
        .filter(|l| !resection.rejected.contains(&l.name))
        .map(|l| Sighting {
            world_m: l.position.world_m,
            world_sigma_m: l.position.world_sigma_m,
            pixel: l.pixel,
            sigma_px: l.sigma_px.map(|sigma| sigma.max(1e-3)),
        })
        .collect()
}

/// Every combination of the cameras' landmark poses (the six most likely), each with its likely delays.
fn from_landmarks(rig: &Rig, curves: &Curves, surveyed: &[Vec<Resection>], posed: &[usize]) -> Vec<Draft> {
    if posed.len() < 2 {
        return Vec::new();
    }
    let mut combinations: Vec<(f64, Vec<usize>)> = vec![(0.0, Vec::new())];
    for &camera in posed {
        combinations = combinations
            .iter()
            .flat_map(|(chi2, picks)| {
                surveyed[camera].iter().enumerate().map(move |(k, r)| {
                    let mut next = picks.clone();
                    next.push(k);
                    (chi2 + r.chi2, next)
                })
            })
            .collect();
    }
    combinations.sort_by(|a, b| a.0.total_cmp(&b.0));
    combinations.truncate(6);
    let mut drafts = Vec::new();
    for (_, picks) in combinations {
        let mut sightings = vec![Vec::new(); rig.cameras.len()];
        let mut poses = vec![None; rig.cameras.len()];
        for (&camera, &pick) in posed.iter().zip(&picks) {
            let resection = &surveyed[camera][pick];
            poses[camera] = Some(resection.pose);
            sightings[camera] = sightings_of(rig, camera, resection);
        }
        let evidence = evidence(rig, curves, sightings);
        drafts.extend(with_delays(rig, &evidence, &poses, posed));
    }
    drafts.sort_by(|a: &Draft, b| a.cost.total_cmp(&b.cost));
    // What is far worse than the best is not worth a polish.
    let best = drafts.first().map_or(0.0, |d| d.cost);
    drafts.retain(|d| d.cost < 2.0 * best + 2.0);
    drafts.truncate(6);
    drafts
}

/// Adds cameras with known poses one by one to the true time scale, forking where two delays are about as good.
fn with_delays(
    rig: &Rig,
    evidence: &Evidence,
    poses: &[Option<crate::geometry::Pose>],
    posed: &[usize],
) -> Vec<Draft> {
    let first = if posed.contains(&rig.reference) {
        rig.reference
    } else {
        posed[0]
    };
    let clocks = (0..poses.len())
        .map(|c| Clock {
            delay_s: 0.0,
            skew: 0.0,
            zero_s: evidence.curves.middle_s(c),
        })
        .collect();
    let mut start = State {
        poses: vec![None; poses.len()],
        clocks,
    };
    start.poses[first] = poses[first];
    let mut drafts = vec![Draft {
        state: start,
        sightings: evidence.sightings.clone(),
        cost: 0.0,
        world: WorldFrame::HomePlate,
        score_px: f64::INFINITY,
        notes: Vec::new(),
    }];
    let mut open: Vec<usize> = posed.iter().copied().filter(|&c| c != first).collect();
    while !open.is_empty() {
        let placed = Evidence::placed(&drafts[0].state);
        let shared = |c: usize| {
            placed
                .iter()
                .map(|&o| evidence.curves.common(o, c).len())
                .max()
                .unwrap_or(0)
        };
        let Some(&camera) = open.iter().max_by_key(|&&c| shared(c)) else {
            break;
        };
        open.retain(|&c| c != camera);
        let mut next = Vec::new();
        for draft in &drafts {
            let Some(window) = delay_window(rig, evidence, &draft.state, &placed, camera) else {
                continue;
            };
            let mut trial = draft.state.clone();
            trial.poses[camera] = poses[camera];
            let with_skew = skew_matters(rig, evidence, camera);
            for candidate in search_delay(evidence, &trial, camera, &window, (with_skew, 3)) {
                let mut state = trial.clone();
                state.clocks[camera] = candidate.clock;
                next.push(Draft {
                    state,
                    cost: candidate.cost,
                    ..draft.clone()
                });
            }
        }
        if next.is_empty() {
            continue;
        }
        next.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        let best = next[0].cost;
        next.retain(|d| d.cost < 1.5 * best + 1.0);
        next.truncate(3);
        drafts = next;
    }
    drafts.retain(|d| Evidence::placed(&d.state).len() >= 2);
    drafts
}

/// States delays against the rig's reference camera and in the terms of [`InitialEstimate`].
fn publish(rig: &Rig, curves: &Curves, draft: &Draft, notes: &[String]) -> InitialEstimate {
    let state = &draft.state;
    let zero = state.clocks[rig.reference];
    let reference_placed = state.poses[rig.reference].is_some();
    let mut notes = notes.to_vec();
    notes.extend(draft.notes.iter().cloned());
    let mut estimate = InitialEstimate {
        poses: state.poses.iter().map(|p| p.as_ref().map(orthonormal)).collect(),
        capture_delay_s: Vec::new(),
        clock_skew_ppm: Vec::new(),
        skew_epoch_ns: Vec::new(),
        world: draft.world,
        score_px: draft.score_px,
        notes: Vec::new(),
    };
    for (c, clock) in state.clocks.iter().enumerate() {
        if state.poses[c].is_none() {
            notes.push(format!("camera {} could not be placed", rig.cameras[c].id));
        }
        // The search runs on the time of one camera; delays are told against the reference's.
        let delay_s = if reference_placed {
            clock.delay_s - zero.delay_s
        } else {
            clock.delay_s
        };
        let is_reference = c == rig.reference;
        estimate
            .capture_delay_s
            .push(if is_reference { 0.0 } else { delay_s });
        estimate
            .clock_skew_ppm
            .push(if is_reference { 0.0 } else { 1e6 * clock.skew });
        estimate
            .skew_epoch_ns
            .push(curves.epoch_ns + (clock.zero_s * 1e9).round() as i64);
    }
    estimate.notes = notes;
    estimate
}
