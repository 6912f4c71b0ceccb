//! Walks one camera file record by record and gives every whole frame, however damaged the rest is.
//!
//! Why not the `mcap` crate's reader: it stops at the first error. The files are written uncompressed, so a
//! chunk is only a 49-byte header before its records; this scanner steps over the header, never trusts the
//! chunk's length to skip by, and after a broken record searches for the next chunk header or frame info.

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use mcap::records::op;

use super::cursor::Cursor;
use super::damage::{Damage, LostFrames};
use super::frame_info::{FrameFlags, FrameInfo, RecordedFrame};
use super::layout::{IMAGE_CHANNEL, INFO_CHANNEL};
use super::payload::decode_image;
use super::resync::{plain_chunk, search};
use super::summary::{FileSummary, Trailer, read_trailer, small_record_damage};
use crate::scene::CameraId;

/// Opcode and length before every record.
pub const RECORD_HEADER_BYTES: u64 = 9;
/// Channel, sequence and two times before a message's data.
pub const MESSAGE_HEADER_BYTES: u64 = 22;
/// Fields of a chunk before its records, without compression's name.
pub const CHUNK_HEADER_BYTES: u64 = 40;
/// Longest record that is neither chunk nor message.
pub const SMALL_RECORD_BYTES_MAX: u64 = 64 << 20;
/// Reasons told one by one before "and n more".
const REASONS_MAX: usize = 3;

struct OpenChunk {
    end: u64,
    crc: u32,
    hasher: crc32fast::Hasher,
    /// False after something in it was found broken: then its checksum says nothing new.
    whole: bool,
    /// First byte of its records.
    begin: u64,
    /// Channel, log time and place of each message, as its message indexes must say.
    messages: Vec<(u16, u64, u64)>,
}

/// One file being read.
pub struct Scanner {
    path: PathBuf,
    camera: CameraId,
    reader: BufReader<File>,
    position: u64,
    length: u64,
    /// Where the records end: before the data-end record of a good file, else the end of the file.
    end: u64,
    summary: Option<FileSummary>,
    chunk: Option<OpenChunk>,
    /// Messages of the chunk before, while its indexes may follow.
    indexed: Vec<(u16, u64, u64)>,
    pending: Option<FrameInfo>,
    /// The next image's info was told to be broken or foreign: the image is no news.
    image_told: bool,
    indices_seen: u64,
    frames_read: u64,
    bytes_lost: u64,
    reasons: Vec<String>,
    reasons_untold: usize,
    end_reasons: usize,
    foreign: u64,
    done: bool,
}

enum Step {
    Frame(Box<RecordedFrame>),
    Nothing,
    End,
}

impl Scanner {
    /// Opens a camera's file. `finished`: it has its final name and so must be whole.
    pub fn open(path: &Path, camera: &CameraId, finished: bool) -> std::io::Result<Self> {
        let mut file = File::open(path)?;
        let length = file.metadata()?.len();
        let mut magic = [0; 8];
        let magic_read = file.read(&mut magic)?;
        let trailer = read_trailer(&mut file, length)?;
        file.seek(SeekFrom::Start(magic_read as u64))?;
        let mut scanner = Self {
            path: path.to_owned(),
            camera: camera.clone(),
            reader: BufReader::with_capacity(64 << 10, file),
            position: magic_read as u64,
            length,
            end: length,
            summary: None,
            chunk: None,
            indexed: Vec::new(),
            pending: None,
            image_told: false,
            indices_seen: 0,
            frames_read: 0,
            bytes_lost: 0,
            reasons: Vec::new(),
            reasons_untold: 0,
            end_reasons: 0,
            foreign: 0,
            done: false,
        };
        if magic.get(..magic_read) != Some(mcap::MAGIC) {
            scanner.tell("does not begin as an MCAP file".to_owned());
        }
        match trailer {
            Trailer::Whole(summary) => {
                scanner.end = summary.data_end;
                if !finished {
                    scanner.tell("is whole but was not given its final name".to_owned());
                }
                scanner.summary = Some(summary);
            }
            Trailer::Missing if finished => scanner.tell_end("its end is missing".to_owned()),
            Trailer::Missing => scanner.tell_end("was not finished, its writer was stopped".to_owned()),
            Trailer::Damaged(what) => scanner.tell(what),
        }
        Ok(scanner)
    }

