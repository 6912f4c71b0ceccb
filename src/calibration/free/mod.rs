//! `motion = "free"`: anything bright that moves smoothly calibrates the rig.
//!
//! One robust maximum-likelihood problem over poses, delays, clock skews, rolling-shutter readouts and one
//! cubic B-spline of the motion, every sighting at its own true exposure midpoint. What it starts from:
//!
//! ```text
//! paths ─► pairs (offset search × five-point) ─► seed ─► camera by camera ─► all together, finer ─► answer
//! ```

mod agreement;
mod arrow;
mod finish;
mod grow;
mod outcome;
mod pace;
mod pair;
mod path;
mod problem;
mod resect;
mod solver;
mod spline;
mod support;
#[cfg(test)]
mod synthetic;
#[cfg(test)]
mod tests;
mod view;

use nalgebra::Vector2;

use super::CalibrationError;
use crate::scene::{Calibration, CameraId, Rig, Track};
use finish::finish;
use grow::{Edge, Grown, Session};
use pace::Pace;
use path::Path;
use problem::Distance;
use view::{Sighting, View};

/// What the estimator of a free motion takes for granted.
#[derive(Debug, Clone)]
pub struct FreeOptions {
    /// Offsets are searched this far about the rough ones, seconds.
    pub shift_range_s: f64,
    /// The same for cameras that do not fit within that, seconds.
    pub shift_range_widest_s: f64,
    /// Step of that search, seconds.
    pub shift_step_s: f64,
    /// Five-point samples at every offset.
    pub five_point_samples: usize,
    /// Knot spacing of the motion, seconds; `None`: from the data.
    pub knot_s: Option<f64>,
    /// 1σ of the clocks' rate errors, ppm.
    pub skew_sigma_ppm: f64,
    /// Mean of an unknown rolling-shutter readout, seconds.
    pub readout_mean_s: f64,
    /// 1σ of it, seconds.
    pub readout_sigma_s: f64,
    /// How well the rig's lenses are known: what is left of a good board calibration.
    pub lens: LensSigma,
    /// Degrees of freedom of Student's t of the detections' errors.
    pub tail: f64,
    /// Smallest share of every camera's sightings (while two cameras see) that one motion must explain.
    pub explained_share_min: f64,
    /// Seed of the random samples.
    pub seed: u64,
}

/// 1σ of what a lens calibration leaves; 0 holds the value as it stands in the rig.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LensSigma {
    /// Focal length, relative; a camera's own `focal_sigma_relative` goes before it.
    pub focal_relative: f64,
    /// Principal point, pixels per axis.
    pub principal_px: f64,
    /// k1 and k2.
    pub radial: f64,
}

impl Default for FreeOptions {
    fn default() -> Self {
        Self {
            shift_range_s: 2.0,
            shift_range_widest_s: 40.0,
            shift_step_s: 0.2,
            five_point_samples: 25,
            knot_s: None,
            skew_sigma_ppm: 5000.0,
            readout_mean_s: 0.015,
            readout_sigma_s: 0.01,
            lens: LensSigma {
                focal_relative: 0.005,
                principal_px: 0.0,
                radial: 0.0,
            },
            tail: 4.0,
            explained_share_min: 0.5,
            seed: 1,
        }
    }
}

/// A point of the motion (`trajectory.csv`).
#[derive(Debug, Clone, PartialEq)]
pub struct TrajectorySample {
    /// Reference camera's true time, nanoseconds.
    pub time_ns: i64,
    /// World "reference_camera": metres where a distance fixes the scale, else first baselines.
    pub position_m: [f64; 3],
    /// 1σ per axis, in the same units.
    pub sigma_m: [f64; 3],
    /// Cameras that see it at that time.
    pub cameras: usize,
}

/// How well one camera fits.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraFit {
    /// Whose.
    pub camera: CameraId,
    /// Sightings while two cameras see, within five sigma.
    pub kept: usize,
    /// The others of them.
    pub outliers: usize,
}

