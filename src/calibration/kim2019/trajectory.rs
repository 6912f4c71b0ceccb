//! The 2-D trajectory models P_i^k(t) of the paper: F1 (Miyata et al. 2017) and F2.

use nalgebra::Vector2;

use crate::calibration::PitchTracks;
use crate::calibration::curves::robust_spline;
use crate::geometry::{Normalized, PlaneSpline, SplineShape};
use crate::scene::CameraSetup;

/// How the ball's path in one image is modelled over time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TrajectoryModel {
    /// F1: one quadratic per coordinate.
    Quadratic,
    /// F2: least-squares piecewise polynomial, by SPLINEFIT's rules: breaks spread evenly over the points, pieces
    /// joined with degree − 1 continuous derivatives.
    ///
    /// "Equation order = 3" [Kim19 §III-A] is read as degree 3 (cubic). SPLINEFIT's own argument counts the
    /// coefficients of a piece, so a literal `n = 3` there would be degree 2; `pitchd evaluate kim2019` prints the
    /// model error of both beside the paper's 0.0304 px.
    Spline {
        /// Pieces; 8 in the paper.
        pieces: usize,
        /// Degree of a piece; 3.
        degree: usize,
    },
}

impl TrajectoryModel {
    /// The paper's F2.
    pub const PAPER: Self = Self::Spline { pieces: 8, degree: 3 };

    fn shape(self, points: usize) -> SplineShape {
        let (pieces, degree) = match self {
            Self::Quadratic => (1, 2),
            // A track too short for all pieces gets fewer: each needs about three points.
            Self::Spline { pieces, degree } => (pieces.min(points / 3).max(1), degree),
        };
        SplineShape {
            degree,
            pieces,
            roughness: 0.0,
        }
    }
}

/// What is done about detections that are not the ball.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StrayPoints {
    /// All points are fitted, as in the paper's simulation, which has none.
    Keep,
    /// Points far off a robust curve are left out first (the paper's tracker does that before).
    Drop,
}

/// P(t) of one pitch in one camera.
#[derive(Debug, Clone)]
pub struct ImageTrajectory {
    spline: PlaneSpline,
    focal_px: Vector2<f64>,
    /// First and last stamp, seconds after the epoch.
    pub span_s: (f64, f64),
    /// Stamps of the points, seconds after the epoch.
    pub stamps_s: Vec<f64>,
    /// Mean distance from the points to the model, pixels.
    pub misfit_px: f64,
}

impl ImageTrajectory {
    /// Fits the points of one pitch in one camera, lens distortion taken out; `None` for too few points.
    pub fn fit(
        camera: &CameraSetup,
        pitch: &PitchTracks,
        epoch_ns: i64,
        (model, stray): (TrajectoryModel, StrayPoints),
    ) -> Option<Self> {
        let lens = &camera.intrinsics;
        let mut seen: Vec<(f64, Vector2<f64>)> = pitch
            .of(&camera.id)
            .flat_map(|t| &t.points)
            .filter_map(|p| {
                let n = lens.direction(p.pixel).ok()?;
                Some((
                    p.stamped.seconds_since(epoch_ns),
                    Vector2::new(lens.fx_px * n.x, lens.fy_px * n.y),
                ))
            })
            .collect();
        seen.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (mut times, mut points): (Vec<f64>, Vec<Vector2<f64>>) = seen.into_iter().unzip();
        if stray == StrayPoints::Drop {
            let (_, weights, _) = robust_spline(&times, &points, 8)?;
            let mut keep = weights.iter().map(|w| *w > 0.0);
            times.retain(|_| keep.next().unwrap_or(false));
            let mut keep = weights.iter().map(|w| *w > 0.0);
            points.retain(|_| keep.next().unwrap_or(false));
        }
        let ones = vec![1.0; times.len()];
        let spline = PlaneSpline::fit(&times, &points, &ones, model.shape(times.len()))?;
        let misfit_px = times
            .iter()
            .zip(&points)
            .map(|(t, p)| (spline.at(*t) - p).norm())
            .sum::<f64>()
            / times.len() as f64;
        Some(Self {
            span_s: spline.span(),
            spline,
            focal_px: Vector2::new(lens.fx_px, lens.fy_px),
            stamps_s: times,
            misfit_px,
        })
    }

    /// P(t) as a direction; beyond the ends the end pieces go on.
    pub fn direction(&self, stamped_s: f64) -> Normalized {
        let p = self.spline.at(stamped_s);
        Normalized {
            x: p.x / self.focal_px.x,
            y: p.y / self.focal_px.y,
        }
    }
}
