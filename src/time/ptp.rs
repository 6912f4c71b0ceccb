//! One time scale for cameras whose clocks follow the network's (PTP, IEEE 1588): their stamps fit each other as their
//! clocks do, to a microsecond, which arrivals on a busy host never tell.
//!
//! The network's clock runs at its own rate (where no grandmaster is on the network a camera's crystal is elected), and
//! stamps are wanted on the host's monotonic clock. So the scale is a line from PTP to host time, the same for every
//! camera, steered slowly by the clock model of one of them. It is continuous, and it changes its rate only at an instant
//! that no frame has reached: two cameras' frames of one PTP time get one host time, whichever is asked for first.

use std::sync::{Arc, Mutex, PoisonError};

use super::{ClockLine, ClockReading, NANOS_PER_SECOND, StampedMidpoint};

/// The scale is steered so often, nanoseconds of PTP.
const STEER_NS: i64 = 8_000_000_000;
/// A new rate holds from so far ahead of the newest frame: far more than cameras lag behind each other.
const AHEAD_NS: i64 = 1_500_000_000;
/// A clock model that knows less neither begins the scale nor steers it, seconds.
const STEER_SIGMA_S: f64 = 0.1e-3;
/// Arrivals of two cameras of one clock are not further apart than this: exposure, readout and transfer, seconds.
const APART_S: f64 = 50e-3;
/// No camera has been on the scale for so long, and the network's clock has another time: the scale begins anew.
const ABANDONED_NS: i64 = 3_000_000_000;
/// Epochs of the scale after the first, which is 0; a camera's own clock begins at 1.
const LATER_SCALES: u32 = 1 << 31;

/// Whether a clock epoch is of the common scale.
pub fn is_of_network(epoch: u32) -> bool {
    epoch == 0 || epoch >= LATER_SCALES
}
/// What is off is steered away over this time, and no faster than this rate.
const STEER_OVER_S: f64 = 60.0;
const STEER_MOST: f64 = 20e-6;
/// The camera that steers is silent for so long before another steers.
const STEERER_LOST_NS: i64 = 3 * STEER_NS;

/// 1σ of a stamp on the common scale, seconds: what PTP in cameras keeps to.
const STAMP_SIGMA_S: f64 = 1e-6;

/// What a camera's own clock model says of a frame.
#[derive(Debug, Clone, Copy)]
struct OwnReading<'a> {
    camera: &'a str,
    /// Device time of the frame, nanoseconds.
    device_ns: i64,
    /// Host time of the same moment, nanoseconds.
    host_ns: i64,
    /// Host seconds over device seconds, less one.
    rate: f64,
    /// 1σ of that host time, seconds.
    sigma_s: f64,
}

/// A frame's place on the common scale.
#[derive(Debug, Clone, Copy, PartialEq)]
struct PtpPlace {
    /// Host time, nanoseconds.
    host_ns: i64,
    /// Host seconds over PTP seconds, less one, there.
    rate: f64,
}

#[derive(Debug, Clone, Copy)]
struct Segment {
    from_ns: i64,
    host_ns: i64,
    rate: f64,
}

impl Segment {
    fn at(&self, ptp_ns: i64) -> PtpPlace {
        let since_ns = ptp_ns.saturating_sub(self.from_ns);
        let stretch_ns = (self.rate * since_ns as f64).round() as i64;
        PtpPlace {
            host_ns: self.host_ns.saturating_add(since_ns).saturating_add(stretch_ns),
            rate: self.rate,
        }
    }
}

#[derive(Debug)]
struct Scale {
    before: Segment,
    now: Segment,
    steerer: String,
    steered_ns: i64,
    /// What the steering camera's arrivals are late by on this scale, seconds: every camera has its own constant.
    steerer_late_s: f64,
    /// Host time of the newest frame on it, nanoseconds.
    newest_ns: i64,
    epoch: u32,
}

