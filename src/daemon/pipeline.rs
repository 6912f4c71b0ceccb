//! The whole daemon on one page: every thread, every queue, who stops whom.
//!
//! ```text
//! cap-<id> ─(1)─► eye-<id> ─┐
//! cap-<id> ─(1)─► eye-<id> ─┼─(2)─► assemble ─(5)─► publish ─(6)─► print
//!     …               …     ┘        │    ▲    ─(7)─►   │
//!                                   (3)  (4)            └─► pitches.jsonl, calibration.json, tracks/
//!                                    ▼    │
//!                                   calibrate
//!
//! cap-<id> ─(8)─► record ─(9)─► disk ─► recordings/        assemble ─(10)─► record
//! ```
//!
//! | thread | takes | gives | queue | when that is full |
//! |---|---|---|---|---|
//! | `cap-<id>` | the camera | frames (in place, from its pool) | (1) ¾ of the pool | the frame is dropped, counted as `dropped` |
//! | `eye-<id>` | frames | tracks of balls | (2) 256 tracks | waits; (1) then drops |
//! | `assemble` | tracks, (4) | pitches | (5) 64 pitches | the pitch is not published, logged as an error |
//! | | | requests | (3) 1 request | asked again with the next pitch |
//! | | | calibrations | (7) 8 | logged as an error; the calibration is used all the same |
//! | `calibrate` | requests | answers | (4) 1 answer | waits |
//! | `publish` | pitches | file, lines | (6) 64 lines | the line is dropped, counted |
//! | `cap-<id>` | | frames, the same memory | (8) 64 frames | the frame is not recorded, counted |
//! | `record` | (8), (10) | clips | (9) 4 clips, or 64 frames of a continuous recording | the clip or frame is lost, counted |
//! | `assemble` | | balls to cut out | (10) 16 | the clip is lost, logged as an error |
//! | `disk` | (9) | session folders | – | blocks alone |
//! | `print` | lines | standard output | – | blocks alone |
//!
//! Stopping is closing: capture threads stop, each closes its queue, and the end travels downstream in the order
//! frames do; a pitch in flight is finished on the way.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use crossbeam_channel::{Sender, bounded};

use super::assemble::{self, Assembler, CalibrationPlan};
use super::clip_disk::ClipDisk;
use super::health::CameraHealth;
use super::publish::{self, PublishLog};
use super::recorder::{ClipTrigger, RecordedLive, Recorder, RecorderHealth};
use super::supervise::Supervisor;
use super::watcher::{self, SeenTrack};
use crate::capture::aravis::{CameraAddress, LiveOptions, PacketPath, Ptp};
use crate::config::{CameraConnection, DaemonConfig, RecordMode};
use crate::eye::EyeConfig;
use crate::scene::{Calibration, Rig};

/// Why the daemon cannot start.
#[derive(Debug, thiserror::Error)]
pub enum DaemonError {
    /// A connection to a camera that the rig does not have.
    #[error("{file}: camera `{camera}` is not in the rig {rig}")]
    NotInRig {
        /// Daemon file.
        file: String,
        /// Camera.
        camera: String,
        /// Rig file.
        rig: String,
    },
    /// No thread to be had.
    #[error("thread {name}: {source}")]
    Thread {
        /// Its name.
        name: String,
        /// The system's words.
        source: std::io::Error,
    },
}

/// A running daemon.
pub struct Daemon {
    stop: Arc<AtomicBool>,
    health: Vec<Arc<CameraHealth>>,
    recorder: Arc<RecorderHealth>,
    threads: Vec<JoinHandle<()>>,
    publisher: JoinHandle<PublishLog>,
}

