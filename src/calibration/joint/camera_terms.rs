//! What is known of the cameras apart from the ball: landmarks, surveyed positions, distances, priors, gauge.

use nalgebra::{DMatrix, DVector, Matrix2x3, Point3, Rotation3, Vector3};

use crate::flight::equations::Loss;
use crate::flight::sighting::CameraModel;
use crate::geometry::Pixel;
use crate::scene::{ParameterKind, Rig, RollingShutter, WorldFrame};

use super::JointOptions;
use super::problem::{Column, JointProblem};

/// 1σ of the gauge: the world's origin and yaw are the reference camera's by definition.
const GAUGE_SIGMA_M: f64 = 1e-5;
const GAUGE_SIGMA_RAD: f64 = 1e-6;
/// Keeps unknowns that nothing determines finite: a light second of a camera's reach and back.
const LOOSE_SIGMA_M: f64 = 1e4;
const LOOSE_SIGMA_RAD: f64 = 1e2;
const LOOSE_SIGMA_S: f64 = 1e3;

/// One view of a landmark.
#[derive(Debug, Clone)]
struct View {
    camera: usize,
    pixel: Pixel,
    /// Along x and y.
    sigma_px: [f64; 2],
}

/// One landmark and all its views. Its position error is shared by the views: their residuals are
/// correlated through it.
#[derive(Debug, Clone)]
struct LandmarkGroup {
    name: String,
    world_m: Point3<f64>,
    world_sigma_m: f64,
    views: Vec<View>,
    /// Lower Cholesky factor of the views' covariance, as the cameras stood when it was taken: held while the
    /// cameras move, so that the cost has no slope that its equations lack.
    lower: DMatrix<f64>,
}

/// A Gaussian prior on one unknown's present value.
#[derive(Debug, Clone, Copy)]
struct ScalarPrior {
    camera: usize,
    parameter: ParameterKind,
    mean: f64,
    sigma: f64,
}

/// The terms.
#[derive(Debug, Clone, Default)]
pub(super) struct CameraTerms {
    landmarks: Vec<LandmarkGroup>,
    positions: Vec<(usize, Point3<f64>, f64)>,
    distances: Vec<(usize, usize, f64, f64)>,
    priors: Vec<ScalarPrior>,
    gauge: Option<(usize, Rotation3<f64>)>,
    focal_px: Vec<f64>,
}

/// Normal equations of the cameras' unknowns. Costs are sums of squares, without the half.
#[derive(Debug, Clone)]
pub(super) struct CameraEquations {
    pub(super) hessian: DMatrix<f64>,
    pub(super) gradient: DVector<f64>,
    pub(super) cost: f64,
}

/// A residual block: values and their derivatives by the columns, whitened.
struct Block {
    residual: DVector<f64>,
    rows: DMatrix<f64>,
}

/// A landmark view that the estimate contradicts.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct LandmarkMisfit {
    pub(super) camera: usize,
    pub(super) name: String,
    pub(super) residual_px: f64,
    pub(super) sigmas: f64,
}

impl CameraTerms {
    pub(super) fn new(
        rig: &Rig,
        problem: &JointProblem,
        cameras: &[CameraModel],
        options: &JointOptions,
    ) -> Self {
        let mut terms = Self {
            focal_px: problem
                .rig_cameras
                .iter()
                .map(|i| rig.cameras[*i].intrinsics.fx_px)
                .collect(),
            ..Self::default()
        };
        let problem_index = |rig_index: usize| problem.rig_cameras.iter().position(|c| *c == rig_index);
        for (camera, rig_index) in problem.rig_cameras.iter().enumerate() {
            let setup = &rig.cameras[*rig_index];
            if problem.world == WorldFrame::HomePlate {
                for mark in &setup.landmarks {
                    terms.add_landmark(camera, mark);
                }
                if let Some((position, sigma)) = setup.position {
                    terms.positions.push((camera, position, sigma.max(1e-6)));
                }
            }
            terms.add_priors(camera, setup, options);
        }
        for measured in &rig.distances {
            let ends =
                [&measured.between.0, &measured.between.1].map(|id| rig.index_of(id).and_then(problem_index));
            if let [Some(a), Some(b)] = ends {
                let sigma = measured.sigma_m.max(1e-6);
                terms.distances.push((a, b, measured.distance_m, sigma));
            }
        }
        if problem.world == WorldFrame::ReferenceCamera {
            // Positions survive as distances: their coordinates are not this world's.
            terms.add_position_distances(rig, problem);
            let pose = &cameras[problem.reference].pose;
            terms.gauge = Some((problem.reference, pose.rotation));
        }
        terms.weigh(cameras);
        terms
    }

