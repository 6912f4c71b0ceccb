//! A ball that is partly hidden by what stands before it (a wire, a rail, a helmet): pixels that show no ball where the ball
//! should be say nothing of where it is.

use nalgebra::{Vector2, Vector3};

use super::{Edge, HUBER_SIGMAS, Look, Picture, PixelLanes, Shared};

/// The ball covers at least so much of a pixel that should show it.
const COVERAGE_MIN: f64 = 0.6;
/// It should differ from what is behind the ball by so many σ ...
const SIGMAS_MIN: f64 = 4.0;
/// ... and differs by less than this share of that.
const SHARE_MAX: f64 = 0.35;
/// Fewest such pixels: one or two are noise, or a step of the light.
const PIXELS_MIN: usize = 3;
/// What hides the ball covers its neighbours too, in part, pixels.
const MARGIN_PX: f64 = 1.5;
/// Fewest pixels of a ball that are enough for its centre.
const SHOWN_MIN: usize = 10;

impl Picture {
    /// Places of the pixels in which a ball of this level at this place is hidden; empty where it is not.
    pub fn hidden(
        &self,
        centre_px: Vector2<f64>,
        level: f64,
        (shared, edge): (&Shared, &Edge),
    ) -> Vec<Vector2<f64>> {
        let own = Vector3::new(centre_px.x, centre_px.y, level);
        let parameters = shared.fill((self.place, &self.turn), &own);
        let look = Look::new(
            &parameters,
            (&self.sweep, edge),
            (self.model_variance, HUBER_SIGMAS),
        );
        let modelled = self.pixels.modelled(&look).into_iter();
        let hidden = modelled.filter(|(pixel, value, coverage)| {
            let lift = value - pixel.background;
            let sigma = (pixel.variance + self.model_variance).sqrt();
            *coverage > COVERAGE_MIN
                && lift.abs() > SIGMAS_MIN * sigma
                && (pixel.value - pixel.background).abs() < SHARE_MAX * lift.abs()
        });
        let places: Vec<_> = hidden.map(|(pixel, ..)| pixel.at).collect();
        if places.len() < PIXELS_MIN {
            Vec::new()
        } else {
            places
        }
    }

    /// The picture without these pixels and their neighbours; `None` where too little of the ball is left.
    pub fn without(&self, hidden: &[Vector2<f64>], (shared, edge): (&Shared, &Edge)) -> Option<Self> {
        let parameters = shared.fill((self.place, &self.turn), &self.own);
        let look = Look::new(
            &parameters,
            (&self.sweep, edge),
            (self.model_variance, HUBER_SIGMAS),
        );
        let mut modelled = self.pixels.modelled(&look);
        modelled.retain(|(pixel, ..)| hidden.iter().all(|h| (h - pixel.at).norm() > MARGIN_PX));
        let shown = modelled
            .iter()
            .filter(|(_, _, coverage)| *coverage > COVERAGE_MIN);
        if shown.count() < SHOWN_MIN {
            return None;
        }
        let pixels: Vec<_> = modelled.into_iter().map(|(pixel, ..)| pixel).collect();
        Some(Self {
            pixels: PixelLanes::new(&pixels),
            ..self.clone()
        })
    }

    /// Where the fit of the centre begins.
    pub fn begin_at(&mut self, centre_px: Vector2<f64>, level: f64) {
        self.own = Vector3::new(centre_px.x, centre_px.y, level);
    }
}
