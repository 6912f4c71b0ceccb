//! Scores a free trajectory against truth in its own world and clock: best similarity and time shift, then
//! 3-D distances, with the coverage that a low error alone would hide.

use std::fmt;

use nalgebra::Point3;
use serde::Serialize;

use crate::geometry::{Similarity, align_similarity};

/// A position at a time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TimedPosition {
    /// Seconds on its own clock.
    pub time_s: f64,
    /// In its own world.
    pub position: Point3<f64>,
}

/// How a trajectory is put beside its truth.
#[derive(Debug, Clone, Copy)]
pub struct TrajectoryScoring {
    /// Longest gap of the estimate over which a truth row is interpolated, seconds.
    pub gap_s: f64,
    /// Step of the coarse search over the shift between the clocks, seconds.
    pub step_s: f64,
    /// Shifts considered keep at least this share of the rows of the best-covered shift.
    pub rows_share_min: f64,
}

impl Default for TrajectoryScoring {
    fn default() -> Self {
        Self {
            gap_s: 0.5,
            step_s: 0.2,
            rows_share_min: 0.8,
        }
    }
}

/// The score.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TrajectoryScore {
    /// Truth time = estimate time + this, seconds.
    pub shift_s: f64,
    /// Estimate to truth.
    #[serde(skip)]
    pub similarity: Similarity,
    /// Truth's units per unit of the estimate.
    pub scale: f64,
    /// Truth rows compared.
    pub rows: usize,
    /// Time the estimate covers (gaps left out), seconds.
    pub covered_s: f64,
    /// Root mean square 3-D distance, truth's units.
    pub rms_m: f64,
    /// Mean 3-D distance.
    pub mean_m: f64,
    /// Median 3-D distance.
    pub median_m: f64,
    /// Largest 3-D distance.
    pub worst_m: f64,
    /// Root mean square distance of the compared truth from its own mean: what "no answer" would score.
    pub extent_m: f64,
}

/// Why there is no score.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TrajectoryScoreError {
    /// Too little of either.
    #[error("{estimate} estimated and {truth} true positions: ten of each are needed")]
    TooFew {
        /// Estimated positions.
        estimate: usize,
        /// True positions.
        truth: usize,
    },
    /// A line that is not a position.
    #[error("line {line}: {reason}")]
    Line {
        /// From 1.
        line: usize,
        /// What is wrong.
        reason: String,
    },
    /// No shift of the clocks makes them overlap.
    #[error("estimate and truth do not overlap at any time shift")]
    NoOverlap,
}

/// Positions of a CSV with a header, found by the names of its columns; a time column whose name ends in
/// `_ns` is in nanoseconds. Returned by rising time.
pub fn read_positions(
    text: &str,
    time: &str,
    axes: [&str; 3],
) -> Result<Vec<TimedPosition>, TrajectoryScoreError> {
    let wrong = |line: usize, reason: String| TrajectoryScoreError::Line { line, reason };
    let mut lines = text.lines().enumerate();
    let header: Vec<&str> = lines
        .next()
        .map(|(_, l)| l.split(',').map(str::trim).collect())
        .unwrap_or_default();
    let place = |name: &str| {
        header
            .iter()
            .position(|h| *h == name)
            .ok_or_else(|| wrong(1, format!("no column `{name}`")))
    };
    let places = [place(time)?, place(axes[0])?, place(axes[1])?, place(axes[2])?];
    let per_second = if time.ends_with("_ns") { 1e9 } else { 1.0 };
    let mut positions = vec![];
    for (index, line) in lines.filter(|(_, l)| !l.trim().is_empty()) {
        let cells: Vec<&str> = line.split(',').map(str::trim).collect();
        let mut values = [0.0; 4];
        for (value, place) in values.iter_mut().zip(places) {
            *value = cells
                .get(place)
                .and_then(|cell| cell.parse::<f64>().ok())
                .filter(|v| v.is_finite())
                .ok_or_else(|| wrong(index + 1, format!("column `{}` is not a number", header[place])))?;
        }
        positions.push(TimedPosition {
            time_s: values[0] / per_second,
            position: Point3::new(values[1], values[2], values[3]),
        });
    }
    positions.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
    Ok(positions)
}

