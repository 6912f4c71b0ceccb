//! `pitchd run`: the daemon in the foreground.

use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use sd_notify::NotifyState;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;

use crate::config::{DaemonConfig, RecordMode, load_daemon, load_rig};
use crate::daemon::ending::STOP_MOST;
use crate::daemon::health::CameraState;
use crate::daemon::memory_lock::lock_memory;
use crate::daemon::pipeline::{self, Daemon, NotTaken};
use crate::export::results::read_calibration;
use crate::scene::{Calibration, WorldFrame};

const AFTER_HELP: &str = "\
Example:
  pitchd run --config /etc/pitchd/pitchd.toml

Pitches come as JSON lines on standard output and in RESULTS/pitches.jsonl. SIGTERM or Ctrl-C finishes the pitch in
flight and exits 0 (1, with their names, if threads are still at work 25 s later); SIGHUP reads the configuration again:
[calibrate], the calibration's file, the recorder's times and quota change at once, of everything else it says that it
needs a restart; a broken file changes nothing.";

/// Arguments of `pitchd run`.
#[derive(Debug, clap::Args)]
#[command(after_help = AFTER_HELP)]
pub struct RunArgs {
    /// The daemon's file.
    #[arg(long, value_name = "FILE", default_value = "/etc/pitchd/pitchd.toml")]
    pub config: PathBuf,
    /// Stop after this many seconds.
    #[arg(long, value_name = "S")]
    pub seconds: Option<f64>,
    /// Seconds between two lines about every camera on the log; 0: none.
    #[arg(long, value_name = "S", default_value_t = 10.0)]
    pub status_every: f64,
}

/// Runs until a signal.
///
/// # Errors
/// A configuration that cannot be used; threads that had to be cut off at the end.
pub fn run(args: &RunArgs) -> anyhow::Result<()> {
    let mut config = load_daemon(&args.config)?;
    let rig = load_rig(&config.rig)?;
    let calibration = first_calibration(&config)?;
    if let Err(error) = lock_memory() {
        tracing::warn!("{error}");
    }
    let mut signals = Signals::new([SIGTERM, SIGINT, SIGHUP]).context("signal handlers")?;
    let daemon = pipeline::start(&config, rig, calibration)?;
    notify(&[NotifyState::Ready]);
    supervise(args, &mut config, &daemon, &mut signals);
    notify(&[NotifyState::Stopping]);
    finish_flight(&daemon);
    let health = daemon.health().to_vec();
    let recorder = daemon.recorder().clone();
    let published = daemon.published().clone();
    let cut_off = daemon.finish();
    for camera in &health {
        tell_line!("pitchd: {}", camera.line());
    }
    if config.record.mode != RecordMode::Off {
        tell_line!("pitchd: {}", recorder.line());
    }
    tell_line!("pitchd: {}", published.line());
    ended(&cut_off)
}

/// An end that cut something off is a failure that names it.
fn ended(cut_off: &[String]) -> anyhow::Result<()> {
    if cut_off.is_empty() {
        return Ok(());
    }
    bail!(
        "still at work {} s after the end was asked for, and cut off: {}; see whether the disk of `results` and \
         `[record] folder` stands still",
        STOP_MOST.as_secs(),
        cut_off.join(", ")
    );
}

