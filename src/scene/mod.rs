//! The nouns that cross a channel or reach the disk.
//!
//! *frame* (an image) → *detection* (pixels to a centre with covariance) → *track* (2-D over time, one
//! camera) → *flight* (3-D over time) → *pitch* (a flight and its numbers); beside them the *rig* (what a
//! person knows of the site), the *field* (landmarks by name) and the *calibration*.

mod ball;
mod calibration;
mod camera;
mod detection;
mod feature;
mod field;
mod foresight;
mod frame;
mod pitch;
mod pixel_format;
mod rig;
mod search;
mod track;

pub use ball::{BALL_MASS_KG, BALL_RADIUS_M};
pub use calibration::{
    Calibration, CalibrationMethod, CameraCalibration, CostStep, Parameter, ParameterKind, WorldFrame,
};
pub use camera::{CameraId, CameraIdError};
pub use detection::{Detection, DetectorKind};
pub use feature::FeatureValue;
pub use field::{FieldPreset, UnknownLandmark};
pub use foresight::{ForeseenPath, ForeseenPlace};
pub use frame::{Frame, FrameStamp, RawFrame};
pub use pitch::{FlightSample, Outlook, Pitch, PitchQuality, PitchSigma, StatcastRow};
pub use pixel_format::PixelFormat;
pub use rig::{
    CameraSetup, DistanceMeasurement, Landmark, LandmarkPosition, Motion, PixelRect, Rig, RollingShutter,
    Site,
};
pub use search::FrameSearch;
pub use track::{Track, TrackPoint};
