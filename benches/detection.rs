//! The detector against the speed of memory and against OpenCV, interleaved in one process on one thread.
//!
//! `cargo bench --bench detection`. Not criterion: ratios on a shared machine are only fair when every contender
//! meets the same minute, so all take turns, round by round, and medians are compared. Fresh 2048×1024 frames
//! from a ring of 32.

#![allow(clippy::unwrap_used, reason = "a bench may")]

use std::hint::black_box;
use std::sync::Arc;
use std::time::Instant;

use pitchd::detection::{Answers, Detector, DetectorConfig, Isa, Kernels};
use pitchd::emulation::pack;
use pitchd::scene::{Detection, Frame, FrameStamp, PixelFormat, RawFrame};
use pitchd::time::StampedMidpoint;
use pitchd::vision::DifferenceBaseline;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

const WIDTH: usize = 2048;
const HEIGHT: usize = 1024;
const RING: usize = 32;
const ROUNDS: usize = 12;

struct Count(usize);

impl Answers for Count {
    fn answer(&mut self, _stamp: FrameStamp, detections: &[Detection]) {
        self.0 += detections.len();
    }
}

/// A ring of noisy frames (σ about 1.5) with a ball and some textured movers of 70×170 pixels.
fn ring(movers: usize) -> Vec<Arc<Vec<u8>>> {
    let mut random = Pcg64Mcg::seed_from_u64(5);
    let stand: Vec<u8> = (0..WIDTH * HEIGHT)
        .map(|_| random.random_range(60..120))
        .collect();
    let cloth: Vec<u8> = (0..70 * 170)
        .map(|i| ((i / 9 % 2) * 60 + 100 + i % 70 / 9 * 4) as u8)
        .collect();
    (0..RING)
        .map(|number| {
            let mut pixels: Vec<u8> = stand
                .iter()
                .map(|v| {
                    let noise: [u8; 2] = [random.random_range(0..4), random.random_range(0..4)];
                    v + noise[0] + noise[1]
                })
                .collect();
            for mover in 0..movers {
                let left = (mover * 239) % (WIDTH - 300) + 4 * number;
                let top = (mover * 173) % (HEIGHT - 180);
                for y in 0..170 {
                    let at = (top + y) * WIDTH + left;
                    pixels[at..at + 70].copy_from_slice(&cloth[y * 70..(y + 1) * 70]);
                }
            }
            let (x, y) = (200 + 20 * number, 300);
            for dy in 0..6 {
                pixels[(y + dy) * WIDTH + x..(y + dy) * WIDTH + x + 8].fill(210);
            }
            Arc::new(pixels)
        })
        .collect()
}

fn frame(number: usize, pixels: &Arc<Vec<u8>>) -> Frame {
    Frame {
        stamp: FrameStamp {
            frame: number as u64,
            device: None,
            arrival: None,
            stamped: StampedMidpoint::from_nanos(number as i64 * 5_714_286),
        },
        width_px: WIDTH as u32,
        height_px: HEIGHT as u32,
        pixels: pixels.clone(),
    }
}

fn median(times: &mut [f64]) -> f64 {
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

/// A contender with its times in milliseconds a frame.
struct Contender<'a> {
    name: String,
    run: Box<dyn FnMut(usize) + 'a>,
    times_ms: Vec<f64>,
}

fn detector(lag_frames: usize, isa: Isa) -> Detector {
    let config = DetectorConfig {
        lag_frames,
        ..DetectorConfig::default()
    };
    Detector::with_isa(config, WIDTH as u32, HEIGHT as u32, isa)
}

/// A detector that searches a ring.
fn search<'a>(name: String, mut detector: Detector, ring: &'a [Arc<Vec<u8>>]) -> Contender<'a> {
    Contender {
        name,
        run: Box::new(move |i| {
            let mut found = Count(0);
            detector.detect(&frame(i, &ring[i % RING]), &mut found).unwrap();
            black_box(found.0);
        }),
        times_ms: Vec::new(),
    }
}

/// The same of frames as a camera packs them.
fn search_packed<'a>(format: PixelFormat, ring: &[Arc<Vec<u8>>]) -> Contender<'a> {
    let packed: Vec<RawFrame> = ring
        .iter()
        .map(|levels| RawFrame {
            format,
            pixels: Arc::new(pack(format, levels)),
            ..RawFrame::from(frame(0, levels))
        })
        .collect();
    let mut detector = detector(1, Isa::detect());
    Contender {
        name: format!("detector, 0 movers, lag 1, {format}"),
        run: Box::new(move |i| {
            let mut found = Count(0);
            let mut raw = packed[i % RING].clone();
            raw.stamp.frame = i as u64;
            raw.stamp.stamped = StampedMidpoint::from_nanos(i as i64 * 5_714_286);
            detector.detect_raw(&raw, &mut found).unwrap();
            black_box(found.0);
        }),
        times_ms: Vec::new(),
    }
}

