//! A folder of images as a source.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::stamps::{FrameStamps, LIST_NAME, Stamping};
use super::{CaptureError, FrameGeometry, FrameSource};
use crate::scene::{CameraId, Frame, FrameStamp};
use crate::vision::image_files::{self, Mono8};

/// Images of one camera, one file a frame.
///
/// A frame's number is the number in its file name: the last run of digits of the name without its ending,
/// or the first run when the last is the same in every name (`0001_cam2.png`). When the names hold no
/// number, frames are counted in the order of the names, and the rows of the list in the order of its
/// frame numbers.
#[derive(Debug)]
pub struct ImageFolder {
    camera: CameraId,
    geometry: FrameGeometry,
    level_bits: Option<u32>,
    frames: std::vec::IntoIter<(FrameStamp, PathBuf)>,
    count: u64,
    warnings: Vec<String>,
}

impl ImageFolder {
    /// Lists the folder and checks numbers and stamps of all frames and the size of the first. `level_bits`: of images of
    /// 16 bits that do not say it themselves, how many count ([`image_files::read_mono8`]).
    ///
    /// # Errors
    /// Every variant of [`CaptureError`] but [`CaptureError::NoSuchCamera`]; the message names the file.
    pub fn open(
        camera: &CameraId,
        folder: &Path,
        geometry: FrameGeometry,
        stamping: Stamping,
        level_bits: Option<u32>,
    ) -> Result<Self, CaptureError> {
        let files = list_images(camera, folder)?;
        let stamps = FrameStamps::find(camera, &[folder.join(LIST_NAME)], stamping)?;
        let mut warnings = Vec::new();
        let by_number = number_files(camera, &files)?;
        let frames = match (&by_number, &stamps) {
            (Some(by_number), stamps) => stamp_by_number(camera, by_number, stamps)?,
            (None, FrameStamps::Listed { list, by_frame }) => {
                warnings.push(format!(
                    "camera {camera}: the image names hold no frame numbers; images by name go with the rows of {}",
                    list.display()
                ));
                stamp_by_order(camera, &files, (list, by_frame))?
            }
            (None, FrameStamps::RateHz(_)) => {
                let counted = (0..).zip(files.iter().cloned()).collect();
                stamp_by_number(camera, &counted, &stamps)?
            }
        };
        if let FrameStamps::Listed { list, by_frame } = &stamps
            && by_frame.len() > frames.len()
        {
            let missing = by_frame.len() - frames.len();
            warnings.push(format!(
                "camera {camera}: {missing} frames of {} have no image",
                list.display()
            ));
        }
        let mut source = Self {
            camera: camera.clone(),
            geometry,
            level_bits,
            count: frames.len() as u64,
            frames: frames.into_iter(),
            warnings,
        };
        if let Some((_, file)) = source.frames.as_slice().first()
            && let (Some(own), Some(given)) = (source.image(file)?.own_bits, level_bits)
            && own != given
        {
            source.warnings.push(format!(
                "camera {camera}: --bits {given} does not count for {}, whose own maximum has {own} bits",
                file.display()
            ));
        }
        Ok(source)
    }

    /// What a person should know, though it is no error.
    pub fn warnings(&self) -> &[String] {
        &self.warnings
    }

    fn image(&self, file: &Path) -> Result<Mono8, CaptureError> {
        let image = image_files::read_mono8(file, self.level_bits).map_err(|source| CaptureError::Image {
            camera: self.camera.clone(),
            source,
        })?;
        let got = FrameGeometry {
            width_px: image.width_px,
            height_px: image.height_px,
        };
        if got != self.geometry {
            return Err(CaptureError::FrameSize {
                camera: self.camera.clone(),
                file: file.to_owned(),
                got,
                expected: self.geometry,
            });
        }
        Ok(image)
    }

    fn read(&self, stamp: FrameStamp, file: &Path) -> Result<Frame, CaptureError> {
        let image = self.image(file)?;
        Ok(Frame {
            stamp,
            width_px: image.width_px,
            height_px: image.height_px,
            pixels: Arc::new(image.pixels),
        })
    }
}

impl Iterator for ImageFolder {
    type Item = Result<Frame, CaptureError>;

    fn next(&mut self) -> Option<Self::Item> {
        let (stamp, file) = self.frames.next()?;
        Some(self.read(stamp, &file))
    }
}

