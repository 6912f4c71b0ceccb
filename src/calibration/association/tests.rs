//! Tests of the association on made-up tracks of known owners.

use super::*;
use crate::geometry::{Intrinsics, Pixel};
use crate::scene::{CameraId, CameraSetup, FieldPreset, Motion, RollingShutter, Site, TrackPoint};
use crate::time::StampedMidpoint;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

fn rig(ids: &[&str]) -> Rig {
    let intrinsics = Intrinsics {
        fx_px: 1790.0,
        fy_px: 1790.0,
        cx_px: 1023.5,
        cy_px: 511.5,
        distortion: [0.0; 5],
    };
    let camera = |id: &&str| CameraSetup {
        id: CameraId::new(id).unwrap(),
        width_px: 2048,
        height_px: 1024,
        frame_rate_hz: 175.0,
        exposure_s: None,
        time_offset_s: None,
        rolling_shutter: RollingShutter::Global,
        intrinsics,
        focal_sigma_relative: 0.0,
        position: None,
        landmarks: Vec::new(),
        regions: Vec::new(),
        masks: Vec::new(),
    };
    Rig {
        site: Site {
            name: String::new(),
            field: FieldPreset::Professional,
            motion: Motion::Flight,
            gravity_mps2: 9.80665,
            air_density_kgpm3: 1.194,
        },
        reference: 0,
        cameras: ids.iter().map(camera).collect(),
        distances: Vec::new(),
    }
}

/// A track from `start_s` to `end_s` that moves to the right at 3000 px/s.
fn track(id: &str, number: u32, (start_s, end_s, rate_hz): (f64, f64, f64), y: f64) -> Track {
    let n = ((end_s - start_s) * rate_hz).round() as u64;
    let point = |i: u64| {
        let t = start_s + i as f64 / rate_hz;
        TrackPoint {
            frame: i,
            stamped: StampedMidpoint::from_seconds_since(1_700_000_000_000_000_000, t),
            pixel: Pixel::new(100.0 + 3000.0 * (t % 1000.0 - start_s % 1000.0 + y / 3000.0), y),
            covariance_px2: None,
        }
    };
    Track {
        camera: CameraId::new(id).unwrap(),
        track: number,
        points: (0..=n).map(point).collect(),
    }
}

struct Scene {
    offset_s: f64,
    skew_ppm: f64,
    spacing_s: f64,
    missed: f64,
    extra: usize,
}

/// Tracks of two cameras and the start of the pitch each belongs to (negative: none).
fn scene(s: &Scene, seed: u64) -> (Vec<Track>, Vec<f64>) {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let (mut tracks, mut owner) = (Vec::new(), Vec::new());
    let mut t = 5.0;
    for k in 0..12 {
        for (id, rate, part) in [("first", 175.0, (0.0, 0.45)), ("third", 119.88, (0.1, 0.45))] {
            if rng.random_bool(s.missed) {
                continue;
            }
            let cut = rng.random_range(0.0..0.06);
            let clock = |x: f64| {
                if id == "first" {
                    x
                } else {
                    x * (1.0 + 1e-6 * s.skew_ppm) + s.offset_s
                }
            };
            let (a, b) = (clock(t + part.0 + cut), clock(t + part.1));
            if k % 3 == 1 {
                let gap = a + 0.4 * (b - a);
                let whole = track(id, 0, (a, b, rate), 300.0);
                for (number, keep) in [(2 * k, true), (2 * k + 1, false)] {
                    let mut piece = whole.clone();
                    piece.track = number;
                    piece.points.retain(|p| {
                        let x = p.stamped.seconds_since(1_700_000_000_000_000_000);
                        if keep { x < gap } else { x > gap + 0.05 }
                    });
                    tracks.push(piece);
                    owner.push(t);
                }
            } else {
                tracks.push(track(id, 2 * k, (a, b, rate), 300.0));
                owner.push(t);
            }
        }
        t += s.spacing_s * rng.random_range(0.6..1.6);
    }
    for k in 0..s.extra {
        let at = rng.random_range(0.0..t);
        tracks.push(track(
            "third",
            100 + k as u32,
            (at + s.offset_s, at + s.offset_s + 0.3, 119.88),
            900.0,
        ));
        owner.push(-1.0);
    }
    (tracks, owner)
}

