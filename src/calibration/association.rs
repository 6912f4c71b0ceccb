//! Tracks of several cameras that are the same ball: by time where the stamps agree, by the pitches' rhythm
//! where they are whole seconds off.

use super::PitchTracks;
use crate::scene::{Rig, Track};

/// How tracks are told to belong together.
#[derive(Debug, Clone, PartialEq)]
pub struct AssociationOptions {
    /// Two events agree when their midpoints differ by at most this after the offset, seconds: cameras see
    /// different parts of a flight, so midpoints scatter by a part of its 0.45 s.
    pub tolerance_s: f64,
    /// Offsets this close to the expected one are preferred, seconds: ±30 frames and different parts seen.
    pub expected_window_s: f64,
    /// The same where the rig gives a rough `time_offset_s`.
    pub rough_window_s: f64,
    /// Largest clock skew expected, ppm.
    pub skew_ppm: f64,
    /// Longest gap between two pieces of one track, seconds.
    pub piece_gap_s: f64,
}

impl Default for AssociationOptions {
    fn default() -> Self {
        Self {
            tolerance_s: 0.25,
            expected_window_s: 0.6,
            rough_window_s: 1.8,
            skew_ppm: 200.0,
            piece_gap_s: 0.3,
        }
    }
}

/// Pitches, and how each camera's stamps lie against the reference camera's.
#[derive(Debug, Clone, PartialEq)]
pub struct Association {
    /// In time order; a pitch may have been seen by one camera only.
    pub pitches: Vec<PitchTracks>,
    /// Per rig camera: median of (its midpoint − the reference's midpoint) of the same pitch, in stamps,
    /// seconds: the capture delay to within the parts of the flight seen. `None`: no pitch in common.
    pub offset_s: Vec<Option<f64>>,
}

/// [`associate`], pitches only.
pub fn group_pitches(rig: &Rig, tracks: &[Track]) -> Vec<PitchTracks> {
    associate(rig, tracks, &AssociationOptions::default()).pitches
}

/// One ball in one camera: one track, or several pieces of it.
#[derive(Debug, Clone)]
struct Event {
    camera: usize,
    pieces: Vec<usize>,
    /// Seconds after the epoch, by the camera's stamps.
    start_s: f64,
    end_s: f64,
    points: usize,
}

impl Event {
    fn middle_s(&self) -> f64 {
        0.5 * (self.start_s + self.end_s)
    }
}

/// Groups the tracks of all cameras into pitches. Tracks of cameras that are not in the rig, and tracks without
/// points, are left out.
pub fn associate(rig: &Rig, tracks: &[Track], options: &AssociationOptions) -> Association {
    let cameras = rig.cameras.len();
    let epoch_ns = tracks
        .iter()
        .filter_map(Track::span)
        .map(|(a, _)| a.nanos())
        .min()
        .unwrap_or(0);
    let mut events: Vec<Vec<Event>> = (0..cameras)
        .map(|camera| camera_events(rig, tracks, camera, (epoch_ns, options.piece_gap_s)))
        .collect();
    let mut offset_s = vec![None; cameras];
    let Some(base) = base_camera(rig, &events) else {
        return Association {
            pitches: Vec::new(),
            offset_s,
        };
    };
    offset_s[base] = Some(0.0);
    // The time scale everything is moved to: midpoints of the events placed so far.
    let mut timeline: Vec<f64> = events[base].iter().map(Event::middle_s).collect();
    let mut open: Vec<usize> = (0..cameras)
        .filter(|&c| c != base && !events[c].is_empty())
        .collect();
    while !open.is_empty() {
        let fits = open.iter().map(|&c| {
            let middles: Vec<f64> = events[c].iter().map(Event::middle_s).collect();
            (
                c,
                best_offset(&timeline, &middles, expected(rig, (base, c), options), options),
            )
        });
        let best = fits.max_by(|a, b| score(&a.1).total_cmp(&score(&b.1)));
        let Some((camera, Some(map))) = best else {
            break;
        };
        open.retain(|&c| c != camera);
        offset_s[camera] = Some(map.offset_s);
        for event in &mut events[camera] {
            let shift = map.at(event.middle_s());
            event.start_s -= shift;
            event.end_s -= shift;
            timeline.push(event.middle_s());
        }
        timeline.sort_by(f64::total_cmp);
        timeline.dedup_by(|b, a| *b - *a < options.tolerance_s);
    }
    // Cameras without a common pitch keep their tracks, apart from everyone else's.
    let placed: Vec<Event> = events
        .iter()
        .flatten()
        .filter(|e| offset_s[e.camera].is_some())
        .cloned()
        .collect();
    let alone = events.iter().flatten().filter(|e| offset_s[e.camera].is_none());
    let mut groups = clusters(placed, options.tolerance_s);
    groups.extend(alone.map(|e| vec![e.clone()]));
    let pitches = groups
        .into_iter()
        .map(|group| PitchTracks {
            tracks: group
                .iter()
                .flat_map(|e| &e.pieces)
                .map(|&i| tracks[i].clone())
                .collect(),
        })
        .collect();
    relative_to_reference(&mut offset_s, rig.reference);
    Association { pitches, offset_s }
}

