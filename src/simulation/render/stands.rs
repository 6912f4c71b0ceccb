//! What stands around the field: padded walls, advertising boards, crowd, outfield fence, sky.

use nalgebra::{Point3, Vector3};

use super::texture::{coverage, grain, hash};

/// Half width between the side walls, metres.
const SIDE_WALL_M: f64 = 27.0;
/// The backstop, y in metres.
const BACKSTOP_Y_M: f64 = -17.5;
/// The side walls end here, y in metres.
const SIDE_END_Y_M: f64 = 48.0;
/// Outfield fence, distance from home, metres.
const FENCE_RADIUS_M: f64 = 106.0;
/// Boards lie between these heights, metres.
const BOARD_M: (f64, f64) = (0.55, 1.75);
/// Seats end here, metres.
const STAND_TOP_M: f64 = 19.0;
const SEAT_M: (f64, f64) = (0.56, 0.86);

/// A point on a wall.
#[derive(Debug, Clone, Copy)]
pub(super) struct WallHit {
    /// Along the ray, metres.
    pub distance_m: f64,
    along_m: f64,
    height_m: f64,
}

impl WallHit {
    /// Is it among the seats?
    pub(super) fn in_crowd(&self) -> bool {
        self.height_m > BOARD_M.1 + 0.4 && self.height_m < STAND_TOP_M
    }
}

/// Where a ray first meets a wall.
pub(super) fn hit(from: &Point3<f64>, along: &Vector3<f64>) -> WallHit {
    let mut best = fence(from, along);
    let mut consider =
        |distance_m: f64, along_of: fn(&Point3<f64>) -> f64, holds: fn(&Point3<f64>) -> bool| {
            if distance_m > 0.1 && distance_m < best.distance_m {
                let p = from + along * distance_m;
                if holds(&p) {
                    best = WallHit {
                        distance_m,
                        along_m: along_of(&p),
                        height_m: p.z,
                    };
                }
            }
        };
    for side in [-SIDE_WALL_M, SIDE_WALL_M] {
        // A camera outside a wall looks through it.
        if (side - from.x) * side > 0.0 {
            consider(
                (side - from.x) / along.x,
                |p| p.y + 300.0,
                |p| p.y < SIDE_END_Y_M && p.y > BACKSTOP_Y_M,
            );
        }
    }
    if from.y > BACKSTOP_Y_M {
        consider(
            (BACKSTOP_Y_M - from.y) / along.y,
            |p| p.x + 900.0,
            |p| p.x.abs() < SIDE_WALL_M,
        );
    }
    best
}

fn fence(from: &Point3<f64>, along: &Vector3<f64>) -> WallHit {
    let a = along.x * along.x + along.y * along.y;
    let b = from.x * along.x + from.y * along.y;
    let c = from.x * from.x + from.y * from.y - FENCE_RADIUS_M * FENCE_RADIUS_M;
    let root = (b * b - a * c).max(0.0).sqrt();
    let distance_m = if a > 1e-9 { (root - b) / a } else { 1e6 };
    let p = from + along * distance_m;
    WallHit {
        distance_m,
        along_m: FENCE_RADIUS_M * p.x.atan2(p.y) + 2000.0,
        height_m: p.z,
    }
}

/// Grey level of a wall point; `board_dn` > 0 makes every third board that bright.
pub(super) fn tone(hit: &WallHit, pixel_m: f64, board_dn: f32) -> f32 {
    let (s, z) = (hit.along_m, hit.height_m);
    if z > STAND_TOP_M {
        return sky(s, z, pixel_m);
    }
    let pad = 58.0 + grain(s, z, pixel_m, &[(2.0, 4.0), (0.3, 4.0)], 71);
    if z < BOARD_M.0 {
        return pad;
    }
    if z < BOARD_M.1 {
        return board(s, z, pixel_m, board_dn);
    }
    if z < BOARD_M.1 + 0.4 {
        return pad * 0.8;
    }
    crowd(s, z, pixel_m)
}

fn sky(s: f64, z: f64, pixel_m: f64) -> f32 {
    148.0 + grain(s, z, pixel_m, &[(40.0, 14.0), (9.0, 6.0)], 91) + ((z - STAND_TOP_M) as f32 * 0.4).min(25.0)
}

fn board(s: f64, z: f64, pixel_m: f64, board_dn: f32) -> f32 {
    const LENGTH_M: f64 = 6.4;
    let number = (s / LENGTH_M).floor();
    let inside_m = s - number * LENGTH_M;
    let index = number as i64;
    let kind = hash(index, 3, 101);
    let bright = board_dn > 0.0 && index.rem_euclid(3) == 0;
    let paper = if bright { board_dn } else { 55.0 + 95.0 * kind };
    let ink = if bright { board_dn * 0.72 } else { 205.0 - paper };
    // Letters: strokes on a grid of a hand's width.
    let column = (inside_m / 0.28).floor() as i64;
    let row = ((z - BOARD_M.0) / 0.17).floor() as i64;
    let lettered = inside_m > 0.7 && inside_m < LENGTH_M - 0.7 && (1..6).contains(&row);
    let stroke = if lettered && hash(column + index * 97, row, 103) > 0.52 {
        1.0
    } else {
        0.0
    };
    let frame = coverage(0.08 - inside_m.min(LENGTH_M - inside_m), pixel_m);
    let face = paper + (ink - paper) * stroke;
    face + (40.0 - face) * frame
}

/// Rows of people: a head over shoulders in most seats, an aisle every twelfth.
fn crowd(s: f64, z: f64, pixel_m: f64) -> f32 {
    let row = (z / SEAT_M.1).floor();
    let shift = 0.28 * (row as i64).rem_euclid(2) as f64;
    let seat = ((s + shift) / SEAT_M.0).floor();
    let (u, v) = ((s + shift) / SEAT_M.0 - seat, z / SEAT_M.1 - row);
    let (i, j) = (seat as i64, row as i64);
    let step = 46.0 + 10.0 * (v as f32) + grain(s, z, pixel_m, &[(0.2, 6.0)], 121);
    if i.rem_euclid(13) == 0 {
        return step + 30.0;
    }
    let clothes = 30.0 + 165.0 * hash(i, j, 123).powf(1.4);
    let skin = 95.0 + 75.0 * hash(i, j, 125);
    if hash(i, j, 127) > 0.86 {
        return step;
    }
    let soft = pixel_m / SEAT_M.0;
    let lean = 0.16 * f64::from(hash(i, j, 129) - 0.5);
    let body = coverage((0.36 - (u - 0.5 - lean).abs()).min(0.56 - v), soft);
    let head = coverage(
        0.155 - (u - 0.5 - lean).hypot((v - 0.70) * SEAT_M.1 / SEAT_M.0),
        soft,
    );
    let dressed = step + (clothes - step) * body;
    dressed + (skin - dressed) * head
}
