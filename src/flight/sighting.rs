//! One 2-D point set against one flight: residual, derivatives and covariance in pixels.

use nalgebra::{Matrix2, Matrix2x3, SMatrix, Vector2};

use super::trajectory::{BasisRow, Trajectory};
use crate::geometry::{Intrinsics, LensError, Pose};
use crate::scene::{CameraCalibration, CameraId, CameraSetup, ParameterKind, TrackPoint};
use crate::time::CameraTiming;

/// Unknowns of one camera, in the order of [`CAMERA_KINDS`].
pub const CAMERA_COLUMNS: usize = 12;

/// What each camera column is.
pub const CAMERA_KINDS: [ParameterKind; CAMERA_COLUMNS] = [
    ParameterKind::RotationX,
    ParameterKind::RotationY,
    ParameterKind::RotationZ,
    ParameterKind::TranslationX,
    ParameterKind::TranslationY,
    ParameterKind::TranslationZ,
    ParameterKind::CaptureDelay,
    ParameterKind::ClockSkew,
    ParameterKind::Readout,
    ParameterKind::FocalScale,
    ParameterKind::PrincipalX,
    ParameterKind::PrincipalY,
];

/// ∂pixel/∂(camera unknowns).
pub type CameraJacobian = SMatrix<f64, 2, CAMERA_COLUMNS>;

/// What no residual shows, added to every point whose covariance comes with it, pixels: the light on a ball and
/// the grid of the sensor move all points of a track alike. On rendered frames fitted centres scatter by 0.02 px
/// while whole tracks lie off by up to 0.1 px; without this the landmarks would count for nothing beside them.
/// Points that claim nothing are as noisy as their residuals.
const UNSEEN_SIGMA_PX: f64 = 0.04;

/// How noisy a camera's points are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraNoise {
    /// 1σ per coordinate where the point itself does not say, pixels.
    pub sigma_px: f64,
    /// Factor on the covariance of points that do say.
    pub variance_factor: f64,
    /// 1σ of the stamps, seconds: noise along the motion.
    pub jitter_s: f64,
}

/// A camera as the flight sees it.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraModel {
    /// Name.
    pub id: CameraId,
    /// Pose.
    pub pose: Pose,
    /// Lens.
    pub intrinsics: Intrinsics,
    /// Clock.
    pub timing: CameraTiming,
    /// Noise of its points.
    pub noise: CameraNoise,
}

impl CameraModel {
    /// From a published calibration.
    pub fn from_calibration(camera: &CameraCalibration) -> Self {
        let sigma_px = if camera.noise_sigma_px > 0.0 {
            camera.noise_sigma_px
        } else {
            0.5
        };
        Self {
            id: camera.id.clone(),
            pose: camera.camera_from_world,
            intrinsics: camera.intrinsics,
            timing: camera.timing(),
            noise: CameraNoise {
                sigma_px,
                variance_factor: 1.0,
                jitter_s: camera.jitter_sigma_s.max(0.0),
            },
        }
    }

    /// From a rig, placed at a pose with a delay; global shutter, no skew.
    pub fn from_setup(setup: &CameraSetup, pose: Pose, capture_delay_s: f64) -> Self {
        Self {
            id: setup.id.clone(),
            pose,
            intrinsics: setup.intrinsics,
            timing: CameraTiming {
                height_px: setup.height_px,
                ..CameraTiming::with_delay(capture_delay_s)
            },
            noise: CameraNoise {
                sigma_px: 0.5,
                variance_factor: 1.0,
                jitter_s: 0.0,
            },
        }
    }

    /// The camera moved by a step in its unknowns (order of [`CAMERA_KINDS`]).
    pub fn perturbed(&self, step: &[f64; CAMERA_COLUMNS]) -> Self {
        let mut moved = self.clone();
        moved.pose = self
            .pose
            .perturbed(&[step[0], step[1], step[2], step[3], step[4], step[5]]);
        moved.timing.capture_delay_s += step[6];
        moved.timing.clock_skew_ppm += step[7];
        moved.timing.readout_s += step[8];
        moved.intrinsics.fx_px *= 1.0 + step[9];
        moved.intrinsics.fy_px *= 1.0 + step[9];
        moved.intrinsics.cx_px += step[10];
        moved.intrinsics.cy_px += step[11];
        moved
    }
}

