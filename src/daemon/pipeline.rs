//! The whole daemon on one page: every thread, every queue, who stops whom.
//!
//! ```text
//! cap-<id> ─(1)─► eye-<id> ─(2)─► look-<id> ─┐
//! cap-<id> ─(1)─► eye-<id> ─(2)─► look-<id> ─┼─(3)─► assemble ─(6)─► publish ─(7)─► print
//!     …             │   ▲──(12)──   …        ┘        │   ▲  │          (16)          ▲
//!                  (13)                              (4) (5) └───(8)───► keep       (15)
//!                   ▼ ▲(17)                           ▼   │                          │
//!                foresee ◄──────────────(14)──── calibrate ; assemble            foresee
//!
//! cap-<id> ─(9)─► record ─(10)─► disk ─► recordings/        assemble ─(11)─► record
//! ```
//!
//! | thread | takes | gives | queue | when that is full |
//! |---|---|---|---|---|
//! | `cap-<id>` | the camera | frames (in place, from its pool) | (1) ¾ of the pool | the frame is dropped, counted as `dropped` |
//! | `eye-<id>` | frames | balls whose paths have ended | (2) 64 | the ball is lost, counted, logged as an error |
//! | | | balls in flight | (13) 64 | dropped: the next frame tells again |
//! | | | stills of home plate, to `calibrate` | (18) 16 | dropped, counted: a better one comes |
//! | `look-<id>` | balls | tracks of pitched balls | (3) 256 tracks | waits; (2) then loses balls |
//! | | | what it found, for the eye | (12) 4 | dropped: the next ball tells again |
//! | `assemble` | tracks, (5) | pitches | (6) 64 pitches | the pitch is not published, logged as an error |
//! | | | requests | (4) 1 request | asked again with the next pitch |
//! | | | calibrations | (8) 8, (14) 4 | logged as an error; the calibration is used all the same |
//! | | | balls to cut out | (11) 16 | the clip is lost, logged as an error |
//! | `calibrate` | requests, (18) | answers | (5) 1 answer | waits |
//! | `foresee` | balls in flight | estimates, as lines | (15) 8 lines | the line is dropped, counted |
//! | | | where each camera will see the ball, to its eye | (17) 1 | it is dropped: the next comes in 10 ms |
//! | `publish` | pitches | lines | (7) 64 lines | the line is dropped, counted |
//! | | | pitches and tracks, for the files | (16) 256 | they are not in the files, logged as an error |
//! | `keep` | (8), (16) | files | – | blocks alone: a disk that stands still delays no pitch |
//! | `cap-<id>` | | frames, the same memory | (9) 64 frames | the frame is not recorded, counted |
//! | `record` | (9), (11) | clips | (10) 4 clips, or 64 frames of a continuous recording | the clip or frame is lost, counted |
//! | `disk` | (10) | session folders; `disk-end` ends the last one | – | blocks alone |
//! | main | SIGHUP | new settings, to `assemble`, `record` and `disk` | 4 each | refused, logged; the old ones hold |
//! | `print` | lines | standard output | – | blocks alone |
//!
//! No thread that handles frames ever waits for one that fits or solves. Stopping is closing: capture threads stop, each
//! closes its queue, and the end travels downstream in the order frames do; a pitch in flight is finished on the way. What
//! a silent camera would hold up is done on threads that nobody waits for: `open-<id>` opens, `camera-teardown` lets go.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use crossbeam_channel::{Sender, bounded};

use super::assemble::{Assembler, CalibrationPlan, NewPlan};
use super::calibrating;
use super::clip_disk::ClipDisk;
use super::ending::{STOP_MOST, join_all};
use super::foresee::{Foresee, InFlight};
use super::health::CameraHealth;
use super::keep;
use super::looker::{self, SeenTrack};
use super::outfit::Wanted;
use super::publish::{self, PublishHealth};
use super::recorder::{ClipTrigger, RecordedLive, Recorder, RecorderHealth};
use super::supervise::Supervisor;
use super::watcher::{self, EyeChannels, LOOK_QUEUE};
use crate::capture::aravis::{
    CameraAddress, LiveOptions, PacketPath, Ptp, UsbMode, make_this_thread_realtime,
};
use crate::config::{CameraConnection, DaemonConfig, RecordConfig, RecordMode};
use crate::eye::EyeConfig;
use crate::scene::{Calibration, PixelFormat, Rig};
use crate::time::PtpDomain;

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

