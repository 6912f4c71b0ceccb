//! The frames of one recording window that are still needed, with what changed from each to the next.

use std::collections::VecDeque;

use super::tiles::TileMap;
use crate::scene::Frame;

/// One frame with the tiles in which it differs from the frame before it.
pub struct Seen {
    /// The frame (shared pixels, no copy).
    pub frame: Frame,
    /// The same under even light, where lamps flicker.
    pub even: Option<Frame>,
    /// Tiles changed since the frame before; `None` for the first of a window.
    pub changed: Option<TileMap>,
}

impl Seen {
    /// What is searched.
    pub fn searched(&self) -> &Frame {
        self.even.as_ref().unwrap_or(&self.frame)
    }
}

/// Frames of one window by their index in it; old ones are dropped, their maps used again.
#[derive(Default)]
pub struct History {
    seen: VecDeque<Seen>,
    first_index: usize,
    spare: Vec<TileMap>,
}

/// A frame to search and the two frames that show what is behind the ball.
pub struct Triple<'a> {
    /// The frame to search.
    pub current: &'a Seen,
    /// A frame in which the ball is elsewhere.
    pub one: &'a Seen,
    /// Another one.
    pub other: &'a Seen,
    /// Tiles changed from the frame in question to the next; `None` for the last of a window.
    pub changed_after: Option<&'a TileMap>,
}

impl History {
    /// Room for `capacity` frames of this size.
    pub fn new(capacity: usize, width_px: usize, height_px: usize) -> Self {
        Self {
            seen: VecDeque::with_capacity(capacity),
            first_index: 0,
            spare: (0..capacity).map(|_| TileMap::new(width_px, height_px)).collect(),
        }
    }

    /// Frames seen in this window.
    pub fn count(&self) -> usize {
        self.first_index + self.seen.len()
    }

    /// The newest frame.
    pub fn newest(&self) -> Option<&Seen> {
        self.seen.back()
    }

    /// A map to fill for the next frame.
    pub fn spare_map(&mut self, width_px: usize, height_px: usize) -> TileMap {
        let mut map = self
            .spare
            .pop()
            .unwrap_or_else(|| TileMap::new(width_px, height_px));
        map.clear();
        map
    }

    /// Takes the next frame of the window.
    pub fn push(&mut self, (frame, even): (Frame, Option<Frame>), changed: Option<TileMap>) {
        self.seen.push_back(Seen { frame, even, changed });
    }

    /// Drops the frames before `index`.
    pub fn forget_before(&mut self, index: usize) {
        while self.first_index < index {
            match self.seen.pop_front() {
                Some(seen) => self.spare.extend(seen.changed),
                None => break,
            }
            self.first_index += 1;
        }
    }

    /// Starts a new window.
    pub fn restart(&mut self) {
        let end = self.count();
        self.forget_before(end);
        self.first_index = 0;
    }

    fn get(&self, index: usize) -> Option<&Seen> {
        self.seen.get(index.checked_sub(self.first_index)?)
    }

    /// The frame `index` with those `step` before and after, where all are there.
    pub fn near(&self, index: usize, step: usize) -> Option<Triple<'_>> {
        let (one, other) = (self.get(index.checked_sub(step)?)?, self.get(index + step)?);
        Some(self.with(self.get(index)?, index, (one, other)))
    }

    fn with<'a>(&'a self, current: &'a Seen, index: usize, (one, other): (&'a Seen, &'a Seen)) -> Triple<'a> {
        Triple {
            current,
            one,
            other,
            changed_after: self.get(index + 1).and_then(|next| next.changed.as_ref()),
        }
    }

    /// The frame `index` with references `lag` away: one on each side, or two on the side that has them.
    /// With `ended` the window has no further frames and what there is must do.
    pub fn triple(&self, index: usize, lag: usize, ended: bool) -> Option<Triple<'_>> {
        let current = self.get(index)?;
        let before = |frames: usize| index.checked_sub(frames).and_then(|i| self.get(i));
        let after = |frames: usize| self.get(index + frames);
        let pair = [
            (before(lag), after(lag)),
            (after(lag), after(2 * lag)),
            (before(lag), before(2 * lag)),
        ];
        let mut chosen = pair.into_iter().find_map(|(a, b)| a.zip(b));
        if chosen.is_none() && ended {
            let newest = self.count().checked_sub(1)?;
            let middle = self.first_index.midpoint(newest);
            let far = [
                (self.first_index, newest),
                (middle, newest),
                (self.first_index, middle),
            ];
            chosen = far
                .into_iter()
                .find(|(a, b)| *a != index && *b != index && a != b)
                .and_then(|(a, b)| self.get(a).zip(self.get(b)));
        }
        Some(self.with(current, index, chosen?))
    }
}
