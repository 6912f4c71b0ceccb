//! Which frames lamps light alike: those a whole number of the light's periods apart, or nearly.
//!
//! Light is evened cell by cell ([`super::light`]), but a cell may hold two lights, such as a board before a lit crowd, and lamps
//! on other wires rise when these fall. A reference in which all of them are as they are now needs no evening.

use std::collections::VecDeque;

/// Mismatches are means over so many frames.
const FRAMES: f32 = 96.0;
/// Nothing is chosen before so many have been seen.
const FRAMES_MIN: f32 = 24.0;
/// A mismatch below this is no flicker, levels.
const MISMATCH_MIN: f32 = 0.4;
/// More frames than needed are chosen where the mismatch is at most this share ...
const GAIN: f32 = 0.6;
/// ... and the fewest that are worse than the best by no more than this ratio.
const ALIKE: f32 = 1.25;

/// How the light changes from frame to frame, and over several.
pub struct Phases {
    /// Sum and number of the changes taken of each column of regions of the newest frame, levels.
    taken: Vec<(f32, u32)>,
    /// Mean changes of the frames before, the newest first; each a row of columns.
    past: VecDeque<Vec<f32>>,
    /// Mean size of the change over 1, 2, … frames, levels.
    mismatches: Vec<f32>,
    /// Changes over several frames, of each column.
    over: Vec<f32>,
    /// Frames seen, at most [`FRAMES`].
    frames: f32,
}

impl Phases {
    /// For so many columns of regions, and lags up to this many frames.
    pub fn new(columns: usize, lag_max: usize) -> Self {
        Self {
            taken: vec![(0.0, 0); columns],
            past: VecDeque::from(vec![vec![0.0; columns]; lag_max.max(1)]),
            mismatches: vec![0.0; lag_max.max(1)],
            over: vec![0.0; columns],
            frames: 0.0,
        }
    }

    /// Takes a mean change from the frame before to the newest, levels.
    #[inline]
    pub fn take(&mut self, column: usize, change: f32) {
        if let Some((sum, count)) = self.taken.get_mut(column) {
            *sum += change;
            *count = count.saturating_add(1);
        }
    }

    /// Ends the newest frame.
    pub fn end_frame(&mut self) {
        if self.taken.iter().all(|(_, count)| *count == 0) {
            return;
        }
        let mut newest = self.past.pop_back().unwrap_or_default();
        for (mean, (sum, count)) in newest.iter_mut().zip(&mut self.taken) {
            *mean = *sum / (*count).max(1) as f32;
            (*sum, *count) = (0.0, 0);
        }
        self.past.push_front(newest);
        self.frames = (self.frames + 1.0).min(FRAMES);
        let columns = self.taken.len().max(1) as f32;
        self.over.fill(0.0);
        for (mismatch, changes) in self.mismatches.iter_mut().zip(&self.past) {
            for (over, change) in self.over.iter_mut().zip(changes) {
                *over += change;
            }
            let mean = self.over.iter().map(|over| over.abs()).sum::<f32>() / columns;
            *mismatch += (mean - *mismatch) / self.frames;
        }
    }

    /// How many frames away a reference is best where at least so many are needed: that many, or more over which the light
    /// changes much less.
    pub fn lag_from(&self, needed: usize) -> usize {
        let mismatch = |lag: usize| self.mismatches.get(lag.checked_sub(1)?).copied();
        let Some(asked) = mismatch(needed).filter(|asked| *asked > MISMATCH_MIN) else {
            return needed;
        };
        let longer = || (needed..=self.mismatches.len()).filter_map(|lag| Some((lag, mismatch(lag)?)));
        let least = longer().map(|(_, mismatch)| mismatch).fold(asked, f32::min);
        if self.frames < FRAMES_MIN || least > GAIN * asked {
            return needed;
        }
        longer()
            .find(|(_, mismatch)| *mismatch <= ALIKE * least)
            .map_or(needed, |(lag, _)| lag)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// After a second of lamps at so many hertz, half of which rise when the others fall.
    fn after_a_second(lamps_hz: f32, frames_hz: f32, amplitude: f32) -> Phases {
        let mut phases = Phases::new(4, 10);
        let light =
            |number: usize| amplitude * (std::f32::consts::TAU * lamps_hz * number as f32 / frames_hz).cos();
        for number in 1..frames_hz as usize {
            for (column, sign) in [1.0, 1.0, -1.0, 0.0].into_iter().enumerate() {
                phases.take(column, sign * (light(number) - light(number - 1)));
            }
            phases.end_frame();
        }
        phases
    }

    #[test]
    fn the_lag_is_near_whole_periods_of_the_lamps() {
        // 120 Hz at 175 frames a second: 0.686 periods a frame, 2.06 in 3, 4.11 in 6; 4.8 in 7, and 6.86 in 10 is little better.
        let phases = after_a_second(120.0, 175.0, 5.0);
        assert_eq!(
            [1, 2, 3, 4, 7].map(|needed| phases.lag_from(needed)),
            [3, 3, 3, 6, 7]
        );
        // 100 Hz: 0.571 a frame, 4 in 7.
        let phases = after_a_second(100.0, 175.0, 5.0);
        assert_eq!([1, 6, 7].map(|needed| phases.lag_from(needed)), [7, 7, 7]);
        // 120 Hz at 120 frames a second: always the same.
        let phases = after_a_second(120.0, 120.0, 5.0);
        assert_eq!([1, 6].map(|needed| phases.lag_from(needed)), [1, 6]);
    }

    #[test]
    fn without_flicker_the_lag_is_what_is_needed() {
        let phases = after_a_second(120.0, 175.0, 0.1);
        assert_eq!(
            [1, 2, 6, 10, 12].map(|needed| phases.lag_from(needed)),
            [1, 2, 6, 10, 12]
        );
        // A cloud: the longer the lag, the more has changed.
        let mut phases = Phases::new(4, 10);
        for _ in 0..100 {
            (0..4).for_each(|column| phases.take(column, -0.5));
            phases.end_frame();
        }
        assert_eq!([1, 5].map(|needed| phases.lag_from(needed)), [1, 5]);
    }
}