/// New settings found no place.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("{0} has not yet taken the settings before these; try again")]
pub struct NotTaken(
    /// The thread.
    pub &'static str,
);

/// A running daemon.
pub struct Daemon {
    stop: Arc<AtomicBool>,
    health: Vec<Arc<CameraHealth>>,
    recorder: Arc<RecorderHealth>,
    published: Arc<PublishHealth>,
    plans: Sender<NewPlan>,
    record_configs: Vec<Sender<RecordConfig>>,
    threads: Vec<JoinHandle<()>>,
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
    let (keep_in, kept) = bounded(256);
    let (estimates_in, estimates) = bounded::<String>(8);
    let (news_in, news) = bounded::<InFlight>(64);
    let (in_use_in, in_use) = bounded(4);
    let (plans_in, plans) = bounded(4);
    let published = Arc::new(PublishHealth::default());

    let rig = with_stamps_roughly_alike(rig);
    let recorder = Arc::new(RecorderHealth::default());
    let mut record_configs = Vec::new();
    let record = start_recorder(config, &recorder, (&mut threads, &mut record_configs))?;
    let mut health = Vec::new();
    let (stills_in, stills) = bounded(calibrating::STILLS_QUEUE);
    let network = PtpDomain::default();
    let (mut captures, mut trackers, mut eyes) = (Vec::new(), BTreeMap::new(), BTreeMap::new());
    for connection in &config.cameras {
        let options = live_options(config, connection, &rig, &network)?;
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
        let priority = connection.realtime_priority;
        let name = format!("cap-{}", connection.id);
        captures.push(((name, below(priority, Urgency::Capture)), supervisor));
        let (look_in, look) = bounded(LOOK_QUEUE);
        let (steps_in, steps) = bounded(4);
        let mut wanted = Wanted::of(&rig, &connection.id, calibration.as_ref());
        wanted.eye.detector.kind = config.detector;
        trackers.insert(connection.id.clone(), wanted.eye.tracker.clone());
        let (foreseen_in, foreseen) = bounded(1);
        eyes.insert(connection.id.clone(), foreseen_in);
        let channels = EyeChannels {
            look: look_in,
            in_flight: news_in.clone(),
            steps,
            foreseen,
            stills: stills_in.clone(),
        };
        let (eye_health, second_eye) = (own.clone(), wanted.eye.clone());
        let name = format!("eye-{}", connection.id);
        threads.push(urgent((name, below(priority, Urgency::Eye)), move || {
            watcher::watch(&frames, &channels, wanted, &eye_health);
        })?);
        let (look_health, look_tracks) = (own.clone(), tracks_in.clone());
        let name = format!("look-{}", connection.id);
        threads.push(urgent((name, below(priority, Urgency::Look)), move || {
            looker::look(&look, (&look_tracks, &steps_in), &second_eye, &look_health);
        })?);
        health.push(own);
    }
    drop((tracks_in, news_in, stills_in));
    let foresee = Foresee {
        rig: rig.clone(),
        trackers,
        eyes,
        lines: config.in_flight.then_some(estimates_in),
        health: published.clone(),
    };
    let priorities = config.cameras.iter().map(|c| c.realtime_priority);
    let solving = priorities.max().and_then(|most| below(most, Urgency::Solve));
    threads.push(urgent(("foresee".into(), solving), move || {
        foresee.run(&news, &in_use)
    })?);