fn notify(states: &[NotifyState<'_>]) {
    if let Err(error) = sd_notify::notify(states) {
        tracing::debug!(%error, "systemd was not told");
    }
}

/// Signals, status lines and the watchdog, until it is time to stop.
fn supervise(args: &RunArgs, config: &mut DaemonConfig, daemon: &Daemon, signals: &mut Signals) {
    let begun = Instant::now();
    let mut told = begun;
    let mut watchdog = Watchdog::new();
    loop {
        for signal in signals.pending() {
            match signal {
                SIGHUP => reload(&args.config, config, |new, calibration| {
                    daemon.reload(new, calibration)
                }),
                _ => return,
            }
        }
        if args.seconds.is_some_and(|s| begun.elapsed().as_secs_f64() >= s) {
            return;
        }
        if args.status_every > 0.0 && told.elapsed().as_secs_f64() >= args.status_every {
            told = Instant::now();
            for camera in daemon.health() {
                tracing::info!("{}", camera.line());
            }
            tracing::info!("{}", daemon.published().line());
        }
        watchdog.feed(daemon);
        std::thread::sleep(Duration::from_millis(50));
    }
}

/// A ball in flight is followed to its end. Longer than a slow pitch flies it can only be something else.
fn finish_flight(daemon: &Daemon) {
    let begun = Instant::now();
    let flies = || {
        daemon
            .health()
            .iter()
            .any(|h| h.in_flight.load(Ordering::Relaxed))
    };
    while flies() && begun.elapsed() < FLIGHT_MOST {
        std::thread::sleep(Duration::from_millis(10));
    }
}

const FLIGHT_MOST: Duration = Duration::from_millis(1200);

/// Feeds systemd's watchdog only while frames are really processed: of every camera that streams, more than before.
struct Watchdog {
    every: Option<Duration>,
    fed: Instant,
    progress: Progress,
}

impl Watchdog {
    fn new() -> Self {
        Self {
            every: sd_notify::watchdog_enabled().map(|limit| limit / 3),
            fed: Instant::now(),
            progress: Progress::default(),
        }
    }

    fn feed(&mut self, daemon: &Daemon) {
        let Some(late) = self.every.and_then(|every| self.fed.elapsed().checked_sub(every)) else {
            return;
        };
        let now = daemon.health().iter();
        let now: Vec<_> = now
            .map(|h| (h.state(), h.processed.load(Ordering::Relaxed)))
            .collect();
        match self.progress.look(&now, late) {
            Verdict::Wait => return,
            Verdict::Stuck(k) => {
                let camera = daemon.health().get(k).map(|h| h.camera.to_string());
                tracing::warn!(
                    camera,
                    "its frames come and are not processed: the watchdog is not fed"
                );
                return;
            }
            Verdict::MovesAgain => tracing::info!("frames are processed again: the watchdog is fed"),
            Verdict::Moves => {}
        }
        self.fed = Instant::now();
        let streaming = now.iter().filter(|(s, _)| *s == CameraState::Streaming).count();
        let status = format!("{streaming} of {} cameras streaming", now.len());
        notify(&[NotifyState::Watchdog, NotifyState::Status(&status)]);
    }
}

/// What a look at the cameras' counters says.
#[derive(Debug, PartialEq, Eq)]
enum Verdict {
    /// Every streaming camera's frames are processed.
    Moves,
    /// The same, after [`Self::Stuck`].
    MovesAgain,
    /// This camera's are not; said once.
    Stuck(usize),
    /// They are not, which has been said or is too new to say.
    Wait,
}

/// Frames processed by each camera at the last feeding.
#[derive(Default)]
struct Progress {
    processed: Vec<u64>,
    told: bool,
}

/// A camera that has just come back has had no frame processed yet.
const STUCK: Duration = Duration::from_secs(1);

impl Progress {
    /// `late`: for how long the watchdog has been due.
    fn look(&mut self, now: &[(CameraState, u64)], late: Duration) -> Verdict {
        let stuck = now.iter().enumerate().find(|(k, (state, processed))| {
            *state == CameraState::Streaming && self.processed.get(*k) == Some(processed)
        });
        let Some((k, _)) = stuck else {
            self.processed = now.iter().map(|(_, processed)| *processed).collect();
            return match std::mem::take(&mut self.told) {
                true => Verdict::MovesAgain,
                false => Verdict::Moves,
            };
        };
        if late < STUCK || self.told {
            return Verdict::Wait;
        }
        self.told = true;
        Verdict::Stuck(k)
    }
}

/// A broken file changes nothing; of a good one what can change at once does, and the rest is named. What `hand_on`
/// refuses is not in use, and the next signal tries it again.
fn reload(
    path: &Path,
    running: &mut DaemonConfig,
    hand_on: impl FnOnce(&DaemonConfig, Option<Calibration>) -> Result<(), NotTaken>,
) {
    let new = match load_daemon(path).and_then(|new| load_rig(&new.rig).map(|_| new)) {
        Ok(new) => new,
        Err(error) => {
            tracing::error!("reload refused, nothing has changed: {error}");
            return;
        }
    };
    let (later, now) = (new.needs_restart(running), new.holds_at_once(running));
    let calibration = match &new.calibration {
        Some(file) if new.calibration != running.calibration => match read_calibration(file) {
            Ok(calibration) => Some(calibration),
            Err(error) => {
                tracing::error!("reload refused, nothing has changed: calibration: {error}");
                return;
            }
        },
        _ => None,
    };
    if !now.is_empty() {
        if let Err(error) = hand_on(&new, calibration) {
            tracing::error!("reload refused, nothing has changed: {error}");
            return;
        }
        tracing::info!("reload: in use at once: {}", now.join(", "));
        running.take_what_holds_at_once(&new);
    }
    if !later.is_empty() {
        tracing::warn!("reload: these hold after a restart: {}", later.join(", "));
    }
    if now.is_empty() && later.is_empty() {
        tracing::info!("reload: nothing has changed");
    }
}

/// The calibration to begin with: the one that the file names, else the last that an earlier run has published.
fn first_calibration(config: &DaemonConfig) -> anyhow::Result<Option<Calibration>> {
    if let Some(file) = &config.calibration {
        return Ok(Some(read_calibration(file)?));
    }
    let last = config.results.join("calibration.json");
    if !last.exists() {
        return Ok(None);
    }
    match read_calibration(&last) {
        Ok(calibration) if calibration.world == WorldFrame::HomePlate => {
            tracing::info!(file = %last.display(), version = calibration.version, "going on with the last calibration");
            Ok(Some(calibration))
        }
        Ok(_) => Ok(None),
        Err(error) => {
            tracing::warn!(%error, "the last calibration cannot be read: the first pitches calibrate");
            Ok(None)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stuck_camera_is_told_of_once_and_so_is_its_return() {
        use CameraState::{Absent, Streaming};
        let (soon, late) = (Duration::ZERO, Duration::from_secs(2));
        let mut progress = Progress::default();
        assert_eq!(
            progress.look(&[(Streaming, 5), (Absent, 0)], soon),
            Verdict::Moves
        );
        assert_eq!(
            progress.look(&[(Streaming, 9), (Streaming, 0)], soon),
            Verdict::Wait
        );
        assert_eq!(
            progress.look(&[(Streaming, 9), (Streaming, 0)], late),
            Verdict::Stuck(1)
        );
        for _ in 0..100 {
            assert_eq!(
                progress.look(&[(Streaming, 20), (Streaming, 0)], late),
                Verdict::Wait
            );
        }
        assert_eq!(
            progress.look(&[(Streaming, 21), (Streaming, 3)], late),
            Verdict::MovesAgain
        );
        assert_eq!(
            progress.look(&[(Streaming, 22), (Streaming, 4)], soon),
            Verdict::Moves
        );
        assert_eq!(
            progress.look(&[(Absent, 22), (Absent, 4)], soon),
            Verdict::Moves,
            "nothing streams"
        );
    }

    #[test]
    fn an_end_that_cuts_off_is_a_failure_with_names() {
        assert!(ended(&[]).is_ok());
        let error = ended(&["keep".to_owned(), "disk".to_owned()]).unwrap_err();
        assert!(error.to_string().contains("cut off: keep, disk;"), "{error}");
    }

    #[test]
    fn settings_that_nobody_took_are_tried_again() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pitchd.toml");
        let rig = "[[camera]]\nid = \"first\"\nwidth_px = 64\nheight_px = 32\nframe_rate_hz = 40.0\n[camera.intrinsics]\n\
                   fx_px = 60.0\nfy_px = 60.0\ncx_px = 31.5\ncy_px = 15.5\n";
        std::fs::write(folder.path().join("rig.toml"), rig).unwrap();
        let write = |every: usize| {
            let text = format!(
                "rig = \"rig.toml\"\n[calibrate]\nevery_pitches = {every}\n[[camera]]\nid = \"first\"\naddress = \"10.0.0.5\"\n"
            );
            std::fs::write(&path, text).unwrap();
        };
        write(4);
        let mut running = load_daemon(&path).unwrap();
        write(5);
        let mut asked = Vec::new();
        for busy in [true, true, false, false] {
            reload(&path, &mut running, |new, _| {
                asked.push((busy, new.recalibrate_every));
                if busy { Err(NotTaken("assemble")) } else { Ok(()) }
            });
            assert_eq!(running.recalibrate_every, if busy { 4 } else { 5 });
        }
        assert_eq!(
            asked,
            [(true, 5), (true, 5), (false, 5)],
            "what is in use is not handed on again"
        );
    }
}
