//! The daemon at full rate against cameras in software, each in a network namespace: two of 2048×1024 (or three, or four
//! of 1280×512) at 175 Hz, real UDP, pitches all the while. `make bench-live`, as root:
//!
//! ```text
//! cargo bench --bench full_rate -- --seconds 300 --cameras 2
//! ```
//!
//! Without `--seconds` it does nothing: `cargo bench` is for what takes seconds.
#![allow(missing_docs)]
#![allow(clippy::panic, clippy::unwrap_used, reason = "a bench may")]

mod figures;
#[path = "../../tests/lab/mod.rs"]
mod lab;
mod scene;

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};
use std::time::{Duration, Instant};

use figures::{Account, Due, account, number, part, percentile, wait};
use lab::{Lab, Reaped, unix_s};
use pitchd::time::{HostClock, SystemClock};
use scene::{EVERY_S, Scene};

/// A camera's clock is not known in its first two seconds.
const SETTLED_S: f64 = 3.0;
/// Skew of each camera's clock, ppm.
const SKEWS_PPM: [i32; 4] = [12, -25, 30, 5];

fn argument(name: &str) -> Option<f64> {
    let mut arguments = std::env::args().skip_while(|a| a != name);
    arguments.nth(1)?.parse().ok()
}

struct Run<'a> {
    scene: &'a Scene,
    folder: PathBuf,
    /// Unix time at which the session first begins.
    start_s: f64,
    emulators: Vec<Reaped>,
    daemon: Reaped,
    /// Unix time at which all cameras streamed.
    streaming_s: f64,
}

fn emulator(lab: &Lab, scene: &Scene, folder: &Path, (k, start_s): (usize, f64)) -> Reaped {
    let id = scene.cameras[k];
    let (session, address) = (scene.path("session"), Lab::address(k));
    let (start, every) = (format!("{start_s:.3}"), EVERY_S.to_string());
    let faults = format!("clock_offset_s={},skew_ppm={}", 100 * k, SKEWS_PPM[k]);
    let arguments = [
        ["emulate", session.as_str(), "--camera", id, "--address", &address],
        ["--start-at", &start, "--every", &every, "--faults", &faults],
    ];
    let (out, log) = (folder.join(format!("{id}.out")), folder.join(format!("{id}.log")));
    let namespace = lab.camera(k);
    Reaped(Lab::start(
        (&namespace, Some(30)),
        &arguments.concat(),
        &out,
        &log,
    ))
}

fn text(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_default()
}

impl<'a> Run<'a> {
    fn begin(lab: &Lab, scene: &'a Scene) -> Self {
        let folder = scene.folder.join("run");
        let _ = std::fs::remove_dir_all(&folder);
        std::fs::create_dir_all(&folder).expect("the target folder");
        let count = scene.cameras.len();
        let start_s = unix_s() + 12.0 + 4.0 * count as f64;
        let emulators: Vec<_> = (0..count)
            .map(|k| emulator(lab, scene, &folder, (k, start_s)))
            .collect();
        let ready = |id: &&str| text(&folder.join(format!("{id}.out"))).contains(" at 10.93.");
        let all_ready = wait(Duration::from_secs(60), || scene.cameras.iter().all(ready));
        assert!(
            all_ready && unix_s() < start_s,
            "the emulated cameras were not ready in time"
        );
        let absolute =
            |name: &str| std::fs::canonicalize(scene.folder.join(name)).expect("the session's files");
        let mut config = format!(
            "rig = {:?}\ncalibration = {:?}\nresults = \"results\"\n",
            absolute("sim/rig.toml"),
            absolute("replay/calibration.json")
        );
        for (k, id) in scene.cameras.iter().enumerate() {
            let address = Lab::address(k);
            config +=
                &format!("[[camera]]\nid = \"{id}\"\naddress = \"{address}\"\nrealtime_priority = 20\n");
        }
        let file = folder.join("pitchd.toml");
        std::fs::write(&file, config).expect("the target folder");
        let arguments = ["-v", "run", "--config", file.to_str().expect("a path of text")];
        let (out, log) = (folder.join("out"), folder.join("log"));
        let daemon = Reaped(Lab::start((&lab.host(), None), &arguments, &out, &log));
        let streams = || text(&log).matches("frames come").count() >= count;
        assert!(
            wait(Duration::from_secs(20), streams),
            "no frames:\n{}",
            text(&log)
        );
        Self {
            scene,
            folder,
            start_s,
            emulators,
            daemon,
            streaming_s: unix_s(),
        }
    }