fn relative_to_reference(offset_s: &mut [Option<f64>], reference: usize) {
    let Some(zero) = offset_s[reference] else {
        return;
    };
    for offset in offset_s.iter_mut().flatten() {
        *offset -= zero;
    }
}

fn base_camera(rig: &Rig, events: &[Vec<Event>]) -> Option<usize> {
    if events.get(rig.reference).is_some_and(|e| !e.is_empty()) {
        return Some(rig.reference);
    }
    (0..events.len())
        .filter(|&c| !events[c].is_empty())
        .max_by_key(|&c| events[c].len())
}

/// Where the offset of a camera against the base is expected, and how wide.
fn expected(rig: &Rig, (base, camera): (usize, usize), options: &AssociationOptions) -> (f64, f64) {
    let rough = |c: usize| rig.cameras[c].time_offset_s;
    if rough(camera).is_none() && rough(base).is_none() {
        return (0.0, options.expected_window_s);
    }
    // Stamps + time_offset = reference stamps, so a camera with a positive offset is behind.
    let offset = rough(base).unwrap_or(0.0) - rough(camera).unwrap_or(0.0);
    (offset, options.rough_window_s)
}

/// Pieces of one camera merged into balls.
fn camera_events(rig: &Rig, tracks: &[Track], camera: usize, (epoch_ns, gap_s): (i64, f64)) -> Vec<Event> {
    let id = &rig.cameras[camera].id;
    let mut order: Vec<usize> = (0..tracks.len())
        .filter(|&i| tracks[i].camera == *id && !tracks[i].points.is_empty())
        .collect();
    order.sort_by_key(|&i| tracks[i].span().map(|(a, _)| a.nanos()));
    let mut events: Vec<Event> = Vec::new();
    for i in order {
        let Some((first, last)) = tracks[i].span() else {
            continue;
        };
        let (start_s, end_s) = (first.seconds_since(epoch_ns), last.seconds_since(epoch_ns));
        let points = tracks[i].points.len();
        let owner = events.iter_mut().rev().take(4).find(|e| {
            let before = e.pieces.last().map(|&p| &tracks[p]);
            start_s - e.end_s <= gap_s && before.is_some_and(|b| continues(b, &tracks[i]))
        });
        match owner {
            Some(event) => {
                event.pieces.push(i);
                event.end_s = event.end_s.max(end_s);
                event.points += points;
            }
            None => events.push(Event {
                camera,
                pieces: vec![i],
                start_s,
                end_s,
                points,
            }),
        }
    }
    events
}

