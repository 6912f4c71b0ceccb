//! Large bodies that move: groups of changed tiles larger than any ball.
//!
//! Pixel by pixel a few players cost more than the whole scan. So where there are many, nothing is gathered within them:
//! they are searched for spots in front of them ([`super::movers`]), and so are their larger fragments: what changes much
//! and often raises its own thresholds, and falls apart. What may be a ball by its size, or is all there is, is gathered.

use super::tiles::TileMap;

/// A body has at least so many rows of tiles, or columns of them: more than the largest ball.
const BODY_BANDS_MIN: usize = 6;
const BODY_COLUMNS_MIN: usize = 4;
/// Rows and columns of tiles that may be missing between two parts of one body.
const GAP_TILES: usize = 1;
/// Tiles of large groups that are gathered like small ones if that is all of them.
const GATHERED_TILES_MAX: usize = 96;
/// Of many, groups of no more tiles than a ball's are gathered, and of the others the smallest with so many tiles in all.
const BALL_TILES_MAX: usize = 6;
const GATHERED_OF_MANY_MAX: usize = 16;

/// A group of tiles: first and last column and band.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Body {
    columns: (usize, usize),
    bands: (usize, usize),
    tiles: usize,
}

impl Body {
    fn is_near(&self, band: usize, column: usize) -> bool {
        band <= self.bands.1 + 1 + GAP_TILES
            && column <= self.columns.1 + 1 + GAP_TILES
            && column + 1 + GAP_TILES >= self.columns.0
    }

    fn take(&mut self, band: usize, column: usize) {
        self.bands.1 = band;
        self.columns = (self.columns.0.min(column), self.columns.1.max(column));
        self.tiles += 1;
    }

    /// Whether no ball is as large.
    fn is_large(&self) -> bool {
        let bands = self.bands.1 + 1 - self.bands.0;
        let columns = self.columns.1 + 1 - self.columns.0;
        bands >= BODY_BANDS_MIN || columns >= BODY_COLUMNS_MIN
    }

    /// Band and column of a tile in its middle.
    pub fn middle(&self) -> (usize, usize) {
        (
            (self.bands.0 + self.bands.1) / 2,
            (self.columns.0 + self.columns.1) / 2,
        )
    }
}

/// Groups changed tiles; keeps its memory from frame to frame.
pub struct Bodies {
    /// Those of the last frame.
    pub large: Vec<Body>,
    tiles: TileMap,
}

impl Bodies {
    /// For images of this size.
    pub fn new(width_px: usize, height_px: usize) -> Self {
        Self {
            large: Vec::with_capacity(1024),
            tiles: TileMap::new(width_px, height_px),
        }
    }

    /// Finds the bodies of a frame, and takes their tiles out of those given.
    pub fn find(&mut self, tiles: &mut TileMap) {
        self.large.clear();
        self.tiles.clear();
        for band in tiles.bands() {
            for column in tiles.columns(band) {
                let known = self
                    .large
                    .iter_mut()
                    .rev()
                    .find(|body| body.is_near(band, column));
                match known {
                    Some(body) => body.take(band, column),
                    None => self.large.push(Body {
                        columns: (column, column),
                        bands: (band, band),
                        tiles: 1,
                    }),
                }
            }
        }
        let large = self.large.iter().filter(|body| body.is_large());
        let many = large.map(|body| body.tiles).sum::<usize>() > GATHERED_TILES_MAX;
        self.large
            .retain(|body| body.is_large() || many && body.tiles > BALL_TILES_MAX);
        self.large
            .sort_unstable_by_key(|body| std::cmp::Reverse(body.tiles));
        let mut left = if many {
            GATHERED_OF_MANY_MAX
        } else {
            GATHERED_TILES_MAX
        };
        while let Some(rest) = self.large.last().and_then(|body| left.checked_sub(body.tiles)) {
            left = rest;
            self.large.pop();
        }
        for body in &self.large {
            for band in body.bands.0..=body.bands.1 {
                self.tiles.take_from(tiles, band, body.columns);
            }
        }
    }

    /// The tiles of a body from top to bottom: band and column.
    pub fn tiles(&self, body: &Body) -> impl Iterator<Item = (usize, usize)> + '_ {
        let (first, last) = body.columns;
        (body.bands.0..=body.bands.1).flat_map(move |band| {
            let columns = self.tiles.columns(band);
            columns
                .filter(move |column| (first..=last).contains(column))
                .map(move |column| (band, column))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tiles(of: impl Iterator<Item = (usize, usize)>) -> TileMap {
        let mut map = TileMap::new(2048, 400);
        of.for_each(|(band, column)| map.set(band, column));
        map
    }

    #[test]
    fn many_players_are_bodies_and_balls_are_not() {
        let player = |column: usize| {
            (10..34).flat_map(move |band| [(band, column), (band, column + 1), (band, column + 2)])
        };
        let ball = [(12, 20), (13, 20), (13, 21)];
        let mut map = tiles(player(4).chain(player(40)).chain(ball));
        let mut bodies = Bodies::new(2048, 400);
        bodies.find(&mut map);
        assert_eq!(bodies.large.len(), 2);
        assert_eq!(map, tiles(ball.into_iter()));
        let body = bodies.large.iter().find(|body| body.columns.0 == 4).unwrap();
        let found: Vec<(usize, usize)> = bodies.tiles(body).collect();
        assert_eq!(found, player(4).collect::<Vec<_>>());
    }

    #[test]
    fn larger_fragments_of_many_are_bodies_too() {
        let player =
            |column: usize| (10..34).flat_map(move |band| (column..column + 3).map(move |c| (band, c)));
        let fragment = |band: usize| (band..band + 3).flat_map(|band| (20..23).map(move |c| (band, c)));
        let ball = [(2, 30), (2, 31), (3, 30), (3, 31), (4, 30), (4, 31)];
        let mut map = tiles(
            player(4)
                .chain(player(40))
                .chain(fragment(10))
                .chain(fragment(30))
                .chain(ball),
        );
        let mut bodies = Bodies::new(2048, 400);
        bodies.find(&mut map);
        // One fragment is gathered, for the other there is no room.
        assert_eq!(bodies.large.len(), 3);
        assert_eq!(map.count(), 9 + ball.len());
        assert!(
            ball.iter()
                .all(|(band, column)| map.columns(*band).any(|c| c == *column))
        );
    }

    #[test]
    fn a_few_that_move_little_are_gathered() {
        let players = (0..10)
            .map(|band| (band, 3))
            .chain((20..40).map(|band| (band, 60)));
        let mut map = tiles(players.clone());
        let mut bodies = Bodies::new(2048, 400);
        bodies.find(&mut map);
        assert!(bodies.large.is_empty());
        assert_eq!(map, tiles(players));
    }
}
