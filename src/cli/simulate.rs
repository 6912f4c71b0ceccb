//! `pitchd simulate`: a scenario to tracks or frames, with the truth beside them.

use std::path::PathBuf;

use crate::simulation::{self, Scenario};

const AFTER_HELP: &str = "\
Examples:
  pitchd simulate config/scenario/three.toml --out /tmp/three
  pitchd solve /tmp/three/tracks --rig /tmp/three/rig.toml --out /tmp/three/result

DIR gets rig.toml (landmarks clicked with noise, no poses), tracks/<camera>.csv and truth/.";

/// Arguments of `pitchd simulate`.
#[derive(Debug, clap::Args)]
#[command(after_help = AFTER_HELP)]
pub struct SimulateArgs {
    /// Scenario file (see config/scenario/).
    pub scenario: PathBuf,
    /// Folder for the products; made if missing.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// 2-D tracks (the default).
    #[arg(long)]
    pub tracks: bool,
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
    let simulated = simulation::simulate_tracks(&scenario)?;
    let rig = simulation::write_rig(&args.out, &simulated.rig)?;
    simulation::write_tracks(&args.out, &simulated.rig, &simulated.tracks)?;
    simulation::write_truth(&args.out, &simulated.truth)?;
    println!(
        "{}: {} pitches, {} tracks from {} cameras",
        rig.display(),
        simulated.truth.pitches.len(),
        simulated.tracks.len(),
        simulated.rig.cameras.len()
    );
    Ok(())
}
