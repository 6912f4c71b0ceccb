//! Results beside the truth: scores that say how good, over how much.

pub mod efficiency;
mod pitches;
mod trajectory;

pub use pitches::{AxisScore, DelayScore, PitchScore, PitchScoreError, score_pitches};
pub use trajectory::{
    TimedPosition, TrajectoryScore, TrajectoryScoreError, TrajectoryScoring, score_trajectory,
};
