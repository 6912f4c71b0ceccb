//! `pitchd replay`: a recorded session through the same pipeline as live frames.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use anyhow::Context;
use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};

use super::detecting::DetectingArgs;
use super::solving::SolvingArgs;
use crate::capture::{FrameSource, RecordingSource};
use crate::config::{load_rig, parse_rig};
use crate::daemon::outfit::Wanted;
use crate::daemon::plates::add_plate;
use crate::daemon::watch::{Pace, Watched, watch_all};
use crate::export::results;
use crate::recording::SessionReader;
use crate::scene::{CameraId, Rig, Track};

const AFTER_HELP: &str = "\
Examples:
  pitchd replay recordings/bullpen --out result
  pitchd replay /data/2026-05-01 --rig moved.toml --calibration result/calibration.json --pace real

Without --calibration the session's own pitches calibrate the cameras once all is searched; then all of them are solved.
With it the cameras tell each other where a ball will be while they are searched, as they do live: a camera that hardly
sees the ball finds more of it.
A damaged session is replayed as far as it can be read; what is lost is named, and the exit code is 1.";

/// Frames that were not searched are told of above this share of a camera's.
const UNSEARCHED_SHARE_TOLD: f64 = 0.02;

/// Arguments of `pitchd replay`.
#[derive(Debug, Args)]
#[command(after_help = AFTER_HELP)]
pub struct ReplayArgs {
    /// Session folder, as `pitchd import` writes it.
    pub session: PathBuf,
    /// Rig file to use instead of the one inside the session.
    #[arg(long, value_name = "FILE")]
    pub rig: Option<PathBuf>,
    /// How fast: max, real, or a factor such as 4x.
    #[arg(long, default_value = "max", value_parser = PaceArg::from_str)]
    pub pace: PaceArg,
    #[command(flatten)]
    detecting: DetectingArgs,
    #[command(flatten)]
    solving: SolvingArgs,
}

/// A pace as it is typed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PaceArg(Pace);

impl FromStr for PaceArg {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text {
            "max" => Ok(Self(Pace::Max)),
            "real" => Ok(Self(Pace::Times(1.0))),
            _ => match text.trim_end_matches('x').parse::<f64>() {
                Ok(times) if times > 0.0 && times.is_finite() => Ok(Self(Pace::Times(times))),
                _ => Err("use max, real, or a factor such as 4x".to_owned()),
            },
        }
    }
}

/// Runs it.
///
/// # Errors
/// An unreadable session or rig, no calibration, or frames that were lost (after all results are written).
pub fn run(args: &ReplayArgs) -> anyhow::Result<()> {
    let session = SessionReader::open(&args.session)?;
    let mut rig = rig_of(args, &session)?;
    let sources = sources(&session, &rig)?;
    let progress = bar(sources.iter().map(|s| s.frames_expected()).sum());
    let PaceArg(pace) = args.pace;
    let known = args.solving.calibration()?;
    let wanted = |camera: &CameraId| {
        let mut wanted = Wanted::of(&rig, camera, known.as_ref());
        wanted.eye = args.detecting.of(wanted.eye);
        wanted
    };
    let sky = known.as_ref().map(|known| (&rig, known));
    let watched = watch_all(sources, &wanted, pace, sky, &|| progress.inc(1));
    progress.finish_and_clear();

    let mut warnings: Vec<String> = watched.iter().flat_map(|w| w.reasons.iter().cloned()).collect();
    let damage = session.damage();
    warnings.extend(damage.iter().map(ToString::to_string));
    let lost = session.losses().iter();
    warnings.extend(lost.map(|loss| format!("lost in an earlier repair: {loss}")));
    warnings.extend(watched.iter().filter_map(unsearched));
    let tracks: Vec<Track> = watched.iter().flat_map(|w| w.tracks.iter().cloned()).collect();
    let searches: Vec<_> = watched.iter().filter_map(|w| w.search.clone()).collect();
    results::write_search(&args.solving.out, &searches, &tracks)?;
    let mut facts = facts(&args.session, &watched);
    // With a calibration given nothing is told by landmarks.
    for of_camera in watched.iter().filter(|_| known.is_none()) {
        let camera = &of_camera.camera;
        if let Some(still) = &of_camera.still {
            let told = add_plate(&mut rig, camera, still);
            let told = told
                .unwrap_or_else(|| "home plate not seen: hidden, or not where the clicks put it".to_owned());
            facts.push((format!("camera {camera}"), told));
        }
    }
    let title = if rig.site.name.is_empty() {
        args.session.display().to_string()
    } else {
        rig.site.name.clone()
    };
    args.solving
        .solve_and_write((&title, &rig), &tracks, &facts, warnings)
        .with_context(|| format!("{}", args.session.display()))?;
    let unusable: u64 = watched.iter().map(|w| w.unusable).sum();
    if !damage.is_empty() || unusable > 0 {
        anyhow::bail!(
            "{}: replayed with losses: {} damaged file(s), {unusable} unusable frame(s) (see the warnings)",
            args.session.display(),
            damage.len()
        );
    }
    Ok(())
}

