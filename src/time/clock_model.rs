//! From a camera's clock to the host's: each frame's stamped midpoint with its sigma, and breaks of the clock.
//!
//! A camera counts time by its own crystal (±100 ppm, and drifting as it warms); the host sees a frame
//! `arrival = host(device) + delay` with a delay that has a floor (exposure, readout, transfer) and a long tail
//! (bursts, stalls). The model follows the *lower envelope* of `arrival − device`: of every half second only the
//! frame with the least delay counts, and two numbers (offset, rate) are filtered from those minima. A minimum
//! above the prediction counts for less the further it is above, because a late minimum tells of the host's load,
//! an early one of the clock. Minima that stay late ([`Lateness`]) are load when they jumped up or scatter, and a
//! slower clock when they rise along one line from where the clock was.
//!
//! The floor itself cannot be seen from here: stamped midpoints are good to a constant, and that constant is part
//! of the capture delay that the calibration estimates from the ball. What matters is that it stays constant; when
//! it cannot have, the model says so by a new *epoch*.

use std::collections::VecDeque;

use nalgebra::{Matrix2, Vector2};

use super::lateness::{Lateness, RATE_CHANGE_MAX};
use super::{ArrivalTime, DeviceTime, NANOS_PER_SECOND, StampedMidpoint};

/// What a clock model takes for granted.
#[derive(Debug, Clone, PartialEq)]
pub struct ClockModelOptions {
    /// Length of a block of frames that yields one minimum, seconds.
    pub block_s: f64,
    /// 1σ of the device clock's rate before anything is known, parts per million.
    pub rate_prior_ppm: f64,
    /// Random walk of the rate (warming crystal), ppm per √second.
    pub rate_walk_ppm: f64,
    /// A frame this much earlier than the clock allows is not believed, seconds.
    pub early_s: f64,
    /// Every minimum of the last [`Self::step_window_s`] above this means the clock was set back, seconds.
    pub step_s: f64,
    /// See [`Self::step_s`].
    pub step_window_s: f64,
    /// Periods after which a device counter may start again at zero, nanoseconds.
    pub counter_periods_ns: Vec<i64>,
}

impl Default for ClockModelOptions {
    fn default() -> Self {
        let wrap = 1_i64 << 32;
        Self {
            block_s: 0.5,
            rate_prior_ppm: 100.0,
            rate_walk_ppm: 0.2,
            early_s: 0.005,
            step_s: 0.001,
            step_window_s: 3.0,
            // 32-bit counters at 1 GHz, 125 MHz, 100 MHz and 1 MHz.
            counter_periods_ns: vec![wrap, 8 * wrap, 10 * wrap, 1000 * wrap],
        }
    }
}

/// What happened to a camera's clock at a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ClockEvent {
    /// The counter started again at zero and was continued; the stamps go on without a break.
    Wrapped {
        /// Period of the counter, nanoseconds.
        period_ns: i64,
    },
    /// The clock was reset or set: a new epoch, the capture delay is no longer known.
    Restarted {
        /// Host time minus device time, new less old, seconds.
        jump_s: f64,
    },
    /// This frame's device time fits nothing; it was stamped by its arrival.
    Outlier {
        /// Arrival after the prediction, seconds.
        excess_s: f64,
    },
}

/// A frame's time by the model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClockReading {
    /// Middle of the exposure, host's monotonic clock, good to a constant within one epoch.
    pub stamped: StampedMidpoint,
    /// 1σ of the stamp apart from that constant, seconds.
    pub sigma_s: f64,
    /// Rises whenever the constant may have changed.
    pub epoch: u32,
    /// What happened, if anything.
    pub event: Option<ClockEvent>,
    /// The model as it stands; `None` where the device time was not believed.
    pub line: Option<ClockLine>,
}