    /// The next whole frame, or `None` at the end of the file.
    pub fn next_frame(&mut self) -> Option<RecordedFrame> {
        while !self.done {
            match self.step() {
                Ok(Step::Frame(frame)) => return Some(*frame),
                Ok(Step::Nothing) => {}
                Ok(Step::End) => self.done = true,
                Err(error) => {
                    self.tell(format!("cannot be read at byte {}: {error}", self.position));
                    self.bytes_lost += self.end.saturating_sub(self.position);
                    self.done = true;
                }
            }
        }
        None
    }

    /// Whose file.
    pub fn camera(&self) -> &CameraId {
        &self.camera
    }

    /// The statistics at the end of the file, where it has any.
    pub fn summary(&self) -> Option<&FileSummary> {
        self.summary.as_ref()
    }

    /// What was lost so far; complete once [`Scanner::next_frame`] has given `None`. `expected`: frames the
    /// session file says are in here.
    pub fn damage(&self, expected: Option<u64>) -> Option<Damage> {
        if self.reasons.is_empty() {
            return None;
        }
        let mut reason = self.reasons.join("; ");
        if self.reasons_untold > 0 {
            reason += &format!("; and {} more", self.reasons_untold);
        }
        let expected = expected.or(self.summary.as_ref().and_then(|s| s.frames(INFO_CHANNEL)));
        let frames_lost = match expected {
            Some(expected) => LostFrames::Exactly(expected.saturating_sub(self.frames_read)),
            None => LostFrames::AtLeast(self.indices_seen.saturating_sub(self.frames_read)),
        };
        Some(Damage {
            file: self.path.clone(),
            camera: Some(self.camera.clone()),
            frames_read: self.frames_read,
            frames_lost,
            bytes_lost: self.bytes_lost,
            reason,
        })
    }

    /// Whether all that was found is that the file ends too early: nothing before its end is wrong.
    pub fn only_end_missing(&self) -> bool {
        self.reasons.len() + self.reasons_untold <= self.end_reasons
    }

    /// Notes that the file ends too early.
    fn tell_end(&mut self, reason: String) {
        self.end_reasons += 1;
        self.tell(reason);
    }

    /// Notes something wrong.
    pub fn tell(&mut self, reason: String) {
        if self.reasons.len() < REASONS_MAX {
            self.reasons.push(reason);
        } else {
            self.reasons_untold += 1;
        }
    }

    /// A frame this scanner gave was not accepted (it goes back in time).
    pub fn reject(&mut self, reason: String) {
        self.frames_read = self.frames_read.saturating_sub(1);
        self.tell(reason);
    }

    fn step(&mut self) -> std::io::Result<Step> {
        if self
            .chunk
            .as_ref()
            .is_some_and(|chunk| self.position >= chunk.end)
        {
            self.close_chunk();
        }
        if self.position >= self.end {
            return Ok(self.at_end());
        }
        let start = self.position;
        let Some(header) = self.read_vec(RECORD_HEADER_BYTES)? else {
            return self.broken(start);
        };
        let mut cursor = Cursor::new(&header);
        let opcode = cursor.bytes(1).and_then(|b| b.first().copied()).unwrap_or(0);
        let length = cursor.u64().unwrap_or(0);
        let limit = self
            .chunk
            .as_ref()
            .map_or(self.end, |chunk| chunk.end.min(self.end));
        match opcode {
            op::CHUNK if self.chunk.is_none() => self.open_chunk(start, length),
            op::DATA_END if self.chunk.is_none() && length == 4 => {
                // Only met when the end of the file is unknown: the records are complete.
                Ok(self.at_end())
            }
            _ if length > limit.saturating_sub(self.position) => self.broken(start),
            op::MESSAGE if length >= MESSAGE_HEADER_BYTES => self.message(start, length),
            op::HEADER..=op::DATA_END | 0x80.. if length <= SMALL_RECORD_BYTES_MAX => {
                let Some(body) = self.read_vec(length)? else {
                    return self.broken(start);
                };
                let broken = match opcode {
                    op::MESSAGE_INDEX => self.index_damage(&body),
                    _ => small_record_damage(opcode, &body),
                };
                if let Some(what) = broken {
                    self.tell(format!("{what} at byte {start}"));
                }
                Ok(Step::Nothing)
            }
            _ => self.broken(start),
        }
    }