fn rig_of(args: &ReplayArgs, session: &SessionReader) -> anyhow::Result<Rig> {
    match (&args.rig, session.rig_toml()) {
        (Some(path), _) => Ok(load_rig(path)?),
        (None, Some(text)) => Ok(parse_rig(&args.session.join("(rig inside)"), text)?),
        (None, None) => anyhow::bail!(
            "{}: the rig inside cannot be read: give one with --rig FILE",
            args.session.display()
        ),
    }
}

/// One source for each recorded camera; each must be in the rig and of its size.
fn sources(session: &SessionReader, rig: &Rig) -> anyhow::Result<Vec<Box<dyn FrameSource>>> {
    let mut sources: Vec<Box<dyn FrameSource>> = Vec::new();
    for camera in session.cameras() {
        let id = &camera.id;
        let Some(setup) = rig.camera(id) else {
            let known: Vec<_> = rig.cameras.iter().map(|c| c.id.as_str()).collect();
            anyhow::bail!(
                "{}: camera `{id}` is recorded but not in the rig ({})",
                session.folder().display(),
                known.join(", ")
            );
        };
        let source = RecordingSource::open(session, id)?;
        let size = source.geometry();
        if (size.width_px, size.height_px) != (setup.width_px, setup.height_px) {
            anyhow::bail!(
                "camera `{id}`: recorded frames are {}×{}, the rig says {}×{}",
                size.width_px,
                size.height_px,
                setup.width_px,
                setup.height_px
            );
        }
        sources.push(Box::new(source));
    }
    if sources.is_empty() {
        anyhow::bail!("{}: no camera in this session", session.folder().display());
    }
    Ok(sources)
}

/// A camera of which many frames were not searched.
fn unsearched(watched: &Watched) -> Option<String> {
    let (unsearched, frames) = (watched.search.as_ref()?.global_changes, watched.frames);
    (unsearched as f64 > UNSEARCHED_SHARE_TOLD * frames as f64).then(|| {
        format!(
            "camera {}: {unsearched} of its {frames} frames were not searched: much of the picture changed at once, as when \
             the camera moves, or in snow",
            watched.camera
        )
    })
}

fn facts(session: &Path, watched: &[Watched]) -> Vec<(String, String)> {
    let mut facts = vec![("session".to_owned(), session.display().to_string())];
    for w in watched {
        let search = w
            .search
            .as_ref()
            .map_or(String::new(), |s| format!("; {}", s.seen()));
        let told = format!(
            "{} frames, {} tracks of pitches{search}",
            w.frames,
            w.tracks.len()
        );
        facts.push((format!("camera {}", w.camera), told));
    }
    facts
}

/// A progress bar on a terminal, nothing elsewhere.
fn bar(frames: Option<u64>) -> ProgressBar {
    let Some(frames) = frames else {
        return ProgressBar::new_spinner();
    };
    let style = ProgressStyle::with_template("{bar:40} {pos}/{len} frames, {per_sec}, {eta} left");
    let bar = ProgressBar::new(frames);
    match style {
        Ok(style) => bar.with_style(style),
        Err(_) => bar,
    }
}