/// Whether `next` can be the same ball as `before`: it begins after `before` has ended, and straight lines
/// through the end of the one and the beginning of the other meet in the gap.
fn continues(before: &Track, next: &Track) -> bool {
    let (Some((_, end)), Some((start, _))) = (before.span(), next.span()) else {
        return false;
    };
    if start <= end {
        return false;
    }
    let epoch = end.nanos();
    let middle = 0.5 * start.seconds_since(epoch);
    let line = |points: &[crate::scene::TrackPoint]| -> Option<([f64; 2], [f64; 2])> {
        let n = points.len() as f64;
        let t: Vec<f64> = points.iter().map(|p| p.stamped.seconds_since(epoch)).collect();
        let mean_t = t.iter().sum::<f64>() / n;
        let spread: f64 = t.iter().map(|t| (t - mean_t).powi(2)).sum();
        if !(spread > 0.0) {
            return None;
        }
        let fit = |value: fn(&crate::scene::TrackPoint) -> f64| {
            let mean = points.iter().map(value).sum::<f64>() / n;
            let slope = points
                .iter()
                .zip(&t)
                .map(|(p, t)| (t - mean_t) * (value(p) - mean))
                .sum::<f64>()
                / spread;
            (mean + slope * (middle - mean_t), slope)
        };
        let (x, y) = (fit(|p| p.pixel.x), fit(|p| p.pixel.y));
        Some(([x.0, y.0], [x.1, y.1]))
    };
    let tail = &before.points[before.points.len().saturating_sub(8)..];
    let head = &next.points[..next.points.len().min(8)];
    let (Some((a, va)), Some((b, vb))) = (line(tail), line(head)) else {
        return false;
    };
    let speed = va[0].hypot(va[1]).max(vb[0].hypot(vb[1]));
    let turn = (va[0] - vb[0]).hypot(va[1] - vb[1]);
    let miss = (a[0] - b[0]).hypot(a[1] - b[1]);
    // Perspective changes the speed in the image, so the lines miss by a part of the way across the gap.
    miss < 8.0 + 0.3 * speed * 2.0 * middle && turn < 0.5 * speed
}

/// Straight line from base time to a camera's stamps.
#[derive(Debug, Clone, Copy)]
struct TimeMap {
    offset_s: f64,
    slope: f64,
    anchor_s: f64,
    score: f64,
}

impl TimeMap {
    /// Stamp − base time at a stamp.
    fn at(&self, stamp_s: f64) -> f64 {
        self.offset_s + self.slope * (stamp_s - self.anchor_s)
    }
}

fn score(map: &Option<TimeMap>) -> f64 {
    map.map_or(f64::NEG_INFINITY, |m| m.score)
}

/// The offset at which most events of `own` meet one of `base`.
fn best_offset(
    base: &[f64],
    own: &[f64],
    expected: (f64, f64),
    options: &AssociationOptions,
) -> Option<TimeMap> {
    let near = |d: f64| (d - expected.0).abs() <= expected.1;
    let mut best: Option<TimeMap> = None;
    for &b in base {
        for &o in own {
            let start = TimeMap {
                offset_s: o - b,
                slope: 0.0,
                anchor_s: o,
                score: 0.0,
            };
            let drift = options.skew_ppm * 1e-6;
            let rough = matches(base, own, &start, (options.tolerance_s, drift));
            // Lonely coincidences prove nothing, unless the clocks are said to agree or there is nothing else.
            if rough.len() < 2 && !near(start.offset_s) && base.len().max(own.len()) > 1 {
                continue;
            }
            let fitted = fit_line(&rough, &start, options);
            let kept = matches(base, own, &fitted, (options.tolerance_s, 0.0));
            let spread =
                kept.iter().map(|(t, d)| (d - fitted.at(*t)).abs()).sum::<f64>() / kept.len().max(1) as f64;
            let bonus = if near(fitted.offset_s) { 0.75 } else { 0.0 };
            let score = kept.len() as f64 + bonus - spread / options.tolerance_s;
            if best.is_none_or(|m| score > m.score) && !kept.is_empty() {
                best = Some(TimeMap { score, ..fitted });
            }
        }
    }
    best
}

