//! The keeper's thread: pitches, tracks and calibrations to files. A disk that stands still holds up nothing else.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};

use crossbeam_channel::Receiver;

use crate::export::results;
use crate::recording::{append_track, read_track_file};
use crate::scene::{Calibration, CameraId, Track};

/// A pitch as it goes to the files.
pub struct KeptPitch {
    /// Its line.
    pub line: String,
    /// What it was solved from.
    pub tracks: Vec<Track>,
}

/// Writes pitches and calibrations until both end.
pub fn keep(folder: &Path, pitches: &Receiver<KeptPitch>, versions: &Receiver<Calibration>) {
    let mut keeper = Keeper::new(folder);
    loop {
        crossbeam_channel::select! {
            recv(pitches) -> pitch => match pitch {
                Ok(pitch) => keeper.keep(&pitch),
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

    fn keep(&mut self, pitch: &KeptPitch) {
        if let Err(error) = self.append(&pitch.line) {
            tracing::error!(%error, folder = %self.folder.display(), "pitches.jsonl was not written");
            self.file = None;
        }
        for track in &pitch.tracks {
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
