//! What `replay` and `solve` share: options of the estimator, and the results folder with what is printed.

use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::{Args, ValueEnum};

use crate::calibration::free::{self, FreeOptions};
use crate::daemon::batch::{Batch, BatchOptions, solve_tracks};
use crate::export::report::{FreeReportInput, ReportInput, TrajectoryRow};
use crate::export::statcast::PlatePlane;
use crate::export::{results, table};
use crate::scene::{Calibration, CalibrationMethod, Rig, Track, WorldFrame};

/// Estimator.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Method {
    /// One maximum-likelihood problem over poses, delays and flights.
    Joint,
    /// The recipe of Kim et al. 2019.
    Kim2019,
}

/// Groups of tracks that became no pitch, named on the terminal; the report names all.
const LEFT_OUT_PRINTED: usize = 4;

/// Plane of the plate at which a location is stated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Plane {
    /// Front of the plate, y = 17/12 ft (Statcast through 2025).
    Front,
    /// Middle of the plate, y = 8.5/12 ft (Statcast from 2026).
    Middle,
}

impl From<Plane> for PlatePlane {
    fn from(plane: Plane) -> Self {
        match plane {
            Plane::Front => Self::Front,
            Plane::Middle => Self::Middle,
        }
    }
}

/// Options of every command that turns tracks into pitches.
#[derive(Debug, Args)]
pub struct SolvingArgs {
    /// Solve with this calibration.json as it is; without it, calibrate from the pitches themselves.
    #[arg(long, value_name = "FILE")]
    pub calibration: Option<PathBuf>,
    /// Estimator of the calibration.
    #[arg(long, value_enum, default_value_t = Method::Joint)]
    pub method: Method,
    /// Plane of the plate location in the table and in pitches.csv.
    #[arg(long, value_enum, default_value_t = Plane::Front)]
    pub plane: Plane,
    /// Folder for pitches.jsonl, pitches.csv, calibration.json, tracks/, results.mcap and report.html.
    #[arg(long, value_name = "DIR", default_value = "pitchd-results")]
    pub out: PathBuf,
    /// Print the pitches as JSON lines instead of the table.
    #[arg(long)]
    pub json: bool,
}

impl SolvingArgs {
    /// The calibration given, if one is.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub fn calibration(&self) -> anyhow::Result<Option<Calibration>> {
        self.calibration.as_deref().map(read_calibration).transpose()
    }

    /// Solves the tracks, writes the results folder, prints the table and the warnings.
    ///
    /// # Errors
    /// No calibration, or a folder that cannot be written.
    pub fn solve_and_write(
        &self,
        (title, rig): (&str, &Rig),
        tracks: &[Track],
        facts: &[(String, String)],
        earlier_warnings: Vec<String>,
    ) -> anyhow::Result<()> {
        let options = BatchOptions {
            method: match self.method {
                Method::Joint => CalibrationMethod::Joint,
                Method::Kim2019 => CalibrationMethod::Kim2019,
            },
            calibration: self.calibration()?,
        };
        let mut batch = match solve_tracks(rig, tracks, &options) {
            Ok(batch) => batch,
            Err(error) => {
                // What was lost or left out is told all the same: it may be why.
                for warning in &earlier_warnings {
                    tell_line!("pitchd: warning: {warning}");
                }
                return Err(error.into());
            }
        };
        batch.warnings.splice(0..0, earlier_warnings);
        let all_warnings = [batch.warnings.as_slice(), &batch.left_out].concat();
        let plane = self.plane.into();
        let report = results::write(
            &self.out,
            &ReportInput {
                title,
                rig,
                calibration: &batch.calibration,
                pitches: &batch.pitches,
                residuals: &batch.residuals,
                warnings: &all_warnings,
                facts,
                plane,
            },
            tracks,
        )?;
        if batch.calibration.world != WorldFrame::HomePlate {
            results::write_trajectory(&self.out, &batch.trajectory(rig.reference_camera().frame_rate_hz))?;
        }
        self.print(rig, &batch, plane, &report)
    }

    /// Solves one thing that moves smoothly: `trajectory.csv`, `calibration.json` and a report.
    ///
    /// # Errors
    /// No calibration, or a folder that cannot be written.
    pub fn solve_and_write_free(
        &self,
        (title, rig): (&str, &Rig),
        tracks: &[Track],
        facts: &[(String, String)],
    ) -> anyhow::Result<()> {
        if self.calibration.is_some() || self.method != Method::Joint {
            anyhow::bail!("--motion free calibrates by itself: it takes neither --calibration nor --method");
        }
        let outcome = free::calibrate(rig, tracks, &FreeOptions::default())?;
        let rows: Vec<_> = outcome
            .trajectory
            .iter()
            .map(|s| TrajectoryRow {
                time_ns: s.time_ns,
                position_m: s.position_m,
                sigma_m: s.sigma_m,
                cameras: u32::try_from(s.cameras).unwrap_or(u32::MAX),
            })
            .collect();
        let mut facts = facts.to_vec();
        facts.push((
            "seen by two cameras".to_owned(),
            format!("{:.1} s, {} samples", outcome.shared_s, rows.len()),
        ));
        facts.push((
            "explained by one motion".to_owned(),
            format!("{:.1} % of the points", 100.0 * outcome.explained_share),
        ));
        let report = results::write_free(
            &self.out,
            &FreeReportInput {
                title,
                rig,
                calibration: &outcome.calibration,
                rows: &rows,
                residuals: &[],
                warnings: &[],
                facts: &facts,
            },
            tracks,
        )?;
        for warning in &outcome.calibration.warnings {
            tell_line!("pitchd: warning: {warning}");
        }
        say!("{}", table::cameras(&outcome.calibration, rig));
        for (name, value) in &facts {
            say_line!("{name}: {value}");
        }
        say_line!("trajectory: {}", self.out.join("trajectory.csv").display());
        say_line!("report: {}", report.display());
        Ok(())
    }

    fn print(&self, rig: &Rig, batch: &Batch, plane: PlatePlane, report: &Path) -> anyhow::Result<()> {
        for warning in batch.calibration.warnings.iter().chain(&batch.warnings) {
            tell_line!("pitchd: warning: {warning}");
        }
        for left in batch.left_out.iter().take(LEFT_OUT_PRINTED) {
            tell_line!("pitchd: warning: {left}");
        }
        if let Some(more @ 1..) = batch.left_out.len().checked_sub(LEFT_OUT_PRINTED) {
            tell_line!(
                "pitchd: warning: {more} more groups of tracks became no pitch: {} tells",
                report.display()
            );
        }
        if self.json {
            say!("{}", results::jsonl(&batch.pitches)?);
        } else {
            say!("{}", table::cameras(&batch.calibration, rig));
            say_line!();
            if batch.calibration.world == WorldFrame::HomePlate {
                say!("{}", table::pitches(&batch.pitches, plane));
            } else {
                say!("{}", table::flights(&batch.flight_rows()));
                say_line!();
                say_line!("trajectory: {}", self.out.join("trajectory.csv").display());
            }
            say_line!();
            say_line!("report: {}", report.display());
        }
        if batch.flights.is_empty() {
            anyhow::bail!("no pitch could be solved (see the warnings)");
        }
        Ok(())
    }
}

fn read_calibration(path: &Path) -> anyhow::Result<Calibration> {
    results::read_calibration(path).context("--calibration")
}
