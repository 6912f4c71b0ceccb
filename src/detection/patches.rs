//! Cut-outs around candidates, kept until their track is known: the second look ([`super::refine`]) needs them.
//!
//! One arena of fixed size; the oldest cut-outs make room for new ones.

use std::collections::VecDeque;

use nalgebra::Vector2;

use super::blobs::{Blob, Images};
use crate::geometry::Pixel;
use crate::scene::{Detection, Track, TrackPoint};
use crate::time::StampedMidpoint;

/// Pixels around a blob's box that are kept too.
const MARGIN_PX: usize = 6;
/// A cut-out reaches at most this far from the centre: radii and streaks of the candidate, and pixels beyond.
const REACH_RADII: f64 = 2.0;
const REACH_STREAKS: f64 = 0.6;
const REACH_MARGIN_PX: f64 = 12.0;
/// ... and never further than this.
const REACH_MAX_PX: f64 = 44.0;

/// A track may lack so many frames before its begin and after its end.
const BEYOND_ENDS: f64 = 3.4;
/// Points that say where the ball was beyond an end.
const END_POINTS: usize = 8;

/// Where a cut-out is, in the frame and in the arena.
#[derive(Debug, Clone, Copy)]
struct Header {
    frame: u64,
    stamped: StampedMidpoint,
    centre: Pixel,
    left: usize,
    top: usize,
    width: usize,
    height: usize,
    offset: usize,
    difference_sigma: f32,
    radius_px: f64,
}

/// A cut-out: the frame and its two references, row by row.
#[derive(Debug, Clone, Copy)]
pub struct Patch<'a> {
    /// First column in the frame.
    pub left: usize,
    /// First row in the frame.
    pub top: usize,
    /// Columns.
    pub width: usize,
    /// The frame.
    pub current: &'a [u8],
    /// A reference.
    pub one: &'a [u8],
    /// The other reference.
    pub other: &'a [u8],
    /// σ of a frame difference here, levels.
    pub difference_sigma: f64,
    /// Radius by the first look, pixels.
    pub radius_px: f64,
}

/// The arena.
#[derive(Debug, Clone)]
pub struct PatchPool {
    bytes: Vec<u8>,
    headers: VecDeque<Header>,
    next: usize,
}

impl PatchPool {
    /// An arena of this many bytes. All of it is written to now: pages that come one by one through the first
    /// innings look like a leak.
    pub fn new(capacity_bytes: usize) -> Self {
        let unused = Header {
            frame: 0,
            stamped: StampedMidpoint::from_nanos(0),
            centre: Pixel::new(0.0, 0.0),
            left: 0,
            top: 0,
            width: 0,
            height: 0,
            offset: 0,
            difference_sigma: 0.0,
            radius_px: 0.0,
        };
        let mut headers = VecDeque::from(vec![unused; capacity_bytes / 512]);
        headers.clear();
        Self {
            bytes: vec![u8::MAX; capacity_bytes],
            headers,
            next: 0,
        }
    }

    /// Keeps the surroundings of a blob under the stamp and centre of its detection.
    pub fn keep(&mut self, images: &Images<'_>, blob: &Blob, detection: &Detection) {
        let (stamped, centre) = (detection.stamped, detection.centre);
        if self.headers.back().is_some_and(|newest| newest.stamped > stamped) {
            self.headers.clear();
        }
        let [sx, sy] = detection.streak_px;
        let reach = REACH_RADII * detection.radius_px + REACH_STREAKS * sx.hypot(sy) + REACH_MARGIN_PX;
        let reach = reach.min(REACH_MAX_PX);
        let (left, width) = span((blob.left, blob.right), centre.x, reach, images.width_px);
        let (top, height) = span((blob.top, blob.bottom), centre.y, reach, images.height_px);
        let size = 3 * width * height;
        if size == 0 || size > self.bytes.len() {
            return;
        }
        if self.next + size > self.bytes.len() {
            self.next = 0;
        }
        let (begin, end) = (self.next, self.next + size);
        while self.headers.front().is_some_and(|old| {
            let old_end = old.offset + 3 * old.width * old.height;
            old.offset < end && begin < old_end
        }) {
            self.headers.pop_front();
        }
        if self.headers.len() == self.headers.capacity() {
            self.headers.pop_front();
        }
        let mut write = begin;
        for source in [images.current, images.one, images.other] {
            for y in top..top + height {
                let from = y * images.width_px + left;
                if let (Some(to), Some(row)) = (
                    self.bytes.get_mut(write..write + width),
                    source.get(from..from + width),
                ) {
                    to.copy_from_slice(row);
                }
                write += width;
            }
        }
        self.next = end;
        self.headers.push_back(Header {
            frame: detection.frame,
            stamped,
            centre,
            left,
            top,
            width,
            height,
            offset: begin,
            difference_sigma: blob.difference_sigma,
            radius_px: detection.radius_px,
        });
    }

    /// A pool of its own with the cut-outs of this track's points, and where the track lacks a frame the largest that holds
    /// the ball: what a second look on another thread needs.
    pub fn of_track(&self, track: &Track) -> Self {
        let Some(path) = BallPath::of(track) else {
            return Self::new(0);
        };
        let first = self.headers.partition_point(|h| h.stamped < path.begin);
        let near = self.headers.range(first..).take_while(|h| h.stamped <= path.end);
        // Of one frame only the largest: a crowd has many.
        let mut headers: Vec<&Header> = Vec::with_capacity(track.points.len());
        for header in near.filter(|h| path.needs(h)) {
            match headers.last_mut().filter(|last| last.stamped == header.stamped) {
                Some(last) if last.size() < header.size() => *last = header,
                Some(_) => {}
                None => headers.push(header),
            }
        }
        let mut own = Self {
            bytes: Vec::new(),
            headers: VecDeque::with_capacity(track.points.len()),
            next: 0,
        };
        for header in headers {
            let offset = own.bytes.len();
            let end = header.offset + 3 * header.width * header.height;
            own.bytes
                .extend_from_slice(self.bytes.get(header.offset..end).unwrap_or_default());
            own.headers.push_back(Header { offset, ..*header });
        }
        own.next = own.bytes.len();
        own
    }