/// A point against a trajectory.
#[derive(Debug, Clone)]
pub struct Sight {
    /// Basis of the trajectory at the point's true midpoint.
    pub basis: BasisRow,
    /// Predicted − observed, pixels.
    pub residual_px: Vector2<f64>,
    /// ∂pixel/∂(ball position), px/m.
    pub by_position: Matrix2x3<f64>,
    /// Motion of the ball in the image, px/s.
    pub velocity_px_per_s: Vector2<f64>,
    /// Covariance of the point, jitter included, px².
    pub covariance_px2: Matrix2<f64>,
    /// Its inverse.
    pub information: Matrix2<f64>,
    /// Squared residual in units of the covariance.
    pub distance2: f64,
    /// Predicted pixel less principal point, pixels.
    from_principal: Vector2<f64>,
    camera_point_m: nalgebra::Vector3<f64>,
    by_camera_point: Matrix2x3<f64>,
}

impl Sight {
    /// Looks at the trajectory through the camera at the point's true midpoint.
    pub fn new(camera: &CameraModel, point: &TrackPoint, trajectory: &Trajectory) -> Result<Self, LensError> {
        let t = camera
            .timing
            .true_seconds(point.stamped, point.pixel.y, trajectory.epoch_ns());
        let basis = trajectory.basis(t);
        let camera_point_m = camera.pose.transform(&trajectory.position_at(&basis));
        let projected = camera.intrinsics.project_with_jacobian(&camera_point_m)?;
        let by_position = projected.by_camera_point * camera.pose.rotation.matrix();
        let velocity = by_position * trajectory.velocity_at(&basis);
        let residual = projected.pixel.vector() - point.pixel.vector();
        let noise = &camera.noise;
        let along = noise.jitter_s * velocity;
        let covariance = match point.covariance_px2 {
            Some(c) => noise.variance_factor * c + Matrix2::identity() * (UNSEEN_SIGMA_PX * UNSEEN_SIGMA_PX),
            None => Matrix2::identity() * (noise.sigma_px * noise.sigma_px),
        } + along * along.transpose();
        let information = covariance.try_inverse().unwrap_or_else(Matrix2::zeros);
        let principal = Vector2::new(camera.intrinsics.cx_px, camera.intrinsics.cy_px);
        Ok(Self {
            basis,
            residual_px: residual,
            by_position,
            velocity_px_per_s: velocity,
            covariance_px2: covariance,
            information,
            distance2: residual.dot(&(information * residual)),
            from_principal: projected.pixel.vector() - principal,
            camera_point_m,
            by_camera_point: projected.by_camera_point,
        })
    }

    /// ∂pixel/∂(camera unknowns), in the order of [`CAMERA_KINDS`]; skew in ppm.
    pub fn by_camera(&self, camera: &CameraModel, point: &TrackPoint) -> CameraJacobian {
        let mut j = CameraJacobian::zeros();
        let turn = -self.by_camera_point * self.camera_point_m.cross_matrix();
        j.fixed_view_mut::<2, 3>(0, 0).copy_from(&turn);
        j.fixed_view_mut::<2, 3>(0, 3).copy_from(&self.by_camera_point);
        let age = point.stamped.seconds_since(camera.timing.skew_epoch_ns);
        let row = (point.pixel.y + 0.5) / f64::from(camera.timing.height_px.max(1)) - 0.5;
        j.set_column(6, &-self.velocity_px_per_s);
        j.set_column(7, &(-1e-6 * age * self.velocity_px_per_s));
        j.set_column(8, &(row * self.velocity_px_per_s));
        j.set_column(9, &self.from_principal);
        j[(0, 10)] = 1.0;
        j[(1, 11)] = 1.0;
        j
    }
}
