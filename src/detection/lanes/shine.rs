//! The light of a ball's picture, averaged over what the blur takes in.

use super::super::disc::RIM_DEPTH_MIN;
use super::{Look, share_and_density};

/// The line between lit and unlit is no blurrier than where the ball is this deep, radii.
const FALL_DEPTH_MIN: f32 = 0.3;

/// The light about one point of the ball relative to its level.
pub(super) struct Shine {
    pub(super) value: f32,
    pub(super) by_u: f32,
    pub(super) by_v: f32,
    /// By [`Rim::follow`], and by the blur's variance in radii.
    pub(super) by_follow: f32,
    pub(super) by_spread: f32,
    pub(super) by_lx: f32,
    pub(super) by_ly: f32,
    pub(super) by_lz: f32,
    /// Means of u², u·v and v².
    pub(super) uu: f32,
    pub(super) uv: f32,
    pub(super) vv: f32,
}

/// The mean of the light over the part of the blur that is on the ball: about (u, v), of variance (σ/r)² along the rim and
/// `follow` times that across it, the direction `n`.
///
/// Squares get their variances. The sphere's depth √(1 − u² − v²) is taken one standard deviation further in and further out,
/// with the variance along the rim. max(0, f) becomes the mean of max(0, f + ξ), with ξ as wide as f changes over the blur.
#[inline(always)]
pub(super) fn shine((u, v): (f32, f32), (nx, ny): (f32, f32), follow: f32, look: &Look<'_>) -> Shine {
    const DEPTH_MIN: f32 = RIM_DEPTH_MIN as f32;
    let [b, c, d, e, f, lx, ly, lz] = look.light;
    let (along, across) = (look.spread, look.spread * follow);
    let narrower = across - along;
    let (nxx, nxy, nyy) = (nx * nx, nx * ny, ny * ny);
    let uu = u * u + along + narrower * nxx;
    let uv = u * v + narrower * nxy;
    let vv = v * v + along + narrower * nyy;

    let out = u * nx + v * ny;
    let aside = across.sqrt();
    let (near, far) = (out - aside, out + aside);
    let near_depth = (1.0 - near * near - along).max(0.0).sqrt();
    let far_depth = (1.0 - far * far - along).max(0.0).sqrt();
    let depth = 0.5 * (near_depth + far_depth);
    // No slope where there is no ball.
    let per = |depth: f32| {
        if depth > 0.0 {
            1.0 / depth.max(DEPTH_MIN)
        } else {
            0.0
        }
    };
    let (per_near, per_far) = (per(near_depth), per(far_depth));
    let depth_by_out = -0.5 * (near * per_near + far * per_far);
    let depth_by_across = 0.25 * (near * per_near - far * per_far) / aside.max(1e-6);
    let depth_by_along = -0.25 * (per_near + per_far);

    let facing = lx * u + ly * v + lz * depth;
    let per_fall = 1.0 / depth.max(FALL_DEPTH_MIN);
    let fall = -out * per_fall;
    let (outward, sideways) = (lx * nx + ly * ny + lz * fall, ly * nx - lx * ny);
    let width = (across * outward * outward + along * sideways * sideways)
        .max(1e-12)
        .sqrt();
    let per_width = 1.0 / width;
    let (lit, density) = share_and_density(facing * per_width);
    // By the variances across and along the rim.
    let by_across = d * nxx
        + e * nxy
        + f * nyy
        + lit * lz * depth_by_across
        + 0.5 * density * outward * outward * per_width;
    let by_along = d * nyy - e * nxy
        + f * nxx
        + lit * lz * depth_by_along
        + 0.5 * density * sideways * sideways * per_width;
    let (wide_out, wide_side) = (
        density * across * outward * per_width,
        density * along * sideways * per_width,
    );
    // The width changes with the place too: outwards with the sphere's slope, sideways with the direction of the rim.
    let fall_by_out = if depth > FALL_DEPTH_MIN {
        per_fall * (out * depth_by_out * per_fall - 1.0)
    } else {
        -per_fall
    };
    let wider_out = wide_out * lz * fall_by_out;
    let outwards = lit * lz * depth_by_out + wider_out;
    let wider_side =
        density * sideways * (narrower * outward + along * lz * fall) * per_width / out.max(0.05);
    Shine {
        value: 1.0 + b * u + c * v + d * uu + e * uv + f * vv + lit * facing + width * density,
        by_u: b + 2.0 * d * u + e * v + lit * lx + outwards * nx - wider_side * ny,
        by_v: c + e * u + 2.0 * f * v + lit * ly + outwards * ny + wider_side * nx,
        by_follow: by_across * look.spread,
        by_spread: by_across * follow + by_along,
        by_lx: lit * u + wide_out * nx - wide_side * ny,
        by_ly: lit * v + wide_out * ny + wide_side * nx,
        by_lz: lit * depth + wide_out * fall,
        uu,
        uv,
        vv,
    }
}
