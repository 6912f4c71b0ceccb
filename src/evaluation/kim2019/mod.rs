//! The paper's whole experiment [Kim19 §II–IV] with `joint` beside it: Table 1, the error matrices of Figs 13–15
//! with the means of Figs 16–18, and the protocol of Tables 3–7 on simulated pitches.

pub mod cells;
mod heat_map;
mod page;
mod printed;
pub mod protocol;
pub mod space;
mod tables;

use nalgebra::Point3;

use self::cells::{Algorithm, Cell, Draws};
use self::protocol::{ProtocolOptions, Trial};
use self::space::NoisePreset;
use super::parallel;
use crate::calibration::kim2019::trajectory::{ImageTrajectory, StrayPoints, TrajectoryModel};
use crate::calibration::{CalibrationError, PitchTracks};
use crate::geometry::triangulate_dlt;
use crate::scene::{CameraIdError, Rig};
use crate::simulation::SimulationError;

/// How much of the experiment is run, and with what the paper leaves open.
#[derive(Debug, Clone, PartialEq)]
pub struct StudyOptions {
    /// Delays of the matrices, frames, for τ2 and τ3 alike.
    pub delays_frames: Vec<f64>,
    /// Presets by number, 1 to 7.
    pub presets: Vec<usize>,
    /// σ_c of N_c, frames: not given in the paper.
    pub capture_sigma_frames: f64,
    /// Draws of the noise per cell of a noisy preset, whose mean errors the cell holds (one in the paper).
    pub draws: u64,
    /// Seed of the noise.
    pub seed: u64,
    /// The two-camera trials.
    pub protocol: ProtocolOptions,
}

impl StudyOptions {
    /// Everything the paper has.
    pub fn full() -> Self {
        Self {
            delays_frames: (-4..=4).map(|k| 0.5 * f64::from(k)).collect(),
            presets: (1..=7).collect(),
            capture_sigma_frames: 0.05,
            draws: 4,
            seed: 1,
            protocol: ProtocolOptions {
                trials: 4,
                detection_sigma_px: 0.3,
                jitter_frames: 0.02,
            },
        }
    }

    /// Four cells of three presets and one trial per delay: the same code in seconds.
    pub fn quick() -> Self {
        let full = Self::full();
        Self {
            delays_frames: vec![-1.5, 1.0],
            presets: vec![1, 5, 7],
            draws: 1,
            protocol: ProtocolOptions {
                trials: 1,
                ..full.protocol
            },
            ..full
        }
    }
}

