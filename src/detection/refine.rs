//! The second look at a whole track: velocity gives the streak, all frames together the ball, each frame its centre.

use nalgebra::{Matrix2, Vector2};

use super::config::DetectorConfig;
use super::disc::Edge;
use super::fit::{FittedCentre, Picture, PictureStart, Shared, fit_centre, fit_shared};
use super::patches::PatchPool;
use super::path::between;
use crate::geometry::Pixel;
use crate::scene::{Track, TrackPoint};

/// Blurs of the disc's edge that are tried (σ, pixels): pixel area alone to soft optics.
pub const EDGE_SIGMAS_PX: [f64; 5] = [0.3, 0.42, 0.55, 0.7, 0.9];
/// Points of a track that has a say in the blur.
const BLUR_POINTS_MIN: usize = 45;
/// ... and its costs do not differ by more than this from blur to blur (a ball: 1.3 to 1.8).
const BLUR_RATIO_MAX: f64 = 2.2;
/// Tracks on which all blurs are tried.
const BLUR_TRACKS: usize = 4;
/// Frames of a track on which the blur is chosen.
const TRIAL_FRAMES: usize = 20;
/// Gauss–Newton steps of a trial and of the fit.
const STEPS: (usize, usize) = (8, 14);
/// One of so many frames goes the first part of the way.
const PART: usize = 3;
/// Fewest cut-outs of a track.
const PICTURES_MIN: usize = 6;
/// Neighbours on each side that give a point's velocity.
const NEIGHBOURS: usize = 4;
/// Exposure where none is known, seconds, and how well.
const EXPOSURE_GUESS_S: (f64, f64) = (0.001, 1.0);
/// σ of the streak's scale where the exposure is known.
const STREAK_SCALE_SIGMA: f64 = 0.03;
/// The first look sees the lit part: the ball is larger by about this.
const RADIUS_OVER_FIRST_LOOK: f64 = 1.3;
/// What is left of light and blur in a centre, the same way for a whole track, pixels.
const SYSTEMATIC_PX: f64 = 0.03;
/// A centre further than this from the path of its neighbours is sought again.
const OFF_PATH_PX: f64 = 0.8;
/// A frame this unlike the ball keeps its centroid.
const CHI2_MAX: f64 = 25.0;

/// What the second look found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Refinement {
    /// Radius in the middle of the track, pixels.
    pub radius_px: f64,
    /// Radius at its begin and end, pixels.
    pub radius_ends_px: [f64; 2],
    /// Blur of the disc's edge, σ in pixels.
    pub edge_sigma_px: f64,
    /// Exposure that the streak shows, seconds.
    pub exposure_s: f64,
    /// Points with a fitted centre.
    pub fitted: usize,
    /// Points that kept their centroid.
    pub left: usize,
}

/// How well each blur has explained the tracks so far; the camera's optics do not change from pitch to pitch.
#[derive(Debug, Clone, Copy, Default)]
pub struct BlurChoice {
    costs: [f64; EDGE_SIGMAS_PX.len()],
    tracks: usize,
}

impl BlurChoice {
    /// Index of the likeliest blur tried.
    fn best(&self) -> usize {
        let costs = self.costs.iter().enumerate();
        costs.min_by(|a, b| a.1.total_cmp(b.1)).map_or(0, |(i, _)| i)
    }

    /// The likeliest blur: where a parabola through the best and its neighbours is lowest.
    fn sigma_px(&self) -> Option<f64> {
        let best = self.best();
        let middle = EDGE_SIGMAS_PX.get(best).copied()?;
        let side =
            |i: Option<usize>| i.and_then(|i| EDGE_SIGMAS_PX.get(i).copied().zip(self.costs.get(i).copied()));
        let (Some((low, cost_low)), Some((high, cost_high))) =
            (side(best.checked_sub(1)), side(Some(best + 1)))
        else {
            return Some(middle);
        };
        let cost = self.costs.get(best).copied()?;
        let (a, b) = (
            (middle - low) * (cost - cost_high),
            (middle - high) * (cost - cost_low),
        );
        let shift = 0.5 * ((middle - low) * a - (middle - high) * b) / (a - b);
        Some(if shift.is_finite() {
            (middle - shift).clamp(low, high)
        } else {
            middle
        })
    }

    /// Whether these costs are those of a ball: no blur explains it twice as well as another.
    fn plausible(costs: &[f64]) -> bool {
        let low = costs.iter().copied().fold(f64::INFINITY, f64::min);
        let high = costs.iter().copied().fold(0.0, f64::max);
        high < BLUR_RATIO_MAX * low
    }
}

/// The second look: replaces the centroids of a track of a detector's candidates by centres fitted to the cut-outs
/// that the detector has kept ([`super::Detector::cut_outs`]). It may be another thread's work.
#[derive(Debug, Clone)]
pub struct Refiner {
    exposure_s: Option<f64>,
    blur: BlurChoice,
}

