//! The register map of the emulated camera: bootstrap registers, the GenICam file and the features' registers.
//!
//! Pure: reading and writing answer with bytes or a refusal, and a write that has consequences (acquisition start, a
//! test packet, privilege) returns them as an [`Effect`] for the camera's threads.

use std::net::{Ipv4Addr, SocketAddrV4};

use super::genicam;
use super::gvcp::Refusal;
use crate::scene::PixelFormat;

/// A GenICam description that is not the camera's own, to try a receiver with.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct StrangeDescription {
    /// Its file name; one that ends in `.zip` is an archive.
    pub name: String,
    /// What the camera's memory holds.
    pub bytes: Vec<u8>,
    /// What the camera states as its address instead of the true one.
    pub stated: Option<String>,
}

impl From<String> for StrangeDescription {
    fn from(text: String) -> Self {
        Self {
            name: "pitchd_emulator.xml".to_owned(),
            bytes: text.into_bytes(),
            stated: None,
        }
    }
}

/// Who the camera says it is, and what it can do.
#[derive(Debug, Clone, PartialEq)]
pub struct Identity {
    /// Its address.
    pub address: Ipv4Addr,
    /// Serial number, at most 15 bytes are told.
    pub serial: String,
    /// User-defined name, at most 15 bytes are told.
    pub user_name: String,
    /// Columns of the sensor.
    pub width_px: u32,
    /// Rows of the sensor.
    pub height_px: u32,
    /// Pixel formats that it has; the first is the one at the start.
    pub pixel_formats: Vec<PixelFormat>,
    /// Least and most frame rate, Hz; the first rate is the most.
    pub rate_hz: (f64, f64),
    /// Exposure at the start, seconds.
    pub exposure_s: f64,
    /// Link speed told, Mb/s.
    pub link_mbps: u32,
    /// Another GenICam description than the camera's own.
    pub genicam: Option<StrangeDescription>,
}

/// Manufacturer told in discovery.
pub const VENDOR: &str = "pitchd";
/// Model told in discovery.
pub const MODEL: &str = "Emulator";
/// Device clock ticks per second: nanoseconds.
pub const TICKS_PER_SECOND: u64 = 1_000_000_000;

pub(super) const CAPABILITY: u32 = 0x0934;
pub(super) const HEARTBEAT_MS: u32 = 0x0938;
pub(super) const TICK_HIGH: u32 = 0x093c;
pub(super) const TIMESTAMP_CONTROL: u32 = 0x0944;
pub(super) const TIMESTAMP_HIGH: u32 = 0x0948;
pub(super) const PRIVILEGE: u32 = 0x0a00;
pub(super) const HOLDER_PORT: u32 = 0x0a04;
pub(super) const HOLDER_ADDRESS: u32 = 0x0a14;
pub(super) const STREAM_PORT: u32 = 0x0d00;
pub(super) const PACKET_SIZE: u32 = 0x0d04;
pub(super) const PACKET_DELAY: u32 = 0x0d08;
pub(super) const STREAM_ADDRESS: u32 = 0x0d18;
pub(super) const STREAM_SOURCE_PORT: u32 = 0x0d1c;

pub(super) const FEATURES: u32 = 0x0002_0000;
pub(super) const WIDTH: u32 = FEATURES;
pub(super) const HEIGHT: u32 = FEATURES + 0x04;
pub(super) const OFFSET_X: u32 = FEATURES + 0x08;
pub(super) const OFFSET_Y: u32 = FEATURES + 0x0c;
pub(super) const PIXEL_FORMAT: u32 = FEATURES + 0x10;
pub(super) const PAYLOAD_BYTES: u32 = FEATURES + 0x14;
pub(super) const ACQUISITION: u32 = FEATURES + 0x18;
pub(super) const ACQUISITION_MODE: u32 = FEATURES + 0x1c;
pub(super) const RATE: u32 = FEATURES + 0x20;
pub(super) const EXPOSURE_US: u32 = FEATURES + 0x28;
pub(super) const GAIN_DB: u32 = FEATURES + 0x30;
pub(super) const TRIGGER_MODE: u32 = FEATURES + 0x38;
pub(super) const SENSOR_WIDTH: u32 = FEATURES + 0x3c;
pub(super) const SENSOR_HEIGHT: u32 = FEATURES + 0x40;
pub(super) const LINK_MBPS: u32 = FEATURES + 0x44;
pub(super) const DEVICE_RESET: u32 = FEATURES + 0x48;
pub(super) const PTP_ENABLE: u32 = FEATURES + 0x4c;
pub(super) const PTP_LATCH: u32 = FEATURES + 0x50;
pub(super) const PTP_STATUS: u32 = FEATURES + 0x54;
pub(super) const PTP_OFFSET_NS: u32 = FEATURES + 0x58;
const FEATURE_BYTES: usize = 0x5c;

