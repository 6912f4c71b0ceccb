//! `pitchd evaluate`: scores against truth, and the estimators' own experiments.

use clap::{Args, Subcommand};

/// Arguments of `pitchd evaluate`.
#[derive(Debug, Args)]
pub struct EvaluateArgs {
    /// Which score.
    #[command(subcommand)]
    pub score: Score,
}

/// Every score; one file each.
#[derive(Debug, Subcommand)]
pub enum Score {}

/// Runs the score.
///
/// # Errors
/// Unreadable results or truth.
pub fn run(args: &EvaluateArgs) -> anyhow::Result<()> {
    match args.score {}
}
