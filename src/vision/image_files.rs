//! Image and video files to Mono8.

use std::io::Read;
use std::path::{Path, PathBuf};

use opencv::core::{CV_8U, CV_16U, Mat, MatTraitConst, MatTraitConstManual};
use opencv::core::{LogLevel, set_log_level};
use opencv::videoio::{
    CAP_ANY, CAP_FFMPEG, CAP_PROP_FRAME_COUNT, CAP_PROP_FRAME_HEIGHT, CAP_PROP_FRAME_WIDTH, CAP_PROP_POS_MSEC,
};
use opencv::videoio::{VideoCapture, VideoCaptureTrait, VideoCaptureTraitConst};
use opencv::{imgcodecs, imgproc};

/// Endings of image files that are read.
pub const IMAGE_ENDINGS: [&str; 6] = ["pgm", "png", "tif", "tiff", "jpg", "jpeg"];

/// An 8-bit grey image, rows from the top, no padding.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Mono8 {
    /// Columns.
    pub width_px: u32,
    /// Rows.
    pub height_px: u32,
    /// `width·height` bytes.
    pub pixels: Vec<u8>,
    /// Bits of a value of two bytes, where the file says it.
    pub own_bits: Option<u32>,
}

/// Why an image or video file cannot be read.
#[derive(Debug, thiserror::Error)]
#[error("{}: {reason}", file.display())]
pub struct ImageError {
    /// File.
    pub file: PathBuf,
    /// Why.
    pub reason: String,
}

/// Whether the name's ending is one of [`IMAGE_ENDINGS`].
pub fn is_image_name(file: &Path) -> bool {
    let ending = file.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
    ending.is_some_and(|ending| IMAGE_ENDINGS.contains(&ending.as_str()))
}

/// Reads an image. Colour becomes luma (BT.601, as OpenCV), transparency is dropped.
///
/// Of a value of two bytes the upper eight are taken: of as many bits as a PGM's own maximum needs; where that is 65535, as
/// most programs write it, and in PNG and TIFF, of `level_bits`. Without those nothing says how many the camera filled, and a
/// wrong guess would darken or clip without a word.
///
/// # Errors
/// The file cannot be read or decoded, has more than 16 bits a value, it is not known how many of them count, or a value
/// has more than those.
pub fn read_mono8(file: &Path, level_bits: Option<u32>) -> Result<Mono8, ImageError> {
    let wrong = |reason: String| ImageError {
        file: file.to_owned(),
        reason,
    };
    let mut start = [0; 2];
    let mut opened = std::fs::File::open(file).map_err(|e| wrong(e.to_string()))?;
    let count = opened.read(&mut start).map_err(|e| wrong(e.to_string()))?;
    match (count, &start) {
        (0, _) => Err(wrong("is empty".to_owned())),
        // Thousands of PGMs are imported at once; reading them straight is twice as fast as through OpenCV.
        (2, b"P5") => {
            let length = opened.metadata().map_or(0, |m| m.len());
            let mut bytes = Vec::with_capacity(usize::try_from(length).unwrap_or(0));
            opened.read_to_end(&mut bytes).map_err(|e| wrong(e.to_string()))?;
            parse_pgm(bytes, level_bits).map_err(wrong)
        }
        _ => {
            drop(opened);
            let path = file
                .to_str()
                .ok_or_else(|| wrong("its name is not UTF-8".to_owned()))?;
            let image = imgcodecs::imread(path, imgcodecs::IMREAD_UNCHANGED)
                .map_err(|e| wrong(format!("is not a readable image: {}", e.message)))?;
            if image.empty() {
                return Err(wrong("is not a readable image".to_owned()));
            }
            grey(&image, level_bits).map_err(wrong)
        }
    }
}

