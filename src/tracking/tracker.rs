//! One camera's tracker: detections of each frame in, finished balls out.

use std::collections::VecDeque;

use super::config::TrackerConfig;
use super::ending::conclude;
use super::hypothesis::{Hypothesis, Match, Pair, Point, in_both};
use super::open::{OpenPath, is_fast, open_paths};
use super::shape::{TrackKind, TrackShape, TrackedBall};
use crate::geometry::Pixel;
use crate::scene::{CameraId, Detection, FrameStamp};

/// Frames back in which a seed's two earlier detections are sought.
const SEED_FRAMES: usize = 4;
/// Most new hypotheses of one frame.
const SEEDS_MAX: usize = 48;
/// Frames whose detections are kept for extending a track back to the hand.
const HISTORY_FRAMES: usize = 400;
/// Branches of one hypothesis in one frame.
const BRANCHES: usize = 2;
/// A path shorter than this may miss this many frames only.
const YOUNG: (usize, f64) = (6, 3.0);
/// Paths looked at in one frame before they have ended.
const ENDING_MAX: usize = 2;
/// Two paths that share more than this are one ball.
const SHARED_MAX: f64 = 0.3;
/// Branches of one beginning that are followed at once. An arm has dozens with more points than a ball just thrown:
/// without this bound they take every place and the pitch is lost.
const FAMILY_MAX: usize = 6;

/// The rest of a lost ball begins at most so many frames before and after the end seen, this much off.
const REST_OVERLAP_FRAMES: f64 = 8.0;
const REST_GAP_FRAMES: f64 = 16.0;
const REST_SPEED_SHARE: f64 = 0.3;
const REST_OFF_PX: f64 = 6.0;
/// This many paths side by side are parts of one moving body.
const COMPANIONS_MIN: usize = 2;
/// Paths side by side are no further apart than this, pixels, and this share of their speed.
const BESIDE: (f64, f64) = (250.0, 0.25);
/// Ended paths remembered to tell what is new.
const RECENT_MAX: usize = 48;

/// What the tracker left out.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct TrackerCounters {
    /// Hypotheses given up because there were too many.
    pub hypotheses_dropped: u64,
    /// Paths that ended without being a ball.
    pub rejected: u64,
}

/// The detections of one frame.
pub struct FramePoints {
    /// Time in frames since the window began.
    pub t: f64,
    /// Its detections.
    pub points: Vec<Point>,
}

/// One camera's tracker.
pub struct Tracker {
    camera: CameraId,
    config: TrackerConfig,
    epoch: Option<FrameStamp>,
    history: VecDeque<FramePoints>,
    alive: Vec<Hypothesis>,
    recent: Vec<Vec<Point>>,
    ending: Vec<Vec<Point>>,
    pending: Vec<(Vec<Point>, TrackedBall)>,
    finished: Vec<TrackedBall>,
    next_number: u32,
    counters: TrackerCounters,
}

impl Tracker {
    /// A tracker for one camera.
    pub fn new(camera: CameraId, config: TrackerConfig) -> Self {
        Self {
            camera,
            config,
            epoch: None,
            history: VecDeque::with_capacity(HISTORY_FRAMES),
            alive: Vec::new(),
            recent: Vec::new(),
            ending: Vec::new(),
            pending: Vec::new(),
            finished: Vec::new(),
            next_number: 1,
            counters: TrackerCounters::default(),
        }
    }

    /// What was left out so far.
    pub fn counters(&self) -> TrackerCounters {
        self.counters
    }

    /// Takes the detections of the next frame.
    pub fn push(&mut self, stamp: FrameStamp, detections: &[Detection]) {
        if let (Some(epoch), Some(newest)) = (self.epoch, self.history.back()) {
            let t = self.frames_since(epoch, stamp);
            if t <= newest.t || t - newest.t > self.config.break_s * self.config.frame_rate_hz {
                self.end_window();
            }
        }
        let epoch = *self.epoch.get_or_insert(stamp);
        let t = self.frames_since(epoch, stamp);
        let points: Vec<Point> = detections
            .iter()
            .enumerate()
            .map(|(index, detection)| Point {
                detection: *detection,
                t,
                index,
            })
            .collect();
        let taken = self.grow(t, &points);
        self.seed(&points, &taken);
        if self.history.len() >= HISTORY_FRAMES {
            self.history.pop_front();
        }
        self.history.push_back(FramePoints { t, points });
        self.prune(t);
    }

