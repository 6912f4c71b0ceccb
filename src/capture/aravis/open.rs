//! Opens and sets up one camera.

use aravis::prelude::*;
use aravis::{Camera, GvStreamOption, GvStreamPacketResend, GvStreamSocketBuffer, UvUsbMode};

use super::error::LiveError;
use super::features;
use super::ffi::{RawStream, open_device};
use super::guard;
use super::options::{LiveOptions, PacketPath, UsbMode};
use super::place::Place;
use super::ptp::PtpFollower;

/// Ethernet, IP, UDP and GVSP bytes of a packet over its pixels.
const OVERHEAD: f64 = 1.01;

/// A camera that is set up, before it streams.
pub struct Opened {
    pub camera: Camera,
    pub stream: RawStream,
    pub payload_bytes: usize,
    pub exposure_s: f64,
    pub packet_size: u32,
    pub model: String,
    pub ptp: Option<PtpFollower>,
    /// The receive buffer that the system grants; `None` where there is no socket to ask.
    pub socket_buffer_bytes: Option<usize>,
}

/// Opens and sets up the camera that is there (one on the network must have answered a ping).
///
/// # Errors
/// Whatever is refused, by name.
pub fn open(options: &LiveOptions, place: &Place) -> Result<Opened, LiveError> {
    let failed = |doing: &'static str| {
        let camera = options.camera.clone();
        move |error: aravis::glib::Error| LiveError::Library {
            camera,
            doing,
            reason: error.message().to_owned(),
        }
    };
    let camera = open_device(&place.to_string()).map_err(failed("open"))?;
    // A camera left streaming by a crashed program refuses new settings.
    let _ = camera.stop_acquisition();
    shorten_heartbeat(options, &camera);
    set_image(options, &camera)?;
    let mut exposure_s = set_timing(options, &camera)?;
    let ptp = PtpFollower::start(options, &camera)?;
    if !options.features.is_empty() {
        features::set(options, &camera)?;
        // They may have changed it.
        exposure_s = 1e-6 * camera.exposure_time().unwrap_or(1e6 * exposure_s);
    }
    let payload_bytes = sane_payload(
        options,
        camera.payload().map_err(failed("read PayloadSize"))? as usize,
    )?;
    let packet_size = set_transport(options, &camera)?;
    check_link(options, &camera, payload_bytes)?;
    let stream =
        RawStream::create(&camera, options.realtime_priority).map_err(failed("create the stream"))?;
    tune(options, &stream);
    let mut socket_buffer_bytes = None;
    if let (Place::Gige(address), PacketPath::UdpSocket) = (place, options.path) {
        let expected = guard::Expected {
            camera: *address,
            payload_bytes,
            packet_size,
        };
        set_guard(options, &stream, &expected)?;
        // The library sets it with the first frame, and does not look at what it got.
        socket_buffer_bytes = stream.grant_buffer(*address, options.socket_buffer_bytes).ok();
    }
    Ok(Opened {
        model: camera.model_name().map(|m| m.to_string()).unwrap_or_default(),
        camera,
        stream,
        payload_bytes,
        exposure_s,
        packet_size,
        ptp,
        socket_buffer_bytes,
    })
}

/// No camera streams without it: one packet would end all of them.
fn set_guard(options: &LiveOptions, stream: &RawStream, expected: &guard::Expected) -> Result<(), LiveError> {
    let refused = |reason: std::io::Error| LiveError::Unguarded {
        camera: options.camera.clone(),
        address: expected.camera,
        reason: reason.to_string(),
    };
    guard::insist(|| guard::set(stream, expected)).map_err(refused)
}

fn setting<T: std::fmt::Display>(
    options: &LiveOptions,
    setting: &'static str,
    value: T,
) -> impl FnOnce(aravis::glib::Error) -> LiveError {
    let camera = options.camera.clone();
    move |error| LiveError::Setting {
        camera,
        setting,
        value: value.to_string(),
        reason: error.message().to_owned(),
    }
}

