//! Why a flight could not be solved.

use crate::scene::CameraId;

/// What a caller of the flight solver must handle.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FlightError {
    /// Too few points for six numbers of release state.
    #[error("{points} point(s) in {cameras} camera(s): a flight needs at least {needed}")]
    TooFewPoints {
        /// Points given.
        points: usize,
        /// Cameras that gave them.
        cameras: usize,
        /// Points needed.
        needed: usize,
    },
    /// A track of a camera that is not calibrated.
    #[error("camera {camera} has a track but no calibration")]
    UnknownCamera {
        /// Which.
        camera: CameraId,
    },
    /// No flight explains the points: most of them were left out.
    #[error("no flight fits: {kept} of {points} points agree (rms {rms_px:.1} px)")]
    NoFit {
        /// Points that agree with the best flight.
        kept: usize,
        /// Points given.
        points: usize,
        /// Root mean square residual of those kept, pixels.
        rms_px: f64,
    },
    /// The normal equations are singular: the cameras do not fix the flight.
    #[error("the cameras do not fix this flight (singular normal equations)")]
    Unobservable,
}