/// Behind everything else: a description may have any size.
const XML: u32 = 0x0100_0000;
const BOOTSTRAP_BYTES: usize = 0xb000;
const FIRE_TEST: u32 = 1 << 31;
/// Control or exclusive privilege.
const PRIVILEGE_MASK: u32 = 3;

/// What a write means for the rest of the camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Effect {
    /// Nothing beyond the register.
    None,
    /// Frames are wanted.
    Start,
    /// Frames are no longer wanted.
    Stop,
    /// One test packet of the packet size is wanted.
    TestPacket,
    /// The timestamp is to be latched into its registers.
    LatchTimestamp,
    /// The device clock starts at zero.
    ResetTimestamp,
    /// The clock follows the network's from now on, or no longer.
    FollowPtp(bool),
    /// Where it stands with the network's clock is to be latched into its register.
    LatchPtp,
    /// The camera restarts.
    Reboot,
}

/// What a stream is to be like, as the registers stand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StreamSettings {
    /// Where packets go.
    pub to: SocketAddrV4,
    /// Packet size with IP and UDP headers, bytes.
    pub packet_size: u32,
    /// How pixels are packed.
    pub pixel_format: PixelFormat,
    /// Region: columns, rows, first column, first row.
    pub region: [u32; 4],
    /// Frame rate, Hz.
    pub rate_hz: f64,
    /// Exposure, seconds.
    pub exposure_s: f64,
}

/// All of the camera's memory.
#[derive(Debug, Clone)]
pub struct RegisterBank {
    identity: Identity,
    bootstrap: Vec<u8>,
    xml: Vec<u8>,
    features: Vec<u8>,
}

impl RegisterBank {
    /// Registers as after power-on.
    pub fn new(identity: Identity) -> Self {
        let mut bank = Self {
            bootstrap: vec![0; BOOTSTRAP_BYTES],
            xml: match &identity.genicam {
                Some(strange) => strange.bytes.clone(),
                None => genicam::description(&identity).into_bytes(),
            },
            features: vec![0; FEATURE_BYTES],
            identity,
        };
        bank.xml.resize(bank.xml.len().next_multiple_of(4), 0);
        bank.fill_bootstrap();
        bank.fill_features();
        bank
    }

    /// The GenICam description.
    pub fn genicam(&self) -> String {
        String::from_utf8_lossy(&self.xml)
            .trim_end_matches('\0')
            .to_owned()
    }

    fn fill_bootstrap(&mut self) {
        let identity = self.identity.clone();
        let ip = u32::from(identity.address);
        // A locally administered MAC that follows from the address.
        for (address, value) in [
            (0x0000, 0x0001_0002), // GigE Vision 1.2
            (0x0004, 0x8000_0001), // big-endian, UTF-8
            (0x0008, 0x0000_0250),
            (0x000c, ip),
            (0x0010, 0x0000_0005),
            (0x0014, 0x0000_0005),
            (0x0024, ip),
            (0x0034, 0xffff_ff00),
            (0x0600, 1),
            (0x0904, 1),
            // user name, serial number, link speed; write memory, packet resend
            (CAPABILITY, 1 << 31 | 1 << 30 | 1 << 28 | 0b110),
            (HEARTBEAT_MS, 3000),
            (TICK_HIGH, (TICKS_PER_SECOND >> 32) as u32),
            (TICK_HIGH + 4, TICKS_PER_SECOND as u32),
            (PACKET_SIZE, 1500),
        ] {
            self.set32(address, value);
        }
        for (address, text, most) in [
            (0x0048, VENDOR, 32),
            (0x0068, MODEL, 32),
            (0x0088, env!("CARGO_PKG_VERSION"), 32),
            (0x00a8, "a camera in software", 48),
            (0x00d8, identity.serial.as_str(), 16),
            (0x00e8, identity.user_name.as_str(), 16),
        ] {
            self.set_text(address, text, most);
        }
        let strange = identity.genicam.as_ref();
        let name = strange.map_or("pitchd_emulator.xml", |s| &s.name);
        let url = format!("Local:{name};{XML:X};{:X}", self.xml.len());
        let url = strange.and_then(|s| s.stated.clone()).unwrap_or(url);
        self.set_text(0x0200, &url, 512);
    }

