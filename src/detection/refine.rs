//! The second look at a whole track: velocity gives the streak, all frames together the ball, each frame its centre.

use nalgebra::{Matrix2, Vector2};

use super::blur::{BlurChoice, BlurCosts, EDGE_SIGMAS_PX, choose_edge};
use super::config::DetectorConfig;
use super::disc::Edge;
use super::fit::{FittedCentre, Picture, PictureStart, Shared, SharedMatrix, fit_shared, fit_shares};
use super::median::median;
use super::patches::PatchPool;
use super::path::between;
use super::regain::FittedBall;
use super::running::Running;
use super::view::View;
use crate::geometry::{Intrinsics, Pixel};
use crate::scene::{Track, TrackPoint};
use crate::time::StampedMidpoint;

/// Frames of a track on which blur and ball are tried.
const TRIAL_FRAMES: usize = 12;
/// Gauss–Newton steps of the fit.
const STEPS: usize = 14;
/// One of so many frames goes the first part of the way.
const PART: usize = 3;
/// Fewest cut-outs of a track.
const PICTURES_MIN: usize = 6;
/// Neighbours on each side that give a point's velocity.
const NEIGHBOURS: usize = 4;
/// Exposure where none is known, seconds, and how well.
const EXPOSURE_GUESS_S: (f64, f64) = (0.001, 1.0);
/// σ of the streak's scale where the exposure is known.
const STREAK_SCALE_SIGMA: f64 = 0.015;
/// The first look sees the lit part: the ball is larger by about this.
const RADIUS_OVER_FIRST_LOOK: f64 = 1.3;
/// What is left of light and blur in a centre, the same way for a whole track, pixels.
const SYSTEMATIC_PX: f64 = 0.015;
/// Where no centre was found, one is taken that is no further than this from the path of its neighbours.
const OFF_PATH_PX: f64 = 0.8;
/// ... and one that is nearer, in a picture no more unlike the ball than this, is right.
const NEAR_PATH_PX: f64 = 0.25;
const LIKE_CHI2: f64 = 3.0;
/// Balls in flight whose fits are kept to be gone on with.
const RUNNING_MAX: usize = 3;

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

/// A refined track, and what it teaches.
pub struct Refined {
    /// What was found.
    pub refinement: Refinement,
    /// For [`Refiner::learn`], if it is a ball.
    pub blur: Option<BlurCosts>,
    /// The ball as it looks in this camera, to find it in the frames that its track lacks.
    pub ball: FittedBall,
}

/// A ball's radius at two instants, by the flight that several cameras have seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KnownSize(
    /// Stamp, and radius as on the lens's axis, pixels.
    pub [(StampedMidpoint, f64); 2],
);

impl KnownSize {
    /// Radius in the middle of a track's span, and its growth; 1/r is linear, as depth is.
    fn over(&self, track: &Track) -> Option<(f64, f64)> {
        let (begin, end) = track.span()?;
        let span_s = end.seconds_since(begin.nanos());
        let [(u, by_one), (v, by_other)] = self
            .0
            .map(|(at, radius_px)| (at.seconds_since(begin.nanos()) / span_s - 0.5, 1.0 / radius_px));
        let slope = (by_other - by_one) / (v - u);
        let middle = by_one - slope * u;
        (middle > 0.0 && slope.is_finite()).then_some((1.0 / middle, slope / middle))
    }
}

/// The second look: replaces the centroids of a track of a detector's candidates by centres fitted to the cut-outs
/// that the detector has kept ([`super::Detector::cut_outs`]). It may be another thread's work.
///
/// A ball can be looked at while it flies ([`Self::look_ahead`]): most of the work is then done when it has landed.
#[derive(Debug, Clone)]
pub struct Refiner {
    exposure_s: Option<f64>,
    lens: Option<Intrinsics>,
    blur: BlurChoice,
    running: Vec<Running>,
}

impl Refiner {
    /// A refiner for the tracks of one camera's detector.
    pub fn new(config: &DetectorConfig) -> Self {
        Self {
            exposure_s: config.exposure_s,
            lens: config.lens,
            blur: BlurChoice::default(),
            running: Vec::new(),
        }
    }

