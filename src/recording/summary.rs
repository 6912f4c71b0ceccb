//! The end of an MCAP file (statistics and footer) and its beginning (what the file is, attachments).

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

use mcap::records::op;

use super::cursor::Cursor;
use super::layout::{METADATA_CRC_KEY, METADATA_NAME, metadata_crc32};
use super::scan::RECORD_HEADER_BYTES;

/// Footer record and magic at the end of a file.
const FOOTER_BYTES: u64 = RECORD_HEADER_BYTES + 20;
/// Data-end record, right before the summary.
const DATA_END_BYTES: u64 = RECORD_HEADER_BYTES + 4;
/// Longest summary that is read: a chunk index takes 100 bytes, a file has some thousand.
const SUMMARY_BYTES_MAX: u64 = 64 << 20;
/// Longest attachment that is read.
const ATTACHMENT_BYTES_MAX: u64 = 64 << 20;

/// What the summary says.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FileSummary {
    /// Where the data-end record begins.
    pub data_end: u64,
    messages: BTreeMap<u16, u64>,
    /// First and last log time, nanoseconds.
    pub log_span_ns: (u64, u64),
}

impl FileSummary {
    /// Messages of a channel.
    pub fn frames(&self, channel: u16) -> Option<u64> {
        Some(self.messages.get(&channel).copied().unwrap_or(0))
    }
}

/// How a file ends.
pub enum Trailer {
    /// As it should.
    Whole(FileSummary),
    /// No footer.
    Missing,
    /// A footer, but what it points to is not right.
    Damaged(String),
}

/// Reads the end of a file.
pub fn read_trailer(file: &mut File, length: u64) -> io::Result<Trailer> {
    let magic = mcap::MAGIC.len() as u64;
    let Some(footer_start) = length
        .checked_sub(magic + FOOTER_BYTES)
        .filter(|start| *start >= magic)
    else {
        return Ok(Trailer::Missing);
    };
    let tail = read_at(file, footer_start, magic + FOOTER_BYTES)?;
    let mut cursor = Cursor::new(&tail);
    let footer = (|| {
        let opcode = cursor.bytes(1)?;
        let record_length = cursor.u64()?;
        let summary_start = cursor.u64()?;
        let _offsets_start = cursor.u64()?;
        let crc = cursor.u32()?;
        let fits = opcode == [op::FOOTER] && record_length == 20 && cursor.rest() == mcap::MAGIC;
        fits.then_some((summary_start, crc))
    })();
    let Some((summary_start, crc)) = footer else {
        return Ok(Trailer::Missing);
    };
    let size = footer_start.checked_sub(summary_start);
    let (Some(size), Some(data_end)) = (
        size.filter(|size| *size <= SUMMARY_BYTES_MAX),
        summary_start.checked_sub(DATA_END_BYTES),
    ) else {
        return Ok(Trailer::Damaged("its footer points nowhere".to_owned()));
    };
    // The footer's checksum covers the summary and the footer up to the checksum itself.
    let covered = read_at(file, summary_start, size + FOOTER_BYTES - 4)?;
    if crc32fast::hash(&covered) != crc {
        return Ok(Trailer::Damaged("its summary fails its checksum".to_owned()));
    }
    let mut data_end_record = vec![op::DATA_END, 4];
    data_end_record.resize(DATA_END_BYTES as usize, 0);
    if read_at(file, data_end, DATA_END_BYTES)? != data_end_record {
        return Ok(Trailer::Damaged("its data-end record is broken".to_owned()));
    }
    Ok(match statistics(&covered, data_end) {
        Some(summary) => Trailer::Whole(summary),
        None => Trailer::Damaged("its summary has no statistics".to_owned()),
    })
}

fn statistics(summary: &[u8], data_end: u64) -> Option<FileSummary> {
    let mut records = Cursor::new(summary);
    loop {
        let opcode = records.bytes(1)?;
        let length = usize::try_from(records.u64()?).ok()?;
        let mut body = Cursor::new(records.bytes(length)?);
        if opcode != [op::STATISTICS] {
            continue;
        }
        let (_messages, _schemas) = (body.u64()?, body.u16()?);
        let _counts = (body.u32()?, body.u32()?, body.u32()?, body.u32()?);
        let log_span_ns = (body.u64()?, body.u64()?);
        let bytes = body.u32()? as usize;
        let mut pairs = Cursor::new(body.bytes(bytes)?);
        let mut messages = BTreeMap::new();
        while let (Some(channel), Some(count)) = (pairs.u16(), pairs.u64()) {
            messages.insert(channel, count);
        }
        return Some(FileSummary {
            data_end,
            messages,
            log_span_ns,
        });
    }
}

