//! `pitchd info`: what is in a session, and what of it is broken.

use std::path::PathBuf;

use anyhow::bail;

use crate::recording::{CameraRecording, SessionReader, Verified};

const AFTER_HELP: &str = "\
Without --verify only the ends of the files are looked at; with it, or where an end is damaged, every frame is \
read and its checksum compared. Exit code 1 when anything is damaged.

Example:
  pitchd info sessions/monday --verify";

/// Arguments of `info`.
#[derive(Debug, clap::Args)]
#[command(after_help = AFTER_HELP)]
pub struct InfoArgs {
    /// Folder of the session.
    session: PathBuf,
    /// Read every frame.
    #[arg(long)]
    verify: bool,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

/// Prints cameras, spans and damage.
///
/// # Errors
/// The folder is no session, or something in it is damaged.
pub fn run(args: &InfoArgs) -> anyhow::Result<()> {
    let session = SessionReader::open(&args.session)?;
    // How much of a damaged file is left can only be told by reading it.
    let whole = (args.verify || !session.damage().is_empty()).then(|| session.verify());
    if args.json {
        let json = json(&session, whole.as_ref());
        say_line!("{}", serde_json::to_string_pretty(&json)?);
    } else {
        print(&session, whole.as_ref());
    }
    match session.damage().len() {
        0 => Ok(()),
        1 => bail!("{}: 1 file is damaged", args.session.display()),
        n => bail!("{}: {n} files are damaged", args.session.display()),
    }
}

fn print(session: &SessionReader, whole: Option<&Verified>) {
    say_line!(
        "{:16} {:>11} {:>7} {:>9} {:>9} files",
        "camera",
        "size",
        "frames",
        "span",
        "rate"
    );
    for camera in session.cameras() {
        let size = camera
            .geometry
            .map_or_else(|| "?".to_owned(), |g| format!("{}x{}", g.width_px, g.height_px));
        let frames = camera.frames.map_or_else(|| "?".to_owned(), |n| n.to_string());
        let (span, rate) = span_and_rate(camera).map_or_else(
            || ("?".to_owned(), "?".to_owned()),
            |(span_s, rate_hz)| (format!("{span_s:.3} s"), format!("{rate_hz:.2} Hz")),
        );
        let files = camera.files.len();
        say_line!(
            "{:16} {size:>11} {frames:>7} {span:>9} {rate:>9} {files}",
            camera.id.as_str()
        );
    }
    let kept = |there: bool| if there { "yes" } else { "no" };
    say_line!(
        "rig: {}, calibration: {}",
        kept(session.rig_toml().is_some()),
        kept(session.calibration_json().is_some())
    );
    if let Some(whole) = whole {
        say_line!("{} frames read, checksums right", whole.frames);
        for (camera, holes) in &whole.holes {
            say_line!(
                "camera {camera}: {} frames were never recorded, in {} places",
                holes.frames,
                holes.places
            );
        }
    }
    for loss in session.losses() {
        say_line!("lost in an earlier repair: {loss}");
    }
    for damage in session.damage() {
        say_line!("damaged: {damage}");
    }
}

/// Seconds from the first stamp to the last, and the rate that makes.
fn span_and_rate(camera: &CameraRecording) -> Option<(f64, f64)> {
    let (first, last) = camera.span?;
    let span_s = last.seconds_since(first.nanos());
    let intervals = camera.frames?.checked_sub(1)?;
    Some((
        span_s,
        if span_s > 0.0 {
            intervals as f64 / span_s
        } else {
            0.0
        },
    ))
}

fn json(session: &SessionReader, whole: Option<&Verified>) -> serde_json::Value {
    let cameras: Vec<_> = session
        .cameras()
        .map(|camera| {
            serde_json::json!({
                "id": camera.id,
                "width_px": camera.geometry.map(|g| g.width_px),
                "height_px": camera.geometry.map(|g| g.height_px),
                "frames": camera.frames,
                "first_stamp_ns": camera.span.map(|(first, _)| first),
                "last_stamp_ns": camera.span.map(|(_, last)| last),
                "files": camera.files,
            })
        })
        .collect();
    let damage: Vec<_> = session
        .damage()
        .into_iter()
        .map(|d| {
            serde_json::json!({
                "file": d.file,
                "camera": d.camera,
                "frames_read": d.frames_read,
                "frames_lost": d.frames_lost.count(),
                "bytes_lost": d.bytes_lost,
                "reason": d.reason,
            })
        })
        .collect();
    serde_json::json!({
        "cameras": cameras,
        "rig": session.rig_toml().is_some(),
        "calibration": session.calibration_json().is_some(),
        "frames_verified": whole.map(|w| w.frames),
        "holes": whole.map(|w| &w.holes),
        "losses": session.losses(),
        "damage": damage,
    })
}
