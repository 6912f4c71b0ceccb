//! The candidates of a frame while it is decided.

use super::blobs::Blob;
use crate::scene::Detection;

/// Which frames show what is behind a candidate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Behind {
    /// Those `lag_frames` away: the ball is elsewhere.
    Far,
    /// Those shortly before and after: what moves behind the ball is nearly where it was.
    Near,
}

/// A candidate, with what its cut-out is made of.
pub struct Found {
    /// As it is answered.
    pub detection: Detection,
    /// Its pixels.
    pub blob: Blob,
    /// What shows what is behind it.
    pub behind: Behind,
}

/// The candidates of a frame, each with its number as it was found.
pub struct Finds(Vec<(usize, Found)>);

impl Finds {
    /// None.
    pub fn new() -> Self {
        Self(Vec::with_capacity(1024))
    }

    /// Forgets all.
    pub fn clear(&mut self) {
        self.0.clear();
    }

    /// Adds one.
    pub fn push(&mut self, detection: Detection, blob: Blob, behind: Behind) {
        let number = self.0.len();
        self.0.push((
            number,
            Found {
                detection,
                blob,
                behind,
            },
        ));
    }

    /// In their order.
    pub fn all(&self) -> impl Iterator<Item = &Found> {
        self.0.iter().map(|(_, found)| found)
    }

    /// Keeps the strongest, those first; of equal ones the first found. Gives how many went.
    pub fn keep_strongest(&mut self, most: usize) -> usize {
        self.0.sort_unstable_by(|(a, one), (b, other)| {
            let stronger = other.detection.strength.total_cmp(&one.detection.strength);
            stronger.then(a.cmp(b))
        });
        let extra = self.0.len().saturating_sub(most);
        self.0.truncate(most);
        extra
    }
}
