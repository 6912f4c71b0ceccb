//! From pairs to a rig: seed with one pair, add the other cameras one by one, refine after each.

use nalgebra::Vector3;

use super::FreeOptions;
use super::agreement::Explained;
use super::pair::{PairGuess, PairSearch, search};
use super::path::Path;
use super::problem::{Distance, Problem, State};
use super::resect::{Fitted, Known, fit, scaled_start, searched_starts};
use super::solver::{fit_spline, minimise, update_scales};
use super::spline::Spline;
use super::support::Support;
use super::view::{CameraState, Column, Priors, View};
use crate::calibration::CalibrationError;
use crate::geometry::Pose;
use crate::scene::{ParameterKind as K, RollingShutter};

/// Everything the stages share.
pub(super) struct Session {
    pub views: Vec<View>,
    pub paths: Vec<Path>,
    /// Rough offset per camera: stamps + this = rough common time, seconds.
    pub offsets_s: Vec<f64>,
    pub shutters: Vec<RollingShutter>,
    pub focal_sigma: Vec<f64>,
    /// With times in seconds of the session.
    pub options: FreeOptions,
    /// How far the rough offsets may be off, seconds.
    pub range_s: f64,
}

/// A pair of cameras with one of its guesses.
#[derive(Debug, Clone, Copy)]
pub(super) struct Edge {
    pub cameras: (usize, usize),
    pub guess: PairGuess,
}

impl Edge {
    /// Good for a start: long, consistent and with parallax.
    pub fn score(&self) -> f64 {
        let g = &self.guess;
        let parallax = (g.parallax_deg.to_radians().sin() / 0.3).clamp(0.0, 1.0);
        let overlap = g.points as f64 / 150.0 * (g.common_s / 20.0).min(1.0);
        g.inlier_share.powi(2) * parallax * overlap / (1.0 + g.shift_sigma_s / 0.02)
    }
}

/// A grown rig with the smoothness and fit it came to.
pub(super) struct Grown {
    pub state: State,
    pub jerk_precision: f64,
    /// The camera whose pose and clock are held.
    pub anchor: usize,
    pub explained: Explained,
}

/// Knot spacing while the rig grows, seconds.
const COARSE_KNOT_S: f64 = 0.2;
/// Epipolar distance within which two cameras agree while the rig grows, pixels.
const GROWTH_AGREES_PX: f64 = 15.0;
/// Sightings of a camera this far apart are enough for that, seconds.
const THINNED_S: f64 = 0.055;

impl Session {
    /// Guesses for every pair of cameras.
    pub fn edges(&self) -> Result<Vec<Edge>, CalibrationError> {
        let mut edges = vec![];
        for first in 0..self.views.len() {
            for second in first + 1..self.views.len() {
                let options = PairSearch {
                    range_s: self.range_s,
                    step_s: self.options.shift_step_s,
                    samples: self.options.five_point_samples,
                    points: 150,
                    seed: self.options.seed,
                };
                let guesses = search(&self.paths[first], &self.paths[second], &options)?;
                edges.extend(guesses.into_iter().take(3).map(|guess| Edge {
                    cameras: (first, second),
                    guess,
                }));
            }
        }
        edges.sort_by(|a, b| b.score().total_cmp(&a.score()));
        Ok(edges)
    }

    fn unposed(&self, camera: usize, delay_s: f64) -> CameraState {
        let view = &self.views[camera];
        CameraState {
            pose: Pose::identity(),
            delay_s,
            skew_ppm: 0.0,
            readout_s: match self.shutters[camera] {
                RollingShutter::ReadoutSeconds(readout_s) => readout_s,
                RollingShutter::Estimate => self.options.readout_mean_s,
                RollingShutter::Global => 0.0,
            },
            lens: view.lens,
            noise: 2.0,
        }
    }