/// The clock model at one moment: device time to stamped midpoint by one line, for stamps that must fit each other
/// although the model has moved between their frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClockLine {
    /// Device time of the frame that this came with, wraps of the counter undone, nanoseconds.
    pub device_ns: i64,
    pub(super) midpoint_ns: i64,
    /// Host seconds over device seconds, less one.
    pub(super) rate: f64,
}

impl ClockLine {
    /// The stamped midpoint of another frame of the same epoch and exposure.
    pub fn stamped(&self, device_ns: i64) -> StampedMidpoint {
        let since_ns = device_ns.saturating_sub(self.device_ns);
        let stretch_ns = (self.rate * since_ns as f64).round() as i64;
        StampedMidpoint::from_nanos(
            self.midpoint_ns
                .saturating_add(since_ns)
                .saturating_add(stretch_ns),
        )
    }
}

/// Host time as a line over device time, with its covariance.
#[derive(Debug, Clone)]
struct Line {
    base_device_ns: i64,
    base_host_ns: i64,
    /// Device seconds since the base at which `state` is stated.
    at_s: f64,
    /// Offset (seconds) and rate (seconds per second) of host − device over the bases.
    state: Vector2<f64>,
    covariance: Matrix2<f64>,
    /// Spread of the minima about the line, seconds.
    noise_s: f64,
    /// Sum of σ by which the latest minima were early, one after the other.
    early: f64,
    blocks: u32,
}

