//! How near the estimator comes to the Cramér–Rao bound: one scenario over many seeds, error beside sigma and
//! bound, coverage of the 95 % intervals, NEES.

use std::fmt;

use nalgebra::Point3;
use serde::Serialize;

use super::{efficiency_plot, parallel};
use crate::calibration::association::{AssociationOptions, associate};
use crate::calibration::joint::{Bound, BoundOptions, Clocks, JointOptions, bound};
use crate::calibration::recipe::{CalibrationOptions, CalibrationOutcome, calibrate};
use crate::calibration::{InitialEstimate, PitchTracks};
use crate::flight::sighting::CameraNoise;
use crate::flight::{PLATE_FRONT_Y_M, PLATE_MIDDLE_Y_M, RELEASE_Y_M, state_at_plane};
use crate::geometry::Pose;
use crate::scene::WorldFrame;
use crate::simulation::{Scenario, Simulated, SimulationError, simulate_tracks};

/// What is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Quantity {
    /// Capture delay, frames.
    DelayFrames,
    /// x at the front of the plate, metres.
    PlateX,
    /// z at the front of the plate, metres.
    PlateZ,
    /// Speed at 54.5 ft, m/s.
    ReleaseSpeed,
}

/// One error.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Trial {
    /// Seed of the scenario.
    pub seed: u64,
    /// What.
    pub quantity: Quantity,
    /// Camera or pitch it belongs to.
    pub of: String,
    /// Estimate − truth.
    pub error: f64,
    /// 1σ that the estimator states.
    pub sigma: f64,
    /// 1σ of the Cramér–Rao bound.
    pub bound: f64,
}

/// A seed that gave no calibration, or left pitches out.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Failure {
    /// Seed.
    pub seed: u64,
    /// Why.
    pub reason: String,
}

/// One quantity over all seeds.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Summary {
    /// What.
    pub quantity: Quantity,
    /// Camera, or all pitches.
    pub of: String,
    /// Errors counted.
    pub count: usize,
    /// Root mean square error.
    pub rms_error: f64,
    /// Root mean square bound.
    pub bound: f64,
    /// Mean absolute error.
    pub mean_absolute_error: f64,
    /// rms error over bound.
    pub ratio: f64,
    /// Share of errors within 1.96 stated sigmas.
    pub coverage_95: f64,
    /// Mean squared error in stated sigmas: 1 when they are honest.
    pub nees: f64,
}

/// The study.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Efficiency {
    /// Every error.
    pub trials: Vec<Trial>,
    /// What failed.
    pub failures: Vec<Failure>,
    /// Mean time of one calibration, seconds; more than its CPU time where the machine is shared.
    pub calibration_s: f64,
    /// By quantity.
    pub summaries: Vec<Summary>,
}

