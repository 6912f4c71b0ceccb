//! `pitchd evaluate detection`: tracks against true centres, from files or from a scenario's own frames.

use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::Args;

use super::detecting::DetectingArgs;
use crate::daemon::outfit::Wanted;
use crate::daemon::plates::add_plate;
use crate::daemon::watch::TimedEye;
use crate::evaluation::{DetectionScore, Pictures, read_centres, score_tracks, truth_of};
use crate::export::results;
use crate::recording::{SessionReader, read_track_folder};
use crate::scene::{CameraId, Frame, Track};
use crate::simulation::{self, CameraRenderer, Scenario, simulate_tracks};

const AFTER_HELP: &str = "\
Examples:
  pitchd evaluate detection /tmp/hard/result /tmp/hard/truth
  pitchd evaluate detection result truth --session sessions/monday --pictures /tmp/misses
  pitchd evaluate detection --scenario config/scenario/hard.toml --pictures /tmp/misses
  pitchd evaluate detection --scenario config/scenario/hard.toml --detector kim2019
  pitchd evaluate detection --scenario config/scenario/idle.toml --out /tmp/idle

RESULT is an output folder of `replay` (its tracks/ are scored) or a folder of track files; TRUTH holds \
truth.json and <camera>.csv. Latency is told of results of `replay` and with --scenario. \
--pictures cuts out of the frames of --session or of the scenario (PNG, four times as large; marks on the edges point \
to the place). With --scenario the frames are rendered, searched and scored in one go, \
and --out keeps what `solve` and `evaluate pitches` need: rig.toml, tracks/, truth/.";