fn check(s: &Scene, seed: u64) {
    let (tracks, owner) = scene(s, seed);
    let found = associate(&rig(&["first", "third"]), &tracks, &AssociationOptions::default());
    let owner_of = |t: &Track| owner[tracks.iter().position(|u| u == t).unwrap()];
    let mut seen: Vec<f64> = owner.iter().copied().filter(|t| *t > 0.0).collect();
    seen.dedup();
    let mut right = 0;
    for pitch in &found.pitches {
        // A false track at the very moment of a pitch its camera missed cannot be told by time.
        let mut owners: Vec<f64> = pitch.tracks.iter().map(owner_of).collect();
        owners.sort_by(|a, b| b.total_cmp(a));
        if owners[0] > 0.0 {
            owners.retain(|t| *t > 0.0);
        }
        let one = owners.windows(2).all(|w| w[0] == w[1]);
        assert!(one, "seed {seed}: tracks of different balls {owners:?}");
        right += usize::from(owners[0] > 0.0);
    }
    assert_eq!(right, seen.len(), "seed {seed}: every ball once");
}

#[test]
fn stamps_that_agree_are_grouped_by_time() {
    for seed in 0..50 {
        check(
            &Scene {
                offset_s: 0.17,
                skew_ppm: 0.0,
                spacing_s: 15.0,
                missed: 0.1,
                extra: 2,
            },
            seed,
        );
        check(
            &Scene {
                offset_s: -0.17,
                skew_ppm: 0.0,
                spacing_s: 15.0,
                missed: 0.1,
                extra: 2,
            },
            seed,
        );
    }
}

#[test]
fn stamps_seconds_off_are_grouped_by_rhythm() {
    for seed in 0..50 {
        check(
            &Scene {
                offset_s: 47.3,
                skew_ppm: 0.0,
                spacing_s: 15.0,
                missed: 0.1,
                extra: 2,
            },
            seed,
        );
        check(
            &Scene {
                offset_s: -3600.0,
                skew_ppm: 0.0,
                spacing_s: 20.0,
                missed: 0.2,
                extra: 0,
            },
            seed,
        );
    }
}

#[test]
fn skew_over_an_hour_is_followed() {
    for seed in 0..20 {
        check(
            &Scene {
                offset_s: 0.05,
                skew_ppm: 20.0,
                spacing_s: 300.0,
                missed: 0.1,
                extra: 2,
            },
            seed,
        );
        check(
            &Scene {
                offset_s: 12.0,
                skew_ppm: -100.0,
                spacing_s: 300.0,
                missed: 0.1,
                extra: 2,
            },
            seed,
        );
    }
}

#[test]
fn a_rough_offset_settles_a_regular_rhythm() {
    let mut rig = rig(&["first", "third"]);
    rig.cameras[1].time_offset_s = Some(19.0);
    // A machine that throws every ten seconds; third's stamps are 19.6 s behind, and it missed the first.
    let mut tracks: Vec<Track> = (0..6)
        .map(|k| {
            track(
                "first",
                k,
                (100.0 + 10.0 * f64::from(k), 100.4 + 10.0 * f64::from(k), 175.0),
                300.0,
            )
        })
        .collect();
    tracks.extend((1..6).map(|k| {
        let t = 100.0 + 10.0 * f64::from(k) - 19.6;
        track("third", k, (t, t + 0.4, 175.0), 300.0)
    }));
    let found = associate(&rig, &tracks, &AssociationOptions::default());
    assert!((found.offset_s[1].unwrap() + 19.6).abs() < 0.02);
    assert_eq!(found.pitches.len(), 6);
    assert_eq!(found.pitches[0].tracks.len(), 1);
    assert!(found.pitches[1..].iter().all(|p| p.cameras_seen() == 2));
}

#[test]
fn nothing_and_strangers_are_no_pitches() {
    let rig = rig(&["first", "third"]);
    assert!(group_pitches(&rig, &[]).is_empty());
    assert!(group_pitches(&rig, &[track("second", 1, (1.0, 1.4, 175.0), 300.0)]).is_empty());
}
