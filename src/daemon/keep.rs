//! The keeper's thread: pitches, tracks and calibrations to files. A disk that stands still holds up nothing else.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{Read, Seek, SeekFrom, Write};
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

/// Number of the last pitch in a results folder; 0 without one. A line that a power cut has torn is told of and left out.
pub fn last_number(folder: &Path) -> u32 {
    let path = folder.join("pitches.jsonl");
    let bytes = std::fs::read(&path).unwrap_or_default();
    let text = String::from_utf8_lossy(&bytes);
    let mut last = 0;
    for (k, line) in text
        .lines()
        .enumerate()
        .filter(|(_, line)| !line.trim().is_empty())
    {
        match serde_json::from_str::<Numbered>(line) {
            Ok(numbered) => last = last.max(numbered.pitch),
            Err(error) => tracing::warn!("{}:{}: no pitch: {error}", path.display(), k + 1),
        }
    }
    last
}

/// What is read of a pitch that was written before.
#[derive(serde::Deserialize)]
struct Numbered {
    pitch: u32,
}

/// Opens a file of lines to add to; a last line that was torn is ended.
fn open_lines(path: &Path) -> std::io::Result<File> {
    let mut file = OpenOptions::new()
        .create(true)
        .append(true)
        .read(true)
        .open(path)?;
    let mut last = [b'\n'];
    if file.seek(SeekFrom::End(-1)).is_ok() {
        file.read_exact(&mut last)?;
    }
    if last != *b"\n" {
        file.write_all(b"\n")?;
    }
    Ok(file)
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
                self.file.insert(open_lines(&self.folder.join("pitches.jsonl"))?)
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_torn_line_costs_itself_alone() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(last_number(folder.path()), 0);
        let path = folder.path().join("pitches.jsonl");
        std::fs::write(&path, "{\"pitch\": 7}\n{\"pitch\": 8}\n{\"pitch\": 9, \"cam").unwrap();
        assert_eq!(last_number(folder.path()), 8);
        let mut keeper = Keeper::new(folder.path());
        keeper.append("{\"pitch\": 9}\n").unwrap();
        keeper.append("{\"pitch\": 10}\n").unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(
            text.ends_with("\"cam\n{\"pitch\": 9}\n{\"pitch\": 10}\n"),
            "{text}"
        );
        assert_eq!(last_number(folder.path()), 10);
    }
}
