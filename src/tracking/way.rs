//! Which way pitches go in a camera's picture and how large they are, where its pose is known: what flies another way or is
//! of another size needs no second look.

use nalgebra::{Point3, Vector2};

use crate::geometry::{Intrinsics, Pose};
use crate::scene::{BALL_RADIUS_M, FieldPreset};

/// Release points and aims that pitches lie between: x and z, metres.
const RELEASES_M: [[f64; 2]; 4] = [[-0.8, 1.4], [-0.8, 2.1], [0.8, 1.4], [0.8, 2.1]];
const AIMS_M: [[f64; 2]; 4] = [[-0.3, 0.45], [-0.3, 1.1], [0.3, 0.45], [0.3, 1.1]];
/// The ball is let go so far before the rubber and crosses the plate here, y in metres.
const STRIDE_M: f64 = 1.8;
const PLATE_Y_M: f64 = 0.43;
/// A pitch hangs below its chord by so much at the middle, metres.
const SAG_M: f64 = 0.25;
/// Ways of all pitches, and of their halves, have at least this cosine with their mean; else the camera looks along the
/// flight, and nothing is said.
const COSINE_MIN: f64 = 0.75;
/// Pitches are no shorter in the picture, pixels.
const LENGTH_MIN_PX: f64 = 60.0;

/// The mean direction of pitches in the picture, a unit vector; `None` where they go many ways.
pub fn pitch_way(pose: &Pose, lens: &Intrinsics, field: FieldPreset) -> Option<[f64; 2]> {
    let rubber_y_m = field.landmark("rubber_front_left").ok()?.y;
    let at = |x: f64, y: f64, z: f64| -> Option<Vector2<f64>> {
        let seen = lens.project(&pose.transform(&Point3::new(x, y, z))).ok()?;
        Some(Vector2::new(seen.x, seen.y))
    };
    let mut ways = Vec::with_capacity(3 * RELEASES_M.len() * AIMS_M.len());
    let release_y_m = rubber_y_m - STRIDE_M;
    for [x0, z0] in RELEASES_M {
        for [x1, z1] in AIMS_M {
            let middle_y_m = 0.5 * (release_y_m + PLATE_Y_M);
            let begin = at(x0, release_y_m, z0)?;
            let middle = at(0.5 * (x0 + x1), middle_y_m, 0.5 * (z0 + z1) + SAG_M)?;
            let end = at(x1, PLATE_Y_M, z1)?;
            if (end - begin).norm() < LENGTH_MIN_PX {
                return None;
            }
            for way in [end - begin, middle - begin, end - middle] {
                ways.push(way.try_normalize(1e-9)?);
            }
        }
    }
    let mean = ways.iter().sum::<Vector2<f64>>().try_normalize(1e-9)?;
    let agree = ways.iter().all(|way| way.dot(&mean) > COSINE_MIN);
    agree.then_some([mean.x, mean.y])
}

/// The smallest and the largest radius of the ball between the hand and the plate, pixels; `None` where that is behind the
/// camera.
pub fn pitch_radii(pose: &Pose, lens: &Intrinsics, field: FieldPreset) -> Option<[f64; 2]> {
    let release_y_m = field.landmark("rubber_front_left").ok()?.y - STRIDE_M;
    let begins = RELEASES_M.map(|[x, z]| Point3::new(x, release_y_m, z));
    let ends = AIMS_M.map(|[x, z]| Point3::new(x, PLATE_Y_M, z));
    // Nearest and farthest are on straight lines, so at their ends.
    let depths = begins.iter().chain(&ends).map(|place| pose.transform(place).z);
    let (nearest, farthest) = depths.fold((f64::INFINITY, 0.0), |(low, high): (f64, f64), depth| {
        (low.min(depth), high.max(depth))
    });
    let radius_px = |depth_m: f64| lens.fx_px * BALL_RADIUS_M / depth_m;
    (nearest > 0.0).then(|| [radius_px(farthest), radius_px(nearest)])
}

#[cfg(test)]
mod tests {
    use super::*;

    const LENS: Intrinsics = Intrinsics {
        fx_px: 1790.0,
        fy_px: 1790.0,
        cx_px: 1023.5,
        cy_px: 511.5,
        distortion: [0.0; 5],
    };

    fn way(from: [f64; 3], to: [f64; 3]) -> Option<[f64; 2]> {
        let pose = Pose::looking_at(from.into(), to.into());
        pitch_way(&pose, &LENS, FieldPreset::Professional)
    }

    #[test]
    fn a_ball_is_as_large_as_its_depth_makes_it() {
        // 10 m behind the plate's front, looking along the field: y + 10 m off. At the plate 0.43 m, at the hand 18.44 − 1.8 m.
        let radii_from = |camera_y_m: f64| {
            let pose = Pose::looking_at(Point3::new(0.0, camera_y_m, 1.5), Point3::new(0.0, 30.0, 1.5));
            pitch_radii(&pose, &LENS, FieldPreset::Professional)
        };
        let [least, most] = radii_from(-10.0).unwrap();
        let by_hand = |depth_m: f64| 1790.0 * 0.036888 / depth_m;
        assert!((least - by_hand(26.64)).abs() < 2e-3, "{least}");
        assert!((most - by_hand(10.43)).abs() < 2e-3, "{most}");
        assert_eq!(radii_from(5.0), None);
    }

    #[test]
    fn pitches_go_left_for_the_first_base_side_right_for_the_third_and_down_from_behind_home() {
        let first = way([20.0, 6.0, 3.0], [0.0, 9.0, 1.0]).unwrap();
        assert!(first[0] < -0.98, "{first:?}");
        let third = way([-20.0, 6.0, 3.0], [0.0, 9.0, 1.0]).unwrap();
        assert!(third[0] > 0.98, "{third:?}");
        let home = way([1.4, -15.5, 8.2], [-0.1, 9.0, 0.6]).unwrap();
        assert!(home[1] > 0.95, "{home:?}");
    }

    #[test]
    fn a_camera_in_the_line_of_flight_says_nothing() {
        assert_eq!(way([0.0, -12.0, 1.5], [0.0, 9.0, 1.5]), None);
    }
}
