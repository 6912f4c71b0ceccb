//! One MCAP file being written: `*.mcap.part` until it is whole and on the disk.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use mcap::records::MessageHeader;
use mcap::write::{Metadata, NoSeek, WriteOptions};
use mcap::{Attachment, Writer};

use super::disk::{DiskWriter, Finishing};
use super::error::RecordingError;
use super::layout::{
    CALIBRATION_ATTACHMENT, FORMAT_VERSION, METADATA_CRC_KEY, METADATA_NAME, RIG_ATTACHMENT, metadata_crc32,
    part_of,
};
use super::writer::DiskPath;

/// What is attached to every file.
#[derive(Debug, Clone, Default)]
pub struct Attached {
    pub rig_toml: String,
    pub calibration_json: Option<String>,
}

/// An open MCAP file.
pub struct Segment {
    writer: Writer<NoSeek<DiskWriter>>,
    file: PathBuf,
    bytes: u64,
}

/// A file on its way to the disk.
pub struct SegmentFinishing {
    finishing: Finishing,
    file: PathBuf,
}

impl SegmentFinishing {
    /// Waits until the file is safe.
    pub fn wait(self) -> Result<(), RecordingError> {
        let part = part_of(&self.file);
        self.finishing.wait().map_err(|e| RecordingError::io(&part, e))
    }
}

impl Segment {
    /// Begins `file` (as `file.part`) with the header, what the file is, rig and calibration.
    pub fn create(
        file: PathBuf,
        disk: DiskPath,
        attached: &Attached,
        about: &[(&str, String)],
    ) -> Result<Self, RecordingError> {
        let part = part_of(&file);
        let writer =
            DiskWriter::create(&part, disk == DiskPath::Direct).map_err(|e| RecordingError::io(&part, e))?;
        let mut about: BTreeMap<String, String> = about
            .iter()
            .map(|(key, value)| ((*key).to_owned(), value.clone()))
            .collect();
        about.insert("format_version".to_owned(), FORMAT_VERSION.to_string());
        about.insert(METADATA_CRC_KEY.to_owned(), metadata_crc32(&about));
        let begin = || {
            let mut writer = WriteOptions::new()
                .compression(None)
                .calculate_data_section_crc(false)
                .disable_seeking(true)
                .library(concat!("pitchd ", env!("CARGO_PKG_VERSION")))
                .create(NoSeek::new(writer))?;
            writer.write_metadata(&Metadata {
                name: METADATA_NAME.to_owned(),
                metadata: about,
            })?;
            attach(
                &mut writer,
                RIG_ATTACHMENT,
                "application/toml",
                &attached.rig_toml,
            )?;
            if let Some(json) = &attached.calibration_json {
                attach(&mut writer, CALIBRATION_ATTACHMENT, "application/json", json)?;
            }
            Ok(writer)
        };
        let writer = begin().map_err(|e| RecordingError::mcap(&part, e))?;
        Ok(Self {
            writer,
            file,
            bytes: 0,
        })
    }

    /// The finished file's name.
    pub fn file(&self) -> &Path {
        &self.file
    }

    /// Message bytes so far.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Adds a channel with its schema; the same twice gives the same number.
    pub fn add_channel(&mut self, topic: &str, schema: &foxglove::Schema) -> Result<u16, RecordingError> {
        let mut add = || {
            let schema_id = self
                .writer
                .add_schema(&schema.name, &schema.encoding, &schema.data)?;
            self.writer
                .add_channel(schema_id, topic, &schema.encoding, &BTreeMap::new())
        };
        add().map_err(|e| RecordingError::mcap(&part_of(&self.file), e))
    }

    /// Appends a message; `time_ns` is its log and publish time.
    pub fn write(
        &mut self,
        channel_id: u16,
        sequence: u32,
        time_ns: i64,
        data: &[u8],
    ) -> Result<(), RecordingError> {
        let time = u64::try_from(time_ns).unwrap_or(0);
        let header = MessageHeader {
            channel_id,
            sequence,
            log_time: time,
            publish_time: time,
        };
        self.bytes += data.len() as u64;
        self.writer
            .write_to_known_channel(&header, data)
            .map_err(|e| RecordingError::mcap(&part_of(&self.file), e))
    }

    /// Attaches a text (with a checksum of its own).
    pub fn attach(&mut self, name: &str, media_type: &str, text: &str) -> Result<(), RecordingError> {
        attach(&mut self.writer, name, media_type, text)
            .map_err(|e| RecordingError::mcap(&part_of(&self.file), e))
    }

    /// Ends the chunk and hands it to the disk, so that a kill loses nothing before it.
    pub fn flush(&mut self) -> Result<(), RecordingError> {
        self.writer
            .flush()
            .map_err(|e| RecordingError::mcap(&part_of(&self.file), e))
    }

    /// Writes the indexes; the disk thread syncs and renames. [`SegmentFinishing::wait`] tells how it went.
    pub fn finish(mut self) -> Result<SegmentFinishing, RecordingError> {
        let part = part_of(&self.file);
        self.writer.finish().map_err(|e| RecordingError::mcap(&part, e))?;
        let disk = self.writer.into_inner().into_inner();
        let finishing = disk
            .finish(self.file.clone())
            .map_err(|e| RecordingError::io(&part, e))?;
        Ok(SegmentFinishing {
            finishing,
            file: self.file,
        })
    }
}

fn attach(
    writer: &mut Writer<NoSeek<DiskWriter>>,
    name: &str,
    media_type: &str,
    text: &str,
) -> mcap::McapResult<()> {
    writer.attach(&Attachment {
        log_time: 0,
        create_time: 0,
        name: name.to_owned(),
        media_type: media_type.to_owned(),
        data: text.as_bytes().into(),
    })
}
