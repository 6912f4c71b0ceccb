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
}

const NAMES: [Names; 2] = [
    Names {
        enable: "PtpEnable",
        latch: "PtpDataSetLatch",
        status: "PtpStatus",
    },
    Names {
        enable: "GevIEEE1588",
        latch: "GevIEEE1588DataSetLatch",
        status: "GevIEEE1588Status",
    },
];

/// States of a clock that is the network's (IEEE 1588 port states).
const FOLLOWS: [&str; 2] = ["slave", "master"];
/// The camera is asked so often whether it follows, before and after it does. An answer takes about a millisecond.
const LOOK_SOON: Duration = Duration::from_millis(500);
const LOOK_LATER: Duration = Duration::from_secs(10);

/// A camera's clock and the network's.
pub struct PtpFollower {
    names: &'static Names,
    domain: PtpDomain,
    camera: CameraId,
    look_at: Instant,
    state: String,
    follows: bool,
    /// Whether frames are stamped on the common scale.
    on_scale: bool,
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
            state: String::new(),
            follows: false,
            on_scale: false,
        }))
    }

    /// The stamp of a frame; `own` is by the camera's own clock. Calibrations know a clock by its epoch: the common scale
    /// is 0, whatever the camera has been through, and its own clock's are above.
    pub fn stamp(&mut self, camera: &Camera, own: ClockReading, exposure_s: f64) -> ClockReading {
        if Instant::now() >= self.look_at {
            self.look(camera);
        }
        let by_own_clock = ClockReading {
            epoch: own.epoch.saturating_add(1),
            ..own
        };
        // Where a clock has just begun to follow, the first times are those that fit nothing.
        if !self.follows || (own.line.is_none() && !self.on_scale) {
            self.on_scale = false;
            return by_own_clock;
        }
        match self.domain.reading(self.camera.as_str(), &own, exposure_s) {
            PtpReading::OnScale(reading) => {
                if !self.on_scale {
                    tracing::info!(camera = %self.camera, state = %self.state, "stamped by the network's clock (PTP)");
                }
                self.on_scale = true;
                reading
            }
            PtpReading::NotYet => {
                self.on_scale = false;
                by_own_clock
            }
            PtpReading::Apart(apart_s) => {
                tracing::warn!(
                    camera = %self.camera, state = %self.state, apart_s,
                    "its PTP clock is not that of the other cameras: are they on one network, and is a switch between them \
                     that passes PTP on? It is stamped by its own clock"
                );
                (self.follows, self.on_scale) = (false, false);
                by_own_clock
            }
        }
    }

    /// What the camera last said of its clock, in the standard's words.
    pub fn state(&self) -> &str {
        &self.state
    }

    fn look(&mut self, camera: &Camera) {
        // Cameras that latch nothing need no command.
        let _ = camera.execute_command(self.names.latch);
        let state = camera.string(self.names.status).map_or_else(
            |error| format!("unknown ({})", error.message()),
            |state| state.to_string(),
        );
        let follows = FOLLOWS.iter().any(|name| state.eq_ignore_ascii_case(name));
        if state != self.state && !follows {
            tracing::info!(camera = %self.camera, %state, "does not follow the network's clock (PTP) yet: stamped by its own");
        }
        self.state = state;
        self.follows = follows;
        self.look_at = Instant::now() + if follows { LOOK_LATER } else { LOOK_SOON };
    }
}
