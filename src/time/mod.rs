//! Instants, the clock each belongs to, and the capture delay between cameras.
//!
//! Four times are told apart by type, because a mix-up compiles and hurts:
//! * [`DeviceTime`]: what the camera's own counter said, in nanoseconds of that counter;
//! * [`ArrivalTime`]: when the host saw the frame, on the host's monotonic clock;
//! * [`StampedMidpoint`]: middle of the exposure as the stamps tell it, good to a constant per camera;
//! * [`TrueMidpoint`]: middle of the exposure on the *reference camera's* time scale.
//!
//! The constant is the *capture delay* τ: **true = stamped − τ** [Kim19 eq. 2 and 4], τ = 0 for the
//! reference camera. τ > 0 means the frame stamped `t` shows the ball where it was at `t − τ`.

mod clock_line;
mod clock_model;
mod host_clock;
mod lateness;
mod ptp;

pub use clock_model::{ClockEvent, ClockLine, ClockModel, ClockModelOptions, ClockReading};
pub use host_clock::{HostClock, SystemClock};
pub use ptp::{PtpDomain, PtpReading, is_of_network};

use serde::{Deserialize, Serialize};

/// Nanoseconds in a second.
pub const NANOS_PER_SECOND: f64 = 1e9;

macro_rules! instant {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
        #[serde(transparent)]
        pub struct $name(i64);

        impl $name {
            /// From nanoseconds.
            pub const fn from_nanos(nanos: i64) -> Self {
                Self(nanos)
            }
            /// Nanoseconds.
            pub const fn nanos(self) -> i64 {
                self.0
            }
            /// Seconds after `epoch_ns`; exact to 0.1 ns within a day of it.
            pub fn seconds_since(self, epoch_ns: i64) -> f64 {
                // The subtraction is done in integers: an f64 of Unix nanoseconds is only good to 256 ns.
                (self.0 - epoch_ns) as f64 / NANOS_PER_SECOND
            }
            /// The instant `seconds` after `epoch_ns`, to the nearest nanosecond.
            pub fn from_seconds_since(epoch_ns: i64, seconds: f64) -> Self {
                Self(epoch_ns + (seconds * NANOS_PER_SECOND).round() as i64)
            }
        }
    };
}

instant!(
    /// Time on a camera's own clock, nanoseconds.
    DeviceTime
);
instant!(
    /// Time at which the host had the frame, nanoseconds of the host's monotonic clock.
    ArrivalTime
);
instant!(
    /// Exposure midpoint as a camera's stamps tell it, nanoseconds; true = stamped − τ.
    StampedMidpoint
);
instant!(
    /// Exposure midpoint on the reference camera's time scale, nanoseconds.
    TrueMidpoint
);

/// How one camera's stamps turn into the reference camera's time.
///
/// For a point in image row `y` (pixels, centre of the first row is 0) of a camera `height_px` high:
///
/// `true = stamped − τ − skew·(stamped − epoch) + readout·((y + ½)/height − ½)`
///
/// The last term is zero for a global shutter. `skew > 0`: this camera's clock runs fast.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CameraTiming {
    /// Capture delay τ in seconds.
    pub capture_delay_s: f64,
    /// Rate of this camera's clock over the reference's, in parts per million; positive: fast.
    pub clock_skew_ppm: f64,
    /// Stamp at which τ is stated (the skew's zero), nanoseconds.
    pub skew_epoch_ns: i64,
    /// Rolling-shutter readout time of the whole frame in seconds; 0: global shutter.
    pub readout_s: f64,
    /// Image height in pixels, for the rolling shutter.
    pub height_px: u32,
}

impl CameraTiming {
    /// A global-shutter camera with this delay and no skew.
    pub fn with_delay(capture_delay_s: f64) -> Self {
        Self {
            capture_delay_s,
            clock_skew_ppm: 0.0,
            skew_epoch_ns: 0,
            readout_s: 0.0,
            height_px: 1,
        }
    }

    /// True exposure midpoint, in seconds after `epoch_ns`, of a point in row `row_px`.
    pub fn true_seconds(&self, stamped: StampedMidpoint, row_px: f64, epoch_ns: i64) -> f64 {
        let skew = 1e-6 * self.clock_skew_ppm * stamped.seconds_since(self.skew_epoch_ns);
        let row = (row_px + 0.5) / f64::from(self.height_px.max(1)) - 0.5;
        stamped.seconds_since(epoch_ns) - self.capture_delay_s - skew + self.readout_s * row
    }

    /// True exposure midpoint of a point in row `row_px`, to the nearest nanosecond.
    pub fn true_midpoint(&self, stamped: StampedMidpoint, row_px: f64) -> TrueMidpoint {
        let base = stamped.nanos();
        TrueMidpoint::from_seconds_since(base, self.true_seconds(stamped, row_px, base))
    }

    /// The stamp of what was exposed in row `row_px` at this instant: the inverse of [`Self::true_midpoint`].
    pub fn stamped_midpoint(&self, at: TrueMidpoint, row_px: f64) -> StampedMidpoint {
        let mut stamped = StampedMidpoint::from_nanos(at.nanos());
        // What is off after a step is off by parts per million after the next.
        for _ in 0..3 {
            let early_s = -self.true_seconds(stamped, row_px, at.nanos());
            stamped = StampedMidpoint::from_seconds_since(stamped.nanos(), early_s);
        }
        stamped
    }
}
