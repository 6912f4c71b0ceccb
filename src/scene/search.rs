//! What the search of one camera's frames cost, how late it answered, and what it left out.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::CameraId;

/// One camera's frames as they were searched.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FrameSearch {
    /// Camera.
    pub camera: CameraId,
    /// Frames searched.
    pub frames: u64,
    /// Frames that came between a frame and its candidates, on average: those that it is compared with.
    pub waited_frames: f64,
    /// The same at the camera's nominal rate, milliseconds.
    pub waited_ms: f64,
    /// Time to search a frame, with the fits of the balls that ended in it, milliseconds: median.
    pub search_ms_p50: f64,
    /// The same that one of a hundred frames exceeds.
    pub search_ms_p99: f64,
    /// Frames without candidates because too much of the picture changed at once.
    pub global_changes: u64,
    /// Candidates left out because a frame had too many.
    pub candidates_dropped: u64,
    /// Frames whose changed pixels did not all fit.
    pub overflows: u64,
}

impl FrameSearch {
    /// What the frames themselves decide, in words: how late candidates come, and what was left out.
    pub fn seen(&self) -> String {
        let mut words = format!(
            "candidates {:.1} frames ({:.1} ms) after their frame",
            self.waited_frames, self.waited_ms
        );
        let left_out = [
            (self.global_changes, "frames changed all over"),
            (self.candidates_dropped, "candidates too many"),
            (self.overflows, "frames with too many changed pixels"),
        ];
        for (count, what) in left_out.iter().filter(|(count, _)| *count > 0) {
            words += &format!("; {count} {what}");
        }
        words
    }
}

impl fmt::Display for FrameSearch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{}; search p50 {:.2} p99 {:.2} ms a frame",
            self.seen(),
            self.search_ms_p50,
            self.search_ms_p99
        )
    }
}
