//! The figures of a full-rate run: from the daemon's own last lines, its results, and the kernel's account of it.

use std::path::Path;
use std::time::{Duration, Instant};

use pitchd::detection::{Isa, Kernels};
use pitchd::export::results::read_pitches;

/// Bytes that one thread reads from memory in a second: half a gigabyte in turn, none of it in a cache; the best of some
/// rounds.
pub fn streaming_read_rate() -> f64 {
    const HALF_BYTES: usize = 1 << 20;
    let frames = vec![[1_u8; 16].repeat(2 * HALF_BYTES / 16); 256];
    let kernels = Kernels::new(Isa::detect());
    let mut best = 0.0_f64;
    for _ in 0..6 {
        let begun = Instant::now();
        for frame in &frames {
            let (one, other) = frame.split_at(HALF_BYTES);
            std::hint::black_box(kernels.read_both(one, other));
        }
        let bytes = (frames.len() * 2 * HALF_BYTES) as f64;
        best = best.max(bytes / begun.elapsed().as_secs_f64());
    }
    best
}

/// Processor time and resident memory of a process.
#[derive(Clone, Copy)]
pub struct Account {
    pub cpu_s: f64,
    pub rss_mb: f64,
}

pub fn account(process: u32) -> Option<Account> {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).ok()?;
    let rss = status.lines().find(|l| l.starts_with("VmRSS:"))?;
    let rss_kib: f64 = rss.split_whitespace().nth(1)?.parse().ok()?;
    let stat = std::fs::read_to_string(format!("/proc/{process}/stat")).ok()?;
    // Behind the name's bracket: utime and stime are the 12th and 13th words, in hundredths of a second.
    let words: Vec<&str> = stat.rsplit_once(')')?.1.split_whitespace().collect();
    let ticks = |k: usize| words.get(k)?.parse::<f64>().ok();
    Some(Account {
        cpu_s: (ticks(11)? + ticks(12)?) / 100.0,
        rss_mb: rss_kib * 1024.0 / 1e6,
    })
}

/// The number right before `word`.
pub fn number(line: &str, word: &str) -> u64 {
    let before = line.split(word).next().unwrap_or_default();
    let digits = before.rsplit([' ', '(']).next().unwrap_or_default();
    digits
        .parse()
        .unwrap_or_else(|_| panic!("no number before {word:?} in {line:?}"))
}

/// What stands between `from` and the next comma or semicolon.
pub fn part<'a>(line: &'a str, from: &str) -> &'a str {
    let rest = line.split(from).nth(1).unwrap_or_default();
    rest.split([',', ';']).next().unwrap_or_default().trim()
}

pub fn percentile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let at = (share * (values.len().max(1) - 1) as f64).round() as usize;
    values.get(at).copied().unwrap_or(f64::NAN)
}

/// A pitch that is due: Unix time at the plate, x and z there.
pub struct Due {
    pub at_s: f64,
    pub plate_m: [f64; 2],
}

/// What became of the pitches.
pub struct Pitches {
    pub due: usize,
    pub found: usize,
    pub wrong: usize,
    /// Distance from the truth at the plate, millimetres.
    pub miss_mm: Vec<f64>,
}

/// `thrown` are all of them; due are those within `(from, until)`. A published pitch is right if one was thrown within 0.1 s
/// that crossed the plate within 5 cm, and that has not been published before.
pub fn pitches(results: &Path, (thrown, to_unix_s): (&[Due], f64), (from, until): (f64, f64)) -> Pitches {
    let mut seen = vec![false; thrown.len()];
    let (mut wrong, mut miss_mm) = (0, Vec::new());
    for pitch in read_pitches(&results.join("pitches.jsonl")).unwrap_or_default() {
        let at_s = to_unix_s + 1e-9 * pitch.plate_time_ns as f64;
        let apart = |d: &Due| (d.at_s - at_s).abs();
        let nearest = thrown
            .iter()
            .enumerate()
            .min_by(|a, b| apart(a.1).total_cmp(&apart(b.1)));
        let Some((which, truth)) = nearest else { continue };
        let [x, z] = [0, 1].map(|k| pitch.plate_front_m[k] - truth.plate_m[k]);
        let off_mm = 1e3 * x.hypot(z);
        if apart(truth) > 0.1 || off_mm > 50.0 || std::mem::replace(&mut seen[which], true) {
            wrong += 1;
            continue;
        }
        miss_mm.push(off_mm);
    }
    let is_due = |d: &Due| (from..until).contains(&d.at_s);
    let due = thrown.iter().zip(&seen).filter(|(d, _)| is_due(d));
    Pitches {
        due: due.clone().count(),
        found: due.filter(|(_, seen)| **seen).count(),
        wrong,
        miss_mm,
    }
}

/// Estimates of balls in flight: their rate while one is told of, and how far they miss 150 ms before the plate.
pub struct Estimates {
    pub flights: usize,
    pub rate_hz: f64,
    pub miss_mm: Vec<f64>,
}

/// From the lines on standard output; a flight's truth is the thrown pitch that its last estimate is nearest to.
pub fn estimates(out: &Path, plates_m: &[[f64; 2]]) -> Estimates {
    let text = std::fs::read_to_string(out).unwrap_or_default();
    let mut flights: std::collections::BTreeMap<u64, Vec<serde_json::Value>> = Default::default();
    for line in text.lines() {
        let line: serde_json::Value = serde_json::from_str(line).unwrap_or_default();
        if let Some(number) = line["in_flight"].as_u64() {
            flights.entry(number).or_default().push(line);
        }
    }
    let plate =
        |line: &serde_json::Value| [0, 1].map(|k| line["plate_front_m"][k].as_f64().unwrap_or(f64::NAN));
    let apart_mm = |a: [f64; 2], b: [f64; 2]| 1e3 * (a[0] - b[0]).hypot(a[1] - b[1]);
    let ns = |line: &serde_json::Value, key: &str| line[key].as_f64().unwrap_or(f64::NAN);
    let (mut rates, mut miss_mm) = (Vec::new(), Vec::new());
    for lines in flights.values() {
        let (Some(first), Some(last)) = (lines.first(), lines.last()) else {
            continue;
        };
        let told = plate(last);
        let truth = plates_m
            .iter()
            .min_by(|a, b| apart_mm(told, **a).total_cmp(&apart_mm(told, **b)));
        let Some(truth) = truth else { continue };
        if lines.len() > 5 {
            let span_s = 1e-9 * (ns(last, "time_ns") - ns(first, "time_ns"));
            rates.push((lines.len() - 1) as f64 / span_s);
        }
        // The last word that came 150 ms before the plate or earlier.
        let early = lines
            .iter()
            .rfind(|l| ns(l, "plate_time_ns") - ns(l, "time_ns") >= 150e6);
        miss_mm.extend(early.map(|line| apart_mm(plate(line), *truth)));
    }
    Estimates {
        flights: flights.len(),
        rate_hz: percentile(&mut rates, 0.5),
        miss_mm,
    }
}

/// Waits until `done`; answers whether it came to that.
pub fn wait(patience: Duration, done: impl Fn() -> bool) -> bool {
    let until = Instant::now() + patience;
    while !done() {
        if Instant::now() >= until {
            return false;
        }
        std::thread::sleep(Duration::from_millis(50));
    }
    true
}
