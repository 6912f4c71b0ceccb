//! A ball that is known by its track, sought where the track leads: in frames that the track lacks (just out of the hand, where
//! the first look saw ball and arm as one; before a bright edge; at the bat), and where something hides a part of it.

use super::disc::Edge;
use super::fit::{FittedCentre, Picture, PictureStart, Shared, SharedMatrix, fit_centre};
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
        let near = self.centres.iter();
        let place = place(
            near.map(|(at, centre)| Near::new(stamped.nanos(), *at, centre))
                .collect(),
        )?;
        let start = self.start(stamped, &place);
        let streak_px = start.streak_px.norm() * self.shared.streak_scale();
        let reach_px = start.radius_px + 0.5 * streak_px;
        let patch = cut_outs.around(stamped, place.centre_px, HELD_SHARE * reach_px)?;
        let found = self.seek(&patch, &start, &place)?;
        let variance = 0.5 * whole_covariance(&found).trace();
        let off_px = (found.centre_px - place.centre_px).norm();
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
