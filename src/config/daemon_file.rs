//! The daemon's file (`pitchd.toml`): which camera is which, what to calibrate from, where results go. Strict.

use std::net::Ipv4Addr;
use std::path::{Path, PathBuf};

use serde::Deserialize;

use super::{ConfigError, line_of};
use crate::scene::{CameraId, DetectorKind, FeatureValue, PixelFormat};

/// One camera's connection.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraConnection {
    /// Camera of the rig.
    pub id: CameraId,
    /// Serial number.
    pub serial: Option<String>,
    /// IP address.
    pub address: Option<Ipv4Addr>,
    /// User-defined name in the camera.
    pub user_name: Option<String>,
    /// First column and row of the region on the sensor.
    pub offset_px: (u32, u32),
    /// How it sends its pixels.
    pub pixel_format: PixelFormat,
    /// Gain, decibels.
    pub gain_db: Option<f64>,
    /// Packet size; none: negotiated.
    pub packet_size: Option<u32>,
    /// Frames in the pool, over those that detection compares with.
    pub buffers: usize,
    /// Socket buffer, bytes.
    pub socket_buffer_bytes: usize,
    /// Real-time priority; 0: ordinary.
    pub realtime_priority: u8,
    /// `udp` or `packet`.
    pub packet_socket: bool,
    /// PTP where the camera has it.
    pub ptp: bool,
    /// Several USB transfers at once, instead of one after the other.
    pub usb_async: bool,
    /// Further features by their GenICam names, in the order in which they are set.
    pub features: Vec<(String, FeatureValue)>,
}

/// What is recorded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RecordMode {
    /// Nothing.
    #[default]
    Off,
    /// A clip of every pitch.
    Clips,
    /// Everything.
    Continuous,
}

/// The recorder.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordConfig {
    /// What is recorded.
    pub mode: RecordMode,
    /// Folder of the recordings.
    pub folder: PathBuf,
    /// Most memory of frames, all cameras together.
    pub memory_bytes: usize,
    /// The oldest recordings are removed beyond this.
    pub quota_bytes: u64,
    /// Seconds of a clip before the first sight of the ball.
    pub before_s: f64,
    /// Seconds after the last.
    pub after_s: f64,
}

/// The daemon's file.
#[derive(Debug, Clone, PartialEq)]
pub struct DaemonConfig {
    /// The file itself.
    pub path: PathBuf,
    /// Rig file, made absolute.
    pub rig: PathBuf,
    /// A calibration to begin with.
    pub calibration: Option<PathBuf>,
    /// Folder for pitches.jsonl and calibration.json.
    pub results: PathBuf,
    /// Pitches before the first calibration.
    pub first_pitches: usize,
    /// Pitches a calibration looks back on.
    pub window_pitches: usize,
    /// New pitches before the next calibration.
    pub recalibrate_every: usize,
    /// Whether estimates of balls in flight are published.
    pub in_flight: bool,
    /// How balls are found in frames.
    pub detector: DetectorKind,
    /// What is recorded.
    pub record: RecordConfig,
    /// Cameras, at least one, ids and addresses unique.
    pub cameras: Vec<CameraConnection>,
}

impl DaemonConfig {
    /// Keys that differ from `running` and hold only after a restart.
    pub fn needs_restart(&self, running: &Self) -> Vec<&'static str> {
        let (new, old) = (&self.record, &running.record);
        [
            ("rig", self.rig != running.rig),
            ("results", self.results != running.results),
            ("in_flight", self.in_flight != running.in_flight),
            ("detector", self.detector != running.detector),
            ("[[camera]]", self.cameras != running.cameras),
            ("record.mode", new.mode != old.mode),
            ("record.folder", new.folder != old.folder),
            ("record.memory_mib", new.memory_bytes != old.memory_bytes),
        ]
        .into_iter()
        .filter_map(|(key, differs)| differs.then_some(key))
        .collect()
    }

    /// Keys that differ from `running` and hold at once.
    pub fn holds_at_once(&self, running: &Self) -> Vec<&'static str> {
        let (new, old) = (&self.record, &running.record);
        [
            ("calibration", self.calibration != running.calibration),
            (
                "calibrate.first_pitches",
                self.first_pitches != running.first_pitches,
            ),
            (
                "calibrate.window_pitches",
                self.window_pitches != running.window_pitches,
            ),
            (
                "calibrate.every_pitches",
                self.recalibrate_every != running.recalibrate_every,
            ),
            ("record.quota_gib", new.quota_bytes != old.quota_bytes),
            ("record.before_s", new.before_s != old.before_s),
            ("record.after_s", new.after_s != old.after_s),
        ]
        .into_iter()
        .filter_map(|(key, differs)| differs.then_some(key))
        .collect()
    }

    /// Takes from `new` what [`Self::holds_at_once`] names; the rest stays.
    pub fn take_what_holds_at_once(&mut self, new: &Self) {
        self.calibration.clone_from(&new.calibration);
        self.first_pitches = new.first_pitches;
        self.window_pitches = new.window_pitches;
        self.recalibrate_every = new.recalibrate_every;
        self.record.quota_bytes = new.record.quota_bytes;
        self.record.before_s = new.record.before_s;
        self.record.after_s = new.record.after_s;
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct DaemonFile {
    rig: String,
    calibration: Option<String>,
    #[serde(default = "default_results")]
    results: String,
    #[serde(default = "default_in_flight")]
    in_flight: bool,
    detector: Option<toml::Spanned<String>>,
    #[serde(default)]
    calibrate: CalibrateFile,
    #[serde(default)]
    record: RecordFile,
    #[serde(default)]
    camera: Vec<CameraFile>,
}

fn default_results() -> String {
    "pitchd-results".to_owned()
}

fn default_in_flight() -> bool {
    true
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, default)]
struct CalibrateFile {
    first_pitches: usize,
    window_pitches: usize,
    every_pitches: usize,
}