/// A binary PGM after its `P5`.
fn parse_pgm(mut bytes: Vec<u8>, level_bits: Option<u32>) -> Result<Mono8, String> {
    let mut place = 0;
    let mut field = |name: &str| {
        let mut number: Option<u32> = None;
        loop {
            let byte = *bytes
                .get(place)
                .ok_or(format!("is cut short in its header ({name})"))?;
            match (byte, number) {
                (b'#', None) => {
                    let rest = bytes.get(place..).unwrap_or_default();
                    place += rest.iter().position(|b| *b == b'\n').unwrap_or(rest.len());
                }
                (b'0'..=b'9', before) => {
                    let digit = u32::from(byte - b'0');
                    let value = before
                        .unwrap_or(0)
                        .checked_mul(10)
                        .and_then(|v| v.checked_add(digit));
                    number = Some(value.ok_or(format!("has an absurd {name}"))?);
                    place += 1;
                }
                (byte, Some(value)) if byte.is_ascii_whitespace() || byte == b'#' => return Ok(value),
                (byte, None) if byte.is_ascii_whitespace() => place += 1,
                _ => return Err(format!("has a broken header ({name})")),
            }
        }
    };
    let (width_px, height_px, white) = (field("width")?, field("height")?, field("maximum")?);
    let value_bytes = match white {
        255 => 1,
        256..=65535 => 2,
        _ => return Err(format!("has a maximum of {white}; 255 to 65535 are read")),
    };
    // One whitespace byte after the maximum, then the rows.
    let begin = place + 1;
    let size = value_bytes * u64::from(width_px) * u64::from(height_px);
    let have = bytes.len().saturating_sub(begin) as u64;
    if have < size || size == 0 {
        return Err(format!(
            "is cut short: {have} bytes of pixels, {width_px}x{height_px} need {size}"
        ));
    }
    bytes.drain(..begin);
    bytes.truncate(usize::try_from(size).map_err(|_| "is too large".to_owned())?);
    let own_bits = (256..65535).contains(&white).then(|| white.ilog2() + 1);
    if value_bytes == 2 {
        let bits = own_bits.or(level_bits).ok_or_else(unknown_bits)?;
        let (values, _) = bytes.as_chunks::<2>();
        bytes = upper_eight(values.iter().map(|value| u16::from_be_bytes(*value)), bits)
            .map_err(|needed| too_many_bits(needed, bits, own_bits.map(|_| white)))?;
    }
    Ok(Mono8 {
        width_px,
        height_px,
        pixels: bytes,
        own_bits,
    })
}

fn unknown_bits() -> String {
    "has 16 bits per value, and does not say how many of them the camera filled; give --bits (10, 12, 14 or 16)".to_owned()
}

/// `white`: the maximum that the file itself has.
fn too_many_bits(needed: u32, level_bits: u32, white: Option<u32>) -> String {
    let (should, mend) = match white {
        Some(white) => (format!("its maximum of {white} has"), "the file is broken"),
        None => ("it should have".to_owned(), "correct --bits"),
    };
    format!("has values of {needed} bits, more than the {level_bits} that {should}; {mend}")
}

/// The upper eight bits of levels of 8 to 16; the bits that a level needs where those are more.
fn upper_eight(values: impl Iterator<Item = u16>, level_bits: u32) -> Result<Vec<u8>, u32> {
    let shift = level_bits.saturating_sub(8).min(8);
    let mut all = 0;
    let levels = values.map(|value| {
        all |= value;
        (value >> shift) as u8
    });
    let levels = levels.collect();
    let needed = u16::BITS - all.leading_zeros();
    if needed > level_bits {
        return Err(needed);
    }
    Ok(levels)
}

fn grey(image: &Mat, level_bits: Option<u32>) -> Result<Mono8, String> {
    let text = |e: opencv::Error| e.message;
    let depth = image.depth();
    if depth != CV_8U && depth != CV_16U {
        let bits = 8 * image.elem_size1();
        return Err(format!(
            "has {bits} bits per value with a sign or a point; plain 8 and 16 bits are read"
        ));
    }
    let code = match image.channels() {
        1 => None,
        3 => Some(imgproc::COLOR_BGR2GRAY),
        4 => Some(imgproc::COLOR_BGRA2GRAY),
        other => return Err(format!("has {other} channels")),
    };
    let mut luma = Mat::default();
    let image = match code {
        None if image.is_continuous() => image,
        None => {
            luma = image.try_clone().map_err(text)?;
            &luma
        }
        Some(code) => {
            imgproc::cvt_color_def(image, &mut luma, code).map_err(text)?;
            &luma
        }
    };
    let pixels = if depth == CV_8U {
        image.data_bytes().map_err(text)?.to_vec()
    } else {
        let values = image.data_typed::<u16>().map_err(text)?;
        let bits = level_bits.ok_or_else(unknown_bits)?;
        upper_eight(values.iter().copied(), bits).map_err(|needed| too_many_bits(needed, bits, None))?
    };
    let side = |n: i32| u32::try_from(n).map_err(|_| "has no size".to_owned());
    Ok(Mono8 {
        width_px: side(image.cols())?,
        height_px: side(image.rows())?,
        pixels,
        own_bits: None,
    })
}

