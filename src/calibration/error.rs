//! Why a calibration could not be had: each variant is something a person can act on.

use crate::scene::CameraId;

/// A calibration that failed, with the numbers that say why.
#[derive(Debug, thiserror::Error)]
pub enum CalibrationError {
    /// Nothing to work on.
    #[error("no track has points: nothing to calibrate from")]
    NoTracks,
    /// One camera alone has no delay and no depth.
    #[error("only camera {camera} has tracks: a calibration needs two")]
    OneCamera {
        /// The one.
        camera: CameraId,
    },
    /// Too few pitches seen by at least two cameras.
    #[error("{found} pitch(es) seen by two cameras, {needed} needed")]
    TooFewPitches {
        /// Found.
        found: usize,
        /// Needed.
        needed: usize,
    },
    /// A camera shares no pitch with the others.
    #[error("camera {camera} shares no pitch with the other cameras within the delays searched")]
    NoCommonPitches {
        /// The camera.
        camera: CameraId,
    },
    /// Too few landmarks for a pose.
    #[error("camera {camera} has {found} usable landmark(s), {needed} needed for a pose")]
    TooFewLandmarks {
        /// The camera.
        camera: CameraId,
        /// Found.
        found: usize,
        /// Needed.
        needed: usize,
    },
    /// No pose explains the clicks.
    #[error("camera {camera}: no pose explains the landmarks (best rms {rms_px:.1} px, worst {worst:?})")]
    LandmarksDisagree {
        /// The camera.
        camera: CameraId,
        /// Residual rms of the best pose, pixels.
        rms_px: f64,
        /// Name of the landmark with the largest residual.
        worst: String,
    },
    /// No camera has landmarks, where they are needed.
    #[error("no camera has enough landmarks: {purpose} needs them")]
    NoLandmarks {
        /// What for.
        purpose: String,
    },
    /// The geometry leaves the delay open.
    #[error(
        "delay of camera {camera} not observable: parallax {parallax_deg:.1}°, sigma {sigma_frames:.2} frame"
    )]
    NotEnoughParallax {
        /// The camera.
        camera: CameraId,
        /// Median angle between its rays and the reference camera's, degrees.
        parallax_deg: f64,
        /// 1σ of the delay, frames.
        sigma_frames: f64,
    },
    /// The five-point stage found no relative pose.
    #[error("no relative pose between cameras {first} and {second}: {reason}")]
    NoRelativePose {
        /// First camera.
        first: CameraId,
        /// Second camera.
        second: CameraId,
        /// Why.
        reason: String,
    },
    /// A free motion that the sightings do not share.
    #[error(
        "camera {camera} and the others see no common motion near the rough offsets \
         ({:.0} % of the points explained)", 100.0 * explained_share
    )]
    NoCommonMotion {
        /// The camera that nothing connects, or the reference.
        camera: CameraId,
        /// Share of the points that the best motion explains.
        explained_share: f64,
    },
    /// Flights that are no ball's, where no landmarks hold the world.
    #[error("{implausible} of {flights} flights are no pitch's ({reason}), and no landmarks hold the world")]
    NoPitches {
        /// Flights that no ball flies.
        implausible: usize,
        /// Flights found.
        flights: usize,
        /// What is wrong with the first.
        reason: String,
    },
    /// A solver stopped without an answer.
    #[error("{stage} did not converge: {reason}")]
    NotConverged {
        /// Which stage.
        stage: &'static str,
        /// What it met.
        reason: String,
    },
    /// A pixel of a track lies where the lens model cannot be inverted.
    #[error("camera {camera}, frame {frame}: {source}")]
    Lens {
        /// The camera.
        camera: CameraId,
        /// The frame.
        frame: u64,
        /// The lens's word.
        source: crate::geometry::LensError,
    },
    /// OpenCV refused.
    #[error(transparent)]
    Vision(#[from] crate::vision::VisionError),
}
