//! A results folder against the truth of its pitches: what was found, how far off, how honest the sigmas.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::export::results::Results;
use crate::scene::{CameraId, Pitch};
use crate::time::NANOS_PER_SECOND;

/// Truth that cannot be read, or results that have no partner in it.
#[derive(Debug, thiserror::Error)]
pub enum PitchScoreError {
    /// File missing.
    #[error("{}: {source}", path.display())]
    Io {
        /// File.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// Not a truth file.
    #[error("{}:{line}: no truth of pitches: {reason}", path.display())]
    Invalid {
        /// File.
        path: PathBuf,
        /// Line.
        line: usize,
        /// What is wrong.
        reason: String,
    },
}

/// Pitches pair up when they cross the plate within this of each other, seconds: a pitcher needs longer.
const PAIR_WITHIN_S: f64 = 1.0;
/// 95 % of a normal lies within this many sigmas.
const SIGMAS_95: f64 = 1.959_964;

#[derive(Deserialize)]
struct TruthFile {
    cameras: Vec<CameraTruth>,
    pitches: Vec<PitchTruth>,
}

#[derive(Deserialize)]
struct CameraTruth {
    id: CameraId,
    capture_delay_s: f64,
    /// Of a truth without them the clock runs true.
    #[serde(default)]
    clock_skew_ppm: f64,
    /// Stamp at which `capture_delay_s` is stated.
    #[serde(default)]
    skew_epoch_ns: i64,
    frame_rate_hz: f64,
}

impl CameraTruth {
    /// Delay at a stamp of the camera, seconds.
    fn delay_at_s(&self, stamp_ns: i64) -> f64 {
        let since_s = (stamp_ns - self.skew_epoch_ns) as f64 / NANOS_PER_SECOND;
        self.capture_delay_s + 1e-6 * self.clock_skew_ppm * since_s
    }
}

#[derive(Deserialize)]
struct PitchTruth {
    pitch: u32,
    plate_time_ns: Option<i64>,
    plate_front_m: Option<[f64; 2]>,
    plate_mid_m: Option<[f64; 2]>,
    release_speed_mps: Option<f64>,
}

/// Errors of one quantity, found − true.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AxisScore {
    /// What, with its unit.
    pub quantity: String,
    /// Values compared.
    pub count: usize,
    /// Mean.
    pub bias: f64,
    /// Mean absolute.
    pub mean_absolute: f64,
    /// Root mean square.
    pub rms: f64,
    /// Largest absolute.
    pub largest: f64,
    /// Root mean square of error/σ: 1 when the sigmas are honest.
    pub normalised_rms: f64,
    /// Share of errors within 1.96 σ.
    pub coverage_95: f64,
}

/// Error and σ of one quantity of a pair; `None` where the truth has none.
type ErrorAndSigma<'a> = dyn Fn(&Pitch, &PitchTruth) -> Option<(f64, f64)> + 'a;

/// One camera's delay.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DelayScore {
    /// Camera.
    pub camera: CameraId,
    /// Found − true, frames of that camera.
    pub error_frames: f64,
    /// 1σ told, frames.
    pub sigma_frames: f64,
}

/// The whole score.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PitchScore {
    /// True pitches.
    pub pitches: usize,
    /// Of them found.
    pub found: usize,
    /// Numbers of the true pitches that were not.
    pub missed: Vec<u32>,
    /// Numbers of the results' pitches that are none.
    pub false_pitches: Vec<u32>,
    /// Plate location and speed.
    pub axes: Vec<AxisScore>,
    /// Delays of the calibrated cameras, without the reference.
    pub delays: Vec<DelayScore>,
    /// Cameras of the truth that the calibration lacks.
    pub cameras_missing: Vec<CameraId>,
}

/// Scores results against a `truth.json` (or a `truth/` folder with one, or the folder above it).
///
/// # Errors
/// [`PitchScoreError`] with the file.
pub fn score_pitches(results: &Results, truth: &Path) -> Result<PitchScore, PitchScoreError> {
    let path = [truth.join("truth/truth.json"), truth.join("truth.json")]
        .into_iter()
        .find(|p| p.is_file())
        .unwrap_or_else(|| truth.to_owned());
    let text = std::fs::read_to_string(&path).map_err(|source| PitchScoreError::Io {
        path: path.clone(),
        source,
    })?;
    let truth: TruthFile = serde_json::from_str(&text).map_err(|e| PitchScoreError::Invalid {
        path,
        line: e.line(),
        reason: e.to_string(),
    })?;
    Ok(compare(results, &truth))
}