impl FrameSource for ImageFolder {
    fn camera(&self) -> &CameraId {
        &self.camera
    }
    fn geometry(&self) -> FrameGeometry {
        self.geometry
    }
    fn frames_expected(&self) -> Option<u64> {
        Some(self.count)
    }
}

/// The folder's images by name.
fn list_images(camera: &CameraId, folder: &Path) -> Result<Vec<PathBuf>, CaptureError> {
    let none = |reason: String| CaptureError::NoFrames {
        camera: camera.clone(),
        path: folder.to_owned(),
        reason,
    };
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(|e| none(e.to_string()))? {
        let path = entry.map_err(|e| none(e.to_string()))?.path();
        if image_files::is_image_name(&path) {
            files.push(path);
        }
    }
    if files.is_empty() {
        return Err(none(format!(
            "holds no images ({})",
            image_files::IMAGE_ENDINGS.join(", ")
        )));
    }
    files.sort();
    Ok(files)
}

/// Files by the number in their names; `None` when the names hold no number.
fn number_files(
    camera: &CameraId,
    files: &[PathBuf],
) -> Result<Option<BTreeMap<u64, PathBuf>>, CaptureError> {
    let runs: Vec<Vec<u64>> = files.iter().map(|file| digit_runs(file)).collect();
    if runs.iter().any(Vec::is_empty) {
        return Ok(None);
    }
    let last = |runs: &Vec<u64>| runs.last().copied();
    let first = |runs: &Vec<u64>| runs.first().copied();
    let constant = files.len() > 1 && runs.iter().all(|r| last(r) == runs.first().and_then(last));
    let mut by_number: BTreeMap<u64, PathBuf> = BTreeMap::new();
    for (file, runs) in files.iter().zip(&runs) {
        let number = if constant { first(runs) } else { last(runs) };
        let frame = number.unwrap_or(0);
        if let Some(before) = by_number.insert(frame, file.clone()) {
            return Err(CaptureError::DuplicateFrame {
                camera: camera.clone(),
                frame,
                first: before,
                second: file.clone(),
            });
        }
    }
    Ok(Some(by_number))
}

/// Every run of digits in a file's name without its ending; a run too long for a number is left out.
fn digit_runs(file: &Path) -> Vec<u64> {
    let name = file.file_stem().unwrap_or_default().to_string_lossy();
    name.split(|c: char| !c.is_ascii_digit())
        .filter_map(|run| run.parse().ok())
        .collect()
}

fn stamp_by_number(
    camera: &CameraId,
    by_number: &BTreeMap<u64, PathBuf>,
    stamps: &FrameStamps,
) -> Result<Vec<(FrameStamp, PathBuf)>, CaptureError> {
    let stamped = by_number.iter().map(|(&frame, file)| match stamps.of(frame) {
        Some(stamped) => Ok((imported(frame, stamped), file.clone())),
        None => Err(CaptureError::NoTimestamp {
            camera: camera.clone(),
            frame,
            file: file.clone(),
            list: match stamps {
                FrameStamps::Listed { list, .. } => list.clone(),
                FrameStamps::RateHz(_) => PathBuf::from("--fps"),
            },
        }),
    });
    stamped.collect()
}

fn stamp_by_order(
    camera: &CameraId,
    files: &[PathBuf],
    (list, by_frame): (&Path, &BTreeMap<u64, crate::time::StampedMidpoint>),
) -> Result<Vec<(FrameStamp, PathBuf)>, CaptureError> {
    if let (Some(file), true) = (files.get(by_frame.len()), files.len() > by_frame.len()) {
        return Err(CaptureError::NoTimestamp {
            camera: camera.clone(),
            frame: by_frame.len() as u64,
            file: file.clone(),
            list: list.to_owned(),
        });
    }
    let rows = by_frame.iter().zip(files);
    Ok(rows
        .map(|((&frame, &stamped), file)| (imported(frame, stamped), file.clone()))
        .collect())
}

/// The stamp of a frame that has no other times.
pub(super) fn imported(frame: u64, stamped: crate::time::StampedMidpoint) -> FrameStamp {
    FrameStamp {
        frame,
        device: None,
        arrival: None,
        stamped,
    }
}
