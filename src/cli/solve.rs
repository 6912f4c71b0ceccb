//! `pitchd solve`: 2-D tracks made by any program to delays, poses and pitches.

use std::path::PathBuf;

use anyhow::Context;
use clap::{Args, ValueEnum};

use super::solving::SolvingArgs;
use crate::config::load_rig;
use crate::recording::read_track_folder;
use crate::scene::Motion as RigMotion;

const AFTER_HELP: &str = "\
TRACKS_DIR holds one <camera id>.csv a camera:
  track,frame,timestamp_ns,x_px,y_px[,sigma_px]
with distorted pixels (the centre of the top-left pixel is 0, 0) and stamped exposure midpoints of that camera.

Examples:
  pitchd solve tracks/ --rig rig.toml --out result
  pitchd solve drone/tracks --rig drone/rig.toml --motion free --out result";

/// What moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Motion {
    /// Pitched balls; results are pitches.
    Flight,
    /// Anything that moves smoothly; the result is trajectory.csv.
    Free,
}

/// Arguments of `pitchd solve`.
#[derive(Debug, Args)]
#[command(after_help = AFTER_HELP)]
pub struct SolveArgs {
    /// Folder of <camera id>.csv files.
    pub tracks_dir: PathBuf,
    /// Rig file: site, cameras, landmarks.
    #[arg(long, value_name = "FILE")]
    pub rig: PathBuf,
    /// What moves; the rig file says where this is not given.
    #[arg(long, value_enum)]
    pub motion: Option<Motion>,
    #[command(flatten)]
    solving: SolvingArgs,
}

/// Runs it.
///
/// # Errors
/// A rig or track file that cannot be read, or no calibration.
pub fn run(args: &SolveArgs) -> anyhow::Result<()> {
    let rig = load_rig(&args.rig)?;
    let tracks = read_track_folder(&args.tracks_dir)?;
    let free = match args.motion {
        Some(motion) => motion == Motion::Free,
        None => rig.site.motion == RigMotion::Free,
    };
    let points: usize = tracks.iter().map(|t| t.points.len()).sum();
    let facts = [
        ("tracks".to_owned(), format!("{} ({points} points)", tracks.len())),
        ("source".to_owned(), args.tracks_dir.display().to_string()),
    ];
    let title = if rig.site.name.is_empty() {
        args.tracks_dir.display().to_string()
    } else {
        rig.site.name.clone()
    };
    if free {
        return args
            .solving
            .solve_and_write_free((&title, &rig), &tracks, &facts)
            .with_context(|| args.tracks_dir.display().to_string());
    }
    args.solving
        .solve_and_write((&title, &rig), &tracks, &facts, Vec::new())
        .with_context(|| args.tracks_dir.display().to_string())
}
