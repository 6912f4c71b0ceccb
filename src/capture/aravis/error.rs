//! Why a live camera cannot be used, and what to do about it.

use std::net::Ipv4Addr;

use super::description::DescriptionError;
use super::place::Place;
use crate::scene::{CameraId, PixelFormat};

/// A live camera's trouble.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LiveError {
    /// Nobody answers.
    #[error(
        "camera {camera}: no answer from {sought}{others}; check power, cable and address (pitchd cameras lists what is there)"
    )]
    Absent {
        /// Camera.
        camera: CameraId,
        /// What was looked for.
        sought: String,
        /// The cameras that did answer, in words.
        others: String,
    },
    /// Another camera is there.
    #[error("camera {camera}: {address} is serial {found}, not {expected}; correct `serial` or `address`")]
    AnotherCamera {
        /// Camera.
        camera: CameraId,
        /// Where.
        address: Ipv4Addr,
        /// Serial found.
        found: String,
        /// Serial asked for.
        expected: String,
    },
    /// Several cameras fit.
    #[error(
        "camera {camera}: {} cameras answer to {sought}: {}; give `address` too, or take the wrong one off the network",
        places.len(), in_words(places)
    )]
    Ambiguous {
        /// Camera.
        camera: CameraId,
        /// What was looked for.
        sought: String,
        /// Where they are.
        places: Vec<Place>,
    },
    /// Another program holds it.
    #[error(
        "camera {camera}: {address} is controlled by another program{}; end that program, or wait for its heartbeat (3 s) if it crashed",
        by.map(|host| format!(" on {host}")).unwrap_or_default()
    )]
    Held {
        /// Camera.
        camera: CameraId,
        /// Where.
        address: Ipv4Addr,
        /// Host of that program, where the camera tells it.
        by: Option<Ipv4Addr>,
    },
    /// Its description of itself would harm the library.
    #[error(
        "camera {camera}: {address} describes itself so that it cannot be used: {why}; update its firmware, or replace it"
    )]
    Description {
        /// Camera.
        camera: CameraId,
        /// Where.
        address: Ipv4Addr,
        /// What is wrong.
        why: DescriptionError,
    },
    /// Nothing keeps packets from the library that it would not survive.
    #[error(
        "camera {camera}: {address} is not used, because spoilt packets from it could not be kept out: {reason}; \
         raise net.core.optmem_max, or take packet_socket = true (without that filter: on a network of trusted cameras)"
    )]
    Unguarded {
        /// Camera.
        camera: CameraId,
        /// Where.
        address: Ipv4Addr,
        /// The system's words.
        reason: String,
    },
    /// It cannot send its pixels as asked.
    #[error(
        "camera {camera}: no pixel format {asked} (it has {}); {}", available.join(", "), instead_of(available)
    )]
    PixelFormat {
        /// Camera.
        camera: CameraId,
        /// How.
        asked: PixelFormat,
        /// The names of what it has.
        available: Vec<String>,
    },
    /// A setting is refused.
    #[error("camera {camera}: {setting} = {value} is refused: {reason}")]
    Setting {
        /// Camera.
        camera: CameraId,
        /// Which.
        setting: &'static str,
        /// Asked value.
        value: String,
        /// The library's words.
        reason: String,
    },
    /// A feature of `features` cannot be set.
    #[error("camera {camera}: features: {feature} = {value}: {reason}; correct `features` of this camera")]
    Feature {
        /// Camera.
        camera: CameraId,
        /// Which.
        feature: String,
        /// Asked value.
        value: String,
        /// Why.
        reason: String,
    },
    /// A setting did not stay.
    #[error(
        "camera {camera}: {setting} is {got}, asked was {asked}; lower the rate, the region or the exposure"
    )]
    NotKept {
        /// Camera.
        camera: CameraId,
        /// Which.
        setting: &'static str,
        /// As the camera has it.
        got: f64,
        /// As asked.
        asked: f64,
    },
    /// The link is too slow.
    #[error(
        "camera {camera}: {needed_mbps:.0} Mb/s are needed, its link has {link_mbps:.0} Mb/s; \
         use a faster port, a smaller region or a lower rate"
    )]
    LinkTooSlow {
        /// Camera.
        camera: CameraId,
        /// Needed.
        needed_mbps: f64,
        /// There.
        link_mbps: f64,
    },
    /// The library failed.
    #[error("camera {camera}: {doing}: {reason}")]
    Library {
        /// Camera.
        camera: CameraId,
        /// What was being done.
        doing: &'static str,
        /// The library's words.
        reason: String,
    },
}

/// What to write where the camera has a format that can be used.
fn instead_of(available: &[String]) -> String {
    let has = |format: &PixelFormat| available.iter().any(|name| name == format.name());
    let usable = PixelFormat::ALL.into_iter().filter(has);
    let lines: Vec<String> = usable.map(|f| format!("pixel_format = \"{f}\"")).collect();
    if lines.is_empty() {
        return "choose a monochrome camera or mode".to_owned();
    }
    format!("write {} in its part of pitchd.toml", lines.join(" or "))
}

fn in_words(places: &[Place]) -> String {
    let places: Vec<_> = places.iter().map(ToString::to_string).collect();
    places.join(" and ")
}
