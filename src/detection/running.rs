//! A ball's fit that is gone on with when more of the ball has been seen.

use super::blur::BlurCosts;
use super::disc::Edge;
use super::fit::{Picture, PictureStart, Shared};
use crate::geometry::Pixel;
use crate::scene::{Track, TrackPoint};
use crate::time::StampedMidpoint;

/// A picture serves on while the ball that chose its pixels was no larger or smaller than this, pixels.
const REACH_CHANGE_MAX_PX: f64 = 0.3;
/// Points that two tracks of one ball have in common, at least: one of so many.
const SHARED_POINTS: usize = 2;

/// The fit of a ball that still flew.
#[derive(Debug, Clone)]
pub struct Running {
    begin: StampedMidpoint,
    span_s: f64,
    edge: Edge,
    shared: Shared,
    /// What the ball says of the blur.
    blur: Option<BlurCosts>,
    /// By stamp; the pixel is the first look's.
    pictures: Vec<(StampedMidpoint, Pixel, Picture)>,
}

impl Running {
    /// Of the points at these indices of a track whose centres are still the first look's.
    pub fn new(
        track: &Track,
        indices: &[usize],
        pictures: Vec<Picture>,
        (edge, shared, blur): (&Edge, &Shared, Option<BlurCosts>),
    ) -> Option<Self> {
        let (begin, end) = track.span()?;
        let points = indices.iter().filter_map(|index| track.points.get(*index));
        let mut pictures: Vec<_> = points
            .zip(pictures)
            .map(|(point, picture)| (point.stamped, point.pixel, picture))
            .collect();
        pictures.sort_by_key(|(stamped, _, _)| *stamped);
        Some(Self {
            begin,
            span_s: end.seconds_since(begin.nanos()),
            edge: *edge,
            shared: *shared,
            blur,
            pictures,
        })
    }

    /// Whether a track is of this ball.
    pub fn is_of(&self, track: &Track) -> bool {
        let shared = track.points.iter().filter(|p| self.of_point(p).is_some()).count();
        shared * SHARED_POINTS > self.pictures.len()
    }

    /// Blur and ball as they are over the span of a longer track, and what the ball says of the blur.
    pub fn ball(&self, track: &Track) -> Option<(Edge, Shared, Option<BlurCosts>)> {
        let (begin, end) = track.span()?;
        let span_s = self.span_s.max(1e-9);
        let stretch = end.seconds_since(begin.nanos()).max(1e-9) / span_s;
        let middle = (begin.seconds_since(self.begin.nanos()) / span_s - 0.5) + 0.5 * stretch;
        Some((self.edge, self.shared.over(middle, stretch), self.blur))
    }

    /// The picture of a point, for the longer track's place and streak.
    pub fn picture(&self, point: &TrackPoint, start: &PictureStart, edge: &Edge) -> Option<Picture> {
        let picture = self.of_point(point)?;
        picture.moved_to(start, edge, REACH_CHANGE_MAX_PX)
    }

    fn of_point(&self, point: &TrackPoint) -> Option<&Picture> {
        let first = self
            .pictures
            .partition_point(|(stamped, _, _)| *stamped < point.stamped);
        let same = self.pictures.get(first..)?.iter();
        let mut same = same.take_while(|(stamped, _, _)| *stamped == point.stamped);
        same.find(|(_, pixel, _)| *pixel == point.pixel)
            .map(|(_, _, picture)| picture)
    }
}
