//! The line that the clock model follows: host time over device time, filtered from the minima of blocks of frames.

use nalgebra::{Matrix2, Vector2};

use super::NANOS_PER_SECOND;
use super::lateness::{Lateness, RATE_CHANGE_MAX};

/// Minima in a row that are early by so many σ together are no chance.
pub(super) const EARLY_SIGMAS: f64 = 8.0;
/// Spread of the minima before it is known. Much less would let the first half second, with its short blocks on a busy
/// host, decide on the rate: 50 µs gave a clock of true rate 0 up to 500 ppm after 0.5 s.
const NOISE_FIRST_S: f64 = 200e-6;
const NOISE_LEAST_S: f64 = 2e-6;
const NOISE_MOST_S: f64 = 500e-6;
/// A clock younger than this believes any earlier frame, seconds.
const YOUNG_S: f64 = 2.0;
const YOUNG_SIGMA_S: f64 = 0.5e-3;

/// Host time as a line over device time, with its covariance.
#[derive(Debug, Clone)]
pub(super) struct Line {
    base_device_ns: i64,
    base_host_ns: i64,
    /// Device seconds since the base at which `state` is stated.
    at_s: f64,
    /// Offset (seconds) and rate (seconds per second) of host − device over the bases.
    pub(super) state: Vector2<f64>,
    /// Of `state`.
    pub(super) covariance: Matrix2<f64>,
    /// Spread of the minima about the line, seconds.
    noise_s: f64,
    /// Sum of σ by which the latest minima were early, one after the other.
    early: f64,
    blocks: u32,
}

impl Line {
    /// Through a first frame; the rate is known to this prior alone.
    pub(super) fn through(device_ns: i64, arrival_ns: i64, rate_prior_ppm: f64) -> Self {
        let rate = 1e-6 * rate_prior_ppm;
        Self {
            base_device_ns: device_ns,
            base_host_ns: arrival_ns,
            at_s: 0.0,
            state: Vector2::zeros(),
            covariance: Matrix2::new(2e-3 * 2e-3, 0.0, 0.0, rate * rate),
            noise_s: NOISE_FIRST_S,
            early: 0.0,
            blocks: 0,
        }
    }

    /// Seconds of device time since the base.
    pub(super) fn device_s(&self, device_ns: i64) -> f64 {
        device_ns.saturating_sub(self.base_device_ns) as f64 / NANOS_PER_SECOND
    }

    /// host − device over the bases at a device time, seconds.
    pub(super) fn offset_s(&self, device_s: f64) -> f64 {
        self.state.x + self.state.y * (device_s - self.at_s)
    }

    /// Host time of a device time, nanoseconds.
    pub(super) fn host_ns(&self, device_ns: i64) -> i64 {
        let offset = self.offset_s(self.device_s(device_ns)) * NANOS_PER_SECOND;
        self.base_host_ns
            .saturating_add(device_ns.saturating_sub(self.base_device_ns))
            .saturating_add(offset.round() as i64)
    }

    /// Arrival after the line, seconds.
    pub(super) fn excess_s(&self, device_ns: i64, arrival_ns: i64) -> f64 {
        arrival_ns.saturating_sub(self.host_ns(device_ns)) as f64 / NANOS_PER_SECOND
    }

    /// 1σ of that, seconds.
    pub(super) fn sigma_s(&self, device_ns: i64) -> f64 {
        let ahead = self.device_s(device_ns) - self.at_s;
        let p = &self.covariance;
        let young = if self.young(device_ns) { YOUNG_SIGMA_S } else { 0.0 };
        (p.m11 + ahead * (2.0 * p.m12 + ahead * p.m22))
            .max(0.0)
            .sqrt()
            .hypot(young)
    }

    /// Whether the envelope may still be wholly wrong, because every frame so far was late.
    pub(super) fn young(&self, device_ns: i64) -> bool {
        self.blocks == 0 || self.device_s(device_ns) < YOUNG_S
    }

