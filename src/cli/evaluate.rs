//! `pitchd evaluate`: scores against truth, and the estimators' own experiments.

use std::path::PathBuf;

use clap::error::ErrorKind;
use clap::{Args, CommandFactory, Subcommand};

use crate::evaluation::score_pitches;
use crate::export::results;

const AFTER_HELP: &str = "\
Examples:
  pitchd simulate config/scenario/three.toml --out /tmp/three
  pitchd solve /tmp/three/tracks --rig /tmp/three/rig.toml --out /tmp/three/result
  pitchd evaluate /tmp/three/result /tmp/three/truth";

/// Arguments of `pitchd evaluate`.
#[derive(Debug, Args)]
#[command(after_help = AFTER_HELP, args_conflicts_with_subcommands = true, arg_required_else_help = true)]
pub struct EvaluateArgs {
    /// Results folder of `replay` or `solve`.
    pub result: Option<PathBuf>,
    /// truth.json, or the folder that holds it.
    pub truth: Option<PathBuf>,
    /// Print the score as JSON.
    #[arg(long)]
    pub json: bool,
    /// Another score.
    #[command(subcommand)]
    pub score: Option<Score>,
}

/// Every other score; one file each.
#[derive(Debug, Subcommand)]
pub enum Score {
    /// The Cramér–Rao bound of a scenario, and the estimator's efficiency over seeds.
    Bound(super::evaluate_bound::BoundArgs),
    /// 2-D tracks against the true centres: recall, precision, bias, false tracks.
    Detection(super::evaluate_detection::EvaluateDetectionArgs),
    /// The experiment of Kim et al. 2019: its tables and error matrices, with `joint` beside them.
    Kim2019(super::evaluate_kim2019::Kim2019Args),
    /// A free motion's trajectory.csv against a true trajectory in its own world and clock.
    Trajectory(super::evaluate_trajectory::EvaluateTrajectoryArgs),
}

/// Runs the score.
///
/// # Errors
/// Unreadable results or truth.
pub fn run(args: &EvaluateArgs) -> anyhow::Result<()> {
    if let Some(score) = &args.score {
        return match score {
            Score::Bound(args) => super::evaluate_bound::run(args),
            Score::Detection(args) => super::evaluate_detection::run(args),
            Score::Kim2019(args) => super::evaluate_kim2019::run(args),
            Score::Trajectory(args) => super::evaluate_trajectory::run(args),
        };
    }
    let (Some(result), Some(truth)) = (&args.result, &args.truth) else {
        let told = "a results folder and its truth are needed: pitchd evaluate RESULT TRUTH";
        super::Cli::command()
            .error(ErrorKind::MissingRequiredArgument, told)
            .exit();
    };
    let score = score_pitches(&results::read(result)?, truth)?;
    if args.json {
        say_line!("{}", serde_json::to_string_pretty(&score)?);
    } else {
        say!("{score}");
    }
    Ok(())
}
