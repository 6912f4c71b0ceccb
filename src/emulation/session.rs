//! A recorded session as a script: one camera's frames at the times of their stamps.

use std::path::{Path, PathBuf};

use super::script::{Script, ScriptShape, ScriptedFrame};
use crate::recording::{RecordingError, SessionReader};
use crate::scene::CameraId;
use crate::time::NANOS_PER_SECOND;

/// Why a session cannot be shown.
#[derive(Debug, thiserror::Error)]
pub enum ScriptError {
    /// It cannot be read.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// It has no such camera, or no frame of it.
    #[error("{}: no frames of camera {camera}; it has {known}", folder.display())]
    NoCamera {
        /// Camera.
        camera: CameraId,
        /// Session.
        folder: PathBuf,
        /// Its cameras.
        known: String,
    },
}

/// Exposure where the recording does not say, seconds.
const EXPOSURE_S: f64 = 0.001;

/// The script of one camera of a session. Its begin is the first stamp of any camera, so that several cameras begun
/// together show the session as it was.
///
/// # Errors
/// [`ScriptError`].
pub fn session_script(folder: &Path, camera: &CameraId) -> Result<(ScriptShape, Script), ScriptError> {
    let session = SessionReader::open(folder)?;
    let missing = || ScriptError::NoCamera {
        camera: camera.clone(),
        folder: folder.to_owned(),
        known: session
            .cameras()
            .map(|c| c.id.to_string())
            .collect::<Vec<_>>()
            .join(", "),
    };
    let recording = session.cameras().find(|c| c.id == *camera).ok_or_else(missing)?;
    let geometry = recording.geometry.ok_or_else(missing)?;
    let first_frames: Vec<_> = session.frames(camera).ok_or_else(missing)?.take(32).collect();
    let exposure_s = first_frames
        .iter()
        .find_map(|f| f.exposure_s)
        .unwrap_or(EXPOSURE_S);
    let stamps: Vec<_> = first_frames.iter().map(|f| f.frame.stamp.stamped).collect();
    // The rate of the first half second: the median step between neighbours.
    let mut steps: Vec<f64> = stamps
        .windows(2)
        .filter_map(|pair| Some(pair.get(1)?.seconds_since(pair.first()?.nanos())))
        .filter(|step| *step > 1e-4)
        .collect();
    steps.sort_by(f64::total_cmp);
    let step_s = *steps.get(steps.len() / 2).ok_or_else(missing)?;
    let shape = ScriptShape {
        width_px: geometry.width_px,
        height_px: geometry.height_px,
        // A rate that was a round number before the stamps' jitter stays one.
        rate_hz: (100.0 / step_s).round() / 100.0,
        exposure_s,
    };
    let half_ns = (0.5 * exposure_s * NANOS_PER_SECOND) as i64;
    let begins: Vec<i64> = session
        .cameras()
        .filter_map(|c| Some(session.frames(&c.id)?.next()?.frame.stamp.stamped.nanos()))
        .collect();
    let epoch_ns = begins.into_iter().min().ok_or_else(missing)? - half_ns;
    let frames = session.frames(camera).ok_or_else(missing)?;
    let (width, height) = (geometry.width_px, geometry.height_px);
    let script = frames
        .filter(move |f| (f.frame.width_px, f.frame.height_px) == (width, height))
        .map(move |f| ScriptedFrame {
            begin_ns: (f.frame.stamp.stamped.nanos() - half_ns - epoch_ns).max(0),
            pixels: f.frame.pixels,
        });
    Ok((shape, Box::new(script)))
}
