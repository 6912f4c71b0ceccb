//! Minima of a clock's envelope that stay late: a slower crystal, or a busy host?

use std::collections::VecDeque;

/// Late minima are judged when they are this many σ late together.
const LATE_TOGETHER_SIGMAS: f64 = 12.0;
/// Late minima before they are judged, and the most that are kept.
const LATE_MIN: usize = 6;
const LATE_MAX: usize = 24;
/// Late minima of a slower clock scatter about their line, and begin off the old one, by at most this many σ of minima.
const LINE_SIGMAS: f64 = 3.0;
/// No crystal's rate changes by more at once, seconds per second; and the more, the longer it must be seen, so many
/// seconds for each 1e-6 (a host becomes busy faster than a crystal warms).
pub const RATE_CHANGE_MAX: f64 = 30e-6;
const SECONDS_PER_PPM: f64 = 0.3;

/// Minima that have stayed late, over the line as it was before them.
#[derive(Debug, Clone)]
pub struct Lateness {
    /// Device second of the line before the first.
    pub from_s: f64,
    /// Its offset there, seconds.
    pub offset_s: f64,
    /// Its rate, seconds per second.
    pub rate: f64,
    /// Spread of the minima before the first, seconds.
    pub noise_s: f64,
    /// Device second and offset of each.
    minima: VecDeque<(f64, f64)>,
    /// Sum of σ by which they were late.
    sigmas: f64,
}

impl Lateness {
    /// Of a line at this device second: its offset and rate, and the spread of minima about it.
    pub fn new(from_s: f64, (offset_s, rate): (f64, f64), noise_s: f64) -> Self {
        Self {
            from_s,
            offset_s,
            rate,
            noise_s,
            minima: VecDeque::new(),
            sigmas: 0.0,
        }
    }

    /// Another minimum (device second, offset), so many σ late.
    pub fn add(&mut self, minimum: (f64, f64), sigmas: f64) {
        if self.minima.len() >= LATE_MAX {
            self.minima.pop_front();
        }
        self.minima.push_back(minimum);
        self.sigmas += sigmas;
    }

    /// Seconds per second by which the clock has become slower, if that is what these minima tell.
    pub fn slower_by(&self) -> Option<f64> {
        if self.minima.len() < LATE_MIN || self.sigmas < LATE_TOGETHER_SIGMAS {
            return None;
        }
        // A straight line through the minima, over the old line.
        let over = |(t, y): &(f64, f64)| (t - self.from_s, y - self.offset_s - self.rate * (t - self.from_s));
        let count = self.minima.len() as f64;
        let (t_sum, y_sum) = self
            .minima
            .iter()
            .map(over)
            .fold((0.0, 0.0), |s, m| (s.0 + m.0, s.1 + m.1));
        let (t_mean, y_mean) = (t_sum / count, y_sum / count);
        let (mut tt, mut ty) = (0.0, 0.0);
        for (t, y) in self.minima.iter().map(over) {
            tt += (t - t_mean) * (t - t_mean);
            ty += (t - t_mean) * (y - y_mean);
        }
        let slope = ty / tt.max(1e-12);
        let begin_s = y_mean - slope * t_mean;
        let scatter = |(t, y): (f64, f64)| (y - begin_s - slope * t).powi(2);
        let rms_s = (self.minima.iter().map(over).map(scatter).sum::<f64>() / count).sqrt();
        let small_s = LINE_SIGMAS * self.noise_s;
        // A rate that goes on changing bends the line: it then begins below the old one.
        let begins = (-small_s - 3.0 * slope..small_s + 0.5 * slope).contains(&begin_s);
        let straight = rms_s < small_s && begins;
        let certain = slope > LINE_SIGMAS * rms_s / tt.sqrt();
        let seen_s = self.minima.back().map_or(0.0, |(t, _)| t - self.from_s);
        let long = slope < RATE_CHANGE_MAX && seen_s > SECONDS_PER_PPM * 1e6 * slope;
        (straight && certain && long).then_some(slope)
    }
}