/// Scores `estimate` against `truth`, both by rising time.
pub fn score_trajectory(
    estimate: &[TimedPosition],
    truth: &[TimedPosition],
    scoring: &TrajectoryScoring,
) -> Result<TrajectoryScore, TrajectoryScoreError> {
    let (Some(first), Some(last), Some(truth_first), Some(truth_last)) =
        (estimate.first(), estimate.last(), truth.first(), truth.last())
    else {
        return Err(TrajectoryScoreError::TooFew {
            estimate: estimate.len(),
            truth: truth.len(),
        });
    };
    if estimate.len() < 10 || truth.len() < 10 {
        return Err(TrajectoryScoreError::TooFew {
            estimate: estimate.len(),
            truth: truth.len(),
        });
    }
    let lowest = truth_first.time_s - last.time_s;
    let highest = truth_last.time_s - first.time_s;
    let steps = ((highest - lowest) / scoring.step_s).ceil() as usize;
    let mut coarse = vec![];
    for k in 0..=steps {
        let shift_s = lowest + k as f64 * scoring.step_s;
        if let Some(score) = at_shift(estimate, truth, shift_s, scoring.gap_s) {
            coarse.push(score);
        }
    }
    let most = coarse
        .iter()
        .map(|s| s.rows)
        .max()
        .ok_or(TrajectoryScoreError::NoOverlap)?;
    let needed = (scoring.rows_share_min * most as f64) as usize;
    coarse.retain(|s| s.rows >= needed);
    coarse.sort_by(|a, b| a.relative().total_cmp(&b.relative()));
    let mut best: Option<TrajectoryScore> = None;
    for start in coarse.iter().take(5) {
        let fine = refined(estimate, truth, (start, needed), scoring);
        if best.as_ref().is_none_or(|b| fine.relative() < b.relative()) {
            best = Some(fine);
        }
    }
    best.ok_or(TrajectoryScoreError::NoOverlap)
}

impl fmt::Display for TrajectoryScore {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{} truth rows compared, {:.1} s covered, extent {:.3} (rms about the mean)",
            self.rows, self.covered_s, self.extent_m
        )?;
        writeln!(
            f,
            "error: rms {:.4}, mean {:.4}, median {:.4}, worst {:.4}",
            self.rms_m, self.mean_m, self.median_m, self.worst_m
        )?;
        writeln!(
            f,
            "truth clock = estimate + {:.4} s, scale {:.5}",
            self.shift_s, self.scale
        )
    }
}

impl TrajectoryScore {
    fn relative(&self) -> f64 {
        self.rms_m / self.extent_m.max(f64::MIN_POSITIVE)
    }
}

/// Shrinking three-point search about a coarse shift, to 0.1 ms.
fn refined(
    estimate: &[TimedPosition],
    truth: &[TimedPosition],
    (start, needed): (&TrajectoryScore, usize),
    scoring: &TrajectoryScoring,
) -> TrajectoryScore {
    let mut best = start.clone();
    let mut step_s = 0.5 * scoring.step_s;
    while step_s > 1e-4 {
        let centre_s = best.shift_s;
        let mut moved = false;
        for shift_s in [centre_s - step_s, centre_s + step_s] {
            if let Some(score) = at_shift(estimate, truth, shift_s, scoring.gap_s)
                && score.rows >= needed
                && score.relative() < best.relative()
            {
                best = score;
                moved = true;
            }
        }
        if !moved {
            step_s *= 0.5;
        }
    }
    best
}