/// Events of both that meet under a map: (stamp, stamp − base time), one to one, nearest first in time order.
fn matches(base: &[f64], own: &[f64], map: &TimeMap, (tolerance_s, drift): (f64, f64)) -> Vec<(f64, f64)> {
    let mut found = Vec::new();
    let mut from = 0;
    for &o in own {
        let target = o - map.at(o);
        let room = tolerance_s + drift * (o - map.anchor_s).abs();
        let window = base
            .iter()
            .enumerate()
            .skip(from)
            .filter(|(_, b)| (*b - target).abs() <= room);
        if let Some((k, b)) = window.min_by(|a, b| (a.1 - target).abs().total_cmp(&(b.1 - target).abs())) {
            found.push((o, o - b));
            from = k + 1;
        }
    }
    found
}

/// Median offset, and a slope where the matches are long and many enough to show one.
fn fit_line(matched: &[(f64, f64)], start: &TimeMap, options: &AssociationOptions) -> TimeMap {
    let mut slopes = Vec::new();
    for (i, a) in matched.iter().enumerate() {
        for b in &matched[i + 1..] {
            // Midpoints scatter by some 50 ms, so only long distances tell a slope.
            if (b.0 - a.0).abs() > 600.0 {
                slopes.push((b.1 - a.1) / (b.0 - a.0));
            }
        }
    }
    let limit = options.skew_ppm * 1e-6;
    let slope = if slopes.len() >= 6 {
        median(&mut slopes).clamp(-limit, limit)
    } else {
        0.0
    };
    let mut offsets: Vec<f64> = matched
        .iter()
        .map(|(t, d)| d - slope * (t - start.anchor_s))
        .collect();
    if offsets.is_empty() {
        return *start;
    }
    TimeMap {
        offset_s: median(&mut offsets),
        slope,
        anchor_s: start.anchor_s,
        score: 0.0,
    }
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    let n = values.len();
    if n % 2 == 1 {
        values[n / 2]
    } else {
        0.5 * (values[n / 2 - 1] + values[n / 2])
    }
}

/// Events within the tolerance of one another, at most one per camera: where two compete, the one with more
/// points, and nearer to the other cameras' time, wins and the other stays alone.
fn clusters(mut events: Vec<Event>, tolerance_s: f64) -> Vec<Vec<Event>> {
    events.sort_by(|a, b| a.middle_s().total_cmp(&b.middle_s()));
    let mut groups: Vec<Vec<Event>> = Vec::new();
    for event in events {
        let fits = groups.last().is_some_and(|g| {
            let first = g.iter().map(Event::middle_s).fold(f64::INFINITY, f64::min);
            event.middle_s() - first <= 1.5 * tolerance_s
        });
        match groups.last_mut() {
            Some(group) if fits => group.push(event),
            _ => groups.push(vec![event]),
        }
    }
    groups
        .iter()
        .flat_map(|g| one_per_camera(g, tolerance_s))
        .collect()
}

fn one_per_camera(group: &[Event], tolerance_s: f64) -> Vec<Vec<Event>> {
    let mut chosen: Vec<Event> = Vec::new();
    let mut rest: Vec<Event> = Vec::new();
    let rank = |e: &Event| {
        let others = group.iter().filter(|o| o.camera != e.camera);
        let apart = others
            .map(|o| (o.middle_s() - e.middle_s()).abs())
            .fold(f64::INFINITY, f64::min);
        let apart = if apart.is_finite() { apart } else { 0.0 };
        e.points as f64 * (1.0 - 0.8 * (apart / tolerance_s).min(1.0))
    };
    let mut by_rank: Vec<(f64, Event)> = group.iter().map(|e| (rank(e), e.clone())).collect();
    by_rank.sort_by(|a, b| b.0.total_cmp(&a.0));
    for (_, event) in by_rank {
        if chosen.iter().any(|c| c.camera == event.camera) {
            rest.push(event);
        } else {
            chosen.push(event);
        }
    }
    let mut groups = vec![chosen];
    groups.extend(rest.into_iter().map(|e| vec![e]));
    groups
}

#[cfg(test)]
mod tests;
