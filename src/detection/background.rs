//! What is behind a ball: its references, moved and dimmed to match the ring around the ball, and how sure.
//!
//! A reference is an earlier or later frame. Lamps flicker and clouds pass between the two, and a player behind the
//! ball has walked on: the ring of pixels around the ball shows by how much, since the ball does not reach it.

use nalgebra::Vector2;

use super::fit::PictureStart;
use super::lanes::Observation;
use super::patches::Patch;

/// The ring around what the ball reaches is this wide, pixels.
const RING_PX: f64 = 5.0;
/// Fewest pixels of a ring that can be matched.
const RING_MIN: usize = 24;
/// Farthest that a reference is moved, pixels.
const MOVE_MAX_PX: i32 = 4;
/// A ring this many times noisier than its noise is worth moving the reference for.
const MOVE_RATIO: f64 = 1.6;
/// ... if that takes away this share of the mismatch.
const MOVE_GAIN: f64 = 0.7;
/// Mismatch of one pixel counts up to this many σ: the ball itself may be in a reference's ring.
const CLIP_SIGMAS: f64 = 6.0;

/// Where the ball reaches: a streak with a margin.
struct Reach {
    centre: Vector2<f64>,
    half: Vector2<f64>,
    reach_px: f64,
}

impl Reach {
    /// Distance beyond the reach, pixels; negative inside.
    fn beyond(&self, at: Vector2<f64>) -> f64 {
        let off = at - self.centre;
        let along = off.dot(&self.half) / self.half.norm_squared().max(1e-12);
        (off - self.half * along.clamp(-1.0, 1.0)).norm() - self.reach_px
    }
}

/// A reference as it is read: moved by whole pixels and a fraction of one, dimmed.
#[derive(Clone, Copy)]
struct Reference<'a> {
    levels: &'a [u8],
    width: usize,
    whole: (isize, isize),
    /// 0 to 1 to the right and down.
    part: Vector2<f64>,
    gain: f64,
    /// Mean squared mismatch in the ring beyond noise, levels².
    unsure: f64,
}

impl Reference<'_> {
    fn moved_by(self, moved: Vector2<f64>) -> Self {
        let below = |v: f64| v as isize - isize::from(v < 0.0 && v != (v as isize) as f64);
        let whole = (below(moved.x), below(moved.y));
        Self {
            whole,
            part: moved - Vector2::new(whole.0 as f64, whole.1 as f64),
            ..self
        }
    }

    /// Level at a place of the cut-out; `None` outside it.
    fn at(&self, x: usize, y: usize) -> Option<f64> {
        let left = x.checked_add_signed(self.whole.0)?;
        let top = y.checked_add_signed(self.whole.1)?;
        let level = |x: usize, y: usize| -> Option<f64> {
            let x = (x < self.width).then_some(x)?;
            self.levels.get(y * self.width + x).map(|v| f64::from(*v))
        };
        if self.part == Vector2::zeros() {
            return level(left, top).map(|v| self.gain * v);
        }
        let (fx, fy) = (self.part.x, self.part.y);
        let row = |y: usize| -> Option<f64> {
            let right = if fx > 0.0 { level(left + 1, y)? } else { 0.0 };
            Some(level(left, y)? * (1.0 - fx) + right * fx)
        };
        let below = if fy > 0.0 { row(top + 1)? } else { 0.0 };
        Some(self.gain * (row(top)? * (1.0 - fy) + below * fy))
    }
}

/// The pixels around the ball, with their levels and room to compare them with a reference's.
struct Ring {
    places: Vec<(usize, usize, f64)>,
    pairs: Vec<(f64, f64)>,
    differences: Vec<f64>,
}

impl Ring {
    fn new(patch: &Patch<'_>, reach: &Reach) -> Self {
        let places = places(patch).zip(patch.current);
        let places: Vec<(usize, usize, f64)> = places
            .filter(|((x, y), _)| (0.0..RING_PX).contains(&reach.beyond(Vector2::new(*x as f64, *y as f64))))
            .map(|((x, y), level)| (x, y, f64::from(*level)))
            .collect();
        Self {
            pairs: Vec::with_capacity(places.len()),
            differences: Vec::with_capacity(places.len()),
            places,
        }
    }
}