fn compare(results: &Results, truth: &TruthFile) -> PitchScore {
    let mut free: Vec<&Pitch> = results.pitches.iter().collect();
    let mut pairs = Vec::new();
    let mut missed = Vec::new();
    for true_pitch in &truth.pitches {
        let away = |p: &Pitch| {
            true_pitch.plate_time_ns.map_or(f64::INFINITY, |t| {
                (p.plate_time_ns - t).unsigned_abs() as f64 / 1e9
            })
        };
        let nearest = (0..free.len()).min_by(|a, b| away(free[*a]).total_cmp(&away(free[*b])));
        match nearest.filter(|i| away(free[*i]) < PAIR_WITHIN_S) {
            Some(i) => pairs.push((free.remove(i), true_pitch)),
            None => missed.push(true_pitch.pitch),
        }
    }
    let axis = |name: &str, of: &ErrorAndSigma<'_>| {
        AxisScore::new(name, pairs.iter().filter_map(|(p, t)| of(p, t)).collect())
    };
    let axes = vec![
        axis("plate front x, mm", &|p, t| {
            Some((
                1e3 * (p.plate_front_m[0] - t.plate_front_m?[0]),
                1e3 * p.sigma.plate_front_m[0],
            ))
        }),
        axis("plate front z, mm", &|p, t| {
            Some((
                1e3 * (p.plate_front_m[1] - t.plate_front_m?[1]),
                1e3 * p.sigma.plate_front_m[1],
            ))
        }),
        axis("plate middle x, mm", &|p, t| {
            Some((
                1e3 * (p.plate_mid_m[0] - t.plate_mid_m?[0]),
                1e3 * p.sigma.plate_mid_m[0],
            ))
        }),
        axis("plate middle z, mm", &|p, t| {
            Some((
                1e3 * (p.plate_mid_m[1] - t.plate_mid_m?[1]),
                1e3 * p.sigma.plate_mid_m[1],
            ))
        }),
        axis("release speed, m/s", &|p, t| {
            Some((
                p.release_speed_mps - t.release_speed_mps?,
                p.sigma.release_speed_mps,
            ))
        }),
    ];
    let calibration = &results.calibration;
    let delays = truth
        .cameras
        .iter()
        .filter(|t| t.id != calibration.reference)
        .filter_map(|t| {
            let found = calibration.camera(&t.id)?;
            Some(DelayScore {
                camera: t.id.clone(),
                // Both at the stamp at which the estimate states its own.
                error_frames: (found.capture_delay_s - t.delay_at_s(found.skew_epoch_ns)) * t.frame_rate_hz,
                sigma_frames: found.capture_delay_sigma_s * t.frame_rate_hz,
            })
        })
        .collect();
    PitchScore {
        pitches: truth.pitches.len(),
        found: pairs.len(),
        missed,
        false_pitches: free.iter().map(|p| p.pitch).collect(),
        axes,
        delays,
        cameras_missing: truth
            .cameras
            .iter()
            .filter(|t| calibration.camera(&t.id).is_none())
            .map(|t| t.id.clone())
            .collect(),
    }
}

impl AxisScore {
    /// From (error, sigma) pairs.
    fn new(quantity: &str, pairs: Vec<(f64, f64)>) -> Self {
        let n = pairs.len() as f64;
        let mean = |f: &dyn Fn(&(f64, f64)) -> f64| pairs.iter().map(f).sum::<f64>() / n;
        Self {
            quantity: quantity.to_owned(),
            count: pairs.len(),
            bias: mean(&|p| p.0),
            mean_absolute: mean(&|p| p.0.abs()),
            rms: mean(&|p| p.0 * p.0).sqrt(),
            largest: pairs.iter().map(|p| p.0.abs()).fold(0.0, f64::max),
            normalised_rms: mean(&|p| (p.0 / p.1).powi(2)).sqrt(),
            coverage_95: mean(&|p| f64::from(u8::from(p.0.abs() <= SIGMAS_95 * p.1))),
        }
    }
}

impl std::fmt::Display for PitchScore {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        writeln!(
            f,
            "pitches: {} of {} found, {} false",
            self.found,
            self.pitches,
            self.false_pitches.len()
        )?;
        if !self.missed.is_empty() {
            writeln!(f, "missed: {:?}", self.missed)?;
        }
        for camera in &self.cameras_missing {
            writeln!(f, "camera {camera}: not calibrated")?;
        }
        writeln!(
            f,
            "{:<22}{:>5}{:>10}{:>10}{:>10}{:>10}{:>9}{:>10}",
            "found − true", "n", "bias", "mean |e|", "rms", "max |e|", "rms/σ", "in 95 %"
        )?;
        for a in &self.axes {
            writeln!(
                f,
                "{:<22}{:>5}{:>10.3}{:>10.3}{:>10.3}{:>10.3}{:>9.2}{:>9.0}%",
                a.quantity,
                a.count,
                a.bias,
                a.mean_absolute,
                a.rms,
                a.largest,
                a.normalised_rms,
                100.0 * a.coverage_95
            )?;
        }
        for d in &self.delays {
            writeln!(
                f,
                "delay of {:<13}{:>+10.4} frame (σ {:.4})",
                d.camera.as_str(),
                d.error_frames,
                d.sigma_frames
            )?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_drifting_clock_is_compared_at_the_estimate_s_own_stamp() {
        let truth = r#"{"id": "a", "capture_delay_s": 0.001, "clock_skew_ppm": 20.0,
                        "skew_epoch_ns": 5000000000, "frame_rate_hz": 175.0}"#;
        let drifting: CameraTruth = serde_json::from_str(truth).unwrap();
        // 100 s later: 1 ms + 20e-6 · 100 s = 3 ms.
        assert!((drifting.delay_at_s(105_000_000_000) - 0.003).abs() < 1e-12);
        let steady = r#"{"id": "a", "capture_delay_s": 0.001, "frame_rate_hz": 175.0}"#;
        let steady: CameraTruth = serde_json::from_str(steady).unwrap();
        assert!((steady.delay_at_s(105_000_000_000) - 0.001).abs() < 1e-12);
    }

    #[test]
    fn the_figures_of_three_errors_by_hand() {
        let score = AxisScore::new("x", vec![(1.0, 1.0), (-3.0, 1.0), (2.0, 2.0)]);
        assert_eq!(score.count, 3);
        assert!(score.bias.abs() < 1e-12);
        assert!((score.mean_absolute - 2.0).abs() < 1e-12);
        assert!((score.rms - (14.0_f64 / 3.0).sqrt()).abs() < 1e-12);
        assert!((score.largest - 3.0).abs() < 1e-12);
        // (1 + 9 + 1)/3
        assert!((score.normalised_rms - (11.0_f64 / 3.0).sqrt()).abs() < 1e-12);
        assert!((score.coverage_95 - 2.0 / 3.0).abs() < 1e-12);
    }
}