    /// Moves the line to a frame below it.
    pub(super) fn lower(&mut self, device_s: f64, excess_s: f64) {
        self.state.x = self.offset_s(device_s) + excess_s;
        self.at_s = device_s;
        self.covariance = Matrix2::new(1e-3 * 1e-3, 0.0, 0.0, self.covariance.m22);
        self.noise_s = NOISE_FIRST_S;
    }

    /// What late minima from now on are judged against.
    pub(super) fn before_lateness(&self) -> Lateness {
        Lateness::new(self.at_s, (self.state.x, self.state.y), self.noise_s)
    }

    /// Goes on along the line of minima that a slower clock has made late.
    pub(super) fn slow_down(&mut self, lateness: &Lateness, slope: f64, device_s: f64) {
        let since_s = device_s - lateness.from_s;
        self.state = Vector2::new(
            lateness.offset_s + (lateness.rate + slope) * since_s,
            lateness.rate + slope,
        );
        self.at_s = device_s;
        self.noise_s = lateness.noise_s;
        let (offset_sigma, rate_sigma) = (2.0 * lateness.noise_s, 0.2 * slope);
        self.covariance = Matrix2::new(offset_sigma * offset_sigma, 0.0, 0.0, rate_sigma * rate_sigma);
    }

    /// 1σ of a minimum about the line, seconds.
    pub(super) fn expected_s(&self, device_s: f64) -> f64 {
        let ahead = device_s - self.at_s;
        let p = &self.covariance;
        (p.m11 + ahead * (2.0 * p.m12 + ahead * p.m22))
            .max(0.0)
            .sqrt()
            .hypot(self.noise_s)
    }

    /// Takes the minimum of one block. `excess_s` is over the line as it stands.
    pub(super) fn update(&mut self, device_s: f64, excess_s: f64, rate_walk_ppm: f64) {
        let ahead = device_s - self.at_s;
        // No frame is early: minima that stay below the line are of a rate that has changed in the last second or two.
        let early = excess_s / self.expected_s(device_s);
        self.early = if early < 0.0 { self.early + early } else { 0.0 };
        if self.early < -EARLY_SIGMAS {
            self.covariance.m11 += excess_s * excess_s;
            self.covariance.m22 += (2.0 * excess_s).abs().min(RATE_CHANGE_MAX).powi(2);
            self.early = 0.0;
        }
        let walk = (1e-6 * rate_walk_ppm).powi(2) * ahead.abs();
        let forward = Matrix2::new(1.0, ahead, 0.0, 1.0);
        // A rate that walks: variance a/1 in the rate, a³/3 in the offset.
        let process = walk * Matrix2::new(ahead * ahead / 3.0, ahead / 2.0, ahead / 2.0, 1.0);
        let covariance = forward * self.covariance * forward.transpose() + process;
        let state = forward * self.state;
        let expected = (covariance.m11 + self.noise_s * self.noise_s).sqrt();
        let late = (excess_s / (2.0 * expected)).max(0.0);
        let variance = self.noise_s * self.noise_s * (1.0 + late * late) + covariance.m11 * late * late;
        let gain = covariance.column(0) / (covariance.m11 + variance);
        self.state = state + gain * excess_s;
        let kept = Matrix2::identity() - gain * nalgebra::RowVector2::new(1.0, 0.0);
        self.covariance = kept * covariance * kept.transpose() + variance * gain * gain.transpose();
        self.at_s = device_s;
        // Spread of the minima, from clipped deviations so that a burst does not open the gate; late ones say little.
        let most = if excess_s > 0.0 { 1.5 } else { 4.0 };
        let deviation = excess_s.abs().min(most * self.noise_s);
        self.noise_s = (0.95 * self.noise_s + 0.05 * 1.25 * deviation).clamp(NOISE_LEAST_S, NOISE_MOST_S);
        self.blocks += 1;
    }

    /// host − device at the latest update, nanoseconds.
    pub(super) fn offset_now_ns(&self) -> i64 {
        let offset = (self.state.x * NANOS_PER_SECOND).round() as i64;
        self.base_host_ns
            .saturating_sub(self.base_device_ns)
            .saturating_add(offset)
    }
}
