//! One camera file being written: frame infos and images in pairs.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::error::RecordingError;
use super::frame_info::{FrameInfo, RecordedFrame};
use super::layout::{IMAGE_CHANNEL, IMAGE_TOPIC, INFO_CHANNEL, INFO_TOPIC, PixelEncoding};
use super::payload::{encode_image, image_schema};
use super::segment::{Attached, Segment, SegmentFinishing};
use super::writer::{CameraGeometry, DiskPath};
use crate::scene::CameraId;

/// Stamps between two flushes: what a kill may cost, nanoseconds.
const FLUSH_SPAN_NS: i64 = 1_000_000_000;

/// What a camera file says of itself before its first frame.
#[derive(Debug, Clone)]
pub struct FrameFileHead {
    pub camera: CameraId,
    pub segment: u32,
    pub geometry: CameraGeometry,
    pub encoding: PixelEncoding,
    pub disk: DiskPath,
    pub attached: Attached,
}

/// What the session file says of a finished camera file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileEntry {
    /// Frames written.
    pub frames: u64,
    /// First and last frame number.
    pub frame_span: [u64; 2],
    /// First and last stamp.
    pub stamp_span_ns: [i64; 2],
}

/// An open camera file.
pub struct FrameFile {
    segment: Segment,
    camera: CameraId,
    encoding: PixelEncoding,
    entry: Option<FileEntry>,
    flushed_ns: i64,
    /// The image message, kept for its memory.
    image: Vec<u8>,
}

impl FrameFile {
    /// Begins `file` as `file.part`.
    pub fn create(file: PathBuf, head: &FrameFileHead) -> Result<Self, RecordingError> {
        let about = [
            ("content", "frames".to_owned()),
            ("camera", head.camera.to_string()),
            ("segment", head.segment.to_string()),
            ("width_px", head.geometry.width_px.to_string()),
            ("height_px", head.geometry.height_px.to_string()),
            ("encoding", head.encoding.name().to_owned()),
        ];
        let mut segment = Segment::create(file, head.disk, &head.attached, &about)?;
        let info_schema = foxglove::Schema::new("pitchd.FrameInfo", "protobuf", FrameInfo::schema());
        let info_topic = format!("/{}/{INFO_TOPIC}", head.camera);
        let image_topic = format!("/{}/{IMAGE_TOPIC}", head.camera);
        // A new file numbers its channels from 1.
        let info_channel = segment.add_channel(&info_topic, &info_schema)?;
        let image_channel = segment.add_channel(&image_topic, &image_schema(head.encoding))?;
        debug_assert_eq!((info_channel, image_channel), (INFO_CHANNEL, IMAGE_CHANNEL));
        Ok(Self {
            segment,
            camera: head.camera.clone(),
            encoding: head.encoding,
            entry: None,
            flushed_ns: i64::MIN,
            image: Vec::new(),
        })
    }

    /// The finished file's name.
    pub fn file(&self) -> &Path {
        self.segment.file()
    }

    /// Message bytes so far.
    pub fn bytes(&self) -> u64 {
        self.segment.bytes()
    }

    /// Stamp of the first frame, nanoseconds.
    pub fn begin_ns(&self) -> Option<i64> {
        let [begin_ns, _] = self.entry.as_ref()?.stamp_span_ns;
        Some(begin_ns)
    }

    /// Appends a frame.
    pub fn write(&mut self, recorded: &RecordedFrame) -> Result<(), RecordingError> {
        let (frame, stamped_ns) = (recorded.frame.stamp.frame, recorded.frame.stamp.stamped.nanos());
        encode_image(
            &recorded.frame,
            self.camera.as_str(),
            self.encoding,
            &mut self.image,
        )
        .map_err(|reason| RecordingError::Encoding {
            file: self.segment.file().to_owned(),
            reason,
        })?;
        let entry = self.entry.get_or_insert(FileEntry {
            frames: 0,
            frame_span: [frame; 2],
            stamp_span_ns: [stamped_ns; 2],
        });
        let mut info = FrameInfo::new(recorded, &self.camera, self.encoding);
        let index = entry.frames as u32;
        info.index = index;
        self.segment
            .write(INFO_CHANNEL, index, stamped_ns, &info.seal())?;
        self.segment
            .write(IMAGE_CHANNEL, index, stamped_ns, &self.image)?;
        entry.frames += 1;
        entry.frame_span[1] = frame;
        entry.stamp_span_ns[1] = stamped_ns;
        if stamped_ns.saturating_sub(self.flushed_ns) >= FLUSH_SPAN_NS {
            self.segment.flush()?;
            self.flushed_ns = stamped_ns;
        }
        Ok(())
    }

    /// Ends the file; its thread brings it to the disk. `None` as entry: it holds no frame.
    pub fn finish(self) -> Result<(SegmentFinishing, Option<FileEntry>), RecordingError> {
        Ok((self.segment.finish()?, self.entry))
    }
}
