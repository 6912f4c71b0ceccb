//! The publisher's thread: each pitch as one line of JSON, to a file and to standard output.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};

use crossbeam_channel::{Receiver, Sender, TrySendError};

use super::assemble::Published;
use crate::export::results;
use crate::recording::{append_track, read_track_file};
use crate::scene::{Calibration, CameraId, Track};

/// What was published and how late.
#[derive(Debug, Clone, Default)]
pub struct PublishLog {
    /// Pitches written to the file.
    pub pitches: u64,
    /// Lines that a slow reader of standard output did not take.
    pub lines_dropped: u64,
    /// From the arrival of the last frame needed to publication, milliseconds, of the pitches that waited for nothing.
    pub latency_ms: Vec<f64>,
}

impl PublishLog {
    /// A quantile of the latency; `None` without pitches.
    pub fn latency_quantile_ms(&self, share: f64) -> Option<f64> {
        let mut sorted = self.latency_ms.clone();
        sorted.sort_by(f64::total_cmp);
        let last = sorted.len().checked_sub(1)?;
        sorted.get((share * last as f64).round() as usize).copied()
    }
}

/// Writes pitches and calibrations until both end. The file comes first; a stalled reader of standard output costs
/// only lines there (`lines` is a short queue to a thread of its own).
pub fn publish(
    folder: &Path,
    pitches: &Receiver<Published>,
    versions: &Receiver<Calibration>,
    lines: &Sender<String>,
) -> PublishLog {
    let mut log = PublishLog::default();
    let mut keeper = Keeper::new(folder);
    loop {
        crossbeam_channel::select! {
            recv(pitches) -> published => match published {
                Ok(published) => keeper.keep(&published, lines, &mut log),
                Err(_) => break,
            },
            recv(versions) -> calibration => {
                if let Ok(calibration) = calibration {
                    keeper.keep_calibration(&calibration);
                }
            }
        }
    }
    for calibration in versions.try_iter() {
        keeper.keep_calibration(&calibration);
    }
    log
}

/// Number of the last pitch in a results folder; 0 without one.
pub fn last_number(folder: &Path) -> u32 {
    let pitches = results::read_pitches(&folder.join("pitches.jsonl")).unwrap_or_default();
    pitches.iter().map(|p| p.pitch).max().unwrap_or(0)
}

struct Keeper {
    folder: PathBuf,
    file: Option<File>,
    /// Last track in each camera's file.
    tracks: BTreeMap<CameraId, u32>,
}

impl Keeper {
    fn new(folder: &Path) -> Self {
        Self {
            folder: folder.to_owned(),
            file: None,
            tracks: BTreeMap::new(),
        }
    }

    /// The file is opened again after a failure: a disk may come back.
    fn append(&mut self, line: &str) -> std::io::Result<()> {
        let file = match &mut self.file {
            Some(file) => file,
            None => {
                std::fs::create_dir_all(&self.folder)?;
                let path = self.folder.join("pitches.jsonl");
                self.file
                    .insert(OpenOptions::new().create(true).append(true).open(path)?)
            }
        };
        file.write_all(line.as_bytes())?;
        file.sync_data()
    }

    fn keep(&mut self, published: &Published, lines: &Sender<String>, log: &mut PublishLog) {
        let line = match results::jsonl(std::slice::from_ref(&published.pitch)) {
            Ok(line) => line,
            Err(error) => {
                tracing::error!(%error, pitch = published.pitch.pitch, "not written");
                return;
            }
        };
        if let Err(TrySendError::Full(_)) = lines.try_send(line.clone()) {
            log.lines_dropped += 1;
        }
        log.latency_ms.extend(published.latency_ms);
        log.pitches += 1;
        tracing::info!(
            pitch = published.pitch.pitch,
            speed_mps = published.pitch.release_speed_mps,
            latency_ms = published.latency_ms,
            "pitch"
        );
        if let Err(error) = self.append(&line) {
            tracing::error!(%error, folder = %self.folder.display(), "pitches.jsonl was not written");
            self.file = None;
        }
        for track in &published.tracks {
            self.append_track(track);
        }
    }

    /// Numbers go on where an earlier run stopped.
    fn append_track(&mut self, track: &Track) {
        let folder = self.folder.join("tracks");
        let last = self.tracks.entry(track.camera.clone()).or_insert_with(|| {
            let path = folder.join(format!("{}.csv", track.camera));
            let before = read_track_file(&path, &track.camera).unwrap_or_default();
            before.iter().map(|t| t.track).max().unwrap_or(0)
        });
        *last += 1;
        let numbered = Track {
            track: *last,
            ..track.clone()
        };
        if let Err(error) = append_track(&folder, &numbered) {
            tracing::error!(%error, "a track was not written");
        }
    }

    fn keep_calibration(&self, calibration: &Calibration) {
        let path = self.folder.join("calibration.json");
        let text = serde_json::to_string_pretty(calibration).map_err(|e| e.to_string());
        let written = text.and_then(|text| {
            std::fs::create_dir_all(&self.folder).map_err(|e| e.to_string())?;
            results::replace(&path, &text).map_err(|e| e.to_string())
        });
        if let Err(error) = written {
            tracing::error!(
                "calibration version {} was not kept: {error}",
                calibration.version
            );
        }
    }
}

/// Prints lines until they end; blocks when nobody reads, and then only itself.
pub fn print(lines: &Receiver<String>) {
    for line in lines {
        let mut out = std::io::stdout().lock();
        if out.write_all(line.as_bytes()).and_then(|()| out.flush()).is_err() {
            return;
        }
    }
}
