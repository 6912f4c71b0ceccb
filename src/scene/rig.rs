//! The rig: what a person knows about the site and its cameras before any pitch (design §5).

use nalgebra::Point3;

use super::{CameraId, FieldPreset};
use crate::geometry::{Intrinsics, Pixel};

/// What moves in front of the cameras.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Motion {
    /// Pitched balls under gravity and drag; results are pitches.
    #[default]
    Flight,
    /// Anything that moves smoothly; the result is a trajectory.
    Free,
}

/// Site-wide facts.
#[derive(Debug, Clone, PartialEq)]
pub struct Site {
    /// For people.
    pub name: String,
    /// Landmarks by name.
    pub field: FieldPreset,
    /// What moves.
    pub motion: Motion,
    /// Local gravity, m/s².
    pub gravity_mps2: f64,
    /// Air density, kg/m³.
    pub air_density_kgpm3: f64,
}

/// Rolling-shutter readout of one camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum RollingShutter {
    /// All rows at once.
    Global,
    /// Unknown; estimated.
    Estimate,
    /// Known readout time of the frame, seconds.
    ReadoutSeconds(f64),
}

/// Where a landmark is in the world.
#[derive(Debug, Clone, PartialEq)]
pub struct LandmarkPosition {
    /// Home-plate frame, metres.
    pub world_m: Point3<f64>,
    /// Uncertainty of that position, metres per axis (0: exact).
    pub world_sigma_m: f64,
}

/// A landmark clicked in one camera's image.
#[derive(Debug, Clone, PartialEq)]
pub struct Landmark {
    /// Preset name, or a label of the person's.
    pub name: String,
    /// World position.
    pub position: LandmarkPosition,
    /// Where it was clicked, distorted pixels.
    pub pixel: Pixel,
    /// Uncertainty of that place along x and y, pixels.
    pub sigma_px: [f64; 2],
}

/// A rectangle of pixels: columns `x_px .. x_px + width_px`, rows `y_px .. y_px + height_px`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PixelRect {
    /// Left column.
    pub x_px: u32,
    /// Top row.
    pub y_px: u32,
    /// Columns.
    pub width_px: u32,
    /// Rows.
    pub height_px: u32,
}

impl PixelRect {
    /// Whether the pixel nearest to (x, y) is inside.
    pub fn contains(&self, x_px: f64, y_px: f64) -> bool {
        let left = f64::from(self.x_px) - 0.5;
        let top = f64::from(self.y_px) - 0.5;
        (left..left + f64::from(self.width_px)).contains(&x_px)
            && (top..top + f64::from(self.height_px)).contains(&y_px)
    }
}

/// One camera as the rig file has it.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraSetup {
    /// Name.
    pub id: CameraId,
    /// Columns.
    pub width_px: u32,
    /// Rows.
    pub height_px: u32,
    /// Nominal frame rate, Hz.
    pub frame_rate_hz: f64,
    /// Exposure time, seconds, where given.
    pub exposure_s: Option<f64>,
    /// Rough offset: this camera's stamps + this = the reference camera's. With it, delays up to ±1.5 s are searched.
    pub time_offset_s: Option<f64>,
    /// Rolling shutter.
    pub rolling_shutter: RollingShutter,
    /// Lens and sensor.
    pub intrinsics: Intrinsics,
    /// Relative 1σ of the focal length; 0: taken as exact.
    pub focal_sigma_relative: f64,
    /// Surveyed centre and its sigma per axis, metres.
    pub position: Option<(Point3<f64>, f64)>,
    /// Clicked landmarks.
    pub landmarks: Vec<Landmark>,
    /// Where a ball is looked for; empty: everywhere.
    pub regions: Vec<PixelRect>,
    /// Where none is looked for.
    pub masks: Vec<PixelRect>,
}

/// A measured distance between two cameras' centres, which fixes the scale where no landmark does.
#[derive(Debug, Clone, PartialEq)]
pub struct DistanceMeasurement {
    /// The two cameras.
    pub between: (CameraId, CameraId),
    /// Metres.
    pub distance_m: f64,
    /// 1σ, metres.
    pub sigma_m: f64,
}

/// Site and cameras.
#[derive(Debug, Clone, PartialEq)]
pub struct Rig {
    /// The site.
    pub site: Site,
    /// Index of the reference camera (τ = 0) in `cameras`.
    pub reference: usize,
    /// At least one camera, ids unique.
    pub cameras: Vec<CameraSetup>,
    /// Measured distances.
    pub distances: Vec<DistanceMeasurement>,
}

impl Rig {
    /// Index of a camera.
    pub fn index_of(&self, id: &CameraId) -> Option<usize> {
        self.cameras.iter().position(|c| c.id == *id)
    }
    /// The camera of that name.
    pub fn camera(&self, id: &CameraId) -> Option<&CameraSetup> {
        self.cameras.iter().find(|c| c.id == *id)
    }
    /// The camera whose clock is the time scale.
    pub fn reference_camera(&self) -> &CameraSetup {
        &self.cameras[self.reference]
    }
    /// The rig of some of its cameras. Where the reference is not among them the first one kept takes its place;
    /// `None` where none is kept.
    pub fn only(&self, kept: impl Fn(&CameraSetup) -> bool) -> Option<Self> {
        let cameras: Vec<_> = self.cameras.iter().filter(|c| kept(c)).cloned().collect();
        let reference = self.cameras.get(self.reference).map(|c| &c.id);
        let reference = cameras.iter().position(|c| Some(&c.id) == reference).unwrap_or(0);
        let has = |id: &CameraId| cameras.iter().any(|c| c.id == *id);
        let measured = |d: &&DistanceMeasurement| has(&d.between.0) && has(&d.between.1);
        (!cameras.is_empty()).then(|| Self {
            site: self.site.clone(),
            reference,
            distances: self.distances.iter().filter(measured).cloned().collect(),
            cameras: cameras.clone(),
        })
    }
}
