//! Reads `session.mcap`: rig, calibration and the list of the cameras' files.

use std::collections::BTreeMap;
use std::path::Path;

use mcap::records::op;

use super::cursor::Cursor;
use super::frame_file::FileEntry;
use super::layout::{FILES_ATTACHMENT, LOSSES_ATTACHMENT};
use super::scan::{RECORD_HEADER_BYTES, SMALL_RECORD_BYTES_MAX};
use super::summary::{Preamble, Trailer, attachment, read_preamble, read_trailer, small_record_damage};

/// What the session file says.
#[derive(Debug, Default)]
pub struct SessionRecord {
    pub preamble: Preamble,
    /// Finished camera files by name.
    pub files: BTreeMap<String, FileEntry>,
    /// What earlier repairs had to give up.
    pub losses: Vec<String>,
    /// What is wrong with the file.
    pub damage: Option<String>,
}

/// Reads as much as is whole.
pub fn read(path: &Path, finished: bool) -> std::io::Result<SessionRecord> {
    let mut record = SessionRecord {
        preamble: read_preamble(path)?,
        ..Default::default()
    };
    let mut file = std::fs::File::open(path)?;
    let length = file.metadata()?.len();
    record.damage = match (read_trailer(&mut file, length)?, finished) {
        (Trailer::Whole(_), true) => None,
        (Trailer::Damaged(what), _) => Some(what),
        (Trailer::Missing, true) => Some("its end is missing".to_owned()),
        (_, false) => Some("was not finished: the recording was stopped".to_owned()),
    };
    match file_list(path, &mut record)? {
        Ok(files) => record.files = files,
        Err(reason) => {
            record.damage.get_or_insert(reason);
        }
    }
    Ok(record)
}

/// Walks the top-level records to the list of files, which is the last before the data end.
fn file_list(
    path: &Path,
    record: &mut SessionRecord,
) -> std::io::Result<Result<BTreeMap<String, FileEntry>, String>> {
    use std::io::{Read, Seek, SeekFrom};
    let mut file = std::io::BufReader::new(std::fs::File::open(path)?);
    let length = file.get_ref().metadata()?.len();
    let mut magic = [0; mcap::MAGIC.len()];
    let _ = file.read(&mut magic)?;
    if magic != *mcap::MAGIC {
        record
            .damage
            .get_or_insert("does not begin as an MCAP file".to_owned());
    }
    let mut position = mcap::MAGIC.len() as u64;
    loop {
        file.seek(SeekFrom::Start(position))?;
        let mut header = Vec::new();
        file.by_ref().take(RECORD_HEADER_BYTES).read_to_end(&mut header)?;
        let mut cursor = Cursor::new(&header);
        let broken_at = position;
        let broken = || Err(format!("is broken at byte {broken_at}"));
        let (Some(&[opcode]), Some(size)) = (cursor.bytes(1), cursor.u64()) else {
            return Ok(broken());
        };
        position += RECORD_HEADER_BYTES;
        if size > length.saturating_sub(position) {
            return Ok(broken());
        }
        match opcode {
            op::DATA_END => return Ok(Err("has no list of files".to_owned())),
            op::HEADER | op::METADATA | op::ATTACHMENT if size <= SMALL_RECORD_BYTES_MAX => {
                let mut body = Vec::new();
                file.by_ref().take(size).read_to_end(&mut body)?;
                if let Some(what) = small_record_damage(opcode, &body) {
                    record.damage.get_or_insert(format!("{what} at byte {broken_at}"));
                }
                let attached = if opcode == op::ATTACHMENT {
                    attachment(&body)
                } else {
                    None
                };
                match attached.as_ref().map(|(name, json)| (name.as_str(), json)) {
                    Some((LOSSES_ATTACHMENT, json)) => {
                        record.losses = serde_json::from_slice(json).unwrap_or_default();
                    }
                    Some((FILES_ATTACHMENT, json)) => {
                        let parsed = serde_json::from_slice(json);
                        return Ok(parsed.map_err(|e| format!("its list of files is broken: {e}")));
                    }
                    _ => {}
                }
            }
            op::HEADER..=op::DATA_END | 0x80.. => {}
            _ => return Ok(broken()),
        }
        position += size;
    }
}
