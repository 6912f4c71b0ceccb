//! Where a ball in flight will be in one camera's picture, as the flight that other cameras see tells it.

use crate::geometry::Pixel;
use crate::time::StampedMidpoint;

/// A place at one instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ForeseenPlace {
    /// Exposure midpoint by this camera's stamps.
    pub stamped: StampedMidpoint,
    /// Centre, distorted pixels.
    pub centre: Pixel,
    /// 1σ of it, the worse direction, pixels.
    pub sigma_px: f64,
    /// The ball's radius as it would be on the lens's axis at this depth, pixels.
    pub radius_px: f64,
}

/// The way of one ball through one camera's picture, as far as it is known.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ForeseenPath {
    places: Vec<ForeseenPlace>,
}

impl ForeseenPath {
    /// Through these places, by rising stamp, so near to each other that the way between two of them is straight.
    pub fn new(places: Vec<ForeseenPlace>) -> Self {
        Self { places }
    }

    /// Its places.
    pub fn places(&self) -> &[ForeseenPlace] {
        &self.places
    }

    /// Where the ball is in a frame with this stamp; `None` where the path does not reach.
    pub fn at(&self, stamped: StampedMidpoint) -> Option<ForeseenPlace> {
        let after = self.places.partition_point(|place| place.stamped < stamped);
        let to = self.places.get(after)?;
        if to.stamped == stamped {
            return Some(*to);
        }
        let from = self.places.get(after.checked_sub(1)?)?;
        let begin = from.stamped.nanos();
        let share = stamped.seconds_since(begin) / to.stamped.seconds_since(begin);
        let between = |a: f64, b: f64| a + share * (b - a);
        Some(ForeseenPlace {
            stamped,
            centre: Pixel::new(
                between(from.centre.x, to.centre.x),
                between(from.centre.y, to.centre.y),
            ),
            sigma_px: between(from.sigma_px, to.sigma_px),
            radius_px: between(from.radius_px, to.radius_px),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_between_two_is_on_the_line_and_none_is_beyond_the_ends() {
        let place = |nanos: i64, x: f64, sigma_px: f64| ForeseenPlace {
            stamped: StampedMidpoint::from_nanos(nanos),
            centre: Pixel::new(x, 2.0 * x),
            sigma_px,
            radius_px: 3.0,
        };
        let path = ForeseenPath::new(vec![place(1000, 10.0, 1.0), place(2000, 20.0, 2.0)]);
        let at = |nanos| path.at(StampedMidpoint::from_nanos(nanos));
        assert_eq!(at(1250), Some(place(1250, 12.5, 1.25)));
        assert_eq!(
            (at(1000), at(2000)),
            (Some(place(1000, 10.0, 1.0)), Some(place(2000, 20.0, 2.0)))
        );
        assert_eq!((at(999), at(2001)), (None, None));
        assert_eq!(ForeseenPath::default().at(StampedMidpoint::from_nanos(0)), None);
    }
}
