//! The publisher's thread: each pitch as one line of JSON, to the keeper and to standard output; and the printer's.

use std::io::Write;
use std::sync::atomic::{AtomicU64, Ordering};

use crossbeam_channel::{Receiver, Sender, TrySendError};

use super::assemble::Published;
use super::histogram::{Histogram, seconds_since};
use super::keep::KeptPitch;
use crate::export::results;
use crate::scene::Outlook;

/// What was published and how late, for anyone to read.
#[derive(Debug, Default)]
pub struct PublishHealth {
    /// Pitches published.
    pub pitches: AtomicU64,
    /// Estimates of balls in flight.
    pub estimates: AtomicU64,
    /// Lines that a slow reader of standard output did not take.
    pub lines_dropped: AtomicU64,
    /// From the arrival of the last frame that a pitch needed to its publication; pitches that waited for a calibration
    /// are not in it.
    pub since_needed: Histogram,
    /// From the exposure midpoint of a pitch's last point to its publication.
    pub since_exposure: Histogram,
    /// From the exposure midpoint of an estimate's newest point to its publication.
    pub estimate_age: Histogram,
    /// From the arrival of the newest frame to the estimate's publication.
    pub estimate_latency: Histogram,
}

impl PublishHealth {
    /// One line for people.
    pub fn line(&self) -> String {
        let get = |n: &AtomicU64| n.load(Ordering::Relaxed);
        format!(
            "{} pitches, last needed frame to published {}, last exposure to published {}; {} estimates in flight, \
             newest frame to published {}, newest exposure to published {}; {} lines not taken",
            get(&self.pitches),
            self.since_needed.in_words(),
            self.since_exposure.in_words(),
            get(&self.estimates),
            self.estimate_latency.in_words(),
            self.estimate_age.in_words(),
            get(&self.lines_dropped),
        )
    }
}

/// A line about a ball in flight.
#[derive(serde::Serialize)]
struct InFlightLine<'a> {
    /// Number of the flight in this run.
    in_flight: u32,
    calibration_version: u32,
    #[serde(flatten)]
    outlook: &'a Outlook,
}

/// The line that tells of a ball in flight.
pub fn in_flight_line(outlook: &Outlook, flight: u32, calibration_version: u32) -> Option<String> {
    let line = InFlightLine {
        in_flight: flight,
        calibration_version,
        outlook,
    };
    serde_json::to_string(&line).ok().map(|text| text + "\n")
}

/// Sends every pitch on as a line, until they end. Nothing here waits: not for a reader of standard output (`lines` is a
/// short queue to a thread of its own), not for a disk (`keep` is one).
pub fn publish(
    pitches: &Receiver<Published>,
    (lines, keep): (&Sender<String>, &Sender<KeptPitch>),
    health: &PublishHealth,
) {
    for published in pitches {
        let number = published.pitch.pitch;
        let line = match results::jsonl(std::slice::from_ref(&published.pitch)) {
            Ok(line) => line,
            Err(error) => {
                tracing::error!(%error, pitch = number, "not written");
                continue;
            }
        };
        if let Err(TrySendError::Full(_)) = lines.try_send(line.clone()) {
            health.lines_dropped.fetch_add(1, Ordering::Relaxed);
        }
        let needed_s = published.complete.map(|at| seconds_since(at.nanos()));
        needed_s.iter().for_each(|s| health.since_needed.add_s(*s));
        if let Some(exposed) = published.exposed {
            health.since_exposure.add_since_ns(exposed.nanos());
        }
        health.pitches.fetch_add(1, Ordering::Relaxed);
        tracing::info!(
            pitch = number,
            speed_mps = published.pitch.release_speed_mps,
            since_last_frame_ms = needed_s.map(|s| 1e3 * s),
            "pitch"
        );
        let kept = KeptPitch {
            line,
            tracks: published.tracks,
        };
        if keep.try_send(kept).is_err() {
            tracing::error!(pitch = number, "not in pitches.jsonl: the disk is far behind");
        }
    }
}

/// Prints lines until pitches end, pitches before estimates; blocks when nobody reads, and then only itself.
pub fn print(pitches: &Receiver<String>, estimates: &Receiver<String>) {
    let mut estimates = Some(estimates);
    loop {
        let never = crossbeam_channel::never();
        let line = crossbeam_channel::select_biased! {
            recv(pitches) -> line => match line {
                Ok(line) => line,
                Err(_) => return,
            },
            recv(estimates.unwrap_or(&never)) -> line => match line {
                Ok(line) => line,
                Err(_) => {
                    estimates = None;
                    continue;
                }
            },
        };
        let mut out = std::io::stdout().lock();
        if out.write_all(line.as_bytes()).and_then(|()| out.flush()).is_err() {
            return;
        }
    }
}
