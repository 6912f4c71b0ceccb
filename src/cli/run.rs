//! `pitchd run`: the daemon in the foreground.

use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use anyhow::Context;
use sd_notify::NotifyState;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;

use crate::capture::aravis::granted_socket_buffer;
use crate::config::{DaemonConfig, RecordMode, load_daemon, load_rig};
use crate::daemon::health::CameraState;
use crate::daemon::pipeline::{self, Daemon};
use crate::export::results::read_calibration;
use crate::scene::{Calibration, WorldFrame};

const AFTER_HELP: &str = "\
Example:
  pitchd run --config /etc/pitchd/pitchd.toml

Pitches come as JSON lines on standard output and in RESULTS/pitches.jsonl. SIGTERM or Ctrl-C finishes the pitch in
flight and exits 0; SIGHUP reads the configuration again: [calibrate], the calibration's file, the recorder's times and
quota change at once, of everything else it says that it needs a restart; a broken file changes nothing.";

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
/// A configuration that cannot be used.
pub fn run(args: &RunArgs) -> anyhow::Result<()> {
    let mut config = load_daemon(&args.config)?;
    let rig = load_rig(&config.rig)?;
    let calibration = first_calibration(&config)?;
    warn_of_small_buffers(&config);
    let mut signals = Signals::new([SIGTERM, SIGINT, SIGHUP]).context("signal handlers")?;
    let daemon = pipeline::start(&config, rig, calibration)?;
    notify(&[NotifyState::Ready]);
    supervise(args, &mut config, &daemon, &mut signals);
    notify(&[NotifyState::Stopping]);
    finish_flight(&daemon);
    let health = daemon.health().to_vec();
    let recorder = daemon.recorder().clone();
    let published = daemon.published().clone();
    daemon.finish();
    for camera in &health {
        tell_line!("pitchd: {}", camera.line());
    }
    if config.record.mode != RecordMode::Off {
        tell_line!("pitchd: {}", recorder.line());
    }
    tell_line!("pitchd: {}", published.line());
    Ok(())
}

fn notify(states: &[NotifyState<'_>]) {
    if let Err(error) = sd_notify::notify(states) {
        tracing::debug!(%error, "systemd was not told");
    }
}

fn warn_of_small_buffers(config: &DaemonConfig) {
    let asked = config
        .cameras
        .iter()
        .map(|c| c.socket_buffer_bytes)
        .max()
        .unwrap_or(0);
    if let Ok(granted) = granted_socket_buffer(asked)
        && granted < asked
    {
        tracing::warn!(
            "socket buffers of {granted} bytes, {asked} were asked for: sysctl -w net.core.rmem_max={asked}"
        );
    }
}

/// Signals, status lines and the watchdog, until it is time to stop.
fn supervise(args: &RunArgs, config: &mut DaemonConfig, daemon: &Daemon, signals: &mut Signals) {
    let begun = Instant::now();
    let mut told = begun;
    let mut watchdog = Watchdog::new(daemon);
    loop {
        for signal in signals.pending() {
            match signal {
                SIGHUP => reload(&args.config, config, daemon),
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
    processed: Vec<u64>,
}

impl Watchdog {
    fn new(daemon: &Daemon) -> Self {
        Self {
            every: sd_notify::watchdog_enabled().map(|limit| limit / 3),
            fed: Instant::now(),
            processed: vec![0; daemon.health().len()],
        }
    }

    fn feed(&mut self, daemon: &Daemon) {
        if self.every.is_none_or(|every| self.fed.elapsed() < every) {
            return;
        }
        let now: Vec<u64> = daemon
            .health()
            .iter()
            .map(|h| h.processed.load(Ordering::Relaxed))
            .collect();
        let stuck = daemon
            .health()
            .iter()
            .zip(now.iter().zip(&self.processed))
            .any(|(h, (now, before))| h.state() == CameraState::Streaming && now == before);
        if !stuck {
            self.fed = Instant::now();
            self.processed = now;
            let streaming = daemon
                .health()
                .iter()
                .filter(|h| h.state() == CameraState::Streaming)
                .count();
            let status = format!("{streaming} of {} cameras streaming", daemon.health().len());
            notify(&[NotifyState::Watchdog, NotifyState::Status(&status)]);
        } else {
            tracing::warn!("a streaming camera's frames are not processed: the watchdog is not fed");
        }
    }
}

/// A broken file changes nothing; of a good one what can change at once does, and the rest is named.
fn reload(path: &Path, running: &mut DaemonConfig, daemon: &Daemon) {
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
        daemon.reload(&new, calibration);
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
