//! Procedural texture: hashed lattice noise in world metres, the same for every camera.

/// A hash of two lattice coordinates and a salt, 0..1.
pub(super) fn hash(x: i64, y: i64, salt: u64) -> f32 {
    let mut h = (x as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15)
        ^ (y as u64).wrapping_mul(0xc2b2_ae3d_27d4_eb4f)
        ^ salt.wrapping_mul(0x1656_67b1_9e37_79f9);
    h = (h ^ (h >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    h ^= h >> 32;
    (h >> 40) as f32 / (1u64 << 24) as f32
}

/// Smooth value noise with lattice step 1, mean 0, about ±1.
fn lattice(x: f64, y: f64, salt: u64) -> f32 {
    let (xf, yf) = (x.floor(), y.floor());
    let (ix, iy) = (xf as i64, yf as i64);
    let ease = |t: f32| t * t * (3.0 - 2.0 * t);
    let (u, v) = (ease((x - xf) as f32), ease((y - yf) as f32));
    let mix = |a: f32, b: f32, t: f32| a + (b - a) * t;
    let low = mix(hash(ix, iy, salt), hash(ix + 1, iy, salt), u);
    let high = mix(hash(ix, iy + 1, salt), hash(ix + 1, iy + 1, salt), u);
    2.0 * mix(low, high, v) - 1.0
}

/// Noise of several grain sizes (metres, amplitude). Grains finer than `pixel_m` fade out, as a lens would
/// average them.
pub(super) fn grain(x_m: f64, y_m: f64, pixel_m: f64, grains: &[(f64, f32)], salt: u64) -> f32 {
    let mut sum = 0.0;
    for ((size_m, amplitude), octave) in grains.iter().zip(salt..) {
        let fade = ((size_m / pixel_m) as f32 - 0.7).clamp(0.0, 1.0);
        if fade > 0.0 {
            sum += amplitude * fade * lattice(x_m / size_m, y_m / size_m, octave);
        }
    }
    sum
}

/// 1 inside, 0 outside an edge at signed distance `inside_m`, soft over a pixel.
pub(super) fn coverage(inside_m: f64, pixel_m: f64) -> f32 {
    ((inside_m / pixel_m) as f32 + 0.5).clamp(0.0, 1.0)
}
