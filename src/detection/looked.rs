//! What was seen in front of large bodies, from the frame that tells it until the frame is answered.
//!
//! That look needs frames nearer than the answer does: as soon as they are there, less of them has left the cache.

use std::collections::VecDeque;

use super::blobs::Blob;
use super::tiles::TileMap;
use crate::scene::Detection;

/// The frames looked into and not yet answered, by their index in the window.
#[derive(Default)]
pub struct Looked {
    /// The first frame not looked into.
    pub next: usize,
    rests: VecDeque<(usize, TileMap)>,
    spots: VecDeque<(usize, Detection, Blob)>,
    spare: Vec<TileMap>,
}

impl Looked {
    /// Keeps the tiles of a frame that are not of large bodies.
    pub fn keep_rest(&mut self, index: usize, tiles: &TileMap) {
        let rest = match self.spare.pop() {
            Some(mut map) => {
                map.set_both(Some(tiles), None);
                map
            }
            None => tiles.clone(),
        };
        self.rests.push_back((index, rest));
    }

    /// Keeps a spot in front of a body of a frame.
    pub fn keep_spot(&mut self, index: usize, detection: Detection, spot: Blob) {
        self.spots.push_back((index, detection, spot));
    }

    /// Whether a frame was looked into; then `tiles` are those that are left of it.
    pub fn take_rest(&mut self, index: usize, tiles: &mut TileMap) -> bool {
        while let Some((of, _)) = self.rests.front().filter(|(of, _)| *of <= index) {
            let found = *of == index;
            if let Some((_, map)) = self.rests.pop_front() {
                if found {
                    tiles.set_both(Some(&map), None);
                }
                self.spare.push(map);
            }
            if found {
                return true;
            }
        }
        false
    }

    /// The next spot of a frame.
    pub fn take_spot(&mut self, index: usize) -> Option<(Detection, Blob)> {
        while self.spots.front().is_some_and(|(of, _, _)| *of < index) {
            self.spots.pop_front();
        }
        self.spots.front().filter(|(of, _, _)| *of == index)?;
        let (_, detection, spot) = self.spots.pop_front()?;
        Some((detection, spot))
    }

    /// Forgets all, and begins at a frame.
    pub fn restart_at(&mut self, next: usize) {
        self.next = next;
        self.spots.clear();
        self.spare.extend(self.rests.drain(..).map(|(_, map)| map));
    }
}
