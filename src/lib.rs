//! pitchd: unsynchronised cameras in, metric 3-D pitches with their uncertainty out.
//!
//! ```text
//! capture ─► detection ─► tracking ─┐ 2-D tracks            ┌─► export, report
//! capture ─► detection ─► tracking ─┼─► calibration ─► flight ─┤
//! (live camera, recording, simulation: one trait)           └─► recording
//! ```
//!
//! A folder is a role; `DESIGN.md` says which room holds what, and `tests/architecture.rs` holds the arrows.
//! Conventions: the home-plate frame in metres, `camera_from_world` poses, the centre of the top-left pixel
//! is (0, 0), **true exposure midpoint = stamped midpoint − τ**; SI inside, feet and mph only in exports.

pub mod calibration;
pub mod capture;
pub mod cli;
pub mod config;
pub mod daemon;
pub mod detection;
pub mod emulation;
pub mod evaluation;
pub mod export;
pub mod eye;
pub mod flight;
pub mod geometry;
pub mod recording;
pub mod scene;

pub mod simulation;
pub mod time;
pub mod tracking;
pub mod vision;