/// Why there is no study.
#[derive(Debug, thiserror::Error)]
pub enum EfficiencyError {
    /// The scenario cannot be simulated.
    #[error(transparent)]
    Simulation(#[from] SimulationError),
    /// The scene has no bound.
    #[error(transparent)]
    Calibration(#[from] crate::calibration::CalibrationError),
}

/// The true cameras as a start.
pub fn true_start(simulated: &Simulated) -> InitialEstimate {
    let cameras = &simulated.truth.cameras;
    let world = if simulated.rig.cameras.iter().any(|c| c.landmarks.len() > 3) {
        WorldFrame::HomePlate
    } else {
        WorldFrame::ReferenceCamera
    };
    // Without landmarks the world begins at the reference camera; z stays up.
    let origin = match world {
        WorldFrame::HomePlate => Point3::origin(),
        WorldFrame::ReferenceCamera => {
            let reference = simulated.truth.camera(&simulated.truth.reference);
            reference.map_or(Point3::origin(), |c| c.camera_from_world.centre_m())
        }
    };
    let moved = |pose: &Pose| Pose {
        rotation: pose.rotation,
        translation_m: pose.translation_m + pose.rotation * origin.coords,
    };
    InitialEstimate {
        poses: cameras
            .iter()
            .map(|c| Some(moved(&c.camera_from_world)))
            .collect(),
        capture_delay_s: cameras.iter().map(|c| c.capture_delay_s).collect(),
        clock_skew_ppm: cameras.iter().map(|c| c.clock_skew_ppm).collect(),
        skew_epoch_ns: cameras.iter().map(|c| c.skew_epoch_ns).collect(),
        world,
        score_px: 0.0,
        notes: Vec::new(),
    }
}

/// The bound of a scene and the pitches it speaks of. Points are those of the simulation that fit the truth;
/// clutter carries no information.
///
/// # Errors
/// [`EfficiencyError`] where the scene cannot be simulated or has no bound.
pub fn scene_bound(scenario: &Scenario) -> Result<(Vec<PitchTracks>, Bound), EfficiencyError> {
    let mut clean = scenario.clone();
    clean.clutter.tracks_per_pitch = 0;
    let simulated = &simulate_tracks(&clean)?;
    let pitches = associate(&simulated.rig, &simulated.tracks, &AssociationOptions::default()).pitches;
    let drifting = simulated.truth.cameras.iter().any(|c| c.clock_skew_ppm != 0.0);
    let options = BoundOptions {
        joint: JointOptions::default(),
        noise: scenario
            .cameras
            .iter()
            .map(|c| CameraNoise {
                sigma_px: scenario.detection.sigma_px,
                variance_factor: 1.0,
                jitter_s: c.jitter_s,
            })
            .collect(),
        clocks: if drifting {
            Clocks::Drifting
        } else {
            Clocks::Steady
        },
        plate_y_m: [PLATE_FRONT_Y_M, PLATE_MIDDLE_Y_M],
        release_y_m: RELEASE_Y_M,
    };
    let bound = bound(&simulated.rig, &pitches, &true_start(simulated), &options)?;
    Ok((pitches, bound))
}

/// Calibrates the scenario under `seeds` seeds from its own on, on all cores. `each` hears how many are done.
///
/// # Errors
/// [`EfficiencyError`]: a scenario that cannot be simulated or has no bound. A calibration that fails is
/// counted among the failures.
pub fn study(
    scenario: &Scenario,
    seeds: u64,
    each: impl FnMut(usize),
) -> Result<Efficiency, EfficiencyError> {
    let mut study = Efficiency::default();
    let of_seed = |k: usize| -> Result<Efficiency, EfficiencyError> {
        let seed = scenario.seed + k as u64;
        let scenario = scenario.clone().with_seed(seed);
        let simulated = simulate_tracks(&scenario)?;
        let (of_bound, bound) = scene_bound(&scenario)?;
        let clock = std::time::Instant::now();
        let outcome = calibrate(&simulated.rig, &simulated.tracks, &CalibrationOptions::default());
        let mut own = Efficiency {
            calibration_s: clock.elapsed().as_secs_f64(),
            ..Efficiency::default()
        };
        match outcome {
            Ok(outcome) => own.add(seed, &simulated, &outcome, (&of_bound, &bound)),
            Err(error) => own.failures.push(Failure {
                seed,
                reason: error.to_string(),
            }),
        }
        Ok(own)
    };
    for own in parallel::each(usize::try_from(seeds).unwrap_or(usize::MAX), of_seed, each) {
        let own = own?;
        study.calibration_s += own.calibration_s / seeds as f64;
        study.trials.extend(own.trials);
        study.failures.extend(own.failures);
    }
    study.summarise();
    Ok(study)
}

impl Efficiency {
    fn add(
        &mut self,
        seed: u64,
        simulated: &Simulated,
        outcome: &CalibrationOutcome,
        bound: (&[PitchTracks], &Bound),
    ) {
        for camera in &simulated.truth.cameras {
            let own = outcome.calibration.camera(&camera.id);
            let limit = bound.1.cameras.iter().find(|c| c.camera == camera.id);
            let (Some(own), Some(limit)) = (own, limit) else {
                self.failures.push(Failure {
                    seed,
                    reason: format!("camera {} left out", camera.id),
                });
                continue;
            };
            if camera.id == simulated.truth.reference {
                continue;
            }
            // Both at the estimate's epoch.
            let since_s = (own.skew_epoch_ns - camera.skew_epoch_ns) as f64 / 1e9;
            let truth = camera.capture_delay_s + 1e-6 * camera.clock_skew_ppm * since_s;
            self.trials.push(Trial {
                seed,
                quantity: Quantity::DelayFrames,
                of: camera.id.to_string(),
                error: (own.capture_delay_s - truth) * camera.frame_rate_hz,
                sigma: own.capture_delay_sigma_s * camera.frame_rate_hz,
                bound: limit.delay_sigma_s * camera.frame_rate_hz,
            });
        }
        for (index, pitch) in simulated.truth.pitches.iter().enumerate() {
            if let Err(reason) = self.add_pitch(seed, pitch, outcome, bound) {
                self.failures.push(Failure {
                    seed,
                    reason: format!("pitch {} ({}): {reason}", index + 1, pitch.name),
                });
            }
        }
    }

    fn add_pitch(
        &mut self,
        seed: u64,
        truth: &crate::simulation::PitchTruth,
        outcome: &CalibrationOutcome,
        bound: (&[PitchTracks], &Bound),
    ) -> Result<(), String> {
        // The flight whose span holds the middle of the true one.
        let middle_ns = (truth.start_time_ns + truth.end_time_ns) / 2;
        let found = outcome.flights.iter().find(|f| {
            let t = (middle_ns - f.flight.trajectory.epoch_ns()) as f64 / 1e9;
            let (begin, end) = f.flight.observed_s;
            (begin..end).contains(&t)
        });
        let found = found.ok_or("not found")?;
        if outcome.calibration.world != WorldFrame::HomePlate {
            return Ok(());
        }
        let limit = bound.1.pitches.iter().find(|p| {
            let stamps = bound.0[p.pitch].tracks.iter().filter_map(|t| t.span());
            // Association numbers pitches anew when there is clutter; stamps are within ±1 s of true time.
            stamps
                .map(|(a, b)| (a.nanos(), b.nanos()))
                .any(|(a, b)| (a - 1_000_000_000..b + 1_000_000_000).contains(&middle_ns))
        });
        let flight = &found.flight;
        let of = format!("{} {}", truth.pitch, truth.name);
        let mut push = |quantity, error, sigma, bound| {
            self.trials.push(Trial {
                seed,
                quantity,
                of: of.clone(),
                error,
                sigma,
                bound,
            });
        };
        let at = |y_m, what| {
            state_at_plane(&flight.trajectory, &flight.covariance, (y_m, what)).map_err(|e| e.to_string())
        };
        if let Some([x, z]) = truth.plate_front_m {
            let plate = at(PLATE_FRONT_Y_M, "plate")?;
            let limit = limit.and_then(|l| l.plate_sigma_m[0]).unwrap_or([f64::NAN; 2]);
            push(Quantity::PlateX, plate.position_m.x - x, plate.sigma(0), limit[0]);
            push(Quantity::PlateZ, plate.position_m.z - z, plate.sigma(2), limit[1]);
        }
        if let Some(speed) = truth.release_speed_mps {
            let release = at(RELEASE_Y_M, "release")?;
            let limit = limit.and_then(|l| l.release_speed_sigma_mps).unwrap_or(f64::NAN);
            push(
                Quantity::ReleaseSpeed,
                release.speed_mps - speed,
                release.sigma(6),
                limit,
            );
        }
        Ok(())
    }

    fn summarise(&mut self) {
        let mut groups: Vec<(Quantity, String)> = self
            .trials
            .iter()
            .map(|t| match t.quantity {
                Quantity::DelayFrames => (t.quantity, t.of.clone()),
                _ => (t.quantity, "all pitches".to_owned()),
            })
            .collect();
        groups.sort();
        groups.dedup();
        self.summaries = groups
            .into_iter()
            .map(|(quantity, of)| summary(quantity, of.clone(), self.trials_of(quantity, &of)))
            .collect();
    }

    fn trials_of(&self, quantity: Quantity, of: &str) -> impl Iterator<Item = &Trial> {
        self.trials
            .iter()
            .filter(move |t| t.quantity == quantity && (quantity != Quantity::DelayFrames || t.of == of))
    }

    /// Errors over their stated sigmas of one summary's quantity.
    pub fn errors_in_sigmas(&self, summary: &Summary) -> Vec<f64> {
        self.trials_of(summary.quantity, &summary.of)
            .map(|t| t.error / t.sigma)
            .collect()
    }

    /// The study as a picture: a histogram of [`Self::errors_in_sigmas`] per summary.
    pub fn svg(&self) -> String {
        efficiency_plot::svg(self)
    }

    /// Every error as CSV.
    pub fn csv(&self) -> String {
        let mut text = "seed,quantity,of,error,sigma,bound\n".to_owned();
        for t in &self.trials {
            text += &format!(
                "{},{:?},{},{:e},{:e},{:e}\n",
                t.seed, t.quantity, t.of, t.error, t.sigma, t.bound
            );
        }
        text
    }
}

fn summary<'a>(quantity: Quantity, of: String, trials: impl Iterator<Item = &'a Trial>) -> Summary {
    let (mut n, mut square, mut bound2, mut bounded, mut absolute) = (0usize, 0.0, 0.0, 0usize, 0.0);
    let (mut covered, mut nees) = (0usize, 0.0);
    for t in trials {
        n += 1;
        square += t.error * t.error;
        absolute += t.error.abs();
        if t.bound.is_finite() {
            bound2 += t.bound * t.bound;
            bounded += 1;
        }
        let ratio = t.error / t.sigma;
        covered += usize::from(ratio.abs() <= 1.96);
        nees += ratio * ratio;
    }
    let count = n.max(1) as f64;
    let rms_error = (square / count).sqrt();
    let bound = (bound2 / bounded.max(1) as f64).sqrt();
    Summary {
        quantity,
        of,
        count: n,
        rms_error,
        bound,
        mean_absolute_error: absolute / count,
        ratio: rms_error / bound,
        coverage_95: covered as f64 / count,
        nees: nees / count,
    }
}

impl fmt::Display for Efficiency {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{:<14} {:<12} {:>6} {:>10} {:>10} {:>7} {:>9} {:>6}",
            "quantity", "of", "n", "rms", "bound", "ratio", "cover95", "NEES"
        )?;
        for s in &self.summaries {
            writeln!(
                f,
                "{:<14} {:<12} {:>6} {:>10.5} {:>10.5} {:>7.3} {:>8.1}% {:>6.2}",
                format!("{:?}", s.quantity),
                s.of,
                s.count,
                s.rms_error,
                s.bound,
                s.ratio,
                100.0 * s.coverage_95,
                s.nees
            )?;
        }
        writeln!(f, "calibration: {:.3} s each", self.calibration_s)?;
        writeln!(f, "failures: {}", self.failures.len())?;
        for failure in self.failures.iter().take(20) {
            writeln!(f, "  seed {}: {}", failure.seed, failure.reason)?;
        }
        Ok(())
    }
}
