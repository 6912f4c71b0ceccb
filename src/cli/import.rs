//! `pitchd import`: a session from folders of images or video files.

use std::io::IsTerminal;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use indicatif::{ProgressBar, ProgressStyle};

use crate::capture::{FrameGeometry, FrameSource, ImageFolder, Stamping, VideoFile};
use crate::config::{load_rig, nearest, portable_rig};
use crate::recording::{CameraGeometry, CameraWriter, PixelEncoding, RecordedFrame};
use crate::recording::{SessionOptions, SessionWriter, remove_session};
use crate::scene::{CameraId, CameraSetup, Rig};

const AFTER_HELP: &str = "\
A camera's PATH is a folder of images (PGM, PNG, TIFF, JPEG; colour becomes grey, of more than 8 bits the upper 8 are
kept) or a video file.
Times: PATH/timestamps.csv with the columns frame,timestamp_ns (middle of the exposure by the camera's stamps;
for a video NAME.timestamps.csv or timestamps.csv beside it), or --fps. The number in an image's name is its \
frame number; when the names hold none, images by name go with the rows by frame number.

Example:
  pitchd import monday --rig rig.toml --camera first=frames/first --camera third=frames/third";

/// Arguments of `import`.
#[derive(Debug, clap::Args)]
#[command(after_help = AFTER_HELP)]
pub struct ImportArgs {
    /// Folder of the new session; it must be empty or not exist.
    out: PathBuf,
    /// Rig file; it is kept in the session.
    #[arg(long, value_name = "FILE")]
    rig: PathBuf,
    /// A camera of the rig and its images or video; once per camera.
    #[arg(long = "camera", value_name = "ID=PATH", required = true, value_parser = camera_path)]
    cameras: Vec<(CameraId, PathBuf)>,
    /// Frame rate in Hz for cameras without timestamps.csv: a frame's time is its number over the rate.
    #[arg(long, value_name = "HZ", value_parser = rate)]
    fps: Option<f64>,
    /// Bits of a camera's levels in images of 16 bits (PNG, TIFF); a PGM whose own maximum is below 65535 says it itself.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(9..=16))]
    bits: Option<u32>,
    /// How pixels are stored; both keep all 8 bits.
    #[arg(long, value_enum, default_value_t = Compress::Raw)]
    compress: Compress,
    /// Replace the session that is in OUT.
    #[arg(long)]
    force: bool,
    /// Print what was imported as JSON.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Compress {
    /// As they are: fastest.
    Raw,
    /// PNG: about half the disk.
    Png,
}

fn camera_path(text: &str) -> Result<(CameraId, PathBuf), String> {
    let (id, path) = text
        .split_once('=')
        .ok_or("write ID=PATH, as in first=frames/first")?;
    if path.is_empty() {
        return Err("there is no path behind '='".to_owned());
    }
    Ok((CameraId::new(id).map_err(|e| e.to_string())?, PathBuf::from(path)))
}

fn rate(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(hz) if hz.is_finite() && hz > 0.0 => Ok(hz),
        _ => Err("a rate is a number above 0".to_owned()),
    }
}

/// A camera ready to be imported.
struct Import {
    source: Box<dyn FrameSource>,
    writer: CameraWriter,
}

#[derive(Debug, serde::Serialize)]
struct Imported {
    camera: CameraId,
    frames: u64,
    bytes: u64,
    cut_off: bool,
}

/// Runs the import.
///
/// # Errors
/// One line that names the culprit; what was written before stays readable.
pub fn run(args: &ImportArgs) -> anyhow::Result<()> {
    let rig = load_rig(&args.rig)?;
    let rig_toml = portable_rig(&args.rig)?;
    let sources = open_sources(args, &rig)?;
    warn_of_absent(args, &rig);
    prepare_folder(&args.out, args.force)?;
    let options = SessionOptions {
        rig_toml,
        encoding: match args.compress {
            Compress::Raw => PixelEncoding::Raw,
            Compress::Png => PixelEncoding::Png,
        },
        ..Default::default()
    };
    let mut session = SessionWriter::create(&args.out, options)?;
    let mut imports = Vec::new();
    for source in sources {
        let FrameGeometry { width_px, height_px } = source.geometry();
        let writer = session.camera(source.camera(), CameraGeometry { width_px, height_px })?;
        imports.push(Import { source, writer });
    }
    let begun = std::time::Instant::now();
    let results = pump_all(imports);
    // The session is ended even when a camera failed: what was written stays readable.
    let written: u64 = results.iter().map(|(imported, _)| imported.frames).sum();
    let ended = session.finish();
    let mut cameras = Vec::new();
    for (imported, result) in results {
        result.with_context(|| {
            format!(
                "import stopped after {written} frames, what reached the disk is kept in {}",
                args.out.display()
            )
        })?;
        cameras.push(imported);
    }
    ended?;
    tell(args, &cameras, begun.elapsed().as_secs_f64())?;
    let cut_off = cameras.iter().filter(|camera| camera.cut_off);
    let cut_off: Vec<&str> = cut_off.map(|camera| camera.camera.as_str()).collect();
    if !cut_off.is_empty() {
        bail!(
            "{}: imported with losses: the file of {} ended too early (see the warnings)",
            args.out.display(),
            cut_off.join(", ")
        );
    }
    Ok(())
}

