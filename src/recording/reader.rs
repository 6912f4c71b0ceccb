//! Opens a session folder and gives each camera's frames in the order of their stamps.

use std::collections::{BTreeMap, VecDeque};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use super::damage::{Damage, LostFrames};
use super::error::RecordingError;
use super::frame_file::FileEntry;
use super::frame_info::{FrameFlags, RecordedFrame};
use super::layout::{
    CALIBRATION_ATTACHMENT, FORMAT_VERSION, INFO_CHANNEL, RIG_ATTACHMENT, SESSION_FILE, parse_camera_file,
    part_of,
};
use super::scan::Scanner;
use super::session_file::{self, SessionRecord};
use super::summary::{Preamble, read_preamble};
use super::writer::CameraGeometry;
use crate::scene::CameraId;
use crate::time::StampedMidpoint;

type DamageList = Arc<Mutex<BTreeMap<PathBuf, Damage>>>;

/// A camera in a session.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraRecording {
    /// Name.
    pub id: CameraId,
    /// Size of its frames; `None` when no file says it any more.
    pub geometry: Option<CameraGeometry>,
    /// Its files in order.
    pub files: Vec<PathBuf>,
    /// Frames, by the files' own summaries; `None` when a file has none.
    pub frames: Option<u64>,
    /// First and last stamp, as `frames`.
    pub span: Option<(StampedMidpoint, StampedMidpoint)>,
}

#[derive(Debug, Clone)]
struct SegmentFile {
    path: PathBuf,
    finished: bool,
    /// By the session file.
    expected: Option<FileEntry>,
}

#[derive(Debug)]
struct Camera {
    recording: CameraRecording,
    segments: Vec<SegmentFile>,
}

/// An open session. Damage does not stop it from opening: see [`SessionReader::damage`].
#[derive(Debug)]
pub struct SessionReader {
    folder: PathBuf,
    cameras: Vec<Camera>,
    rig_toml: Option<String>,
    calibration_json: Option<String>,
    losses: Vec<String>,
    damage: DamageList,
}

impl SessionReader {
    /// Opens a folder. Only the beginning and end of each file are read.
    ///
    /// # Errors
    /// [`RecordingError::NotASession`] when there is no recording in it, [`RecordingError::Version`] when it is
    /// from a newer program, [`RecordingError::Io`] when the folder cannot be listed.
    pub fn open(folder: &Path) -> Result<Self, RecordingError> {
        let names = list(folder)?;
        let mut reader = Self {
            folder: folder.to_owned(),
            cameras: Vec::new(),
            rig_toml: None,
            calibration_json: None,
            losses: Vec::new(),
            damage: DamageList::default(),
        };
        let session = reader.open_session_file(&names)?;
        let mut by_camera: BTreeMap<CameraId, BTreeMap<u32, SegmentFile>> = BTreeMap::new();
        for name in &names {
            let Some(parsed) = parse_camera_file(name) else {
                continue;
            };
            let segment = SegmentFile {
                path: folder.join(name),
                finished: parsed.finished,
                expected: session.files.get(name).cloned(),
            };
            let segments = by_camera.entry(parsed.camera).or_default();
            // A finished file beside its own `.part` (a repair that was interrupted) is the better one.
            let known = segments.get(&parsed.segment).is_some_and(|known| known.finished);
            if !known {
                segments.insert(parsed.segment, segment);
            }
        }
        reader.tell_missing_files(&session, &by_camera);
        reader.losses = session.losses;
        for (id, segments) in by_camera {
            reader.add_camera(id, segments)?;
        }
        if reader.cameras.is_empty() && reader.damage().is_empty() {
            return Err(RecordingError::NotASession {
                folder: folder.to_owned(),
                reason: "holds no recorded camera".to_owned(),
            });
        }
        Ok(reader)
    }