    /// Weighs every landmark as the cameras stand now.
    pub(super) fn weigh(&mut self, cameras: &[CameraModel]) {
        for group in &mut self.landmarks {
            group.weigh(cameras);
        }
    }

    fn add_landmark(&mut self, camera: usize, mark: &crate::scene::Landmark) {
        let view = View {
            camera,
            pixel: mark.pixel,
            sigma_px: mark.sigma_px.map(|sigma| sigma.max(1e-3)),
        };
        let at = &mark.position;
        let shared = self
            .landmarks
            .iter_mut()
            .find(|g| at.world_sigma_m > 0.0 && g.name == mark.name && g.world_m == at.world_m);
        match shared {
            Some(group) => group.views.push(view),
            None => self.landmarks.push(LandmarkGroup {
                name: mark.name.clone(),
                world_m: at.world_m,
                world_sigma_m: at.world_sigma_m,
                views: vec![view],
                lower: DMatrix::zeros(0, 0),
            }),
        }
    }

    fn add_priors(&mut self, camera: usize, setup: &crate::scene::CameraSetup, options: &JointOptions) {
        let mut add = |parameter, mean, sigma| {
            self.priors.push(ScalarPrior {
                camera,
                parameter,
                mean,
                sigma,
            });
        };
        add(ParameterKind::ClockSkew, 0.0, options.skew_sigma_ppm);
        if setup.rolling_shutter == RollingShutter::Estimate {
            let (mean, sigma) = options.readout_prior_s;
            add(ParameterKind::Readout, mean, sigma);
        }
        if setup.focal_sigma_relative > 0.0 {
            add(ParameterKind::FocalScale, 1.0, setup.focal_sigma_relative);
        }
    }

    fn add_position_distances(&mut self, rig: &Rig, problem: &JointProblem) {
        let surveyed: Vec<_> = problem
            .rig_cameras
            .iter()
            .enumerate()
            .filter_map(|(c, i)| rig.cameras[*i].position.map(|(p, s)| (c, p, s.max(1e-6))))
            .collect();
        for (n, (a, pa, sa)) in surveyed.iter().enumerate() {
            for (b, pb, sb) in surveyed.iter().skip(n + 1) {
                self.distances.push((*a, *b, (pa - pb).norm(), sa.hypot(*sb)));
            }
        }
    }

    /// Whether any landmark, position or distance is in.
    pub(super) fn fix_scale(&self) -> bool {
        !(self.landmarks.is_empty() && self.positions.len() < 2 && self.distances.is_empty())
    }

    /// Robust cost.
    pub(super) fn cost(&self, cameras: &[CameraModel], columns: &[Column], loss: Loss) -> f64 {
        self.equations(cameras, columns, loss).cost
    }

    /// Normal equations at the cameras as they stand.
    pub(super) fn equations(
        &self,
        cameras: &[CameraModel],
        columns: &[Column],
        loss: Loss,
    ) -> CameraEquations {
        let n = columns.len();
        let mut equations = CameraEquations {
            hessian: DMatrix::zeros(n, n),
            gradient: DVector::zeros(n),
            cost: 0.0,
        };
        for group in &self.landmarks {
            if let Some(block) = group.block(cameras, columns) {
                equations.add(&block, Some(loss));
            } else {
                equations.cost += loss.apply(1e8).0;
            }
        }
        for (camera, position, sigma) in &self.positions {
            equations.add(&position_block(cameras, columns, *camera, position, *sigma), None);
        }
        for term in &self.distances {
            equations.add(&distance_block(cameras, columns, *term), None);
        }
        for prior in &self.priors {
            let block = self.prior_block(cameras, columns, prior);
            equations.add(&block, None);
        }
        if let Some((camera, rotation)) = &self.gauge {
            equations.add(&gauge_block(cameras, columns, *camera, rotation), None);
        }
        for (i, column) in columns.iter().enumerate() {
            let sigma = match column.parameter() {
                ParameterKind::RotationX | ParameterKind::RotationY | ParameterKind::RotationZ => {
                    LOOSE_SIGMA_RAD
                }
                ParameterKind::TranslationX | ParameterKind::TranslationY | ParameterKind::TranslationZ => {
                    LOOSE_SIGMA_M
                }
                ParameterKind::CaptureDelay => LOOSE_SIGMA_S,
                _ => f64::INFINITY,
            };
            equations.hessian[(i, i)] += 1.0 / (sigma * sigma);
        }
        equations
    }

