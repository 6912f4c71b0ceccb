//! How to open one live camera.

use std::net::Ipv4Addr;

use crate::scene::{CameraId, FeatureValue, PixelFormat};
use crate::time::PtpDomain;

/// What tells a camera from all others. At least one must be given; all that are given must hold.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct CameraAddress {
    /// Serial number: the same camera at any address.
    pub serial: Option<String>,
    /// IP address.
    pub address: Option<Ipv4Addr>,
    /// User-defined name in the camera.
    pub user_name: Option<String>,
}

impl std::fmt::Display for CameraAddress {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mut parts = Vec::new();
        parts.extend(self.serial.as_ref().map(|s| format!("serial {s}")));
        parts.extend(self.address.map(|a| format!("address {a}")));
        parts.extend(self.user_name.as_ref().map(|n| format!("name {n}")));
        f.write_str(&parts.join(", "))
    }
}

/// How packets reach the library.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum PacketPath {
    /// A plain UDP socket: no privileges, and no delay of its own.
    #[default]
    UdpSocket,
    /// The packet socket: less than half the processor time, 2.5 ms more latency, needs CAP_NET_RAW.
    PacketSocket,
}

/// Whether the camera's clock follows the network's.
#[derive(Debug, Clone, PartialEq, Default)]
pub enum Ptp {
    /// Free-running.
    #[default]
    Off,
    /// PTP, where the camera has it; cameras of one domain are stamped on one scale.
    WhereAvailable(PtpDomain),
}

/// How a USB3 Vision camera's frames are fetched.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum UsbMode {
    /// One transfer after the other.
    #[default]
    Sync,
    /// Several at once: more bandwidth. Aravis before 0.8.28 spins in it when no buffer is free, and may wait for ever.
    Async,
}

/// How to open one live camera.
#[derive(Debug, Clone, PartialEq)]
pub struct LiveOptions {
    /// Our name for it.
    pub camera: CameraId,
    /// Which one it is.
    pub which: CameraAddress,
    /// Columns and rows.
    pub size_px: (u32, u32),
    /// First column and row on the sensor.
    pub offset_px: (u32, u32),
    /// How it sends its pixels.
    pub pixel_format: PixelFormat,
    /// Frames a second.
    pub frame_rate_hz: f64,
    /// Exposure, seconds; `None`: as the camera has it.
    pub exposure_s: Option<f64>,
    /// Gain, decibels; `None`: as the camera has it.
    pub gain_db: Option<f64>,
    /// Packet size with IP and UDP headers; `None`: the largest that passes.
    pub packet_size: Option<u32>,
    /// How packets come.
    pub path: PacketPath,
    /// How a USB3 camera's frames are fetched.
    pub usb_mode: UsbMode,
    /// Socket buffer, bytes.
    pub socket_buffer_bytes: usize,
    /// The most frames in the pool.
    pub buffers: usize,
    /// Of those, frames that are kept free for the receive thread; the pool grows to its most only as readers keep others.
    /// Memory is touched as it is made, 2 GiB of it for seconds: a camera must not wait for that.
    pub buffers_ready: usize,
    /// Priority of the receive and capture threads (SCHED_RR); `None`: ordinary.
    pub realtime_priority: Option<u8>,
    /// Clock discipline.
    pub ptp: Ptp,
    /// Further features by their GenICam names, set in this order before it streams.
    pub features: Vec<(String, FeatureValue)>,
}

impl LiveOptions {
    /// A camera with everything as it should be for 175 fps: 32 MiB of socket buffer, 48 frames of pool.
    pub fn new(camera: CameraId, which: CameraAddress, size_px: (u32, u32), frame_rate_hz: f64) -> Self {
        Self {
            camera,
            which,
            size_px,
            offset_px: (0, 0),
            pixel_format: PixelFormat::Mono8,
            frame_rate_hz,
            exposure_s: None,
            gain_db: None,
            packet_size: None,
            path: PacketPath::UdpSocket,
            usb_mode: UsbMode::Sync,
            socket_buffer_bytes: 32 << 20,
            buffers: 48,
            buffers_ready: 48,
            realtime_priority: Some(20),
            ptp: Ptp::Off,
            features: Vec::new(),
        }
    }

    /// Bytes of a frame.
    pub fn frame_bytes(&self) -> usize {
        let (width_px, height_px) = self.size_px;
        self.pixel_format.bytes(width_px as usize * height_px as usize)
    }

    /// Frames to be kept free.
    pub(super) fn ready(&self) -> usize {
        self.buffers_ready.min(self.buffers).max(1)
    }
}
