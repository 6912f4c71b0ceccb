//! A latency histogram that one thread fills and anyone reads: twenty-four buckets to a factor of ten.

use std::sync::atomic::{AtomicU64, Ordering};

use crate::time::{HostClock, SystemClock};

/// Upper edge of the first bucket, seconds.
const FIRST_S: f64 = 10e-6;
/// Buckets to a factor of ten: a quantile is right to a tenth.
const PER_DECADE: f64 = 24.0;
/// From 10 µs to 100 s.
const BUCKETS: usize = 7 * 24 + 1;

/// Counts of durations.
#[derive(Debug)]
pub struct Histogram {
    buckets: [AtomicU64; BUCKETS],
}

impl Default for Histogram {
    fn default() -> Self {
        Self {
            buckets: std::array::from_fn(|_| AtomicU64::new(0)),
        }
    }
}

/// Seconds from an instant of the host's monotonic clock to now.
pub fn seconds_since(at_ns: i64) -> f64 {
    1e-9 * SystemClock.monotonic().nanos().saturating_sub(at_ns) as f64
}

impl Histogram {
    /// Counts one duration.
    pub fn add_s(&self, duration_s: f64) {
        let place = (PER_DECADE * (duration_s.max(FIRST_S) / FIRST_S).log10()).ceil();
        if let Some(bucket) = self.buckets.get((place as usize).min(BUCKETS - 1)) {
            bucket.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Counts the time from an instant of the host's clock to now.
    pub fn add_since_ns(&self, at_ns: i64) {
        self.add_s(seconds_since(at_ns));
    }

    /// How many were counted.
    pub fn count(&self) -> u64 {
        self.buckets.iter().map(|b| b.load(Ordering::Relaxed)).sum()
    }

    /// Upper edge of the bucket in which a share of the durations ends; `None` when there are none.
    pub fn quantile_s(&self, share: f64) -> Option<f64> {
        let wanted = (share * self.count() as f64).ceil().max(1.0);
        let mut seen = 0.0;
        self.buckets.iter().enumerate().find_map(|(place, bucket)| {
            seen += bucket.load(Ordering::Relaxed) as f64;
            (seen >= wanted).then(|| FIRST_S * 10_f64.powf(place as f64 / PER_DECADE))
        })
    }

    /// "p50 1.2 p99 3.4 ms", or a dash.
    pub fn in_words(&self) -> String {
        match (self.quantile_s(0.5), self.quantile_s(0.99)) {
            (Some(half), Some(most)) => format!("p50 {:.1} p99 {:.1} ms", 1e3 * half, 1e3 * most),
            _ => "–".to_owned(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_right_to_a_tenth() {
        let histogram = Histogram::default();
        assert_eq!(histogram.quantile_s(0.5), None);
        for k in 1..=1000 {
            histogram.add_s(1e-5 * f64::from(k));
        }
        for (share, exact_s) in [(0.5, 5e-3), (0.99, 9.9e-3), (0.001, 1e-5)] {
            let found_s = histogram.quantile_s(share).unwrap();
            assert!(
                (exact_s..=1.101 * exact_s).contains(&(found_s * 1.000_001)),
                "{share}: {found_s}"
            );
        }
        histogram.add_s(f64::INFINITY);
        histogram.add_s(-1.0);
        assert_eq!(histogram.count(), 1002);
    }
}