    /// The problem over restricted views, with the unknowns of a phase.
    pub fn problem<'v>(
        &self,
        views: &'v [View],
        state: &State,
        (anchor, phase): (usize, Phase),
    ) -> Problem<'v> {
        let mut columns = vec![];
        for camera in (0..views.len()).filter(|&c| state.cameras[c].is_some()) {
            let mut kinds = vec![];
            if camera != anchor {
                kinds.extend([
                    K::RotationX,
                    K::RotationY,
                    K::RotationZ,
                    K::TranslationX,
                    K::TranslationY,
                    K::TranslationZ,
                    K::CaptureDelay,
                    K::ClockSkew,
                ]);
            }
            if phase == Phase::Full {
                if self.shutters[camera] == RollingShutter::Estimate {
                    kinds.push(K::Readout);
                }
                let lens = &self.options.lens;
                if self.focal_sigma[camera] > 0.0 {
                    kinds.push(K::FocalScale);
                }
                if lens.principal_px > 0.0 {
                    kinds.extend([K::PrincipalX, K::PrincipalY]);
                }
                if lens.radial > 0.0 {
                    kinds.extend([K::RadialK1, K::RadialK2]);
                }
            }
            columns.extend(kinds.into_iter().map(|kind| Column { camera, kind }));
        }
        Problem {
            views,
            columns,
            distances: vec![],
            priors: Priors {
                skew_ppm: self.options.skew_sigma_ppm,
                readout_s: (self.options.readout_mean_s, self.options.readout_sigma_s),
                focal: self.focal_sigma.clone(),
                principal_px: self.options.lens.principal_px,
                radial: self.options.lens.radial,
            },
            jerk_precision: 1.0,
            acceleration_precision: 1e-9,
            tail: self.options.tail,
            redundancy: 1.0,
        }
    }

    /// Grows a rig from one edge.
    pub fn grow(&self, seed: &Edge, edges: &[Edge]) -> Result<Option<Grown>, CalibrationError> {
        self.seeded(seed)
            .map(|grown| self.extended(grown, edges))
            .transpose()
    }

    /// Adds cameras for as long as one fits.
    pub fn extended(&self, mut grown: Grown, edges: &[Edge]) -> Result<Grown, CalibrationError> {
        while let Some((camera, fitted)) = self.next_camera(&grown, edges)? {
            let mut candidate = grown.state.clone();
            let mut joined = fitted.camera;
            joined.noise = (fitted.median_px / 1.18).max(0.3);
            candidate.cameras[camera] = Some(joined);
            let anchor = grown.anchor;
            let Some(next) = self.refined(candidate, anchor, grown.jerk_precision) else {
                break;
            };
            grown = next;
        }
        Ok(grown)
    }

    /// Two cameras, a spline through their rays, and a first joint refinement.
    fn seeded(&self, seed: &Edge) -> Option<Grown> {
        let (first, second) = seed.cameras;
        let mut cameras = vec![None; self.views.len()];
        let start = self.unposed(first, -self.offsets_s[first]);
        let mut other = self.unposed(
            second,
            self.delay_from(&start, (first, second), seed.guess.shift_s),
        );
        other.pose = seed.guess.second_from_first;
        cameras[first] = Some(start);
        cameras[second] = Some(other);
        let state = State {
            cameras,
            spline: Spline::covering(&[(0.0, 1.0)], COARSE_KNOT_S),
        };
        self.refined(state, first, 0.0)
    }

    /// τ of a camera from a known one's and the shift between their rough times.
    fn delay_from(&self, known: &CameraState, (from, to): (usize, usize), shift_s: f64) -> f64 {
        known.delay_s + self.offsets_s[from] - self.offsets_s[to] + shift_s
    }

    /// Fits the spline to the posed cameras afresh and refines everything together on coarse knots.
    fn refined(&self, mut state: State, anchor: usize, jerk_precision: f64) -> Option<Grown> {
        let mut precision = jerk_precision;
        for _ in 0..2 {
            let agreeing = self.agreeing(&state, GROWTH_AGREES_PX);
            let support = Support::new(&agreeing, &state);
            let spans = support.spans();
            if spans.is_empty() {
                return None;
            }
            let views = support.restricted(&agreeing, &state, THINNED_S);
            state.spline = Spline::covering(&spans, COARSE_KNOT_S);
            let mut problem = self.problem(&views, &state, (anchor, Phase::Growth));
            problem.distances = vec![self.gauge(&state, anchor)?];
            let depth = self.depth(&views, &state, anchor);
            // A metre a second per second, in units of a scene ten depths wide: only a start.
            problem.jerk_precision = if precision > 0.0 {
                precision
            } else {
                (0.05 * depth).powi(-2)
            };
            fit_spline(&problem, &mut state, depth, 6)?;
            for _ in 0..3 {
                minimise(&problem, &mut state, 6, 1e-4);
                update_scales(&mut problem, &mut state)?;
            }
            precision = problem.jerk_precision;
        }
        let explained = self.explained(&state);
        Some(Grown {
            state,
            jerk_precision: precision,
            anchor,
            explained,
        })
    }

    /// Holds the length of the first baseline of the anchor.
    pub fn gauge(&self, state: &State, anchor: usize) -> Option<Distance> {
        let home = state.cameras[anchor].as_ref()?.pose.centre_m();
        let other = (0..state.cameras.len()).find(|&c| c != anchor && state.cameras[c].is_some())?;
        let distance = (state.cameras[other].as_ref()?.pose.centre_m() - home).norm();
        Some(Distance {
            cameras: (anchor, other),
            distance,
            sigma: 1e-6 * distance,
        })
    }

    /// Median distance of the thing from the anchor, from rays of two cameras at the same time; a baseline
    /// where there is none.
    pub fn depth(&self, views: &[View], state: &State, anchor: usize) -> f64 {
        let Some(home) = &state.cameras[anchor] else {
            return 1.0;
        };
        let mut depths = vec![];
        for (other, camera) in state.cameras.iter().enumerate() {
            let Some(camera) = camera.as_ref().filter(|_| other != anchor) else {
                continue;
            };
            let relative = camera.pose.compose(&home.pose.inverse());
            for s in views[anchor].sightings.iter().step_by(7) {
                let rough_s = views[anchor].true_s(home, s) + camera.delay_s + self.offsets_s[other];
                let ray = home
                    .lens
                    .direction(crate::geometry::Pixel::new(s.pixel_px.x, s.pixel_px.y));
                let (Ok(a), Some(b)) = (ray, self.paths[other].at(rough_s)) else {
                    continue;
                };
                let a = relative.rotation * Vector3::new(a.x, a.y, 1.0);
                let b = Vector3::new(b.x, b.y, 1.0);
                let along = b.cross(&a);
                let depth = -b.cross(&relative.translation_m).dot(&along) / along.norm_squared();
                if depth > 0.0 && depth.is_finite() {
                    depths.push(depth);
                }
            }
        }
        depths.sort_by(f64::total_cmp);
        depths.get(depths.len() / 2).copied().unwrap_or(1.0)
    }

    /// The camera that fits the motion known so far best, if any fits.
    fn next_camera(
        &self,
        grown: &Grown,
        edges: &[Edge],
    ) -> Result<Option<(usize, Fitted)>, CalibrationError> {
        let support = Support::new(&self.agreeing(&grown.state, GROWTH_AGREES_PX), &grown.state);
        let known = Known {
            spline: &grown.state.spline,
            shared: &support.shared,
        };
        let mut best: Option<(usize, Fitted)> = None;
        for camera in (0..self.views.len()).filter(|&c| grown.state.cameras[c].is_none()) {
            let mut fits = vec![];
            for start in self.starts_from_edges(grown, camera, (edges, known)) {
                fits.extend(fit(&self.views[camera], known, &start));
            }
            if !fits.iter().any(good) {
                let rough = self.unposed(camera, self.rough_delay(grown, camera));
                let range = (self.range_s, self.options.shift_step_s);
                for start in searched_starts(&self.views[camera], known, &rough, range)? {
                    fits.extend(fit(&self.views[camera], known, &start));
                }
            }
            for fitted in fits.into_iter().filter(good) {
                if best.as_ref().is_none_or(|(_, b)| worth(&fitted) > worth(b)) {
                    best = Some((camera, fitted));
                }
            }
        }
        Ok(best)
    }

    /// Where the rough offsets alone put a camera's delay in the grown rig's time.
    fn rough_delay(&self, grown: &Grown, camera: usize) -> f64 {
        let anchor = grown.state.cameras[grown.anchor].as_ref();
        anchor.map_or(0.0, |a| self.delay_from(a, (grown.anchor, camera), 0.0))
    }

    fn starts_from_edges(
        &self,
        grown: &Grown,
        camera: usize,
        (edges, known): (&[Edge], Known),
    ) -> Vec<CameraState> {
        let mut starts = vec![];
        for edge in edges {
            let (from, relative, shift_s) = if edge.cameras.1 == camera {
                (edge.cameras.0, edge.guess.second_from_first, edge.guess.shift_s)
            } else if edge.cameras.0 == camera {
                (
                    edge.cameras.1,
                    edge.guess.second_from_first.inverse(),
                    -edge.guess.shift_s,
                )
            } else {
                continue;
            };
            let Some(neighbour) = &grown.state.cameras[from] else {
                continue;
            };
            let start = self.unposed(camera, self.delay_from(neighbour, (from, camera), shift_s));
            starts.extend(scaled_start(
                &self.views[camera],
                known,
                (&neighbour.pose, &relative),
                &start,
            ));
            if starts.len() >= 8 {
                break;
            }
        }
        starts
    }
}

/// Which unknowns are free.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Phase {
    /// Poses, delays and skews.
    Growth,
    /// Also readouts and lenses, as the rig asks.
    Full,
}

fn good(fitted: &Fitted) -> bool {
    fitted.sightings >= 40 && fitted.inlier_share > 0.4
}

fn worth(fitted: &Fitted) -> f64 {
    fitted.inlier_share * (fitted.sightings as f64).min(1000.0)
}
