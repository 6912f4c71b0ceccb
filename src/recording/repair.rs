//! Makes a killed or damaged recording whole again: `.part` files get their end and their name, damaged files
//! are written anew from the frames that are left.

use std::fs;
use std::path::{Path, PathBuf};

use super::damage::Damage;
use super::error::RecordingError;
use super::frame_file::{FileEntry, FrameFile, FrameFileHead};
use super::layout::{
    DAMAGED_SUFFIX, FORMAT_VERSION, PART_SUFFIX, PixelEncoding, REPAIR_SUFFIX, SESSION_FILE,
    parse_camera_file, part_of, with_suffix,
};
use super::reader::SessionReader;
use super::scan::Scanner;
use super::segment::{Attached, Segment};
use super::summary::read_preamble;
use super::writer::{CameraGeometry, DiskPath, FileEntries, end_session_file};
use crate::scene::CameraId;

/// A file that was mended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Repaired {
    /// The file as it is now.
    pub file: PathBuf,
    /// What was wrong with it, and what is lost for good.
    pub damage: Damage,
    /// The damaged file, kept where more than its end was broken.
    pub kept: Option<PathBuf>,
}

/// Mends every file of a session that needs it. Each mended file is read again and its frames counted before
/// the old one is touched. A damaged file is kept with the ending `.damaged`; a `.part` of which only the end
/// is missing is not. What is lost for good is noted in the session file.
///
/// # Errors
/// As [`SessionReader::open`]; [`RecordingError::DiskFull`] (a mended file needs room beside the old one);
/// [`RecordingError::Encoding`] when the mended file does not read back.
pub fn repair_session(folder: &Path) -> Result<Vec<Repaired>, RecordingError> {
    let reader = SessionReader::open(folder)?;
    let attached = Attached {
        rig_toml: reader.rig_toml().unwrap_or_default().to_owned(),
        calibration_json: reader.calibration_json().map(str::to_owned),
    };
    let mut repaired = Vec::new();
    let mut entries = FileEntries::new();
    for camera in reader.cameras() {
        for file in &camera.files {
            let mended = mend(file, &camera.id, &attached, reader.frames_expected(file))?;
            if let Some(entry) = mended.entry {
                entries.insert(mended.name, entry);
            }
            repaired.extend(mended.repaired);
        }
    }
    let session_damage = reader
        .damage()
        .into_iter()
        .filter(|d| d.camera.is_none() || !d.file.exists() && !part_of(&d.file).exists());
    let gone: Vec<Damage> = session_damage.collect();
    if repaired.is_empty() && gone.is_empty() {
        return Ok(repaired);
    }
    let mut losses = reader.losses().to_vec();
    let told = repaired.iter().map(|r: &Repaired| &r.damage).chain(&gone);
    losses.extend(
        told.filter(|d| d.frames_lost.count() > 0)
            .map(ToString::to_string),
    );
    rewrite_session_file(folder, &attached, &entries, &losses)?;
    repaired.extend(
        gone.into_iter()
            .filter(|d| d.camera.is_none())
            .map(|damage| Repaired {
                file: folder.join(SESSION_FILE),
                damage,
                kept: None,
            }),
    );
    Ok(repaired)
}

struct Mended {
    name: String,
    entry: Option<FileEntry>,
    repaired: Option<Repaired>,
}

