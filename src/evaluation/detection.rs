//! 2-D tracks against the true centres: recall, precision, bias along and across the motion, honesty of σ.

use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};

use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

use crate::scene::{CameraId, FrameSearch, Track};
use crate::simulation::CameraCentres;

/// A point further from the true centre than this is not that ball, pixels.
const SAME_BALL_PX: f64 = 3.0;
/// A track of which less than this share is the ball is false.
const TRUE_SHARE_MIN: f64 = 0.5;

/// Truth of centres that cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum DetectionScoreError {
    /// File or folder missing.
    #[error("{}: {source}", path.display())]
    Io {
        /// Path.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A row that is no centre.
    #[error("{}:{line}: no true centre: {reason}", path.display())]
    Row {
        /// File.
        path: PathBuf,
        /// Line, from 1.
        line: u64,
        /// What is wrong.
        reason: String,
    },
}

/// A ball in one frame as it truly was.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct BallTruth {
    /// Number of the pitch or throw.
    pub pitch: u32,
    /// Frame number.
    pub frame: u64,
    /// Centre, distorted pixels.
    pub x_px: f64,
    /// Centre, distorted pixels.
    pub y_px: f64,
    /// 1 where it is in the picture, in flight and not hidden.
    pub visible: u8,
}

/// Score of one camera.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DetectionScore {
    /// Camera.
    pub camera: CameraId,
    /// Pitches with visible balls.
    pub pitches: usize,
    /// Pitches of which at least half of the visible balls are in one track.
    pub pitches_found: usize,
    /// Visible balls.
    pub visible: usize,
    /// Of them found.
    pub found: usize,
    /// Points of all tracks that are no pitched ball.
    pub false_points: usize,
    /// Tracks that are no pitch.
    pub false_tracks: usize,
    /// Found ÷ visible.
    pub recall: f64,
    /// Found ÷ all points.
    pub precision: f64,
    /// Mean error along and across the motion, pixels.
    pub bias_px: [f64; 2],
    /// Rms error along and across the motion, pixels.
    pub rms_px: [f64; 2],
    /// Largest error, pixels.
    pub worst_px: f64,
    /// Mean squared error over its covariance (1: honest), where points have one.
    pub normalised_square: f64,
    /// What the search cost, how late it answered and what it left out, where that is known.
    pub search: Option<FrameSearch>,
    /// Visible balls that are in no track.
    #[serde(skip)]
    pub missed: Vec<BallTruth>,
    /// Numbers of the false tracks.
    #[serde(skip)]
    pub false_track_numbers: Vec<u32>,
}

/// True centres of one camera as the simulator has them.
pub fn truth_of(centres: &CameraCentres) -> Vec<BallTruth> {
    centres
        .centres
        .iter()
        .map(|c| BallTruth {
            pitch: c.pitch,
            frame: c.frame,
            x_px: c.pixel.x,
            y_px: c.pixel.y,
            visible: u8::from(c.visible),
        })
        .collect()
}

/// Reads `TRUTH/<camera>.csv` (`pitch,frame,timestamp_ns,x_px,y_px,visible,…`).
///
/// # Errors
/// [`DetectionScoreError`] with file and line.
pub fn read_centres(folder: &Path, camera: &CameraId) -> Result<Vec<BallTruth>, DetectionScoreError> {
    let path = folder.join(format!("{camera}.csv"));
    let file = std::fs::File::open(&path).map_err(|source| DetectionScoreError::Io {
        path: path.clone(),
        source,
    })?;
    csv::Reader::from_reader(file)
        .deserialize()
        .enumerate()
        .map(|(i, row)| {
            row.map_err(|e: csv::Error| DetectionScoreError::Row {
                path: path.clone(),
                line: i as u64 + 2,
                reason: e.to_string(),
            })
        })
        .collect()
}

/// Scores the tracks of one camera. Balls numbered above `pitches_max` are throws: tracking one is false.
pub fn score_tracks(
    camera: &CameraId,
    tracks: &[Track],
    truth: &[BallTruth],
    pitches_max: u32,
) -> DetectionScore {
    let mut at: BTreeMap<(u64, u32), &BallTruth> = BTreeMap::new();
    for ball in truth.iter().filter(|b| b.pitch <= pitches_max) {
        at.insert((ball.frame, ball.pitch), ball);
    }
    let mut tally = Tally::default();
    let mut hit: BTreeMap<(u64, u32), bool> = BTreeMap::new();
    let mut best_of_pitch: BTreeMap<u32, usize> = BTreeMap::new();
    for track in tracks.iter().filter(|t| t.camera == *camera) {
        let mut of_pitch: BTreeMap<u32, usize> = BTreeMap::new();
        for point in &track.points {
            let near = at
                .range((point.frame, 0)..=(point.frame, u32::MAX))
                .find(|(_, ball)| {
                    (point.pixel.x - ball.x_px).hypot(point.pixel.y - ball.y_px) < SAME_BALL_PX
                });
            let Some((key, ball)) = near else {
                tally.false_points += 1;
                continue;
            };
            *of_pitch.entry(ball.pitch).or_default() += 1;
            if ball.visible == 0 {
                continue;
            }
            hit.insert(*key, true);
            let off = Vector2::new(point.pixel.x - ball.x_px, point.pixel.y - ball.y_px);
            let covariance = point.covariance_px2.and_then(|c| c.try_inverse());
            tally.add(
                off,
                motion(&at, ball),
                covariance.map(|i| (off.transpose() * i * off)[0] / 2.0),
            );
        }
        let matched = of_pitch.values().sum::<usize>();
        if (matched as f64) < TRUE_SHARE_MIN * track.points.len() as f64 {
            tally.false_tracks.push(track.track);
        }
        for (pitch, count) in of_pitch {
            let best = best_of_pitch.entry(pitch).or_default();
            *best = (*best).max(count);
        }
    }
    let mut visible_of: BTreeMap<u32, usize> = BTreeMap::new();
    let mut missed = Vec::new();
    for (key, ball) in at.iter().filter(|(_, b)| b.visible != 0) {
        *visible_of.entry(ball.pitch).or_default() += 1;
        if !hit.contains_key(key) {
            missed.push(**ball);
        }
    }
    let visible = visible_of.values().sum::<usize>();
    let found = hit.len();
    let n = f64::max(tally.count, 1.0);
    DetectionScore {
        camera: camera.clone(),
        pitches: visible_of.len(),
        pitches_found: visible_of
            .iter()
            .filter(|(pitch, count)| best_of_pitch.get(pitch).is_some_and(|best| 2 * best >= **count))
            .count(),
        visible,
        found,
        false_points: tally.false_points,
        false_tracks: tally.false_tracks.len(),
        recall: found as f64 / visible.max(1) as f64,
        precision: found as f64 / (found + tally.false_points).max(1) as f64,
        bias_px: [tally.sum.x / n, tally.sum.y / n],
        rms_px: [(tally.squares.x / n).sqrt(), (tally.squares.y / n).sqrt()],
        worst_px: tally.worst_px,
        normalised_square: tally.normalised / f64::max(tally.normalised_count, 1.0),
        search: None,
        missed,
        false_track_numbers: tally.false_tracks,
    }
}

