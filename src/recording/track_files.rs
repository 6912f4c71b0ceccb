//! Track files (design §5): `TRACKS_DIR/<camera id>.csv` with `track,frame,timestamp_ns,x_px,y_px[,…]`.
//!
//! Distorted pixels, stamped exposure midpoints of that camera. The optional columns are `sigma_px` (1σ per
//! axis), or the covariance itself as `var_x_px2,cov_xy_px2,var_y_px2`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use nalgebra::Matrix2;

use crate::geometry::Pixel;
use crate::scene::{CameraId, Track, TrackPoint};
use crate::time::StampedMidpoint;

/// What is wrong with a track file.
#[derive(Debug, thiserror::Error)]
pub enum TrackFileError {
    /// The folder or file cannot be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// Folder or file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// No track file in the folder.
    #[error("{}: no <camera id>.csv in this folder", path.display())]
    Empty {
        /// Folder.
        path: PathBuf,
    },
    /// A file whose name is no camera id.
    #[error("{}: {reason}", path.display())]
    NotACamera {
        /// File.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// A column is missing.
    #[error("{}: no column `{column}` (needs track,frame,timestamp_ns,x_px,y_px)", path.display())]
    MissingColumn {
        /// File.
        path: PathBuf,
        /// Column.
        column: &'static str,
    },
    /// A row is wrong.
    #[error("{}:{line}: {reason}", path.display())]
    Row {
        /// File.
        path: PathBuf,
        /// Line, from 1.
        line: u64,
        /// What is wrong.
        reason: String,
    },
}

/// Reads every `<camera id>.csv` of a folder, by rising camera id, tracks by number, points by rising stamp.
///
/// # Errors
/// [`TrackFileError`] with file and line.
pub fn read_track_folder(folder: &Path) -> Result<Vec<Track>, TrackFileError> {
    let io = |source| TrackFileError::Io {
        path: folder.to_owned(),
        source,
    };
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(io)? {
        let path = entry.map_err(io)?.path();
        if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("csv")) {
            files.push(path);
        }
    }
    if files.is_empty() {
        return Err(TrackFileError::Empty {
            path: folder.to_owned(),
        });
    }
    files.sort();
    let mut tracks = Vec::new();
    for path in files {
        let stem = path
            .file_stem()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        let camera = CameraId::new(&stem).map_err(|e| TrackFileError::NotACamera {
            path: path.clone(),
            reason: e.to_string(),
        })?;
        tracks.extend(read_track_file(&path, &camera)?);
    }
    Ok(tracks)
}

/// Reads one camera's file. A row repeated to the letter (a frame delivered twice) counts once.
///
/// # Errors
/// [`TrackFileError`] with file and line.
pub fn read_track_file(path: &Path, camera: &CameraId) -> Result<Vec<Track>, TrackFileError> {
    let row_error = |line, reason: String| TrackFileError::Row {
        path: path.to_owned(),
        line,
        reason,
    };
    let file = std::fs::File::open(path).map_err(|source| TrackFileError::Io {
        path: path.to_owned(),
        source,
    })?;
    let mut reader = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .comment(Some(b'#'))
        .from_reader(file);
    let header = reader.headers().map_err(|e| row_error(1, e.to_string()))?.clone();
    let columns = Columns::find(path, &header)?;
    let mut tracks: BTreeMap<u32, Vec<TrackPoint>> = BTreeMap::new();
    for record in reader.records() {
        let record = record.map_err(|e| {
            let line = e.position().map_or(0, csv::Position::line);
            row_error(line, short_reason(&e))
        })?;
        let line = record.position().map_or(0, csv::Position::line);
        let (track, point) = columns.parse(&record).map_err(|reason| row_error(line, reason))?;
        tracks.entry(track).or_default().push(point);
    }
    Ok(tracks
        .into_iter()
        .map(|(track, mut points)| {
            points.sort_by_key(|p| (p.stamped, p.frame));
            points.dedup();
            Track {
                camera: camera.clone(),
                track,
                points,
            }
        })
        .collect())
}

fn short_reason(error: &csv::Error) -> String {
    match error.kind() {
        csv::ErrorKind::UnequalLengths {
            expected_len, len, ..
        } => format!("{len} fields where the header has {expected_len}"),
        csv::ErrorKind::Utf8 { .. } => "not UTF-8 text".to_owned(),
        _ => error.to_string(),
    }
}

struct Columns {
    track: usize,
    frame: usize,
    timestamp: usize,
    x: usize,
    y: usize,
    sigma: Option<usize>,
    covariance: Option<[usize; 3]>,
}