/// The pixels that the ball may reach with what is behind them, and the rms contrast near the centre (a ball
/// may be brighter than the background on one side and darker on the other).
pub fn observe(patch: &Patch<'_>, start: &PictureStart, blur_px: f64) -> (Vec<Observation>, f64) {
    let sigma = patch.difference_sigma.max(0.6);
    let reach = Reach {
        centre: start.centre_px - Vector2::new(patch.left as f64, patch.top as f64),
        half: start.streak_px * 0.5,
        reach_px: 1.3 * start.radius_px + 3.0 * blur_px + 1.0,
    };
    let mut ring = Ring::new(patch, &reach);
    let one = matched((patch.one, patch.width), &mut ring, sigma);
    let other = matched((patch.other, patch.width), &mut ring, sigma);
    let brighter = lift_near(patch, reach.centre) >= 0;
    let mut observations = Vec::with_capacity(patch.current.len());
    let mut contrast = (0.0, 0.0);
    for ((x, y), current) in places(patch).zip(patch.current) {
        let at = Vector2::new(x as f64, y as f64);
        if reach.beyond(at) > 0.0 {
            continue;
        }
        let Some((background, unsure)) = behind(&one, &other, (x, y), (sigma, brighter)) else {
            continue;
        };
        let value = f64::from(*current);
        if (at - reach.centre).norm() < start.radius_px + 0.5 {
            contrast = (contrast.0 + (value - background).powi(2), contrast.1 + 1.0);
        }
        let saturated = if *current == u8::MAX { 400.0 } else { 0.0 };
        observations.push(Observation {
            at: at + Vector2::new(patch.left as f64, patch.top as f64),
            value,
            background,
            variance: 0.75 * sigma * sigma + unsure + saturated,
        });
    }
    (observations, (contrast.0 / f64::max(contrast.1, 1.0)).sqrt())
}

fn places(patch: &Patch<'_>) -> impl Iterator<Item = (usize, usize)> + use<> {
    let width = patch.width.max(1);
    (0..patch.current.len()).map(move |i| (i % width, i / width))
}

/// Level behind a pixel and the variance of what the references leave open.
fn behind(
    one: &Reference<'_>,
    other: &Reference<'_>,
    (x, y): (usize, usize),
    (sigma, brighter): (f64, bool),
) -> Option<(f64, f64)> {
    let (a, b) = match (one.at(x, y), other.at(x, y)) {
        (Some(a), Some(b)) => (a, b),
        (Some(a), None) => return Some((a, one.unsure + 0.25 * sigma * sigma)),
        (None, Some(b)) => return Some((b, other.unsure + 0.25 * sigma * sigma)),
        (None, None) => return None,
    };
    let apart = (a - b).abs();
    let noise = 0.5 * sigma * sigma;
    let (va, vb) = (one.unsure + noise, other.unsure + noise);
    if apart < 3.0 * (va + vb).sqrt() {
        let share = vb / (va + vb);
        // Both references may miss the same thing, so their mismatches do not average out.
        let left = share * one.unsure + (1.0 - share) * other.unsure;
        return Some((share * a + (1.0 - share) * b, left));
    }
    // They differ where one of them holds the ball or something that moves: take the one further from the ball's
    // level, and believe it less.
    let (level, unsure) = if (a < b) == brighter {
        (a, one.unsure)
    } else {
        (b, other.unsure)
    };
    Some((level, unsure + (0.35 * apart).powi(2)))
}

/// The reference that matches the ring best.
fn matched<'a>((levels, width): (&'a [u8], usize), ring: &mut Ring, sigma: f64) -> Reference<'a> {
    let still = Reference {
        levels,
        width,
        whole: (0, 0),
        part: Vector2::zeros(),
        gain: 1.0,
        unsure: 0.0,
    };
    if ring.places.len() < RING_MIN {
        return still;
    }
    let noise = sigma * sigma;
    let (mut best, mut least) = dimmed(still, ring, sigma);
    if least > MOVE_RATIO * noise
        && let Some((moved, cost)) = moved(still, ring, (sigma, MOVE_GAIN * least))
    {
        (best, least) = (moved, cost);
    }
    best.unsure = (least - noise).max(0.0);
    best
}

