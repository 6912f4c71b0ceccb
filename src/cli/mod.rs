//! The command line: one file a subcommand; no mathematics.

#[macro_use]
pub mod terminal;
pub mod log_queue;

mod cameras;
mod check;
mod check_cameras;
mod detecting;
mod emulate;
mod evaluate;
mod evaluate_bound;
mod evaluate_detection;
mod evaluate_kim2019;
mod evaluate_trajectory;
mod export;
mod import;
mod info;
mod init;
mod recover;
mod replay;
mod run;
mod seen;
mod shell_files;
mod simulate;
mod solve;
mod solving;

use clap::{Parser, Subcommand};

const AFTER_HELP: &str = "\
A first look, from a clone of the repository:
  pitchd replay recordings/bullpen --out /tmp/pitches
  open /tmp/pitches/report.html

Exit codes: 0 done, 1 failed (or done with losses that were named), 2 wrong usage.";

/// Live multi-camera capture and tracking of baseball pitches from cameras that are not synchronised.
#[derive(Debug, Parser)]
#[command(name = "pitchd", version, after_help = AFTER_HELP, arg_required_else_help = true)]
pub struct Cli {
    /// More of the log on stderr: -v info, -vv debug. The variable PITCHD_LOG takes a full filter.
    #[arg(short, long, global = true, display_order = 1000, action = clap::ArgAction::Count)]
    pub verbose: u8,
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// Every subcommand.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// List GigE Vision and USB3 Vision cameras.
    Cameras(cameras::CamerasArgs),
    /// Check host, cameras and configuration; each line says what mends it.
    Check(check::CheckArgs),
    /// Serve frames as a real GigE Vision camera on the network.
    Emulate(emulate::EmulateArgs),
    /// Print a shell's completion script.
    Completions(shell_files::CompletionsArgs),
    /// Score results against truth; the estimators' own experiments.
    Evaluate(evaluate::EvaluateArgs),
    /// Write analyst files (Statcast, TrackMan, JSON lines) from results.
    Export(export::ExportArgs),
    /// Build a session from folders of images or from video files.
    Import(import::ImportArgs),
    /// Write manual pages.
    Man(shell_files::ManArgs),
    /// Replay a recorded session through the live pipeline: pitches, calibration, report.
    Replay(replay::ReplayArgs),
    /// Write a first configuration from the cameras found.
    Init(init::InitArgs),
    /// Show what is in a session, and what of it is broken.
    Info(info::InfoArgs),
    /// Make a killed or damaged session whole again.
    Recover(recover::RecoverArgs),
    /// The daemon: live cameras in, pitches out.
    Run(run::RunArgs),
    /// Make tracks or frames from a scenario: stadium, cameras, pitches, noise; truth beside them.
    Simulate(simulate::SimulateArgs),
    /// Solve 2-D tracks made by any program: delays, poses, pitches.
    Solve(solve::SolveArgs),
}

impl Cli {
    /// Runs the subcommand; an error becomes exit code 1.
    ///
    /// # Errors
    /// Whatever stopped the command, in words for a person.
    pub fn run(&self) -> anyhow::Result<()> {
        match &self.command {
            Command::Cameras(args) => cameras::run(args),
            Command::Check(args) => check::run(args),
            Command::Completions(args) => shell_files::completions(args),
            Command::Man(args) => shell_files::man(args),
            Command::Init(args) => init::run(args),
            Command::Run(args) => run::run(args),
            Command::Emulate(args) => emulate::run(args),
            Command::Evaluate(args) => evaluate::run(args),
            Command::Export(args) => export::run(args),
            Command::Import(args) => import::run(args),
            Command::Replay(args) => replay::run(args),
            Command::Solve(args) => solve::run(args),
            Command::Info(args) => info::run(args),
            Command::Recover(args) => recover::run(args),
            Command::Simulate(args) => simulate::run(args),
        }
    }
}
