//! The publisher's thread: each pitch as one line of JSON, to a file and to standard output; and the printer's.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use crossbeam_channel::{Receiver, Sender, TrySendError};

use super::assemble::Published;
use super::histogram::{Histogram, seconds_since};
use crate::export::results;
use crate::recording::{append_track, read_track_file};
use crate::scene::{Calibration, CameraId, Outlook, Track};

/// What was published and how late, for anyone to read.
#[derive(Debug, Default)]
pub struct PublishHealth {
    /// Pitches published.
    pub pitches: AtomicU64,
    /// Estimates of balls in flight.
    pub estimates: AtomicU64,
    /// Lines that a slow reader of standard output did not take.
    pub lines_dropped: AtomicU64,
    /// From the arrival of the last frame that a pitch needed to its publication; pitches that waited for a calibration
    /// are not in it.
    pub since_needed: Histogram,
    /// From the exposure midpoint of a pitch's last point to its publication.
    pub since_exposure: Histogram,
    /// From the exposure midpoint of an estimate's newest point to its publication.
    pub estimate_age: Histogram,
    /// From the arrival of the newest frame to the estimate's publication.
    pub estimate_latency: Histogram,
}

impl PublishHealth {
    /// One line for people.
    pub fn line(&self) -> String {
        let get = |n: &AtomicU64| n.load(Ordering::Relaxed);
        format!(
            "{} pitches, last needed frame to published {}, last exposure to published {}; {} estimates in flight, \
             newest frame to published {}, newest exposure to published {}; {} lines not taken",
            get(&self.pitches),
            self.since_needed.in_words(),
            self.since_exposure.in_words(),
            get(&self.estimates),
            self.estimate_latency.in_words(),
            self.estimate_age.in_words(),
            get(&self.lines_dropped),
        )
    }
}

/// A line about a ball in flight.
#[derive(serde::Serialize)]
struct InFlightLine<'a> {
    /// Number of the flight in this run.
    in_flight: u32,
    calibration_version: u32,
    #[serde(flatten)]
    outlook: &'a Outlook,
}

/// The line that tells of a ball in flight.
pub fn in_flight_line(outlook: &Outlook, flight: u32, calibration_version: u32) -> Option<String> {
    let line = InFlightLine {
        in_flight: flight,
        calibration_version,
        outlook,
    };
    serde_json::to_string(&line).ok().map(|text| text + "\n")
}

/// Writes pitches and calibrations until both end. A stalled reader of standard output costs only lines there (`lines` is
/// a short queue to a thread of its own).
pub fn publish(
    folder: &Path,
    pitches: &Receiver<Published>,
    versions: &Receiver<Calibration>,
    (lines, health): (&Sender<String>, &PublishHealth),
) {
    let mut keeper = Keeper::new(folder);
    loop {
        crossbeam_channel::select! {
            recv(pitches) -> published => match published {
                Ok(published) => keeper.keep(&published, lines, health),
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

    fn keep(&mut self, published: &Published, lines: &Sender<String>, health: &PublishHealth) {
        let line = match results::jsonl(std::slice::from_ref(&published.pitch)) {
            Ok(line) => line,
            Err(error) => {
                tracing::error!(%error, pitch = published.pitch.pitch, "not written");
                return;
            }
        };
        if let Err(TrySendError::Full(_)) = lines.try_send(line.clone()) {
            health.lines_dropped.fetch_add(1, Ordering::Relaxed);
        }
        let needed_s = published.complete.map(|at| seconds_since(at.nanos()));
        needed_s.iter().for_each(|s| health.since_needed.add_s(*s));
        if let Some(exposed) = published.exposed {
            health.since_exposure.add_since_ns(exposed.nanos());
        }
        health.pitches.fetch_add(1, Ordering::Relaxed);
        tracing::info!(
            pitch = published.pitch.pitch,
            speed_mps = published.pitch.release_speed_mps,
            since_last_frame_ms = needed_s.map(|s| 1e3 * s),
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

/// Prints lines until pitches end, pitches before estimates; blocks when nobody reads, and then only itself.
pub fn print(pitches: &Receiver<String>, estimates: &Receiver<String>) {
    let mut estimates = Some(estimates);
    loop {
        let never = crossbeam_channel::never();
        let line = crossbeam_channel::select_biased! {
            recv(pitches) -> line => match line {
                Ok(line) => line,
                Err(_) => return,
            },
            recv(estimates.unwrap_or(&never)) -> line => match line {
                Ok(line) => line,
                Err(_) => {
                    estimates = None;
                    continue;
                }
            },
        };
        let mut out = std::io::stdout().lock();
        if out.write_all(line.as_bytes()).and_then(|()| out.flush()).is_err() {
            return;
        }
    }
}
