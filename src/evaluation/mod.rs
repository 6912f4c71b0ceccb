//! Results beside the truth: scores that say how good, over how much.

mod detection;
pub mod efficiency;
mod efficiency_plot;
pub mod kim2019;
mod parallel;
mod pictures;
mod pitches;
mod trajectory;

pub use detection::{BallTruth, DetectionScore, DetectionScoreError, read_centres, score_tracks, truth_of};
pub use pictures::{PictureError, Pictures};
pub use pitches::{AxisScore, DelayScore, PitchScore, PitchScoreError, score_pitches};
pub use trajectory::{
    TimedPosition, TrajectoryScore, TrajectoryScoreError, TrajectoryScoring, read_positions, score_trajectory,
};
