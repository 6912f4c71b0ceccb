//! How the light of a part of the picture steps from one frame to the next, told by its tiles.
//!
//! Under one lamp all levels are multiplied by the same factor. Where a bright board stands above the ground, each lit by
//! lamps of another phase, one rises while the other falls: then a straight line through the levels of both, which is right
//! for every mixture of the two in between too, the pixels and tiles of their border.

/// Tiles that can be told apart: a tile's number within its cell has four bits.
pub const TILES_MAX: usize = 16;
/// Fewest tiles of a line: half of each half of them.
const LINE_TILES_MIN: usize = 8;
/// A tile is off where its mean level is by so much, levels.
const OFF_LEVELS: f32 = 2.0;
/// A line is asked for where so many tiles are off: a ball is in four at most, a player's arm in a few.
const OFF_TILES_MIN: usize = 4;
/// Bright and dark tiles are apart by so much, levels ...
const APART_LEVELS: f32 = 16.0;
/// ... and the line leaves less than this share of what the factor leaves, each tile counting up to so many levels.
const LEFT_SHARE: f32 = 0.5;
const LEFT_LEVELS_MAX: f32 = 12.0;
/// What a line may multiply by: beyond it is no light.
const GAIN_LIMITS: [f32; 2] = [0.5, 2.0];

/// Levels of a frame as those of the frame before: `gain` · level + `offset`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LightStep {
    /// Factor.
    pub gain: f32,
    /// Levels.
    pub offset: f32,
}

impl LightStep {
    /// The same light.
    pub const NONE: Self = Self {
        gain: 1.0,
        offset: 0.0,
    };

    /// The level in the light of the frame before.
    pub fn level(&self, now: f32) -> f32 {
        self.gain * now + self.offset
    }

    /// This step, and then the one that the frame before is mapped by.
    pub fn then(self, before: Self) -> Self {
        Self {
            gain: before.gain * self.gain,
            offset: before.level(self.offset),
        }
    }
}

/// The tiles of a cell.
#[derive(Default)]
pub struct CellTiles {
    /// Sums of levels now and before, of `count` tiles.
    sums: [[u32; 2]; TILES_MAX],
    count: usize,
}

impl CellTiles {
    /// Those of the sums that show any light, the first [`TILES_MAX`].
    pub fn new<'a>(all: impl Iterator<Item = &'a [u32; 2]>) -> Self {
        let mut tiles = Self::default();
        for (sums, slot) in all.filter(|[n, b]| *n > 0 && *b > 0).zip(&mut tiles.sums) {
            *slot = *sums;
            tiles.count += 1;
        }
        tiles
    }

    fn all(&self) -> &[[u32; 2]] {
        self.sums.get(..self.count).unwrap_or_default()
    }

    /// The step of their light, and by how many levels the mean has risen; each sum is of so many pixels. `None`: nothing
    /// is lit.
    pub fn step(&self, pixels: usize) -> Option<(LightStep, f32)> {
        let unit = 1.0 / pixels.max(1) as f32;
        let (now, before) = agreed(self.all())?;
        let factor = LightStep {
            gain: before / now,
            offset: 0.0,
        };
        let off =
            |step: &LightStep, [n, b]: &[u32; 2]| (*b as f32 * unit - step.level(*n as f32 * unit)).abs();
        let are_off = self.all().iter().filter(|sums| off(&factor, sums) > OFF_LEVELS);
        let change = (now - before) * unit;
        if are_off.count() < OFF_TILES_MIN {
            return Some((factor, change));
        }
        let left = |step: &LightStep| -> f32 {
            let all = self.all().iter();
            all.map(|sums| off(step, sums).min(LEFT_LEVELS_MAX)).sum()
        };
        let line = self.line(unit);
        let line = line.filter(|line| left(line) < LEFT_SHARE * left(&factor));
        Some((line.unwrap_or(factor), change))
    }

    /// The line through what the darker and what the brighter half of the tiles agree on.
    fn line(&self, unit: f32) -> Option<LightStep> {
        if self.count < LINE_TILES_MIN {
            return None;
        }
        let mut by_level = self.sums;
        let tiles = by_level.get_mut(..self.count)?;
        tiles.sort_unstable_by_key(|[now, before]| now + before);
        let (dark, bright) = tiles.split_at(self.count / 2);
        let ((dark_now, dark_before), (now, before)) = (agreed(dark)?, agreed(bright)?);
        let gain = (before - dark_before) / (now - dark_now);
        let is_apart = (now - dark_now) * unit > APART_LEVELS;
        (is_apart && (GAIN_LIMITS[0]..GAIN_LIMITS[1]).contains(&gain)).then_some(LightStep {
            gain,
            offset: (before - gain * now) * unit,
        })
    }
}