    fn prior_block(&self, cameras: &[CameraModel], columns: &[Column], prior: &ScalarPrior) -> Block {
        let camera = &cameras[prior.camera];
        let (value, slope) = match prior.parameter {
            ParameterKind::ClockSkew => (camera.timing.clock_skew_ppm, 1.0),
            ParameterKind::Readout => (camera.timing.readout_s, 1.0),
            _ => {
                let scale = camera.intrinsics.fx_px / self.focal_px[prior.camera];
                (scale, scale)
            }
        };
        let mut rows = DMatrix::zeros(1, columns.len());
        if let Some(i) = columns
            .iter()
            .position(|c| c.camera == prior.camera && c.parameter() == prior.parameter)
        {
            rows[(0, i)] = slope / prior.sigma;
        }
        Block {
            residual: DVector::from_element(1, (value - prior.mean) / prior.sigma),
            rows,
        }
    }

    /// Landmark views farther than the limit from where the cameras put them.
    pub(super) fn misfits(&self, cameras: &[CameraModel], limit: f64) -> Vec<LandmarkMisfit> {
        let mut bad = Vec::new();
        for group in &self.landmarks {
            for view in &group.views {
                let seen = group.view_residual(cameras, view);
                let Some((residual, by_world)) = seen else {
                    continue;
                };
                let spread = by_world.norm_squared() / 2.0 * group.world_sigma_m.powi(2);
                let sigma_px = nalgebra::Vector2::from(view.sigma_px).map(|own| own.hypot(spread.sqrt()));
                let sigmas = residual.component_div(&sigma_px).norm();
                if sigmas > limit {
                    bad.push(LandmarkMisfit {
                        camera: view.camera,
                        name: group.name.clone(),
                        residual_px: residual.norm(),
                        sigmas,
                    });
                }
            }
        }
        bad
    }
}

impl LandmarkGroup {
    fn view_residual(
        &self,
        cameras: &[CameraModel],
        view: &View,
    ) -> Option<(nalgebra::Vector2<f64>, Matrix2x3<f64>)> {
        let camera = &cameras[view.camera];
        let seen = camera
            .intrinsics
            .project_with_jacobian(&camera.pose.transform(&self.world_m))
            .ok()?;
        Some((
            seen.pixel.vector() - view.pixel.vector(),
            seen.by_camera_point * camera.pose.rotation.matrix(),
        ))
    }

    /// Takes the views' covariance at the cameras as they stand; a view from behind has its click's alone.
    fn weigh(&mut self, cameras: &[CameraModel]) {
        let n = 2 * self.views.len();
        let mut by_world = DMatrix::zeros(n, 3);
        let mut covariance = DMatrix::zeros(n, n);
        for (v, view) in self.views.iter().enumerate() {
            let seen = self.view_residual(cameras, view);
            for k in 0..2 {
                covariance[(2 * v + k, 2 * v + k)] = view.sigma_px[k].powi(2);
                if let Some((_, world)) = &seen {
                    by_world.row_mut(2 * v + k).copy_from(&world.row(k));
                }
            }
        }
        let clicks = covariance.map(f64::sqrt);
        covariance += self.world_sigma_m.powi(2) * &by_world * by_world.transpose();
        self.lower = covariance.cholesky().map_or(clicks, |c| c.l());
    }

