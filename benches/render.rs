//! Frames per second of the renderer at 2048×1024 on one core, clean and hard looks.
#![allow(missing_docs)]

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use pitchd::simulation::{CameraRenderer, Layout, Preset, Scenario};

fn render(c: &mut Criterion) {
    let mut group = c.benchmark_group("render_2048x1024");
    group.throughput(Throughput::Elements(1)).sample_size(30);
    for (name, preset) in [("clean", Preset::Clean), ("hard", Preset::Hard)] {
        let mut scenario = Scenario::stock(Layout::Three, &[0.4, -0.7], 2);
        scenario.render.preset = preset;
        let mut renderer = CameraRenderer::new(&scenario, 0).expect("stock scenarios are valid");
        let exposures: Vec<_> = renderer.exposures().collect();
        let mut pixels = vec![0u8; 2048 * 1024];
        let mut next = exposures.iter().cycle();
        group.bench_function(name, |b| {
            b.iter(|| {
                if let Some(exposure) = next.next() {
                    renderer.render(exposure, black_box(&mut pixels));
                }
            });
        });
    }
    group.finish();
    let mut group = c.benchmark_group("render_2048x1024_background");
    group.sample_size(10).bench_function("still", |b| {
        let scenario = Scenario::stock(Layout::TwoOpposite, &[], 1);
        b.iter(|| CameraRenderer::new(black_box(&scenario), 0).map(|r| r.size_px()));
    });
    group.finish();
}

criterion_group! {
    name = benches;
    config = Criterion::default().measurement_time(std::time::Duration::from_secs(4));
    targets = render
}
criterion_main!(benches);
