//! Cut-outs around candidates, kept until their track is known: the second look ([`super::refine`]) needs them.
//!
//! One arena of fixed size; the oldest cut-outs make room for new ones.

mod going_on;

use std::collections::VecDeque;

use going_on::{GoingOn, on_line};
use nalgebra::Vector2;

use super::blobs::{Blob, Images};
use super::dispatch::fetch_ahead;
use super::expected::ExpectedBall;
use crate::geometry::Pixel;
use crate::scene::{Detection, FrameStamp, Track, TrackPoint};
use crate::time::StampedMidpoint;

/// Pixels around a blob's box that are kept too.
const MARGIN_PX: usize = 6;
/// While a row is copied, the memory of one so many below is asked for.
const ROWS_AHEAD: usize = 6;
/// A cut-out reaches at most this far from the centre: radii and streaks of the candidate, and pixels beyond.
const REACH_RADII: f64 = 2.0;
const REACH_STREAKS: f64 = 0.6;
const REACH_MARGIN_PX: f64 = 12.0;
/// ... and never further than this.
const REACH_MAX_PX: f64 = 44.0;

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
    kept_for: KeptFor,
}

/// Why a cut-out is kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum KeptFor {
    /// What may be a ball was found there.
    Candidate,
    /// A ball was expected there, and none found.
    Expected,
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
            kept_for: KeptFor::Candidate,
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
        let [sx, sy] = detection.streak_px;
        let reach = REACH_RADII * detection.radius_px + REACH_STREAKS * sx.hypot(sy) + REACH_MARGIN_PX;
        let reach = reach.min(REACH_MAX_PX);
        let (left, width) = span((blob.left, blob.right), centre.x, reach, images.width_px);
        let (top, height) = span((blob.top, blob.bottom), centre.y, reach, images.height_px);
        let header = Header {
            frame: detection.frame,
            stamped,
            centre,
            left,
            top,
            width,
            height,
            offset: 0,
            difference_sigma: blob.difference_sigma,
            radius_px: detection.radius_px,
            kept_for: KeptFor::Candidate,
        };
        self.copy(images, header);
    }

    /// Keeps the surroundings of a place where a ball is expected and none was found, for a track that lacks this frame;
    /// with the σ of a frame difference there, levels.
    pub fn keep_expected(
        &mut self,
        images: &Images<'_>,
        expected: &ExpectedBall,
        (stamp, difference_sigma): (FrameStamp, f32),
    ) {
        let centre = expected.centre;
        let reach = REACH_RADII * expected.radius_px + expected.reach_px + REACH_MARGIN_PX;
        let reach = reach.min(REACH_MAX_PX);
        let (left, width) = span((0, images.width_px), centre.x, reach, images.width_px);
        let (top, height) = span((0, images.height_px), centre.y, reach, images.height_px);
        let header = Header {
            frame: stamp.frame,
            stamped: stamp.stamped,
            centre,
            left,
            top,
            width,
            height,
            offset: 0,
            difference_sigma,
            radius_px: expected.radius_px,
            kept_for: KeptFor::Expected,
        };
        self.copy(images, header);
    }

    /// Copies the pixels of a cut-out and keeps it.
    fn copy(&mut self, images: &Images<'_>, header: Header) {
        let Header {
            left,
            top,
            width,
            height,
            ..
        } = header;
        let newest = self.headers.back().map(|newest| newest.stamped);
        if newest > Some(header.stamped) {
            self.headers.clear();
        }
        let size = 3 * header.size();
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
                let later = from + ROWS_AHEAD * images.width_px;
                fetch_ahead(source, later);
                fetch_ahead(source, later + width - 1);
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
            offset: begin,
            ..header
        });
    }

    /// A pool of its own with the cut-outs of this track's points, of the frames that it lacks, and of those beyond its ends
    /// as far as something goes on there: what a second look on another thread needs.
    pub fn of_track(&self, track: &Track) -> Self {
        let Some((first, last)) = track.span() else {
            return Self::new(0);
        };
        let begin = self.headers.partition_point(|h| h.stamped < first);
        let end = self.headers.partition_point(|h| h.stamped <= last);
        let mut headers = GoingOn::from_begin(track).among(self.headers.range(..begin).rev());
        headers.reverse();
        headers.extend(self.within(track, |header| is_needed(&track.points, header)));
        headers.extend(GoingOn::from_end(track).among(self.headers.range(end..)));
        self.copy_of(&headers)
    }

    /// A pool of its own with the cut-outs of this track's points only: enough to fit them.
    pub fn of_points(&self, track: &Track) -> Self {
        self.copy_of(&self.within(track, |header| is_of_a_point(&track.points, header)))
    }

    /// The cut-outs wanted between the ends of a track; of one frame only the largest candidate's (a crowd has
    /// many), and the largest of those expected, which may be a wrong path's.
    fn within(&self, track: &Track, wanted: impl Fn(&Header) -> bool) -> Vec<&Header> {
        let Some((first, last)) = track.span() else {
            return Vec::new();
        };
        let begin = self.headers.partition_point(|h| h.stamped < first);
        let mut headers: Vec<&Header> = Vec::with_capacity(track.points.len());
        let between = self.headers.range(begin..).take_while(|h| h.stamped <= last);
        for header in between.filter(|h| wanted(h)) {
            match headers.last_mut().filter(|last| last.is_like(header)) {
                Some(last) if last.size() < header.size() => *last = header,
                Some(_) => {}
                None => headers.push(header),
            }
        }
        headers
    }

    fn copy_of(&self, headers: &[&Header]) -> Self {
        let mut own = Self {
            bytes: Vec::new(),
            headers: VecDeque::with_capacity(headers.len()),
            next: 0,
        };
        for header in headers {
            let offset = own.bytes.len();
            let end = header.offset + 3 * header.size();
            own.bytes
                .extend_from_slice(self.bytes.get(header.offset..end).unwrap_or_default());
            own.headers.push_back(Header { offset, ..**header });
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

    /// Of the same frame, and kept for the same.
    fn is_like(&self, other: &Self) -> bool {
        self.stamped == other.stamped && self.kept_for == other.kept_for
    }

    fn holds(&self, place_px: Vector2<f64>, reach_px: f64) -> bool {
        let within = |place: f64, first: usize, count: usize| {
            place - reach_px >= first as f64 && place + reach_px < (first + count) as f64
        };
        within(place_px.x, self.left, self.width) && within(place_px.y, self.top, self.height)
    }
}

/// Whether a cut-out is a point's own.
fn is_of_a_point(points: &[TrackPoint], header: &Header) -> bool {
    let at = points.partition_point(|p| p.stamped < header.stamped);
    let point = points.get(at).filter(|point| point.stamped == header.stamped);
    point.is_some_and(|point| point.pixel == header.centre)
}

/// Whether a cut-out is a point's own, or holds the ball in a frame of which the track has no point: on the straight line
/// between the neighbours.
fn is_needed(points: &[TrackPoint], header: &Header) -> bool {
    let after = points.partition_point(|p| p.stamped < header.stamped);
    let neighbours = points.get(after.saturating_sub(1)).zip(points.get(after));
    match neighbours.filter(|(_, to)| to.stamped != header.stamped) {
        Some((from, to)) => {
            let at = |point: &TrackPoint| (point.stamped, point.pixel.vector());
            header.holds(on_line(at(from), at(to), header.stamped), 0.0)
        }
        None => is_of_a_point(points, header),
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detection::{Isa, Kernels};
    use crate::scene::CameraId;
    use nalgebra::Matrix2;

    const STEP_PX: f64 = 12.0;

    fn stamped(frame: u64) -> StampedMidpoint {
        StampedMidpoint::from_seconds_since(0, frame as f64 / 175.0)
    }

    fn images(image: &[u8]) -> Images<'_> {
        Images {
            kernels: Kernels::new(Isa::detect()),
            width_px: 600,
            height_px: 100,
            current: image,
            one: image,
            other: image,
        }
    }

    fn keep(pool: &mut PatchPool, frame: u64, x: f64, y: f64) {
        let image = vec![0; 600 * 100];
        let images = images(&image);
        let blob = Blob {
            left: x as usize - 2,
            right: x as usize + 2,
            top: y as usize - 2,
            bottom: y as usize + 2,
            area_px: 25,
            place_sum: [25 * x as usize, 25 * y as usize],
            change_sum: 500,
            peak: 40,
            difference_sigma: 2.0,
        };
        let detection = Detection {
            frame,
            stamped: stamped(frame),
            centre: Pixel::new(x, y),
            covariance_px2: Matrix2::identity() * 0.01,
            radius_px: 3.0,
            streak_px: [5.0, 0.0],
            strength: 10.0,
        };
        pool.keep(&images, &blob, &detection);
    }

    /// Frames 0–45, 12 px each, of which the track has 20–29. From frame 30 on the candidates are drawn aside by 4 px, as at
    /// an edge of shadow, and in every frame something else is 25 px off. After a gap of six frames nothing is the ball's.
    #[test]
    fn a_track_is_followed_on_beyond_its_ends_but_not_over_a_gap() {
        let mut pool = PatchPool::new(1 << 20);
        for frame in 0..46 {
            keep(&mut pool, frame, 20.0 + STEP_PX * frame as f64, 75.0);
            let aside = if frame < 30 { 0.0 } else { 4.0 };
            if !(12..14).contains(&frame) && !(36..42).contains(&frame) {
                keep(&mut pool, frame, 20.0 + STEP_PX * frame as f64, 50.0 + aside);
            }
        }
        let points = (20..30).map(|frame| TrackPoint {
            frame,
            stamped: stamped(frame),
            pixel: Pixel::new(20.0 + STEP_PX * frame as f64, 50.0),
            covariance_px2: None,
        });
        let track = Track {
            camera: CameraId::new("a").unwrap(),
            track: 0,
            points: points.collect(),
        };
        let own = pool.of_track(&track);
        let frames: Vec<u64> = own.frames().map(|(frame, _)| frame).collect();
        let expected: Vec<u64> = (0..36).filter(|f| !(12..14).contains(f)).collect();
        assert_eq!(frames, expected);
        let others = own.headers.iter().filter(|h| h.centre.y > 60.0);
        assert_eq!(others.count(), 0);
        let points: Vec<u64> = pool.of_points(&track).frames().map(|(frame, _)| frame).collect();
        assert_eq!(points, (20..30).collect::<Vec<u64>>());
    }

    /// A ball in frames 20–29, found in all but frame 25; there and after the end one is expected.
    #[test]
    fn what_was_expected_is_kept_for_the_gaps_of_a_track_and_leads_nowhere() {
        let image = vec![0; 600 * 100];
        let images = images(&image);
        let place = |frame: u64| Pixel::new(20.0 + STEP_PX * frame as f64, 50.0);
        let mut pool = PatchPool::new(1 << 20);
        let found = |frame: &u64| (20..30).contains(frame) && *frame != 25;
        for frame in 20..34 {
            if found(&frame) {
                keep(&mut pool, frame, place(frame).x, place(frame).y);
                continue;
            }
            let expected = ExpectedBall {
                centre: place(frame),
                reach_px: 2.0,
                radius_px: 3.0,
            };
            let stamp = FrameStamp {
                frame,
                device: None,
                arrival: None,
                stamped: stamped(frame),
            };
            pool.keep_expected(&images, &expected, (stamp, 2.0));
        }
        let points = (20..30).filter(found).map(|frame| TrackPoint {
            frame,
            stamped: stamped(frame),
            pixel: place(frame),
            covariance_px2: None,
        });
        let track = Track {
            camera: CameraId::new("a").unwrap(),
            track: 0,
            points: points.collect(),
        };
        let own = pool.of_track(&track);
        let frames: Vec<u64> = own.frames().map(|(frame, _)| frame).collect();
        assert_eq!(frames, (20..30).collect::<Vec<u64>>());
        // Two radii, the reach and 12 px around the place.
        let around = |reach_px: f64| own.around(stamped(25), place(25).vector(), reach_px);
        assert!(around(19.5).is_some() && around(20.5).is_none());
        assert_eq!(pool.of_points(&track).frames().count(), 9);
    }
}
