//! Reprojection residuals of each camera: the scatter, and the rms over time, pitch by pitch or in slices.

use std::collections::BTreeMap;

use nalgebra::Matrix2;

use crate::scene::{Calibration, CameraCalibration, CameraId, Pitch};

use super::Residual;
use super::chart::{Chart, Margins, Scale};
use super::html::{count, escape, figure, median, number};

/// More dots than this add bytes and no sight: they are thinned evenly, and the caption says so.
const DOTS_MAX: usize = 4000;

/// One card a camera: scatter above, rms over time below, all at the same scales.
pub(super) fn cards(residuals: &[Residual], pitches: &[Pitch], calibration: &Calibration) -> String {
    let mut cameras: BTreeMap<&CameraId, Vec<&Residual>> = BTreeMap::new();
    for residual in residuals
        .iter()
        .filter(|r| r.dx_px.is_finite() && r.dy_px.is_finite())
    {
        cameras.entry(&residual.camera).or_default().push(residual);
    }
    let clock = SessionClock::new(residuals, pitches);
    let points: BTreeMap<&CameraId, Vec<[f64; 2]>> = cameras
        .iter()
        .map(|(id, all)| (*id, rms_over_time(all, &clock)))
        .collect();
    let over = |k: usize, least: f64| points.values().flatten().map(|p| p[k]).fold(least, f64::max);
    let end_s = over(0, 1.0);
    let scales = Scales {
        half_px: half_range_px(residuals),
        time: Scale::linear(-0.04 * end_s, 1.04 * end_s),
        rms: Scale::linear(0.0, 1.15 * over(1, 0.1)),
        rms_label: if pitches.is_empty() {
            "rms over the motion, px"
        } else {
            "rms of each pitch, px"
        },
    };
    cameras
        .iter()
        .map(|(id, all)| {
            let rms = points.get(id).map_or(&[][..], Vec::as_slice);
            card(id, all, calibration.camera(id), (rms, &scales))
        })
        .collect()
}

/// Where in the session a residual stands.
struct SessionClock {
    /// Seconds from the first release to each pitch's.
    pitch_s: BTreeMap<u32, f64>,
    /// First and last residual of a motion that is no pitch.
    motion_s: [f64; 2],
}

impl SessionClock {
    fn new(residuals: &[Residual], pitches: &[Pitch]) -> Self {
        let first_ns = pitches.iter().map(|p| p.release_time_ns).min().unwrap_or(0);
        let times = || {
            let free = residuals.iter().filter(|r| r.pitch == 0);
            free.map(|r| r.time_s).filter(|t| t.is_finite())
        };
        Self {
            pitch_s: pitches
                .iter()
                .map(|p| (p.pitch, p.release_time_ns.saturating_sub(first_ns) as f64 / 1e9))
                .collect(),
            motion_s: [
                times().fold(f64::INFINITY, f64::min),
                times().fold(f64::NEG_INFINITY, f64::max),
            ],
        }
    }

    /// A number that residuals to be taken together share, and their time in the session, seconds; `None` for
    /// a flight that became no pitch.
    fn place(&self, residual: &Residual) -> Option<(u32, f64)> {
        if residual.pitch > 0 {
            return Some((residual.pitch, *self.pitch_s.get(&residual.pitch)?));
        }
        let [start, end] = self.motion_s;
        let share = (residual.time_s - start) / (end - start).max(1e-9);
        share
            .is_finite()
            .then_some(((SLICES * share) as u32, residual.time_s - start))
    }
}

struct Scales {
    half_px: f64,
    time: Scale,
    rms: Scale,
    rms_label: &'static str,
}

/// Half the scatter's side: four times the middle residual, so that a few wild points do not shrink the rest.
fn half_range_px(residuals: &[Residual]) -> f64 {
    let kept = residuals
        .iter()
        .filter(|r| r.kept)
        .map(|r| r.dx_px.hypot(r.dy_px));
    (4.0 * median(kept).unwrap_or(0.25)).clamp(0.05, 1e3)
}

/// Slices of a motion that is no pitch.
const SLICES: f64 = 60.0;

