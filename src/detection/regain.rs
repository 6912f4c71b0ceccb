//! A ball that is known by its track, sought where the track leads: in frames that the track lacks (just out of the hand, where
//! the first look saw ball and arm as one; before a bright edge; at the bat), and where something hides a part of it.

use nalgebra::Vector2;

use super::disc::Edge;
use super::fit::{FittedCentre, Picture, PictureStart, Shared, SharedMatrix, fit_centre};
use super::median::{SIGMA_OVER_MEDIAN, median};
use super::patches::{Patch, PatchPool};
use super::path::{Near, Place, place};
use super::refine::whole_covariance;
use super::view::View;
use crate::geometry::{Intrinsics, Pixel};
use crate::scene::{Track, TrackPoint};
use crate::time::StampedMidpoint;

/// A frame this unlike the ball has no centre.
const CHI2_MAX: f64 = 25.0;
/// What is added to a track is no further from where the path leads than so many σ of both, and so many pixels more.
const SIGMAS_MAX: f64 = 3.0;
const BEYOND_PX: f64 = 0.1;
/// ... but no further than so many radii.
const OFF_RADII_MAX: f64 = 0.75;
/// ... and the picture is no more unlike the ball than this.
const ADDED_CHI2_MAX: f64 = 6.0;
/// ... and the centre is as sure as this, pixels.
const SIGMA_MAX_PX: f64 = 0.25;
/// ... and the ball is no brighter or darker than its neighbours by more than this ratio (sun and shade).
const LEVEL_RATIO_MAX: f64 = 3.0;
/// A cut-out holds this share of the ball around its place at least: one around a lit or a dark cap is small.
const HELD_SHARE: f64 = 0.5;
/// Fewest centres that tell how far stamps are off.
const STAMPS_MIN: usize = 12;
/// Frames beyond an end in which the ball may be missed before it is given up.
const MISSES_MAX: usize = 12;

/// A ball as all frames of its track show it.
pub struct FittedBall {
    pub(super) exposure_s: f64,
    pub(super) lens: Option<Intrinsics>,
    pub(super) edge: Edge,
    pub(super) shared: Shared,
    pub(super) covariance: SharedMatrix,
    /// First and last stamp of the track.
    pub(super) span: (StampedMidpoint, StampedMidpoint),
    /// Share of the sphere's light at places in the track, by rising place.
    pub(super) shares: Vec<(f64, f64)>,
    /// In no order.
    pub(super) centres: Vec<(StampedMidpoint, FittedCentre)>,
    /// How far a stamp is off the exposure, 1σ, seconds, as the centres along the path say: 0 until frames are sought.
    pub(super) stamp_sigma_s: f64,
}

impl FittedBall {
    /// The centre in one frame.
    pub(super) fn centre(&self, picture: &mut Picture) -> Option<FittedCentre> {
        fit_centre(picture, &self.shared, &self.covariance, &self.edge).filter(|c| c.chi2 <= CHI2_MAX)
    }

    /// The centre in one frame, sought from where the path leads and in what is not hidden.
    pub(super) fn seek(
        &self,
        patch: &Patch<'_>,
        start: &PictureStart,
        place: &Place,
    ) -> Option<FittedCentre> {
        let picture = Picture::new(patch, start, &self.edge)?.lit(self.share(start.place));
        let mut shown = picture.shown(place.centre_px, place.level, (&self.shared, &self.edge))?;
        self.centre(&mut shown)
    }

    /// The share of the sphere's light at a place in the track: that of the nearest picture.
    fn share(&self, place: f64) -> f64 {
        let shares = self.shares.iter();
        let nearest = shares.min_by(|a, b| (a.0 - place).abs().total_cmp(&(b.0 - place).abs()));
        nearest.map_or(1.0, |(_, share)| *share)
    }

    /// Adds the ball to its track in frames that the track lacks, in gaps and beyond both ends as far as it is found; gives
    /// how often. A frame's cut-out and the path decide: what is not where the path leads is not added.
    pub fn regain(&mut self, cut_outs: &PatchPool, track: &mut Track) -> usize {
        let Some((first, last)) = track.span() else {
            return 0;
        };
        let before = track.points.len();
        self.centres
            .retain(|(stamped, _)| index_of(track, *stamped).is_ok());
        self.stamp_sigma_s = stamp_sigma_s(&self.centres);
        for frame in cut_outs.frames().filter(|(_, s)| (first..last).contains(s)) {
            self.add(cut_outs, track, frame);
        }
        self.follow(cut_outs, track, cut_outs.frames().filter(|(_, s)| *s > last));
        self.follow(
            cut_outs,
            track,
            cut_outs.frames().rev().filter(|(_, s)| *s < first),
        );
        track.points.len() - before
    }

