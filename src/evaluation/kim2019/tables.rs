//! The experiment's numbers as CSV, and what they say.

use std::fmt::Write;

use super::cells::Algorithm;
use super::protocol::METHODS;
use super::{Measure, Study, mean_sd, printed};

/// File names and contents.
pub(super) fn csv(study: &Study) -> Vec<(String, String)> {
    let mut matrices =
        "preset,algorithm,tau2_frames,tau3_frames,tau2_error_frames,tau3_error_frames,distance_cm,draws,\
         answered\n"
            .to_owned();
    let mut means = "preset,algorithm,measure,unit,mean,sd,cells\n".to_owned();
    // Writing to a string cannot fail.
    for matrix in &study.matrices {
        for (k, algorithm) in Algorithm::ALL.iter().enumerate() {
            for cell in &matrix.cells {
                let e = cell.errors.get(k).copied().flatten();
                let value = |v: Option<f64>| v.map_or(String::new(), |v| format!("{v:.6}"));
                let _ = writeln!(
                    matrices,
                    "{},{},{},{},{},{},{},{},{}",
                    matrix.preset.name,
                    algorithm.name(),
                    cell.delays_frames[0],
                    cell.delays_frames[1],
                    value(e.map(|e| e.delay_frames[0])),
                    value(e.map(|e| e.delay_frames[1])),
                    value(e.map(|e| e.distance_cm)),
                    cell.draws,
                    cell.answered.get(k).copied().unwrap_or(0),
                );
            }
            for measure in Measure::ALL {
                let (mean, sd, n) = matrix.mean_sd(*algorithm, measure);
                let (name, unit) = measure.name();
                let _ = writeln!(
                    means,
                    "{},{},{name},{unit},{mean:.6},{sd:.6},{n}",
                    matrix.preset.name,
                    algorithm.name()
                );
            }
        }
    }
    let mut trials = "tau2_frames,trial,method,delay_error_frames,reprojection_px,distance_cm,\
                      bound_frames,bound_with_landmarks_frames\n"
        .to_owned();
    for t in &study.trials {
        for (method, score) in METHODS.iter().zip(&t.scores) {
            let value = |v: Option<f64>| v.map_or(String::new(), |v| format!("{v:.6}"));
            let _ = writeln!(
                trials,
                "{:.6},{},{method},{},{},{},{},{}",
                t.delay_frames,
                t.trial,
                value(score.map(|s| s.delay_frames)),
                value(score.map(|s| s.reprojection_px)),
                value(score.map(|s| s.distance_cm)),
                value(t.bound_frames[0]),
                value(t.bound_frames[1]),
            );
        }
    }
    let mut table_1 = "timing_difference_frames,error_cm,paper_error_cm\n".to_owned();
    for ((difference, ours), (_, paper)) in study.table_1.iter().zip(printed::TABLE_1) {
        let _ = writeln!(table_1, "{difference},{ours:.4},{paper}");
    }
    [
        ("matrices.csv", matrices),
        ("means.csv", means),
        ("trials.csv", trials),
        ("table1.csv", table_1),
    ]
    .map(|(name, text)| (name.to_owned(), text))
    .to_vec()
}

/// Mean over the trials of one method's number.
pub(super) fn trial_mean(study: &Study, method: usize, of: impl Fn(&super::protocol::Score) -> f64) -> f64 {
    let all: Vec<f64> = study
        .trials
        .iter()
        .map(|t| t.scores[method].as_ref().map_or(f64::NAN, &of))
        .collect();
    mean_sd(&all).0
}

/// Root mean square over the trials of a bound, frames.
pub(super) fn bound_rms(study: &Study, which: usize) -> f64 {
    let all: Vec<f64> = study
        .trials
        .iter()
        .filter_map(|t| t.bound_frames[which])
        .collect();
    (all.iter().map(|b| b * b).sum::<f64>() / all.len() as f64).sqrt()
}

