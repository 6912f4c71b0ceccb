//! `pitchd evaluate bound`: the Cramér–Rao bound of a scenario, and how near the estimator comes.

use std::path::PathBuf;

use anyhow::Context;
use clap::Args;

use crate::evaluation::efficiency::{scene_bound, study};
use crate::simulation::Scenario;

const AFTER_HELP: &str = "\
Examples:
  pitchd evaluate bound config/scenario/three.toml
  pitchd evaluate bound config/scenario/three.toml --seeds 50 --csv /tmp/efficiency.csv --plot /tmp/efficiency.svg";

/// Arguments of `pitchd evaluate bound`.
#[derive(Debug, Args)]
#[command(after_help = AFTER_HELP)]
pub struct BoundArgs {
    /// Scenario file.
    pub scenario: PathBuf,
    /// Seeds to calibrate, from the scenario's own on; 0: the bound alone.
    #[arg(long, default_value_t = 0)]
    pub seeds: u64,
    /// Every error of the study, as CSV.
    #[arg(long, value_name = "FILE")]
    pub csv: Option<PathBuf>,
    /// The study as a picture (SVG): errors in stated sigmas, rms over bound, coverage, NEES.
    #[arg(long, value_name = "FILE")]
    pub plot: Option<PathBuf>,
}

/// Prints the bound, and the study when seeds are asked for.
///
/// # Errors
/// A scenario that cannot be read or simulated, a scene without a bound, a CSV that cannot be written.
pub fn run(args: &BoundArgs) -> anyhow::Result<()> {
    if args.seeds == 0 && (args.csv.is_some() || args.plot.is_some()) {
        anyhow::bail!("--csv and --plot hold the errors of a study: say --seeds N with them");
    }
    let scenario = Scenario::from_path(&args.scenario)?;
    let (_, bound) = scene_bound(&scenario)?;
    for (camera, spec) in bound.cameras.iter().zip(&scenario.cameras) {
        say_line!(
            "camera {}: delay {:.4} frame ({:.1} µs), skew {:.2} ppm, centre {:.1} {:.1} {:.1} mm",
            camera.camera,
            camera.delay_sigma_s * spec.frame_rate_hz,
            1e6 * camera.delay_sigma_s,
            camera.skew_sigma_ppm,
            1e3 * camera.centre_sigma_m[0],
            1e3 * camera.centre_sigma_m[1],
            1e3 * camera.centre_sigma_m[2],
        );
    }
    for pitch in &bound.pitches {
        let plate = pitch.plate_sigma_m[0].map_or("does not reach the plate".to_owned(), |[x, z]| {
            format!("plate front x {:.2} z {:.2} mm", 1e3 * x, 1e3 * z)
        });
        let speed = pitch
            .release_speed_sigma_mps
            .map_or(String::new(), |s| format!(", speed {s:.4} m/s"));
        say_line!("pitch {}: {plate}{speed}", pitch.pitch + 1);
    }
    if args.seeds > 0 {
        let bar = indicatif::ProgressBar::new(args.seeds);
        let study = study(&scenario, args.seeds, |_| bar.inc(1))?;
        bar.finish_and_clear();
        say!("{study}");
        for (path, text) in [(&args.csv, study.csv()), (&args.plot, study.svg())] {
            if let Some(path) = path {
                std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))?;
            }
        }
    }
    Ok(())
}
