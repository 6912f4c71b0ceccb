//! Writes a session: one [`CameraWriter`] per camera, each usable from its own thread.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use super::error::RecordingError;
use super::frame_file::{FileEntry, FrameFile, FrameFileHead};
use super::frame_info::RecordedFrame;
use super::layout::{
    FILES_ATTACHMENT, LOSSES_ATTACHMENT, PixelEncoding, SEGMENT_BYTES_MAX, SEGMENT_SPAN_NS, SESSION_FILE,
    camera_file, is_session_file,
};
use super::segment::{Attached, Segment, SegmentFinishing};
use crate::scene::CameraId;

/// What a session is made with.
#[derive(Debug, Clone, Default)]
pub struct SessionOptions {
    /// Text of the rig file, kept in every file of the session.
    pub rig_toml: String,
    /// `calibration.json`, where there is one.
    pub calibration_json: Option<String>,
    /// How pixels are stored.
    pub encoding: PixelEncoding,
    /// How bytes reach the disk.
    pub disk: DiskPath,
}

/// How bytes reach the disk.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum DiskPath {
    /// Past the page cache where the file system allows it: for more data than fits in memory.
    #[default]
    Direct,
    /// Through the page cache.
    Buffered,
}

/// Size of a camera's frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CameraGeometry {
    /// Columns.
    pub width_px: u32,
    /// Rows.
    pub height_px: u32,
}

pub(super) type FileEntries = BTreeMap<String, FileEntry>;

/// A session being written.
pub struct SessionWriter {
    folder: PathBuf,
    options: Arc<SessionOptions>,
    files: Arc<Mutex<FileEntries>>,
    cameras: Vec<CameraId>,
    session: Segment,
}

impl SessionWriter {
    /// Makes the folder (it must be empty or not exist) and begins the session file.
    ///
    /// # Errors
    /// [`RecordingError::NotEmpty`], or what the disk says.
    pub fn create(folder: &Path, options: SessionOptions) -> Result<Self, RecordingError> {
        let io = |e| RecordingError::io(folder, e);
        std::fs::create_dir_all(folder).map_err(io)?;
        if std::fs::read_dir(folder).map_err(io)?.next().is_some() {
            return Err(RecordingError::NotEmpty {
                folder: folder.to_owned(),
            });
        }
        let about = [("content", "session".to_owned())];
        // Small, and it must be on the disk at once: through the page cache.
        let mut session = Segment::create(
            folder.join(SESSION_FILE),
            DiskPath::Buffered,
            &attached(&options),
            &about,
        )?;
        session.flush()?;
        Ok(Self {
            folder: folder.to_owned(),
            options: Arc::new(options),
            files: Arc::default(),
            cameras: Vec::new(),
            session,
        })
    }

    /// Begins a camera's files.
    ///
    /// # Errors
    /// [`RecordingError::CameraTwice`].
    pub fn camera(
        &mut self,
        camera: &CameraId,
        geometry: CameraGeometry,
    ) -> Result<CameraWriter, RecordingError> {
        if self.cameras.contains(camera) {
            return Err(RecordingError::CameraTwice {
                camera: camera.clone(),
            });
        }
        self.cameras.push(camera.clone());
        Ok(CameraWriter {
            folder: self.folder.clone(),
            camera: camera.clone(),
            geometry,
            options: Arc::clone(&self.options),
            files: Arc::clone(&self.files),
            open: None,
            next_segment: 0,
            last: None,
            finishing: Vec::new(),
        })
    }

    /// Ends the session; the cameras must have been finished before.
    ///
    /// # Errors
    /// What the disk says.
    pub fn finish(self) -> Result<(), RecordingError> {
        let files = self.files.lock().unwrap_or_else(PoisonError::into_inner).clone();
        end_session_file(self.session, &files, &[])
    }
}

/// Ends a session file with the list of the cameras' files and what earlier repairs had to give up.
pub(super) fn end_session_file(
    mut session: Segment,
    files: &FileEntries,
    losses: &[String],
) -> Result<(), RecordingError> {
    let json = |list: Result<String, serde_json::Error>| list.expect("names and numbers always serialise");
    if !losses.is_empty() {
        session.attach(
            LOSSES_ATTACHMENT,
            "application/json",
            &json(serde_json::to_string(losses)),
        )?;
    }
    // The list of files comes last: a reader stops at it.
    session.attach(
        FILES_ATTACHMENT,
        "application/json",
        &json(serde_json::to_string(files)),
    )?;
    session.finish()?.wait()
}

/// Empties a folder of its session, so that a new one can be made there.
///
/// # Errors
/// [`RecordingError::NotASession`] when there is anything else in it: then nothing is removed.
pub fn remove_session(folder: &Path) -> Result<(), RecordingError> {
    let io = |e| RecordingError::io(folder, e);
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(io)? {
        let entry = entry.map_err(io)?;
        let name = entry.file_name();
        if !name.to_str().is_some_and(is_session_file) {
            return Err(RecordingError::NotASession {
                folder: folder.to_owned(),
                reason: format!("holds {}, which is no part of a session", name.display()),
            });
        }
        files.push(entry.path());
    }
    for file in files {
        std::fs::remove_file(&file).map_err(|e| RecordingError::io(&file, e))?;
    }
    Ok(())
}