    fn block(&self, cameras: &[CameraModel], columns: &[Column]) -> Option<Block> {
        let n = 2 * self.views.len();
        let mut residual = DVector::zeros(n);
        let mut rows = DMatrix::zeros(n, columns.len());
        for (v, view) in self.views.iter().enumerate() {
            let camera = &cameras[view.camera];
            let x = camera.pose.transform(&self.world_m);
            let seen = camera.intrinsics.project_with_jacobian(&x).ok()?;
            let j = seen.by_camera_point;
            let turn = -j * x.cross_matrix();
            let r = seen.pixel.vector() - view.pixel.vector();
            let scaled = seen.pixel.vector()
                - nalgebra::Vector2::new(camera.intrinsics.cx_px, camera.intrinsics.cy_px);
            for k in 0..2 {
                residual[2 * v + k] = r[k];
                for (i, column) in columns.iter().enumerate() {
                    if column.camera == view.camera {
                        rows[(2 * v + k, i)] = match column.kind {
                            a @ 0..=2 => turn[(k, a)],
                            a @ 3..=5 => j[(k, a - 3)],
                            9 => scaled[k],
                            10 if k == 0 => 1.0,
                            11 if k == 1 => 1.0,
                            _ => 0.0,
                        };
                    }
                }
            }
        }
        let lower = &self.lower;
        Some(Block {
            residual: lower.solve_lower_triangular(&residual)?,
            rows: lower.solve_lower_triangular(&rows)?,
        })
    }
}

impl CameraEquations {
    fn add(&mut self, block: &Block, loss: Option<Loss>) {
        let distance2 = block.residual.norm_squared();
        // A group of n views has 2n degrees of freedom; the loss is made for two.
        let surplus = block.residual.len().saturating_sub(2) as f64;
        let (cost, weight) = match loss {
            Some(loss) => loss.apply((distance2 - surplus).max(0.0)),
            None => (distance2, 1.0),
        };
        self.cost += cost;
        if weight > 0.0 {
            self.hessian += weight * block.rows.tr_mul(&block.rows);
            self.gradient += weight * block.rows.tr_mul(&block.residual);
        }
    }
}

/// Derivative of the camera's centre by its shift υ: −Rᵀ (its turn leaves it where it is).
fn centre_rows(cameras: &[CameraModel], columns: &[Column], camera: usize) -> DMatrix<f64> {
    let r = cameras[camera].pose.rotation.matrix().transpose();
    DMatrix::from_fn(3, columns.len(), |row, i| {
        let column = columns[i];
        if column.camera == camera && (3..6).contains(&column.kind) {
            -r[(row, column.kind - 3)]
        } else {
            0.0
        }
    })
}

fn position_block(
    cameras: &[CameraModel],
    columns: &[Column],
    camera: usize,
    position: &Point3<f64>,
    sigma: f64,
) -> Block {
    let miss = (cameras[camera].pose.centre_m() - position) / sigma;
    Block {
        residual: DVector::from_column_slice(miss.as_slice()),
        rows: centre_rows(cameras, columns, camera) / sigma,
    }
}

fn distance_block(
    cameras: &[CameraModel],
    columns: &[Column],
    (a, b, distance_m, sigma): (usize, usize, f64, f64),
) -> Block {
    let between = cameras[a].pose.centre_m() - cameras[b].pose.centre_m();
    let length = between.norm().max(1e-9);
    let direction = nalgebra::RowVector3::from(between.transpose() / length);
    let rows = centre_rows(cameras, columns, a) - centre_rows(cameras, columns, b);
    Block {
        residual: DVector::from_element(1, (length - distance_m) / sigma),
        rows: DMatrix::from_fn(1, columns.len(), |_, i| {
            (0..3).map(|k| direction[k] * rows[(k, i)]).sum::<f64>() / sigma
        }),
    }
}

/// Holds the reference camera's centre at the origin and its yaw where it started.
fn gauge_block(cameras: &[CameraModel], columns: &[Column], camera: usize, start: &Rotation3<f64>) -> Block {
    let pose = &cameras[camera].pose;
    let turned: Vector3<f64> = (start.inverse() * pose.rotation).scaled_axis();
    let centre = pose.centre_m();
    let mut residual = DVector::zeros(4);
    let mut rows = DMatrix::zeros(4, columns.len());
    for k in 0..3 {
        residual[k] = centre[k] / GAUGE_SIGMA_M;
    }
    residual[3] = turned.z / GAUGE_SIGMA_RAD;
    rows.view_mut((0, 0), (3, columns.len()))
        .copy_from(&(centre_rows(cameras, columns, camera) / GAUGE_SIGMA_M));
    let up = pose.rotation.matrix().column(2);
    for (i, column) in columns.iter().enumerate() {
        if column.camera == camera && column.kind < 3 {
            rows[(3, i)] = up[column.kind] / GAUGE_SIGMA_RAD;
        }
    }
    Block { residual, rows }
}
