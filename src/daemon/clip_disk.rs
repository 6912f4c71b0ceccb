//! The recorder's disk thread: clips to session folders, old ones removed to keep to the quota. It alone waits for the
//! disk, and a disk that is slow, full, read-only or gone costs recordings, which are counted.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use crossbeam_channel::Receiver;

use super::recorder::{HeldFrame, RecorderHealth};
use crate::config::RecordConfig;
use crate::recording::{
    CameraGeometry, CameraWriter, FrameFlags, RecordedFrame, RecordingError, SessionOptions, SessionWriter,
};
use crate::scene::CameraId;
use crate::time::{HostClock, SystemClock};

/// Work for the disk.
pub enum DiskJob {
    /// A clip, camera by camera, each by rising stamps.
    Clip(Vec<Arc<HeldFrame>>),
    /// One frame of a continuous recording.
    Frame(Arc<HeldFrame>),
}

/// A continuous recording begins a new session this often, so that the oldest can be removed.
const SESSION_MOST: Duration = Duration::from_secs(600);
/// After a failure a continuous recording rests this long.
const REST: Duration = Duration::from_secs(5);

/// The disk thread's tools.
pub struct ClipDisk {
    /// Where and how much.
    pub config: RecordConfig,
    /// Text of the rig file, kept in every session.
    pub rig_toml: String,
    /// `calibration.json` as it is published.
    pub calibration: PathBuf,
    /// What has been done.
    pub health: Arc<RecorderHealth>,
    /// Newer settings: the quota changes with them.
    pub configs: Receiver<RecordConfig>,
}

/// A session being written.
struct Open {
    session: SessionWriter,
    cameras: BTreeMap<CameraId, CameraWriter>,
    since: Instant,
    frames: u64,
}

impl Open {
    fn write(&mut self, held: &HeldFrame) -> Result<(), RecordingError> {
        let writer = match self.cameras.get_mut(&held.camera) {
            Some(writer) => writer,
            None => {
                let geometry = CameraGeometry {
                    width_px: held.frame.width_px,
                    height_px: held.frame.height_px,
                };
                let writer = self.session.camera(&held.camera, geometry)?;
                self.cameras.entry(held.camera.clone()).or_insert(writer)
            }
        };
        writer.write(&RecordedFrame {
            frame: held.frame.clone(),
            exposure_s: Some(held.exposure_s),
            flags: FrameFlags::default(),
        })?;
        self.frames += 1;
        Ok(())
    }

    fn finish(self) -> Result<u64, RecordingError> {
        for (_, writer) in self.cameras {
            writer.finish()?;
        }
        self.session.finish()?;
        Ok(self.frames)
    }
}

impl ClipDisk {
    /// Runs until the recorder ends.
    pub fn run(mut self, jobs: &Receiver<DiskJob>) {
        let mut continuous: Option<Open> = None;
        let mut resting = None::<Instant>;
        loop {
            // Settings are taken when they come: between two pitches there is no job for an hour.
            let job = crossbeam_channel::select_biased! {
                recv(self.configs) -> new => {
                    match new {
                        Ok(new) => self.config.quota_bytes = new.quota_bytes,
                        Err(_) => self.configs = crossbeam_channel::never(),
                    }
                    continue;
                }
                recv(jobs) -> job => match job {
                    Ok(job) => job,
                    Err(_) => break,
                },
            };
            match job {
                DiskJob::Clip(frames) => self.clip(frames),
                DiskJob::Frame(held) => {
                    if resting.is_some_and(|since| since.elapsed() < REST) {
                        self.health.frames_lost.fetch_add(1, Ordering::Relaxed);
                        continue;
                    }
                    resting = None;
                    if let Err(error) = self.continuous(&mut continuous, &held) {
                        self.failed(&error, 1);
                        (continuous, resting) = (None, Some(Instant::now()));
                    }
                }
            }
        }
        if let Some(open) = continuous {
            self.end(open);
        }
    }

    fn clip(&self, frames: Vec<Arc<HeldFrame>>) {
        let count = frames.len() as u64;
        let written = self.open("pitch").and_then(|mut open| {
            // Each frame goes home as soon as it is written.
            for held in frames {
                open.write(&held)?;
            }
            open.finish()
        });
        match written {
            Ok(frames) => {
                self.health.clips.fetch_add(1, Ordering::Relaxed);
                self.health.frames.fetch_add(frames, Ordering::Relaxed);
            }
            Err(error) => self.failed(&error, count),
        }
    }

    fn continuous(&self, open: &mut Option<Open>, held: &HeldFrame) -> Result<(), RecordingError> {
        if open.as_ref().is_some_and(|o| o.since.elapsed() > SESSION_MOST)
            && let Some(old) = open.take()
        {
            self.end(old);
        }
        let session = match open {
            Some(session) => session,
            None => open.insert(self.open("continuous")?),
        };
        session.write(held)?;
        self.health.frames.fetch_add(1, Ordering::Relaxed);
        Ok(())
    }

    fn end(&self, open: Open) {
        match open.finish() {
            Ok(_) => {
                self.health.clips.fetch_add(1, Ordering::Relaxed);
            }
            Err(error) => self.failed(&error, 0),
        }
    }

    fn failed(&self, error: &RecordingError, frames: u64) {
        self.health.clips_lost.fetch_add(1, Ordering::Relaxed);
        self.health.frames_lost.fetch_add(frames, Ordering::Relaxed);
        tracing::error!(%error, "not recorded; pitches go on");
    }

    fn open(&self, kind: &str) -> Result<Open, RecordingError> {
        keep_quota(&self.config.folder, self.config.quota_bytes)?;
        let name = format!("{kind}-{}", SystemClock.unix_nanos() / 1_000_000);
        let options = SessionOptions {
            rig_toml: self.rig_toml.clone(),
            calibration_json: std::fs::read_to_string(&self.calibration).ok(),
            ..SessionOptions::default()
        };
        Ok(Open {
            session: SessionWriter::create(&self.config.folder.join(name), options)?,
            cameras: BTreeMap::new(),
            since: Instant::now(),
            frames: 0,
        })
    }
}

/// Removes the oldest recordings until the folder is below its quota. Only folders that the recorder itself named.
///
/// # Errors
/// What the disk says.
fn keep_quota(folder: &Path, quota_bytes: u64) -> Result<(), RecordingError> {
    let io = |source| RecordingError::io(folder, source);
    if !folder.exists() {
        return Ok(());
    }
    // Oldest first: the number is the time of day in milliseconds.
    let mut sessions: Vec<(u64, PathBuf, u64)> = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(io)? {
        let path = entry.map_err(io)?.path();
        let name = path
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        let made_ms = ["pitch-", "continuous-"]
            .iter()
            .find_map(|kind| name.strip_prefix(kind)?.parse().ok());
        if let Some(made_ms) = made_ms {
            sessions.push((made_ms, path.clone(), size_of(&path)));
        }
    }
    sessions.sort();
    let mut total: u64 = sessions.iter().map(|s| s.2).sum();
    for (_, path, bytes) in sessions {
        if total <= quota_bytes {
            break;
        }
        crate::recording::remove_session(&path)?;
        std::fs::remove_dir(&path).map_err(|e| RecordingError::io(&path, e))?;
        tracing::info!(session = %path.display(), "removed to keep to the quota");
        total = total.saturating_sub(bytes);
    }
    Ok(())
}

fn size_of(folder: &Path) -> u64 {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    entries.filter_map(|e| Some(e.metadata().ok()?.len())).sum()
}
