//! Camera identifiers.

use std::fmt;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

/// A camera's name in rig files, track files, topics and results: 1–40 of `a–z A–Z 0–9 _ -`.
/// (No dots or slashes: it becomes a file name and a message subject.)
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct CameraId(Arc<str>);

/// A string that cannot name a camera.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("camera id {0:?}: use 1 to 40 letters, digits, '_' or '-'")]
pub struct CameraIdError(pub String);

impl CameraId {
    /// Checks and takes a name.
    pub fn new(name: &str) -> Result<Self, CameraIdError> {
        let fits = (1..=40).contains(&name.len())
            && name
                .bytes()
                .all(|b| b.is_ascii_alphanumeric() || b == b'_' || b == b'-');
        if fits {
            Ok(Self(name.into()))
        } else {
            Err(CameraIdError(name.to_owned()))
        }
    }
    /// The name.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for CameraId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl TryFrom<String> for CameraId {
    type Error = CameraIdError;
    fn try_from(name: String) -> Result<Self, Self::Error> {
        Self::new(&name)
    }
}

impl From<CameraId> for String {
    fn from(id: CameraId) -> Self {
        id.0.as_ref().to_owned()
    }
}