/// Makes every queue and starts every thread.
///
/// # Errors
/// [`DaemonError`].
pub fn start(
    config: &DaemonConfig,
    rig: Rig,
    calibration: Option<Calibration>,
) -> Result<Daemon, DaemonError> {
    let stop = Arc::new(AtomicBool::new(false));
    let mut threads = Vec::new();
    let (tracks_in, tracks) = bounded::<SeenTrack>(256);
    let (requests_in, requests) = bounded(1);
    let (answers_in, answers) = bounded(1);
    let (pitches_in, pitches) = bounded(64);
    let (versions_in, versions) = bounded(8);
    let (lines_in, lines) = bounded::<String>(64);

    let rig = with_stamps_roughly_alike(rig);
    let recorder = Arc::new(RecorderHealth::default());
    let record = start_recorder(config, &recorder, &mut threads)?;
    let mut health = Vec::new();
    let mut captures = Vec::new();
    for connection in &config.cameras {
        let options = live_options(config, connection, &rig)?;
        let own = Arc::new(CameraHealth::new(connection.id.clone()));
        // The rest of the pool is for the receive thread and the eye's own history.
        let (frames_in, frames) = bounded((connection.buffers * 3 / 4).max(4));
        let supervisor = Supervisor {
            options,
            frames: frames_in,
            record: record
                .as_ref()
                .map(|(frames, _)| (frames.clone(), recorder.clone())),
            health: own.clone(),
            stop: stop.clone(),
        };
        captures.push((format!("cap-{}", connection.id), supervisor));
        let eye = EyeConfig::of_rig(&rig, &connection.id);
        let (eye_health, eye_tracks): (_, Sender<SeenTrack>) = (own.clone(), tracks_in.clone());
        threads.push(named(format!("eye-{}", connection.id), move || {
            watcher::watch(&frames, &eye_tracks, &eye, &eye_health);
        })?);
        health.push(own);
    }
    drop(tracks_in);

    let assembler = Assembler {
        rig: rig.clone(),
        numbers_before: publish::last_number(&config.results),
        calibration: calibration.map(|c| {
            let epochs = assemble::first_epochs(&c);
            (c, epochs)
        }),
        plan: CalibrationPlan {
            first_pitches: config.first_pitches,
            window_pitches: config.window_pitches,
            every_pitches: config.recalibrate_every,
        },
        health: health.clone(),
        requests: requests_in,
        clips: record.map(|(_, clips)| clips),
        publish: pitches_in,
        versions: versions_in,
    };
    threads.push(named("assemble".into(), move || {
        assembler.run(&tracks, &answers)
    })?);
    threads.push(named("calibrate".into(), move || {
        assemble::calibrate(&rig, &requests, &answers_in);
    })?);
    threads.push(named("print".into(), move || publish::print(&lines))?);
    let folder = config.results.clone();
    let publisher = spawn("publish".into(), move || {
        publish::publish(&folder, &pitches, &versions, &lines_in)
    })?;
    // Cameras last: everything downstream is ready for their first frame.
    for (name, supervisor) in captures {
        threads.push(named(name, move || supervisor.run())?);
    }
    Ok(Daemon {
        stop,
        health,
        recorder,
        threads,
        publisher,
    })
}

impl Daemon {
    /// Health of every camera.
    pub fn health(&self) -> &[Arc<CameraHealth>] {
        &self.health
    }

    /// What has been recorded.
    pub fn recorder(&self) -> &Arc<RecorderHealth> {
        &self.recorder
    }

    /// Asks every camera to stop; what they have sent is finished.
    pub fn request_stop(&self) {
        self.stop.store(true, Ordering::Relaxed);
    }

    /// Stops, waits for the last pitch, and tells what was published.
    pub fn finish(self) -> PublishLog {
        self.request_stop();
        let Self {
            threads, publisher, ..
        } = self;
        let log = publisher.join().unwrap_or_default();
        for thread in threads {
            // `print` may be blocked by a reader that stands still: it is left to the process's end.
            if thread.thread().name() != Some("print") && thread.join().is_err() {
                tracing::error!("a thread ended by a panic");
            }
        }
        log
    }
}

type ToRecorder = (Sender<RecordedLive>, Sender<ClipTrigger>);

