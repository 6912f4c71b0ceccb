//! Reads what people write (rig files) into the rooms' own types; every error names file, line and key.

mod daemon_file;
mod nearest;
mod portable;
mod rig_file;

pub use daemon_file::{CameraConnection, DaemonConfig, RecordConfig, RecordMode, load_daemon, parse_daemon};
pub use nearest::nearest;
pub use portable::portable_rig;
pub use rig_file::{load_rig, parse_rig};

use std::path::{Path, PathBuf};

/// What is wrong with a file a person wrote.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("{}: cannot be read: {source}", path.display())]
    Unreadable {
        /// File.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A key, a type or the syntax is wrong.
    #[error("{}:{line}: {reason}", path.display())]
    Invalid {
        /// File.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// What and, where there is one, the nearest right word.
        reason: String,
    },
    /// Keys that are right one by one do not fit together.
    #[error("{}: {reason}", path.display())]
    Inconsistent {
        /// File.
        path: PathBuf,
        /// Names the camera or key.
        reason: String,
    },
}

impl ConfigError {
    /// Turns a TOML error into one line: place, what is wrong, and the nearest known key.
    fn from_toml(path: &Path, text: &str, error: &toml::de::Error) -> Self {
        let line = error.span().map_or(1, |span| line_of(text, span.start));
        let mut reason = nearest::explain(error.message());
        // A wrong type names no key of its own.
        let key = text.lines().nth(line - 1).and_then(|l| l.split_once('='));
        if let Some((key, _)) = key.filter(|_| reason.starts_with("invalid")) {
            reason = format!("`{}`: {reason}", key.trim());
        }
        Self::Invalid {
            path: path.to_owned(),
            line,
            reason,
        }
    }
}

fn line_of(text: &str, offset: usize) -> usize {
    text.bytes().take(offset).filter(|b| *b == b'\n').count() + 1
}
