//! `pitchd evaluate trajectory`: a free motion against its truth.

use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::Args;

use crate::evaluation::{TimedPosition, TrajectoryScoring, read_positions, score_trajectory};

const AFTER_HELP: &str = "\
Example:
  pitchd solve drone/tracks --rig drone/rig.toml --motion free --out result
  pitchd evaluate trajectory result drone/truth.csv

The truth has a header line and columns t (seconds), x, y, z, in any world, scale and clock: the best \
similarity and time shift come first. Judge by the rows and the time covered as well as by the error.";

/// Arguments of `pitchd evaluate trajectory`.
#[derive(Debug, Args)]
#[command(after_help = AFTER_HELP)]
pub struct EvaluateTrajectoryArgs {
    /// Results folder of `solve --motion free`, or its trajectory.csv.
    pub result: PathBuf,
    /// CSV with columns t,x,y,z.
    pub truth: PathBuf,
    /// Print the score as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Runs the score.
///
/// # Errors
/// Unreadable files, or nothing to compare.
pub fn run(args: &EvaluateTrajectoryArgs) -> anyhow::Result<()> {
    let result = if args.result.is_dir() {
        args.result.join("trajectory.csv")
    } else {
        args.result.clone()
    };
    let estimate = positions(&result, "time_ns", ["x_m", "y_m", "z_m"])?;
    let truth = positions(&args.truth, "t", ["x", "y", "z"])?;
    let score = score_trajectory(&estimate, &truth, &TrajectoryScoring::default())?;
    if args.json {
        say_line!("{}", serde_json::to_string_pretty(&score)?);
    } else {
        say!("{score}");
    }
    Ok(())
}

fn positions(path: &Path, time: &str, axes: [&str; 3]) -> anyhow::Result<Vec<TimedPosition>> {
    let text =
        std::fs::read_to_string(path).with_context(|| format!("{}: cannot be read", path.display()))?;
    read_positions(&text, time, axes).with_context(|| path.display().to_string())
}