/// The recorder's two threads, if anything is to be recorded.
fn start_recorder(
    config: &DaemonConfig,
    health: &Arc<RecorderHealth>,
    threads: &mut Vec<JoinHandle<()>>,
) -> Result<Option<ToRecorder>, DaemonError> {
    if config.record.mode == RecordMode::Off {
        return Ok(None);
    }
    let (frames_in, frames) = bounded(64);
    let (clips_in, clips) = bounded(16);
    let (jobs_in, jobs) = bounded(match config.record.mode {
        RecordMode::Continuous => 64,
        _ => 4,
    });
    let cameras = config.cameras.iter().map(|c| c.id.clone()).collect();
    let recorder = Recorder::new(config.record.clone(), cameras, jobs_in, health.clone());
    let disk = ClipDisk {
        config: config.record.clone(),
        rig_toml: std::fs::read_to_string(&config.rig).unwrap_or_default(),
        calibration: config.results.join("calibration.json"),
        health: health.clone(),
    };
    threads.push(named("record".into(), move || recorder.run(&frames, &clips))?);
    threads.push(named("disk".into(), move || disk.run(&jobs))?);
    Ok(Some((frames_in, clips_in)))
}

/// Frames of a camera that the recorder may hold at once: its memory comes on top of the pool.
fn frames_recorded(config: &DaemonConfig, frame_bytes: usize) -> usize {
    match config.record.mode {
        RecordMode::Off => 0,
        RecordMode::Clips | RecordMode::Continuous => config.record.memory_bytes / frame_bytes.max(1),
    }
}

fn spawn<T: Send + 'static>(
    name: String,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<JoinHandle<T>, DaemonError> {
    let thread = std::thread::Builder::new().name(name.clone()).spawn(work);
    thread.map_err(|source| DaemonError::Thread { name, source })
}

fn named(name: String, work: impl FnOnce() + Send + 'static) -> Result<JoinHandle<()>, DaemonError> {
    spawn(name, work)
}

/// Live stamps are all on the host's clock: what is left between cameras is a transfer time of some milliseconds.
fn with_stamps_roughly_alike(mut rig: Rig) -> Rig {
    for camera in &mut rig.cameras {
        camera.time_offset_s = Some(0.0);
    }
    rig
}

/// Frames that an eye keeps to compare with: a pool that is no larger starves its camera.
fn frames_held(eye: &EyeConfig) -> usize {
    3 * eye.detector.lag_frames_max.max(eye.detector.lag_frames) + 3
}

fn live_options(
    config: &DaemonConfig,
    connection: &CameraConnection,
    rig: &Rig,
) -> Result<LiveOptions, DaemonError> {
    let setup = rig.camera(&connection.id).ok_or_else(|| DaemonError::NotInRig {
        file: config.path.display().to_string(),
        camera: connection.id.to_string(),
        rig: config.rig.display().to_string(),
    })?;
    let which = CameraAddress {
        serial: connection.serial.clone(),
        address: connection.address,
        user_name: connection.user_name.clone(),
    };
    Ok(LiveOptions {
        offset_px: connection.offset_px,
        exposure_s: setup.exposure_s,
        gain_db: connection.gain_db,
        packet_size: connection.packet_size,
        path: if connection.packet_socket {
            PacketPath::PacketSocket
        } else {
            PacketPath::UdpSocket
        },
        socket_buffer_bytes: connection.socket_buffer_bytes,
        buffers: connection.buffers
            + frames_held(&EyeConfig::of_rig(rig, &connection.id))
            + frames_recorded(config, setup.width_px as usize * setup.height_px as usize),
        realtime_priority: (connection.realtime_priority > 0).then_some(connection.realtime_priority),
        ptp: if connection.ptp {
            Ptp::WhereAvailable
        } else {
            Ptp::Off
        },
        ..LiveOptions::new(
            connection.id.clone(),
            which,
            (setup.width_px, setup.height_px),
            setup.frame_rate_hz,
        )
    })
}
