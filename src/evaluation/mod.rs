//! Results beside the truth: scores that say how good, over how much.

pub mod efficiency;
mod pitches;

pub use pitches::{AxisScore, DelayScore, PitchScore, PitchScoreError, score_pitches};
mod trajectory;

pub use trajectory::{
    TimedPosition, TrajectoryScore, TrajectoryScoreError, TrajectoryScoring, score_trajectory,
};