    fn follow(
        &mut self,
        cut_outs: &PatchPool,
        track: &mut Track,
        frames: impl Iterator<Item = (u64, StampedMidpoint)>,
    ) {
        let mut misses = 0;
        for frame in frames {
            if !self.add(cut_outs, track, frame) {
                misses += 1;
                if misses > MISSES_MAX {
                    return;
                }
            }
        }
    }

    /// Whether the track now has this frame.
    fn add(
        &mut self,
        cut_outs: &PatchPool,
        track: &mut Track,
        (frame, stamped): (u64, StampedMidpoint),
    ) -> bool {
        let Err(index) = index_of(track, stamped) else {
            return true;
        };
        let Some(centre) = self.find(cut_outs, stamped) else {
            return false;
        };
        let point = TrackPoint {
            frame,
            stamped,
            pixel: Pixel::new(centre.centre_px.x, centre.centre_px.y),
            covariance_px2: Some(whole_covariance(&centre)),
        };
        track.points.insert(index, point);
        self.centres.push((stamped, centre));
        true
    }

    fn find(&self, cut_outs: &PatchPool, stamped: StampedMidpoint) -> Option<FittedCentre> {
        let place = place_by(&self.centres, stamped)?;
        let start = self.start(stamped, &place);
        let streak_px = start.streak_px.norm() * self.shared.streak_scale();
        let reach_px = start.radius_px + 0.5 * streak_px;
        let patch = cut_outs.around(stamped, place.centre_px, HELD_SHARE * reach_px)?;
        let found = self.seek(&patch, &start, &place)?;
        let variance = 0.5 * whole_covariance(&found).trace();
        let off_px = off_px(
            found.centre_px - place.centre_px,
            &place,
            (self.stamp_sigma_s, start.radius_px),
        );
        let bend_sigma_px = place.bend_sigma_px(start.radius_px);
        let sigma_px = (variance + place.sigma_px.powi(2) + bend_sigma_px.powi(2)).sqrt();
        let allowed_px = (SIGMAS_MAX * sigma_px + BEYOND_PX).min(OFF_RADII_MAX * start.radius_px);
        let ratio = found.level.max(place.level) / found.level.min(place.level).max(1e-9);
        tracing::trace!(
            stamped_ns = stamped.nanos(),
            ?place,
            ?found,
            off_px,
            allowed_px,
            "sought"
        );
        let sure = found.chi2 <= ADDED_CHI2_MAX && variance < SIGMA_MAX_PX.powi(2) && ratio < LEVEL_RATIO_MAX;
        (sure && off_px <= allowed_px).then_some(found)
    }

    fn start(&self, stamped: StampedMidpoint, place: &Place) -> PictureStart {
        let (begin, end) = (self.span.0.nanos(), self.span.1);
        let along = stamped.seconds_since(begin) / end.seconds_since(begin).max(1e-9) - 0.5;
        let at = Pixel::new(place.centre_px.x, place.centre_px.y);
        PictureStart {
            centre_px: place.centre_px,
            streak_px: place.velocity_px_per_s * self.exposure_s,
            radius_px: self.shared.radius_px(along),
            view: View::of(self.lens.as_ref(), at),
            place: along,
        }
    }
}

/// The index of this stamp's point in the track, or where it would be.
fn index_of(track: &Track, stamped: StampedMidpoint) -> Result<usize, usize> {
    track.points.binary_search_by_key(&stamped, |p| p.stamped)
}

/// Where the other centres of a track have the ball at a stamp.
fn place_by(centres: &[(StampedMidpoint, FittedCentre)], stamped: StampedMidpoint) -> Option<Place> {
    let others = centres.iter().filter(|(at, _)| *at != stamped);
    place(
        others
            .map(|(at, centre)| Near::new(stamped.nanos(), *at, centre))
            .collect(),
    )
}