    /// Watches for `seconds`; answers the account of every five of them.
    fn watch(&self, seconds: f64) -> Vec<(f64, Account)> {
        let begun = Instant::now();
        let mut accounts = Vec::new();
        loop {
            let after_s = begun.elapsed().as_secs_f64();
            accounts.extend(account(self.daemon.0.id()).map(|a| (after_s, a)));
            let left_s = seconds - after_s;
            if left_s <= 0.0 {
                return accounts;
            }
            std::thread::sleep(Duration::from_secs_f64(left_s.min(5.0)));
        }
    }

    /// Ends daemon and cameras; answers the daemon's last lines and what each camera says it has sent.
    fn end(&mut self) -> (Vec<String>, Vec<String>) {
        let id = self.daemon.0.id().to_string();
        let told = Command::new("kill").args(["-TERM", &id]).status();
        assert!(
            told.is_ok_and(|s| s.success()),
            "no daemon to end:\n{}",
            text(&self.folder.join("log"))
        );
        let status = self.daemon.0.wait().expect("the daemon's end");
        let log = text(&self.folder.join("log"));
        assert!(status.success(), "{log}");
        for emulator in &mut self.emulators {
            if let Some(pipe) = &mut emulator.0.stdin {
                // One that has ended already is found out below.
                let _ = writeln!(pipe, "quit");
            }
            let _ = emulator.0.wait();
        }
        let sent = self.scene.cameras.iter().map(|id| {
            let out = text(&self.folder.join(format!("{id}.out")));
            out.lines().last().unwrap_or_default().to_owned()
        });
        let lines = log
            .lines()
            .filter(|l| l.starts_with("pitchd: "))
            .map(str::to_owned);
        (lines.collect(), sent.collect())
    }
}

/// A line of the table; answers whether it holds.
fn row(what: &str, found: &str, wanted: Option<(&str, bool)>) -> bool {
    let (wanted, holds) = wanted.unwrap_or(("", true));
    let verdict = if holds { "" } else { "NOT REACHED" };
    let line = format!("{what:<36} {found:<40} {wanted:<16} {verdict}");
    println!("{}", line.trim_end());
    holds
}

fn of_cameras(scene: &Scene, lines: &[String], sent: &[String]) -> bool {
    let mut holds = true;
    for (id, sent) in scene.cameras.iter().zip(sent) {
        let start = format!("pitchd: {id} ");
        let line = lines
            .iter()
            .find(|l| l.starts_with(&start))
            .expect("a line about every camera");
        let (processed, frames) = (number(line, " processed"), number(sent, " frames"));
        let share = 100.0 * processed as f64 / frames.max(1) as f64;
        let found = format!("{processed} of {frames} sent, {share:.3} %");
        holds &= row(
            &format!("{id}: frames processed"),
            &found,
            Some((">= 99.9 %", share >= 99.9)),
        );
        let causes = format!(
            "{} missing ({} incomplete, {} no buffer, {} shape), {} dropped, {} refused, {} not sent in time",
            number(line, " missing"),
            number(line, " incomplete"),
            number(line, " without buffer"),
            number(line, " of another shape"),
            number(line, " dropped"),
            number(line, " refused"),
            number(sent, " skipped")
        );
        row(&format!("{id}: the others by cause"), &causes, None);
        row(
            &format!("{id}: arrival to detected"),
            part(line, "arrival to detected "),
            None,
        );
        row(
            &format!("{id}: path's end to fitted"),
            part(line, "path's end to fitted "),
            None,
        );
    }
    holds
}

