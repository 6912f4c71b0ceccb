//! Initial values: ranked hypotheses of every camera's pose and delay, from landmarks where there are any,
//! else from the ball alone.

use super::curves::Curves;
use super::delay_search::{delay_window, search_delay, skew_matters};
use super::path::PathPrior;
use super::polish::{Clock, Evidence, State, Unknown, WithSkew};
use super::resection::{LANDMARKS_NEEDED, Resection, Sighting, resect_camera};
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
}

impl Default for InitialOptions {
    fn default() -> Self {
        Self {
            hypotheses: 4,
            samples: 10,
            polish_steps: 6,
            seed: 1,
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
    let drafts = from_landmarks(rig, &curves, &surveyed, &posed);
    let mut estimates: Vec<(f64, InitialEstimate)> = Vec::new();
    for mut draft in drafts {
        let mut evidence = evidence(rig, &curves, draft.sightings.clone());
        polish(rig, &mut evidence, &mut draft, options.polish_steps);
        estimates.push((draft.cost, publish(rig, &evidence, &draft.state, &notes)));
    }
    estimates.sort_by(|a, b| a.0.total_cmp(&b.0));
    estimates.truncate(options.hypotheses.max(1));
    if estimates.is_empty() {
        return Err(CalibrationError::TooFewPitches { found: 0, needed: 1 });
    }
    Ok(estimates.into_iter().map(|(_, e)| e).collect())
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
            sigma_px: l.sigma_px.max(1e-3),
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
                    sightings: draft.sightings.clone(),
                    cost: candidate.cost,
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

/// Brings a draft near its minimum and states its cost there.
fn polish(rig: &Rig, evidence: &mut Evidence, draft: &mut Draft, steps: usize) {
    let placed = Evidence::placed(&draft.state);
    let reference = if placed.contains(&rig.reference) {
        rig.reference
    } else {
        placed[0]
    };
    let with_skew = placed
        .iter()
        .any(|&c| skew_matters(rig, evidence, c) == WithSkew::Yes);
    let with_skew = if with_skew { WithSkew::Yes } else { WithSkew::No };
    let unknowns = Unknown::all(&draft.state, reference, &[], with_skew);
    evidence.slack_px = 0.1;
    draft.cost = evidence.polish(&mut draft.state, &unknowns, steps);
}

/// States delays against the rig's reference camera and in the terms of [`InitialEstimate`].
fn publish(rig: &Rig, evidence: &Evidence, state: &State, notes: &[String]) -> InitialEstimate {
    let epoch_ns = evidence.curves.epoch_ns;
    let score_px = evidence.score_px(state);
    let zero = state.clocks[rig.reference];
    let reference_placed = state.poses[rig.reference].is_some();
    let mut notes = notes.to_vec();
    let mut estimate = InitialEstimate {
        poses: state.poses.clone(),
        capture_delay_s: Vec::new(),
        clock_skew_ppm: Vec::new(),
        skew_epoch_ns: Vec::new(),
        world: WorldFrame::HomePlate,
        score_px,
        notes: Vec::new(),
    };
    for (c, clock) in state.clocks.iter().enumerate() {
        if state.poses[c].is_none() {
            notes.push(format!("camera {} could not be placed", rig.cameras[c].id));
        }
        // true_ref = stamped_ref − zero.delay …: the reference's own delay is moved to all others.
        let delay_s = if reference_placed {
            clock.delay_s - zero.delay_s
        } else {
            clock.delay_s
        };
        estimate
            .capture_delay_s
            .push(if c == rig.reference { 0.0 } else { delay_s });
        estimate
            .clock_skew_ppm
            .push(if c == rig.reference { 0.0 } else { 1e6 * clock.skew });
        estimate
            .skew_epoch_ns
            .push(epoch_ns + (clock.zero_s * 1e9).round() as i64);
    }
    estimate.notes = notes;
    estimate
}
