//! The recorder's disk thread: clips to session folders, old ones removed to keep to the quota. It alone waits for the
//! disk, and a disk that is slow, full, read-only or gone costs recordings, which are counted.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crossbeam_channel::Receiver;

use super::recorder::{HeldFrame, RecorderHealth};
use crate::config::RecordConfig;
use crate::detection::UnpackedFrames;
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

/// A continuous recording begins a new session this often, and whenever the last has an eighth of the quota, so that the
/// oldest can be removed.
const SESSION_MOST: Duration = Duration::from_secs(600);
const QUOTA_PARTS: u64 = 8;
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
    /// A session of a continuous recording is not ended for the quota's sake before it has this many bytes.
    pub session_bytes_least: u64,
}

/// A continuous recording.
#[derive(Default)]
struct Continuous {
    open: Option<Open>,
    /// Since the last failure.
    resting: Option<Instant>,
    /// Sessions on their way to the disk.
    endings: Vec<JoinHandle<()>>,
}

/// A session being written.
pub(super) struct Open {
    session: SessionWriter,
    /// Each with the number of the frame last written.
    cameras: BTreeMap<CameraId, (CameraWriter, u64)>,
    /// Memory for what is unpacked on its way.
    unpacked: UnpackedFrames,
    since: Instant,
    frames: u64,
    /// Written so far.
    pub(super) bytes: u64,
}

impl Open {
    pub(super) fn write(&mut self, held: &HeldFrame) -> Result<(), RecordingError> {
        let number = held.frame.stamp.frame;
        let (writer, last) = match self.cameras.get_mut(&held.camera) {
            Some(open) => open,
            None => {
                let geometry = CameraGeometry {
                    width_px: held.frame.width_px,
                    height_px: held.frame.height_px,
                };
                let writer = self.session.camera(&held.camera, geometry)?;
                let before = number.saturating_sub(1);
                self.cameras
                    .entry(held.camera.clone())
                    .or_insert((writer, before))
            }
        };
        // Whoever lost it, the camera, the link or this recorder: here is a hole.
        let flags = match number.saturating_sub(*last) > 1 {
            true => FrameFlags::AFTER_LOSS,
            false => FrameFlags::default(),
        };
        *last = number;
        let raw = &held.frame;
        // What the detector sees: a replay then does what was done live, and a pixel is one byte.
        let Some(frame) = self.unpacked.image(raw) else {
            return Err(RecordingError::FrameBytes {
                camera: held.camera.clone(),
                frame: number,
                size_px: (raw.width_px, raw.height_px),
                bytes: raw.bytes().len(),
                bytes_needed: raw.format.bytes(raw.width_px as usize * raw.height_px as usize),
            });
        };
        let bytes = frame.bytes().len() as u64;
        writer.write(&RecordedFrame {
            frame,
            exposure_s: Some(held.exposure_s),
            flags,
        })?;
        (self.frames, self.bytes) = (self.frames + 1, self.bytes + bytes);
        Ok(())
    }

    fn finish(self) -> Result<u64, RecordingError> {
        for (writer, _) in self.cameras.into_values() {
            writer.finish()?;
        }
        self.session.finish()?;
        Ok(self.frames)
    }
}

impl ClipDisk {
    /// Runs until the recorder ends.
    pub fn run(mut self, jobs: &Receiver<DiskJob>) {
        let mut continuous = Continuous::default();
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
                    if continuous.resting.is_some_and(|since| since.elapsed() < REST) {
                        self.health.frames_lost.fetch_add(1, Ordering::Relaxed);
                        continue;
                    }
                    continuous.resting = None;
                    if let Err(error) = self.continuous(&mut continuous, &held) {
                        self.failed(&error, 1);
                        (continuous.open, continuous.resting) = (None, Some(Instant::now()));
                    }
                }
            }
        }
        if let Some(open) = continuous.open {
            end(open, &self.health);
        }
        for ending in continuous.endings {
            // A thread that panicked has said so.
            let _ = ending.join();
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

    fn continuous(&self, continuous: &mut Continuous, held: &HeldFrame) -> Result<(), RecordingError> {
        let most = (self.config.quota_bytes / QUOTA_PARTS).max(self.session_bytes_least);
        let full = |o: &Open| o.since.elapsed() > SESSION_MOST || o.bytes >= most;
        if continuous.open.as_ref().is_some_and(full)
            && let Some(old) = continuous.open.take()
        {
            continuous.endings.retain(|ending| !ending.is_finished());
            continuous.endings.extend(self.end_beside(old));
        }
        let session = match &mut continuous.open {
            Some(session) => session,
            none => none.insert(self.open("continuous")?),
        };
        session.write(held)?;
        self.health.frames.fetch_add(1, Ordering::Relaxed);
        Ok(())
    }

    /// Ends a session on a thread of its own: it waits for the disk, and the next one's frames do not.
    fn end_beside(&self, open: Open) -> Option<JoinHandle<()>> {
        let health = self.health.clone();
        let thread = std::thread::Builder::new().name("disk-end".to_owned());
        let ending = thread.spawn(move || end(open, &health));
        if let Err(error) = &ending {
            tracing::error!(%error, "no thread to end a recording: it stays as after a kill (pitchd recover)");
            self.health.clips_lost.fetch_add(1, Ordering::Relaxed);
        }
        ending.ok()
    }

    fn failed(&self, error: &RecordingError, frames: u64) {
        failed(&self.health, error, frames);
    }

    pub(super) fn open(&self, kind: &str) -> Result<Open, RecordingError> {
        // Room for the session that begins is kept free.
        let quota = self.config.quota_bytes;
        keep_quota(&self.config.folder, quota - quota / QUOTA_PARTS)?;
        let name = format!("{kind}-{}", SystemClock.unix_nanos() / 1_000_000);
        let options = SessionOptions {
            rig_toml: self.rig_toml.clone(),
            calibration_json: std::fs::read_to_string(&self.calibration).ok(),
            ..SessionOptions::default()
        };
        Ok(Open {
            session: SessionWriter::create(&self.config.folder.join(name), options)?,
            cameras: BTreeMap::new(),
            unpacked: UnpackedFrames::default(),
            since: Instant::now(),
            frames: 0,
            bytes: 0,
        })
    }
}

fn end(open: Open, health: &RecorderHealth) {
    match open.finish() {
        Ok(_) => {
            health.clips.fetch_add(1, Ordering::Relaxed);
        }
        Err(error) => failed(health, &error, 0),
    }
}

fn failed(health: &RecorderHealth, error: &RecordingError, frames: u64) {
    health.clips_lost.fetch_add(1, Ordering::Relaxed);
    health.frames_lost.fetch_add(frames, Ordering::Relaxed);
    tracing::error!(%error, "not recorded; pitches go on");
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
