//! Simulated sessions: a scenario in, 2-D tracks or frames out, with the truth beside every product.
//!
//! * [`Scenario`]: site, cameras, pitches, noise, looks; a TOML file or built by a program;
//! * flights by RK4 of gravity, drag and Magnus force: never by the model that the solver fits;
//! * [`simulate_tracks`]: rig, tracks and truth;
//! * [`camera_frames`]: one camera's frames in time order, rendered as they are asked for.
//!
//! Signs are the house's: **true = stamped − τ**, the reference camera has τ = 0. Everything random follows
//! from the seed, by streams of their own, so that one option does not change another's numbers.

mod check;
mod clock;
mod error;
mod flight;
mod options;
mod pitch_file;
mod render;
mod scenario;
mod stock;
mod throw;
mod tracks;
mod truth;
mod write;

pub use clock::{CameraClock, Exposure};
pub use error::SimulationError;
pub use flight::{Flight, FlightEnd, FlightState, Forces, Transverse};
pub use options::{ClutterSpec, DetectionNoise, LandmarkClicks, Preset, RenderOptions};
pub use render::{CameraFrames, CameraRenderer, camera_frames, write_frames};
pub use scenario::{CameraSpec, FlightLaw, Knuckle, NineNumbers, PitchFile, PitchSpec, Scenario, SiteSpec};
pub use stock::{Layout, stock_camera, stock_pitches};
pub use throw::{PLATE_FRONT_Y_M, PLATE_MIDDLE_Y_M, RELEASE_PLANE_Y_M, ThrownBall};
pub use tracks::{Simulated, rig, simulate_tracks};
pub use truth::{CameraCentres, CameraTruth, PitchTruth, TrueCentre, TrueSample, Truth};
pub use write::{write_rig, write_tracks, write_truth};

#[cfg(test)]
mod tests;
