//! What one camera saw, its unknowns, and the prediction of one sighting with its analytic derivatives.

use nalgebra::{Matrix2x3, Vector2, Vector3};

use super::spline::{Basis, Spline};
use crate::geometry::{Intrinsics, Pose};
use crate::scene::ParameterKind;

/// One 2-D point of one camera.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sighting {
    /// Stamped midpoint, seconds after the session's epoch.
    pub stamped_s: f64,
    /// Distorted pixel.
    pub pixel_px: Vector2<f64>,
    /// 1σ the file gave, or 1: only ratios within a camera matter.
    pub sigma_px: f64,
}

/// What a camera saw, with what is fixed about it.
#[derive(Debug, Clone)]
pub(super) struct View {
    /// By rising stamp.
    pub sightings: Vec<Sighting>,
    /// Rows of the image.
    pub height_px: f64,
    /// Stamp at which τ is stated, seconds after the session's epoch.
    pub epoch_s: f64,
    /// Lens of the rig file.
    pub lens: Intrinsics,
}

/// The unknowns of one camera.
#[derive(Debug, Clone)]
pub(super) struct CameraState {
    pub pose: Pose,
    /// τ at the view's epoch, seconds.
    pub delay_s: f64,
    pub skew_ppm: f64,
    pub readout_s: f64,
    pub lens: Intrinsics,
    /// Factor on the sightings' sigmas.
    pub noise: f64,
}

/// A border unknown.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Column {
    pub camera: usize,
    pub kind: ParameterKind,
}

/// 1σ of the Gaussian priors that keep weak unknowns in the range that hardware has.
#[derive(Debug, Clone)]
pub(super) struct Priors {
    pub skew_ppm: f64,
    /// Mean and 1σ.
    pub readout_s: (f64, f64),
    /// Relative, per camera.
    pub focal: Vec<f64>,
    pub principal_px: f64,
    pub radial: f64,
}

/// A sighting's prediction, linearised.
pub(super) struct Prediction {
    /// Predicted − observed, pixels.
    pub residual_px: Vector2<f64>,
    pub basis: Basis,
    camera_m: Vector3<f64>,
    by_camera_point: Matrix2x3<f64>,
    pub by_world_point: Matrix2x3<f64>,
    by_time: Vector2<f64>,
    since_epoch_s: f64,
    row: f64,
}

impl View {
    /// (y + ½)/height − ½ of a pixel row.
    fn row(&self, y_px: f64) -> f64 {
        (y_px + 0.5) / self.height_px - 0.5
    }

    /// True exposure midpoint of a sighting, seconds after the session's epoch.
    pub fn true_s(&self, camera: &CameraState, sighting: &Sighting) -> f64 {
        sighting.stamped_s - camera.delay_s - 1e-6 * camera.skew_ppm * (sighting.stamped_s - self.epoch_s)
            + camera.readout_s * self.row(sighting.pixel_px.y)
    }

    /// Stamp at a true instant in the middle row: the inverse of `true_s`, to first order in the skew.
    pub fn stamp_s(&self, camera: &CameraState, true_s: f64) -> f64 {
        let stamped_s = true_s + camera.delay_s;
        stamped_s + 1e-6 * camera.skew_ppm * (stamped_s - self.epoch_s)
    }

    /// Predicts one sighting; `None` behind the camera.
    pub fn predict(&self, camera: &CameraState, spline: &Spline, sighting: &Sighting) -> Option<Prediction> {
        let basis = spline.basis(self.true_s(camera, sighting));
        let world = spline.combine(basis.first, &basis.value);
        let rotation = camera.pose.rotation.matrix();
        let camera_m = rotation * world + camera.pose.translation_m;
        let projected = camera.lens.project_with_jacobian(&camera_m).ok()?;
        let by_world_point = projected.by_camera_point * rotation;
        Some(Prediction {
            residual_px: projected.pixel.vector() - sighting.pixel_px,
            basis,
            camera_m,
            by_camera_point: projected.by_camera_point,
            by_world_point,
            by_time: by_world_point * spline.combine(basis.first, &basis.rate),
            since_epoch_s: sighting.stamped_s - self.epoch_s,
            row: self.row(sighting.pixel_px.y),
        })
    }
}