/// A camera waits this long for a program that died before another may have it, milliseconds. The library sends a
/// heartbeat a second.
const HEARTBEAT_MS: i64 = 3000;

/// Some cameras wait for ten seconds or more; after a crash they would be missing for as long.
fn shorten_heartbeat(options: &LiveOptions, camera: &Camera) {
    let name = "GevHeartbeatTimeout";
    if camera.is_feature_available(name).unwrap_or(false)
        && camera.integer(name).is_ok_and(|ms| ms > HEARTBEAT_MS)
        && let Err(error) = camera.set_integer(name, HEARTBEAT_MS)
    {
        tracing::info!(camera = %options.camera, %error, "its heartbeat timeout stays as it is");
    }
}

/// By its number in the convention, as the leaders of frames tell it.
fn set_pixel_format(options: &LiveOptions, camera: &Camera) -> Result<(), LiveError> {
    let (name, asked) = ("PixelFormat", options.pixel_format);
    let number = i64::from(asked.code());
    if camera.set_integer(name, number).is_ok() && camera.integer(name).is_ok_and(|got| got == number) {
        return Ok(());
    }
    let available = camera.dup_available_pixel_formats_as_strings();
    let available = available
        .unwrap_or_default()
        .into_iter()
        .map(|name| name.to_string());
    Err(LiveError::PixelFormat {
        camera: options.camera.clone(),
        asked,
        available: available.collect(),
    })
}

fn set_image(options: &LiveOptions, camera: &Camera) -> Result<(), LiveError> {
    set_pixel_format(options, camera)?;
    let (width, height) = options.size_px;
    let (x, y) = options.offset_px;
    let [x, y, w, h] = [x, y, width, height].map(|n| i32::try_from(n).unwrap_or(i32::MAX));
    let refused = setting(options, "region", format!("{width}x{height} at {x}, {y}"));
    camera.set_region(x, y, w, h).map_err(|error| match (refused(error), camera.sensor_size()) {
        (LiveError::Setting { camera, setting, value, reason }, Ok((most_w, most_h))) => LiveError::Setting {
            camera,
            setting,
            value,
            reason: format!(
                "{reason}; the sensor has {most_w}x{most_h}: correct width_px and height_px of the rig, or offset_px"
            ),
        },
        (other, _) => other,
    })?;
    let (_, _, got_w, got_h) = camera
        .region()
        .map_err(setting(options, "region", "as read back"))?;
    if (got_w, got_h) != (w, h) {
        return Err(LiveError::NotKept {
            camera: options.camera.clone(),
            setting: "region (columns)",
            got: f64::from(if got_w == w { got_h } else { got_w }),
            asked: f64::from(if got_w == w { h } else { w }),
        });
    }
    Ok(())
}

/// Free-running, at the asked rate and exposure; answers the exposure in seconds.
fn set_timing(options: &LiveOptions, camera: &Camera) -> Result<f64, LiveError> {
    if camera.is_feature_available("TriggerMode").unwrap_or(false) {
        camera
            .set_string("TriggerMode", "Off")
            .map_err(setting(options, "TriggerMode", "Off"))?;
    }
    if let Some(exposure_s) = options.exposure_s {
        let refused = setting(options, "exposure", exposure_s);
        camera.set_exposure_time(1e6 * exposure_s).map_err(refused)?;
    }
    let rate_hz = options.frame_rate_hz;
    camera
        .set_frame_rate(rate_hz)
        .map_err(setting(options, "frame rate", rate_hz))?;
    let got_hz = camera
        .frame_rate()
        .map_err(setting(options, "frame rate", rate_hz))?;
    if (got_hz - rate_hz).abs() > 0.005 * rate_hz {
        return Err(LiveError::NotKept {
            camera: options.camera.clone(),
            setting: "frame rate (Hz)",
            got: got_hz,
            asked: rate_hz,
        });
    }
    if let Some(gain_db) = options.gain_db {
        camera
            .set_gain(gain_db)
            .map_err(setting(options, "gain", gain_db))?;
    }
    camera
        .exposure_time()
        .map(|us| 1e-6 * us)
        .map_err(setting(options, "exposure", "as read back"))
}

