//! A video file as a source.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::image_folder::imported;
use super::own_times::OwnTimes;
use super::stamps::{FrameStamps, LIST_NAME, Stamping};
use super::{CaptureError, FrameGeometry, FrameSource};
use crate::scene::{CameraId, Frame};
use crate::vision::image_files::{VideoReader, is_image_name};

/// A header may be off by this share of its frames: many containers know the length in seconds only.
const HEADER_OFF_SHARE: f64 = 0.02;

/// Frames of one video file, counted from 0. Its stamps: `<name>.timestamps.csv` beside it, else
/// `timestamps.csv` beside it (row by row, whatever number its first frame has), else the given rate. The rate
/// in the file itself is not believed: containers round it and phones vary it.
pub struct VideoFile {
    camera: CameraId,
    file: PathBuf,
    geometry: FrameGeometry,
    reader: VideoReader,
    stamps: FrameStamps,
    listed: Vec<u64>,
    next: u64,
    own_times: OwnTimes,
    ended: bool,
    broken: bool,
}

impl VideoFile {
    /// Opens the file and checks its size.
    ///
    /// # Errors
    /// [`CaptureError::Image`], [`CaptureError::FrameSize`], [`CaptureError::Timestamps`].
    pub fn open(
        camera: &CameraId,
        file: &Path,
        geometry: FrameGeometry,
        stamping: Stamping,
    ) -> Result<Self, CaptureError> {
        let wrong = |reason: &str| CaptureError::NoFrames {
            camera: camera.clone(),
            path: file.to_owned(),
            reason: reason.to_owned(),
        };
        if !file.exists() {
            return Err(wrong("there is no such folder or file"));
        }
        if is_image_name(file) {
            return Err(wrong("is one image; give the folder it is in"));
        }
        let lists = [
            file.with_extension("timestamps.csv"),
            file.with_file_name(LIST_NAME),
        ];
        let stamps = FrameStamps::find(camera, &lists, stamping)?;
        let reader = VideoReader::open(file).map_err(|source| CaptureError::Image {
            camera: camera.clone(),
            source,
        })?;
        let (width_px, height_px) = reader.size_px();
        let got = FrameGeometry { width_px, height_px };
        if got != geometry {
            return Err(CaptureError::FrameSize {
                camera: camera.clone(),
                file: file.to_owned(),
                got,
                expected: geometry,
            });
        }
        let listed = match &stamps {
            FrameStamps::Listed { by_frame, .. } => by_frame.keys().copied().collect(),
            FrameStamps::RateHz(_) => Vec::new(),
        };
        Ok(Self {
            camera: camera.clone(),
            file: file.to_owned(),
            geometry,
            reader,
            stamps,
            listed,
            next: 0,
            own_times: OwnTimes::default(),
            ended: false,
            broken: false,
        })
    }

    /// The frames that the header tells of, where the file ended clearly before.
    fn frames_missing(&self) -> Option<u64> {
        let told = self.reader.frames_expected()?;
        let missing = told.saturating_sub(self.reader.frames_read());
        (self.ended && missing as f64 > 1.0 + HEADER_OFF_SHARE * told as f64).then_some(told)
    }

    fn stamp(&self, index: u64) -> Result<crate::scene::FrameStamp, CaptureError> {
        let frame = match &self.stamps {
            FrameStamps::RateHz(_) => Some(index),
            FrameStamps::Listed { .. } => usize::try_from(index)
                .ok()
                .and_then(|i| self.listed.get(i).copied()),
        };
        frame
            .and_then(|frame| Some(imported(frame, self.stamps.of(frame)?)))
            .ok_or_else(|| CaptureError::NoTimestamp {
                camera: self.camera.clone(),
                frame: index,
                file: self.file.clone(),
                list: match &self.stamps {
                    FrameStamps::Listed { list, .. } => list.clone(),
                    FrameStamps::RateHz(_) => PathBuf::from("--fps"),
                },
            })
    }
}

impl Iterator for VideoFile {
    type Item = Result<Frame, CaptureError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.broken {
            return None;
        }
        let image = match self.reader.next_mono8() {
            Ok(Some(image)) => image,
            Ok(None) => {
                self.ended = true;
                return None;
            }
            Err(source) => {
                self.broken = true;
                return Some(Err(CaptureError::Image {
                    camera: self.camera.clone(),
                    source,
                }));
            }
        };
        if let Some(time_s) = self.reader.own_time_s() {
            self.own_times.push(time_s);
        }
        let index = self.next;
        self.next += 1;
        Some(self.stamp(index).map(|stamp| Frame {
            stamp,
            width_px: image.width_px,
            height_px: image.height_px,
            pixels: Arc::new(image.pixels),
        }))
    }
}

impl FrameSource for VideoFile {
    fn camera(&self) -> &CameraId {
        &self.camera
    }
    fn geometry(&self) -> FrameGeometry {
        self.geometry
    }
    fn frames_expected(&self) -> Option<u64> {
        self.reader.frames_expected()
    }
    fn is_cut_off(&self) -> bool {
        self.frames_missing().is_some()
    }
    fn remarks(&self) -> Vec<String> {
        let place = format!("camera {}: {}", self.camera, self.file.display());
        let cut_off = self.frames_missing().map(|told| {
            format!(
                "{place}: its header tells of {told} frames, {} could be read: it is damaged, cut off or has gaps",
                self.reader.frames_read()
            )
        });
        let by_rate = matches!(self.stamps, FrameStamps::RateHz(_));
        let uneven = self.own_times.uneven().filter(|_| by_rate).map(|late| {
            format!(
                "{place}: by its own times {} of {} frames come late, frame {} first ({:.0} ms after the one before, {:.0} ms \
                 are usual); --fps takes them for even, {} would be believed",
                late.count,
                self.reader.frames_read(),
                late.first,
                1e3 * late.step_s,
                1e3 * late.usual_s,
                self.file.with_extension("timestamps.csv").display()
            )
        });
        cut_off.into_iter().chain(uneven).collect()
    }
}