/// Direction of a ball's motion in the picture, from its truth one frame before and after.
fn motion(at: &BTreeMap<(u64, u32), &BallTruth>, ball: &BallTruth) -> Vector2<f64> {
    let place = |frame: u64| at.get(&(frame, ball.pitch)).map(|b| Vector2::new(b.x_px, b.y_px));
    let here = Vector2::new(ball.x_px, ball.y_px);
    let before = place(ball.frame.wrapping_sub(1)).unwrap_or(here);
    let after = place(ball.frame + 1).unwrap_or(here);
    (after - before).try_normalize(1e-9).unwrap_or_else(Vector2::x)
}

#[derive(Default)]
struct Tally {
    count: f64,
    sum: Vector2<f64>,
    squares: Vector2<f64>,
    worst_px: f64,
    normalised: f64,
    normalised_count: f64,
    false_points: usize,
    false_tracks: Vec<u32>,
}

impl Tally {
    fn add(&mut self, off: Vector2<f64>, direction: Vector2<f64>, normalised: Option<f64>) {
        let across = Vector2::new(-direction.y, direction.x);
        let parts = Vector2::new(off.dot(&direction), off.dot(&across));
        self.count += 1.0;
        self.sum += parts;
        self.squares += parts.component_mul(&parts);
        self.worst_px = self.worst_px.max(off.norm());
        if let Some(square) = normalised {
            self.normalised += square;
            self.normalised_count += 1.0;
        }
    }
}

impl fmt::Display for DetectionScore {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{}: pitches {} of {}, recall {:.2} % ({} of {}), precision {:.2} %, false tracks {}",
            self.camera,
            self.pitches_found,
            self.pitches,
            100.0 * self.recall,
            self.found,
            self.visible,
            100.0 * self.precision,
            self.false_tracks
        )?;
        writeln!(
            f,
            "  centre along/across: bias {:+.3} {:+.3} px, rms {:.3} {:.3} px, worst {:.2} px, e²/σ² {:.2}",
            self.bias_px[0],
            self.bias_px[1],
            self.rms_px[0],
            self.rms_px[1],
            self.worst_px,
            self.normalised_square
        )?;
        match &self.search {
            Some(search) => writeln!(f, "  latency: {search}"),
            None => writeln!(f, "  latency: not told beside these tracks (replay writes it)"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pixel;
    use crate::scene::TrackPoint;
    use crate::time::StampedMidpoint;

    fn ball(pitch: u32, frame: u64, visible: u8) -> BallTruth {
        BallTruth {
            pitch,
            frame,
            x_px: 10.0 * frame as f64,
            y_px: 5.0,
            visible,
        }
    }

    #[test]
    fn a_shifted_track_shows_its_bias_and_a_stray_one_is_false() {
        let camera = CameraId::new("a").unwrap();
        let truth: Vec<BallTruth> = (0..20).map(|i| ball(1, i, u8::from(i != 3))).collect();
        let track = |number: u32, dy: f64, frames: std::ops::Range<u64>| Track {
            camera: camera.clone(),
            track: number,
            points: frames
                .map(|i| TrackPoint {
                    frame: i,
                    stamped: StampedMidpoint::from_nanos(i as i64),
                    pixel: Pixel::new(10.0 * i as f64 + 0.1, 5.0 + dy),
                    covariance_px2: Some(nalgebra::Matrix2::identity() * 0.01),
                })
                .collect(),
        };
        let score = score_tracks(&camera, &[track(1, 0.2, 0..18), track(2, 40.0, 2..9)], &truth, 1);
        assert_eq!(
            (score.pitches, score.pitches_found, score.false_tracks),
            (1, 1, 1)
        );
        assert_eq!((score.visible, score.found, score.missed.len()), (19, 17, 2));
        assert!((score.bias_px[0] - 0.1).abs() < 1e-9 && (score.bias_px[1] - 0.2).abs() < 1e-9);
        assert!((score.normalised_square - 2.5).abs() < 1e-9);
        assert_eq!(score.false_points, 7);
    }
}
