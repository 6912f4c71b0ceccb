//! The times that a video file has of its own: not believed, but where they are uneven a rate does not hold.

/// A step above this share of the usual one, and longer by this many seconds than it (files round to milliseconds), is
/// uneven.
const UNEVEN: (f64, f64) = (1.5, 0.0015);

/// The steps between a video's frames by its own times.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct OwnTimes {
    last_s: Option<f64>,
    steps_s: Vec<f32>,
}

/// Frames that come late by a video's own times.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Uneven {
    /// How many.
    pub count: usize,
    /// The first of them, counted from 0.
    pub first: usize,
    /// How long after the one before it comes, seconds.
    pub step_s: f64,
    /// How long that is for half of the frames at most.
    pub usual_s: f64,
}

impl OwnTimes {
    /// Takes the time of the next frame.
    pub fn push(&mut self, time_s: f64) {
        if let Some(last_s) = self.last_s.replace(time_s) {
            self.steps_s.push((time_s - last_s) as f32);
        }
    }

    /// The frames that come later than the others do; `None`: they come evenly, or the file does not say.
    pub fn uneven(&self) -> Option<Uneven> {
        let mut sorted = self.steps_s.clone();
        sorted.sort_unstable_by(f32::total_cmp);
        let usual_s = f64::from(*sorted.get(sorted.len() / 2)?);
        let (share, seconds) = UNEVEN;
        let limit_s = (share * usual_s).max(usual_s + seconds);
        let late = self.steps_s.iter().map(|step| f64::from(*step)).zip(1..);
        let mut late = late.filter(|(step_s, _)| usual_s > 0.0 && *step_s > limit_s);
        let (step_s, first) = late.next()?;
        Some(Uneven {
            count: 1 + late.count(),
            first,
            step_s,
            usual_s,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn uneven(times_ms: impl Iterator<Item = f64>) -> Option<Uneven> {
        let mut times = OwnTimes::default();
        for ms in times_ms {
            times.push(ms / 1e3);
        }
        times.uneven()
    }

    #[test]
    fn a_gap_is_uneven_and_rounding_is_not() {
        for rate_hz in [10.0, 29.97, 59.94, 240.0, 400.0, 960.0] {
            let rounded = (0..200).map(|n| (1e3 * f64::from(n) / rate_hz).round());
            assert_eq!(uneven(rounded), None, "{rate_hz} Hz");
        }
        let lost = (0..100)
            .filter(|n| ![40, 41, 70].contains(n))
            .map(|n| 40.0 * f64::from(n));
        let found = uneven(lost).unwrap();
        assert_eq!((found.count, found.first), (2, 40));
        assert!(
            (found.step_s - 0.12).abs() < 1e-6 && (found.usual_s - 0.04).abs() < 1e-6,
            "{found:?}"
        );
    }

    #[test]
    fn no_times_are_not_uneven() {
        assert_eq!(uneven([].into_iter()), None);
        assert_eq!(uneven([0.0; 20].into_iter()), None);
        assert_eq!(uneven([5.0].into_iter()), None);
    }
}
