//! A recorded camera as a source.

use super::{CaptureError, FrameGeometry, FrameSource};
use crate::recording::{CameraFrames, SessionReader};
use crate::scene::{CameraId, Frame};

/// Frames of one camera of a session. What is damaged is not an error here: the reader counts it, and
/// [`SessionReader::damage`] tells it when the source has come to its end.
pub struct RecordingSource {
    camera: CameraId,
    geometry: FrameGeometry,
    frames_expected: Option<u64>,
    frames: CameraFrames,
}

impl RecordingSource {
    /// The source of one camera.
    ///
    /// # Errors
    /// [`CaptureError::NoSuchCamera`]; [`CaptureError::NoFrames`] when not one of its frames is left.
    pub fn open(session: &SessionReader, camera: &CameraId) -> Result<Self, CaptureError> {
        let recording = session.cameras().find(|c| c.id == *camera);
        let (Some(recording), Some(frames)) = (recording, session.frames(camera)) else {
            return Err(CaptureError::NoSuchCamera {
                camera: camera.clone(),
                place: session.folder().to_owned(),
            });
        };
        let Some(geometry) = recording.geometry else {
            return Err(CaptureError::NoFrames {
                camera: camera.clone(),
                path: session.folder().to_owned(),
                reason: "no frame of it can be read".to_owned(),
            });
        };
        Ok(Self {
            camera: camera.clone(),
            geometry: FrameGeometry {
                width_px: geometry.width_px,
                height_px: geometry.height_px,
            },
            frames_expected: recording.frames,
            frames,
        })
    }
}

impl Iterator for RecordingSource {
    type Item = Result<Frame, CaptureError>;

    fn next(&mut self) -> Option<Self::Item> {
        self.frames.next().map(|recorded| Ok(recorded.frame))
    }
}

impl FrameSource for RecordingSource {
    fn camera(&self) -> &CameraId {
        &self.camera
    }
    fn geometry(&self) -> FrameGeometry {
        self.geometry
    }
    fn frames_expected(&self) -> Option<u64> {
        self.frames_expected
    }
}