impl Default for CalibrateFile {
    fn default() -> Self {
        Self {
            first_pitches: 4,
            window_pitches: 16,
            every_pitches: 8,
        }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, default)]
struct RecordFile {
    mode: RecordMode,
    folder: String,
    memory_mib: usize,
    quota_gib: f64,
    before_s: f64,
    after_s: f64,
}

impl Default for RecordFile {
    fn default() -> Self {
        Self {
            mode: RecordMode::Off,
            folder: "recordings".to_owned(),
            memory_mib: 2048,
            quota_gib: 100.0,
            before_s: 0.5,
            after_s: 0.5,
        }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CameraFile {
    id: toml::Spanned<String>,
    serial: Option<String>,
    address: Option<Ipv4Addr>,
    user_name: Option<String>,
    offset_px: Option<[u32; 2]>,
    pixel_format: Option<toml::Spanned<String>>,
    gain_db: Option<f64>,
    packet_size: Option<toml::Spanned<u32>>,
    buffers: Option<toml::Spanned<usize>>,
    socket_buffer_mib: Option<usize>,
    realtime_priority: Option<u8>,
    #[serde(default)]
    packet_socket: bool,
    #[serde(default)]
    ptp: bool,
    #[serde(default)]
    usb_mode: UsbTransfers,
    #[serde(default)]
    features: Vec<(toml::Spanned<String>, toml::Value)>,
}

#[derive(Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
enum UsbTransfers {
    #[default]
    Sync,
    Async,
}

/// The detector asked for; where it is and why it cannot be.
fn detector_of(file: &DaemonFile) -> Result<DetectorKind, (usize, String)> {
    let Some(name) = &file.detector else {
        return Ok(DetectorKind::default());
    };
    DetectorKind::of_name(name.get_ref()).ok_or_else(|| {
        let known = DetectorKind::ALL.map(DetectorKind::name).join(", ");
        let why = format!("detector: unknown value `{}`; known: {known}", name.get_ref());
        (name.span().start, why)
    })
}

/// The pixel format asked for; where it is and why it cannot be. The nearest name may not be the nearest format: all of
/// them are told.
fn pixel_format_of(camera: &CameraFile) -> Result<PixelFormat, (usize, String)> {
    let Some(name) = &camera.pixel_format else {
        return Ok(PixelFormat::default());
    };
    PixelFormat::of_name(name.get_ref()).ok_or_else(|| {
        let known = PixelFormat::ALL.map(PixelFormat::name).join(", ");
        let why = format!("pixel_format: unknown value `{}`; known: {known}", name.get_ref());
        (name.span().start, why)
    })
}

/// The features asked for; where one is and why it cannot be.
fn features_of(camera: &CameraFile) -> Result<Vec<(String, FeatureValue)>, (usize, String)> {
    let value_of = |(name, value): &(toml::Spanned<String>, toml::Value)| {
        let value = match value {
            toml::Value::Boolean(switch) => FeatureValue::Switch(*switch),
            toml::Value::Integer(number) => FeatureValue::Integer(*number),
            toml::Value::Float(number) => FeatureValue::Float(*number),
            toml::Value::String(text) => FeatureValue::Text(text.clone()),
            other => {
                let (at, name, kind) = (name.span().start, name.get_ref(), other.type_str());
                let why = format!(
                    "features: the value of {name} is of type {kind}; give true, false, a number or a text"
                );
                return Err((at, why));
            }
        };
        Ok((name.get_ref().clone(), value))
    };
    camera.features.iter().map(value_of).collect()
}

/// Reads and checks a daemon file.
///
/// # Errors
/// [`ConfigError`] with file, line and key.
pub fn load_daemon(path: &Path) -> Result<DaemonConfig, ConfigError> {
    let text = std::fs::read_to_string(path).map_err(|source| ConfigError::Unreadable {
        path: path.to_owned(),
        source,
    })?;
    parse_daemon(path, &text)
}

/// As [`load_daemon`], from a text that came from `path`.
///
/// # Errors
/// As [`load_daemon`].
pub fn parse_daemon(path: &Path, text: &str) -> Result<DaemonConfig, ConfigError> {
    let file: DaemonFile = toml::from_str(text).map_err(|e| ConfigError::from_toml(path, text, &e))?;
    let beside = |name: &str| path.parent().unwrap_or(Path::new(".")).join(name);
    let invalid = |offset: usize, reason: String| ConfigError::Invalid {
        path: path.to_owned(),
        line: line_of(text, offset),
        reason,
    };
    let detector = detector_of(&file).map_err(|(at, reason)| invalid(at, reason))?;
    let mut cameras: Vec<CameraConnection> = Vec::with_capacity(file.camera.len());
    for camera in &file.camera {
        let at = camera.id.span().start;
        let id = CameraId::new(camera.id.get_ref()).map_err(|e| invalid(at, e.to_string()))?;
        if cameras.iter().any(|c| c.id == id) {
            return Err(invalid(at, format!("camera `{id}` is there twice")));
        }
        if camera.serial.is_none() && camera.address.is_none() && camera.user_name.is_none() {
            return Err(invalid(
                at,
                format!("camera `{id}`: give serial, address or user_name"),
            ));
        }
        // Where an address does not lead to it a camera is sought by its name; only serial numbers tell two of one name apart.
        let same = cameras.iter().find(|c| {
            let by_serial = c.serial.is_some() && camera.serial.is_some();
            (c.serial.is_some() && c.serial == camera.serial)
                || (c.address.is_some() && c.address == camera.address)
                || (c.user_name.is_some() && c.user_name == camera.user_name && !by_serial)
        });
        if let Some(other) = same {
            return Err(invalid(
                at,
                format!("cameras `{}` and `{id}` are the same device", other.id),
            ));
        }
        if let Some(size) = &camera.packet_size
            && !(576..=65500).contains(size.get_ref())
        {
            return Err(invalid(size.span().start, "packet_size: 576 to 65500".to_owned()));
        }
        if let Some(buffers) = &camera.buffers
            && !(8..=4096).contains(buffers.get_ref())
        {
            return Err(invalid(buffers.span().start, "buffers: 8 to 4096".to_owned()));
        }
        cameras.push(CameraConnection {
            id,
            serial: camera.serial.clone(),
            address: camera.address,
            user_name: camera.user_name.clone(),
            offset_px: camera.offset_px.map_or((0, 0), |[x, y]| (x, y)),
            pixel_format: pixel_format_of(camera).map_err(|(at, reason)| invalid(at, reason))?,
            gain_db: camera.gain_db,
            packet_size: camera.packet_size.as_ref().map(|s| *s.get_ref()),
            buffers: camera.buffers.as_ref().map_or(48, |b| *b.get_ref()),
            socket_buffer_bytes: camera.socket_buffer_mib.unwrap_or(32).clamp(1, 1024) << 20,
            realtime_priority: camera.realtime_priority.unwrap_or(20).min(90),
            packet_socket: camera.packet_socket,
            ptp: camera.ptp,
            usb_async: camera.usb_mode == UsbTransfers::Async,
            features: features_of(camera).map_err(|(at, reason)| invalid(at, reason))?,
        });
    }
    if cameras.is_empty() {
        return Err(ConfigError::Inconsistent {
            path: path.to_owned(),
            reason: "no [[camera]]".to_owned(),
        });
    }
    let calibrate = file.calibrate;
    Ok(DaemonConfig {
        path: path.to_owned(),
        rig: beside(&file.rig),
        calibration: file.calibration.as_deref().map(beside),
        results: beside(&file.results),
        in_flight: file.in_flight,
        detector,
        first_pitches: calibrate.first_pitches.max(1),
        window_pitches: calibrate.window_pitches.max(calibrate.first_pitches.max(1)),
        recalibrate_every: calibrate.every_pitches.max(1),
        record: RecordConfig {
            mode: file.record.mode,
            folder: beside(&file.record.folder),
            memory_bytes: file.record.memory_mib.clamp(16, 1 << 20) << 20,
            quota_bytes: (file.record.quota_gib.max(0.0) * 1_073_741_824.0) as u64,
            before_s: file.record.before_s.clamp(0.0, 60.0),
            after_s: file.record.after_s.clamp(0.0, 60.0),
        },
        cameras,
    })
}

#[cfg(test)]
#[path = "daemon_file_tests.rs"]
mod tests;