impl Refiner {
    /// A refiner for the tracks of one camera's detector.
    pub fn new(config: &DetectorConfig) -> Self {
        Self {
            exposure_s: config.exposure_s,
            blur: BlurChoice::default(),
        }
    }

    /// Refines a track in place. Points whose cut-out is gone or does not look like the ball keep their centroid and
    /// its larger covariance. `None`: too few cut-outs, nothing changed.
    pub fn refine(&mut self, cut_outs: &PatchPool, track: &mut Track) -> Option<Refinement> {
        refine(cut_outs, self.exposure_s, &mut self.blur, track)
    }
}

fn refine(
    pool: &PatchPool,
    exposure_s: Option<f64>,
    blur: &mut BlurChoice,
    track: &mut Track,
) -> Option<Refinement> {
    let starts = starts(pool, exposure_s, track)?;
    let scale_sigma = if exposure_s.is_some() {
        STREAK_SCALE_SIGMA
    } else {
        EXPOSURE_GUESS_S.1
    };
    let radius = median(starts.iter().map(|(_, s)| s.radius_px))?;
    let first = Shared::start(radius, scale_sigma);
    let (edge, shared) = choose_edge(pool, track, &starts, &first, blur)?;

    // Again with the pixels that the ball of the found size reaches, from the found centres.
    let mut pictures = Vec::with_capacity(starts.len());
    for (index, start) in &starts {
        let point = track.points.get(*index)?;
        let better = PictureStart {
            radius_px: shared.radius_px(start.place),
            streak_px: start.streak_px,
            ..*start
        };
        let patch = pool.find(point.stamped, point.pixel)?;
        if let Some(picture) = Picture::new(&patch, &better, &edge) {
            pictures.push((*index, picture));
        }
    }
    let (indices, mut pictures): (Vec<usize>, Vec<Picture>) = pictures.into_iter().unzip();
    if pictures.len() < PICTURES_MIN {
        return None;
    }
    let mut shared = shared;
    shared.release_light();
    // Most of the way on a part of the frames: with all of them it is then two steps instead of ten.
    let mut part: Vec<Picture> = pictures.iter().step_by(PART).cloned().collect();
    if part.len() >= PICTURES_MIN {
        let mut nearer = shared;
        if fit_shared(&mut part, &mut nearer, &edge, STEPS.1).is_some() {
            shared.values = nearer.values;
        }
    }
    let (covariance, _) = fit_shared(&mut pictures, &mut shared, &edge, STEPS.1)?;
    let mut centres: Vec<Option<FittedCentre>> = vec![None; track.points.len()];
    for (index, picture) in indices.iter().zip(&mut pictures) {
        if let Some(slot) = centres.get_mut(*index) {
            *slot = fit_centre(picture, &shared, &covariance, &edge).filter(|c| c.chi2 <= CHI2_MAX);
        }
    }
    let path = centres.clone();
    for (index, start) in &starts {
        let Some(expected) = between(track, &path, *index) else {
            continue;
        };
        let Some(slot) = centres.get_mut(*index) else {
            continue;
        };
        if slot.is_some_and(|c| (c.centre_px - expected).norm() < OFF_PATH_PX) {
            continue;
        }
        // Where an arm or an edge drew the centroid away the fit began beside the ball: again from the path.
        let again = PictureStart {
            centre_px: expected,
            radius_px: shared.radius_px(start.place),
            ..*start
        };
        let point = track.points.get(*index)?;
        let picture = pool
            .find(point.stamped, point.pixel)
            .and_then(|patch| Picture::new(&patch, &again, &edge));
        let better = picture.and_then(|mut picture| fit_centre(&mut picture, &shared, &covariance, &edge));
        if let Some(better) =
            better.filter(|c| c.chi2 <= CHI2_MAX && (c.centre_px - expected).norm() < OFF_PATH_PX)
        {
            *slot = Some(better);
        }
    }
    let mut fitted = 0;
    for (point, centre) in track.points.iter_mut().zip(&centres) {
        if let Some(centre) = centre {
            point.pixel = Pixel::new(centre.centre_px.x, centre.centre_px.y);
            point.covariance_px2 = Some(centre.covariance_px2 + Matrix2::identity() * SYSTEMATIC_PX.powi(2));
            fitted += 1;
        }
    }
    Some(Refinement {
        radius_px: shared.radius_px(0.0),
        radius_ends_px: [shared.radius_px(-0.5), shared.radius_px(0.5)],
        edge_sigma_px: edge.sigma_px,
        exposure_s: exposure_s.unwrap_or(EXPOSURE_GUESS_S.0) * shared.values[2],
        fitted,
        left: track.points.len() - fitted,
    })
}