/// A video's frame: nothing says how many of its bits count where it has more than eight.
fn grey_of_video(frame: &Mat) -> Result<Mono8, String> {
    if frame.depth() == CV_16U {
        return Err(
            "has 16 bits per value; of videos 8 are read. Make images of it (PNG or TIFF) and import their folder \
             with --bits"
                .to_owned(),
        );
    }
    grey(frame, None)
}

/// A video file being read frame by frame.
pub struct VideoReader {
    file: PathBuf,
    capture: VideoCapture,
    size_px: (u32, u32),
    frames_expected: Option<u64>,
    frame: Mat,
    frames_read: u64,
}

impl VideoReader {
    /// Opens a video.
    ///
    /// # Errors
    /// The file cannot be read or its codec is not known.
    pub fn open(file: &Path) -> Result<Self, ImageError> {
        let wrong = |reason: &str| ImageError {
            file: file.to_owned(),
            reason: reason.to_owned(),
        };
        let opened = std::fs::File::open(file).map_err(|e| wrong(&e.to_string()))?;
        if opened.metadata().is_ok_and(|data| data.len() == 0) {
            return Err(wrong("is empty"));
        }
        let path = file.to_str().ok_or_else(|| wrong("its name is not UTF-8"))?;
        // What is wrong is told by our own error; OpenCV's words would go to stderr beside it.
        set_log_level(LogLevel::LOG_LEVEL_SILENT).map_err(|e| wrong(&e.message))?;
        // FFmpeg first: GStreamer, which is tried otherwise, has its own way of shouting.
        let capture = [CAP_FFMPEG, CAP_ANY]
            .into_iter()
            .filter_map(|backend| VideoCapture::from_file(path, backend).ok())
            .find(|capture| capture.is_opened().unwrap_or(false))
            .ok_or_else(|| wrong("is not a readable video"))?;
        // OpenCV says 0 or a negative number where it does not know.
        let property = |id| capture.get(id).ok().filter(|v| v.is_finite() && *v > 0.0);
        let side = |id| property(id).map_or(0, |v| v as u32);
        Ok(Self {
            size_px: (side(CAP_PROP_FRAME_WIDTH), side(CAP_PROP_FRAME_HEIGHT)),
            frames_expected: property(CAP_PROP_FRAME_COUNT).map(|v| v as u64),
            file: file.to_owned(),
            capture,
            frame: Mat::default(),
            frames_read: 0,
        })
    }

    /// Columns and rows.
    pub fn size_px(&self) -> (u32, u32) {
        self.size_px
    }

    /// Frames by the container's header, which may be an estimate.
    pub fn frames_expected(&self) -> Option<u64> {
        self.frames_expected
    }

    /// Frames read so far.
    pub fn frames_read(&self) -> u64 {
        self.frames_read
    }

    /// When the frame last read is to be shown, by the container, seconds; `None` where it does not say.
    pub fn own_time_s(&self) -> Option<f64> {
        let shown_ms = self.capture.get(CAP_PROP_POS_MSEC).ok();
        shown_ms.filter(|ms| ms.is_finite()).map(|ms| ms / 1e3)
    }

    /// The next frame as luma; `None` at the end.
    ///
    /// # Errors
    /// The frame does not decode, or has other than 8 bits.
    pub fn next_mono8(&mut self) -> Result<Option<Mono8>, ImageError> {
        let wrong = |reason: String| ImageError {
            file: self.file.clone(),
            reason: format!("frame {}: {reason}", self.frames_read),
        };
        if !self.capture.read(&mut self.frame).map_err(|e| wrong(e.message))? {
            return Ok(None);
        }
        let image = grey_of_video(&self.frame).map_err(wrong)?;
        self.frames_read += 1;
        Ok(Some(image))
    }
}

