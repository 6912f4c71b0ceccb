//! The host's clocks behind a trait, so that tests can give their own.

use std::time::{SystemTime, UNIX_EPOCH};

use rustix::time::{ClockId, clock_gettime};

use super::ArrivalTime;

/// Reads the host's clocks.
pub trait HostClock: Send + Sync {
    /// Now, on the monotonic clock.
    fn monotonic(&self) -> ArrivalTime;
    /// Now, nanoseconds since 1970.
    fn unix_nanos(&self) -> i64;

    /// The monotonic instant of a moment that a library stamped with the time of day, nanoseconds since 1970. A
    /// moment that is not within the last second (the time of day was set meanwhile) is taken as now.
    fn monotonic_of_unix(&self, unix_nanos: u64) -> ArrivalTime {
        let now = self.monotonic();
        let age_ns = self
            .unix_nanos()
            .saturating_sub(i64::try_from(unix_nanos).unwrap_or(0));
        if (0..1_000_000_000).contains(&age_ns) {
            ArrivalTime::from_nanos(now.nanos() - age_ns)
        } else {
            now
        }
    }
}

/// The machine's own clocks.
#[derive(Debug, Clone, Copy, Default)]
pub struct SystemClock;

impl HostClock for SystemClock {
    fn monotonic(&self) -> ArrivalTime {
        let now = clock_gettime(ClockId::Monotonic);
        ArrivalTime::from_nanos(
            now.tv_sec
                .saturating_mul(1_000_000_000)
                .saturating_add(now.tv_nsec),
        )
    }
    fn unix_nanos(&self) -> i64 {
        SystemTime::now()
            .duration_since(UNIX_EPOCH)
            .map_or(0, |d| i64::try_from(d.as_nanos()).unwrap_or(i64::MAX))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Fixed;
    impl HostClock for Fixed {
        fn monotonic(&self) -> ArrivalTime {
            ArrivalTime::from_nanos(50_000_000_000)
        }
        fn unix_nanos(&self) -> i64 {
            1_775_000_000_000_000_000
        }
    }

    #[test]
    fn a_moment_of_the_day_becomes_monotonic() {
        let at = |ns| Fixed.monotonic_of_unix(ns).nanos();
        assert_eq!(at(1_774_999_999_996_000_000), 49_996_000_000);
        // The clock was set back by an hour between the two readings: now is the best guess.
        assert_eq!(at(1_775_003_600_000_000_000), 50_000_000_000);
        assert!(SystemClock.monotonic() <= SystemClock.monotonic());
    }
}