    fn open_session_file(&mut self, names: &[String]) -> Result<SessionRecord, RecordingError> {
        let path = self.folder.join(SESSION_FILE);
        let part = part_of(&path);
        let found = [(path, true), (part, false)].into_iter().find(|(path, _)| {
            names
                .iter()
                .any(|n| path.file_name().is_some_and(|f| f == n.as_str()))
        });
        let Some((path, finished)) = found else {
            let missing = self.folder.join(SESSION_FILE);
            self.tell_session(missing, "is missing; the cameras' own files are read".to_owned());
            return Ok(SessionRecord::default());
        };
        match session_file::read(&path, finished) {
            Ok(mut record) => {
                self.take_preamble(&path, std::mem::take(&mut record.preamble))?;
                if let Some(reason) = record.damage.take() {
                    self.tell_session(path, reason);
                }
                Ok(record)
            }
            Err(error) => {
                self.tell_session(path, format!("cannot be read: {error}"));
                Ok(SessionRecord::default())
            }
        }
    }

    fn tell_session(&self, file: PathBuf, reason: String) {
        let damage = Damage {
            file: file.clone(),
            camera: None,
            frames_read: 0,
            frames_lost: LostFrames::Exactly(0),
            bytes_lost: 0,
            reason,
        };
        self.damage_map().insert(file, damage);
    }

    fn damage_map(&self) -> std::sync::MutexGuard<'_, BTreeMap<PathBuf, Damage>> {
        self.damage.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn tell_missing_files(
        &self,
        session: &SessionRecord,
        found: &BTreeMap<CameraId, BTreeMap<u32, SegmentFile>>,
    ) {
        for (name, entry) in &session.files {
            let Some(parsed) = parse_camera_file(name) else {
                continue;
            };
            let there = found
                .get(&parsed.camera)
                .is_some_and(|segments| segments.contains_key(&parsed.segment));
            if !there {
                let file = self.folder.join(name);
                let damage = Damage {
                    file: file.clone(),
                    camera: Some(parsed.camera),
                    frames_read: 0,
                    frames_lost: LostFrames::Exactly(entry.frames),
                    bytes_lost: 0,
                    reason: "is missing".to_owned(),
                };
                self.damage_map().insert(file, damage);
            }
        }
    }

    fn take_preamble(
        &mut self,
        file: &Path,
        preamble: Preamble,
    ) -> Result<Option<CameraGeometry>, RecordingError> {
        let number = |key: &str| preamble.about.get(key).and_then(|text| text.parse::<u32>().ok());
        if let Some(found) = number("format_version").filter(|found| *found > FORMAT_VERSION) {
            return Err(RecordingError::Version {
                file: file.to_owned(),
                found,
                known: FORMAT_VERSION,
            });
        }
        let geometry = number("width_px")
            .zip(number("height_px"))
            .map(|(width_px, height_px)| CameraGeometry { width_px, height_px });
        let text = |name: &str| {
            let bytes = preamble.attachments.get(name)?;
            String::from_utf8(bytes.clone()).ok()
        };
        self.rig_toml = self.rig_toml.take().or_else(|| text(RIG_ATTACHMENT));
        self.calibration_json = self
            .calibration_json
            .take()
            .or_else(|| text(CALIBRATION_ATTACHMENT));
        Ok(geometry)
    }