fn set_transport(options: &LiveOptions, camera: &Camera) -> Result<u32, LiveError> {
    if camera.is_uv_device() {
        camera.uv_set_usb_mode(match options.usb_mode {
            UsbMode::Sync => UvUsbMode::Sync,
            UsbMode::Async => UvUsbMode::Async,
        });
    }
    if !camera.is_gv_device() {
        return Ok(0);
    }
    camera.gv_set_stream_options(match options.path {
        PacketPath::UdpSocket => GvStreamOption::PACKET_SOCKET_DISABLED,
        PacketPath::PacketSocket => GvStreamOption::NONE,
    });
    match options.packet_size {
        Some(size) => {
            let asked = i32::try_from(size).unwrap_or(i32::MAX);
            camera
                .gv_set_packet_size(asked)
                .map_err(setting(options, "packet size", size))?;
            camera.gv_set_packet_size_adjustment(aravis::GvPacketSizeAdjustment::Never);
        }
        None => camera
            .gv_auto_packet_size()
            .map_err(setting(options, "packet size", "negotiated"))?,
    }
    let size = camera
        .gv_get_packet_size()
        .map_err(setting(options, "packet size", "as read back"))?;
    sane_packet_size(options, size)
}

/// Chunks behind the image take some kilobytes. The pool is made of buffers of this size: an absurd one is not believed.
fn sane_payload(options: &LiveOptions, payload_bytes: usize) -> Result<usize, LiveError> {
    let image = options.frame_bytes();
    if (image..=2 * image + (1 << 20)).contains(&payload_bytes) {
        return Ok(payload_bytes);
    }
    Err(LiveError::Setting {
        camera: options.camera.clone(),
        setting: "PayloadSize",
        value: payload_bytes.to_string(),
        reason: format!(
            "an image of {}x{} {} has {image} bytes",
            options.size_px.0, options.size_px.1, options.pixel_format
        ),
    })
}

/// A packet size that the library would divide by or allocate: the standard's least, and a datagram's most.
fn sane_packet_size(options: &LiveOptions, size: u32) -> Result<u32, LiveError> {
    if (576..=65_535).contains(&size) {
        return Ok(size);
    }
    Err(LiveError::Setting {
        camera: options.camera.clone(),
        setting: "packet size",
        value: size.to_string(),
        reason: "a packet has 576 to 65535 bytes".to_owned(),
    })
}

fn check_link(options: &LiveOptions, camera: &Camera, payload_bytes: usize) -> Result<(), LiveError> {
    // Megabits per second by the SFNC for both names.
    let told = ["DeviceLinkSpeed", "GevLinkSpeed"].iter().find_map(|name| {
        let there = camera.is_feature_available(name).unwrap_or(false);
        camera.integer(name).ok().filter(|v| there && *v > 0)
    });
    let Some(link_mbps) = told.map(|v| v as f64) else {
        return Ok(());
    };
    let needed_mbps = 8e-6 * payload_bytes as f64 * options.frame_rate_hz * OVERHEAD;
    if needed_mbps > link_mbps {
        return Err(LiveError::LinkTooSlow {
            camera: options.camera.clone(),
            needed_mbps,
            link_mbps,
        });
    }
    Ok(())
}

/// Timeouts for 175 fps: with the library's own (20 ms, 100 ms) a lost packet holds up all later frames. A frame is given
/// up after 25 ms: a host that stands still for 10 ms (another machine's turn) has its packets in the socket's buffer.
fn tune(options: &LiveOptions, stream: &RawStream) {
    let Some(gige) = stream.gige() else { return };
    gige.set_socket_buffer(GvStreamSocketBuffer::Fixed);
    gige.set_socket_buffer_size(i32::try_from(options.socket_buffer_bytes).unwrap_or(i32::MAX));
    gige.set_packet_resend(GvStreamPacketResend::Always);
    gige.set_packet_timeout(1000);
    gige.set_initial_packet_timeout(200);
    gige.set_frame_retention(25_000);
}