/// Mean sums now and before of the half of the tiles whose ratio is in the middle; `None` without any.
fn agreed(tiles: &[[u32; 2]]) -> Option<(f32, f32)> {
    let mut by_ratio = [u32::MAX; TILES_MAX];
    for (place, ([now, before], key)) in tiles.iter().zip(&mut by_ratio).enumerate() {
        // Ratios up to 64 in steps of 2⁻²⁰, with the place in the lowest bits.
        let ratio = (u64::from(*now) << 20) / u64::from(*before).max(1);
        *key = (ratio.min((1 << 26) - 1) as u32) << 4 | place as u32;
    }
    let count = tiles.len().min(TILES_MAX);
    let keys = by_ratio.get_mut(..count)?;
    keys.sort_unstable();
    let middle = keys.get(count / 4..count - count / 4)?;
    let sums = middle.iter().filter_map(|key| tiles.get((key & 15) as usize));
    let (now, before) = sums.fold((0, 0), |(now, before), sums| (now + sums[0], before + sums[1]));
    let share = 1.0 / middle.len().max(1) as f32;
    (now > 0 && before > 0).then_some((now as f32 * share, before as f32 * share))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sums of 64 pixels of these mean levels, now and before.
    fn tiles(levels: &[(f32, f32)]) -> CellTiles {
        let sums: Vec<[u32; 2]> = levels
            .iter()
            .map(|(now, before)| [(64.0 * now) as u32, (64.0 * before) as u32])
            .collect();
        CellTiles::new(sums.iter())
    }

    /// Twelve tiles of 140 and four of 60, all brighter by a tenth now, and three of them with something before it.
    #[test]
    fn one_lamp_is_a_factor() {
        let mut levels = vec![(154.0, 140.0); 12];
        levels.extend([(66.0, 60.0); 4]);
        (levels[0].0, levels[1].0, levels[13].1) = (90.0, 100.0, 200.0);
        let (step, change) = tiles(&levels).step(64).unwrap();
        assert!(
            (step.gain - 1.0 / 1.1).abs() < 1e-5 && step.offset == 0.0,
            "{step:?}"
        );
        // Of the eight in the middle by ratio some may be dark: 6 to 14 levels.
        assert!((6.0..=14.0).contains(&change), "{change}");
    }

    /// A board of 140 falls to 126 while the ground of 60 rises to 66, and two tiles have a quarter of the board: 80 and 81.
    /// One board tile holds a ball. The line through (126, 140) and (66, 60): gain 80/60, offset 140 − 168.
    #[test]
    fn two_lamps_are_a_line() {
        let mut levels = vec![(126.0, 140.0); 9];
        levels.extend([(66.0, 60.0); 5]);
        levels.extend([(81.0, 80.0); 2]);
        levels[3].0 = 110.0;
        let (step, _) = tiles(&levels).step(64).unwrap();
        assert!((step.gain - 4.0 / 3.0).abs() < 0.01, "{step:?}");
        for (now, before) in [(126.0, 140.0), (66.0, 60.0), (81.0, 80.0)] {
            assert!((step.level(now) - before).abs() < 0.5, "{step:?} of {now}");
        }
        // Of three tiles there is no line, and of none nothing.
        assert_eq!(tiles(&levels[8..11]).step(64).unwrap().0.offset, 0.0);
        assert_eq!(tiles(&[(0.0, 5.0)]).step(64), None);
    }

    #[test]
    fn steps_follow_each_other() {
        let (first, second) = (
            LightStep {
                gain: 2.0,
                offset: 3.0,
            },
            LightStep {
                gain: 0.5,
                offset: 10.0,
            },
        );
        // 20 → 43 → 31.5.
        assert_eq!(first.then(second).level(20.0), 31.5);
        assert_eq!(first.then(LightStep::NONE), first);
    }
}