fn read_at(file: &mut File, offset: u64, count: u64) -> io::Result<Vec<u8>> {
    file.seek(SeekFrom::Start(offset))?;
    let mut bytes = Vec::new();
    file.take(count).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// What stands before the first message of a file.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Preamble {
    /// What the file says of itself.
    pub about: BTreeMap<String, String>,
    /// Whole attachments by name.
    pub attachments: BTreeMap<String, Vec<u8>>,
}

/// Reads header, metadata and attachments up to the first chunk, or as far as they are whole.
pub fn read_preamble(path: &Path) -> io::Result<Preamble> {
    let mut file = io::BufReader::new(File::open(path)?);
    let mut preamble = Preamble::default();
    let mut magic = [0; 8];
    if file.read_exact(&mut magic).is_err() || magic != *mcap::MAGIC {
        return Ok(preamble);
    }
    loop {
        let mut header = Vec::new();
        file.by_ref().take(RECORD_HEADER_BYTES).read_to_end(&mut header)?;
        let mut cursor = Cursor::new(&header);
        let (Some(&[opcode]), Some(length)) = (cursor.bytes(1), cursor.u64()) else {
            return Ok(preamble);
        };
        let wanted = matches!(opcode, op::HEADER | op::METADATA | op::ATTACHMENT);
        if !wanted || length > ATTACHMENT_BYTES_MAX {
            return Ok(preamble);
        }
        let mut body = Vec::new();
        file.by_ref().take(length).read_to_end(&mut body)?;
        if body.len() as u64 != length {
            return Ok(preamble);
        }
        match opcode {
            op::METADATA => {
                if let Some((_, map)) = metadata(&body) {
                    preamble.about = map;
                }
            }
            op::ATTACHMENT => {
                if let Some((name, data)) = attachment(&body) {
                    preamble.attachments.insert(name, data);
                }
            }
            _ => {}
        }
    }
}

/// Name and map of a metadata record whose checksum holds.
fn metadata(body: &[u8]) -> Option<(String, BTreeMap<String, String>)> {
    let mut cursor = Cursor::new(body);
    let name = cursor.string()?.to_owned();
    let map = cursor.string_map()?;
    let whole = name == METADATA_NAME && map.get(METADATA_CRC_KEY) == Some(&metadata_crc32(&map));
    whole.then_some((name, map))
}

/// What is wrong with a record that has a checksum of its own (or, the header, a fixed beginning).
pub fn small_record_damage(opcode: u8, body: &[u8]) -> Option<&'static str> {
    match opcode {
        op::HEADER => (!header(body)).then_some("the header is broken"),
        op::METADATA => metadata(body).is_none().then_some("metadata fail their checksum"),
        op::ATTACHMENT => attachment(body)
            .is_none()
            .then_some("an attachment fails its checksum"),
        _ => None,
    }
}

fn header(body: &[u8]) -> bool {
    let mut cursor = Cursor::new(body);
    cursor.string() == Some("")
        && cursor
            .string()
            .is_some_and(|library| library.starts_with("pitchd "))
}

/// Name and data of an attachment whose checksum holds.
pub fn attachment(body: &[u8]) -> Option<(String, Vec<u8>)> {
    let (covered, crc) = body.split_at_checked(body.len().checked_sub(4)?)?;
    if crc32fast::hash(covered) != Cursor::new(crc).u32()? {
        return None;
    }
    let mut cursor = Cursor::new(covered);
    let _times = (cursor.u64()?, cursor.u64()?);
    let name = cursor.string()?.to_owned();
    let _media_type = cursor.string()?;
    let size = usize::try_from(cursor.u64()?).ok()?;
    Some((name, cursor.bytes(size)?.to_vec()))
}
