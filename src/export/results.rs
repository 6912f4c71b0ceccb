//! The results folder (design §5): written by `replay` and `solve`, read back by `export` and `evaluate`.
//!
//! Every file is written beside its place and renamed into it, so a reader never sees half of one.

use std::path::{Path, PathBuf};

use crate::recording::{ViewerInput, write_track_folder, write_viewer_file};
use crate::scene::{Calibration, FrameSearch, Pitch, Track};

use super::error::ExportError;
use super::report::{self, FreeReportInput, ReportInput, TrajectoryRow};
use super::statcast;

/// What can be read back.
#[derive(Debug, Clone, PartialEq)]
pub struct Results {
    /// Every pitch, in the file's order.
    pub pitches: Vec<Pitch>,
    /// The calibration they were solved with.
    pub calibration: Calibration,
}

/// Writes `pitches.jsonl`, `pitches.csv`, `calibration.json`, `tracks/<camera>.csv`, `results.mcap` (for viewers)
/// and `report.html`; gives the report's path. Track files of cameras without a track in `tracks` are left as they are.
///
/// # Errors
/// [`ExportError::Write`] with the path; [`ExportError::NotFinite`] when a number had no JSON form, after
/// everything else is written.
pub fn write(folder: &Path, input: &ReportInput<'_>, tracks: &[Track]) -> Result<PathBuf, ExportError> {
    std::fs::create_dir_all(folder).map_err(ExportError::writing(folder))?;
    let report = folder.join("report.html");
    replace(&folder.join("pitches.jsonl"), &jsonl(input.pitches)?)?;
    replace(
        &folder.join("pitches.csv"),
        &statcast::csv(input.pitches, input.plane),
    )?;
    let calibration_json = calibration_json(input.calibration)?;
    replace(&folder.join("calibration.json"), &calibration_json)?;
    write_tracks(folder, tracks)?;
    let shown = ViewerInput {
        calibration_json: &calibration_json,
        calibration: input.calibration,
        pitches: input.pitches,
        tracks,
    };
    write_viewer_file(&folder.join("results.mcap"), &shown)?;
    replace(&report, &report::html(input))?;
    read(folder).map_err(not_finite)?;
    Ok(report)
}

/// Writes `trajectory.csv`, `calibration.json`, `tracks/<camera>.csv` and `report.html` of a free motion;
/// gives the report's path.
///
/// # Errors
/// As [`write`].
pub fn write_free(
    folder: &Path,
    input: &FreeReportInput<'_>,
    tracks: &[Track],
) -> Result<PathBuf, ExportError> {
    std::fs::create_dir_all(folder).map_err(ExportError::writing(folder))?;
    let (report, calibration) = (folder.join("report.html"), folder.join("calibration.json"));
    replace(&folder.join("trajectory.csv"), &trajectory_csv(input.rows))?;
    replace(&calibration, &calibration_json(input.calibration)?)?;
    write_tracks(folder, tracks)?;
    replace(&report, &report::free_html(input))?;
    read_calibration(&calibration).map_err(not_finite)?;
    Ok(report)
}

/// Writes `trajectory.csv` alone: flights that are no pitches because the world has no plate.
///
/// # Errors
/// [`ExportError::Write`] with the path.
pub fn write_trajectory(folder: &Path, rows: &[TrajectoryRow]) -> Result<PathBuf, ExportError> {
    let path = folder.join("trajectory.csv");
    replace(&path, &trajectory_csv(rows))?;
    Ok(path)
}

const SEARCH_FILE: &str = "detection.json";

/// Writes what the frames gave, whatever becomes of it: `tracks/<camera>.csv`, and `detection.json` with what searching
/// each camera's frames cost, how late it answered and what it left out.
///
/// # Errors
/// [`ExportError::Write`] with the path.
pub fn write_search(folder: &Path, cameras: &[FrameSearch], tracks: &[Track]) -> Result<(), ExportError> {
    std::fs::create_dir_all(folder).map_err(ExportError::writing(folder))?;
    let path = folder.join(SEARCH_FILE);
    let text = serde_json::to_string_pretty(cameras).map_err(|error| ExportError::Line {
        path: path.clone(),
        line: 1,
        reason: error.to_string(),
    })?;
    replace(&path, &text)?;
    write_tracks(folder, tracks)
}

/// Reads the `detection.json` of a results folder; empty where there is none.
///
/// # Errors
/// [`ExportError`] with file and line.
pub fn read_search(folder: &Path) -> Result<Vec<FrameSearch>, ExportError> {
    let path = folder.join(SEARCH_FILE);
    let text = match std::fs::read_to_string(&path) {
        Ok(text) => text,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(ExportError::reading(&path)(error)),
    };
    serde_json::from_str(&text).map_err(|error| ExportError::Line {
        path,
        line: error.line(),
        reason: format!("no account of a search: {}", without_place(&error)),
    })
}