    /// Where the grown paths should be at this stamp: position, how far off it may be, radius (pixels).
    pub fn predictions(&self, stamp: FrameStamp) -> impl Iterator<Item = (Pixel, f64, f64)> + '_ {
        let t = self.epoch.map_or(0.0, |epoch| self.frames_since(epoch, stamp));
        self.alive
            .iter()
            .filter(|h| h.points.len() >= YOUNG.0)
            .filter_map(move |h| h.prediction(t))
            .map(|(at, reach, radius)| (Pixel::new(at.x, at.y), reach, radius))
    }

    /// The likeliest of the paths being followed.
    pub fn open(&self) -> Vec<OpenPath> {
        open_paths(&self.alive, &self.config)
    }

    /// Whether what may be a ball is being followed (a grown path that goes fast), or held back because it may go on: not the
    /// time to change how frames are compared.
    pub fn sees_a_ball(&self) -> bool {
        let is_ball = |h: &Hypothesis| {
            let recent = h.points.len().checked_sub(YOUNG.0);
            let recent = recent.and_then(|from| h.points.get(from..));
            recent.is_some_and(|points| is_fast(points, &self.config))
        };
        self.holds_back() || self.alive.iter().any(is_ball)
    }

    /// Whether a path has ended that may go on.
    pub fn holds_back(&self) -> bool {
        !self.pending.is_empty()
    }

    /// What the paths that have just missed `frames` frames would be if they ended now: mostly they have.
    pub fn ending(&self, frames: f64) -> Vec<TrackedBall> {
        let Some(newest) = self.history.back() else {
            return Vec::new();
        };
        let missed = |h: &Hypothesis| newest.t - h.last_t();
        let candidates = self.alive.iter().filter(|h| {
            h.points.len() >= self.config.points_min && (frames - 0.5..frames + 0.5).contains(&missed(h))
        });
        let mut taken: Vec<&Hypothesis> = Vec::new();
        for hypothesis in candidates {
            let better = |other: &&Hypothesis| {
                other.score > hypothesis.score && hypothesis.shared(&other.points) > SHARED_MAX
            };
            if taken.len() < ENDING_MAX && !self.alive.iter().any(|h| better(&h)) {
                taken.push(hypothesis);
            }
        }
        let balls = taken.into_iter();
        balls
            .filter_map(|h| conclude(&self.config, &self.camera, h, &self.history))
            .map(|(_, ball)| ball)
            .filter(|ball| ball.kind == TrackKind::Pitch && self.is_surely_flying(&ball.shape))
            .collect()
    }

    /// Whether a shape is far beyond what a player's limb makes.
    fn is_surely_flying(&self, shape: &TrackShape) -> bool {
        shape.path_radii() > 3.0 * self.config.path_radii_min
            && shape.speed_radii_per_s() > 1.5 * self.config.speed_radii_per_s_min
    }

    /// The balls finished since the last call.
    pub fn drain(&mut self) -> Vec<TrackedBall> {
        std::mem::take(&mut self.finished)
    }

    /// Ends every track and gives what is left.
    pub fn finish(&mut self) -> Vec<TrackedBall> {
        self.end_window();
        self.drain()
    }

    fn frames_since(&self, epoch: FrameStamp, stamp: FrameStamp) -> f64 {
        stamp.stamped.seconds_since(epoch.stamped.nanos()) * self.config.frame_rate_hz
    }

    fn end_window(&mut self) {
        let mut ended = std::mem::take(&mut self.alive);
        ended.sort_by(|a, b| b.score.total_cmp(&a.score));
        self.ending = ended.iter().map(|h| h.points.clone()).collect();
        for hypothesis in ended {
            self.end(hypothesis);
        }
        self.release();
        self.ending.clear();
        self.history.clear();
        self.recent.clear();
        self.epoch = None;
    }

    /// Extends the hypotheses; tells which detections a grown path has taken.
    fn grow(&mut self, t: f64, points: &[Point]) -> Vec<bool> {
        let mut taken = vec![false; points.len()];
        let mut branches = Vec::new();
        for hypothesis in &mut self.alive {
            let matches = hypothesis.matches(t, points);
            let grown = hypothesis.points.len() >= YOUNG.0;
            for Match { index, gain } in matches.iter().skip(1).take(BRANCHES - 1) {
                if let Some(point) = points.get(*index) {
                    let mut branch = hypothesis.clone();
                    branch.extend(*point, *gain);
                    branches.push(branch);
                }
            }
            match matches.first().and_then(|m| points.get(m.index).map(|p| (m, p))) {
                Some((best, point)) => {
                    if let (true, Some(flag)) = (grown, taken.get_mut(best.index)) {
                        *flag = true;
                    }
                    // A second look at the same frame keeps the unextended path too, as a miss.
                    if best.gain < 0.0 {
                        let mut missed = hypothesis.clone();
                        missed.score -= 0.7;
                        branches.push(missed);
                    }
                    hypothesis.extend(*point, best.gain);
                }
                None => hypothesis.score -= 0.7,
            }
        }
        self.alive.append(&mut branches);
        taken
    }

    /// Starts a hypothesis for every three detections in line that end in this frame.
    fn seed(&mut self, points: &[Point], taken: &[bool]) {
        let mut seeds: Vec<[Point; 3]> = Vec::new();
        let back: Vec<&FramePoints> = self.history.iter().rev().take(SEED_FRAMES).collect();
        for (c, _) in points.iter().zip(taken).filter(|(_, taken)| !**taken) {
            for (i, middle) in back.iter().enumerate().take(2) {
                for pair in middle.points.iter().filter_map(|b| Pair::new(&self.config, b, c)) {
                    for first in back.iter().skip(i + 1).take(2) {
                        let in_line = |a: &&Point| pair.continues(&self.config, a);
                        let found = first.points.iter().filter(in_line);
                        seeds.extend(found.map(|a| [*a, *pair.middle(), *c]));
                    }
                }
            }
        }
        let strength = |seed: &[Point; 3]| seed.iter().map(|p| p.detection.strength).sum::<f64>();
        seeds.sort_by(|a, b| strength(b).total_cmp(&strength(a)));
        self.counters.hypotheses_dropped += seeds.len().saturating_sub(SEEDS_MAX) as u64;
        let seeds = seeds.into_iter().take(SEEDS_MAX);
        self.alive
            .extend(seeds.map(|seed| Hypothesis::new(seed.to_vec())));
    }

    fn prune(&mut self, t: f64) {
        self.alive.sort_by(|a, b| b.score.total_cmp(&a.score));
        let mut kept: Vec<(usize, Hypothesis)> = Vec::with_capacity(self.alive.len());
        let mut ended = Vec::new();
        for hypothesis in std::mem::take(&mut self.alive) {
            let missed = t - hypothesis.last_t();
            let young = hypothesis.points.len() < YOUNG.0;
            let allowed = if young {
                YOUNG.1
            } else {
                f64::from(self.config.gap_frames_max) + 0.5
            };
            if missed > allowed {
                ended.push(hypothesis);
            } else if kept.iter().any(|(_, better)| better.same_end(&hypothesis)) {
                continue;
            } else if family(kept.iter().map(|(_, h)| h), &hypothesis) >= FAMILY_MAX {
                self.counters.hypotheses_dropped += 1;
            } else {
                let here = |(_, better): &&(usize, Hypothesis)| better.ends_with(&hypothesis);
                kept.push((kept.iter().filter(here).count(), hypothesis));
            }
        }
        let extra = kept.len().saturating_sub(self.config.hypotheses_max);
        if extra > 0 {
            self.counters.hypotheses_dropped += extra as u64;
            // The likeliest way to every place stays before the second one to any: birds and flags that have been followed for
            // seconds would else leave no place for a ball just thrown.
            kept.sort_by_key(|(better, _)| *better);
            kept.truncate(self.config.hypotheses_max);
            kept.sort_by(|(_, a), (_, b)| b.score.total_cmp(&a.score));
        }
        self.alive = kept.into_iter().map(|(_, hypothesis)| hypothesis).collect();
        for hypothesis in ended {
            self.end(hypothesis);
        }
        self.release();
    }

    /// Other paths that went beside this one at its velocity.
    fn companions(&self, points: &[Point]) -> usize {
        let alive = self.alive.iter().map(|h| h.points.as_slice());
        let all = alive.chain(self.ending.iter().chain(&self.recent).map(Vec::as_slice));
        let mut found: Vec<&[Point]> = Vec::new();
        for other in all.filter(|other| beside(points, other)) {
            if !found.iter().any(|known| in_both(known, other) > 0) {
                found.push(other);
            }
        }
        found.len()
    }

    /// A path has ended: is it a ball nobody has yet?
    fn end(&mut self, hypothesis: Hypothesis) {
        if hypothesis.points.len() < self.config.points_min / 2 {
            return;
        }
        let better_alive = self
            .alive
            .iter()
            .any(|h| h.score >= hypothesis.score && hypothesis.shared(&h.points) > SHARED_MAX);
        // What goes beyond one held back may be more of that ball.
        let same_begin = |a: &[Point], b: &[Point]| a.first().zip(b.first()).is_some_and(|(a, b)| a.same(b));
        let is_more = |points: &[Point]| {
            let held = self.pending.iter().any(|(held, _)| same_begin(held, points));
            held && points.last().is_some_and(|last| last.t < hypothesis.last_t())
        };
        let mut known = self.recent.iter().filter(|points| !is_more(points));
        if better_alive || known.any(|points| hypothesis.shared(points) > SHARED_MAX) {
            return;
        }
        let Some(ball) = conclude(&self.config, &self.camera, &hypothesis, &self.history) else {
            self.counters.rejected += 1;
            return;
        };
        let (points, mut ball) = ball;
        let shared = |other: &[Point]| in_both(&points, other) as f64 > SHARED_MAX * points.len() as f64;
        // The end of a ball that was lost for a while also finds its begin: the longer one counts, unless that makes
        // a pitch into something else.
        let rest_of = self.pending.iter().position(|(other, _)| shared(other));
        let held = rest_of.and_then(|index| self.pending.get(index));
        if held.is_some_and(|(_, held)| {
            held.track.points.len() >= ball.track.points.len()
                || (held.kind == TrackKind::Pitch && ball.kind != TrackKind::Pitch)
        }) {
            return;
        }
        let is_held = |other: &[Point]| held.is_some_and(|(points, _)| same_begin(other, points));
        if self.recent.iter().any(|other| shared(other) && !is_held(other)) {
            return;
        }
        if let Some((replaced, _)) = rest_of.map(|index| self.pending.remove(index)) {
            self.recent.retain(|other| !same_begin(other, &replaced));
        }
        if ball.kind == TrackKind::Pitch && self.companions(&points) >= COMPANIONS_MIN {
            ball.kind = TrackKind::Group;
        }
        self.recent.push(points.clone());
        if self.recent.len() > RECENT_MAX {
            self.recent.remove(0);
        }
        self.pending.push((points, ball));
    }

    /// Gives out the ended balls that no living path may yet turn out to be the rest of.
    fn release(&mut self) {
        let (alive, gap) = (&self.alive, f64::from(self.config.gap_frames_max));
        let now = self.history.back().map_or(f64::INFINITY, |newest| newest.t);
        // Another path is with the ball where this one, or the way found on from it, has come to.
        let is_seen = |ended: &[Point]| {
            let with = |path: &[Point], last: &Point| {
                let newest = path.iter().rev().take_while(|p| p.t >= last.t);
                newest.last().is_some_and(|p| p.same(last))
            };
            let last = ended.last().filter(|last| now - last.t <= gap);
            last.is_some_and(|last| alive.iter().any(|h| with(&h.points, last)))
        };
        let (held, free): (Vec<_>, Vec<_>) =
            std::mem::take(&mut self.pending)
                .into_iter()
                .partition(|(points, _)| {
                    let more = |h: &Hypothesis| goes_on(points, &h.points) || goes_through(points, &h.points);
                    is_seen(points) || alive.iter().any(more)
                });
        self.pending = held;
        for (_, mut ball) in free {
            ball.track.track = self.next_number;
            self.next_number += 1;
            self.finished.push(ball);
        }
    }
}

