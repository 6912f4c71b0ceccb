//! The ground: grass, dirt, mound, chalk and plate, by world position.

use nalgebra::{Point3, Vector3};

use super::texture::{coverage, grain};
use crate::scene::FieldPreset;

/// The field as the renderer needs it.
#[derive(Debug, Clone)]
pub(super) struct Ground {
    rubber_y_m: f64,
    rubber_z_m: f64,
    base_m: f64,
    mound_y_m: f64,
    white_dn: f32,
    shadow: bool,
}

const PLATE_HALF_M: f64 = 0.2159;
const MOUND_RADIUS_M: f64 = 2.7432;
const MOUND_TOP_M: f64 = 0.95;
/// Where the shadow's edge meets the ground on the line to the mound, and its slope in x.
const SHADOW_Y_M: f64 = 4.6;
const SHADOW_SLOPE: f64 = 0.22;
/// Share of the light left in the shadow.
const SHADE: f32 = 0.52;

impl Ground {
    pub(super) fn new(field: FieldPreset, white_dn: f32, shadow: bool) -> Self {
        let at = |name: &str| field.landmark(name).map_or(Point3::origin(), |p| p);
        let rubber = at("rubber_front_right");
        Self {
            rubber_y_m: rubber.y,
            rubber_z_m: rubber.z,
            base_m: at("first_base").x,
            mound_y_m: at("mound_center").y,
            white_dn,
            shadow,
        }
    }

    /// Height of the ground, metres: flat but for the mound.
    fn height_m(&self, x: f64, y: f64) -> f64 {
        let r = x.hypot(y - self.mound_y_m);
        self.rubber_z_m * ((MOUND_RADIUS_M - r) / (MOUND_RADIUS_M - MOUND_TOP_M)).clamp(0.0, 1.0)
    }

    /// Distance along a ray to the ground; `None` if it rises.
    pub(super) fn hit(&self, from: &Point3<f64>, along: &Vector3<f64>) -> Option<f64> {
        if along.z > -1e-6 {
            return None;
        }
        let mut t = -from.z / along.z;
        // The mound is gentle: three rounds settle the height to a millimetre.
        for _ in 0..3 {
            let p = from + along * t;
            t = (self.height_m(p.x, p.y) - from.z) / along.z;
        }
        (t > 0.0).then_some(t)
    }

    /// Share of the sun at a point, 0..1: the stand's shadow lies over home plate.
    pub(super) fn light(&self, p: &Point3<f64>) -> f32 {
        if !self.shadow {
            return 1.0;
        }
        // The sun stands behind home: higher points leave the shadow nearer to it.
        let beyond_m = p.y - SHADOW_SLOPE * p.x + 0.8 * p.z - SHADOW_Y_M;
        SHADE + (1.0 - SHADE) * coverage(beyond_m, 0.12)
    }

    /// Grey level of the ground at a point; `pixel_m` is the size of a pixel there.
    pub(super) fn tone(&self, p: &Point3<f64>, pixel_m: f64) -> f32 {
        let (x, y) = (p.x, p.y);
        let dirt_tone = 128.0
            + grain(
                x,
                y,
                pixel_m,
                &[(1.7, 7.0), (0.4, 6.0), (0.09, 7.0), (0.03, 6.0)],
                11,
            );
        let mowing = if ((x + y) / 4.2).rem_euclid(2.0) < 1.0 {
            5.0
        } else {
            -5.0
        };
        let grass_tone = 92.0
            + mowing
            + grain(
                x,
                y,
                pixel_m,
                &[(3.1, 6.0), (0.5, 5.0), (0.1, 8.0), (0.035, 8.0)],
                31,
            );
        let dirt = self.dirt(x, y, pixel_m);
        let ground = grass_tone + (dirt_tone - grass_tone) * dirt;
        let chalk_tone = self.white_dn * 0.93 + grain(x, y, pixel_m, &[(0.05, 9.0), (0.02, 8.0)], 51);
        ground + (chalk_tone - ground) * self.white(x, y, pixel_m)
    }

    fn dirt(&self, x: f64, y: f64, pixel_m: f64) -> f32 {
        let disc =
            |cx: f64, cy: f64, radius: f64| coverage(radius - (x - cx).hypot(y - cy), pixel_m.max(0.05));
        let b = self.base_m;
        // Infield skin: within 29 m of the mound, outside the grass square between the bases.
        let skin = disc(0.0, self.mound_y_m, 28.96);
        let square = b - x.abs() - (y - b).abs();
        let grass = coverage(square - 1.3, 0.05);
        let fair = coverage(y - x.abs() + 1.2, 0.05);
        let mut dirt: f32 = skin * (1.0 - grass) * fair;
        dirt = dirt.max(disc(0.0, self.mound_y_m, MOUND_RADIUS_M));
        dirt = dirt.max(disc(0.0, 0.2, 3.96));
        // Warning track along the side walls.
        dirt.max(coverage((x.abs() - 23.5).min(48.0 - y), 0.05))
    }

    fn white(&self, x: f64, y: f64, pixel_m: f64) -> f32 {
        let ax = x.abs();
        let slab = |value: f64, low: f64, high: f64| (value - low).min(high - value);
        // Plate: the square between the sides and the wedge to the tip.
        let plate = slab(y, 0.0, 2.0 * PLATE_HALF_M)
            .min(PLATE_HALF_M - ax)
            .min(y - ax);
        // Batter's boxes: 4 in lines whose outer edges are the landmarks.
        let outer = slab(ax, 0.3683, 1.5875).min(slab(y, -0.6985, 1.1303));
        let boxes = outer.min(0.1 - outer);
        // Foul lines to the bases and on, outer edge on the line; they begin at the boxes.
        let foul = ((y - ax) * std::f64::consts::FRAC_1_SQRT_2)
            .min(0.1 - (y - ax) * std::f64::consts::FRAC_1_SQRT_2);
        let foul = foul.min(y - 1.25);
        // Bags.
        let bag = |cx: f64, cy: f64| 0.19 - (x - cx).abs().max((y - cy).abs());
        let b = self.base_m;
        let bags = bag(b - 0.27, b).max(bag(-b + 0.27, b)).max(bag(0.0, 2.0 * b));
        let rubber = slab(y, self.rubber_y_m, self.rubber_y_m + 0.1524).min(0.3048 - ax);
        let worn = 0.85;
        let bright = coverage(plate.max(rubber).max(bags), pixel_m);
        bright.max(worn * coverage(boxes.max(foul), pixel_m))
    }
}
