//! The strike zone: margin and probability from a crossing and its covariance (domain §4, ABS rule).

use nalgebra::Matrix2;

use crate::scene::BALL_RADIUS_M;

/// Half the plate's width, metres (8.5 in).
pub const HALF_PLATE_M: f64 = 0.2159;

/// A flat zone at the middle of the plate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StrikeZone {
    /// Height of the upper edge, metres.
    pub top_m: f64,
    /// Height of the lower edge, metres.
    pub bottom_m: f64,
}

impl StrikeZone {
    /// MLB's ABS zone for a batter of this standing height: 53.5 % and 27 % of it.
    pub fn for_height(height_m: f64) -> Self {
        Self {
            top_m: 0.535 * height_m,
            bottom_m: 0.27 * height_m,
        }
    }

    /// How deep the ball reaches into the zone: the distance of its surface past the nearest edge, metres;
    /// positive: it touches the zone (a strike) by that much, negative: it misses by that much.
    pub fn margin_m(&self, x_m: f64, z_m: f64) -> f64 {
        let dx = x_m.abs() - HALF_PLATE_M;
        let dz = (self.bottom_m - z_m).max(z_m - self.top_m);
        let outside = dx.max(0.0).hypot(dz.max(0.0));
        let inside = dx.max(dz).min(0.0);
        BALL_RADIUS_M - (outside + inside)
    }

    /// Probability that any part of the ball touches the zone, for a centre that is normal about (x, z) with
    /// `covariance_m2`. By slices in x, exact to about 1e-3.
    pub fn strike_probability(&self, centre_m: [f64; 2], covariance_m2: &Matrix2<f64>) -> f64 {
        let [x, z] = centre_m;
        let sigma_x = covariance_m2[(0, 0)].max(1e-16).sqrt();
        let slope = covariance_m2[(0, 1)] / (sigma_x * sigma_x);
        let sigma_z = (covariance_m2[(1, 1)] - slope * covariance_m2[(0, 1)])
            .max(1e-16)
            .sqrt();
        const SLICES: i32 = 800;
        let (mut total, mut hit) = (0.0, 0.0);
        for i in -SLICES..=SLICES {
            let u = 5.0 * f64::from(i) / f64::from(SLICES);
            let weight = (-0.5 * u * u).exp();
            total += weight;
            let over = (x + u * sigma_x).abs() - HALF_PLATE_M;
            if over >= BALL_RADIUS_M {
                continue;
            }
            // The zone grown by the ball's radius has round corners.
            let reach = if over > 0.0 {
                (BALL_RADIUS_M * BALL_RADIUS_M - over * over).sqrt()
            } else {
                BALL_RADIUS_M
            };
            let mean = z + slope * u * sigma_x;
            let below = normal_below((self.top_m + reach - mean) / sigma_z);
            hit += weight * (below - normal_below((self.bottom_m - reach - mean) / sigma_z));
        }
        (hit / total).clamp(0.0, 1.0)
    }

    /// Statcast's zone number for the ball at the front of the plate: 1–9 inside, rows from the top, columns
    /// from the left as the catcher sees; 11–14 outside. In-zone ⇔ |x| ≤ 0.83 ft and within 0.12 ft of the zone in height.
    pub fn statcast_zone(&self, x_ft: f64, z_ft: f64) -> u8 {
        const HALF_WIDTH_FT: f64 = 0.83;
        const SLACK_FT: f64 = 0.12;
        let foot = super::nine_parameter::FOOT_M;
        let top = self.top_m / foot + SLACK_FT;
        let bottom = self.bottom_m / foot - SLACK_FT;
        if x_ft.abs() <= HALF_WIDTH_FT && (bottom..=top).contains(&z_ft) {
            let third = |share: f64| (share * 3.0).clamp(0.0, 2.0).floor() as u8;
            let column = third((x_ft + HALF_WIDTH_FT) / (2.0 * HALF_WIDTH_FT));
            let row = third((top - z_ft) / (top - bottom));
            return 1 + 3 * row + column;
        }
        let upper = z_ft > 0.5 * (top + bottom);
        match (upper, x_ft < 0.0) {
            (true, true) => 11,
            (true, false) => 12,
            (false, true) => 13,
            (false, false) => 14,
        }
    }
}

/// Φ(u), the share of a standard normal below `u`.
fn normal_below(u: f64) -> f64 {
    0.5 * libm::erfc(-u / std::f64::consts::SQRT_2)
}

#[cfg(test)]
mod tests {
    use super::*;

    const ZONE: StrikeZone = StrikeZone {
        top_m: 1.0,
        bottom_m: 0.5,
    };

    #[test]
    fn the_margin_is_the_ball_s_surface_past_the_edge() {
        // Middle of the zone: the nearest edge is the side, 215.9 mm away, plus the radius.
        assert!((ZONE.margin_m(0.0, 0.75) - (0.2159 + BALL_RADIUS_M)).abs() < 1e-12);
        // 40 mm outside the right edge: a miss by 40 − 36.888 mm.
        assert!((ZONE.margin_m(0.2559, 0.75) + 0.003_112).abs() < 1e-9);
        // 30/40 mm off the corner: 50 mm away.
        assert!((ZONE.margin_m(0.2159 + 0.03, 1.04) - (BALL_RADIUS_M - 0.05)).abs() < 1e-12);
    }

    #[test]
    fn a_ball_that_just_touches_is_a_strike_half_the_time() {
        let covariance = Matrix2::new(1e-6, 0.0, 0.0, 1e-6);
        let edge = [HALF_PLATE_M + BALL_RADIUS_M, 0.75];
        assert!((ZONE.strike_probability(edge, &covariance) - 0.5).abs() < 0.02);
        // 1σ inside: Φ(1) = 0.8413.
        let inside = [edge[0] - 1e-3, 0.75];
        assert!((ZONE.strike_probability(inside, &covariance) - 0.8413).abs() < 0.01);
        assert!(ZONE.strike_probability([0.0, 0.75], &covariance) > 0.9999);
        assert!(ZONE.strike_probability([0.0, 2.0], &covariance) < 1e-6);
    }

    #[test]
    fn zones_are_numbered_from_the_catcher_s_upper_left() {
        // 1 m = 3.28 ft, 0.5 m = 1.64 ft; thirds of [1.52, 3.40].
        assert_eq!(ZONE.statcast_zone(-0.7, 3.2), 1);
        assert_eq!(ZONE.statcast_zone(0.0, 2.46), 5);
        assert_eq!(ZONE.statcast_zone(0.7, 1.6), 9);
        assert_eq!(ZONE.statcast_zone(-1.0, 3.0), 11);
        assert_eq!(ZONE.statcast_zone(1.0, 1.0), 14);
    }
}
