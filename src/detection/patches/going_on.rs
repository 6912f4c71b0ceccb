//! A track followed on beyond its ends, from cut-out to cut-out.

use std::collections::VecDeque;

use nalgebra::Vector2;

use super::{Header, KeptFor};
use crate::scene::{Track, TrackPoint};
use crate::time::StampedMidpoint;

/// Points that say where the ball was beyond an end.
const END_POINTS: usize = 8;
/// A ball is followed through so many frames beyond an end, and may be missing in so many of them in a row.
const BEYOND_FRAMES_MAX: usize = 60;
const ABSENT_FRAMES_MAX: f64 = 4.5;
/// It is no further from the straight line through its last points than so many radii, and so many pixels a frame.
const BEYOND_RADII: f64 = 1.5;
const BEYOND_PX: f64 = 2.0;

/// A place and when it was.
pub type Past = (StampedMidpoint, Vector2<f64>);

/// Where something that moves straight is at a stamp.
pub fn on_line(from: Past, to: Past, stamped: StampedMidpoint) -> Vector2<f64> {
    let span_s = to.0.seconds_since(from.0.nanos());
    let share = stamped.seconds_since(from.0.nanos()) / if span_s == 0.0 { 1.0 } else { span_s };
    from.1 + (to.1 - from.1) * share
}

/// The end of a track, followed on from candidate to candidate: coarse, for a fit decides whether it is the ball. An edge
/// of shadow or of a board draws the candidates aside and ends a track before the ball is gone.
pub struct GoingOn {
    /// The latest places, the newest last.
    latest: VecDeque<Past>,
    /// Between two frames, seconds.
    step_s: f64,
}

impl GoingOn {
    /// After the track.
    pub fn from_end(track: &Track) -> Self {
        let from = track.points.len().saturating_sub(END_POINTS);
        Self::new(track, track.points.iter().skip(from))
    }

    /// Before the track, back in time.
    pub fn from_begin(track: &Track) -> Self {
        let to = END_POINTS.min(track.points.len());
        Self::new(track, track.points.iter().take(to).rev())
    }

    fn new<'a>(track: &Track, points: impl Iterator<Item = &'a TrackPoint>) -> Self {
        let steps = track.points.windows(2).filter_map(|pair| match pair {
            [a, b] => Some(b.stamped.seconds_since(a.stamped.nanos())),
            _ => None,
        });
        let mut latest = VecDeque::with_capacity(END_POINTS + 1);
        latest.extend(points.map(|p| (p.stamped, p.pixel.vector())));
        Self {
            latest,
            step_s: steps.min_by(f64::total_cmp).unwrap_or(0.0),
        }
    }

    /// Those of the cut-outs, given as their frames follow each other, in which it goes on; one a frame.
    pub fn among<'a>(mut self, headers: impl Iterator<Item = &'a Header>) -> Vec<&'a Header> {
        let mut found: Vec<&Header> = Vec::new();
        let mut nearest: Option<(f64, &Header)> = None;
        // What was only expected says nothing of where it goes.
        for header in headers.filter(|h| h.kept_for == KeptFor::Candidate) {
            if let Some((_, last)) = nearest.filter(|(_, last)| last.stamped != header.stamped) {
                self.go_to(last);
                found.push(last);
                nearest = None;
            }
            let Some((off_px, absent)) = self.off_px(header) else {
                break;
            };
            if absent > ABSENT_FRAMES_MAX || found.len() >= BEYOND_FRAMES_MAX {
                break;
            }
            let reach_px = BEYOND_RADII * header.radius_px + BEYOND_PX * absent.max(1.0);
            if off_px < reach_px && nearest.is_none_or(|(least, _)| off_px < least) {
                nearest = Some((off_px, header));
            }
        }
        found.extend(nearest.map(|(_, last)| last));
        found
    }

    /// How far a candidate is from where it goes, pixels, and frames since it was last seen.
    fn off_px(&self, header: &Header) -> Option<(f64, f64)> {
        let (from, to) = (*self.latest.front()?, *self.latest.back()?);
        let off = header.centre.vector() - on_line(from, to, header.stamped);
        let absent = header.stamped.seconds_since(to.0.nanos()).abs() / self.step_s.max(1e-9);
        Some((off.norm(), absent))
    }

    fn go_to(&mut self, header: &Header) {
        if self.latest.len() >= END_POINTS {
            self.latest.pop_front();
        }
        self.latest.push_back((header.stamped, header.centre.vector()));
    }
}
