//! Calibration and single-pitch solving on one core: issue 3 asks for 0.5 s (8 pitches × 3 cameras) and 2 ms.

#![allow(clippy::unwrap_used, reason = "a bench may")]
#![allow(missing_docs, reason = "criterion's macros")]

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use pitchd::calibration::recipe::{CalibrationOptions, calibrate};
use pitchd::flight::{FlightOptions, solve_flight};
use pitchd::simulation::{DetectionNoise, Layout, Scenario, simulate_tracks};

fn scenario(layout: Layout, pitches: usize) -> Scenario {
    let noise = DetectionNoise::gaussian(0.3);
    Scenario::stock(layout, &[0.73, -1.31], pitches).with_detection(noise)
}

fn calibration(c: &mut Criterion) {
    let mut group = c.benchmark_group("calibrate");
    group.sample_size(10);
    for (name, layout) in [("2 cameras", Layout::TwoOpposite), ("3 cameras", Layout::Three)] {
        for pitches in [4, 8, 16, 32] {
            let session = simulate_tracks(&scenario(layout, pitches)).unwrap();
            group.bench_function(BenchmarkId::new(name, pitches), |b| {
                b.iter(|| calibrate(&session.rig, &session.tracks, &CalibrationOptions::default()).unwrap());
            });
        }
    }
    group.finish();
}

fn one_pitch(c: &mut Criterion) {
    let session = simulate_tracks(&scenario(Layout::Three, 8)).unwrap();
    let outcome = calibrate(&session.rig, &session.tracks, &CalibrationOptions::default()).unwrap();
    let options = FlightOptions::for_site(&session.rig.site, outcome.calibration.world);
    for (name, index) in [("solve a four-seamer", 0), ("solve a knuckleball", 6)] {
        let tracks = &outcome.pitches[index].tracks;
        c.bench_function(name, |b| {
            b.iter(|| solve_flight(&outcome.calibration, tracks, &options).unwrap());
        });
    }
}

criterion_group!(benches, one_pitch, calibration);
criterion_main!(benches);