/// One row a frame of the reference camera: nanoseconds and metres to the micrometre.
fn trajectory_csv(rows: &[TrajectoryRow]) -> String {
    let mut text = "time_ns,x_m,y_m,z_m,sigma_x_m,sigma_y_m,sigma_z_m,cameras\n".to_owned();
    for row in rows {
        let ([x, y, z], [sx, sy, sz]) = (row.position_m, row.sigma_m);
        text += &format!(
            "{},{x:.6},{y:.6},{z:.6},{sx:.6},{sy:.6},{sz:.6},{}\n",
            row.time_ns, row.cameras
        );
    }
    text
}

/// What was written must read back; serde_json writes a NaN as null and says nothing.
fn not_finite(error: ExportError) -> ExportError {
    match error {
        ExportError::Line { path, line, reason } => ExportError::NotFinite { path, line, reason },
        other => other,
    }
}

/// Reads `pitches.jsonl` and `calibration.json` of a results folder.
///
/// # Errors
/// [`ExportError`] with file and line.
pub fn read(folder: &Path) -> Result<Results, ExportError> {
    Ok(Results {
        pitches: read_pitches(&folder.join("pitches.jsonl"))?,
        calibration: read_calibration(&folder.join("calibration.json"))?,
    })
}

/// Reads a `pitches.jsonl`. Blank lines are skipped.
///
/// # Errors
/// [`ExportError`] with file and line.
pub fn read_pitches(path: &Path) -> Result<Vec<Pitch>, ExportError> {
    let text = std::fs::read_to_string(path).map_err(ExportError::reading(path))?;
    text.lines()
        .enumerate()
        .filter(|(_, line)| !line.trim().is_empty())
        .map(|(i, line)| {
            serde_json::from_str(line).map_err(|error| ExportError::Line {
                path: path.to_owned(),
                line: i + 1,
                reason: format!("no pitch: {}", without_place(&error)),
            })
        })
        .collect()
}

/// Reads a `calibration.json`.
///
/// # Errors
/// [`ExportError`] with file and line.
pub fn read_calibration(path: &Path) -> Result<Calibration, ExportError> {
    let text = std::fs::read_to_string(path).map_err(ExportError::reading(path))?;
    let calibration: Calibration = serde_json::from_str(&text).map_err(|error| ExportError::Line {
        path: path.to_owned(),
        line: error.line(),
        reason: format!("no calibration: {}", without_place(&error)),
    })?;
    let needed = calibration.parameters.len();
    let rows = &calibration.covariance;
    if rows.len() != needed || rows.iter().any(|row| row.len() != needed) {
        return Err(ExportError::Line {
            path: path.to_owned(),
            line: 1,
            reason: format!("no calibration: its covariance is not {needed}×{needed}, as its parameters ask"),
        });
    }
    Ok(calibration)
}

/// One pitch a line.
///
/// # Errors
/// [`ExportError::Line`]: cannot happen for pitches as the type has them.
pub fn jsonl(pitches: &[Pitch]) -> Result<String, ExportError> {
    let mut text = String::new();
    for (i, pitch) in pitches.iter().enumerate() {
        text += &serde_json::to_string(pitch).map_err(|error| ExportError::Line {
            path: PathBuf::from("pitches.jsonl"),
            line: i + 1,
            reason: error.to_string(),
        })?;
        text.push('\n');
    }
    Ok(text)
}

fn calibration_json(calibration: &Calibration) -> Result<String, ExportError> {
    let mut text = serde_json::to_string_pretty(calibration).map_err(|error| ExportError::Line {
        path: PathBuf::from("calibration.json"),
        line: 1,
        reason: error.to_string(),
    })?;
    text.push('\n');
    Ok(text)
}

fn write_tracks(folder: &Path, tracks: &[Track]) -> Result<(), ExportError> {
    if tracks.is_empty() {
        return Ok(());
    }
    let (part, place) = (folder.join(".tracks.part"), folder.join("tracks"));
    write_track_folder(&part, tracks)?;
    std::fs::create_dir_all(&place).map_err(ExportError::writing(&place))?;
    let listing = std::fs::read_dir(&part).map_err(ExportError::writing(&part))?;
    for entry in listing {
        let entry = entry.map_err(ExportError::writing(&part))?;
        let target = place.join(entry.file_name());
        std::fs::rename(entry.path(), &target).map_err(ExportError::writing(&target))?;
    }
    std::fs::remove_dir(&part).map_err(ExportError::writing(&part))
}

/// Writes `text` beside `path`, then renames it into place.
///
/// # Errors
/// [`ExportError::Write`] with the path.
pub fn replace(path: &Path, text: &str) -> Result<(), ExportError> {
    let mut part = path.as_os_str().to_owned();
    part.push(".part");
    let part = PathBuf::from(part);
    std::fs::write(&part, text).map_err(ExportError::writing(&part))?;
    std::fs::rename(&part, path).map_err(ExportError::writing(path))
}

/// serde's message without its own "at line 1 column 9": the line is ours to say.
fn without_place(error: &serde_json::Error) -> String {
    let text = error.to_string();
    let place = format!(" at line {} column {}", error.line(), error.column());
    format!("{} (column {})", text.replace(&place, ""), error.column())
}

#[cfg(test)]
mod tests {
    use super::super::fixture;
    use super::super::statcast::PlatePlane;
    use super::*;
    use crate::geometry::Pixel;
    use crate::scene::{CameraId, Rig, TrackPoint};
    use crate::time::StampedMidpoint;