impl Columns {
    fn find(path: &Path, header: &csv::StringRecord) -> Result<Self, TrackFileError> {
        // A spreadsheet may have put a byte-order mark in front.
        let at = |name: &str| {
            header
                .iter()
                .position(|h| h.trim_start_matches('\u{feff}') == name)
        };
        let need = |name: &'static str| {
            at(name).ok_or_else(|| TrackFileError::MissingColumn {
                path: path.to_owned(),
                column: name,
            })
        };
        let covariance = match (at("var_x_px2"), at("cov_xy_px2"), at("var_y_px2")) {
            (Some(xx), Some(xy), Some(yy)) => Some([xx, xy, yy]),
            _ => None,
        };
        Ok(Self {
            track: need("track")?,
            frame: need("frame")?,
            timestamp: need("timestamp_ns")?,
            x: need("x_px")?,
            y: need("y_px")?,
            sigma: at("sigma_px"),
            covariance,
        })
    }

    fn parse(&self, record: &csv::StringRecord) -> Result<(u32, TrackPoint), String> {
        let x = number(record, self.x, "x_px")?;
        let y = number(record, self.y, "y_px")?;
        let covariance_px2 = match (self.covariance, self.sigma) {
            (Some(columns), _) if !field(record, columns[0]).is_empty() => {
                let xx = number(record, columns[0], "var_x_px2")?;
                let xy = number(record, columns[1], "cov_xy_px2")?;
                let yy = number(record, columns[2], "var_y_px2")?;
                if !(xx > 0.0 && yy > 0.0 && xx * yy > xy * xy) {
                    return Err("the covariance is not positive definite".to_owned());
                }
                Some(Matrix2::new(xx, xy, xy, yy))
            }
            (_, Some(column)) if !field(record, column).is_empty() => {
                let sigma = number(record, column, "sigma_px")?;
                if sigma <= 0.0 {
                    return Err(format!("sigma_px = {sigma} is not positive"));
                }
                Some(Matrix2::identity() * (sigma * sigma))
            }
            _ => None,
        };
        Ok((
            integer(record, self.track, "track")?,
            TrackPoint {
                frame: integer(record, self.frame, "frame")?,
                stamped: StampedMidpoint::from_nanos(integer(record, self.timestamp, "timestamp_ns")?),
                pixel: Pixel::new(x, y),
                covariance_px2,
            },
        ))
    }
}

fn field(record: &csv::StringRecord, column: usize) -> &str {
    record.get(column).unwrap_or("")
}

fn number(record: &csv::StringRecord, column: usize, name: &str) -> Result<f64, String> {
    let text = field(record, column);
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value.abs() < 1e9 => Ok(value),
        _ if text.is_empty() => Err(format!("`{name}` is missing")),
        _ => Err(format!("`{name}` = {text:?} is no usable number")),
    }
}

fn integer<T: std::str::FromStr>(record: &csv::StringRecord, column: usize, name: &str) -> Result<T, String> {
    let text = field(record, column);
    text.parse().map_err(|_| {
        if text.is_empty() {
            format!("`{name}` is missing")
        } else {
            format!("`{name}` = {text:?} is no whole number in range")
        }
    })
}

/// Writes `<folder>/<camera id>.csv` for every camera that has tracks; the folder is made.
///
/// # Errors
/// [`TrackFileError::Io`] with the file.
pub fn write_track_folder(folder: &Path, tracks: &[Track]) -> Result<(), TrackFileError> {
    let io = |path: &Path| {
        let path = path.to_owned();
        move |source| TrackFileError::Io { path, source }
    };
    std::fs::create_dir_all(folder).map_err(io(folder))?;
    let mut cameras: BTreeMap<&CameraId, Vec<&Track>> = BTreeMap::new();
    for track in tracks {
        cameras.entry(&track.camera).or_default().push(track);
    }
    for (camera, tracks) in cameras {
        let path = folder.join(format!("{camera}.csv"));
        std::fs::write(&path, track_csv(&tracks)).map_err(io(&path))?;
    }
    Ok(())
}

/// Appends a track to `<folder>/<camera id>.csv`; folder and file are made where they are missing.
///
/// # Errors
/// [`TrackFileError::Io`] with the file.
pub fn append_track(folder: &Path, track: &Track) -> Result<(), TrackFileError> {
    use std::io::Write as _;
    let path = folder.join(format!("{}.csv", track.camera));
    let append = || {
        std::fs::create_dir_all(folder)?;
        let mut file = std::fs::OpenOptions::new()
            .create(true)
            .append(true)
            .open(&path)?;
        let mut text = String::new();
        if file.metadata()?.len() == 0 {
            text = format!("{HEADER}{COVARIANCE_HEADER}\n");
        }
        write_rows(&mut text, track, true);
        file.write_all(text.as_bytes())
    };
    append().map_err(|source| TrackFileError::Io {
        path: path.clone(),
        source,
    })
}

