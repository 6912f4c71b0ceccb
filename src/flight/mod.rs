//! Tracks and the latest calibration in, 3-D flight and pitch numbers out.
//!
//! `physics` (forces) → `trajectory` (path and its prior) → `sighting` (a point against a path) →
//! `equations` (normal equations) → `start`, `solve` (one pitch with a known calibration) → `outcome`
//! → `pitch`; beside them the numbers and views of a solved flight: `numbers`, `nine_parameter`, `zone`, and
//! what a ball still in flight will do: `outlook`, `foresight`.

pub mod equations;
mod error;
mod foresight;
mod gate;
mod nine_parameter;
mod numbers;
pub mod outcome;
mod outlook;
pub mod physics;
pub mod pitch;
mod residuals;
pub mod sighting;
pub mod solve;
#[cfg(test)]
mod solve_tests;
mod start;
#[cfg(test)]
pub(crate) mod synthetic;
mod together;
pub mod trajectory;
mod zone;

pub use error::FlightError;
pub use foresight::foresee;
pub use nine_parameter::{
    FOOT_M, MPH_MPS, Movement, NineParameter, PLATE_FRONT_Y_FT, PLATE_MIDDLE_Y_FT, REFERENCE_Y_FT,
    STATCAST_GRAVITY_FTPS2,
};
pub use numbers::{
    NineParameterView, NumbersError, PLATE_FRONT_Y_M, PLATE_MIDDLE_Y_M, PlaneState, RELEASE_Y_M,
    nine_parameter_view, position_sigma_m, speed_at, state_at_plane,
};
pub use outcome::{SolvedFlight, TrackFit};
pub use outlook::{OutlookError, flight_so_far, outlook_of};
pub use physics::{Aerodynamics, Physics};
pub use pitch::{PitchOptions, flight_samples, is_far_off, pitch_from_flight};
pub use residuals::{PointResidual, residuals};
pub use solve::{FlightOptions, solve_flight};
pub use start::linear_start;
pub use together::may_be_one_pitch;
pub use trajectory::{FlightPrior, Trajectory};
pub use zone::{HALF_PLATE_M, StrikeZone};
