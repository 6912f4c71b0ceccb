//! A first flight from points and poses: constant acceleration by robust linear least squares.

use nalgebra::{Matrix2x3, RowVector3, SMatrix, SVector, Vector2};

use super::equations::Sighting;
use super::physics::{Aerodynamics, Physics, TYPICAL_LIFT_EXPONENT};
use super::sighting::CameraModel;
use super::trajectory::{BasisRow, TERMS, TYPICAL_DRAG, Trajectory};

/// Coefficients of the start: three per axis.
const UNKNOWNS: usize = 9;
/// 1σ of drag and lift about the start's prior (gravity alone), m/s² per axis.
const FORCE_SIGMA_MPS2: f64 = 12.0;
/// Most passes of re-weighting; the weights of 20 % gross outliers are below 1 % after six.
const PASSES: usize = 10;

struct Row {
    camera: usize,
    basis: BasisRow,
    /// `rows · position + offset` is zero for a point on the ray (normalised units times depth).
    rows: Matrix2x3<f64>,
    offset: Vector2<f64>,
    depth_row: RowVector3<f64>,
    depth_offset: f64,
}

/// A trajectory of constant acceleration over the sightings' span, and the median misfit in pixels.
/// `None` when no sighting has a direction or the points do not fix a start.
pub fn linear_start(
    cameras: &[CameraModel],
    sightings: &[Sighting],
    physics: Physics,
    epoch_ns: i64,
) -> Option<(Trajectory, f64)> {
    let time = |s: &Sighting| {
        let timing = &cameras[s.camera].timing;
        timing.true_seconds(s.point.stamped, s.point.pixel.y, epoch_ns)
    };
    let begin = sightings.iter().map(time).fold(f64::INFINITY, f64::min);
    let end = sightings.iter().map(time).fold(f64::NEG_INFINITY, f64::max);
    if !(end > begin) {
        return None;
    }
    let empty = Trajectory::new(physics, epoch_ns, (begin, end), nalgebra::DVector::zeros(0));
    let rows: Vec<Row> = sightings
        .iter()
        .filter_map(|s| {
            let camera = &cameras[s.camera];
            let n = camera.intrinsics.direction(s.point.pixel).ok()?;
            let r = camera.pose.rotation.matrix();
            let t = &camera.pose.translation_m;
            Some(Row {
                camera: s.camera,
                basis: empty.basis(time(s)),
                rows: Matrix2x3::from_rows(&[r.row(0) - n.x * r.row(2), r.row(1) - n.y * r.row(2)]),
                offset: Vector2::new(t.x - n.x * t.z, t.y - n.y * t.z),
                depth_row: r.row(2).into_owned(),
                depth_offset: t.z,
            })
        })
        .collect();
    let mut weights: Vec<f64> = rows
        .iter()
        .map(|r| cameras[r.camera].intrinsics.fx_px / 20.0)
        .collect();
    let mut median_px = f64::INFINITY;
    let mut solution = None;
    for _ in 0..PASSES {
        let c = solve(&rows, &weights, &empty)?;
        let mut misfits = Vec::with_capacity(rows.len());
        let mut scales = Vec::with_capacity(rows.len());
        for row in &rows {
            let position = position(&c, &row.basis);
            let depth = (row.depth_row * position)[0] + row.depth_offset;
            // A ball nearer than a metre, or behind the camera, is a wrong start, not a near ball.
            let scale = cameras[row.camera].intrinsics.fx_px / depth.abs().max(1.0);
            misfits.push(scale * (row.rows * position + row.offset).norm());
            scales.push(scale);
        }
        let mut sorted = misfits.clone();
        sorted.sort_by(f64::total_cmp);
        let median_before_px = median_px;
        median_px = *sorted.get(sorted.len() / 2)?;
        let width = (2.0 * median_px).max(0.5);
        for ((weight, misfit), scale) in weights.iter_mut().zip(&misfits).zip(&scales) {
            *weight = scale / (1.0 + (misfit / width).powi(2));
        }
        solution = Some(c);
        if (median_before_px - median_px).abs() < 0.02 * median_px {
            break;
        }
    }
    let c = solution?;
    let mut parameters = empty.parameters().clone();
    for axis in 0..3 {
        for k in 0..3 {
            parameters[axis * TERMS + k] = c[3 * axis + k];
        }
    }
    let aerodynamics = Aerodynamics {
        drag_coefficient: TYPICAL_DRAG,
        lift: nalgebra::Vector3::zeros(),
        lift_exponent: TYPICAL_LIFT_EXPONENT,
    };
    let start = empty.with_parameters(parameters).with_aerodynamics(&aerodynamics);
    Some((start, median_px))
}

fn position(c: &SVector<f64, UNKNOWNS>, basis: &BasisRow) -> nalgebra::Vector3<f64> {
    nalgebra::Vector3::from_fn(|axis, _| (0..3).map(|k| c[3 * axis + k] * basis.value[k]).sum())
}

fn solve(rows: &[Row], weights: &[f64], empty: &Trajectory) -> Option<SVector<f64, UNKNOWNS>> {
    let mut normal = SMatrix::<f64, UNKNOWNS, UNKNOWNS>::zeros();
    let mut right = SVector::<f64, UNKNOWNS>::zeros();
    for (row, weight) in rows.iter().zip(weights) {
        let w2 = weight * weight;
        let information = w2 * row.rows.transpose() * row.rows;
        let pull = w2 * row.rows.transpose() * row.offset;
        for a in 0..3 {
            for k in 0..3 {
                right[3 * a + k] -= pull[a] * row.basis.value[k];
                for b in 0..3 {
                    for l in 0..3 {
                        normal[(3 * a + k, 3 * b + l)] +=
                            information[(a, b)] * row.basis.value[k] * row.basis.value[l];
                    }
                }
            }
        }
    }
    let (begin, _) = empty.span_s();
    let curvature = empty.basis(begin).curvature[2];
    let weight = (curvature / FORCE_SIGMA_MPS2).powi(2);
    for axis in 0..3 {
        normal[(3 * axis + 2, 3 * axis + 2)] += weight;
    }
    let gravity = -empty.physics().gravity_mps2 / curvature;
    right[8] += weight * gravity;
    Some(normal.cholesky()?.solve(&right))
}
