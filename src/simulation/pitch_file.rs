//! Pitches from a CSV file with Statcast columns (`x0 z0 vx0 vy0 vz0 ax ay az release_pos_y`, feet).

use std::path::Path;

use super::error::SimulationError;
use super::scenario::{NineNumbers, PitchFile, PitchSpec};

/// Reads the rows asked for; a row that lacks a number is an error that names line and column.
pub(super) fn read(path: &Path, wanted: &PitchFile) -> Result<Vec<PitchSpec>, SimulationError> {
    let parse = |message: String| SimulationError::Parse {
        path: path.to_owned(),
        message,
    };
    let text = std::fs::read_to_string(path).map_err(|source| SimulationError::Read {
        path: path.to_owned(),
        source,
    })?;
    let mut reader = csv::Reader::from_reader(text.trim_start_matches('\u{feff}').as_bytes());
    let columns = reader.headers().map_err(|e| parse(e.to_string()))?.clone();
    let rows = reader
        .records()
        .collect::<Result<Vec<_>, _>>()
        .map_err(|e| parse(e.to_string()))?;
    let chosen = wanted.rows.clone().unwrap_or_else(|| (0..rows.len()).collect());
    let mut pitches = Vec::with_capacity(chosen.len());
    for (order, index) in chosen.into_iter().enumerate() {
        let row = rows
            .get(index)
            .ok_or_else(|| parse(format!("row {index}: the file has {} rows", rows.len())))?;
        let text_of = |column: &str| row.get(columns.iter().position(|c| c == column)?);
        let number = |column: &str| {
            let value = text_of(column).and_then(|v| v.trim().parse::<f64>().ok());
            value
                .filter(|v| v.is_finite())
                .ok_or_else(|| parse(format!("row {index}: column {column} is missing or no number")))
        };
        pitches.push(PitchSpec {
            name: text_of("pitch_type").unwrap_or_default().to_owned(),
            start_s: Some(5.0 + wanted.interval_s * order as f64),
            statcast: Some(NineNumbers {
                x0: number("x0")?,
                z0: number("z0")?,
                vx0: number("vx0")?,
                vy0: number("vy0")?,
                vz0: number("vz0")?,
                ax: number("ax")?,
                ay: number("ay")?,
                az: number("az")?,
                release_pos_y: number("release_pos_y").unwrap_or(54.5),
            }),
            model: wanted.model,
            ..PitchSpec::default()
        });
    }
    Ok(pitches)
}
