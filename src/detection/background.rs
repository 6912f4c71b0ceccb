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

/// A reference as it is read: moved by a fraction of a pixel, dimmed.
struct Reference<'a> {
    levels: &'a [u8],
    width: usize,
    moved: Vector2<f64>,
    gain: f64,
    /// Mean squared mismatch in the ring beyond noise, levels².
    unsure: f64,
}

impl Reference<'_> {
    /// Level at a place of the cut-out; `None` outside it.
    fn at(&self, x: usize, y: usize) -> Option<f64> {
        if self.moved == Vector2::zeros() {
            return self
                .levels
                .get(y * self.width + x)
                .map(|v| self.gain * f64::from(*v));
        }
        let (px, py) = (x as f64 + self.moved.x, y as f64 + self.moved.y);
        let (fx, fy) = (px - px.floor(), py - py.floor());
        if px < 0.0 || py < 0.0 {
            return None;
        }
        let (left, top) = (px as usize, py as usize);
        let level = |x: usize, y: usize| -> Option<f64> {
            let x = (x < self.width).then_some(x)?;
            self.levels.get(y * self.width + x).map(|v| f64::from(*v))
        };
        let row = |y: usize| -> Option<f64> {
            let right = if fx > 0.0 { level(left + 1, y)? } else { 0.0 };
            Some(level(left, y)? * (1.0 - fx) + right * fx)
        };
        let below = if fy > 0.0 { row(top + 1)? } else { 0.0 };
        Some(self.gain * (row(top)? * (1.0 - fy) + below * fy))
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
    let ring: Vec<(usize, usize)> = places(patch)
        .filter(|(x, y)| (0.0..RING_PX).contains(&reach.beyond(Vector2::new(*x as f64, *y as f64))))
        .collect();
    let one = matched(patch, patch.one, &ring, sigma);
    let other = matched(patch, patch.other, &ring, sigma);
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
fn matched<'a>(patch: &Patch<'_>, levels: &'a [u8], ring: &[(usize, usize)], sigma: f64) -> Reference<'a> {
    let mut best = Reference {
        levels,
        width: patch.width,
        moved: Vector2::zeros(),
        gain: 1.0,
        unsure: 0.0,
    };
    if ring.len() < RING_MIN {
        return best;
    }
    let noise = sigma * sigma;
    let mut least = dim(patch, &mut best, ring, sigma);
    if least > MOVE_RATIO * noise {
        let still = least;
        let mut place = (0, 0);
        let mut costs = [[f64::INFINITY; 2 * MOVE_MAX_PX as usize + 1]; 2 * MOVE_MAX_PX as usize + 1];
        for dy in -MOVE_MAX_PX..=MOVE_MAX_PX {
            for dx in -MOVE_MAX_PX..=MOVE_MAX_PX {
                let mut trial = Reference {
                    moved: Vector2::new(f64::from(dx), f64::from(dy)),
                    ..best
                };
                let cost = dim(patch, &mut trial, ring, sigma);
                if let Some(slot) = costs
                    .get_mut((dy + MOVE_MAX_PX) as usize)
                    .and_then(|row| row.get_mut((dx + MOVE_MAX_PX) as usize))
                {
                    *slot = cost;
                }
                if cost < least {
                    (least, place) = (cost, (dx, dy));
                }
            }
        }
        if least < MOVE_GAIN * still {
            let cost = |dx: i32, dy: i32| {
                let row = costs.get((dy + MOVE_MAX_PX) as usize);
                row.and_then(|row| row.get((dx + MOVE_MAX_PX) as usize)).copied()
            };
            let (dx, dy) = place;
            let part_x = vertex(cost(dx - 1, dy), least, cost(dx + 1, dy));
            let part_y = vertex(cost(dx, dy - 1), least, cost(dx, dy + 1));
            let mut finer = Reference {
                moved: Vector2::new(f64::from(dx) + part_x, f64::from(dy) + part_y),
                ..best
            };
            best.moved = Vector2::new(f64::from(dx), f64::from(dy));
            let finer_cost = dim(patch, &mut finer, ring, sigma);
            if finer_cost < least {
                (least, best) = (finer_cost, finer);
            } else {
                least = dim(patch, &mut best, ring, sigma);
            }
        }
    }
    best.unsure = (least - noise).max(0.0);
    best
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

/// Sets the reference's gain to the ring's median ratio and gives the mean squared mismatch left, levels².
fn dim(patch: &Patch<'_>, reference: &mut Reference<'_>, ring: &[(usize, usize)], sigma: f64) -> f64 {
    reference.gain = 1.0;
    let mut pairs: Vec<(f64, f64)> = Vec::with_capacity(ring.len());
    for (x, y) in ring {
        let level = patch.current.get(y * patch.width + x);
        if let (Some(current), Some(behind)) = (level, reference.at(*x, *y)) {
            pairs.push((f64::from(*current), behind));
        }
    }
    if pairs.len() < RING_MIN {
        return f64::INFINITY;
    }
    let mean = pairs.iter().map(|(_, b)| b).sum::<f64>() / pairs.len() as f64;
    // The mean of the differences that are no larger than noise and a few levels: whole levels have no fine median.
    let mut differences: Vec<f64> = pairs.iter().map(|(c, b)| c - b).collect();
    differences.sort_by(f64::total_cmp);
    let middle = differences.get(differences.len() / 2).copied().unwrap_or(0.0);
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
    squares / pairs.len() as f64
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