impl Scale {
    fn beginning(own: &OwnReading, epoch: u32) -> Self {
        let first = Segment {
            from_ns: own.device_ns,
            host_ns: own.host_ns,
            rate: own.rate,
        };
        Self {
            before: first,
            now: first,
            steerer: own.camera.to_owned(),
            steered_ns: own.device_ns,
            steerer_late_s: 0.0,
            newest_ns: own.host_ns,
            epoch,
        }
    }

    /// Seconds by which the camera's own clock model is after where the scale has its frame.
    fn apart_s(&self, own: &OwnReading) -> f64 {
        own.host_ns.saturating_sub(self.at(own.device_ns).host_ns) as f64 / NANOS_PER_SECOND
    }

    fn at(&self, ptp_ns: i64) -> PtpPlace {
        let segment = if ptp_ns < self.now.from_ns {
            &self.before
        } else {
            &self.now
        };
        segment.at(ptp_ns)
    }

    fn steer(&mut self, own: &OwnReading) {
        if own.sigma_s > STEER_SIGMA_S {
            return;
        }
        let since_ns = own.device_ns.saturating_sub(self.steered_ns);
        let late_s = self.apart_s(own);
        if self.steerer != own.camera {
            if since_ns < STEERER_LOST_NS {
                return;
            }
            own.camera.clone_into(&mut self.steerer);
            self.steerer_late_s = late_s;
        }
        if since_ns < STEER_NS {
            return;
        }
        self.steered_ns = own.device_ns;
        let off_s = late_s - self.steerer_late_s;
        let from_ns = own.device_ns.saturating_add(AHEAD_NS);
        self.before = self.now;
        self.now = Segment {
            from_ns,
            host_ns: self.before.at(from_ns).host_ns,
            rate: own.rate + (off_s / STEER_OVER_S).clamp(-STEER_MOST, STEER_MOST),
        };
    }
}

/// The common scale of all cameras of one network; its clones are one and the same.
#[derive(Debug, Clone, Default)]
pub struct PtpDomain(Arc<Mutex<Option<Scale>>>);

impl PartialEq for PtpDomain {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }
}

/// What becomes of a frame of a camera that says it follows the network's clock.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PtpReading {
    /// Its stamp on the common scale, in the scale's epoch: it outlives a camera's restart.
    OnScale(ClockReading),
    /// Its device time fits nothing, or there is no scale yet and its own clock model does not know enough to begin one.
    NotYet,
    /// Its clock is another than the other cameras', by seconds.
    Apart(f64),
}