fn open_sources(args: &ImportArgs, rig: &Rig) -> anyhow::Result<Vec<Box<dyn FrameSource>>> {
    let stamping = args.fps.map_or(Stamping::List, Stamping::RateHz);
    let mut sources: Vec<Box<dyn FrameSource>> = Vec::new();
    for (id, path) in &args.cameras {
        let setup = find_camera(rig, id, &args.rig)?;
        if sources.iter().any(|s| s.camera() == id) {
            bail!("camera {id} is given twice");
        }
        let geometry = FrameGeometry {
            width_px: setup.width_px,
            height_px: setup.height_px,
        };
        if path.is_dir() {
            let source = ImageFolder::open(id, path, geometry, stamping, args.bits)?;
            for warning in source.warnings() {
                tell_line!("pitchd: warning: {warning}");
            }
            sources.push(Box::new(source));
        } else {
            sources.push(Box::new(VideoFile::open(id, path, geometry, stamping)?));
        }
    }
    Ok(sources)
}

fn find_camera<'a>(rig: &'a Rig, id: &CameraId, file: &Path) -> anyhow::Result<&'a CameraSetup> {
    if let Some(setup) = rig.camera(id) {
        return Ok(setup);
    }
    let known: Vec<&str> = rig.cameras.iter().map(|c| c.id.as_str()).collect();
    let guess = match nearest(id.as_str(), known.iter().copied()) {
        Some(near) => format!("did you mean {near}?"),
        None => format!("it has {}", known.join(", ")),
    };
    bail!("--camera {id}: {} has no such camera; {guess}", file.display())
}

fn warn_of_absent(args: &ImportArgs, rig: &Rig) {
    for camera in &rig.cameras {
        if !args.cameras.iter().any(|(id, _)| *id == camera.id) {
            tell_line!(
                "pitchd: warning: camera {} of {} gets no images",
                camera.id,
                args.rig.display()
            );
        }
    }
}

fn prepare_folder(out: &Path, force: bool) -> anyhow::Result<()> {
    if out.exists() && !out.is_dir() {
        bail!("{}: is a file; a session is a folder", out.display());
    }
    let empty = !out.exists()
        || std::fs::read_dir(out)
            .with_context(|| out.display().to_string())?
            .next()
            .is_none();
    if empty {
        return Ok(());
    }
    if !force {
        bail!(
            "{}: exists and is not empty; --force replaces a session",
            out.display()
        );
    }
    Ok(remove_session(out)?)
}

/// Imports every camera on a thread of its own.
fn pump_all(imports: Vec<Import>) -> Vec<(Imported, anyhow::Result<()>)> {
    let expected: Option<u64> = imports.iter().map(|i| i.source.frames_expected()).sum();
    let bar = progress_bar(expected);
    let results = std::thread::scope(|scope| {
        let threads: Vec<_> = imports
            .into_iter()
            .map(|import| scope.spawn(|| pump(import, &bar)))
            .collect();
        threads
            .into_iter()
            .map(|thread| {
                thread
                    .join()
                    .unwrap_or_else(|panic| std::panic::resume_unwind(panic))
            })
            .collect()
    });
    bar.finish_and_clear();
    results
}

fn pump(import: Import, bar: &ProgressBar) -> (Imported, anyhow::Result<()>) {
    let Import {
        mut source,
        mut writer,
    } = import;
    let mut imported = Imported {
        camera: source.camera().clone(),
        frames: 0,
        bytes: 0,
        cut_off: false,
    };
    let mut copy = || -> anyhow::Result<()> {
        for frame in source.by_ref() {
            let recorded = RecordedFrame::from(frame?);
            writer.write(&recorded)?;
            imported.frames += 1;
            imported.bytes += recorded.frame.bytes().len() as u64;
            bar.inc(1);
        }
        Ok(())
    };
    let copied = copy();
    imported.cut_off = source.is_cut_off();
    for remark in source.remarks() {
        bar.suspend(|| tell_line!("pitchd: warning: {remark}"));
    }
    let finished = writer.finish();
    (imported, copied.and(finished.map_err(Into::into)))
}

fn progress_bar(expected: Option<u64>) -> ProgressBar {
    if !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let style = ProgressStyle::with_template("{bar:40} {pos}/{len} frames, {per_sec}, {eta} left");
    ProgressBar::new(expected.unwrap_or(0)).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}

fn tell(args: &ImportArgs, cameras: &[Imported], seconds: f64) -> anyhow::Result<()> {
    if args.json {
        say_line!("{}", serde_json::to_string_pretty(cameras)?);
        return Ok(());
    }
    for camera in cameras {
        say_line!("{}: {} frames", camera.camera, camera.frames);
    }
    let bytes: u64 = cameras.iter().map(|c| c.bytes).sum();
    let rate = bytes as f64 / 1e6 / seconds.max(1e-9);
    say_line!("{} in {seconds:.1} s ({rate:.0} MB/s)", args.out.display());
    Ok(())
}
