//! What can go wrong when results are written or read back.

use std::path::{Path, PathBuf};

use crate::recording::{RecordingError, TrackFileError};

/// A results folder or export that cannot be written or read.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// A file or folder cannot be written.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// File or folder.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A file cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// File.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A line is no such record.
    #[error("{}:{line}: {reason}", path.display())]
    Line {
        /// File.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// What is wrong with it.
        reason: String,
    },
    /// Written, but with numbers that are not finite, which JSON has no word for; it will not read back.
    #[error("{}:{line}: written with a number that is not finite ({reason}); treat it as lost", path.display())]
    NotFinite {
        /// File.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// Which field.
        reason: String,
    },
    /// A track file.
    #[error(transparent)]
    Tracks(#[from] TrackFileError),
    /// The file for viewers.
    #[error(transparent)]
    Viewer(#[from] RecordingError),
}

impl ExportError {
    /// Turns an I/O error of writing `path` into ours.
    pub(super) fn writing(path: &Path) -> impl FnOnce(std::io::Error) -> Self + use<> {
        let path = path.to_owned();
        move |source| Self::Write { path, source }
    }

    /// Turns an I/O error of reading `path` into ours.
    pub(super) fn reading(path: &Path) -> impl FnOnce(std::io::Error) -> Self + use<> {
        let path = path.to_owned();
        move |source| Self::Read { path, source }
    }
}