/// (seconds in the session, rms px) of each pitch's kept points, by time; of each slice of a free motion.
fn rms_over_time(residuals: &[&Residual], clock: &SessionClock) -> Vec<[f64; 2]> {
    let mut sums: BTreeMap<u32, [f64; 3]> = BTreeMap::new();
    for r in residuals.iter().filter(|r| r.kept) {
        let Some((group, time_s)) = clock.place(r) else {
            continue;
        };
        let [count, time, square] = sums.entry(group).or_default();
        *count += 1.0;
        *time += time_s;
        *square += r.dx_px * r.dx_px + r.dy_px * r.dy_px;
    }
    let mut points: Vec<[f64; 2]> = sums
        .values()
        .map(|[count, time, square]| [time / count, (square / count).sqrt()])
        .collect();
    points.sort_by(|a, b| a[0].total_cmp(&b[0]));
    points
}

fn card(
    id: &CameraId,
    residuals: &[&Residual],
    camera: Option<&CameraCalibration>,
    (rms, scales): (&[[f64; 2]], &Scales),
) -> String {
    let (scatter, beyond, drawn) = scatter(id, residuals, camera, scales);
    let kept = residuals.iter().filter(|r| r.kept).count();
    let n = kept.max(1) as f64;
    let mean = |of: fn(&Residual) -> f64| residuals.iter().filter(|r| r.kept).map(|r| of(r)).sum::<f64>() / n;
    let square = mean(|r| r.dx_px * r.dx_px + r.dy_px * r.dy_px);
    let mut caption = format!(
        "<b>{}</b>: rms {} px, mean ({}, {}) px, {}",
        escape(id.as_str()),
        number(square.sqrt(), 3),
        number(mean(|r| r.dx_px), 3),
        number(mean(|r| r.dy_px), 3),
        count(kept, "point", "points"),
    );
    let outliers = residuals.len() - kept;
    if outliers > 0 {
        caption += &format!(
            ", <span class=\"key cross\">{}</span>",
            count(outliers, "outlier", "outliers")
        );
    }
    caption.push('.');
    if beyond > 0 {
        caption += &format!(" {beyond} beyond the picture.");
    }
    if drawn < kept {
        caption += &format!(" {drawn} of them drawn.");
    }
    figure(
        "card",
        &format!("{scatter}{}", rms_chart(id, rms, scales)),
        &caption,
    )
}

/// The scatter; how many points lie beyond it, and how many of those kept are drawn.
fn scatter(
    id: &CameraId,
    residuals: &[&Residual],
    camera: Option<&CameraCalibration>,
    scales: &Scales,
) -> (String, usize, usize) {
    let half = scales.half_px;
    let margins = Margins {
        left: 44.0,
        top: 26.0,
        right: 14.0,
        bottom: 42.0,
    };
    // Rows grow downwards in the picture; so does dy here.
    let (across, down) = (Scale::linear(-half, half), Scale::linear(half, -half));
    let mut chart = Chart::new([358.0, 368.0], margins, across, down);
    chart.axes(["dx, px →", "dy, px ↓"], [5, 5]);
    chart.line("zero", &[[-half, 0.0], [half, 0.0]]);
    chart.line("zero", &[[0.0, -half], [0.0, half]]);
    if let Some(camera) = camera {
        let sigma = camera.noise_sigma_px;
        chart.ellipse("sigma", [0.0, 0.0], &Matrix2::identity(), 2.0 * sigma);
    }
    let place = |r: &&Residual| [r.dx_px, r.dy_px];
    let kept: Vec<[f64; 2]> = residuals.iter().filter(|r| r.kept).map(place).collect();
    let outliers: Vec<[f64; 2]> = residuals.iter().filter(|r| !r.kept).map(place).collect();
    let every = kept.len().div_ceil(DOTS_MAX).max(1);
    let drawn: Vec<[f64; 2]> = kept.iter().copied().step_by(every).collect();
    chart.dots("dots", &drawn);
    chart.crosses("crosses", &outliers);
    let beyond = kept
        .iter()
        .chain(&outliers)
        .filter(|p| p[0].abs() > half || p[1].abs() > half)
        .count();
    (
        chart.finish(&format!("Residuals of camera {id}")),
        beyond,
        drawn.len(),
    )
}

fn rms_chart(id: &CameraId, rms: &[[f64; 2]], scales: &Scales) -> String {
    let margins = Margins {
        left: 44.0,
        top: 26.0,
        right: 14.0,
        bottom: 42.0,
    };
    let mut chart = Chart::new([358.0, 170.0], margins, scales.time, scales.rms);
    chart.axes(["time in the session, s", scales.rms_label], [5, 3]);
    chart.line("trend", rms);
    for point in rms {
        chart.circle("mark", *point, 3.0);
    }
    chart.finish(&format!("Residual rms of camera {id} over the session"))
}