/// What the estimate came to.
#[derive(Debug, Clone)]
pub struct FreeOutcome {
    /// Poses, delays, skews, readouts and their covariance; world "reference_camera".
    pub calibration: Calibration,
    /// The motion at the reference camera's frames while at least two cameras see it.
    pub trajectory: Vec<TrajectorySample>,
    /// Fit of every calibrated camera.
    pub cameras: Vec<CameraFit>,
    /// Seconds during which at least two calibrated cameras see the thing.
    pub shared_s: f64,
    /// Share of the sightings during that time which the motion explains, of the camera that fits worst.
    pub explained_share: f64,
}

/// Fewest sightings with which a camera takes part.
const FEWEST_SIGHTINGS: usize = 50;
/// Seeds tried where the first leaves doubt.
const SEEDS: usize = 6;

/// Calibrates a rig from the 2-D tracks of one thing that moves smoothly.
///
/// `rig.cameras[..].time_offset_s` are rough (to about `shift_range_s`). Answers in the reference camera's
/// axes and clock.
///
/// # Errors
/// Typed, with numbers: too few cameras with tracks, no pair with a relative pose, the reference camera
/// unconnected, or a motion that explains too few of the sightings.
pub fn calibrate(
    rig: &Rig,
    tracks: &[Track],
    options: &FreeOptions,
) -> Result<FreeOutcome, CalibrationError> {
    // 1. Sightings of every camera, and their smooth paths for the search.
    let mut gathered = gather(rig, tracks, options)?;
    let reference = gathered.reference;
    // 2., 3. A rig from the rough offsets, and with the cameras that they do not place from anywhere near.
    let mut grown =
        grow_widely(&mut gathered.session, reference)?.ok_or_else(|| CalibrationError::NoCommonMotion {
            camera: rig.reference_camera().id.clone(),
            explained_share: 0.0,
        })?;
    let session = &gathered.session;
    // 4. Everything together, in the reference camera's world and clock; without the cameras that do not fit.
    loop {
        let solution = finish(session, &grown, (reference, &gathered.distances))?;
        let Some((worst, explained_share)) = session.explained(&solution.state).least() else {
            return Err(CalibrationError::NoTracks);
        };
        if explained_share >= options.explained_share_min {
            // 5. The answer.
            return Ok(outcome::outcome(rig, &gathered, &solution));
        }
        let remaining = grown.state.cameras.iter().flatten().count();
        if worst == reference || remaining < 3 {
            return Err(CalibrationError::NoCommonMotion {
                camera: rig.cameras[gathered.in_rig[worst]].id.clone(),
                explained_share,
            });
        }
        grown.state.cameras[worst] = None;
    }
}

/// Relative pose and offset of every pair of cameras, and a rig grown from them. Where the rough offsets lead
/// nowhere, or leave cameras out, once more with offsets that may be as far off as a person errs.
fn grow_widely(session: &mut Session, reference: usize) -> Result<Option<Grown>, CalibrationError> {
    let edges = session.edges()?;
    let near = best_grown(session, &edges, reference)?;
    let whole = |g: &Grown| g.state.cameras.iter().all(Option::is_some);
    if near.as_ref().is_some_and(whole) || session.range_s >= session.options.shift_range_widest_s {
        return Ok(near);
    }
    session.range_s = session.options.shift_range_widest_s;
    match near {
        Some(grown) => session.extended(grown, &edges).map(Some),
        None => {
            let edges = session.edges()?;
            best_grown(session, &edges, reference)
        }
    }
}

/// Grows a rig from the best pair, from others where that leaves doubt.
fn best_grown(
    session: &Session,
    edges: &[Edge],
    reference: usize,
) -> Result<Option<Grown>, CalibrationError> {
    let mut best: Option<Grown> = None;
    for seed in edges.iter().take(SEEDS) {
        let Some(grown) = session.grow(seed, edges)? else {
            continue;
        };
        let connected = grown.state.cameras[reference].is_some();
        let sure = connected
            && grown.state.cameras.iter().all(Option::is_some)
            && grown.explained.least().is_some_and(|(_, share)| share > 0.7);
        if connected
            && best
                .as_ref()
                .is_none_or(|b| grown.explained.sightings > b.explained.sightings)
        {
            best = Some(grown);
        }
        if sure {
            break;
        }
    }
    Ok(best)
}

/// What the stages work on, with the way back to the rig.
struct Gathered {
    session: Session,
    /// How the session's time runs.
    pace: Pace,
    /// Index in the rig of every view.
    in_rig: Vec<usize>,
    /// Index of the reference camera among the views.
    reference: usize,
    distances: Vec<Distance>,
    epoch_ns: i64,
    warnings: Vec<String>,
}