#[cfg(test)]
mod tests {
    use opencv::core::{Scalar, Vector};

    use super::*;

    /// 4×1 values in two bytes, high one first.
    fn pgm(maximum: u32, values: [u16; 4]) -> Vec<u8> {
        let mut bytes = format!("P5 4 1 {maximum}\n").into_bytes();
        bytes.extend(values.iter().flat_map(|v| v.to_be_bytes()));
        bytes.drain(..2);
        bytes
    }

    #[test]
    fn a_pgm_of_more_bits_has_its_upper_eight() {
        let read = |maximum, values, bits| parse_pgm(pgm(maximum, values), bits).map(|image| image.pixels);
        // 0xab and 0x12 with the low bits of ten, of twelve and of sixteen.
        let ten = [0x2af, 0x048, 0, 1023];
        let twelve = [0xabc, 0x123, 0, 4095];
        let expected = vec![0xab, 0x12, 0, 255];
        assert_eq!(read(1023, ten, None), Ok(expected.clone()));
        assert_eq!(read(4095, twelve, None), Ok(expected.clone()));
        // What a file says of itself counts, whatever was said for those that do not.
        assert_eq!(read(1023, ten, Some(12)), Ok(expected.clone()));
        let own_bits = |maximum| parse_pgm(pgm(maximum, ten), Some(12)).unwrap().own_bits;
        assert_eq!((own_bits(1023), own_bits(65535)), (Some(10), None));
        let error = read(1023, twelve, None).unwrap_err();
        assert!(
            error.contains("12 bits, more than the 10 that its maximum of 1023 has"),
            "{error}"
        );
        // Most programs write 65535 whatever the camera filled.
        assert!(read(65535, twelve, None).unwrap_err().contains("give --bits"));
        assert_eq!(read(65535, twelve, Some(12)), Ok(expected.clone()));
        assert_eq!(read(65535, twelve.map(|v| v << 4), Some(16)), Ok(expected));
        let error = read(65535, twelve, Some(10)).unwrap_err();
        assert!(
            error.contains("has values of 12 bits, more than the 10"),
            "{error}"
        );
        assert_eq!(
            read(127, twelve, None),
            Err("has a maximum of 127; 255 to 65535 are read".to_owned())
        );
        let cut = pgm(4095, twelve)[..12].to_vec();
        assert!(parse_pgm(cut, None).unwrap_err().contains("4x1 need 8"));
    }

    #[test]
    fn png_and_tiff_of_more_bits_have_their_upper_eight() {
        let folder = tempfile::tempdir().unwrap();
        let image = |kind, level| Mat::new_rows_cols_with_default(3, 5, kind, Scalar::all(level)).unwrap();
        for name in ["a.png", "a.tif"] {
            let file = folder.path().join(name);
            let write = |image: &Mat| {
                assert!(imgcodecs::imwrite(file.to_str().unwrap(), image, &Vector::new()).unwrap());
            };
            for kind in [opencv::core::CV_16UC1, opencv::core::CV_16UC3] {
                write(&image(kind, f64::from(0xabc)));
                let read = |bits| read_mono8(&file, bits);
                assert_eq!(read(Some(12)).unwrap().pixels, [0xab; 15], "{name}");
                assert_eq!(read(Some(16)).unwrap().pixels, [0x0a; 15], "{name}");
                assert!(read(None).unwrap_err().reason.contains("give --bits"));
                assert!(
                    read(Some(11))
                        .unwrap_err()
                        .reason
                        .contains("has values of 12 bits")
                );
                // --bits is for images.
                let told = grey_of_video(&image(kind, f64::from(0xabc))).unwrap_err();
                assert!(
                    told.contains("Make images of it") && !told.contains("give --bits"),
                    "{told}"
                );
            }
            assert_eq!(
                grey_of_video(&image(opencv::core::CV_8UC1, 200.0))
                    .unwrap()
                    .pixels,
                [200; 15]
            );
            // The bits of values in one byte are known.
            write(&image(opencv::core::CV_8UC1, 200.0));
            assert_eq!(read_mono8(&file, Some(12)).unwrap().pixels, [200; 15]);
        }
    }
}