impl PtpDomain {
    /// The stamp of a frame on the common scale; `own` is what the camera's own clock model says of it. The first camera
    /// fixes where the scale lies.
    pub fn reading(&self, camera: &str, own: &ClockReading, exposure_s: f64) -> PtpReading {
        let half_ns = (0.5 * exposure_s * NANOS_PER_SECOND).round() as i64;
        let Some(line) = own.line else {
            return PtpReading::NotYet;
        };
        let frame = OwnReading {
            camera,
            device_ns: line.device_ns,
            host_ns: own.stamped.nanos().saturating_sub(half_ns),
            rate: line.rate,
            sigma_s: own.sigma_s,
        };
        // A thread that panicked leaves numbers that were whole.
        let mut scale = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let knows = frame.sigma_s <= STEER_SIGMA_S;
        if scale.is_none() && !knows {
            return PtpReading::NotYet;
        }
        let scale = scale.get_or_insert_with(|| Scale::beginning(&frame, 0));
        let apart_s = scale.apart_s(&frame);
        if apart_s.abs() > APART_S + 5.0 * frame.sigma_s {
            // The network's clock has jumped (its master was restarted, or is another one), or all cameras were off.
            if !knows || frame.host_ns.saturating_sub(scale.newest_ns) < ABANDONED_NS {
                return PtpReading::Apart(apart_s);
            }
            let epoch = scale.epoch.saturating_add(1).max(LATER_SCALES);
            *scale = Scale::beginning(&frame, epoch);
        }
        scale.newest_ns = scale.newest_ns.max(frame.host_ns);
        scale.steer(&frame);
        let place = scale.at(frame.device_ns);
        let midpoint_ns = place.host_ns.saturating_add(half_ns);
        PtpReading::OnScale(ClockReading {
            stamped: StampedMidpoint::from_nanos(midpoint_ns),
            sigma_s: STAMP_SIGMA_S,
            epoch: scale.epoch,
            event: own.event,
            line: Some(ClockLine {
                device_ns: line.device_ns,
                midpoint_ns,
                rate: place.rate,
            }),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TAI_NS: i64 = 1_764_000_000_000_000_000;

    /// A camera's reading at PTP second `s`, by a model that puts it `late_us` after where it belongs; the network's
    /// clock is slow against the host by `slow_ppm`.
    fn own(camera: &str, s: f64, late_us: f64, slow_ppm: f64) -> OwnReading<'_> {
        let host_s = 1000.0 + s * (1.0 + 1e-6 * slow_ppm) + 1e-6 * late_us;
        OwnReading {
            camera,
            device_ns: TAI_NS + (1e9 * s).round() as i64,
            host_ns: (1e9 * host_s).round() as i64,
            rate: 1e-6 * slow_ppm,
            sigma_s: 5e-6,
        }
    }

    fn read(domain: &PtpDomain, own: &OwnReading) -> PtpReading {
        let midpoint_ns = own.host_ns + 500_000;
        let reading = ClockReading {
            stamped: StampedMidpoint::from_nanos(midpoint_ns),
            sigma_s: own.sigma_s,
            epoch: 3,
            event: None,
            line: Some(ClockLine {
                device_ns: own.device_ns,
                midpoint_ns,
                rate: own.rate,
            }),
        };
        domain.reading(own.camera, &reading, 0.001)
    }

    /// Host time of the frame on the scale.
    fn place(domain: &PtpDomain, own: &OwnReading) -> i64 {
        match read(domain, own) {
            PtpReading::OnScale(at) => at.stamped.nanos() - 500_000,
            other => panic!("{}: {other:?}", own.camera),
        }
    }

    #[test]
    fn frames_of_one_ptp_time_have_one_host_time() {
        let domain = PtpDomain::default();
        let mut asked = 0;
        // The second camera's frames come 40 ms later each, and its arrivals are late by another constant.
        for k in 0..20_000 {
            let s = 0.01 * f64::from(k);
            let a = place(&domain, &own("a", s, 20.0 * (0.3 * s).sin(), 12.0));
            let behind = s - 0.04;
            let b = place(&domain, &own("b", behind, 300.0, 12.0));
            // The same line, asked by the other camera.
            let again = place(&domain, &own("a", behind, 0.0, 12.0));
            assert_eq!(b, again);
            let passed_ns = a - b;
            // 40 ms of PTP at 12 ppm, steered by at most 20 ppm.
            assert!((passed_ns - 40_000_480).abs() < 800, "{passed_ns} at {s}");
            asked += 1;
        }
        assert_eq!(asked, 20_000);
    }

    #[test]
    fn the_scale_follows_the_host_over_a_game() {
        let domain = PtpDomain::default();
        // A grandmaster that warms: 12 ppm, later 30.
        let host_late = |s: f64| if s < 3602.0 { 0.0 } else { 18e-6 * (s - 3602.0) };
        let mut worst_us: f64 = 0.0;
        for k in 0..10_800 {
            let s = f64::from(k);
            let mut reading = own("a", s, 1e6 * host_late(s), 12.0);
            reading.rate = if s < 3602.0 { 12e-6 } else { 30e-6 };
            let placed = place(&domain, &reading);
            let off_us = 1e-3 * (placed - reading.host_ns) as f64;
            worst_us = worst_us.max(off_us.abs());
        }
        // Eight seconds at 18 ppm until it is steered, 1.5 until that holds.
        assert!(worst_us < 200.0, "{worst_us} us");
        assert!(worst_us > 100.0, "{worst_us} us: nothing had to be steered");
    }

    #[test]
    fn another_camera_steers_when_the_first_is_gone_and_nothing_jumps() {
        let domain = PtpDomain::default();
        let mut last = place(&domain, &own("a", 0.0, 0.0, 0.0));
        for k in 1..4000 {
            let s = 0.05 * f64::from(k);
            let camera = if s < 20.0 { "a" } else { "b" };
            let late_us = if camera == "b" { 250.0 } else { 0.0 };
            let placed = place(&domain, &own(camera, s, late_us, 0.0));
            assert!((placed - last - 50_000_000).abs() < 100, "at {s} s");
            last = placed;
        }
        let off_ns = last - own("a", 0.05 * 3999.0, 0.0, 0.0).host_ns;
        assert!(off_ns.abs() < 1000, "{off_ns} ns");
    }

    #[test]
    fn a_stamp_is_the_middle_of_the_exposure_on_the_scale() {
        let domain = PtpDomain::default();
        let vague = OwnReading {
            sigma_s: 0.5e-3,
            ..own("a", 5.0, 0.0, 0.0)
        };
        assert_eq!(read(&domain, &vague), PtpReading::NotYet);
        for (camera, late_us) in [("a", 0.0), ("b", 1500.0)] {
            let PtpReading::OnScale(at) = read(&domain, &own(camera, 5.0, late_us, 0.0)) else {
                panic!("{camera} is on the scale");
            };
            // 1005 s by the first camera, and half an exposure of 1 ms.
            assert_eq!((at.stamped.nanos(), at.epoch), (1_005_000_500_000, 0));
            assert_eq!(
                at.line.unwrap().stamped(TAI_NS + 5_010_000_000).nanos(),
                1_005_010_500_000
            );
        }
        // One that knows little may join, and is not told off for what it does not know.
        let vague = OwnReading {
            camera: "c",
            sigma_s: 0.5e-3,
            ..own("c", 5.0, 3000.0, 0.0)
        };
        assert_eq!(place(&domain, &vague), 1_005_000_000_000);
    }

    #[test]
    fn a_camera_of_another_clock_is_apart_until_it_is_the_networks() {
        let domain = PtpDomain::default();
        // Another network's clock shows 400 s more.
        let other = |s: f64| OwnReading {
            device_ns: TAI_NS + (1e9 * (s + 400.0)).round() as i64,
            ..own("b", s, 0.0, 0.0)
        };
        let mut epochs = Vec::new();
        for k in 0..100 {
            let s = 0.1 * f64::from(k);
            // The first camera is there for five seconds.
            if s < 5.0 {
                place(&domain, &own("a", s, 0.0, 0.0));
            }
            match read(&domain, &other(s)) {
                PtpReading::Apart(apart_s) => {
                    assert!((apart_s + 400.0).abs() < 1e-6, "{apart_s}");
                    assert!(s < 8.0, "the scale was never begun anew");
                }
                PtpReading::OnScale(at) => {
                    assert!(
                        s > 7.8 && (at.stamped.nanos() - other(s).host_ns) == 500_000,
                        "{s}"
                    );
                    epochs.push(at.epoch);
                }
                PtpReading::NotYet => panic!("at {s} s"),
            }
        }
        assert!(
            epochs.len() > 15 && epochs.iter().all(|e| *e == LATER_SCALES),
            "{epochs:?}"
        );
        assert!(is_of_network(0) && is_of_network(LATER_SCALES) && !is_of_network(1));
        // Back with the network's new clock.
        assert!(matches!(
            read(&domain, &OwnReading { camera: "a", ..other(10.0) }),
            PtpReading::OnScale(at) if at.epoch == LATER_SCALES
        ));
    }
}