    /// Frames of which something is kept, in their order.
    pub fn frames(&self) -> impl DoubleEndedIterator<Item = (u64, StampedMidpoint)> {
        let mut frames: Vec<_> = self.headers.iter().map(|h| (h.frame, h.stamped)).collect();
        frames.dedup();
        frames.into_iter()
    }

    /// The largest cut-out of a frame that holds all within `reach_px` of a place.
    pub fn around(
        &self,
        stamped: StampedMidpoint,
        place_px: Vector2<f64>,
        reach_px: f64,
    ) -> Option<Patch<'_>> {
        let first = self.headers.partition_point(|h| h.stamped < stamped);
        let same = self.headers.range(first..).take_while(|h| h.stamped == stamped);
        let holding = same.filter(|h| h.holds(place_px, reach_px));
        self.patch(holding.max_by_key(|h| h.size())?)
    }

    fn header(&self, stamped: StampedMidpoint, centre: Pixel) -> Option<&Header> {
        let first = self.headers.partition_point(|h| h.stamped < stamped);
        self.headers
            .range(first..)
            .take_while(|h| h.stamped == stamped)
            .find(|h| h.centre == centre)
    }

    /// The cut-out kept under this stamp and centre, if it is still there.
    pub fn find(&self, stamped: StampedMidpoint, centre: Pixel) -> Option<Patch<'_>> {
        self.patch(self.header(stamped, centre)?)
    }

    fn patch(&self, header: &Header) -> Option<Patch<'_>> {
        let size = header.width * header.height;
        let all = self.bytes.get(header.offset..header.offset + 3 * size)?;
        let (current, references) = all.split_at(size);
        let (one, other) = references.split_at(size);
        Some(Patch {
            left: header.left,
            top: header.top,
            width: header.width,
            current,
            one,
            other,
            difference_sigma: f64::from(header.difference_sigma),
            radius_px: header.radius_px,
        })
    }
}

impl Header {
    fn size(&self) -> usize {
        self.width * self.height
    }

    fn holds(&self, place_px: Vector2<f64>, reach_px: f64) -> bool {
        let within = |place: f64, first: usize, count: usize| {
            place - reach_px >= first as f64 && place + reach_px < (first + count) as f64
        };
        within(place_px.x, self.left, self.width) && within(place_px.y, self.top, self.height)
    }
}

/// Where the ball of a track is, also in frames that the track lacks.
struct BallPath<'a> {
    points: &'a [TrackPoint],
    /// First and last stamp that it is looked for.
    begin: StampedMidpoint,
    end: StampedMidpoint,
}

impl<'a> BallPath<'a> {
    fn of(track: &'a Track) -> Option<Self> {
        let (first, last) = track.span()?;
        let steps = track.points.windows(2).filter_map(|pair| match pair {
            [a, b] => Some(b.stamped.seconds_since(a.stamped.nanos())),
            _ => None,
        });
        let beyond_s = BEYOND_ENDS * steps.min_by(f64::total_cmp).unwrap_or(0.0);
        Some(Self {
            points: &track.points,
            begin: StampedMidpoint::from_seconds_since(first.nanos(), -beyond_s),
            end: StampedMidpoint::from_seconds_since(last.nanos(), beyond_s),
        })
    }

    /// Whether a cut-out is a point's own, or holds the ball in a frame of which the track has no point.
    fn needs(&self, header: &Header) -> bool {
        let after = self.points.partition_point(|p| p.stamped < header.stamped);
        match self.points.get(after) {
            Some(point) if point.stamped == header.stamped => point.pixel == header.centre,
            _ => self
                .place(after, header.stamped)
                .is_some_and(|place| header.holds(place, 0.0)),
        }
    }

    /// On the straight line between the neighbours, or on from an end; `after` is the first point behind the stamp.
    fn place(&self, after: usize, stamped: StampedMidpoint) -> Option<Vector2<f64>> {
        let count = self.points.len();
        let (from, to) = match after {
            0 => (0, END_POINTS.min(count) - 1),
            _ if after < count => (after - 1, after),
            _ => (count.saturating_sub(END_POINTS), count - 1),
        };
        let (from, to) = (self.points.get(from)?, self.points.get(to)?);
        let span_s = to.stamped.seconds_since(from.stamped.nanos());
        let share = stamped.seconds_since(from.stamped.nanos()) / f64::max(span_s, 1e-9);
        let (from, to) = (from.pixel.vector(), to.pixel.vector());
        Some(from + (to - from) * share)
    }
}

/// First pixel and count along one axis: the blob with its margin, as far as the reach around the centre goes.
fn span((first, last): (usize, usize), centre: f64, reach: f64, size: usize) -> (usize, usize) {
    let lowest = (centre - reach).max(0.0) as usize;
    let highest = (centre + reach).max(0.0) as usize + 1;
    let begin = first.saturating_sub(MARGIN_PX).max(lowest).min(size);
    let end = (last + 1 + MARGIN_PX).min(highest).min(size);
    (begin, end.saturating_sub(begin))
}