/// What the numbers say, computed.
pub(super) fn verdicts(study: &Study) -> Vec<String> {
    let mut lines = vec![format!(
        "Model error without noise: F1 {:.3} px (paper {:.4}), F2 {:.4} px (paper {:.4}; pieces of degree 2: {:.4}).",
        study.misfit_px[0],
        printed::MISFIT_PX[0],
        study.misfit_px[1],
        printed::MISFIT_PX[1],
        study.misfit_px[2],
    )];
    for (name, rival) in [
        ("F2O1, whose cost knows the true points", Algorithm::F2O1),
        ("F2O2, whose cost knows the true points", Algorithm::F2O2),
        ("F2O2 by reprojection error", Algorithm::F2Reprojection),
    ] {
        let noisy = || study.matrices.iter().filter(|m| m.preset.is_noisy());
        let means = noisy()
            .flat_map(|m| Measure::ALL.map(|of| [Algorithm::Joint, rival].map(|a| m.mean_sd(a, of).0)));
        let cells = noisy().flat_map(|m| {
            Measure::ALL.map(|of| {
                let [own, other] = [Algorithm::Joint, rival].map(|a| m.errors(a, of));
                own.into_iter()
                    .zip(other)
                    .map(|(own, other)| [own, other])
                    .collect::<Vec<_>>()
            })
        });
        let (mean_won, mean_all) = won(means);
        let (cells_won, cells_all) = won(cells.flatten());
        lines.push(format!(
            "Against {name}, joint has the smaller mean error in {mean_won} of {mean_all} (noisy preset, measure) \
             pairs, and the smaller error in {cells_won} of {cells_all} cells."
        ));
    }
    let refused = refusals(study);
    if refused > 0 {
        lines.push(format!(
            "joint gave no answer in {refused} draws; their reasons are in the page."
        ));
    }
    let mut ratios: Vec<f64> = study
        .matrices
        .iter()
        .flat_map(|m| {
            Measure::ALL
                .map(|measure| m.mean_sd(Algorithm::F1O2, measure).0 / m.mean_sd(Algorithm::F2O2, measure).0)
        })
        .filter(|r| r.is_finite())
        .collect();
    ratios.sort_by(f64::total_cmp);
    if let (Some(least), Some(most)) = (ratios.first(), ratios.last()) {
        lines.push(format!(
            "Mean errors of F1 are {least:.1} to {most:.1} times those of F2 over presets and measures."
        ));
    }
    lines.push(format!(
        "Two cameras on one side: mean delay error F1 {:.4}, F2 {:.4}, joint {:.4}, joint with landmarks {:.4} frame; \
         bound (1 sigma) {:.4} without and {:.4} with landmarks. Paper's F1 and F2: {:.4} and {:.4}.",
        trial_mean(study, 0, |s| s.delay_frames),
        trial_mean(study, 1, |s| s.delay_frames),
        trial_mean(study, 3, |s| s.delay_frames),
        trial_mean(study, 4, |s| s.delay_frames),
        bound_rms(study, 0),
        bound_rms(study, 1),
        printed::TABLE_7.0[0],
        printed::TABLE_7.1[0],
    ));
    lines
}

/// Draws in which joint gave no answer.
fn refusals(study: &Study) -> u64 {
    let joint = Algorithm::ALL.len() - 1;
    let cells = study.matrices.iter().flat_map(|m| &m.cells);
    cells
        .map(|c| c.draws - c.answered.get(joint).copied().unwrap_or(0).min(c.draws))
        .sum()
}

/// How many of the pairs have the first smaller, of how many in which the rival answered.
fn won(pairs: impl Iterator<Item = [f64; 2]>) -> (usize, usize) {
    pairs
        .filter(|p| p[1].is_finite())
        .fold((0, 0), |(won, all), [own, other]| {
            (won + usize::from(own < other), all + 1)
        })
}