fn of_pitches(run: &Run<'_>, lines: &[String], until_s: f64) -> bool {
    let line = lines.last().expect("a line about pitches");
    let rounds = (0..10_000).map(|k| run.start_s + EVERY_S * f64::from(k));
    let rounds = rounds.take_while(|at| *at < until_s + 2.0);
    let thrown: Vec<Due> = rounds
        .flat_map(|at| {
            run.scene.thrown.iter().map(move |t| Due {
                at_s: at + t.after_s,
                plate_m: t.plate_m,
            })
        })
        .collect();
    let to_unix_s = unix_s() - 1e-9 * SystemClock.monotonic().nanos() as f64;
    let due = (run.streaming_s + SETTLED_S, until_s - 1.0);
    let mut pitches = figures::pitches(&run.folder.join("results"), (&thrown, to_unix_s), due);
    let found = format!(
        "{} of {} due, {} wrong",
        pitches.found, pitches.due, pitches.wrong
    );
    let all = pitches.due > 0 && pitches.found == pitches.due && pitches.wrong == 0;
    let mut holds = row("pitches found", &found, Some(("all, none wrong", all)));
    let [p50, p99] = [0.5, 0.99].map(|share| percentile(&mut pitches.miss_mm, share));
    row(
        "their plate against the truth",
        &format!("p50 {p50:.1} p99 {p99:.1} mm"),
        None,
    );
    let latency = part(line, "last needed frame to published ");
    let p99_ms = latency
        .split("p99 ")
        .nth(1)
        .and_then(|t| t.split(' ').next()?.parse::<f64>().ok());
    let in_time = p99_ms.is_some_and(|ms| ms <= 20.0);
    holds &= row(
        "last needed frame to published",
        latency,
        Some(("p99 <= 20 ms", in_time)),
    );
    row(
        "last exposure to published",
        part(line, "last exposure to published "),
        None,
    );
    row(
        "newest frame to estimate",
        part(line, "newest frame to published "),
        None,
    );
    let plates: Vec<_> = run.scene.thrown.iter().map(|t| t.plate_m).collect();
    let mut estimates = figures::estimates(&run.folder.join("out"), &plates);
    let rate = format!("{:.0} Hz over {} flights", estimates.rate_hz, estimates.flights);
    holds &= row(
        "estimates in flight, median rate",
        &rate,
        Some((">= 50 Hz", estimates.rate_hz >= 50.0)),
    );
    let [p50, p90] = [0.5, 0.9].map(|share| percentile(&mut estimates.miss_mm, share));
    let miss = format!(
        "p50 {p50:.0} p90 {p90:.0} mm of {} flights",
        estimates.miss_mm.len()
    );
    row("their miss 150 ms before the plate", &miss, None);
    holds
}

/// Memory after the first minute, and processor time against what reading every frame once would take.
fn of_the_process(run: &Run<'_>, accounts: &[(f64, Account)], read_rate: f64) -> bool {
    let (Some((from_s, first)), Some((until_s, last))) = (accounts.first(), accounts.last()) else {
        return row(
            "processor and memory",
            "no account of the process",
            Some(("", false)),
        );
    };
    let count = run.scene.cameras.len() as f64;
    let busy = 100.0 * (last.cpu_s - first.cpu_s) / (until_s - from_s).max(1e-9) / count;
    let (width, height) = run.scene.size_px;
    let frame_bytes = f64::from(width) * f64::from(height);
    let bound = 100.0 * frame_bytes * run.scene.rate_hz / read_rate;
    let found = format!("{busy:.1} % of a core, {:.1} times the bound", busy / bound);
    row("processor per camera, daemon", &found, None);
    let found = format!("{bound:.2} % of a core ({:.1} GB/s read here)", 1e-9 * read_rate);
    row("its bound: one read of every frame", &found, None);
    let rss = format!("{:.0} MB", last.rss_mb);
    let settled = accounts.iter().find(|(after_s, _)| *after_s >= 60.0);
    let Some((_, settled)) = settled.filter(|_| *until_s >= 90.0) else {
        return row("memory", &format!("{rss} (too short to tell of growth)"), None);
    };
    let growth = last.rss_mb - settled.rss_mb;
    let found = format!("{rss}, {growth:+.2} MB since minute 1");
    row("memory", &found, Some(("< 5 MB growth", growth < 5.0)))
}

fn main() -> ExitCode {
    let Some(seconds) = argument("--seconds") else {
        println!("full_rate: not run (make bench-live)");
        return ExitCode::SUCCESS;
    };
    let cameras = (argument("--cameras").unwrap_or(2.0) as usize).clamp(2, 4);
    let lab = match Lab::new('f', cameras) {
        Ok(lab) => lab,
        Err(why) => panic!("network namespaces are needed, as root: {why}"),
    };
    let scene = Scene::of(cameras);
    let read_rate = figures::streaming_read_rate();
    let mut run = Run::begin(&lab, &scene);
    let accounts = run.watch(seconds);
    let until_s = unix_s();
    let (lines, sent) = run.end();
    let (width, height) = scene.size_px;
    println!(
        "{cameras} cameras of {width}x{height} at {} Hz for {seconds:.0} s",
        scene.rate_hz
    );
    let holds = [
        of_cameras(&scene, &lines, &sent),
        of_pitches(&run, &lines, until_s),
        of_the_process(&run, &accounts, read_rate),
    ];
    match holds.iter().all(|h| *h) {
        true => ExitCode::SUCCESS,
        false => ExitCode::FAILURE,
    }
}
