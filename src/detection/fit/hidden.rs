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
    /// The picture without the pixels in which a ball of this level at this place is hidden, and their neighbours, to be
    /// fitted from there; as it is where nothing is hidden, `None` where too little of the ball is left.
    pub fn shown(
        mut self,
        centre_px: Vector2<f64>,
        level: f64,
        (shared, edge): (&Shared, &Edge),
    ) -> Option<Self> {
        let own = Vector3::new(centre_px.x, centre_px.y, level);
        let parameters = shared.fill((self.place, &self.turn, self.share), &own);
        let noise = (self.model_variance, HUBER_SIGMAS);
        let look = Look::new(&parameters, (&self.sweep, edge), noise);
        let mut modelled = self.pixels.modelled(&look);
        let hidden = modelled.iter().filter(|(pixel, value, coverage)| {
            let lift = value - pixel.background;
            let sigma = (pixel.variance + self.model_variance).sqrt();
            *coverage > COVERAGE_MIN
                && lift.abs() > SIGMAS_MIN * sigma
                && (pixel.value - pixel.background).abs() < SHARE_MAX * lift.abs()
        });
        let hidden: Vec<_> = hidden.map(|(pixel, ..)| pixel.at).collect();
        if hidden.len() < PIXELS_MIN {
            return Some(self);
        }
        modelled.retain(|(pixel, ..)| hidden.iter().all(|h| (h - pixel.at).norm() > MARGIN_PX));
        let covered = modelled
            .iter()
            .filter(|(_, _, coverage)| *coverage > COVERAGE_MIN);
        if covered.count() < SHOWN_MIN {
            return None;
        }
        let pixels: Vec<_> = modelled.into_iter().map(|(pixel, ..)| pixel).collect();
        self.pixels = PixelLanes::new(&pixels);
        self.own = own;
        Some(self)
    }
}
