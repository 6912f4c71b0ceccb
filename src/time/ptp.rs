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
const APART_S: f64 = 2e-3;
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
}

impl Scale {
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
        let late_s = own.host_ns.saturating_sub(self.at(own.device_ns).host_ns) as f64 / NANOS_PER_SECOND;
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
    /// Its stamp on the common scale, in epoch 0: the scale outlives a camera's restart.
    OnScale(ClockReading),
    /// There is no scale yet, and its own clock model does not know enough to begin one.
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
            // A frame whose device time fits nothing.
            return PtpReading::OnScale(ClockReading { epoch: 0, ..*own });
        };
        let frame = OwnReading {
            camera,
            device_ns: line.device_ns,
            host_ns: own.stamped.nanos().saturating_sub(half_ns),
            rate: line.rate,
            sigma_s: own.sigma_s,
        };
        match self.apart_s(&frame) {
            None if frame.sigma_s > STEER_SIGMA_S => return PtpReading::NotYet,
            Some(apart_s) if apart_s.abs() > APART_S + 5.0 * frame.sigma_s => {
                return PtpReading::Apart(apart_s);
            }
            _ => {}
        }
        let place = self.place(&frame);
        let midpoint_ns = place.host_ns.saturating_add(half_ns);
        PtpReading::OnScale(ClockReading {
            stamped: StampedMidpoint::from_nanos(midpoint_ns),
            sigma_s: STAMP_SIGMA_S,
            epoch: 0,
            event: own.event,
            line: Some(ClockLine {
                device_ns: line.device_ns,
                midpoint_ns,
                rate: place.rate,
            }),
        })
    }

    fn place(&self, own: &OwnReading) -> PtpPlace {
        // A thread that panicked leaves numbers that were whole.
        let mut scale = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let scale = scale.get_or_insert_with(|| {
            let first = Segment {
                from_ns: own.device_ns,
                host_ns: own.host_ns,
                rate: own.rate,
            };
            Scale {
                before: first,
                now: first,
                steerer: own.camera.to_owned(),
                steered_ns: own.device_ns,
                steerer_late_s: 0.0,
            }
        });
        scale.steer(own);
        scale.at(own.device_ns)
    }

    /// Seconds by which the camera's own clock model is after where the scale has its frame; `None` before the first.
    fn apart_s(&self, own: &OwnReading) -> Option<f64> {
        let scale = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let place = scale.as_ref()?.at(own.device_ns);
        Some(own.host_ns.saturating_sub(place.host_ns) as f64 / NANOS_PER_SECOND)
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

    #[test]
    fn frames_of_one_ptp_time_have_one_host_time() {
        let domain = PtpDomain::default();
        let mut asked = 0;
        // The second camera's frames come 40 ms later each, and its arrivals are late by another constant.
        for k in 0..20_000 {
            let s = 0.01 * f64::from(k);
            let a = domain.place(&own("a", s, 20.0 * (0.3 * s).sin(), 12.0));
            let behind = s - 0.04;
            let b = domain.place(&own("b", behind, 300.0, 12.0));
            // The same line, asked by the other camera.
            let again = domain.place(&own("a", behind, 0.0, 12.0));
            assert_eq!(b, again);
            let passed_ns = a.host_ns - b.host_ns;
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
            let place = domain.place(&reading);
            let off_us = 1e-3 * (place.host_ns - reading.host_ns) as f64;
            worst_us = worst_us.max(off_us.abs());
        }
        // Eight seconds at 18 ppm until it is steered, 1.5 until that holds.
        assert!(worst_us < 200.0, "{worst_us} us");
        assert!(worst_us > 100.0, "{worst_us} us: nothing had to be steered");
    }

    #[test]
    fn another_camera_steers_when_the_first_is_gone_and_nothing_jumps() {
        let domain = PtpDomain::default();
        let mut last = domain.place(&own("a", 0.0, 0.0, 0.0)).host_ns;
        for k in 1..4000 {
            let s = 0.05 * f64::from(k);
            let camera = if s < 20.0 { "a" } else { "b" };
            let late_us = if camera == "b" { 250.0 } else { 0.0 };
            let place = domain.place(&own(camera, s, late_us, 0.0));
            assert!((place.host_ns - last - 50_000_000).abs() < 100, "at {s} s");
            last = place.host_ns;
        }
        let off_ns = last - own("a", 0.05 * 3999.0, 0.0, 0.0).host_ns;
        assert!(off_ns.abs() < 1000, "{off_ns} ns");
    }

    #[test]
    fn a_stamp_is_the_middle_of_the_exposure_on_the_scale() {
        let domain = PtpDomain::default();
        let reading = |late_us: f64, sigma_s: f64| {
            let of = own("a", 5.0, late_us, 0.0);
            ClockReading {
                stamped: StampedMidpoint::from_nanos(of.host_ns + 500_000),
                sigma_s,
                epoch: 3,
                event: None,
                line: Some(ClockLine {
                    device_ns: of.device_ns,
                    midpoint_ns: of.host_ns + 500_000,
                    rate: 0.0,
                }),
            }
        };
        assert_eq!(
            domain.reading("a", &reading(0.0, 0.5e-3), 0.001),
            PtpReading::NotYet
        );
        for (camera, late_us) in [("a", 0.0), ("b", 1500.0)] {
            let PtpReading::OnScale(at) = domain.reading(camera, &reading(late_us, 5e-6), 0.001) else {
                panic!("{camera} is on the scale");
            };
            // 1005 s by the first camera, and half an exposure of 1 ms.
            assert_eq!((at.stamped.nanos(), at.epoch), (1_005_000_500_000, 0));
            assert_eq!(
                at.line.unwrap().stamped(TAI_NS + 5_010_000_000).nanos(),
                1_005_010_500_000
            );
        }
        let apart = domain.reading("c", &reading(-2500.0, 5e-6), 0.001);
        assert!(
            matches!(apart, PtpReading::Apart(s) if (s + 2.5e-3).abs() < 1e-9),
            "{apart:?}"
        );
    }

    #[test]
    fn a_camera_of_another_clock_is_far_apart() {
        let domain = PtpDomain::default();
        assert_eq!(domain.apart_s(&own("a", 0.0, 0.0, 0.0)), None);
        domain.place(&own("a", 0.0, 0.0, 0.0));
        let apart_s = domain.apart_s(&own("b", 1.0, 30_000.0, 0.0)).unwrap();
        assert!((apart_s - 0.03).abs() < 1e-9, "{apart_s}");
    }
}