/// How many of these paths begin where this one does: the branches of one mover.
fn family<'a>(kept: impl Iterator<Item = &'a Hypothesis>, hypothesis: &Hypothesis) -> usize {
    let Some(first) = hypothesis.points.first() else {
        return 0;
    };
    let begins = kept.filter_map(|h| h.points.first());
    begins.filter(|p| p.same(first)).count()
}

/// Whether a path may be the rest of an ended one: it begins near its end and goes the same way as fast.
fn goes_on(ended: &[Point], path: &[Point]) -> bool {
    let tail = ended.get(ended.len().saturating_sub(YOUNG.0)..).unwrap_or(&[]);
    let (Some((a0, a1)), Some((b0, b1))) = (tail.first().zip(tail.last()), path.first().zip(path.last()))
    else {
        return false;
    };
    let gap = b0.t - a1.t;
    if path.len() < YOUNG.0 || !(-REST_OVERLAP_FRAMES..=REST_GAP_FRAMES).contains(&gap) || b1.t <= a1.t {
        return false;
    }
    let velocity = |from: &Point, to: &Point| (to.position() - from.position()) / (to.t - from.t).max(1.0);
    let (va, vb) = (velocity(a0, a1), velocity(b0, b1));
    (va - vb).norm() < REST_SPEED_SHARE * va.norm()
        && (a1.position() + va * gap - b0.position()).norm() < 2.0 * va.norm() + REST_OFF_PX
}