const HEADER: &str = "track,frame,timestamp_ns,x_px,y_px";
const COVARIANCE_HEADER: &str = ",sigma_px,var_x_px2,cov_xy_px2,var_y_px2";

fn track_csv(tracks: &[&Track]) -> String {
    let with_covariance = tracks
        .iter()
        .flat_map(|t| &t.points)
        .any(|p| p.covariance_px2.is_some());
    let covariance = if with_covariance { COVARIANCE_HEADER } else { "" };
    let mut text = format!("{HEADER}{covariance}\n");
    for track in tracks {
        write_rows(&mut text, track, with_covariance);
    }
    text
}

fn write_rows(text: &mut String, track: &Track, with_covariance: bool) {
    use std::fmt::Write as _;
    for p in &track.points {
        // Writing to a String cannot fail.
        let _ = write!(
            text,
            "{},{},{},{:.4},{:.4}",
            track.track,
            p.frame,
            p.stamped.nanos(),
            p.pixel.x,
            p.pixel.y
        );
        if let Some(c) = p.covariance_px2 {
            let sigma = (0.5 * c.trace()).sqrt();
            let _ = write!(
                text,
                ",{sigma:.4},{:.3e},{:.3e},{:.3e}",
                c[(0, 0)],
                c[(0, 1)],
                c[(1, 1)]
            );
        } else if with_covariance {
            text.push_str(",,,,");
        }
        text.push('\n');
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Vec<Track>, TrackFileError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("first.csv");
        std::fs::write(&path, text).unwrap();
        read_track_folder(folder.path())
    }

    #[test]
    fn what_is_written_reads_back() {
        let camera = CameraId::new("first").unwrap();
        let point = |frame: u64, covariance_px2| TrackPoint {
            frame,
            stamped: StampedMidpoint::from_nanos(1_775_001_600_000_000_007 + frame as i64),
            pixel: Pixel::new(12.25, 99.5),
            covariance_px2,
        };
        let track = Track {
            camera,
            track: 4,
            points: vec![
                point(1, None),
                point(2, Some(Matrix2::new(0.04, 0.01, 0.01, 0.09))),
            ],
        };
        let folder = tempfile::tempdir().unwrap();
        write_track_folder(folder.path(), std::slice::from_ref(&track)).unwrap();
        assert_eq!(read_track_folder(folder.path()).unwrap(), vec![track]);
    }

    #[test]
    fn tracks_are_appended_one_by_one() {
        let folder = tempfile::tempdir().unwrap();
        let made = |track| Track {
            camera: CameraId::new("first").unwrap(),
            track,
            points: vec![TrackPoint {
                frame: u64::from(track),
                stamped: StampedMidpoint::from_nanos(i64::from(track)),
                pixel: Pixel::new(1.5, 2.5),
                covariance_px2: Some(Matrix2::new(0.04, 0.01, 0.01, 0.09)),
            }],
        };
        for track in [made(1), made(2)] {
            append_track(&folder.path().join("tracks"), &track).unwrap();
        }
        let read = read_track_folder(&folder.path().join("tracks")).unwrap();
        assert_eq!(read, [made(1), made(2)]);
    }

    #[test]
    fn columns_may_stand_in_any_order_and_a_row_given_twice_counts_once() {
        let tracks =
            read("y_px,x_px,frame,track,timestamp_ns\n2,1,7,0,70\n2,1,7,0,70\n4,3,6,0,60\n").unwrap();
        assert_eq!(tracks[0].points.len(), 2);
        assert_eq!(tracks[0].points[0].pixel, Pixel::new(3.0, 4.0));
    }

    #[test]
    fn each_bad_row_is_named() {
        let head = "track,frame,timestamp_ns,x_px,y_px\n0,1,10,1,1\n";
        let cases = [
            (
                format!("{head}0,2,,1,1\n"),
                "first.csv:3: `timestamp_ns` is missing",
            ),
            (
                format!("{head}0,2,20,nan,1\n"),
                "first.csv:3: `x_px` = \"nan\" is no usable number",
            ),
            (
                format!("{head}0,2,20,1\n"),
                "first.csv:3: 4 fields where the header has 5",
            ),
            (
                format!("{head}-1,2,20,1,1\n"),
                "first.csv:3: `track` = \"-1\" is no whole number",
            ),
            ("track,frame,x_px,y_px\n".to_owned(), "no column `timestamp_ns`"),
        ];
        for (text, expected) in cases {
            let told = read(&text).unwrap_err().to_string();
            assert!(told.contains(expected), "{told}");
        }
        let empty = tempfile::tempdir().unwrap();
        assert!(
            read_track_folder(empty.path())
                .unwrap_err()
                .to_string()
                .contains("no <camera id>.csv")
        );
    }
}
