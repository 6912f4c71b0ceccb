//! `pitchd export`: analyst files from a results folder.

use std::io::Write as _;
use std::path::PathBuf;

use anyhow::bail;
use clap::ValueEnum;

use super::solving::Plane;
use crate::export::statcast::{self, PlatePlane};
use crate::export::{results, trackman};

const AFTER_HELP: &str = "\
Examples:
  pitchd export /tmp/pitches --format statcast --plane middle --out pitches.csv
  pitchd export /tmp/pitches --format trackman > trackman.csv
  pitchd export /tmp/pitches/pitches.jsonl --format jsonl --out copy.jsonl

statcast: the public file's columns, units and order; the column plate_plane says where plate_x and plate_z are \
stated (front: 17/12 ft, as the public file through 2025; middle: 8.5/12 ft, as from 2026).
trackman: TrackMan V3 columns, units and signs (PlateLocSide, RelSide, HorzBreak have the sign of −x).
jsonl: one pitch a line, as pitchd itself keeps them.";

/// Arguments of `pitchd export`.
#[derive(Debug, clap::Args)]
#[command(after_help = AFTER_HELP)]
pub struct ExportArgs {
    /// Results folder of `replay` or `solve`, or a pitches.jsonl.
    #[arg(value_name = "RESULTS")]
    pub results: PathBuf,
    /// What to write.
    #[arg(long, value_enum)]
    pub format: Format,
    /// Where Statcast's plate_x, plate_z and zone are stated [default: front].
    #[arg(long, value_enum)]
    pub plane: Option<Plane>,
    /// File to write; standard output without it.
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}

/// Export formats.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// Statcast's columns (CSV).
    Statcast,
    /// TrackMan V3's columns (CSV).
    Trackman,
    /// One JSON object a line.
    Jsonl,
}

/// Runs it.
///
/// # Errors
/// Results that cannot be read, or a file that cannot be written.
pub fn run(args: &ExportArgs) -> anyhow::Result<()> {
    if args.plane.is_some() && args.format != Format::Statcast {
        bail!("--plane belongs to --format statcast: the other formats state fixed planes");
    }
    let path = if args.results.is_dir() {
        args.results.join("pitches.jsonl")
    } else {
        args.results.clone()
    };
    let pitches = results::read_pitches(&path)?;
    let text = match args.format {
        Format::Statcast => statcast::csv(&pitches, args.plane.map_or(PlatePlane::default(), Into::into)),
        Format::Trackman => trackman::csv(&pitches),
        Format::Jsonl => results::jsonl(&pitches)?,
    };
    match &args.out {
        Some(file) => results::replace(file, &text)?,
        None => match std::io::stdout().write_all(text.as_bytes()) {
            // The reader (`head`) has seen enough.
            Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => {}
            outcome => outcome?,
        },
    }
    Ok(())
}