/// `expected`: frames that the session file says are in it.
fn mend(
    file: &Path,
    camera: &CameraId,
    attached: &Attached,
    expected: Option<u64>,
) -> Result<Mended, RecordingError> {
    let io = |e| RecordingError::io(file, e);
    let name = file
        .file_name()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned();
    let parsed = parse_camera_file(&name);
    let (segment, finished) = parsed.map_or((0, true), |p| (p.segment, p.finished));
    let good = file.with_file_name(name.strip_suffix(PART_SUFFIX).unwrap_or(&name));
    let good_name = good
        .file_name()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned();
    let (mut scanner, entry) = survey(file, camera, finished)?;
    let Some(damage) = scanner.damage(expected) else {
        return Ok(Mended {
            name: good_name,
            entry,
            repaired: None,
        });
    };
    let keep = !scanner.only_end_missing() && damage.frames_lost.count() > 0;
    // A file with nothing in it is only put aside.
    if let Some(entry) = &entry {
        let about = read_preamble(file).map_err(io)?.about;
        let encoding = match about.get("encoding").map(String::as_str) {
            Some("png") => PixelEncoding::Png,
            _ => PixelEncoding::Raw,
        };
        scanner = Scanner::open(file, camera, finished).map_err(io)?;
        let new = with_suffix(&good, REPAIR_SUFFIX);
        rewrite(&mut scanner, &new, (segment, encoding, attached))?;
        check(&new, camera, entry)?;
        if keep {
            fs::rename(file, with_suffix(file, DAMAGED_SUFFIX)).map_err(io)?;
        }
        fs::rename(&new, &good).map_err(io)?;
        if !keep && !finished {
            fs::remove_file(file).map_err(io)?;
        }
    } else {
        fs::rename(file, with_suffix(file, DAMAGED_SUFFIX)).map_err(io)?;
    }
    let kept = (keep || entry.is_none()).then(|| with_suffix(file, DAMAGED_SUFFIX));
    Ok(Mended {
        name: good_name,
        entry,
        repaired: Some(Repaired {
            file: good,
            damage,
            kept,
        }),
    })
}

/// Reads a file to its end.
fn survey(
    file: &Path,
    camera: &CameraId,
    finished: bool,
) -> Result<(Scanner, Option<FileEntry>), RecordingError> {
    let mut scanner = Scanner::open(file, camera, finished).map_err(|e| RecordingError::io(file, e))?;
    let mut entry: Option<FileEntry> = None;
    while let Some(recorded) = scanner.next_frame() {
        let stamp = recorded.frame.stamp;
        let entry = entry.get_or_insert(FileEntry {
            frames: 0,
            frame_span: [stamp.frame; 2],
            stamp_span_ns: [stamp.stamped.nanos(); 2],
        });
        entry.frames += 1;
        entry.frame_span[1] = stamp.frame;
        entry.stamp_span_ns[1] = stamp.stamped.nanos();
    }
    Ok((scanner, entry))
}

fn rewrite(
    scanner: &mut Scanner,
    new: &Path,
    (segment, encoding, attached): (u32, PixelEncoding, &Attached),
) -> Result<(), RecordingError> {
    let mut file: Option<FrameFile> = None;
    while let Some(recorded) = scanner.next_frame() {
        let open = match &mut file {
            Some(open) => open,
            None => {
                let head = FrameFileHead {
                    camera: scanner.camera().clone(),
                    segment,
                    geometry: CameraGeometry {
                        width_px: recorded.frame.width_px,
                        height_px: recorded.frame.height_px,
                    },
                    encoding,
                    disk: DiskPath::Direct,
                    attached: attached.clone(),
                };
                file.insert(FrameFile::create(new.to_owned(), &head)?)
            }
        };
        open.write(&recorded)?;
    }
    match file {
        Some(file) => file.finish()?.0.wait(),
        None => Ok(()),
    }
}

/// A repair must never make things worse: the new file is read before the old one goes.
fn check(new: &Path, camera: &CameraId, wanted: &FileEntry) -> Result<(), RecordingError> {
    let (scanner, got) = survey(new, camera, true)?;
    if let (None, Some(got)) = (scanner.damage(None), &got)
        && got == wanted
    {
        return Ok(());
    }
    Err(RecordingError::Encoding {
        file: new.to_owned(),
        reason: format!("does not read back: {got:?}, wanted {wanted:?}"),
    })
}

fn rewrite_session_file(
    folder: &Path,
    attached: &Attached,
    entries: &FileEntries,
    losses: &[String],
) -> Result<(), RecordingError> {
    let file = folder.join(SESSION_FILE);
    let new = with_suffix(&file, REPAIR_SUFFIX);
    let about = [
        ("content", "session".to_owned()),
        ("repaired_to_format", FORMAT_VERSION.to_string()),
    ];
    let session = Segment::create(new.clone(), DiskPath::Direct, attached, &about)?;
    end_session_file(session, entries, losses)?;
    fs::rename(&new, &file).map_err(|e| RecordingError::io(&file, e))?;
    let part = part_of(&file);
    if part.exists() {
        fs::remove_file(&part).map_err(|e| RecordingError::io(&part, e))?;
    }
    Ok(())
}
