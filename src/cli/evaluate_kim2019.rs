//! `pitchd evaluate kim2019`: the paper's whole experiment, with `joint` beside it.

use std::path::PathBuf;

use anyhow::Context;
use clap::Args;
use indicatif::ProgressBar;

use crate::evaluation::kim2019::{StudyOptions, run as run_study};

const AFTER_HELP: &str = "\
Examples:
  pitchd evaluate kim2019 --quick
  pitchd evaluate kim2019 --out /tmp/kim2019";

/// Arguments of `pitchd evaluate kim2019`.
#[derive(Debug, Args)]
#[command(after_help = AFTER_HELP)]
pub struct Kim2019Args {
    /// Folder for index.html, the heat maps and the tables.
    #[arg(long, value_name = "DIR", default_value = "kim2019-results")]
    pub out: PathBuf,
    /// Four cells of three presets and one trial per delay: seconds instead of minutes.
    #[arg(long)]
    pub quick: bool,
    /// Seed of the noise.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// 1σ of the capture time noise N_c, frames (not given in the paper).
    #[arg(long, value_name = "FRAMES", default_value_t = 0.05)]
    pub capture_sigma: f64,
    /// Noise presets by number, 1 to 7 (all seven).
    #[arg(long, value_name = "N,N", value_delimiter = ',')]
    pub presets: Vec<usize>,
    /// Draws of the noise per cell (1 in the paper); a cell holds the mean of their errors.
    #[arg(long, value_name = "N")]
    pub draws: Option<u64>,
    /// Trials per delay of the two-camera protocol (4 in the paper).
    #[arg(long, value_name = "N")]
    pub trials: Option<usize>,
}

/// Runs the experiment and writes its page.
///
/// # Errors
/// A folder that cannot be written, or a method that cannot even start.
pub fn run(args: &Kim2019Args) -> anyhow::Result<()> {
    let mut options = if args.quick {
        StudyOptions::quick()
    } else {
        StudyOptions::full()
    };
    options.seed = args.seed;
    options.capture_sigma_frames = args.capture_sigma;
    if !args.presets.is_empty() {
        options.presets.clone_from(&args.presets);
    }
    if let Some(draws) = args.draws {
        options.draws = draws;
    }
    if let Some(trials) = args.trials {
        options.protocol.trials = trials;
    }
    std::fs::create_dir_all(&args.out).with_context(|| format!("cannot make {}", args.out.display()))?;
    let bar = ProgressBar::new(0);
    let study = run_study(&options, |done, of| {
        bar.set_length(of as u64);
        bar.set_position(done as u64);
    })?;
    bar.finish_and_clear();
    let mut files = study.files();
    files.push(("index.html".to_owned(), study.html()));
    for (name, text) in &files {
        let path = args.out.join(name);
        std::fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))?;
    }
    for line in study.verdicts() {
        say_line!("{line}");
    }
    say_line!("{}", args.out.join("index.html").display());
    Ok(())
}