/// Arguments of `pitchd evaluate detection`.
#[derive(Debug, Args)]
#[command(after_help = AFTER_HELP, arg_required_else_help = true)]
pub struct EvaluateDetectionArgs {
    /// Results folder of `replay`, or a folder of track files.
    #[arg(required_unless_present = "scenario")]
    pub result: Option<PathBuf>,
    /// Truth folder.
    #[arg(required_unless_present = "scenario")]
    pub truth: Option<PathBuf>,
    /// Render this scenario's frames, search and score them.
    #[arg(long, conflicts_with_all = ["result", "truth"])]
    pub scenario: Option<PathBuf>,
    /// Only this camera.
    #[arg(long)]
    pub camera: Option<String>,
    /// Another seed than the scenario's.
    #[arg(long, requires = "scenario")]
    pub seed: Option<u64>,
    /// The session whose frames were searched, for --pictures.
    #[arg(long, value_name = "DIR", requires = "pictures", conflicts_with = "scenario")]
    pub session: Option<PathBuf>,
    /// Cut every miss and every false track out of the frames into this folder.
    #[arg(long, value_name = "DIR")]
    pub pictures: Option<PathBuf>,
    /// Write rig.toml, tracks/ and truth/ into this folder.
    #[arg(long, requires = "scenario", value_name = "DIR")]
    pub out: Option<PathBuf>,
    #[command(flatten)]
    detecting: DetectingArgs,
    /// Print the scores as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Runs the score.
///
/// # Errors
/// Unreadable tracks, truth or scenario.
pub fn run(args: &EvaluateDetectionArgs) -> anyhow::Result<()> {
    let scores = match (&args.scenario, &args.result, &args.truth) {
        (Some(scenario), _, _) => of_scenario(args, scenario)?,
        (None, Some(_), _) if args.pictures.is_some() && args.session.is_none() => {
            anyhow::bail!(
                "--pictures: of which frames? --session SESSION says, the recording that RESULT is of"
            )
        }
        (None, Some(_), _) if args.detecting.detector.is_some() => {
            anyhow::bail!("--detector: RESULT has been searched already; with --scenario frames are")
        }
        (None, Some(result), Some(truth)) => of_files(args, result, truth)?,
        _ => anyhow::bail!("needs RESULT and TRUTH, or --scenario"),
    };
    if args.json {
        say_line!("{}", serde_json::to_string_pretty(&scores)?);
    } else {
        for score in &scores {
            say!("{score}");
        }
    }
    Ok(())
}

fn wanted(args: &EvaluateDetectionArgs, camera: &CameraId) -> bool {
    args.camera.as_ref().is_none_or(|name| name == camera.as_str())
}

#[derive(serde::Deserialize)]
struct TruthFile {
    cameras: Vec<TruthCamera>,
    pitches: Vec<serde::de::IgnoredAny>,
}

#[derive(serde::Deserialize)]
struct TruthCamera {
    id: CameraId,
}

fn of_files(
    args: &EvaluateDetectionArgs,
    result: &Path,
    truth: &Path,
) -> anyhow::Result<Vec<DetectionScore>> {
    let inner = result.join("tracks");
    let tracks = read_track_folder(if inner.is_dir() { &inner } else { result })?;
    let path = truth.join("truth.json");
    let text = std::fs::read(&path).with_context(|| path.display().to_string())?;
    let file: TruthFile = serde_json::from_slice(&text).with_context(|| path.display().to_string())?;
    let pitches = file.pitches.len() as u32;
    let session = args.session.as_deref().map(SessionReader::open).transpose()?;
    let searches = results::read_search(result)?;
    let mut scores = Vec::new();
    for camera in file.cameras.iter().filter(|camera| wanted(args, &camera.id)) {
        let mut score = score_tracks(&camera.id, &tracks, &read_centres(truth, &camera.id)?, pitches);
        score.search = searches.iter().find(|s| s.camera == camera.id).cloned();
        if let (Some(folder), Some(session)) = (&args.pictures, &session) {
            let recorded = session
                .frames(&camera.id)
                .with_context(|| format!("{}: no camera `{}`", session.folder().display(), camera.id))?;
            cut_pictures(folder, &score, &tracks, recorded.map(|recorded| recorded.frame))?;
        }
        scores.push(score);
    }
    Ok(scores)
}

/// Cuts what was missed and what is false out of the frames of one camera.
fn cut_pictures(
    folder: &Path,
    score: &DetectionScore,
    tracks: &[Track],
    frames: impl Iterator<Item = Frame>,
) -> anyhow::Result<()> {
    let mut pictures = Pictures::of(score, tracks);
    let folder = folder.join(score.camera.as_str());
    for frame in frames {
        if pictures.missing() == 0 {
            break;
        }
        pictures.cut(&frame, &folder)?;
    }
    if pictures.missing() > 0 {
        tell_line!(
            "pitchd: warning: camera {}: the frames of {} pictures are not there",
            score.camera,
            pictures.missing()
        );
    }
    if pictures.left_out > 0 {
        tell_line!(
            "pitchd: warning: camera {}: {} pictures more than {} were left out",
            score.camera,
            pictures.left_out,
            pictures.written
        );
    }
    if pictures.written > 0 {
        tell_line!("{}: {} pictures", folder.display(), pictures.written);
    }
    Ok(())
}

fn of_scenario(args: &EvaluateDetectionArgs, path: &Path) -> anyhow::Result<Vec<DetectionScore>> {
    let mut scenario = Scenario::from_path(path)?;
    if let Some(seed) = args.seed {
        scenario = scenario.with_seed(seed);
    }
    let mut simulated = simulate_tracks(&scenario)?;
    let truth = &mut simulated.truth;
    let pitches = truth.pitches.len() as u32;
    let (mut scores, mut all_tracks) = (Vec::new(), Vec::new());
    for (index, camera) in truth
        .cameras
        .iter()
        .enumerate()
        .filter(|(_, c)| wanted(args, &c.id))
    {
        let renderer = CameraRenderer::new(&scenario, index)?;
        let centres = truth.centres.iter_mut().find(|c| c.camera == camera.id);
        let balls = centres.map(|centres| {
            renderer.mark_hidden(&mut centres.centres);
            truth_of(centres)
        });
        let mut wanted = Wanted::of(&simulated.rig, &camera.id, None);
        wanted.eye = args.detecting.of(wanted.eye);
        let mut eye = TimedEye::new(camera.id.clone(), wanted, (camera.width_px, camera.height_px));
        for frame in renderer.frames() {
            eye.push(&frame)?;
        }
        let (tracks, search, still) = eye.finish();
        if let Some(told) = still.and_then(|still| add_plate(&mut simulated.rig, &camera.id, &still)) {
            tell_line!("camera {}: {told}", camera.id);
        }
        let mut score = score_tracks(&camera.id, &tracks, &balls.unwrap_or_default(), pitches);
        score.search = Some(search);
        if let Some(folder) = &args.pictures {
            let frames = CameraRenderer::new(&scenario, index)?.frames();
            cut_pictures(folder, &score, &tracks, frames)?;
        }
        scores.push(score);
        all_tracks.extend(tracks);
    }
    if let Some(folder) = &args.out {
        simulation::write_rig(folder, &simulated.rig)?;
        simulation::write_tracks(folder, &simulated.rig, &all_tracks)?;
        simulation::write_truth(folder, &simulated.truth)?;
    }
    Ok(scores)
}