    fn fill_features(&mut self) {
        let identity = self.identity.clone();
        let format = identity.pixel_formats.first().copied().unwrap_or_default();
        for (address, value) in [
            (WIDTH, identity.width_px),
            (HEIGHT, identity.height_px),
            (PIXEL_FORMAT, format.code()),
            (SENSOR_WIDTH, identity.width_px),
            (SENSOR_HEIGHT, identity.height_px),
            (LINK_MBPS, identity.link_mbps),
        ] {
            self.set32(address, value);
        }
        self.set_f64(RATE, identity.rate_hz.1);
        self.set_f64(EXPOSURE_US, 1e6 * identity.exposure_s);
        self.update_payload();
    }

    fn slot(&mut self, address: u32, count: usize) -> Option<&mut [u8]> {
        let (memory, at) = if address >= FEATURES {
            (&mut self.features, address - FEATURES)
        } else {
            (&mut self.bootstrap, address)
        };
        memory.get_mut(at as usize..(at as usize).checked_add(count)?)
    }
    pub(super) fn set32(&mut self, address: u32, value: u32) {
        if let Some(slot) = self.slot(address, 4) {
            slot.copy_from_slice(&value.to_be_bytes());
        }
    }
    fn set_f64(&mut self, address: u32, value: f64) {
        if let Some(slot) = self.slot(address, 8) {
            slot.copy_from_slice(&value.to_be_bytes());
        }
    }
    fn set_text(&mut self, address: u32, text: &str, most: usize) {
        if let Some(slot) = self.slot(address, most) {
            slot.fill(0);
            // The last byte stays zero.
            for (to, from) in slot.iter_mut().zip(text.bytes().take(most.saturating_sub(1))) {
                *to = from;
            }
        }
    }
    /// A 32-bit register; 0 where there is none.
    pub fn get32(&self, address: u32) -> u32 {
        self.read(address, 4)
            .ok()
            .and_then(|b| Some(u32::from_be_bytes(b.try_into().ok()?)))
            .unwrap_or(0)
    }
    fn get_f64(&self, address: u32) -> f64 {
        self.read(address, 8)
            .ok()
            .and_then(|b| Some(f64::from_be_bytes(b.try_into().ok()?)))
            .unwrap_or(0.0)
    }

    /// Bytes of the memory.
    ///
    /// # Errors
    /// No register there, or not a multiple of four.
    pub fn read(&self, address: u32, count: usize) -> Result<Vec<u8>, Refusal> {
        if !address.is_multiple_of(4) || !count.is_multiple_of(4) {
            return Err(Refusal::BadAlignment);
        }
        let (memory, base) = match address {
            XML.. => (&self.xml, XML),
            FEATURES.. => (&self.features, FEATURES),
            _ => (&self.bootstrap, 0),
        };
        let at = (address - base) as usize;
        at.checked_add(count)
            .and_then(|end| memory.get(at..end))
            .map(<[u8]>::to_vec)
            .ok_or(Refusal::InvalidAddress)
    }

    /// What discovery answers: the first 248 bytes.
    pub fn discovery(&self) -> Vec<u8> {
        self.bootstrap.get(..0xf8).unwrap_or_default().to_vec()
    }