    /// Refines a track in place. Points whose cut-out is gone or does not look like the ball keep their centroid and
    /// its larger covariance. `None`: too few cut-outs, nothing changed.
    pub fn refine(
        &self,
        cut_outs: &PatchPool,
        track: &mut Track,
        size: Option<&KnownSize>,
    ) -> Option<Refined> {
        // At its end nobody waits for a comparison of blurs, if one is known.
        let teaches = if self.blur.is_known() {
            0
        } else {
            track.points.len()
        };
        let fit = self.fit(cut_outs, (track, teaches), size)?;
        let span = track.span()?;
        let Fit {
            starts,
            indices,
            mut pictures,
            shared,
            edge,
            covariance,
            blur,
        } = fit;
        let mut ball = FittedBall {
            stamp_sigma_s: 0.0,
            exposure_s: self.exposure_s.unwrap_or(EXPOSURE_GUESS_S.0),
            lens: self.lens,
            edge,
            shared,
            covariance,
            span,
            shares: pictures.iter().map(Picture::share).collect(),
            centres: Vec::new(),
        };
        let mut centres: Vec<Option<FittedCentre>> = vec![None; track.points.len()];
        for (index, picture) in indices.iter().zip(&mut pictures) {
            if let Some(slot) = centres.get_mut(*index) {
                *slot = ball.centre(picture);
            }
        }
        let path = centres.clone();
        for (index, start) in &starts {
            let (Some(place), Some(slot)) = (between(track, &path, *index), centres.get_mut(*index)) else {
                continue;
            };
            let off_path_px = |c: &FittedCentre| (c.centre_px - place.centre_px).norm();
            let now_off_px = slot.as_ref().map_or(OFF_PATH_PX, off_path_px);
            if slot.is_some_and(|c| now_off_px < NEAR_PATH_PX && c.chi2 < LIKE_CHI2) {
                continue;
            }
            // Where an arm or an edge drew the centroid away the fit began beside the ball, and where a wire hides a
            // part of it the rest drew it: again from the path.
            let again = PictureStart {
                centre_px: place.centre_px,
                radius_px: shared.radius_px(start.place),
                ..*start
            };
            let point = track.points.get(*index)?;
            let patch = cut_outs.find(point.stamped, point.pixel);
            let better = patch.and_then(|patch| ball.seek(&patch, &again, &place));
            *slot = better.filter(|c| off_path_px(c) < now_off_px).or(*slot);
        }
        let mut fitted = 0;
        for (point, centre) in track.points.iter_mut().zip(&centres) {
            if let Some(centre) = centre {
                point.pixel = Pixel::new(centre.centre_px.x, centre.centre_px.y);
                point.covariance_px2 = Some(whole_covariance(centre));
                ball.centres.push((point.stamped, *centre));
                fitted += 1;
            }
        }
        let refinement = Refinement {
            radius_px: shared.radius_px(0.0),
            radius_ends_px: [shared.radius_px(-0.5), shared.radius_px(0.5)],
            edge_sigma_px: edge.sigma_px,
            exposure_s: ball.exposure_s * shared.values[2],
            fitted,
            left: track.points.len() - fitted,
        };
        Some(Refined {
            refinement,
            blur,
            ball,
        })
    }

    /// Takes what a ball has taught of the blur.
    pub fn learn(&mut self, blur: &BlurCosts) {
        self.blur.learn(blur);
    }

    /// Fits a ball that still flies, so that [`Self::refine`] goes on from there; whether it could be fitted.
    pub fn look_ahead(&mut self, cut_outs: &PatchPool, track: &Track, size: Option<&KnownSize>) -> bool {
        let Some(fit) = self.fit(cut_outs, (track, track.points.len()), size) else {
            return false;
        };
        let Some(running) = Running::new(
            track,
            &fit.indices,
            fit.pictures,
            (&fit.edge, &fit.shared, fit.blur),
        ) else {
            return false;
        };
        self.running.retain(|older| !older.is_of(track));
        if self.running.len() >= RUNNING_MAX {
            self.running.remove(0);
        }
        self.running.push(running);
        true
    }

    /// Whether this track's ball was looked at while it flew.
    pub fn knows(&self, track: &Track) -> bool {
        self.running.iter().any(|running| running.is_of(track))
    }

    /// Ball and pictures of a track that teaches the blur by so many points.
    fn fit(
        &self,
        pool: &PatchPool,
        (track, teaches): (&Track, usize),
        size: Option<&KnownSize>,
    ) -> Option<Fit> {
        let starts = self.starts(pool, track)?;
        let size = size.and_then(|size| size.over(track));
        let running = self.running.iter().find(|running| running.is_of(track));
        let (edge, mut shared, blur) = match running {
            Some(running) => running.ball(track)?,
            None => self.first_fit((pool, track, teaches), &starts, size)?,
        };
        if let Some((radius_px, growth)) = size {
            shared.know_size(radius_px, growth);
        }
        // The pixels that the ball of the found size reaches.
        let (mut indices, mut pictures) = (Vec::new(), Vec::new());
        let mut share = 1.0;
        for (index, start) in &starts {
            let point = track.points.get(*index)?;
            let better = PictureStart {
                radius_px: shared.radius_px(start.place),
                ..*start
            };
            let known = running.and_then(|running| running.picture(point, &better, &edge));
            let patch = pool.find(point.stamped, point.pixel)?;
            // In the light of the picture before, until it is known better.
            let new = || Some(Picture::new(&patch, &better, &edge)?.lit(share));
            if let Some(picture) = known.or_else(new) {
                (_, share) = picture.share();
                indices.push(*index);
                pictures.push(picture);
            }
        }
        if pictures.len() < PICTURES_MIN {
            return None;
        }
        shared.release_light();
        if running.is_none() {
            // Most of the way on a part of the frames: with all of them it is then two steps instead of ten.
            let mut part: Vec<Picture> = pictures.iter().step_by(PART).cloned().collect();
            if part.len() >= PICTURES_MIN {
                let mut nearer = shared;
                if fit_shared(&mut part, &mut nearer, &edge, STEPS).is_some() {
                    shared.values = nearer.values;
                }
            }
        }
        let (mut covariance, _) = fit_shared(&mut pictures, &mut shared, &edge, STEPS)?;
        if let Some(shaded) = fit_shares(&pictures, &shared, &edge, STEPS) {
            (pictures, shared, covariance) = shaded;
        }
        Some(Fit {
            starts,
            indices,
            pictures,
            shared,
            edge,
            covariance,
            blur,
        })
    }