fn at_shift(
    estimate: &[TimedPosition],
    truth: &[TimedPosition],
    shift_s: f64,
    gap_s: f64,
) -> Option<TrajectoryScore> {
    let (mut from, mut to) = (vec![], vec![]);
    let mut next = 0;
    for row in truth {
        let time_s = row.time_s - shift_s;
        while next < estimate.len() && estimate[next].time_s < time_s {
            next += 1;
        }
        let (Some(before), Some(after)) = (
            next.checked_sub(1).and_then(|k| estimate.get(k)),
            estimate.get(next),
        ) else {
            continue;
        };
        let span_s = after.time_s - before.time_s;
        if span_s > gap_s || !(span_s > 0.0) {
            continue;
        }
        let u = (time_s - before.time_s) / span_s;
        from.push(before.position + u * (after.position - before.position));
        to.push(row.position);
    }
    if from.len() < 10 {
        return None;
    }
    let similarity = align_similarity(&from, &to)?;
    let mut distances: Vec<f64> = from
        .iter()
        .zip(&to)
        .map(|(a, b)| (similarity.transform(a) - b).norm())
        .collect();
    distances.sort_by(f64::total_cmp);
    let n = distances.len() as f64;
    let centre = to.iter().map(|p| p.coords).sum::<nalgebra::Vector3<f64>>() / n;
    Some(TrajectoryScore {
        shift_s,
        similarity,
        scale: similarity.scale,
        rows: to.len(),
        covered_s: estimate
            .windows(2)
            .map(|w| w[1].time_s - w[0].time_s)
            .filter(|d| *d <= gap_s)
            .sum(),
        rms_m: (distances.iter().map(|d| d * d).sum::<f64>() / n).sqrt(),
        mean_m: distances.iter().sum::<f64>() / n,
        median_m: distances[distances.len() / 2],
        worst_m: distances[distances.len() - 1],
        extent_m: (to.iter().map(|p| (p.coords - centre).norm_squared()).sum::<f64>() / n).sqrt(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Rotation3, Vector3};

    fn path(t: f64) -> Point3<f64> {
        Point3::new(
            10.0 * (0.3 * t).sin(),
            8.0 * (0.17 * t).cos(),
            2.0 * (0.41 * t).sin(),
        )
    }

    /// A path moved, turned, scaled by 1/25, with a clock 37.123 s behind, and 3 cm (4 then 0 alternately
    /// would be rms 2.83) of error: the score says 3 cm.
    #[test]
    fn the_score_of_a_known_error() {
        let turn = Rotation3::new(Vector3::new(0.3, -0.8, 1.1));
        let estimate: Vec<_> = (0..3000)
            .map(|k| {
                let time_s = 5.0 + f64::from(k) / 30.0;
                let error = Vector3::z() * if k % 2 == 0 { 0.03 } else { -0.03 };
                let position =
                    Point3::from(turn * (path(time_s + 37.123).coords + error) / 25.0 + Vector3::x());
                TimedPosition { time_s, position }
            })
            .collect();
        // Truth rows fall on the estimate's instants: no interpolation between the alternating errors.
        let truth: Vec<_> = (0..1000)
            .map(|k| {
                let time_s = 5.0 + 37.123 + f64::from(k) * 7.0 / 30.0 - 40.0;
                TimedPosition {
                    time_s,
                    position: path(time_s),
                }
            })
            .collect();
        let score = score_trajectory(&estimate, &truth, &TrajectoryScoring::default()).unwrap();
        assert!((score.shift_s - 37.123).abs() < 0.02, "{score:?}");
        assert!((score.similarity.scale - 25.0).abs() < 0.05, "{score:?}");
        assert!(score.rms_m < 0.031 && score.rms_m > 0.01, "{score:?}");
        assert!(
            (score.covered_s - 99.97).abs() < 0.1 && score.rows > 420,
            "{score:?}"
        );
    }

    #[test]
    fn positions_by_column_name() {
        let text = "time_ns,x_m,y_m,z_m,cameras\n2000000000,1,2,3,4\n1000000000,0,0,0,2\n";
        let found = read_positions(text, "time_ns", ["x_m", "y_m", "z_m"]).unwrap();
        assert_eq!(found[0].time_s, 1.0);
        assert_eq!(found[1].position, Point3::new(1.0, 2.0, 3.0));
        let error = read_positions("t,x,y,z\n1,2,nan,3\n", "t", ["x", "y", "z"]);
        assert_eq!(
            error.unwrap_err().to_string(),
            "line 2: column `y` is not a number"
        );
        let error = read_positions("t,x,z\n", "t", ["x", "y", "z"]);
        assert_eq!(error.unwrap_err().to_string(), "line 1: no column `y`");
    }

    #[test]
    fn nothing_to_compare_is_an_error() {
        let error = score_trajectory(&[], &[], &TrajectoryScoring::default());
        assert_eq!(
            error,
            Err(TrajectoryScoreError::TooFew {
                estimate: 0,
                truth: 0
            })
        );
    }
}