    fn add_camera(
        &mut self,
        id: CameraId,
        segments: BTreeMap<u32, SegmentFile>,
    ) -> Result<(), RecordingError> {
        let segments: Vec<SegmentFile> = segments.into_values().collect();
        let mut recording = CameraRecording {
            id: id.clone(),
            geometry: None,
            files: segments.iter().map(|s| s.path.clone()).collect(),
            frames: Some(0),
            span: None,
        };
        for segment in &segments {
            // A file that cannot be opened is told when its frames are asked for.
            let preamble = read_preamble(&segment.path).unwrap_or_default();
            recording.geometry = self
                .take_preamble(&segment.path, preamble)?
                .or(recording.geometry);
            let Ok(scanner) = Scanner::open(&segment.path, &id, segment.finished) else {
                recording.frames = None;
                continue;
            };
            let summary = scanner.summary();
            let frames = summary.and_then(|s| s.frames(INFO_CHANNEL));
            recording.frames = recording.frames.zip(frames).map(|(sum, count)| sum + count);
            if let (Some(summary), Some(1..)) = (summary, frames) {
                let (begin, end) = summary.log_span_ns;
                let stamp = |ns: u64| StampedMidpoint::from_nanos(i64::try_from(ns).unwrap_or(i64::MAX));
                let (begin, end) = (stamp(begin), stamp(end));
                recording.span = Some(match recording.span {
                    Some((first, last)) => (first.min(begin), last.max(end)),
                    None => (begin, end),
                });
            }
            let expected = segment.expected.as_ref().map(|e| e.frames);
            if let Some(damage) = scanner.damage(expected) {
                self.damage_map().insert(segment.path.clone(), damage);
            }
        }
        if recording.geometry.is_none() {
            recording.geometry = CameraFrames::new(&id, &segments, DamageList::default())
                .next()
                .map(|first| CameraGeometry {
                    width_px: first.frame.width_px,
                    height_px: first.frame.height_px,
                });
        }
        self.cameras.push(Camera { recording, segments });
        Ok(())
    }

    /// The folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The cameras by name.
    pub fn cameras(&self) -> impl Iterator<Item = &CameraRecording> {
        self.cameras.iter().map(|camera| &camera.recording)
    }

    /// Text of the rig file the session was made with.
    pub fn rig_toml(&self) -> Option<&str> {
        self.rig_toml.as_deref()
    }

    /// `calibration.json` the session was made with.
    pub fn calibration_json(&self) -> Option<&str> {
        self.calibration_json.as_deref()
    }

    /// What earlier repairs ([`super::repair_session`]) had to give up, in words.
    pub fn losses(&self) -> &[String] {
        &self.losses
    }

    /// Frames that the session file says are in a camera's file.
    pub(super) fn frames_expected(&self, file: &Path) -> Option<u64> {
        let segments = self.cameras.iter().flat_map(|c| &c.segments);
        let segment = segments.into_iter().find(|s| s.path == file)?;
        Some(segment.expected.as_ref()?.frames)
    }

    /// A camera's frames by rising stamps, read as they are asked for. `None`: no such camera.
    pub fn frames(&self, camera: &CameraId) -> Option<CameraFrames> {
        let found = self.cameras.iter().find(|c| c.recording.id == *camera)?;
        Some(CameraFrames::new(
            camera,
            &found.segments,
            Arc::clone(&self.damage),
        ))
    }

    /// What is lost, as far as it is known: what the ends of the files tell at once, everything once all
    /// cameras' frames have been read to their end.
    pub fn damage(&self) -> Vec<Damage> {
        self.damage_map().values().cloned().collect()
    }

    /// Reads every frame of every camera, so that [`SessionReader::damage`] is complete.
    pub fn verify(&self) -> Verified {
        let mut verified = Verified::default();
        for camera in &self.cameras {
            let id = &camera.recording.id;
            let mut last = None;
            for read in CameraFrames::new(id, &camera.segments, Arc::clone(&self.damage)) {
                verified.frames += 1;
                let number = read.frame.stamp.frame;
                if read.flags.contains(FrameFlags::AFTER_LOSS) {
                    let holes = verified.holes.entry(id.clone()).or_default();
                    holes.places += 1;
                    holes.frames += last.map_or(0, |last| number.saturating_sub(last).saturating_sub(1));
                }
                last = Some(number);
            }
        }
        verified
    }
}

/// What a session holds, every frame read.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Verified {
    /// Frames that are whole.
    pub frames: u64,
    /// Per camera what the recorder has marked as missing.
    pub holes: BTreeMap<CameraId, Holes>,
}