/// The reference moved to where it matches the ring best, and its mismatch there, if that is below `worth`.
fn moved<'a>(
    still: Reference<'a>,
    ring: &mut Ring,
    (sigma, worth): (f64, f64),
) -> Option<(Reference<'a>, f64)> {
    let mut costs = [[f64::INFINITY; 2 * MOVE_MAX_PX as usize + 1]; 2 * MOVE_MAX_PX as usize + 1];
    let (mut least, mut place) = (worth, None);
    for (dy, row) in (-MOVE_MAX_PX..).zip(&mut costs) {
        for (dx, slot) in (-MOVE_MAX_PX..).zip(row) {
            let by = Vector2::new(f64::from(dx), f64::from(dy));
            let (trial, cost) = dimmed(still.moved_by(by), ring, sigma);
            *slot = cost;
            if cost < least {
                (least, place) = (cost, Some((dx, dy, trial)));
            }
        }
    }
    let (dx, dy, whole) = place?;
    let cost = |dx: i32, dy: i32| {
        let row = costs.get((dy + MOVE_MAX_PX) as usize);
        row.and_then(|row| row.get((dx + MOVE_MAX_PX) as usize)).copied()
    };
    let part_x = vertex(cost(dx - 1, dy), least, cost(dx + 1, dy));
    let part_y = vertex(cost(dx, dy - 1), least, cost(dx, dy + 1));
    let by = Vector2::new(f64::from(dx) + part_x, f64::from(dy) + part_y);
    let (finer, finer_cost) = dimmed(still.moved_by(by), ring, sigma);
    Some(if finer_cost < least {
        (finer, finer_cost)
    } else {
        (whole, least)
    })
}

/// Where a parabola through three costs one pixel apart is lowest, −½ to ½.
fn vertex(before: Option<f64>, here: f64, after: Option<f64>) -> f64 {
    let (Some(before), Some(after)) = (before, after) else {
        return 0.0;
    };
    let part = 0.5 * (before - after) / (before - 2.0 * here + after);
    if part.is_finite() {
        part.clamp(-0.5, 0.5)
    } else {
        0.0
    }
}

/// The reference with the gain that the ring shows, and the mean squared mismatch left, levels².
fn dimmed<'a>(mut reference: Reference<'a>, ring: &mut Ring, sigma: f64) -> (Reference<'a>, f64) {
    reference.gain = 1.0;
    let Ring {
        places,
        pairs,
        differences,
    } = ring;
    pairs.clear();
    let behind = |(x, y, level): &(usize, usize, f64)| Some((*level, reference.at(*x, *y)?));
    pairs.extend(places.iter().filter_map(behind));
    if pairs.len() < RING_MIN {
        return (reference, f64::INFINITY);
    }
    let mean = pairs.iter().map(|(_, b)| b).sum::<f64>() / pairs.len() as f64;
    // The mean of the differences that are no larger than noise and a few levels: whole levels have no fine median.
    differences.clear();
    differences.extend(pairs.iter().map(|(c, b)| c - b));
    let half = differences.len() / 2;
    let (_, middle, _) = differences.select_nth_unstable_by(half, f64::total_cmp);
    let middle = *middle;
    let (sum, count) = differences
        .iter()
        .filter(|d| (*d - middle).abs() < 2.5 * sigma)
        .fold((0.0, 0.0), |(sum, count), d| (sum + d, count + 1.0));
    let offset = sum / f64::max(count, 1.0);
    reference.gain = (1.0 + offset / mean.max(1.0)).clamp(0.5, 2.0);
    let clip = (CLIP_SIGMAS * sigma).powi(2);
    let squares: f64 = pairs
        .iter()
        .map(|(c, b)| (c - b * reference.gain).powi(2).min(clip))
        .sum();
    (reference, squares / pairs.len() as f64)
}

/// Sum of the change of the nine pixels around the start: positive for a ball brighter than the background.
fn lift_near(patch: &Patch<'_>, centre: Vector2<f64>) -> i32 {
    let (x, y) = (
        centre.x.max(0.0).round() as usize,
        centre.y.max(0.0).round() as usize,
    );
    let mut lift = 0i32;
    for dy in 0..3 {
        for dx in 0..3 {
            let index = (y + dy).saturating_sub(1) * patch.width + (x + dx).saturating_sub(1);
            if let (Some(c), Some(a), Some(b)) = (
                patch.current.get(index),
                patch.one.get(index),
                patch.other.get(index),
            ) {
                lift += 2 * i32::from(*c) - i32::from(*a) - i32::from(*b);
            }
        }
    }
    lift
}
