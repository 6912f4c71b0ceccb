//! Finds the next place in a damaged camera file where reading can go on.

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::ops::Range;

use mcap::records::op;

use super::cursor::Cursor;
use super::frame_info::{FrameInfo, INFO_BYTES_MAX};
use super::layout::INFO_CHANNEL;
use super::scan::{CHUNK_HEADER_BYTES, MESSAGE_HEADER_BYTES, RECORD_HEADER_BYTES};

/// Window of the search for the next good record.
const SEARCH_BYTES: usize = 1 << 20;
/// What a search needs to see behind a place to judge it.
const SEARCH_AHEAD: usize = (RECORD_HEADER_BYTES + MESSAGE_HEADER_BYTES + INFO_BYTES_MAX) as usize;

/// First place in `places` where a chunk or a frame info begins.
pub fn search(reader: &mut BufReader<File>, places: Range<u64>, end: u64) -> std::io::Result<Option<u64>> {
    let (mut base, to) = (places.start, places.end.min(end));
    let mut window = Vec::new();
    while base < to {
        reader.seek(SeekFrom::Start(base))?;
        window.clear();
        let wanted = (to - base).min(SEARCH_BYTES as u64);
        // Judging the last places needs bytes behind `to`.
        reader
            .by_ref()
            .take(wanted + SEARCH_AHEAD as u64)
            .read_to_end(&mut window)?;
        let places = (wanted as usize).min(window.len());
        for place in 0..places {
            let Some(bytes) = window.get(place..) else { break };
            if frame_begins(bytes) {
                return Ok(Some(base + place as u64));
            }
        }
        if places == 0 {
            break;
        }
        base += places as u64;
    }
    Ok(None)
}

/// The checksum in the header of an uncompressed chunk, when its three lengths agree.
pub fn plain_chunk(length: u64, fields: &[u8]) -> Option<u32> {
    let mut cursor = Cursor::new(fields);
    let (_begin, _end) = (cursor.u64()?, cursor.u64()?);
    let uncompressed = cursor.u64()?;
    let crc = cursor.u32()?;
    let compression_length = cursor.u32()?;
    let compressed = cursor.u64()?;
    let agree = compression_length == 0
        && uncompressed == compressed
        && compressed.checked_add(CHUNK_HEADER_BYTES) == Some(length);
    agree.then_some(crc)
}

fn frame_begins(bytes: &[u8]) -> bool {
    let mut cursor = Cursor::new(bytes);
    match cursor.bytes(1) {
        Some([op::CHUNK]) => {
            let length = cursor.u64();
            let fields = cursor.bytes(CHUNK_HEADER_BYTES as usize);
            matches!((length, fields), (Some(length), Some(fields)) if plain_chunk(length, fields).is_some())
        }
        Some([op::MESSAGE]) => {
            let length = cursor.u64().unwrap_or(0);
            let info_length = length.saturating_sub(MESSAGE_HEADER_BYTES);
            (1..=INFO_BYTES_MAX).contains(&info_length)
                && cursor
                    .bytes(MESSAGE_HEADER_BYTES as usize)
                    .and_then(|head| Cursor::new(head).u16())
                    == Some(INFO_CHANNEL)
                && cursor
                    .bytes(info_length as usize)
                    .and_then(FrameInfo::open)
                    .is_some()
        }
        _ => false,
    }
}
