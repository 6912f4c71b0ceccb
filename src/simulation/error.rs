//! What can go wrong between a scenario and its products.

use std::path::PathBuf;

/// Why a scenario could not be simulated.
#[derive(Debug, thiserror::Error)]
pub enum SimulationError {
    /// The scenario file could not be read.
    #[error("{path}: {source}")]
    Read {
        /// File.
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
    /// Not a scenario: bad TOML, an unknown key, a wrong type.
    #[error("{path}: {message}")]
    Parse {
        /// File.
        path: PathBuf,
        /// Line, column and what is wrong there.
        message: String,
    },
    /// A value out of its range, or keys that contradict each other.
    #[error("{path}: {key}: {problem}")]
    Value {
        /// File, or `scenario` when built by a program.
        path: PathBuf,
        /// Dotted key.
        key: String,
        /// What is wrong and what would be right.
        problem: String,
    },
    /// A product could not be written.
    #[error("{path}: {source}")]
    Write {
        /// File or folder.
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
}

impl SimulationError {
    /// A value error of a scenario whose file is not known yet.
    pub(super) fn value(key: impl Into<String>, problem: impl Into<String>) -> Self {
        Self::Value {
            path: PathBuf::from("scenario"),
            key: key.into(),
            problem: problem.into(),
        }
    }

    /// The same error, of that file.
    pub(super) fn in_file(self, file: &std::path::Path) -> Self {
        match self {
            Self::Value { key, problem, .. } => Self::Value {
                path: file.to_owned(),
                key,
                problem,
            },
            other => other,
        }
    }
}
