//! Names in a session folder: files, topics, attachments, versions.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::scene::CameraId;

/// Version of the layout this program writes; it reads this one and all before.
pub const FORMAT_VERSION: u32 = 1;
/// A new file begins when the stamps of one span this much, nanoseconds.
pub const SEGMENT_SPAN_NS: i64 = 10_000_000_000;
/// … or when it holds this many bytes.
pub const SEGMENT_BYTES_MAX: u64 = 4 << 30;
/// Channel of the frame infos in every camera's file. Fixed, so that a damaged channel record costs nothing.
pub const INFO_CHANNEL: u16 = 1;
/// Channel of the images.
pub const IMAGE_CHANNEL: u16 = 2;
/// Last part of the topic of the frame infos.
pub const INFO_TOPIC: &str = "frame_info";
/// Last part of the topic of the images.
pub const IMAGE_TOPIC: &str = "image";
/// Attachment with the rig file's text.
pub const RIG_ATTACHMENT: &str = "rig.toml";
/// Attachment with the calibration.
pub const CALIBRATION_ATTACHMENT: &str = "calibration.json";
/// Metadata record that says what the file is.
pub const METADATA_NAME: &str = "pitchd";
/// Key in it: CRC-32 of the other keys and values.
pub const METADATA_CRC_KEY: &str = "crc32";
/// Attachment of the session file: the camera files and how many frames each holds.
pub const FILES_ATTACHMENT: &str = "files.json";
/// Attachment of a repaired session file: what could not be saved, in words.
pub const LOSSES_ATTACHMENT: &str = "losses.json";
/// Ending of a damaged file that a repair has replaced.
pub const DAMAGED_SUFFIX: &str = ".damaged";
/// Ending of a file a repair is making.
pub const REPAIR_SUFFIX: &str = ".repair";
/// The file of rig, calibration, tracks and results.
pub const SESSION_FILE: &str = "session.mcap";
/// Ending of a file that is not finished.
pub const PART_SUFFIX: &str = ".part";

/// How pixels are stored; never lossy.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum PixelEncoding {
    /// As they are: `foxglove.RawImage`, mono8.
    #[default]
    Raw,
    /// PNG: `foxglove.CompressedImage`; about half the disk for one core per 370 MB/s.
    Png,
}

impl PixelEncoding {
    /// The word in the files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Raw => "mono8",
            Self::Png => "png",
        }
    }
}

/// Checksum of a metadata record, over all its keys but its own; MCAP gives these records none.
pub fn metadata_crc32(map: &BTreeMap<String, String>) -> String {
    let mut hasher = crc32fast::Hasher::new();
    for (key, value) in map.iter().filter(|(key, _)| *key != METADATA_CRC_KEY) {
        hasher.update(format!("{key}={value}\n").as_bytes());
    }
    format!("{:08x}", hasher.finalize())
}

/// A camera's file, by its name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CameraFile {
    /// Camera.
    pub camera: CameraId,
    /// Number of the segment, from 0.
    pub segment: u32,
    /// False: `.part`.
    pub finished: bool,
}

/// `<camera>.<segment>.mcap`.
pub fn camera_file(folder: &Path, camera: &CameraId, segment: u32) -> PathBuf {
    folder.join(format!("{camera}.{segment:04}.mcap"))
}

/// The same with `.part` behind.
pub fn part_of(file: &Path) -> PathBuf {
    with_suffix(file, PART_SUFFIX)
}

/// A path with something behind its whole name.
pub fn with_suffix(file: &Path, suffix: &str) -> PathBuf {
    let mut name = file.as_os_str().to_owned();
    name.push(suffix);
    PathBuf::from(name)
}

/// Reads a file name; `None` for anything that is not a camera's file.
pub fn parse_camera_file(name: &str) -> Option<CameraFile> {
    let (stem, finished) = match name.strip_suffix(PART_SUFFIX) {
        Some(stem) => (stem, false),
        None => (name, true),
    };
    // A camera id has no dots, so the name splits in exactly one way.
    let (camera, segment) = stem.strip_suffix(".mcap")?.split_once('.')?;
    let digits = segment.len() >= 4 && segment.bytes().all(|b| b.is_ascii_digit());
    Some(CameraFile {
        camera: CameraId::new(camera).ok()?,
        segment: digits.then(|| segment.parse().ok())??,
        finished,
    })
}

/// Whether a file of this name belongs to a session (finished or not, or set aside by a repair).
pub fn is_session_file(name: &str) -> bool {
    let mut stem = name;
    for suffix in [DAMAGED_SUFFIX, PART_SUFFIX, REPAIR_SUFFIX] {
        stem = stem.strip_suffix(suffix).unwrap_or(stem);
    }
    stem == SESSION_FILE || parse_camera_file(stem).is_some()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_names_come_back() {
        let id = CameraId::new("third-base_2").unwrap();
        for segment in [0, 7, 12_345] {
            let file = camera_file(Path::new("/s"), &id, segment);
            let name = file.file_name().unwrap().to_str().unwrap();
            let parsed = parse_camera_file(name).unwrap();
            assert_eq!(
                (parsed.camera, parsed.segment, parsed.finished),
                (id.clone(), segment, true)
            );
            let part = part_of(&file);
            let parsed = parse_camera_file(part.file_name().unwrap().to_str().unwrap()).unwrap();
            assert!(!parsed.finished);
        }
        for other in [
            "session.mcap",
            "a.mcap",
            "a.1.mcap",
            "a b.0001.mcap",
            "a.0001.csv",
            ".0001.mcap",
        ] {
            assert_eq!(parse_camera_file(other), None, "{other}");
        }
        assert!(is_session_file("session.mcap.part") && is_session_file("a.0001.mcap.part.damaged"));
        assert!(!is_session_file("notes.txt"));
    }
}
