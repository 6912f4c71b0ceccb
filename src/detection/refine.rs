//! The second look at a whole track: velocity gives the streak, all frames together the ball, each frame its centre.

use nalgebra::{Matrix2, Vector2};

use super::disc::Edge;
use super::fit::{Picture, PictureStart, Shared, fit_centre, fit_shared};
use super::patches::PatchPool;
use crate::geometry::Pixel;
use crate::scene::{Track, TrackPoint};

/// Blurs of the disc's edge that are tried (σ, pixels): pixel area alone to soft optics.
const EDGE_SIGMAS_PX: [f64; 4] = [0.3, 0.42, 0.6, 0.85];
/// Frames on which the blur is chosen.
const TRIAL_FRAMES: usize = 20;
/// Gauss–Newton steps of a trial and of the fit.
const STEPS: (usize, usize) = (8, 14);
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

/// Refines a track in place.
pub fn refine(
    pool: &PatchPool,
    exposure_s: Option<f64>,
    edge_sigma_px: Option<f64>,
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
    let (edge, shared) = choose_edge(pool, track, &starts, &first, edge_sigma_px)?;

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
    let (covariance, _) = fit_shared(&mut pictures, &mut shared, &edge, STEPS.1)?;
    let mut fitted = 0;
    for (index, picture) in indices.iter().zip(&mut pictures) {
        let Some(centre) = fit_centre(picture, &shared, &covariance, &edge) else {
            continue;
        };
        if centre.chi2 > CHI2_MAX {
            continue;
        }
        if let Some(point) = track.points.get_mut(*index) {
            point.pixel = Pixel::new(centre.centre_px.x, centre.centre_px.y);
            point.covariance_px2 = Some(centre.covariance_px2 + Matrix2::identity() * 1e-4);
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

/// Fits a few frames with every blur (or the one found before) and keeps the likeliest.
fn choose_edge(
    pool: &PatchPool,
    track: &Track,
    starts: &[(usize, PictureStart)],
    first: &Shared,
    known_sigma_px: Option<f64>,
) -> Option<(Edge, Shared)> {
    let step = starts.len().div_ceil(TRIAL_FRAMES).max(1);
    let widest = EDGE_SIGMAS_PX.last().copied().unwrap_or(1.0);
    let selector = Edge::new(widest);
    let known = known_sigma_px.as_slice();
    let tried: &[f64] = if known.is_empty() { &EDGE_SIGMAS_PX } else { known };
    let mut best: Option<(f64, Edge, Shared)> = None;
    for sigma_px in tried {
        // The same pixels for every blur, or their costs could not be compared.
        let mut pictures: Vec<Picture> = starts
            .iter()
            .step_by(step)
            .filter_map(|(index, start)| {
                let point = track.points.get(*index)?;
                Picture::new(&pool.find(point.stamped, point.pixel)?, start, &selector)
            })
            .collect();
        if pictures.len() < PICTURES_MIN.min(starts.len()) {
            return None;
        }
        let edge = Edge::new(*sigma_px);
        let mut shared = *first;
        if let Some((_, cost)) = fit_shared(&mut pictures, &mut shared, &edge, STEPS.0)
            && best.as_ref().is_none_or(|b| cost < b.0)
        {
            best = Some((cost, edge, shared));
        }
    }
    best.map(|(_, edge, shared)| (edge, shared))
}

fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}