/// Whether a path comes through the end of an ended one and goes on as fast the same way: light that changed drew the centroids
/// aside, and what was expected went on without them.
fn goes_through(ended: &[Point], path: &[Point]) -> bool {
    let tail = ended.get(ended.len().saturating_sub(YOUNG.0)..).unwrap_or(&[]);
    let Some((from, end)) = tail.first().zip(tail.last()) else {
        return false;
    };
    let at = path.partition_point(|p| p.t < end.t);
    let rest = path.get(at..).unwrap_or(&[]);
    let Some((begin, to)) = rest.first().zip(rest.get(YOUNG.0)) else {
        return false;
    };
    let velocity = |from: &Point, to: &Point| (to.position() - from.position()) / (to.t - from.t).max(1.0);
    let (before, after) = (velocity(from, end), velocity(begin, to));
    begin.same(end) && (before - after).norm() < REST_SPEED_SHARE * before.norm()
}

/// Whether two paths of different detections went side by side for most of the shorter one.
fn beside(a: &[Point], b: &[Point]) -> bool {
    let (Some(a0), Some(a1), Some(b0), Some(b1)) = (a.first(), a.last(), b.first(), b.last()) else {
        return false;
    };
    let (begin, end) = (a0.t.max(b0.t), a1.t.min(b1.t));
    let shorter = (a1.t - a0.t).min(b1.t - b0.t);
    if b.len() < 6 || end - begin < 5.0 || end - begin < 0.5 * shorter || in_both(a, b) > 0 {
        return false;
    }
    let at = |points: &[Point], t: f64| points.iter().find(|p| p.t >= t - 0.5).map(Point::position);
    let (Some(pa0), Some(pa1), Some(pb0), Some(pb1)) = (at(a, begin), at(a, end), at(b, begin), at(b, end))
    else {
        return false;
    };
    let (va, vb) = ((pa1 - pa0) / (end - begin), (pb1 - pb0) / (end - begin));
    (va - vb).norm() < BESIDE.1 * va.norm().max(vb.norm()) && (pa0 - pb0).norm() < BESIDE.0
}

#[cfg(test)]
#[path = "tracker_tests.rs"]
mod tests;
