//! A camera whose clock follows the network's (PTP): asked to, watched whether it does, its stamps on the common scale.

use std::time::{Duration, Instant};

use aravis::Camera;
use aravis::prelude::*;

use super::error::LiveError;
use super::options::{LiveOptions, Ptp};
use crate::scene::CameraId;
use crate::time::{ClockReading, PtpDomain, PtpReading};

/// Names of the features: of the standard today, and of the one before it.
struct Names {
    enable: &'static str,
    latch: &'static str,
    status: &'static str,
    offset_ns: &'static str,
}

const NAMES: [Names; 2] = [
    Names {
        enable: "PtpEnable",
        latch: "PtpDataSetLatch",
        status: "PtpStatus",
        offset_ns: "PtpOffsetFromMaster",
    },
    Names {
        enable: "GevIEEE1588",
        latch: "GevIEEE1588DataSetLatch",
        status: "GevIEEE1588Status",
        offset_ns: "GevIEEE1588OffsetFromMaster",
    },
];

/// States of a clock that is the network's (IEEE 1588 port states).
const FOLLOWS: [&str; 2] = ["slave", "master"];
/// A clock that is further from its master's than this does not follow yet, nanoseconds.
const OFFSET_MOST_NS: i64 = 20_000;
/// The camera is asked again whether it follows after these times: at first soon, later seldom. An answer takes about a
/// millisecond, and one that is lost half a second.
const LOOK_SOON: Duration = Duration::from_millis(500);
const LOOK_LATER: Duration = Duration::from_secs(10);

/// A camera's clock and the network's.
pub struct PtpFollower {
    names: &'static Names,
    domain: PtpDomain,
    camera: CameraId,
    look_at: Instant,
    looks_after: Duration,
    state: String,
    follows: bool,
    /// Epoch of the common scale, while frames are stamped on it.
    on_scale: Option<u32>,
}

impl PtpFollower {
    /// Asks the camera to follow; `None` where that is not wanted, or not possible with this camera.
    ///
    /// # Errors
    /// The camera has PTP and refuses it.
    pub fn start(options: &LiveOptions, camera: &Camera) -> Result<Option<Self>, LiveError> {
        let Ptp::WhereAvailable(domain) = &options.ptp else {
            return Ok(None);
        };
        let has = |feature: &str| camera.is_feature_available(feature).unwrap_or(false);
        let Some(names) = NAMES.iter().find(|names| has(names.enable)) else {
            tracing::warn!(camera = %options.camera, "has no PTP (ptp = true): it is stamped by its own clock");
            return Ok(None);
        };
        camera
            .set_boolean(names.enable, true)
            .map_err(|error| LiveError::Setting {
                camera: options.camera.clone(),
                setting: names.enable,
                value: true.to_string(),
                reason: error.message().to_owned(),
            })?;
        Ok(Some(Self {
            names,
            domain: domain.clone(),
            camera: options.camera.clone(),
            look_at: Instant::now(),
            looks_after: LOOK_SOON,
            state: String::new(),
            follows: false,
            on_scale: None,
        }))
    }

    /// The stamp of a frame; `own` is by the camera's own clock.
    pub fn stamp(&mut self, own: ClockReading, exposure_s: f64) -> ClockReading {
        if !self.follows {
            self.on_scale = None;
            return own;
        }
        match self.domain.reading(self.camera.as_str(), &own, exposure_s) {
            PtpReading::OnScale(reading) => {
                if self.on_scale != Some(reading.epoch) {
                    tracing::info!(camera = %self.camera, state = %self.state, "stamped by the network's clock (PTP)");
                }
                self.on_scale = Some(reading.epoch);
                reading
            }
            // A frame whose time fits nothing is no reason to leave the scale.
            PtpReading::NotYet => ClockReading {
                epoch: self.on_scale.unwrap_or(own.epoch),
                ..own
            },
            PtpReading::Apart(apart_s) => {
                tracing::warn!(
                    camera = %self.camera, state = %self.state, apart_s,
                    "its PTP clock is not that of the other cameras: are they on one network, and is a switch between them \
                     that passes PTP on? It is stamped by its own clock"
                );
                (self.follows, self.on_scale) = (false, None);
                own
            }
        }
    }

    /// What the camera last said of its clock, in the standard's words.
    pub fn state(&self) -> &str {
        &self.state
    }

    /// Asks the camera where its clock stands, if it is time for that. Blocks for as long as the answer takes: not for a
    /// time when frames matter.
    pub fn look(&mut self, camera: &Camera) {
        if Instant::now() < self.look_at {
            return;
        }
        // Cameras that latch nothing need no command.
        let _ = camera.execute_command(self.names.latch);
        let state = camera.string(self.names.status).map_or_else(
            |error| format!("unknown ({})", error.message()),
            |state| state.to_string(),
        );
        // A master is its own; a camera that does not tell is taken at its word.
        let offset_ns = match state.eq_ignore_ascii_case("slave")
            && camera.is_feature_available(self.names.offset_ns).unwrap_or(false)
        {
            true => camera.integer(self.names.offset_ns).unwrap_or(0),
            false => 0,
        };
        let near = offset_ns.saturating_abs() <= OFFSET_MOST_NS;
        let follows = near && FOLLOWS.iter().any(|name| state.eq_ignore_ascii_case(name));
        if state != self.state && !follows {
            tracing::info!(
                camera = %self.camera, %state, offset_ns, "does not follow the network's clock (PTP) yet: stamped by its own"
            );
        }
        self.state = state;
        self.follows = follows;
        self.look_at = Instant::now() + self.looks_after;
        self.looks_after = (self.looks_after * 3 / 2).min(LOOK_LATER);
    }
}