/// OpenCV on a ring: contours, or components.
fn opponent<'a>(name: String, components: bool, ring: &'a [Arc<Vec<u8>>]) -> Contender<'a> {
    let mut baseline = DifferenceBaseline::new();
    Contender {
        name,
        run: Box::new(move |i| {
            let (c, p) = (&ring[i % RING], &ring[(i + RING - 1) % RING]);
            if components {
                black_box(baseline.components(c, p, WIDTH as i32, 20.0).unwrap());
            } else {
                black_box(baseline.contours(c, p, WIDTH as i32, 20.0).unwrap());
            }
        }),
        times_ms: Vec::new(),
    }
}

/// Several cameras on one thread, frame by frame in turn; the time is one frame's.
fn cameras<'a>(count: usize, ring: &'a [Arc<Vec<u8>>]) -> Contender<'a> {
    let mut detectors: Vec<Detector> = (0..count).map(|_| detector(1, Isa::detect())).collect();
    Contender {
        name: format!("detector, camera {count} of {count} on one thread"),
        run: Box::new(move |i| {
            // Each camera has frames of its own: the same ring, begun elsewhere.
            let (camera, number) = (i % count, i / count);
            let pixels = &ring[(number + camera * RING / count) % RING];
            let mut found = Count(0);
            detectors[camera]
                .detect(&frame(number, pixels), &mut found)
                .unwrap();
            black_box(found.0);
        }),
        times_ms: Vec::new(),
    }
}

fn main() {
    let crowds: Vec<(usize, Vec<Arc<Vec<u8>>>)> = [0, 1, 8, 50].map(|movers| (movers, ring(movers))).into();
    let kernels = Kernels::new(Isa::detect());
    let quiet = &crowds[0].1;
    let mut contenders = vec![Contender {
        name: "read two streams".into(),
        run: Box::new(|i| {
            black_box(kernels.read_both(&quiet[i % RING], &quiet[(i + RING - 1) % RING]));
        }),
        times_ms: Vec::new(),
    }];
    for isa in Isa::available() {
        contenders.push(search(
            format!("detector {isa:?}, quiet"),
            detector(1, *isa),
            quiet,
        ));
    }
    for (movers, ring) in &crowds {
        for lag in [1, DetectorConfig::default().lag_frames] {
            let name = format!("detector, {movers} movers, lag {lag}");
            contenders.push(search(name, detector(lag, Isa::detect()), ring));
        }
    }
    let formats = [
        PixelFormat::Mono10p,
        PixelFormat::Mono12p,
        PixelFormat::Mono12Packed,
    ];
    contenders.extend(formats.map(|format| search_packed(format, quiet)));
    contenders.extend([2, 4, 8].map(|count| cameras(count, quiet)));
    for (movers, ring) in crowds.iter().filter(|(movers, _)| matches!(movers, 0 | 8)) {
        let name = format!("OpenCV absdiff+threshold+findContours, {movers} movers");
        contenders.push(opponent(name, false, ring));
    }
    let name = "OpenCV absdiff+threshold+connectedComponentsWithStats";
    contenders.push(opponent(name.into(), true, quiet));
    for round in 0..ROUNDS {
        for contender in &mut contenders {
            for i in 0..2 * RING {
                let begin = Instant::now();
                (contender.run)(round * 2 * RING + i);
                contender.times_ms.push(1e3 * begin.elapsed().as_secs_f64());
            }
        }
    }
    let medians: Vec<(String, f64)> = contenders
        .iter_mut()
        .map(|c| (c.name.clone(), median(&mut c.times_ms)))
        .collect();
    let limit = medians[0].1;
    let quiet = medians
        .iter()
        .find(|m| m.0 == "detector, 0 movers, lag 1")
        .map_or(limit, |m| m.1);
    println!(
        "{:55} {:>9} {:>16} {:>15}",
        "median of one 2048x1024 frame", "ms", "share of limit", "over quiet"
    );
    for (name, ms) in &medians {
        let (share, over) = (100.0 * limit / ms, ms / quiet);
        println!("{name:55} {ms:9.3} {share:15.0}% {over:14.2}x");
    }
}
