//! `pitchd evaluate detection`: tracks against true centres, from files or from a scenario's own frames.

use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::Args;

use super::detecting::DetectingArgs;
use crate::daemon::outfit::eye_of;
use crate::evaluation::{DetectionScore, read_centres, score_tracks, truth_of};
use crate::eye::CameraEye;
use crate::recording::read_track_folder;
use crate::scene::{CameraId, Frame, Track};
use crate::simulation::{self, CameraRenderer, Scenario, simulate_tracks};

const AFTER_HELP: &str = "\
Examples:
  pitchd evaluate detection /tmp/hard/result /tmp/hard/truth
  pitchd evaluate detection --scenario config/scenario/hard.toml --pictures /tmp/misses
  pitchd evaluate detection --scenario config/scenario/hard.toml --detector kim2019
  pitchd evaluate detection --scenario config/scenario/idle.toml --out /tmp/idle

RESULT is an output folder of `replay` (its tracks/ are scored) or a folder of track files; TRUTH holds \
truth.json and <camera>.csv. With --scenario the frames are rendered, searched and scored in one go, \
and --out keeps what `solve` and `evaluate pitches` need: rig.toml, tracks/, truth/.";

/// Side of a picture of a miss, pixels.
const PICTURE_SIDE_PX: i64 = 96;
/// Most pictures of one camera.
const PICTURES_MAX: usize = 60;

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
    /// Cut every miss and every false track out of the frames into this folder (PGM).
    #[arg(long, requires = "scenario", value_name = "DIR")]
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
    file.cameras
        .iter()
        .filter(|camera| wanted(args, &camera.id))
        .map(|camera| {
            Ok(score_tracks(
                &camera.id,
                &tracks,
                &read_centres(truth, &camera.id)?,
                pitches,
            ))
        })
        .collect()
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
        let config = args.detecting.of(eye_of(&simulated.rig, &camera.id, None));
        let mut eye = CameraEye::new(camera.id.clone(), config, camera.width_px, camera.height_px);
        for frame in renderer.frames() {
            eye.push(&frame)?;
        }
        eye.finish();
        let tracks = eye.drain_pitches();
        tracing::info!(camera = %camera.id, counters = ?eye.counters(), "searched");
        let score = score_tracks(&camera.id, &tracks, &balls.unwrap_or_default(), pitches);
        if let Some(folder) = &args.pictures {
            let frames = CameraRenderer::new(&scenario, index)?.frames();
            cut_pictures(&folder.join(camera.id.as_str()), &score, &tracks, frames)?;
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

/// Writes a picture of every miss and of a point of every false track.
fn cut_pictures(
    folder: &Path,
    score: &DetectionScore,
    tracks: &[Track],
    frames: impl Iterator<Item = Frame>,
) -> anyhow::Result<()> {
    let mut wanted: Vec<(u64, f64, f64, String)> = score
        .missed
        .iter()
        .map(|b| {
            (
                b.frame,
                b.x_px,
                b.y_px,
                format!("miss-pitch{}-frame{}", b.pitch, b.frame),
            )
        })
        .collect();
    for track in tracks
        .iter()
        .filter(|t| score.false_track_numbers.contains(&t.track))
    {
        if let Some(p) = track.points.get(track.points.len() / 2) {
            wanted.push((
                p.frame,
                p.pixel.x,
                p.pixel.y,
                format!("false-track{}-frame{}", track.track, p.frame),
            ));
        }
    }
    wanted.truncate(PICTURES_MAX);
    if wanted.is_empty() {
        return Ok(());
    }
    std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    for frame in frames {
        for (_, x, y, name) in wanted.iter().filter(|w| w.0 == frame.stamp.frame) {
            let path = folder.join(format!("{name}.pgm"));
            std::fs::write(&path, cut(&frame, *x, *y)).with_context(|| path.display().to_string())?;
        }
    }
    Ok(())
}

/// A square around a point as PGM.
fn cut(frame: &Frame, x_px: f64, y_px: f64) -> Vec<u8> {
    let mut out = format!("P5\n{PICTURE_SIDE_PX} {PICTURE_SIDE_PX}\n255\n").into_bytes();
    let (left, top) = (
        x_px as i64 - PICTURE_SIDE_PX / 2,
        y_px as i64 - PICTURE_SIDE_PX / 2,
    );
    for y in top..top + PICTURE_SIDE_PX {
        for x in left..left + PICTURE_SIDE_PX {
            let inside =
                (0..i64::from(frame.width_px)).contains(&x) && (0..i64::from(frame.height_px)).contains(&y);
            let index = (y * i64::from(frame.width_px) + x) as usize;
            out.push(if inside {
                frame.bytes().get(index).copied().unwrap_or(0)
            } else {
                0
            });
        }
    }
    out
}
