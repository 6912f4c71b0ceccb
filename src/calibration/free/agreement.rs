//! Which sightings agree with another camera's, and how much of them one motion explains.

use super::grow::Session;
use super::pair::epipolar_miss;
use super::problem::State;
use super::support::Support;
use super::view::{Sighting, View};
use crate::geometry::{Pixel, Pose};

/// Epipolar distance within which two cameras agree in the end, pixels.
pub(super) const AGREES_PX: f64 = 8.0;

impl Session {
    /// The views without the sightings that contradict every other calibrated camera that sees something at
    /// the same time: where two cameras look at different things, neither is worth a point in space.
    pub fn agreeing(&self, state: &State, limit_px: f64) -> Vec<View> {
        let pose = |c: usize| state.cameras[c].as_ref().map(|c| c.pose);
        let mut views = self.views.clone();
        for (own, view) in views.iter_mut().enumerate() {
            let Some(camera) = &state.cameras[own] else {
                view.sightings.clear();
                continue;
            };
            let others: Vec<(usize, Pose)> = (0..self.views.len())
                .filter(|&other| other != own)
                .filter_map(|other| Some((other, pose(other)?.compose(&camera.pose.inverse()))))
                .collect();
            let limit_px = limit_px.max(2.0 * EXPLAINED_SCATTERS * self.paths[own].scatter_px);
            view.sightings.retain(|s| {
                let t_s = self.views[own].true_s(camera, s);
                let pixel = Pixel::new(s.pixel_px.x, s.pixel_px.y);
                let Ok(direction) = camera.lens.direction(pixel) else {
                    return false;
                };
                let mut contradicted = false;
                for (other, relative) in &others {
                    let seen = state.cameras[*other].as_ref().and_then(|c| {
                        self.paths[*other].at(self.views[*other].stamp_s(c, t_s) + self.offsets_s[*other])
                    });
                    let Some(seen) = seen else { continue };
                    let focal = [self.paths[own].focal_px, self.paths[*other].focal_px];
                    if epipolar_miss(relative, &[direction, seen], focal) < limit_px {
                        return true;
                    }
                    contradicted = true;
                }
                !contradicted
            });
        }
        views
    }

    /// What the state explains while two cameras see.
    pub fn explained(&self, state: &State) -> Explained {
        let support = Support::new(&self.views, state);
        let mut explained = Explained {
            sightings: 0,
            shares: vec![None; self.views.len()],
        };
        for (index, view) in support.restricted(&self.views, state, 0.0).iter().enumerate() {
            let Some(camera) = &state.cameras[index] else {
                continue;
            };
            let limit_px = EXPLAINED_PX.max(EXPLAINED_SCATTERS * self.paths[index].scatter_px);
            let fits = |s: &&Sighting| {
                view.predict(camera, &state.spline, s)
                    .is_some_and(|p| p.residual_px.norm() < limit_px)
            };
            let close = view.sightings.iter().filter(fits).count();
            explained.sightings += close;
            explained.shares[index] = Some(close as f64 / view.sightings.len().max(1) as f64);
        }
        explained
    }
}

/// How much of what the cameras saw one motion explains.
#[derive(Debug, Clone)]
pub(super) struct Explained {
    /// Sightings of all cameras.
    pub sightings: usize,
    /// Share of every calibrated camera's own sightings. One camera alone can always be explained by a free
    /// curve: only the least share tells.
    pub shares: Vec<Option<f64>>,
}

impl Explained {
    /// The calibrated camera that is explained least, and its share.
    pub fn least(&self) -> Option<(usize, f64)> {
        let shares = self.shares.iter().enumerate();
        shares
            .filter_map(|(camera, share)| Some((camera, (*share)?)))
            .min_by(|a, b| a.1.total_cmp(&b.1))
    }
}

/// A sighting this close to the prediction is explained, pixels; and in medians of the camera's own scatter.
const EXPLAINED_PX: f64 = 4.0;
const EXPLAINED_SCATTERS: f64 = 5.0;
