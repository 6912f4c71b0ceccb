//! The candidates of a frame while it is decided.

use super::blobs::Blob;
use super::kernel::{TILE_HEIGHT_PX, TILE_WIDTH_PX};
use super::regions::{REGION_BANDS, REGION_TILES};
use crate::scene::Detection;

const REGION_PX: [usize; 2] = [REGION_TILES * TILE_WIDTH_PX, REGION_BANDS * TILE_HEIGHT_PX];
/// Frames that tell how restless a region is.
const LATELY_FRAMES: f32 = 128.0;

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
    /// Whether it is where a ball is expected.
    pub expected: bool,
}

/// How many candidates each region of the picture has had lately. Where a crowd waves there are some in every frame, and
/// of more than can be answered those go first: a ball before the wall below it is not to go for them.
pub struct Restless {
    columns: usize,
    /// Candidates of a frame, the mean of about the last [`LATELY_FRAMES`].
    rates: Vec<f32>,
}

impl Restless {
    /// Of an image of this size.
    pub fn new(width_px: usize, height_px: usize) -> Self {
        let columns = width_px.div_ceil(REGION_PX[0]);
        Self {
            columns,
            rates: vec![0.0; columns * height_px.div_ceil(REGION_PX[1])],
        }
    }

    /// Takes the places of a frame's blobs.
    pub fn learn(&mut self, blobs: &[Blob]) {
        for rate in &mut self.rates {
            *rate -= *rate / LATELY_FRAMES;
        }
        for blob in blobs {
            let place = self.place(blob);
            if let Some(rate) = self.rates.get_mut(place) {
                *rate += 1.0 / LATELY_FRAMES;
            }
        }
    }

    /// What strength counts for here when there are too many: 1 where nothing was, down to a fifth.
    pub fn share(&self, blob: &Blob) -> f64 {
        let rate = self.rates.get(self.place(blob)).copied().unwrap_or(0.0);
        1.0 / (1.0 + 4.0 * f64::from(rate.min(1.0)))
    }

    fn place(&self, blob: &Blob) -> usize {
        blob.top.midpoint(blob.bottom) / REGION_PX[1] * self.columns
            + blob.left.midpoint(blob.right) / REGION_PX[0]
    }
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
    pub fn push(&mut self, found: Found) {
        let number = self.0.len();
        self.0.push((number, found));
    }

    /// In their order.
    pub fn all(&self) -> impl Iterator<Item = &Found> {
        self.0.iter().map(|(_, found)| found)
    }

    /// Keeps the strongest, those first; of equal ones the first found. Of too many, those expected stay first, and then
    /// strength counts for less where there are some in every frame. Gives how many went.
    pub fn keep_strongest(&mut self, most: usize, restless: &Restless) -> usize {
        let extra = self.0.len().saturating_sub(most);
        if extra > 0 {
            self.sort_by(|found| match found.expected {
                true => f64::INFINITY,
                false => found.detection.strength * restless.share(&found.blob),
            });
            self.0.truncate(most);
        }
        self.sort_by(|found| found.detection.strength);
        extra
    }

    fn sort_by(&mut self, rank: impl Fn(&Found) -> f64) {
        self.0
            .sort_unstable_by(|(a, one), (b, other)| rank(other).total_cmp(&rank(one)).then(a.cmp(b)));
    }
}