    /// Where each point's fit begins, by its index in the track.
    fn starts(&self, pool: &PatchPool, track: &Track) -> Option<Vec<(usize, PictureStart)>> {
        let (begin, end) = track.span()?;
        let epoch = begin.nanos();
        let span = end.seconds_since(epoch).max(1e-9);
        let exposure = self.exposure_s.unwrap_or(EXPOSURE_GUESS_S.0);
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
                    view: View::of(self.lens.as_ref(), point.pixel),
                    place: point.stamped.seconds_since(epoch) / span - 0.5,
                };
                (index, start)
            })
            .collect();
        (starts.len() >= PICTURES_MIN).then_some(starts)
    }

    /// Blur and ball from a few frames.
    fn first_fit(
        &self,
        (pool, track, teaches): (&PatchPool, &Track, usize),
        starts: &[(usize, PictureStart)],
        size: Option<(f64, f64)>,
    ) -> Option<(Edge, Shared, Option<BlurCosts>)> {
        let scale_sigma = if self.exposure_s.is_some() {
            STREAK_SCALE_SIGMA
        } else {
            EXPOSURE_GUESS_S.1
        };
        let radius = median(starts.iter().map(|(_, s)| s.radius_px))?;
        let mut first = Shared::start(radius, scale_sigma, self.lens.is_some());
        if let Some((radius_px, growth)) = size {
            first.know_size(radius_px, growth);
            (first.values[0], first.values[1]) = (radius_px, growth);
        }
        let step = starts.len().div_ceil(TRIAL_FRAMES).max(1);
        let widest = Edge::new(EDGE_SIGMAS_PX.last().copied().unwrap_or(1.0));
        let trial = starts.iter().step_by(step).filter_map(|(index, start)| {
            let point = track.points.get(*index)?;
            Picture::new(&pool.find(point.stamped, point.pixel)?, start, &widest)
        });
        let trial: Vec<Picture> = trial.collect();
        if trial.len() < PICTURES_MIN {
            return None;
        }
        choose_edge(trial, &first, teaches.min(starts.len()), &self.blur)
    }
}

/// The covariance of a fitted centre with what light and blur leave in it, px².
pub fn whole_covariance(centre: &FittedCentre) -> Matrix2<f64> {
    centre.covariance_px2 + Matrix2::identity() * SYSTEMATIC_PX.powi(2)
}

/// Ball and pictures of a track, fitted together.
struct Fit {
    starts: Vec<(usize, PictureStart)>,
    /// Which point of the track each picture is of.
    indices: Vec<usize>,
    pictures: Vec<Picture>,
    shared: Shared,
    edge: Edge,
    covariance: SharedMatrix,
    blur: Option<BlurCosts>,
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::CameraId;

    #[test]
    fn a_radius_known_at_two_instants_is_known_over_the_track() {
        let stamped = |ms: i64| StampedMidpoint::from_nanos(1_000_000 * ms);
        let point = |ms: i64| TrackPoint {
            frame: ms as u64,
            stamped: stamped(ms),
            pixel: Pixel::new(0.0, 0.0),
            covariance_px2: None,
        };
        let track = Track {
            camera: CameraId::new("a").unwrap(),
            track: 0,
            points: vec![point(100), point(200), point(500)],
        };
        // 1/r from 1/2 at 200 ms to 1/4 at 400 ms: 3/8 in the middle at 300 ms, and by 1/2 less over the 400 ms of the track.
        let (radius_px, growth) = KnownSize([(stamped(200), 2.0), (stamped(400), 4.0)])
            .over(&track)
            .unwrap();
        assert!((radius_px - 8.0 / 3.0).abs() < 1e-12, "{radius_px}");
        assert!((growth + 0.5 / 0.375).abs() < 1e-12, "{growth}");
        let mut shared = Shared::start(3.0, 1.0, true);
        shared.values[0] = radius_px;
        shared.values[1] = growth;
        assert!((shared.radius_px(0.25) - 4.0).abs() < 1e-12);
        assert_eq!(KnownSize([(stamped(200), 2.0); 2]).over(&track), None);
    }
}