/// Why the experiment could not be run.
#[derive(Debug, thiserror::Error)]
pub enum StudyError {
    /// A method could not even start.
    #[error(transparent)]
    Calibration(#[from] CalibrationError),
    /// The two-camera scenario.
    #[error(transparent)]
    Simulation(#[from] SimulationError),
    /// A camera name.
    #[error(transparent)]
    CameraId(#[from] CameraIdError),
    /// A preset that does not exist.
    #[error("there is no preset N{0}: N1 to N7")]
    UnknownPreset(usize),
}

/// One preset's matrix.
#[derive(Debug, Clone)]
pub struct Matrix {
    /// The noise.
    pub preset: NoisePreset,
    /// Row by row: τ3 down, τ2 across.
    pub cells: Vec<Cell>,
}

/// Everything found.
#[derive(Debug, Clone)]
pub struct Study {
    /// What was run.
    pub options: StudyOptions,
    /// Table 1: timing difference in frames, 3-D error in centimetres.
    pub table_1: Vec<(f64, f64)>,
    /// Mean distance of noise-free points to F1, to F2 (cubic), and to F2 with pieces of degree 2, pixels.
    pub misfit_px: [f64; 3],
    /// Error matrices.
    pub matrices: Vec<Matrix>,
    /// Two-camera trials.
    pub trials: Vec<Trial>,
}

/// Runs the experiment on all cores; `progress` hears how many of how many steps are done.
///
/// # Errors
/// [`StudyError`]; an algorithm that fails in a cell is a gap in the tables, not an error.
pub fn run(options: &StudyOptions, mut progress: impl FnMut(usize, usize)) -> Result<Study, StudyError> {
    let rig = space::rig()?;
    let all = space::presets(options.capture_sigma_frames);
    let preset_of = |number: usize| {
        let found = number.checked_sub(1).and_then(|n| all.get(n)).copied();
        found.ok_or(StudyError::UnknownPreset(number))
    };
    let presets: Vec<NoisePreset> = options
        .presets
        .iter()
        .map(|&n| preset_of(n))
        .collect::<Result<_, _>>()?;
    let size = options.delays_frames.len();
    let per_matrix = size * size;
    let of_matrices = presets.len() * per_matrix;
    let per_delay = options.protocol.trials;
    let steps = of_matrices + PROTOCOL_DELAYS_FRAMES.len() * per_delay;
    let work = |step: usize| -> Result<Step, StudyError> {
        if let Some(trial) = step.checked_sub(of_matrices) {
            let delay_frames = PROTOCOL_DELAYS_FRAMES[trial / per_delay];
            let trial = protocol::run(delay_frames, 1 + trial % per_delay, &options.protocol)?;
            return Ok(Step::Trial(trial));
        }
        let (matrix, cell) = (step / per_matrix, step % per_matrix);
        let delays = [
            options.delays_frames[cell % size],
            options.delays_frames[cell / size],
        ];
        let draws = Draws {
            first_seed: options.seed + 1000 * (options.presets[matrix] * per_matrix + cell) as u64,
            count: if presets[matrix].is_noisy() {
                options.draws
            } else {
                1
            },
        };
        Ok(Step::Cell(cells::run(&rig, delays, &presets[matrix], draws)?))
    };
    let (mut cells, mut trials) = (Vec::new(), Vec::new());
    for step in parallel::each(steps, work, |done| progress(done, steps)) {
        match step? {
            Step::Cell(cell) => cells.push(cell),
            Step::Trial(trial) => trials.push(trial),
        }
    }
    let matrices = presets
        .iter()
        .zip(cells.chunks(per_matrix.max(1)))
        .map(|(preset, cells)| Matrix {
            preset: *preset,
            cells: cells.to_vec(),
        })
        .collect();
    Ok(Study {
        options: options.clone(),
        table_1: table_1(&rig, &all[2], options.seed),
        misfit_px: misfit(&rig, &all[0]),
        matrices,
        trials,
    })
}

/// τ2 of the real experiment, frames.
const PROTOCOL_DELAYS_FRAMES: [f64; 4] = [1.0 / 3.0, 0.5, 2.0 / 3.0, 1.0];

/// One independent piece of the experiment.
enum Step {
    Cell(Cell),
    Trial(Trial),
}

/// Table 1: known poses, whole-pixel centres (N3), camera 2 late by the difference, nothing corrected.
fn table_1(rig: &Rig, preset: &NoisePreset, seed: u64) -> Vec<(f64, f64)> {
    let poses = space::poses();
    printed::TABLE_1
        .iter()
        .map(|(difference, _)| {
            let pitches = space::pitches(rig, &[0.0, *difference, 0.0], preset, (seed, 0.0));
            let mut errors_m: Vec<f64> = Vec::new();
            for (k, pitch) in pitches.iter().enumerate() {
                errors_m.extend((0..108).filter_map(|frame| uncorrected_m(rig, &poses, (k, pitch), frame)));
            }
            (
                *difference,
                100.0 * errors_m.iter().sum::<f64>() / errors_m.len().max(1) as f64,
            )
        })
        .collect()
}

fn uncorrected_m(
    rig: &Rig,
    poses: &[crate::geometry::Pose; 3],
    (number, pitch): (usize, &PitchTracks),
    frame: usize,
) -> Option<f64> {
    let mut views = Vec::new();
    for ((camera, pose), track) in rig.cameras.iter().zip(poses).zip(&pitch.tracks) {
        views.push((
            *pose,
            camera.intrinsics.direction(track.points.get(frame)?.pixel).ok()?,
        ));
    }
    let found: Point3<f64> = triangulate_dlt(&views).ok()?;
    let time_s = space::start_s(number) + frame as f64 / space::RATE_HZ;
    Some((found - space::truth_at(number, time_s)?).norm())
}

/// Mean distance of noise-free points to the models.
fn misfit(rig: &Rig, preset: &NoisePreset) -> [f64; 3] {
    let pitches = space::pitches(rig, &[0.0; 3], preset, (1, 0.0));
    let models = [
        TrajectoryModel::Quadratic,
        TrajectoryModel::PAPER,
        TrajectoryModel::Spline { pieces: 8, degree: 2 },
    ];
    models.map(|model| {
        let fits: Vec<f64> = pitches
            .iter()
            .flat_map(|p| rig.cameras.iter().map(move |c| (c, p)))
            .filter_map(|(c, p)| ImageTrajectory::fit(c, p, space::EPOCH_NS, (model, StrayPoints::Keep)))
            .map(|t| t.misfit_px)
            .collect();
        fits.iter().sum::<f64>() / fits.len().max(1) as f64
    })
}

/// The three errors of the paper's matrices.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
pub enum Measure {
    /// |τ2 − τ2*|, frames.
    Tau2,
    /// |τ3 − τ3*|, frames.
    Tau3,
    /// 3-D error, centimetres.
    Distance,
}

impl Measure {
    /// Figs 13–15 (16–18).
    pub const ALL: [Self; 3] = [Self::Tau2, Self::Tau3, Self::Distance];

    /// Name and unit.
    pub fn name(self) -> (&'static str, &'static str) {
        match self {
            Self::Tau2 => ("tau2 error", "frame"),
            Self::Tau3 => ("tau3 error", "frame"),
            Self::Distance => ("3-D error", "cm"),
        }
    }
}

impl Matrix {
    /// One error of one algorithm in every cell; NaN where it failed.
    pub fn errors(&self, algorithm: Algorithm, measure: Measure) -> Vec<f64> {
        let k = Algorithm::ALL.iter().position(|a| *a == algorithm).unwrap_or(0);
        self.cells
            .iter()
            .map(|c| match c.errors.get(k).copied().flatten() {
                Some(e) => match measure {
                    Measure::Tau2 => e.delay_frames[0],
                    Measure::Tau3 => e.delay_frames[1],
                    Measure::Distance => e.distance_cm,
                },
                None => f64::NAN,
            })
            .collect()
    }

    /// Mean, standard deviation and number of cells in which the algorithm answered.
    pub fn mean_sd(&self, algorithm: Algorithm, measure: Measure) -> (f64, f64, usize) {
        mean_sd(&self.errors(algorithm, measure))
    }
}

/// Mean, standard deviation and number of the finite values.
pub fn mean_sd(values: &[f64]) -> (f64, f64, usize) {
    let finite: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    let n = finite.len() as f64;
    let mean = finite.iter().sum::<f64>() / n;
    let spread = finite.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n;
    (mean, spread.sqrt(), finite.len())
}

impl Study {
    /// One self-contained page: ours beside the paper's, heat maps inside.
    pub fn html(&self) -> String {
        page::html(self)
    }

    /// Files by name: CSV tables and heat maps.
    pub fn files(&self) -> Vec<(String, String)> {
        let mut files = tables::csv(self);
        files.extend(
            page::heat_maps(self)
                .into_iter()
                .map(|(name, svg)| (format!("{name}.svg"), svg)),
        );
        files
    }

    /// What the experiment shows, one sentence a line.
    pub fn verdicts(&self) -> Vec<String> {
        tables::verdicts(self)
    }
}
