//! Fast motion in slow motion: the search knows drones and lamps, which are watched for many seconds at a time. A
//! thrown ball is there for half a second; watched as many times slower it moves like they do.

use std::collections::BTreeMap;

use super::FreeOptions;
use super::support::{SEEING_S, stretches};
use crate::scene::{CameraId, RollingShutter, Track};

/// Stretches from here on show a motion that needs no slowing, seconds.
const LONG_S: f64 = 1.5;
/// Length that slowing gives the typical stretch, seconds.
const SLOWED_S: f64 = 3.0;
/// Most that a motion is slowed.
const MOST: f64 = 10.0;

/// How many seconds of the session one second of the cameras is: 1, or more for a motion in short stretches.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Pace(pub f64);

impl Pace {
    /// From how long at a time the cameras see the thing.
    pub fn of(tracks: &[Track], epoch_ns: i64) -> Self {
        let mut stamps: BTreeMap<&CameraId, Vec<f64>> = BTreeMap::new();
        for track in tracks {
            let own = stamps.entry(&track.camera).or_default();
            own.extend(track.points.iter().map(|p| p.stamped.seconds_since(epoch_ns)));
        }
        let mut lengths = vec![];
        for own in stamps.values_mut() {
            own.sort_by(f64::total_cmp);
            let seen = stretches(own.iter().copied(), SEEING_S);
            lengths.extend(seen.iter().map(|(begin, end)| end - begin));
        }
        let all: f64 = lengths.iter().sum();
        let long: f64 = lengths.iter().filter(|l| **l > LONG_S).sum();
        if 2.0 * long >= all {
            return Self(1.0);
        }
        // Of the stretches that hold most of the time: a false point here and there is a stretch too.
        lengths.sort_by(f64::total_cmp);
        let mut held = 0.0;
        let typical = lengths.iter().copied().find(|length| {
            held += length;
            2.0 * held >= all
        });
        Self((SLOWED_S / typical.unwrap_or(SLOWED_S).max(1e-3)).clamp(1.0, MOST))
    }

    /// Options with their times in seconds of the session.
    pub fn options(self, options: &FreeOptions) -> FreeOptions {
        FreeOptions {
            shift_range_s: options.shift_range_s * self.0,
            shift_range_widest_s: options.shift_range_widest_s * self.0,
            readout_mean_s: options.readout_mean_s * self.0,
            readout_sigma_s: options.readout_sigma_s * self.0,
            ..options.clone()
        }
    }

    /// A shutter for the session; a global one reads out in no time.
    pub fn shutter(self, shutter: RollingShutter) -> RollingShutter {
        match shutter {
            RollingShutter::Global => RollingShutter::ReadoutSeconds(0.0),
            RollingShutter::ReadoutSeconds(readout_s) => RollingShutter::ReadoutSeconds(readout_s * self.0),
            RollingShutter::Estimate => RollingShutter::Estimate,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::synthetic::Scene;
    use super::*;
    use crate::simulation::{DetectionNoise, Layout, Scenario, simulate_tracks};

    #[test]
    fn pitches_are_slowed_and_a_drone_is_not() {
        let (_, drone, _) = Scene::drone(1).make(0.0);
        assert_eq!(Pace::of(&drone, 0), Pace(1.0));
        let scenario =
            Scenario::stock(Layout::TwoOpposite, &[0.5], 4).with_detection(DetectionNoise::gaussian(0.3));
        let pitches = simulate_tracks(&scenario).unwrap().tracks;
        let Pace(slowed) = Pace::of(&pitches, 0);
        assert!((5.0..9.0).contains(&slowed), "{slowed}");
    }
}