impl Line {
    fn through(device_ns: i64, arrival_ns: i64, rate_prior_ppm: f64) -> Self {
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
    fn device_s(&self, device_ns: i64) -> f64 {
        device_ns.saturating_sub(self.base_device_ns) as f64 / NANOS_PER_SECOND
    }
    /// host − device over the bases at a device time, seconds.
    fn offset_s(&self, device_s: f64) -> f64 {
        self.state.x + self.state.y * (device_s - self.at_s)
    }
    fn host_ns(&self, device_ns: i64) -> i64 {
        let offset = self.offset_s(self.device_s(device_ns)) * NANOS_PER_SECOND;
        self.base_host_ns
            .saturating_add(device_ns.saturating_sub(self.base_device_ns))
            .saturating_add(offset.round() as i64)
    }
    /// Arrival after the line, seconds.
    fn excess_s(&self, device_ns: i64, arrival_ns: i64) -> f64 {
        arrival_ns.saturating_sub(self.host_ns(device_ns)) as f64 / NANOS_PER_SECOND
    }
    fn sigma_s(&self, device_ns: i64) -> f64 {
        let ahead = self.device_s(device_ns) - self.at_s;
        let p = &self.covariance;
        let young = if self.young(device_ns) { YOUNG_SIGMA_S } else { 0.0 };
        (p.m11 + ahead * (2.0 * p.m12 + ahead * p.m22))
            .max(0.0)
            .sqrt()
            .hypot(young)
    }

    /// Whether the envelope may still be wholly wrong, because every frame so far was late.
    fn young(&self, device_ns: i64) -> bool {
        self.blocks == 0 || self.device_s(device_ns) < YOUNG_S
    }

    /// Moves the line to a frame below it.
    fn lower(&mut self, device_s: f64, excess_s: f64) {
        self.state.x = self.offset_s(device_s) + excess_s;
        self.at_s = device_s;
        self.covariance = Matrix2::new(1e-3 * 1e-3, 0.0, 0.0, self.covariance.m22);
        self.noise_s = NOISE_FIRST_S;
    }

    fn before_lateness(&self) -> Lateness {
        Lateness::new(self.at_s, (self.state.x, self.state.y), self.noise_s)
    }

    /// Goes on along the line of minima that a slower clock has made late.
    fn slow_down(&mut self, lateness: &Lateness, slope: f64, device_s: f64) {
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
    fn expected_s(&self, device_s: f64) -> f64 {
        let ahead = device_s - self.at_s;
        let p = &self.covariance;
        (p.m11 + ahead * (2.0 * p.m12 + ahead * p.m22))
            .max(0.0)
            .sqrt()
            .hypot(self.noise_s)
    }

    /// Takes the minimum of one block. `excess_s` is over the line as it stands.
    fn update(&mut self, device_s: f64, excess_s: f64, rate_walk_ppm: f64) {
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
}

/// Minima in a row that are early by so many σ together are no chance.
const EARLY_SIGMAS: f64 = 8.0;
/// Minima this early, so many in a row, are of a clock that was set forward, seconds.
const EARLY_STEP_S: f64 = 0.5e-3;
const EARLY_STEPS: u32 = 2;
/// A minimum this many σ above the line is late: it moves nothing.
const LATE_SIGMAS: f64 = 3.0;
/// Spread of the minima before it is known. Much less would let the first half second, with its short blocks on a busy
/// host, decide on the rate: 50 µs gave a clock of true rate 0 up to 500 ppm after 0.5 s.
const NOISE_FIRST_S: f64 = 200e-6;
const NOISE_LEAST_S: f64 = 2e-6;
const NOISE_MOST_S: f64 = 500e-6;
/// A clock younger than this believes any earlier frame, seconds.
const YOUNG_S: f64 = 2.0;
const YOUNG_SIGMA_S: f64 = 0.5e-3;
/// Unbelievable frames in a row that agree with each other before they are believed.
const SUSPECTS: usize = 3;
const AGREE_S: f64 = 0.1;
/// The longest stall over which a counter's wrap is still recognised, seconds.
const WRAP_STALL_S: f64 = 0.2;

/// The block being filled.
#[derive(Debug, Clone, Default)]
struct Block {
    begin_s: f64,
    frames: u32,
    least: Option<(f64, f64)>,
}

/// The clock of one camera. Feed every frame in order of arrival; the answer depends on nothing else.
#[derive(Debug, Clone)]
pub struct ClockModel {
    options: ClockModelOptions,
    line: Option<Line>,
    block: Block,
    /// Device second and excess of the latest block minima, for the step test.
    minima: VecDeque<(f64, f64)>,
    lateness: Option<Lateness>,
    /// Minima in a row that came too early for any crystal.
    early_steps: u32,
    suspects: Vec<(i64, i64)>,
    wraps_ns: i64,
    last_device_ns: i64,
    epoch: u32,
}

impl ClockModel {
    /// A model that knows nothing yet.
    pub fn new(options: ClockModelOptions) -> Self {
        Self {
            options,
            line: None,
            block: Block::default(),
            minima: VecDeque::new(),
            lateness: None,
            early_steps: 0,
            suspects: Vec::new(),
            wraps_ns: 0,
            last_device_ns: i64::MIN,
            epoch: 0,
        }
    }

    /// Forgets the clock, as after a reconnection: the next frame begins a new epoch.
    pub fn restart(&mut self) {
        if self.line.take().is_some() {
            self.epoch += 1;
        }
        self.clear();
    }

    fn clear(&mut self) {
        self.block = Block::default();
        self.minima.clear();
        self.lateness = None;
        self.early_steps = 0;
        self.suspects.clear();
        self.wraps_ns = 0;
    }

    /// Rate of the device's clock over the host's, parts per million (positive: fast), with 1σ.
    pub fn skew_ppm(&self) -> Option<(f64, f64)> {
        let line = self.line.as_ref()?;
        Some((-1e6 * line.state.y, 1e6 * line.covariance.m22.max(0.0).sqrt()))
    }

    /// The stamped midpoint of a frame whose exposure began at `device` and lasted `exposure_s`.
    pub fn push(&mut self, device: DeviceTime, arrival: ArrivalTime, exposure_s: f64) -> ClockReading {
        let (raw_ns, arrival_ns) = (device.nanos(), arrival.nanos());
        let mut device_ns = raw_ns.saturating_add(self.wraps_ns);
        let mut event = None;
        if let Some(line) = &self.line {
            let excess = line.excess_s(device_ns, arrival_ns);
            let early = -self.options.early_s - 5.0 * line.sigma_s(device_ns);
            let backward = device_ns <= self.last_device_ns;
            if backward && let Some(period) = self.wrapped(device_ns, arrival_ns) {
                self.wraps_ns = self.wraps_ns.saturating_add(period);
                device_ns = device_ns.saturating_add(period);
                event = Some(ClockEvent::Wrapped { period_ns: period });
            } else if backward || (excess < early && !line.young(device_ns)) {
                return self.suspect(raw_ns, arrival_ns, exposure_s);
            }
        }
        self.suspects.clear();
        event = self.accept(device_ns, arrival_ns).or(event);
        self.reading(device_ns, exposure_s, event)
    }

    fn reading(&self, device_ns: i64, exposure_s: f64, event: Option<ClockEvent>) -> ClockReading {
        let half_ns = (0.5 * exposure_s * NANOS_PER_SECOND).round() as i64;
        let (host_ns, sigma_s) = self.line.as_ref().map_or((device_ns, f64::INFINITY), |line| {
            (line.host_ns(device_ns), line.sigma_s(device_ns))
        });
        let midpoint_ns = host_ns.saturating_add(half_ns);
        ClockReading {
            stamped: StampedMidpoint::from_nanos(midpoint_ns),
            sigma_s,
            epoch: self.epoch,
            event,
            line: self.line.as_ref().map(|line| ClockLine {
                device_ns,
                midpoint_ns,
                rate: line.state.y,
            }),
        }
    }

    /// The period that explains a counter's fall, if the stamps then go on where they were.
    fn wrapped(&self, device_ns: i64, arrival_ns: i64) -> Option<i64> {
        let line = self.line.as_ref()?;
        self.options.counter_periods_ns.iter().copied().find(|period| {
            let continued = device_ns.saturating_add(*period);
            let excess = line.excess_s(continued, arrival_ns);
            continued > self.last_device_ns && excess > -self.options.early_s && excess < WRAP_STALL_S
        })
    }

    /// A frame that does not fit: stamped by its arrival, believed once several agree.
    fn suspect(&mut self, raw_ns: i64, arrival_ns: i64, exposure_s: f64) -> ClockReading {
        let agrees = self.suspects.iter().all(|(d, a)| {
            let change = arrival_ns
                .saturating_sub(*a)
                .saturating_sub(raw_ns.saturating_sub(*d));
            (change as f64 / NANOS_PER_SECOND).abs() < AGREE_S && raw_ns > *d
        });
        if !agrees {
            self.suspects.clear();
        }
        self.suspects.push((raw_ns, arrival_ns));
        let old = self
            .line
            .as_ref()
            .map(|l| (l.excess_s(raw_ns, arrival_ns), l.offset_now_ns()));
        if self.suspects.len() >= SUSPECTS {
            let suspects = std::mem::take(&mut self.suspects);
            let begun_ns = suspects
                .iter()
                .map(|(d, a)| a.saturating_sub(*d))
                .min()
                .unwrap_or_default();
            self.restart();
            for (d, a) in suspects {
                self.accept(d, a);
            }
            let jump_ns = begun_ns.saturating_sub(old.map_or(0, |(_, offset)| offset));
            let event = ClockEvent::Restarted {
                jump_s: jump_ns as f64 / NANOS_PER_SECOND,
            };
            return self.reading(raw_ns, exposure_s, Some(event));
        }
        let half_ns = (0.5 * exposure_s * NANOS_PER_SECOND).round() as i64;
        ClockReading {
            stamped: StampedMidpoint::from_nanos(arrival_ns.saturating_add(half_ns)),
            sigma_s: self.options.early_s,
            epoch: self.epoch,
            event: Some(ClockEvent::Outlier {
                excess_s: old.map_or(0.0, |(excess, _)| excess),
            }),
            line: None,
        }
    }

    /// Takes a believed frame into the envelope.
    fn accept(&mut self, device_ns: i64, arrival_ns: i64) -> Option<ClockEvent> {
        self.last_device_ns = device_ns;
        let prior = self.options.rate_prior_ppm;
        let line = self
            .line
            .get_or_insert_with(|| Line::through(device_ns, arrival_ns, prior));
        let device_s = line.device_s(device_ns);
        let excess = line.excess_s(device_ns, arrival_ns);
        let excess = if line.young(device_ns) && excess < -3.0 * line.sigma_s(device_ns).min(100e-6) {
            // The first frames may all have been late: the earliest so far is the envelope.
            line.lower(device_s, excess);
            self.block.least = None;
            0.0
        } else {
            excess
        };
        if self.block.frames == 0 {
            self.block.begin_s = device_s;
        }
        self.block.frames += 1;
        if self.block.least.is_none_or(|(_, least)| excess < least) {
            self.block.least = Some((device_s, excess));
        }
        // Short blocks at first: 0.1 s, growing to the full length within 3 s.
        let length_s = (0.1 + device_s / 8.0).min(self.options.block_s);
        if self.block.frames < 8 || device_s - self.block.begin_s < length_s {
            return None;
        }
        let (at_s, excess_s) = std::mem::take(&mut self.block).least?;
        let sigmas = excess_s / line.expected_s(at_s);
        if !line.young(device_ns) && excess_s < -EARLY_STEP_S.max(EARLY_SIGMAS * line.expected_s(at_s)) {
            // No frame is early, and no crystal gets there in half a second: the clock was set forward, or a step
            // that was believed is undone. Twice, and it is so.
            self.early_steps += 1;
            if self.early_steps < EARLY_STEPS {
                return None;
            }
            return Some(self.step(excess_s));
        }
        self.early_steps = 0;
        if sigmas <= 0.0 || line.young(device_ns) {
            self.lateness = None;
            line.update(at_s, excess_s, self.options.rate_walk_ppm);
        } else {
            let lateness = self.lateness.get_or_insert_with(|| line.before_lateness());
            lateness.add((at_s, line.offset_s(at_s) + excess_s), sigmas);
            if let Some(slope) = lateness.slower_by() {
                line.slow_down(lateness, slope, at_s);
                self.lateness = None;
                // They were over the old line.
                self.minima.clear();
                return None;
            } else if sigmas < LATE_SIGMAS {
                line.update(at_s, excess_s, self.options.rate_walk_ppm);
            }
        }
        self.minima.push_back((at_s, excess_s));
        self.step_test(device_s)
    }

    /// A clock set back by less than a frame shows as minima that all stay late.
    fn step_test(&mut self, device_s: f64) -> Option<ClockEvent> {
        let window_s = self.options.step_window_s;
        while self.minima.len() > 1
            && self
                .minima
                .get(1)
                .is_some_and(|(at, _)| device_s - at >= window_s)
        {
            self.minima.pop_front();
        }
        let covered = self
            .minima
            .front()
            .is_some_and(|(at, _)| device_s - at >= window_s);
        let least = self.minima.iter().map(|m| m.1).fold(f64::INFINITY, f64::min);
        if !covered || least < self.options.step_s {
            return None;
        }
        Some(self.step(least))
    }

    /// Host less device has changed by this at once: a new epoch.
    fn step(&mut self, jump_s: f64) -> ClockEvent {
        if let Some(line) = &mut self.line {
            line.state.x += jump_s;
            line.covariance.m11 += 1e-3 * 1e-3;
        }
        self.minima.clear();
        self.lateness = None;
        self.early_steps = 0;
        self.epoch += 1;
        ClockEvent::Restarted { jump_s }
    }
}

impl Line {
    /// host − device at the latest update, nanoseconds.
    fn offset_now_ns(&self) -> i64 {
        let offset = (self.state.x * NANOS_PER_SECOND).round() as i64;
        self.base_host_ns
            .saturating_sub(self.base_device_ns)
            .saturating_add(offset)
    }
}

#[cfg(test)]
#[path = "clock_model_tests.rs"]
mod tests;