/// Frames that were never recorded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
pub struct Holes {
    /// Gaps.
    pub places: u64,
    /// Frames missing in them, by their numbers.
    pub frames: u64,
}

fn list(folder: &Path) -> Result<Vec<String>, RecordingError> {
    let not = |reason: &str| RecordingError::NotASession {
        folder: folder.to_owned(),
        reason: reason.to_owned(),
    };
    let entries = std::fs::read_dir(folder).map_err(|error| match error.kind() {
        std::io::ErrorKind::NotFound => not("there is no such folder"),
        std::io::ErrorKind::NotADirectory => not("is a file; a session is a folder"),
        _ => RecordingError::io(folder, error),
    })?;
    let mut names = Vec::new();
    for entry in entries {
        let entry = entry.map_err(|e| RecordingError::io(folder, e))?;
        if let Ok(name) = entry.file_name().into_string() {
            names.push(name);
        }
    }
    names.sort();
    let recorded = |name: &String| {
        let name = name.strip_suffix(super::layout::PART_SUFFIX).unwrap_or(name);
        name.ends_with(".mcap")
    };
    match (names.is_empty(), names.iter().any(recorded)) {
        (true, _) => Err(not("is empty, not a session")),
        (false, false) => Err(not("is not a session: it holds no *.mcap file")),
        (false, true) => Ok(names),
    }
}

/// A camera's frames by rising stamps. One file is open and one frame in memory at a time.
pub struct CameraFrames {
    camera: CameraId,
    waiting: VecDeque<SegmentFile>,
    open: Option<(Scanner, SegmentFile)>,
    last: Option<(u64, StampedMidpoint)>,
    damage: DamageList,
}

impl CameraFrames {
    fn new(camera: &CameraId, segments: &[SegmentFile], damage: DamageList) -> Self {
        Self {
            camera: camera.clone(),
            waiting: VecDeque::from(segments.to_vec()),
            open: None,
            last: None,
            damage,
        }
    }

    /// Opens the next file that can be opened.
    fn open_next(&mut self) -> Option<()> {
        loop {
            let segment = self.waiting.pop_front()?;
            match Scanner::open(&segment.path, &self.camera, segment.finished) {
                Ok(scanner) => {
                    self.open = Some((scanner, segment));
                    return Some(());
                }
                Err(error) => {
                    let expected = segment.expected.as_ref().map(|e| e.frames);
                    self.tell(Damage {
                        file: segment.path,
                        camera: Some(self.camera.clone()),
                        frames_read: 0,
                        frames_lost: expected.map_or(LostFrames::AtLeast(0), LostFrames::Exactly),
                        bytes_lost: 0,
                        reason: format!("cannot be opened: {error}"),
                    });
                }
            }
        }
    }

    fn tell(&self, damage: Damage) {
        let mut map = self.damage.lock().unwrap_or_else(PoisonError::into_inner);
        map.insert(damage.file.clone(), damage);
    }
}

impl Iterator for CameraFrames {
    type Item = RecordedFrame;

    fn next(&mut self) -> Option<RecordedFrame> {
        loop {
            if self.open.is_none() {
                self.open_next()?;
            }
            let (scanner, segment) = self.open.as_mut()?;
            if let Some(recorded) = scanner.next_frame() {
                let now = (recorded.frame.stamp.frame, recorded.frame.stamp.stamped);
                match self.last {
                    Some((frame, stamped)) if now.0 <= frame || now.1 <= stamped => {
                        scanner.reject(format!("frame {} goes back in time", now.0));
                    }
                    _ => {
                        self.last = Some(now);
                        return Some(recorded);
                    }
                }
            } else {
                let damage = scanner.damage(segment.expected.as_ref().map(|e| e.frames));
                self.open = None;
                if let Some(damage) = damage {
                    self.tell(damage);
                }
            }
        }
    }
}