/// Where each point's fit begins, by its index in the track.
fn starts(pool: &PatchPool, exposure_s: Option<f64>, track: &Track) -> Option<Vec<(usize, PictureStart)>> {
    let (begin, end) = track.span()?;
    let epoch = begin.nanos();
    let span = end.seconds_since(epoch).max(1e-9);
    let exposure = exposure_s.unwrap_or(EXPOSURE_GUESS_S.0);
    let first_look = median(
        track
            .points
            .iter()
            .filter_map(|p| pool.find(p.stamped, p.pixel))
            .map(|patch| patch.radius_px),
    )?;
    let starts: Vec<(usize, PictureStart)> = track
        .points
        .iter()
        .enumerate()
        .filter(|(_, point)| pool.find(point.stamped, point.pixel).is_some())
        .map(|(index, point)| {
            let start = PictureStart {
                centre_px: point.pixel.vector(),
                streak_px: velocity(&track.points, index) * exposure,
                radius_px: first_look * RADIUS_OVER_FIRST_LOOK,
                place: point.stamped.seconds_since(epoch) / span - 0.5,
            };
            (index, start)
        })
        .collect();
    (starts.len() >= PICTURES_MIN).then_some(starts)
}

/// Velocity at one point from a straight line through its neighbours, pixels per second.
fn velocity(points: &[TrackPoint], index: usize) -> Vector2<f64> {
    let from = index.saturating_sub(NEIGHBOURS);
    let near = points
        .get(from..(index + NEIGHBOURS + 1).min(points.len()))
        .unwrap_or(&[]);
    let Some(epoch) = near.first().map(|p| p.stamped.nanos()) else {
        return Vector2::zeros();
    };
    let count = near.len() as f64;
    let times: Vec<f64> = near.iter().map(|p| p.stamped.seconds_since(epoch)).collect();
    let mean_t = times.iter().sum::<f64>() / count;
    let mean = near.iter().map(|p| p.pixel.vector()).sum::<Vector2<f64>>() / count;
    let mut sum = Vector2::zeros();
    let mut squares = 0.0;
    for (t, p) in times.iter().zip(near) {
        sum += (p.pixel.vector() - mean) * (t - mean_t);
        squares += (t - mean_t) * (t - mean_t);
    }
    sum / f64::max(squares, 1e-12)
}

/// Fits a few frames with every blur (later only with the best) and keeps the likeliest over all tracks.
fn choose_edge(
    pool: &PatchPool,
    track: &Track,
    starts: &[(usize, PictureStart)],
    first: &Shared,
    blur: &mut BlurChoice,
) -> Option<(Edge, Shared)> {
    let step = starts.len().div_ceil(TRIAL_FRAMES).max(1);
    let selector = Edge::new(EDGE_SIGMAS_PX.last().copied().unwrap_or(1.0));
    let settled = blur.tracks >= BLUR_TRACKS;
    let mut found: [Option<(f64, Shared)>; EDGE_SIGMAS_PX.len()] = Default::default();
    for (index, sigma_px) in EDGE_SIGMAS_PX.iter().enumerate() {
        if settled && index != blur.best() {
            continue;
        }
        // The same pixels for every blur, or their costs could not be compared.
        let mut pictures: Vec<Picture> = starts
            .iter()
            .step_by(step)
            .filter_map(|(index, start)| {
                let point = track.points.get(*index)?;
                Picture::new(&pool.find(point.stamped, point.pixel)?, start, &selector)
            })
            .collect();
        if pictures.len() < PICTURES_MIN {
            return None;
        }
        let edge = Edge::new(*sigma_px);
        let mut shared = *first;
        if fit_shared(&mut pictures, &mut shared, &edge, STEPS.0).is_none() {
            continue;
        }
        // Held to the sphere alone the light would be matched by a wrong blur.
        let held = shared;
        // What the light then makes of it only compares the blurs.
        let compared = (!settled).then(|| {
            shared.release_light();
            fit_shared(&mut pictures, &mut shared, &edge, STEPS.0).map(|(_, cost)| cost)
        });
        if let (Some(cost), Some(slot)) = (compared.unwrap_or(Some(0.0)), found.get_mut(index)) {
            *slot = Some((cost, held));
        }
    }
    let mut total = *blur;
    if !settled && found.iter().all(Option::is_some) {
        for (sum, cost) in total.costs.iter_mut().zip(found.iter().flatten()) {
            *sum += cost.0;
        }
        total.tracks += 1;
        // Only a long track is surely a ball.
        let own: Vec<f64> = found.iter().flatten().map(|f| f.0).collect();
        if starts.len() >= BLUR_POINTS_MIN && BlurChoice::plausible(&own) {
            *blur = total;
        }
    }
    let best = total.best();
    let (_, shared) = found.get(best).copied().flatten()?;
    Some((Edge::new(total.sigma_px()?), shared))
}

fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}