    /// Writes one register.
    ///
    /// # Errors
    /// The register cannot be written, or not with this value.
    pub fn write32(&mut self, address: u32, value: u32) -> Result<Effect, Refusal> {
        let region_most = |size: u32, offset: u32| size.saturating_sub(offset);
        let effect = match address {
            HEARTBEAT_MS => {
                self.set32(address, value.max(500));
                return Ok(Effect::None);
            }
            TIMESTAMP_CONTROL if value & 2 != 0 => return Ok(Effect::LatchTimestamp),
            TIMESTAMP_CONTROL if value & 1 != 0 => return Ok(Effect::ResetTimestamp),
            PACKET_SIZE => {
                // Keep the do-not-fragment bit and the size; the test bit fires and does not stay.
                self.set32(address, value & !FIRE_TEST & 0x4000_ffff);
                return Ok(if value & FIRE_TEST != 0 {
                    Effect::TestPacket
                } else {
                    Effect::None
                });
            }
            PRIVILEGE | STREAM_PORT | PACKET_DELAY | STREAM_ADDRESS | ACQUISITION_MODE
            | TIMESTAMP_CONTROL => Effect::None,
            WIDTH if (8..=region_most(self.identity.width_px, self.get32(OFFSET_X))).contains(&value) => {
                Effect::None
            }
            HEIGHT if (8..=region_most(self.identity.height_px, self.get32(OFFSET_Y))).contains(&value) => {
                Effect::None
            }
            OFFSET_X if value <= region_most(self.identity.width_px, self.get32(WIDTH)) => Effect::None,
            OFFSET_Y if value <= region_most(self.identity.height_px, self.get32(HEIGHT)) => Effect::None,
            PIXEL_FORMAT if self.identity.pixel_formats.iter().any(|f| f.code() == value) => Effect::None,
            TRIGGER_MODE if value == 0 => Effect::None,
            WIDTH | HEIGHT | OFFSET_X | OFFSET_Y | PIXEL_FORMAT | TRIGGER_MODE => {
                return Err(Refusal::InvalidParameter);
            }
            ACQUISITION if value == 1 => Effect::Start,
            ACQUISITION => Effect::Stop,
            DEVICE_RESET => return Ok(Effect::Reboot),
            PTP_ENABLE if value <= 1 => Effect::FollowPtp(value == 1),
            PTP_ENABLE => return Err(Refusal::InvalidParameter),
            PTP_LATCH => return Ok(Effect::LatchPtp),
            _ if self.read(address, 4).is_ok() => return Err(Refusal::WriteProtect),
            _ => return Err(Refusal::InvalidAddress),
        };
        self.set32(address, value);
        self.update_payload();
        Ok(effect)
    }

    /// Writes memory: a floating-point feature or the user's name.
    ///
    /// # Errors
    /// As [`Self::write32`].
    pub fn write_memory(&mut self, address: u32, bytes: &[u8]) -> Result<Effect, Refusal> {
        if let Ok(word) = <[u8; 4]>::try_from(bytes) {
            return self.write32(address, u32::from_be_bytes(word));
        }
        if address == 0x00e8 && bytes.len() <= 16 {
            let text = String::from_utf8_lossy(bytes).trim_end_matches('\0').to_owned();
            self.set_text(address, &text, 16);
            return Ok(Effect::None);
        }
        let value = f64::from_be_bytes(bytes.try_into().map_err(|_| Refusal::WriteProtect)?);
        let (least, most) = match address {
            RATE => self.identity.rate_hz,
            EXPOSURE_US => (10.0, 1e6),
            GAIN_DB => (0.0, 24.0),
            _ => return Err(Refusal::WriteProtect),
        };
        if !(least - 1e-6..=most + 1e-6).contains(&value) {
            return Err(Refusal::InvalidParameter);
        }
        self.set_f64(address, value);
        Ok(Effect::None)
    }

    fn update_payload(&mut self) {
        let pixels = self.get32(WIDTH).saturating_mul(self.get32(HEIGHT));
        let bytes = self.pixel_format().bytes(pixels as usize);
        self.set32(PAYLOAD_BYTES, u32::try_from(bytes).unwrap_or(u32::MAX));
    }

    fn pixel_format(&self) -> PixelFormat {
        PixelFormat::of_code(self.get32(PIXEL_FORMAT)).unwrap_or_default()
    }