fn attached(options: &SessionOptions) -> Attached {
    Attached {
        rig_toml: options.rig_toml.clone(),
        calibration_json: options.calibration_json.clone(),
    }
}

/// Writes the frames of one camera.
pub struct CameraWriter {
    folder: PathBuf,
    camera: CameraId,
    geometry: CameraGeometry,
    options: Arc<SessionOptions>,
    files: Arc<Mutex<FileEntries>>,
    open: Option<FrameFile>,
    next_segment: u32,
    last: Option<(u64, i64)>,
    finishing: Vec<(SegmentFinishing, String, FileEntry)>,
}

impl CameraWriter {
    /// Appends a frame. Numbers and stamps must rise.
    ///
    /// # Errors
    /// A frame of the wrong size or out of order is refused and the writer goes on; after a disk error
    /// ([`RecordingError::DiskFull`], [`RecordingError::Io`]) it can only be dropped, and what was written
    /// stays readable.
    pub fn write(&mut self, recorded: &RecordedFrame) -> Result<(), RecordingError> {
        self.check(recorded)?;
        let stamp = recorded.frame.stamp;
        let stamped_ns = stamp.stamped.nanos();
        let full = self.open.as_ref().is_some_and(|open| {
            let span_ns = open
                .begin_ns()
                .map_or(0, |begin_ns| stamped_ns.saturating_sub(begin_ns));
            span_ns >= SEGMENT_SPAN_NS || open.bytes() >= SEGMENT_BYTES_MAX
        });
        if full {
            self.close_file()?;
        }
        let mut open = match self.open.take() {
            Some(open) => open,
            None => self.open_file()?,
        };
        // A file whose writing failed is dropped here: it stays as it is, `.part`.
        open.write(recorded)?;
        self.last = Some((stamp.frame, stamped_ns));
        self.open = Some(open);
        Ok(())
    }

    fn check(&self, recorded: &RecordedFrame) -> Result<(), RecordingError> {
        let frame = &recorded.frame;
        let size_px = (self.geometry.width_px, self.geometry.height_px);
        let got_px = (frame.width_px, frame.height_px);
        if got_px != size_px {
            return Err(RecordingError::FrameSize {
                camera: self.camera.clone(),
                frame: frame.stamp.frame,
                got_px,
                expected_px: size_px,
            });
        }
        let bytes = frame.bytes().len();
        let bytes_needed = size_px.0 as usize * size_px.1 as usize;
        if bytes != bytes_needed {
            return Err(RecordingError::FrameBytes {
                camera: self.camera.clone(),
                frame: frame.stamp.frame,
                size_px,
                bytes,
                bytes_needed,
            });
        }
        let (frame, stamped_ns) = (frame.stamp.frame, frame.stamp.stamped.nanos());
        match self.last {
            Some((previous_frame, previous_ns)) if frame <= previous_frame || stamped_ns <= previous_ns => {
                Err(RecordingError::NotRising {
                    camera: self.camera.clone(),
                    frame,
                    stamped_ns,
                    previous_frame,
                    previous_ns,
                })
            }
            _ => Ok(()),
        }
    }

    fn open_file(&mut self) -> Result<FrameFile, RecordingError> {
        let head = FrameFileHead {
            camera: self.camera.clone(),
            segment: self.next_segment,
            geometry: self.geometry,
            encoding: self.options.encoding,
            disk: self.options.disk,
            attached: attached(&self.options),
        };
        let file = camera_file(&self.folder, &self.camera, self.next_segment);
        self.next_segment += 1;
        FrameFile::create(file, &head)
    }

    fn close_file(&mut self) -> Result<(), RecordingError> {
        if let Some(open) = self.open.take() {
            let name = open.file().file_name().unwrap_or_default();
            let name = name.to_string_lossy().into_owned();
            if let (finishing, Some(entry)) = open.finish()? {
                self.finishing.push((finishing, name, entry));
            }
        }
        // Files that are long done are only asked how it went.
        while self.finishing.len() > 2 {
            self.settle_first()?;
        }
        Ok(())
    }

    fn settle_first(&mut self) -> Result<(), RecordingError> {
        let (finishing, name, entry) = self.finishing.remove(0);
        finishing.wait()?;
        self.files
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .insert(name, entry);
        Ok(())
    }

    /// Ends the camera's last file and waits until all are on the disk.
    ///
    /// # Errors
    /// What the disk says.
    pub fn finish(mut self) -> Result<(), RecordingError> {
        self.close_file()?;
        while !self.finishing.is_empty() {
            self.settle_first()?;
        }
        Ok(())
    }
}