/// How far stamps are off, 1σ, seconds: half of the centres are no further from the path of the others, along it.
fn stamp_sigma_s(centres: &[(StampedMidpoint, FittedCentre)]) -> f64 {
    let off_s = |(stamped, centre): &(StampedMidpoint, FittedCentre)| {
        let place = place_by(centres, *stamped)?;
        let speed = place.velocity_px_per_s.norm();
        let along_px = (centre.centre_px - place.centre_px).dot(&place.velocity_px_per_s) / speed.max(1e-9);
        let one_more = (1.0 + place.share_of_one).sqrt();
        (speed > 0.0).then(|| along_px.abs() / (speed * one_more))
    };
    let off_s: Vec<f64> = centres.iter().filter_map(off_s).collect();
    if off_s.len() < STAMPS_MIN {
        return 0.0;
    }
    SIGMA_OVER_MEDIAN * median(off_s).unwrap_or(0.0)
}

/// How far a centre is off its place, pixels, less what its stamp and those of the path may be off: along the path, and no more
/// than the share of the ball's radius that any centre may be off.
fn off_px(off: Vector2<f64>, place: &Place, (stamp_sigma_s, radius_px): (f64, f64)) -> f64 {
    let Some(ahead) = place.velocity_px_per_s.try_normalize(0.0) else {
        return off.norm();
    };
    let stamps_s = SIGMAS_MAX * stamp_sigma_s * (1.0 + place.share_of_one).sqrt();
    let stamps_px = (stamps_s * place.velocity_px_per_s.norm()).min(OFF_RADII_MAX * radius_px);
    let along = off.dot(&ahead);
    let beyond = (along.abs() - stamps_px).max(0.0);
    (off - ahead * along).norm().hypot(beyond)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Balls that go 12 px a frame and stamps off by so much in turn one way and the other, seconds.
    fn centres(stamp_off_s: f64) -> Vec<(StampedMidpoint, FittedCentre)> {
        let centre = |frame: i32| {
            let sign = [1.0, -1.0, -1.0, 1.0][frame as usize % 4];
            let t_s = f64::from(frame) / 175.0 + sign * stamp_off_s;
            let centre = FittedCentre {
                centre_px: Vector2::new(12.0 * f64::from(frame), 100.0),
                covariance_px2: nalgebra::Matrix2::identity() * 1e-4,
                chi2: 1.0,
                level: 90.0,
            };
            (StampedMidpoint::from_seconds_since(0, t_s), centre)
        };
        (0..60).map(centre).collect()
    }

    #[test]
    fn stamps_that_waver_are_told_by_the_path() {
        assert!(stamp_sigma_s(&centres(0.0)) < 1e-6);
        // All are off by 0.1 ms, and so the median is; as σ of a normal law 0.148 ms. The path, of ten, wavers a little too.
        let sigma_s = stamp_sigma_s(&centres(1e-4));
        assert!((1.1e-4..1.8e-4).contains(&sigma_s), "{sigma_s}");
        // Too few to tell.
        assert!(stamp_sigma_s(&centres(1e-4)[..STAMPS_MIN - 1]) < 1e-9);
    }

    #[test]
    fn a_centre_may_be_off_along_its_path_by_what_stamps_are_off() {
        let place = Place {
            centre_px: Vector2::zeros(),
            velocity_px_per_s: Vector2::new(0.0, 2000.0),
            level: 90.0,
            sigma_px: 0.06,
            share_of_one: 3.0,
            bend_s3: 0.0,
        };
        // 3 σ of 0.1 ms with those of a path as unsure as three centres: 3·1e-4·√(1 + 3)·2000 = 1.2 px along, nothing across.
        let off = |x: f64, y: f64| off_px(Vector2::new(x, y), &place, (1e-4, 4.0));
        assert!(off(0.0, 1.1) < 1e-12 && off(0.0, -1.1) < 1e-12);
        assert!((off(0.3, -1.6) - 0.5).abs() < 1e-12, "{}", off(0.3, -1.6));
        // No more than 0.75 radii.
        let wild = off_px(Vector2::new(0.0, 5.0), &place, (1.0, 4.0));
        assert!((wild - 2.0).abs() < 1e-12, "{wild}");
        // Exact stamps: any distance counts.
        assert!((off_px(Vector2::new(0.3, 0.4), &place, (0.0, 4.0)) - 0.5).abs() < 1e-12);
    }
}