fn gather(rig: &Rig, tracks: &[Track], options: &FreeOptions) -> Result<Gathered, CalibrationError> {
    let epoch_ns = tracks
        .iter()
        .filter(|t| t.camera == rig.reference_camera().id)
        .filter_map(|t| t.points.first().map(|p| p.stamped.nanos()))
        .min()
        .ok_or(CalibrationError::NoTracks)?;
    let pace = Pace::of(tracks, epoch_ns);
    let options = pace.options(options);
    let mut session = Session {
        views: vec![],
        paths: vec![],
        offsets_s: vec![],
        shutters: vec![],
        focal_sigma: vec![],
        range_s: options.shift_range_s,
        options,
    };
    let (mut in_rig, mut warnings) = (vec![], vec![]);
    for (index, setup) in rig.cameras.iter().enumerate() {
        let mut sightings: Vec<Sighting> = tracks
            .iter()
            .filter(|t| t.camera == setup.id)
            .flat_map(|t| &t.points)
            .map(|p| Sighting {
                stamped_s: pace.0 * p.stamped.seconds_since(epoch_ns),
                pixel_px: Vector2::new(p.pixel.x, p.pixel.y),
                sigma_px: p
                    .covariance_px2
                    .map_or(1.0, |c| (0.5 * c.trace()).sqrt())
                    .max(1e-3),
            })
            .filter(|s| s.pixel_px.iter().all(|v| v.is_finite()))
            .collect();
        sightings.sort_by(|a, b| a.stamped_s.total_cmp(&b.stamped_s));
        if sightings.len() < FEWEST_SIGHTINGS {
            warnings.push(format!(
                "camera {}: {} points, left out",
                setup.id,
                sightings.len()
            ));
            continue;
        }
        let view = View {
            epoch_s: sightings[sightings.len() / 2].stamped_s,
            sightings,
            height_px: f64::from(setup.height_px.max(1)),
            lens: setup.intrinsics,
        };
        let offset_s = pace.0 * setup.time_offset_s.unwrap_or(0.0);
        session.paths.push(Path::new(&view, offset_s));
        session.views.push(view);
        session.offsets_s.push(offset_s);
        session.shutters.push(pace.shutter(setup.rolling_shutter));
        session.focal_sigma.push(match setup.focal_sigma_relative {
            given if given > 0.0 => given,
            _ => session.options.lens.focal_relative,
        });
        in_rig.push(index);
    }
    let reference =
        in_rig
            .iter()
            .position(|&k| k == rig.reference)
            .ok_or_else(|| CalibrationError::NoCommonMotion {
                camera: rig.reference_camera().id.clone(),
                explained_share: 0.0,
            })?;
    if in_rig.len() < 2 {
        return Err(CalibrationError::OneCamera {
            camera: rig.reference_camera().id.clone(),
        });
    }
    let distances = distances(rig, &in_rig);
    Ok(Gathered {
        session,
        pace,
        in_rig,
        reference,
        distances,
        epoch_ns,
        warnings,
    })
}

/// Measured distances, and those between surveyed positions.
fn distances(rig: &Rig, in_rig: &[usize]) -> Vec<Distance> {
    let at = |id: &CameraId| in_rig.iter().position(|&k| rig.cameras[k].id == *id);
    let mut found: Vec<Distance> = rig
        .distances
        .iter()
        .filter_map(|d| {
            Some(Distance {
                cameras: (at(&d.between.0)?, at(&d.between.1)?),
                distance: d.distance_m,
                sigma: d.sigma_m.max(1e-6 * d.distance_m),
            })
        })
        .collect();
    for (a, &in_a) in in_rig.iter().enumerate() {
        for (b, &in_b) in in_rig.iter().enumerate().skip(a + 1) {
            if let (Some(pa), Some(pb)) = (rig.cameras[in_a].position, rig.cameras[in_b].position) {
                let distance = (pa.0 - pb.0).norm();
                found.push(Distance {
                    cameras: (a, b),
                    distance,
                    sigma: pa.1.hypot(pb.1).max(1e-6 * distance),
                });
            }
        }
    }
    found.retain(|d| d.distance > 0.0);
    found
}
