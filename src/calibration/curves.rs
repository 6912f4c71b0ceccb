//! The ball's path in each image as a smooth curve over stamped time: for initial values only, never for the
//! estimate itself (which takes every detection at its own time).

use nalgebra::Vector2;

use super::{CalibrationError, PitchTracks};
use crate::geometry::{Normalized, PlaneSpline, SplineShape};
use crate::scene::{CameraSetup, Rig};

/// Fewest points of a curve.
const POINTS_NEEDED: usize = 8;

/// One pitch in one camera.
#[derive(Debug, Clone)]
pub struct ImageCurve {
    spline: PlaneSpline,
    focal_px: Vector2<f64>,
    /// First and last point kept, seconds after the epoch by the camera's stamps.
    pub start_s: f64,
    /// See `start_s`.
    pub end_s: f64,
    /// Points kept.
    pub points: usize,
    /// 1σ of a coordinate about the curve, pixels.
    pub noise_px: f64,
    /// The reduced samples that stand for the points.
    pub samples: Vec<(f64, Normalized)>,
    /// 1σ of a coordinate of a sample, pixels.
    pub sample_sigma_px: f64,
}

impl ImageCurve {
    /// Direction of the ball at a stamp (seconds after the epoch), lens distortion taken out.
    pub fn direction(&self, stamped_s: f64) -> Normalized {
        let p = self.spline.at(stamped_s);
        Normalized {
            x: p.x / self.focal_px.x,
            y: p.y / self.focal_px.y,
        }
    }

    /// Middle of the part seen.
    pub fn middle_s(&self) -> f64 {
        0.5 * (self.start_s + self.end_s)
    }
}

/// All curves of a calibration window.
#[derive(Debug, Clone)]
pub struct Curves {
    /// Nanoseconds; all stamps of the curves count from here.
    pub epoch_ns: i64,
    /// `[pitch][camera]`.
    pub of: Vec<Vec<Option<ImageCurve>>>,
}

impl Curves {
    /// Curves of every pitch and camera with enough points; each stands by `samples` samples.
    pub fn new(rig: &Rig, pitches: &[PitchTracks], samples: usize) -> Result<Self, CalibrationError> {
        let stamps = pitches.iter().flat_map(|p| &p.tracks).filter_map(|t| t.span());
        let epoch_ns = stamps
            .map(|(a, _)| a.nanos())
            .min()
            .ok_or(CalibrationError::NoTracks)?;
        let of = pitches
            .iter()
            .map(|pitch| {
                rig.cameras
                    .iter()
                    .map(|camera| image_curve(camera, pitch, epoch_ns, samples))
                    .collect()
            })
            .collect();
        Ok(Self { epoch_ns, of })
    }

    /// The curve of a pitch in a camera.
    pub fn get(&self, pitch: usize, camera: usize) -> Option<&ImageCurve> {
        self.of.get(pitch)?.get(camera)?.as_ref()
    }

    /// Pitches that both cameras saw.
    pub fn common(&self, a: usize, b: usize) -> Vec<usize> {
        (0..self.of.len())
            .filter(|&p| self.get(p, a).is_some() && self.get(p, b).is_some())
            .collect()
    }

    /// Middle stamp of the curves of a camera, seconds after the epoch.
    pub fn middle_s(&self, camera: usize) -> f64 {
        let mut sum = (0.0, 0);
        for curve in self.of.iter().filter_map(|p| p.get(camera)?.as_ref()) {
            sum = (sum.0 + curve.middle_s(), sum.1 + 1);
        }
        sum.0 / f64::from(sum.1.max(1))
    }

    /// Longest time between that and a curve of the camera, seconds.
    pub fn half_span_s(&self, camera: usize) -> f64 {
        let middle_s = self.middle_s(camera);
        let own = self.of.iter().filter_map(|p| p.get(camera)?.as_ref());
        own.map(|c| (c.middle_s() - middle_s).abs()).fold(0.0, f64::max)
    }
}

fn image_curve(
    camera: &CameraSetup,
    pitch: &PitchTracks,
    epoch_ns: i64,
    samples: usize,
) -> Option<ImageCurve> {
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
    let (times, points): (Vec<f64>, Vec<Vector2<f64>>) = seen.into_iter().unzip();
    let (spline, weights, noise_px) = robust_spline(&times, &points, 8)?;
    let kept: Vec<f64> = times
        .iter()
        .zip(&weights)
        .filter(|(_, w)| **w > 0.3)
        .map(|(t, _)| *t)
        .collect();
    if kept.len() < POINTS_NEEDED {
        return None;
    }
    let (start_s, end_s) = (*kept.first()?, *kept.last()?);
    let mut curve = ImageCurve {
        spline,
        focal_px: Vector2::new(lens.fx_px, lens.fy_px),
        start_s,
        end_s,
        points: kept.len(),
        noise_px,
        samples: Vec::new(),
        sample_sigma_px: (noise_px * (11.0 / kept.len() as f64).sqrt().min(1.0)).hypot(0.05),
    };
    let last = (samples.max(2) - 1) as f64;
    curve.samples = (0..samples.max(2))
        .map(|i| {
            // The spline's very ends are its noisiest; the samples keep a little inside.
            let share = 0.02 + 0.96 * i as f64 / last;
            let t = start_s + share * (end_s - start_s);
            (t, curve.direction(t))
        })
        .collect();
    Some(curve)
}

/// Cubic spline by iteratively reweighted least squares: first one cubic in the L1 sense, to find the gross
/// outliers, then up to `pieces` pieces with a redescending weight. Returns the weights and the noise, 1σ per coordinate.
pub(crate) fn robust_spline(
    times: &[f64],
    points: &[Vector2<f64>],
    pieces: usize,
) -> Option<(PlaneSpline, Vec<f64>, f64)> {
    if times.len() < POINTS_NEEDED {
        return None;
    }
    let mut weights = vec![1.0; times.len()];
    let rough = SplineShape {
        degree: 3,
        pieces: 1,
        roughness: 0.0,
    };
    let distances = |spline: &PlaneSpline| -> Vec<f64> {
        times
            .iter()
            .zip(points)
            .map(|(t, p)| (spline.at(*t) - p).norm())
            .collect()
    };
    let mut spline = PlaneSpline::fit(times, points, &weights, rough)?;
    for _ in 0..12 {
        for (w, d) in weights.iter_mut().zip(distances(&spline)) {
            *w = 1.0 / (d + 0.05);
        }
        spline = PlaneSpline::fit(times, points, &weights, rough)?;
    }
    let mut sigma = 0.0;
    for round in 0..8 {
        let d = distances(&spline);
        // Median of the norm of two Gaussian coordinates is 1.1774 σ.
        sigma = (median(&d) / 1.1774).max(0.02);
        let reach = if round < 2 { 8.0 } else { 5.0 } * sigma;
        for (w, d) in weights.iter_mut().zip(d) {
            *w = if d < reach {
                (1.0 - (d / reach).powi(2)).powi(2)
            } else {
                0.0
            };
        }
        let kept = weights.iter().filter(|w| **w > 0.0).count();
        let shape = SplineShape {
            degree: 3,
            pieces: (kept / 8).clamp(1, pieces),
            roughness: 1e-4,
        };
        spline = PlaneSpline::fit(times, points, &weights, shape)?;
    }
    Some((spline, weights, sigma))
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(0.0)
}