    /// Notes who holds the camera; nobody: 0.0.0.0, port 0.
    pub(super) fn set_holder(&mut self, address: Ipv4Addr, port: u16) {
        self.set32(HOLDER_PORT, u32::from(port));
        self.set32(HOLDER_ADDRESS, u32::from(address));
    }

    /// Whether a program holds the camera.
    pub fn is_held(&self) -> bool {
        self.get32(PRIVILEGE) & PRIVILEGE_MASK != 0
    }

    /// The stream as the registers have it now.
    pub fn stream_settings(&self) -> StreamSettings {
        StreamSettings {
            to: SocketAddrV4::new(
                Ipv4Addr::from(self.get32(STREAM_ADDRESS)),
                (self.get32(STREAM_PORT) & 0xffff) as u16,
            ),
            packet_size: self.get32(PACKET_SIZE) & 0xffff,
            pixel_format: self.pixel_format(),
            region: [WIDTH, HEIGHT, OFFSET_X, OFFSET_Y].map(|a| self.get32(a)),
            rate_hz: self.get_f64(RATE),
            exposure_s: 1e-6 * self.get_f64(EXPOSURE_US),
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    pub(crate) fn identity() -> Identity {
        Identity {
            address: Ipv4Addr::new(127, 0, 0, 5),
            serial: "E5".into(),
            user_name: "first".into(),
            width_px: 2048,
            height_px: 1024,
            pixel_formats: vec![PixelFormat::Mono8, PixelFormat::Mono12p],
            rate_hz: (1.0, 175.0),
            exposure_s: 0.001,
            link_mbps: 5000,
            genicam: None,
        }
    }

    #[test]
    fn the_region_is_held_within_the_sensor() {
        let mut bank = RegisterBank::new(identity());
        assert_eq!(bank.get32(PAYLOAD_BYTES), 2048 * 1024);
        assert_eq!(bank.write32(OFFSET_X, 4), Err(Refusal::InvalidParameter));
        assert_eq!(bank.write32(WIDTH, 1024), Ok(Effect::None));
        assert_eq!(bank.write32(OFFSET_X, 1024), Ok(Effect::None));
        assert_eq!(bank.write32(WIDTH, 1025), Err(Refusal::InvalidParameter));
        assert_eq!(bank.get32(PAYLOAD_BYTES), 1024 * 1024);
        let format = |format: PixelFormat| format.code();
        assert_eq!(
            bank.write32(PIXEL_FORMAT, format(PixelFormat::Mono10p)),
            Err(Refusal::InvalidParameter)
        );
        assert_eq!(
            bank.write32(PIXEL_FORMAT, format(PixelFormat::Mono12p)),
            Ok(Effect::None)
        );
        assert_eq!(bank.get32(PAYLOAD_BYTES), 1024 * 1024 * 3 / 2);
        assert_eq!(bank.write32(PAYLOAD_BYTES, 1), Err(Refusal::WriteProtect));
        assert_eq!(bank.write32(0xffff_fff0, 1), Err(Refusal::InvalidAddress));
        assert_eq!(bank.read(2, 4), Err(Refusal::BadAlignment));
    }

    #[test]
    fn the_address_of_the_description_leads_to_it() {
        let bank = RegisterBank::new(identity());
        let url = String::from_utf8(bank.read(0x200, 64).unwrap()).unwrap();
        let mut parts = url.trim_end_matches('\0').split(';');
        assert_eq!(parts.next(), Some("Local:pitchd_emulator.xml"));
        let [address, size] = [(); 2].map(|()| u32::from_str_radix(parts.next().unwrap(), 16).unwrap());
        let xml = bank.read(address, size as usize).unwrap();
        assert!(
            xml.starts_with(b"<?xml") && String::from_utf8(xml).unwrap().contains("</RegisterDescription>")
        );
    }

    proptest! {
        #[test]
        fn no_access_makes_it_panic(address in any::<u32>(), value in any::<u32>(), count in 0_usize..600) {
            let mut bank = RegisterBank::new(identity());
            for near in [address, address % 0x1000 * 4, FEATURES + address % 0x60] {
                let _ = bank.read(near, count);
                let _ = bank.write32(near, value);
                let _ = bank.write_memory(near, &vec![7; count]);
            }
            prop_assert!(bank.stream_settings().region[0] <= 2048);
        }
    }
}