    fn at_end(&mut self) -> Step {
        self.close_chunk();
        if let Some(info) = self.pending.take() {
            self.tell(format!("frame {}: its image is missing", info.frame));
        }
        if self.foreign > 0 {
            self.tell(format!("{} frames belong to another camera", self.foreign));
        }
        Step::End
    }

    fn close_chunk(&mut self) {
        let Some(chunk) = self.chunk.take() else { return };
        self.indexed.clear();
        if chunk.whole && self.position == chunk.end {
            if chunk.hasher.finalize() == chunk.crc {
                self.indexed = chunk.messages;
            } else {
                self.tell(format!("the chunk before byte {} fails its checksum", chunk.end));
            }
        }
    }

    fn open_chunk(&mut self, start: u64, length: u64) -> std::io::Result<Step> {
        let Some(fields) = self.read_vec(CHUNK_HEADER_BYTES)? else {
            return self.broken(start);
        };
        match plain_chunk(length, &fields) {
            Some(crc) => {
                self.chunk = Some(OpenChunk {
                    end: self.position + (length - CHUNK_HEADER_BYTES),
                    crc,
                    hasher: crc32fast::Hasher::new(),
                    whole: true,
                    begin: self.position,
                    messages: Vec::new(),
                });
                Ok(Step::Nothing)
            }
            None => self.broken(start),
        }
    }

