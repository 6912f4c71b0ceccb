//! The emulated camera's clock: a crystal of its own, or the network's once it follows that (PTP).

use std::sync::OnceLock;
use std::time::{Duration, Instant};

use crate::time::{HostClock, SystemClock};

/// A camera needs so long to synchronise.
const SYNCHRONISES: Duration = Duration::from_secs(2);
/// The network's clock over this host's monotonic one, nanoseconds: some TAI, the same for every emulated camera here.
const NETWORK_NS: i64 = 1_700_000_000_000_000_000;

/// Where a camera stands with the network's clock (IEEE 1588 port states).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum PtpState {
    /// Not asked to follow.
    Disabled = 0,
    /// Not yet synchronised.
    Uncalibrated = 1,
    /// It follows.
    Slave = 2,
}

impl PtpState {
    /// Names and values, as the description has them.
    pub const ENTRIES: [(&'static str, u32); 3] = [
        ("Disabled", Self::Disabled as u32),
        ("Uncalibrated", Self::Uncalibrated as u32),
        ("Slave", Self::Slave as u32),
    ];
}

/// The camera's clock.
#[derive(Debug, Clone, Copy)]
pub struct DeviceClock {
    since: Instant,
    since_ns: f64,
    rate: f64,
    /// Since when it has tried to follow the network's clock, and by how much that is another network's, nanoseconds.
    follows: Option<(Instant, i64)>,
}

impl DeviceClock {
    /// A clock of this reading and rate; it follows nobody.
    pub fn new(now: Instant, offset_s: f64, skew_ppm: f64) -> Self {
        Self {
            since: now,
            since_ns: 1e9 * offset_s,
            rate: 1.0 + 1e-6 * skew_ppm,
            follows: None,
        }
    }

    /// Nanoseconds it shows.
    pub fn ticks(&self, at: Instant) -> u64 {
        if let Some((since, apart_ns)) = self.follows
            && at >= since + SYNCHRONISES
        {
            return u64::try_from(network_ns(at).saturating_add(apart_ns)).unwrap_or(0);
        }
        let ahead = at.saturating_duration_since(self.since).as_nanos() as f64;
        let behind = self.since.saturating_duration_since(at).as_nanos() as f64;
        (self.since_ns + self.rate * (ahead - behind)).max(0.0) as u64
    }

    /// The same clock set forward (or back), with another rate from now on.
    pub fn stepped(self, now: Instant, by_s: f64, skew_ppm: f64) -> Self {
        Self {
            since: now,
            since_ns: self.ticks(now) as f64 + 1e9 * by_s,
            rate: 1.0 + 1e-6 * skew_ppm,
            ..self
        }
    }

    /// Follows the network's clock from now on, one that is `apart_s` from this host's other cameras'; or no longer.
    pub fn follow(&mut self, now: Instant, apart_s: Option<f64>) {
        match (apart_s, self.follows) {
            (Some(apart_s), None) => self.follows = Some((now, (1e9 * apart_s).round() as i64)),
            (None, Some(_)) => {
                self.since_ns = self.ticks(now) as f64;
                self.since = now;
                self.follows = None;
            }
            _ => {}
        }
    }

    /// Where it stands with the network's clock, and how far it is from it, nanoseconds: a camera says that it follows
    /// before its clock has come quite near.
    pub fn ptp_state(&self, now: Instant) -> (PtpState, u32) {
        match self.follows {
            None => (PtpState::Disabled, 0),
            Some((since, _)) if now < since + SYNCHRONISES / 2 => (PtpState::Uncalibrated, 0),
            Some((since, _)) if now < since + SYNCHRONISES => (PtpState::Slave, 1_500_000),
            Some(_) => (PtpState::Slave, 0),
        }
    }
}

/// The network's clock, the same in every process of this host to some 0.1 µs.
fn network_ns(at: Instant) -> i64 {
    static BASE: OnceLock<(Instant, i64)> = OnceLock::new();
    let (base, base_ns) = BASE.get_or_init(|| (Instant::now(), SystemClock.monotonic().nanos()));
    let ahead = at.saturating_duration_since(*base).as_nanos() as i64;
    let behind = base.saturating_duration_since(at).as_nanos() as i64;
    NETWORK_NS + base_ns + ahead - behind
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clock_that_follows_shows_the_networks_time_once_it_has_synchronised() {
        let now = Instant::now();
        let s = Duration::from_secs;
        let mut clocks = [
            DeviceClock::new(now, 100.0, 50.0),
            DeviceClock::new(now, -3.0, -20.0),
        ];
        for clock in &mut clocks {
            clock.follow(now, Some(0.0));
        }
        assert_eq!(clocks[0].ptp_state(now).0, PtpState::Uncalibrated);
        // It says so a second before its clock is the network's.
        assert_eq!(clocks[0].ptp_state(now + s(1)), (PtpState::Slave, 1_500_000));
        assert_eq!(clocks[0].ticks(now + s(1)), 101_000_050_000);
        assert_eq!(clocks[0].ptp_state(now + s(3)), (PtpState::Slave, 0));
        let at = clocks.map(|c| c.ticks(now + s(3)));
        assert_eq!(at[0], at[1]);
        let host = SystemClock.monotonic().nanos() + 3_000_000_000 + NETWORK_NS;
        assert!((at[0] as i64 - host).abs() < 1_000_000_000, "{at:?} at {host}");
        // It goes on from there by its own crystal.
        clocks[0].follow(now + s(3), None);
        assert_eq!(clocks[0].ptp_state(now + s(4)).0, PtpState::Disabled);
        let passed = clocks[0].ticks(now + s(4)) as i64 - at[0] as i64;
        // A double has TAI nanoseconds to 256 ns.
        assert!((passed - 1_000_050_000).abs() < 1024, "{passed}");
    }
}
