//! `pitchd recover`: makes a killed or damaged session whole again.

use std::path::PathBuf;

use anyhow::bail;

use crate::recording::repair_session;

const AFTER_HELP: &str = "\
A .part file (its recorder was killed) gets its end and its name; a damaged file is written anew from the frames \
that are left and kept with the ending .damaged. Exit code 1 when frames are lost for good; they are named.

Example:
  pitchd recover sessions/monday";

/// Arguments of `recover`.
#[derive(Debug, clap::Args)]
#[command(after_help = AFTER_HELP)]
pub struct RecoverArgs {
    /// Folder of the session. No other program may be recording into it.
    session: PathBuf,
}

/// Repairs the session and says what was lost.
///
/// # Errors
/// The folder is no session, the disk is full, or frames are lost.
pub fn run(args: &RecoverArgs) -> anyhow::Result<()> {
    let repaired = repair_session(&args.session)?;
    if repaired.is_empty() {
        say_line!("{}: nothing to mend", args.session.display());
        return Ok(());
    }
    let mut lost = 0;
    for repair in &repaired {
        lost += repair.damage.frames_lost.count();
        say_line!("mended: {}", repair.damage);
        if let Some(kept) = &repair.kept {
            say_line!("  kept: {}", kept.display());
        }
    }
    if lost > 0 {
        bail!("{}: {lost} frames are lost", args.session.display());
    }
    Ok(())
}