impl Prediction {
    /// ∂residual/∂unknown of the camera that saw it.
    pub fn by(&self, kind: ParameterKind, lens: &Intrinsics) -> Vector2<f64> {
        use ParameterKind as K;
        let (x, y) = (
            self.camera_m.x / self.camera_m.z,
            self.camera_m.y / self.camera_m.z,
        );
        let r2 = x * x + y * y;
        let j = &self.by_camera_point;
        let c = &self.camera_m;
        // ∂x_c/∂ω = −[x_c]×: its columns are −x_c × e_k, written out e_k × x_c.
        match kind {
            K::RotationX => j * Vector3::new(0.0, -c.z, c.y),
            K::RotationY => j * Vector3::new(c.z, 0.0, -c.x),
            K::RotationZ => j * Vector3::new(-c.y, c.x, 0.0),
            K::TranslationX => j.column(0).into(),
            K::TranslationY => j.column(1).into(),
            K::TranslationZ => j.column(2).into(),
            K::CaptureDelay => -self.by_time,
            K::ClockSkew => -1e-6 * self.since_epoch_s * self.by_time,
            K::Readout => self.row * self.by_time,
            K::FocalScale => {
                let d = lens.pixel(crate::geometry::Normalized { x, y });
                Vector2::new(d.x - lens.cx_px, d.y - lens.cy_px)
            }
            K::PrincipalX => Vector2::new(1.0, 0.0),
            K::PrincipalY => Vector2::new(0.0, 1.0),
            K::RadialK1 => Vector2::new(lens.fx_px * x, lens.fy_px * y) * r2,
            K::RadialK2 => Vector2::new(lens.fx_px * x, lens.fy_px * y) * (r2 * r2),
        }
    }
}

impl CameraState {
    /// The value of a scalar unknown as an offset from its prior, and the prior's 1σ.
    pub fn prior(&self, column: Column, lens: &Intrinsics, priors: &Priors) -> Option<(f64, f64)> {
        use ParameterKind as K;
        match column.kind {
            K::ClockSkew => Some((self.skew_ppm, priors.skew_ppm)),
            K::Readout => Some((self.readout_s - priors.readout_s.0, priors.readout_s.1)),
            K::FocalScale => Some(((self.lens.fx_px / lens.fx_px).ln(), priors.focal[column.camera])),
            K::PrincipalX => Some((self.lens.cx_px - lens.cx_px, priors.principal_px)),
            K::PrincipalY => Some((self.lens.cy_px - lens.cy_px, priors.principal_px)),
            K::RadialK1 => Some((self.lens.distortion[0] - lens.distortion[0], priors.radial)),
            K::RadialK2 => Some((self.lens.distortion[1] - lens.distortion[1], priors.radial)),
            _ => None,
        }
    }

    /// Moves one unknown by `delta`; poses gather in `twist`.
    pub fn moved(&mut self, kind: ParameterKind, delta: f64, twist: &mut [f64; 6]) {
        use ParameterKind as K;
        match kind {
            K::RotationX => twist[0] = delta,
            K::RotationY => twist[1] = delta,
            K::RotationZ => twist[2] = delta,
            K::TranslationX => twist[3] = delta,
            K::TranslationY => twist[4] = delta,
            K::TranslationZ => twist[5] = delta,
            K::CaptureDelay => self.delay_s += delta,
            K::ClockSkew => self.skew_ppm += delta,
            K::Readout => self.readout_s += delta,
            K::FocalScale => {
                self.lens.fx_px *= delta.exp();
                self.lens.fy_px *= delta.exp();
            }
            K::PrincipalX => self.lens.cx_px += delta,
            K::PrincipalY => self.lens.cy_px += delta,
            K::RadialK1 => self.lens.distortion[0] += delta,
            K::RadialK2 => self.lens.distortion[1] += delta,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::synthetic::{Scene, at_truth};
    use super::*;

    /// CameraTiming's doc by hand: a point in the last row but a half of a 1000-row camera, readout 20 ms,
    /// is seen 10 ms (less half a row) after the stamp says; a delay of 0.5 s puts it 0.5 s earlier.
    #[test]
    fn the_instant_of_a_sighting_by_hand() {
        let (views, state, _) = at_truth(
            &Scene {
                duration_s: 1.0,
                ..Scene::drone(1)
            },
            0.2,
        );
        let view = View {
            height_px: 1000.0,
            epoch_s: 2.0,
            ..views[0].clone()
        };
        let camera = CameraState {
            delay_s: 0.5,
            skew_ppm: 100.0,
            readout_s: 0.02,
            ..state.cameras[0].clone().unwrap()
        };
        let s = Sighting {
            stamped_s: 12.0,
            pixel_px: Vector2::new(0.0, 999.5),
            sigma_px: 1.0,
        };
        assert!((view.true_s(&camera, &s) - (12.0 - 0.5 - 0.001 + 0.01)).abs() < 1e-12);
    }
}
