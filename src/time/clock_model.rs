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

use super::clock_line::{EARLY_SIGMAS, Line};
use super::lateness::Lateness;
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

/// Minima this early, so many in a row, are of a clock that was set forward, seconds.
const EARLY_STEP_S: f64 = 0.5e-3;
const EARLY_STEPS: u32 = 2;
/// A minimum this many σ above the line is late: it moves nothing.
const LATE_SIGMAS: f64 = 3.0;
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
        let minimum = std::mem::take(&mut self.block).least?;
        self.take_minimum(device_ns, minimum)
    }

    /// Takes the least delayed frame of a block (device second, seconds over the line); the block ended at `device_ns`.
    fn take_minimum(&mut self, device_ns: i64, (at_s, excess_s): (f64, f64)) -> Option<ClockEvent> {
        let line = self.line.as_mut()?;
        let device_s = line.device_s(device_ns);
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

#[cfg(test)]
#[path = "clock_model_tests.rs"]
mod tests;