    let assembler = Assembler {
        rig: rig.clone(),
        numbers_before: keep::last_number(&config.results),
        calibration: calibration.map(calibrating::from_file),
        plan: plan_of(config),
        health: health.clone(),
        requests: requests_in,
        clips: record.map(|(_, clips)| clips),
        publish: pitches_in,
        versions: versions_in,
        foresee: in_use_in,
    };
    threads.push(urgent(("assemble".into(), solving), move || {
        assembler.run(&tracks, &answers, &plans)
    })?);
    threads.push(named("calibrate".into(), move || {
        calibrating::calibrate(rig, (&requests, &stills), &answers_in);
    })?);
    threads.push(named("print".into(), move || publish::print(&lines, &estimates))?);
    let publish_health = published.clone();
    threads.push(urgent(("publish".into(), solving), move || {
        publish::publish(&pitches, (&lines_in, &keep_in), &publish_health);
    })?);
    let folder = config.results.clone();
    threads.push(named("keep".into(), move || {
        keep::keep(&folder, &kept, &versions)
    })?);
    // Cameras last: everything downstream is ready for their first frame.
    for (name, supervisor) in captures {
        threads.push(urgent(name, move || supervisor.run())?);
    }
    Ok(Daemon {
        stop,
        health,
        recorder,
        published,
        plans: plans_in,
        record_configs,
        threads,
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

    /// What has been published.
    pub fn published(&self) -> &Arc<PublishHealth> {
        &self.published
    }

    /// Takes what can change while it runs; the rest needs a restart. All of it or nothing: `main` alone sends here, so
    /// that a queue with room keeps it until the send.
    ///
    /// # Errors
    /// [`NotTaken`]: a thread is busy with earlier settings, and nothing has changed.
    pub fn reload(&self, config: &DaemonConfig, calibration: Option<Calibration>) -> Result<(), NotTaken> {
        if self.plans.is_full() {
            return Err(NotTaken("assemble"));
        }
        if self.record_configs.iter().any(Sender::is_full) {
            return Err(NotTaken("the recorder"));
        }
        let new = NewPlan {
            plan: plan_of(config),
            calibration,
        };
        self.plans.try_send(new).map_err(|_| NotTaken("assemble"))?;
        for to in &self.record_configs {
            to.try_send(config.record.clone())
                .map_err(|_| NotTaken("the recorder"))?;
        }
        Ok(())
    }

    /// Asks every camera to stop; what they have sent is finished.
    pub fn request_stop(&self) {
        self.stop.store(true, Ordering::Relaxed);
    }

    /// Stops and waits for the last pitch, at most [`STOP_MOST`] for all threads together; answers the names of those that
    /// are still at work then and will be cut off.
    #[must_use = "what was cut off is to be told"]
    pub fn finish(self) -> Vec<String> {
        self.request_stop();
        join_all(self.threads, STOP_MOST)
    }
}

fn plan_of(config: &DaemonConfig) -> CalibrationPlan {
    CalibrationPlan {
        first_pitches: config.first_pitches,
        window_pitches: config.window_pitches,
        every_pitches: config.recalibrate_every,
    }
}

type ToRecorder = (Sender<RecordedLive>, Sender<ClipTrigger>);

/// The recorder's two threads, if anything is to be recorded.
fn start_recorder(
    config: &DaemonConfig,
    health: &Arc<RecorderHealth>,
    (threads, configs): (&mut Vec<JoinHandle<()>>, &mut Vec<Sender<RecordConfig>>),
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
    let (recorder_configs_in, recorder_configs) = bounded(4);
    let (disk_configs_in, disk_configs) = bounded(4);
    configs.extend([recorder_configs_in, disk_configs_in]);
    let disk = ClipDisk {
        configs: disk_configs,
        config: config.record.clone(),
        rig_toml: std::fs::read_to_string(&config.rig).unwrap_or_default(),
        calibration: config.results.join("calibration.json"),
        health: health.clone(),
        session_bytes_least: 256 << 20,
    };
    threads.push(named("record".into(), move || {
        recorder.run(&frames, &clips, &recorder_configs);
    })?);
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

fn named(name: String, work: impl FnOnce() + Send + 'static) -> Result<JoinHandle<()>, DaemonError> {
    let thread = std::thread::Builder::new().name(name.clone()).spawn(work);
    thread.map_err(|source| DaemonError::Thread { name, source })
}

/// As [`named`], real-time where the system allows it.
fn urgent(
    (name, priority): (String, Option<u8>),
    work: impl FnOnce() + Send + 'static,
) -> Result<JoinHandle<()>, DaemonError> {
    named(name.clone(), move || {
        if let Some(priority) = priority
            && !make_this_thread_realtime(priority)
        {
            tracing::debug!(name, "stays an ordinary thread");
        }
        work();
    })
}

/// Priorities below a camera's receive thread: a frame is taken before it is searched, searched before anything is fitted, and
/// a pitch whose balls have been fitted is solved before the next ball is. Another program's load then delays none of them;
/// `calibrate`, `record`, `disk` and `print` can wait. A camera's priority of 6 or more leaves room for all of them.
#[derive(Clone, Copy)]
enum Urgency {
    Capture = 1,
    Eye = 2,
    Solve = 4,
    Look = 5,
}

fn below(priority: u8, urgency: Urgency) -> Option<u8> {
    (priority > 0).then(|| priority.saturating_sub(urgency as u8).max(1))
}

/// Live stamps are all on the host's clock: what is left between cameras is a transfer time of some milliseconds.
fn with_stamps_roughly_alike(mut rig: Rig) -> Rig {
    for camera in &mut rig.cameras {
        camera.time_offset_s = Some(0.0);
    }
    rig
}

/// Frames that an eye keeps to compare with: a pool that is no larger starves its camera. Unpacked ones are in memory of
/// the eye's own.
fn frames_held(eye: &EyeConfig, format: PixelFormat) -> usize {
    match format {
        PixelFormat::Mono8 => 3 * eye.detector.lag_frames_max.max(eye.detector.lag_frames) + 3,
        _ => 0,
    }
}

/// How the daemon opens a camera; `network` is the clock that cameras with PTP follow.
///
/// # Errors
/// [`DaemonError::NotInRig`].
pub fn live_options(
    config: &DaemonConfig,
    connection: &CameraConnection,
    rig: &Rig,
    network: &PtpDomain,
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
    let format = connection.pixel_format;
    let ready = connection.buffers + frames_held(&EyeConfig::of_rig(rig, &connection.id), format);
    let frame_bytes = format.bytes(setup.width_px as usize * setup.height_px as usize);
    Ok(LiveOptions {
        offset_px: connection.offset_px,
        pixel_format: format,
        exposure_s: setup.exposure_s,
        gain_db: connection.gain_db,
        packet_size: connection.packet_size,
        path: if connection.packet_socket {
            PacketPath::PacketSocket
        } else {
            PacketPath::UdpSocket
        },
        usb_mode: if connection.usb_async {
            UsbMode::Async
        } else {
            UsbMode::Sync
        },
        socket_buffer_bytes: connection.socket_buffer_bytes,
        buffers_ready: ready,
        buffers: ready + frames_recorded(config, frame_bytes),
        realtime_priority: (connection.realtime_priority > 0).then_some(connection.realtime_priority),
        ptp: if connection.ptp {
            Ptp::WhereAvailable(network.clone())
        } else {
            Ptp::Off
        },
        features: connection.features.clone(),
        ..LiveOptions::new(
            connection.id.clone(),
            which,
            (setup.width_px, setup.height_px),
            setup.frame_rate_hz,
        )
    })
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::config::parse_daemon;

    #[test]
    fn settings_are_taken_whole_or_not_at_all() {
        let text = "rig = \"r\"\n[[camera]]\nid = \"first\"\naddress = \"10.0.0.5\"\n";
        let config = parse_daemon(Path::new("p.toml"), text).unwrap();
        let (plans_in, plans) = bounded(4);
        let (record_in, record) = bounded(2);
        let daemon = Daemon {
            stop: Arc::default(),
            health: Vec::new(),
            recorder: Arc::default(),
            published: Arc::default(),
            plans: plans_in,
            record_configs: vec![record_in],
            threads: Vec::new(),
        };
        assert_eq!(daemon.reload(&config, None), Ok(()));
        assert_eq!(daemon.reload(&config, None), Ok(()));
        assert_eq!(daemon.reload(&config, None), Err(NotTaken("the recorder")));
        assert_eq!((plans.len(), record.len()), (2, 2), "nothing was taken by half");
        assert_eq!(record.try_iter().count(), 2);
        assert_eq!(daemon.reload(&config, None), Ok(()), "there is room again");
        drop(plans);
        assert_eq!(daemon.reload(&config, None), Err(NotTaken("assemble")));
    }
}