    /// A message index has no checksum, but it says nothing that the chunk before it has not said.
    fn index_damage(&self, body: &[u8]) -> Option<&'static str> {
        if self.indexed.is_empty() {
            return None;
        }
        let mut cursor = Cursor::new(body);
        let channel = cursor.u16();
        let right = cursor
            .u32()
            .is_some_and(|bytes| bytes as usize == cursor.rest().len())
            && self
                .indexed
                .iter()
                .filter(|(of, _, _)| Some(*of) == channel)
                .all(|(_, time, place)| cursor.u64() == Some(*time) && cursor.u64() == Some(*place))
            && cursor.rest().is_empty();
        (!right).then_some("a message index is broken")
    }

    fn message(&mut self, start: u64, length: u64) -> std::io::Result<Step> {
        let Some(head) = self.read_vec(MESSAGE_HEADER_BYTES)? else {
            return self.broken(start);
        };
        let mut cursor = Cursor::new(&head);
        let (channel, _sequence, log_time) = (cursor.u16(), cursor.u32(), cursor.u64());
        if let (Some(chunk), Some(channel), Some(log_time)) = (&mut self.chunk, channel, log_time) {
            chunk.messages.push((channel, log_time, start - chunk.begin));
        }
        let Some(data) = self.read_vec(length - MESSAGE_HEADER_BYTES)? else {
            return self.broken(start);
        };
        if channel == Some(IMAGE_CHANNEL) {
            return self.image(start, data);
        }
        if channel == Some(INFO_CHANNEL) {
            return match FrameInfo::open(&data) {
                Some(info) => {
                    self.info(info);
                    Ok(Step::Nothing)
                }
                None => {
                    self.tell(format!("the frame info at byte {start} fails its checksum"));
                    self.image_told = true;
                    self.go_on_after(start)
                }
            };
        }
        self.tell(format!("a message at byte {start} has an unknown channel"));
        self.go_on_after(start)
    }

    fn info(&mut self, info: FrameInfo) {
        if let Some(before) = self.pending.take() {
            self.tell(format!("frame {}: its image is missing", before.frame));
        }
        self.image_told = true;
        if u64::from(info.index) < self.indices_seen {
            self.tell(format!("frame {}: is in the file twice", info.frame));
        } else if info.camera != self.camera.as_str() {
            self.foreign += 1;
            self.indices_seen = u64::from(info.index) + 1;
        } else {
            self.indices_seen = u64::from(info.index) + 1;
            self.image_told = false;
            self.pending = Some(info);
        }
    }

    fn image(&mut self, start: u64, data: Vec<u8>) -> std::io::Result<Step> {
        let Some(info) = self.pending.take() else {
            if !self.image_told {
                self.tell(format!("the image at byte {start} has no frame info"));
            }
            self.image_told = false;
            return self.go_on_after(start);
        };
        match decode_image(&info, data) {
            Ok(frame) => {
                self.frames_read += 1;
                Ok(Step::Frame(Box::new(RecordedFrame {
                    frame,
                    exposure_s: info.exposure_ns.map(|ns| ns as f64 * 1e-9),
                    flags: FrameFlags(info.flags),
                })))
            }
            Err(reason) => {
                self.tell(format!("frame {}: {reason}", info.frame));
                self.bytes_lost += self.position - start;
                self.go_on_after(start)
            }
        }
    }

    /// After a record whose content is broken: its length may be broken too. It is believed when it ends
    /// where its chunk does or a frame begins there.
    fn go_on_after(&mut self, start: u64) -> std::io::Result<Step> {
        let next = self.position;
        if let Some(chunk) = &mut self.chunk {
            chunk.whole = false;
            if chunk.end == next {
                return Ok(Step::Nothing);
            }
        }
        if search(&mut self.reader, next..next + 1, self.end)? == Some(next) {
            self.go_to(next)?;
            return Ok(Step::Nothing);
        }
        self.resync(start)
    }

    /// A record that cannot be one.
    fn broken(&mut self, start: u64) -> std::io::Result<Step> {
        let step = self.resync(start)?;
        match step {
            Step::End => self.tell_end(format!("ends inside a record, after byte {start}")),
            _ => self.tell(format!("bytes {start} to {} are no record", self.position)),
        }
        Ok(step)
    }

    fn resync(&mut self, start: u64) -> std::io::Result<Step> {
        let found = search(&mut self.reader, start + 1..self.end, self.end)?;
        let next = found.unwrap_or(self.end);
        self.bytes_lost += next.saturating_sub(start);
        self.go_to(next)?;
        if let Some(chunk) = &mut self.chunk {
            chunk.whole = false;
            if next >= chunk.end {
                self.chunk = None;
            }
        }
        let pending = self.pending.take();
        if found.is_none() {
            return Ok(self.at_end());
        }
        // Its image, if it was still to come, was in the lost bytes.
        if let Some(info) = pending {
            self.tell(format!("frame {}: its image is missing", info.frame));
        }
        Ok(Step::Nothing)
    }

    fn go_to(&mut self, position: u64) -> std::io::Result<()> {
        self.reader.seek(SeekFrom::Start(position))?;
        self.position = position;
        Ok(())
    }

    /// The next `count` bytes; `None` when the file ends before.
    fn read_vec(&mut self, count: u64) -> std::io::Result<Option<Vec<u8>>> {
        if count > self.length.saturating_sub(self.position) {
            return Ok(None);
        }
        let mut bytes = Vec::with_capacity(usize::try_from(count).unwrap_or(0));
        self.reader.by_ref().take(count).read_to_end(&mut bytes)?;
        self.position += bytes.len() as u64;
        if let Some(chunk) = &mut self.chunk {
            chunk.hasher.update(&bytes);
        }
        Ok((bytes.len() as u64 == count).then_some(bytes))
    }
}