    fn input<'a>(rig: &'a Rig, calibration: &'a Calibration, pitches: &'a [Pitch]) -> ReportInput<'a> {
        ReportInput {
            title: "a session",
            rig,
            calibration,
            pitches,
            residuals: &[],
            warnings: &[],
            facts: &[],
            plane: PlatePlane::Front,
        }
    }

    fn track() -> Track {
        Track {
            camera: CameraId::new("first").unwrap(),
            track: 1,
            points: vec![TrackPoint {
                frame: 7,
                stamped: StampedMidpoint::from_nanos(70),
                pixel: Pixel::new(1.5, 2.5),
                covariance_px2: None,
            }],
        }
    }

    #[test]
    fn what_is_written_reads_back() {
        let (rig, calibration, pitches) = (fixture::rig(), fixture::calibration(), fixture::pitches());
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("new/out");
        // Twice: the second replaces the first.
        for _ in 0..2 {
            let report = write(&out, &input(&rig, &calibration, &pitches), &[track()]).unwrap();
            assert_eq!(report, out.join("report.html"));
        }
        let back = read(&out).unwrap();
        // Not assert_eq: it would print every sample.
        assert!(back.pitches == pitches);
        assert_eq!(back.calibration.parameters, calibration.parameters);
        assert_eq!(back.calibration.cameras[1].capture_delay_s, 0.003_21);
        let tracks = crate::recording::read_track_folder(&out.join("tracks")).unwrap();
        assert_eq!(tracks, [track()]);
        let mut names: Vec<String> = std::fs::read_dir(&out)
            .unwrap()
            .map(|e| e.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        assert_eq!(
            names,
            [
                "calibration.json",
                "pitches.csv",
                "pitches.jsonl",
                "report.html",
                "results.mcap",
                "tracks"
            ]
        );
    }

    #[test]
    fn a_free_motion_has_a_row_a_frame() {
        let (rig, calibration) = (fixture::rig(), fixture::calibration());
        let row = |i: i64| TrajectoryRow {
            time_ns: 1_775_001_600_000_000_007 + i,
            position_m: [1.0, -2.5, 0.125],
            sigma_m: [0.01, 0.02, 0.03],
            cameras: 2,
        };
        let rows = [row(0), row(1)];
        let input = FreeReportInput {
            title: "drone",
            rig: &rig,
            calibration: &calibration,
            rows: &rows,
            residuals: &[],
            warnings: &[],
            facts: &[],
        };
        let folder = tempfile::tempdir().unwrap();
        write_free(folder.path(), &input, &[track()]).unwrap();
        let text = std::fs::read_to_string(folder.path().join("trajectory.csv")).unwrap();
        assert_eq!(
            text.lines().nth(1).unwrap(),
            "1775001600000000007,1.000000,-2.500000,0.125000,0.010000,0.020000,0.030000,2"
        );
        assert_eq!(text.lines().count(), 3);
        for name in ["calibration.json", "report.html", "tracks/first.csv"] {
            assert!(folder.path().join(name).exists(), "{name}");
        }
    }

    #[test]
    fn a_broken_line_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pitches.jsonl");
        let good = jsonl(&fixture::pitches()).unwrap();
        std::fs::write(&path, format!("{good}\n{{\"pitch\":\"one\"}}\n")).unwrap();
        let told = read_pitches(&path).unwrap_err().to_string();
        assert!(told.contains("pitches.jsonl:8: no pitch: invalid type"), "{told}");
        let told = read(folder.path().join("none").as_path())
            .unwrap_err()
            .to_string();
        assert!(
            told.starts_with("cannot read ") && told.contains("pitches.jsonl"),
            "{told}"
        );
        let path = folder.path().join("calibration.json");
        std::fs::write(&path, "{\n  \"version\": 1,\n  \"method\": \"fast\"\n}").unwrap();
        let told = read_calibration(&path).unwrap_err().to_string();
        assert!(
            told.contains("calibration.json:3: no calibration: unknown variant `fast`"),
            "{told}"
        );
    }

    #[test]
    fn a_number_that_is_not_finite_is_told_after_everything_is_written() {
        let (rig, calibration, mut pitches) = (fixture::rig(), fixture::calibration(), fixture::pitches());
        pitches[2].release_speed_mps = f64::NAN;
        let folder = tempfile::tempdir().unwrap();
        let told = write(folder.path(), &input(&rig, &calibration, &pitches), &[]).unwrap_err();
        assert!(matches!(told, ExportError::NotFinite { line: 3, .. }), "{told}");
        assert!(folder.path().join("report.html").exists());
    }

    #[test]
    fn a_folder_that_cannot_be_made_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        std::fs::write(&file, "").unwrap();
        let (rig, calibration) = (fixture::rig(), fixture::calibration());
        let told = write(&file.join("out"), &input(&rig, &calibration, &[]), &[])
            .unwrap_err()
            .to_string();
        assert!(
            told.starts_with("cannot write ") && told.contains("file/out"),
            "{told}"
        );
    }
}
