//! Times for imported frames: `timestamps.csv` (`frame,timestamp_ns`) or a frame rate.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::CaptureError;
use crate::scene::CameraId;
use crate::time::StampedMidpoint;

/// Name of the list beside the images.
pub const LIST_NAME: &str = "timestamps.csv";

/// Where the stamps of imported frames come from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Stamping {
    /// From the list beside the images.
    List,
    /// From the list where there is one, else frame number × 1/rate.
    RateHz(f64),
}

/// Stamped midpoints by frame number.
#[derive(Debug, Clone)]
pub enum FrameStamps {
    /// As listed.
    Listed {
        /// The list.
        list: PathBuf,
        /// By frame number; stamps rise.
        by_frame: BTreeMap<u64, StampedMidpoint>,
    },
    /// Frame number × 1/rate.
    RateHz(f64),
}

impl FrameStamps {
    /// Takes the first list of `candidates` that exists, else the rate, else says that there is neither.
    pub fn find(camera: &CameraId, candidates: &[PathBuf], stamping: Stamping) -> Result<Self, CaptureError> {
        if let Some(list) = candidates.iter().find(|list| list.exists()) {
            return Ok(Self::Listed {
                list: list.clone(),
                by_frame: read_list(camera, list)?,
            });
        }
        match stamping {
            Stamping::RateHz(rate_hz) => Ok(Self::RateHz(rate_hz)),
            Stamping::List => Err(CaptureError::Timestamps {
                camera: camera.clone(),
                list: candidates.first().cloned().unwrap_or_default(),
                reason: "there is no such file; give the frame rate with --fps instead".to_owned(),
            }),
        }
    }

    /// The stamp of a frame.
    pub fn of(&self, frame: u64) -> Option<StampedMidpoint> {
        match self {
            Self::Listed { by_frame, .. } => by_frame.get(&frame).copied(),
            Self::RateHz(rate_hz) => {
                let nanos = frame as f64 * 1e9 / rate_hz;
                (nanos < i64::MAX as f64).then(|| StampedMidpoint::from_nanos(nanos.round() as i64))
            }
        }
    }
}

fn read_list(camera: &CameraId, list: &Path) -> Result<BTreeMap<u64, StampedMidpoint>, CaptureError> {
    let wrong = |reason: String| CaptureError::Timestamps {
        camera: camera.clone(),
        list: list.to_owned(),
        reason,
    };
    let mut reader = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .from_path(list)
        .map_err(|e| wrong(e.to_string()))?;
    let headers = reader.headers().map_err(|e| wrong(e.to_string()))?.clone();
    let column = |name: &str| {
        let found = headers
            .iter()
            .position(|h| h.trim_start_matches('\u{feff}') == name);
        found.ok_or_else(|| {
            let have: Vec<&str> = headers.iter().collect();
            wrong(format!(
                "line 1: no column {name:?}; the columns are {}",
                have.join(",")
            ))
        })
    };
    let (frame_column, stamp_column) = (column("frame")?, column("timestamp_ns")?);
    let mut by_frame = BTreeMap::new();
    for record in reader.records() {
        let record = record.map_err(|e| wrong(e.to_string()))?;
        let line = record.position().map_or(0, csv::Position::line);
        let number = |column: usize, name: &str| {
            let text = record.get(column).unwrap_or("");
            let number: Result<i64, _> = text.parse();
            number.map_err(|_| wrong(format!("line {line}: {name} {text:?} is not a whole number")))
        };
        let frame = number(frame_column, "frame")?;
        let Ok(frame) = u64::try_from(frame) else {
            return Err(wrong(format!("line {line}: frame {frame} is negative")));
        };
        let stamp = StampedMidpoint::from_nanos(number(stamp_column, "timestamp_ns")?);
        if by_frame.insert(frame, stamp).is_some() {
            return Err(wrong(format!("line {line}: frame {frame} is listed twice")));
        }
    }
    if by_frame.is_empty() {
        return Err(wrong("lists no frame".to_owned()));
    }
    for ((before, earlier), (frame, later)) in by_frame.iter().zip(by_frame.iter().skip(1)) {
        if later <= earlier {
            return Err(wrong(format!(
                "timestamps do not rise: frame {frame} has {} ns, frame {before} before it {} ns",
                later.nanos(),
                earlier.nanos()
            )));
        }
    }
    Ok(by_frame)
}
