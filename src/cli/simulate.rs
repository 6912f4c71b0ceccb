//! `pitchd simulate`: a scenario to tracks or frames, with the truth beside them.

use std::path::PathBuf;

use indicatif::{ProgressBar, ProgressStyle};

use crate::simulation::{self, CameraRenderer, Scenario, Truth};

const AFTER_HELP: &str = "\
Examples:
  pitchd simulate config/scenario/three.toml --out /tmp/three
  pitchd solve /tmp/three/tracks --rig /tmp/three/rig.toml --out /tmp/three/result
  pitchd simulate config/scenario/hard.toml --frames --seed 7 --out /tmp/hard

DIR gets rig.toml (landmarks clicked with noise, no poses), truth/, and tracks/<camera>.csv; with --frames also \
frames/<camera>/NNNNNN.pgm and timestamps.csv, which `pitchd import` reads.";

/// Arguments of `pitchd simulate`.
#[derive(Debug, clap::Args)]
#[command(after_help = AFTER_HELP)]
pub struct SimulateArgs {
    /// Scenario file (see config/scenario/).
    pub scenario: PathBuf,
    /// Folder for the products; made if missing.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// 2-D tracks only (the default).
    #[arg(long, conflicts_with = "frames")]
    pub tracks: bool,
    /// Rendered frames too, around every ball (2 MB each at 2048×1024).
    #[arg(long)]
    pub frames: bool,
    /// Another seed than the scenario's.
    #[arg(long)]
    pub seed: Option<u64>,
}

/// Runs it.
///
/// # Errors
/// A bad scenario, or a product that cannot be written.
pub fn run(args: &SimulateArgs) -> anyhow::Result<()> {
    let mut scenario = Scenario::from_path(&args.scenario)?;
    if let Some(seed) = args.seed {
        scenario = scenario.with_seed(seed);
    }
    let mut simulated = simulation::simulate_tracks(&scenario)?;
    let rig = simulation::write_rig(&args.out, &simulated.rig)?;
    simulation::write_tracks(&args.out, &simulated.rig, &simulated.tracks)?;
    if args.frames {
        render(args, &scenario, &mut simulated.truth)?;
    }
    simulation::write_truth(&args.out, &simulated.truth)?;
    say_line!(
        "{}: {} pitches, {} tracks from {} cameras",
        rig.display(),
        simulated.truth.pitches.len(),
        simulated.tracks.len(),
        simulated.rig.cameras.len()
    );
    Ok(())
}

fn render(args: &SimulateArgs, scenario: &Scenario, truth: &mut Truth) -> anyhow::Result<()> {
    for (index, centres) in truth.centres.iter_mut().enumerate() {
        let mut renderer = CameraRenderer::new(scenario, index)?;
        renderer.mark_hidden(&mut centres.centres);
        let bar = ProgressBar::new(renderer.exposures().count() as u64)
            .with_style(ProgressStyle::with_template(
                "{prefix:>12} {wide_bar} {pos}/{len} {eta}",
            )?)
            .with_prefix(renderer.camera().to_string());
        let count = simulation::write_frames(&args.out, &mut renderer, || bar.inc(1))?;
        bar.finish_and_clear();
        say_line!("{}: {count} frames", renderer.camera());
    }
    Ok(())
}
