//! The GenICam description that the emulated camera serves: which features there are and in which registers.

use std::fmt::Write;

use super::clock::PtpState;
use super::registers::{
    ACQUISITION, ACQUISITION_MODE, DEVICE_RESET, EXPOSURE_US, GAIN_DB, HEARTBEAT_MS, HEIGHT, Identity,
    LINK_MBPS, MODEL, OFFSET_X, OFFSET_Y, PACKET_DELAY, PACKET_SIZE, PAYLOAD_BYTES, PIXEL_FORMAT, PTP_ENABLE,
    PTP_LATCH, PTP_OFFSET_NS, PTP_STATUS, RATE, SENSOR_HEIGHT, SENSOR_WIDTH, STREAM_ADDRESS, STREAM_PORT,
    STREAM_SOURCE_PORT, TICK_HIGH, TIMESTAMP_CONTROL, TIMESTAMP_HIGH, TRIGGER_MODE, VENDOR, WIDTH,
};

const CATEGORIES: &[(&str, &[&str])] = &[
    (
        "DeviceControl",
        &[
            "DeviceVendorName",
            "DeviceModelName",
            "DeviceVersion",
            "DeviceSerialNumber",
            "DeviceID",
            "DeviceUserID",
            "DeviceLinkSpeed",
            "DeviceReset",
            "PtpEnable",
            "PtpDataSetLatch",
            "PtpStatus",
            "PtpOffsetFromMaster",
        ],
    ),
    (
        "ImageFormatControl",
        &[
            "SensorWidth",
            "SensorHeight",
            "WidthMax",
            "HeightMax",
            "Width",
            "Height",
            "OffsetX",
            "OffsetY",
            "PixelFormat",
        ],
    ),
    (
        "AcquisitionControl",
        &[
            "AcquisitionMode",
            "AcquisitionStart",
            "AcquisitionStop",
            "AcquisitionFrameRate",
            "ExposureTime",
            "TriggerSelector",
            "TriggerMode",
        ],
    ),
    ("AnalogControl", &["Gain"]),
    (
        "TransportLayerControl",
        &[
            "PayloadSize",
            "GevHeartbeatTimeout",
            "GevTimestampTickFrequency",
            "GevTimestampControlLatch",
            "GevTimestampControlReset",
            "GevTimestampValue",
            "GevSCPHostPort",
            "GevSCPSPacketSize",
            "GevSCPSFireTestPacket",
            "GevSCPSDoNotFragment",
            "GevSCPD",
            "GevSCDA",
            "GevSCSP",
        ],
    ),
];

struct Xml(String);

impl Xml {
    fn line(&mut self, text: std::fmt::Arguments<'_>) {
        // Writing to a String cannot fail.
        let _ = self.0.write_fmt(text);
        self.0.push('\n');
    }
    fn register(&mut self, kind: &str, name: &str, address: u32, rest: &str) {
        self.line(format_args!(
            "<{kind} Name=\"{name}\"><Address>0x{address:x}</Address>{rest}<pPort>Device</pPort></{kind}>"
        ));
    }
    fn text(&mut self, name: &str, address: u32, length: u32, access: &str) {
        let rest = format!("<Length>{length}</Length><AccessMode>{access}</AccessMode>");
        self.register("StringReg", name, address, &rest);
    }
    fn int_register(&mut self, name: &str, address: u32, length: u32, access: &str) {
        let rest = format!("<Length>{length}</Length><AccessMode>{access}</AccessMode>");
        self.line(format_args!(
            "<IntReg Name=\"{name}\"><Address>0x{address:x}</Address>{rest}<pPort>Device</pPort>\
             <Cachable>NoCache</Cachable><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>"
        ));
    }
    /// An integer feature with its register; `limits` are further elements such as `<Max>`.
    fn integer(&mut self, name: &str, address: u32, access: &str, limits: &str) {
        self.line(format_args!(
            "<Integer Name=\"{name}\"><pValue>{name}Reg</pValue>{limits}</Integer>"
        ));
        self.int_register(&format!("{name}Reg"), address, 4, access);
    }
    fn float(&mut self, name: &str, address: u32, unit: &str, (least, most): (f64, f64)) {
        self.line(format_args!(
            "<Float Name=\"{name}\"><pValue>{name}Reg</pValue><Min>{least}</Min><Max>{most}</Max><Unit>{unit}</Unit></Float>"
        ));
        self.line(format_args!(
            "<FloatReg Name=\"{name}Reg\"><Address>0x{address:x}</Address><Length>8</Length><AccessMode>RW</AccessMode>\
             <pPort>Device</pPort><Cachable>NoCache</Cachable><Endianess>BigEndian</Endianess></FloatReg>"
        ));
    }
    fn command(&mut self, name: &str, register: &str, value: u32) {
        self.line(format_args!(
            "<Command Name=\"{name}\"><pValue>{register}</pValue><CommandValue>{value}</CommandValue></Command>"
        ));
    }
    fn choice(&mut self, name: &str, register: &str, entries: &[(&str, u32)]) {
        self.line(format_args!("<Enumeration Name=\"{name}\">"));
        for (entry, value) in entries {
            self.line(format_args!(
                "<EnumEntry Name=\"{entry}\"><Value>{value}</Value></EnumEntry>"
            ));
        }
        self.line(format_args!("<pValue>{register}</pValue></Enumeration>"));
    }
    /// Bits of a register, counted from the most significant as the standard does.
    fn bits(&mut self, name: &str, address: u32, (msb, lsb): (u32, u32)) {
        self.line(format_args!(
            "<MaskedIntReg Name=\"{name}\"><Address>0x{address:x}</Address><Length>4</Length><AccessMode>RW</AccessMode>\
             <pPort>Device</pPort><Cachable>NoCache</Cachable><LSB>{lsb}</LSB><MSB>{msb}</MSB><Sign>Unsigned</Sign>\
             <Endianess>BigEndian</Endianess></MaskedIntReg>"
        ));
    }
}

/// The description of a camera.
pub fn description(identity: &Identity) -> String {
    let mut xml = Xml(String::with_capacity(16_384));
    xml.line(format_args!(
        "<?xml version=\"1.0\" encoding=\"utf-8\"?>\n\
         <RegisterDescription ModelName=\"{MODEL}\" VendorName=\"{VENDOR}\" ToolTip=\"A camera in software\" \
         StandardNameSpace=\"GEV\" SchemaMajorVersion=\"1\" SchemaMinorVersion=\"1\" SchemaSubMinorVersion=\"0\" \
         MajorVersion=\"1\" MinorVersion=\"0\" SubMinorVersion=\"0\" \
         ProductGuid=\"6f0c7a52-7b0c-4a53-9a0e-6b1f3b7c2d10\" VersionGuid=\"0f4f8a0e-7d53-4b39-8f5f-4d3c0c2a9b11\" \
         xmlns=\"http://www.genicam.org/GenApi/Version_1_1\" xmlns:xsi=\"http://www.w3.org/2001/XMLSchema-instance\" \
         xsi:schemaLocation=\"http://www.genicam.org/GenApi/Version_1_1 \
         http://www.genicam.org/GenApi/GenApiSchema_Version_1_1.xsd\">"
    ));
    xml.line(format_args!("<Category Name=\"Root\" NameSpace=\"Standard\">"));
    for (category, _) in CATEGORIES {
        xml.line(format_args!("<pFeature>{category}</pFeature>"));
    }
    xml.line(format_args!("</Category>"));
    for (category, features) in CATEGORIES {
        xml.line(format_args!(
            "<Category Name=\"{category}\" NameSpace=\"Standard\">"
        ));
        for feature in *features {
            xml.line(format_args!("<pFeature>{feature}</pFeature>"));
        }
        xml.line(format_args!("</Category>"));
    }
    device_features(&mut xml);
    image_features(&mut xml, identity);
    acquisition_features(&mut xml, identity);
    transport_features(&mut xml);
    xml.line(format_args!(
        "<Port Name=\"Device\" NameSpace=\"Standard\"></Port>"
    ));
    xml.line(format_args!("</RegisterDescription>"));
    xml.0
}

fn device_features(xml: &mut Xml) {
    for (name, address, length, access) in [
        ("DeviceVendorName", 0x48, 32, "RO"),
        ("DeviceModelName", 0x68, 32, "RO"),
        ("DeviceVersion", 0x88, 32, "RO"),
        ("DeviceManufacturerInfo", 0xa8, 48, "RO"),
        ("DeviceSerialNumber", 0xd8, 16, "RO"),
        ("DeviceID", 0xd8, 16, "RO"),
        ("DeviceUserID", 0xe8, 16, "RW"),
    ] {
        xml.text(name, address, length, access);
    }
    xml.integer("DeviceLinkSpeed", LINK_MBPS, "RO", "");
    xml.int_register("DeviceResetReg", DEVICE_RESET, 4, "RW");
    xml.command("DeviceReset", "DeviceResetReg", 1);
    xml.int_register("PtpEnableReg", PTP_ENABLE, 4, "RW");
    xml.line(format_args!(
        "<Boolean Name=\"PtpEnable\"><pValue>PtpEnableReg</pValue><OnValue>1</OnValue><OffValue>0</OffValue></Boolean>"
    ));
    xml.int_register("PtpDataSetLatchReg", PTP_LATCH, 4, "RW");
    xml.command("PtpDataSetLatch", "PtpDataSetLatchReg", 1);
    xml.int_register("PtpStatusReg", PTP_STATUS, 4, "RO");
    xml.choice("PtpStatus", "PtpStatusReg", &PtpState::ENTRIES);
    xml.integer("PtpOffsetFromMaster", PTP_OFFSET_NS, "RO", "");
}

fn image_features(xml: &mut Xml, identity: &Identity) {
    let (width, height) = (identity.width_px, identity.height_px);
    xml.integer("SensorWidth", SENSOR_WIDTH, "RO", "");
    xml.integer("SensorHeight", SENSOR_HEIGHT, "RO", "");
    xml.line(format_args!(
        "<Integer Name=\"WidthMax\"><Value>{width}</Value></Integer><Integer Name=\"HeightMax\"><Value>{height}</Value></Integer>"
    ));
    for (name, address, least, most) in [
        ("Width", WIDTH, 8, width),
        ("Height", HEIGHT, 8, height),
        ("OffsetX", OFFSET_X, 0, width - width.min(8)),
        ("OffsetY", OFFSET_Y, 0, height - height.min(8)),
    ] {
        let limits = format!("<Min>{least}</Min><Max>{most}</Max><Inc>1</Inc>");
        xml.integer(name, address, "RW", &limits);
    }
    xml.int_register("PixelFormatReg", PIXEL_FORMAT, 4, "RW");
    let formats = identity.pixel_formats.iter();
    let formats: Vec<_> = formats.map(|format| (format.name(), format.code())).collect();
    xml.choice("PixelFormat", "PixelFormatReg", &formats);
}

fn acquisition_features(xml: &mut Xml, identity: &Identity) {
    xml.int_register("AcquisitionModeReg", ACQUISITION_MODE, 4, "RW");
    xml.choice("AcquisitionMode", "AcquisitionModeReg", &[("Continuous", 0)]);
    xml.int_register("AcquisitionReg", ACQUISITION, 4, "RW");
    xml.command("AcquisitionStart", "AcquisitionReg", 1);
    xml.command("AcquisitionStop", "AcquisitionReg", 0);
    xml.float("AcquisitionFrameRate", RATE, "Hz", identity.rate_hz);
    xml.float("ExposureTime", EXPOSURE_US, "us", (10.0, 1e6));
    xml.float("Gain", GAIN_DB, "dB", (0.0, 24.0));
    xml.int_register("TriggerModeReg", TRIGGER_MODE, 4, "RW");
    xml.choice("TriggerMode", "TriggerModeReg", &[("Off", 0)]);
    xml.line(format_args!(
        "<Enumeration Name=\"TriggerSelector\"><EnumEntry Name=\"FrameStart\"><Value>0</Value></EnumEntry><Value>0</Value></Enumeration>"
    ));
}

fn transport_features(xml: &mut Xml) {
    xml.integer("PayloadSize", PAYLOAD_BYTES, "RO", "");
    xml.integer("GevHeartbeatTimeout", HEARTBEAT_MS, "RW", "<Min>500</Min>");
    for (name, address) in [
        ("GevTimestampTickFrequency", TICK_HIGH),
        ("GevTimestampValue", TIMESTAMP_HIGH),
    ] {
        xml.line(format_args!(
            "<Integer Name=\"{name}\"><pValue>{name}Reg</pValue></Integer>"
        ));
        xml.int_register(&format!("{name}Reg"), address, 8, "RO");
    }
    xml.int_register("GevTimestampControlReg", TIMESTAMP_CONTROL, 4, "RW");
    xml.command("GevTimestampControlReset", "GevTimestampControlReg", 1);
    xml.command("GevTimestampControlLatch", "GevTimestampControlReg", 2);
    xml.bits("GevSCPHostPortReg", STREAM_PORT, (16, 31));
    xml.line(format_args!(
        "<Integer Name=\"GevSCPHostPort\"><pValue>GevSCPHostPortReg</pValue></Integer>"
    ));
    xml.bits("GevSCPSPacketSizeReg", PACKET_SIZE, (16, 31));
    xml.line(format_args!(
        "<Integer Name=\"GevSCPSPacketSize\"><pValue>GevSCPSPacketSizeReg</pValue><Min>576</Min><Max>65500</Max><Inc>4</Inc></Integer>"
    ));
    xml.bits("GevSCPSFireTestPacketReg", PACKET_SIZE, (0, 0));
    xml.command("GevSCPSFireTestPacket", "GevSCPSFireTestPacketReg", 1);
    xml.bits("GevSCPSDoNotFragmentReg", PACKET_SIZE, (1, 1));
    xml.line(format_args!(
        "<Boolean Name=\"GevSCPSDoNotFragment\"><pValue>GevSCPSDoNotFragmentReg</pValue><OnValue>1</OnValue><OffValue>0</OffValue></Boolean>"
    ));
    xml.integer("GevSCPD", PACKET_DELAY, "RW", "");
    xml.integer("GevSCDA", STREAM_ADDRESS, "RW", "");
    xml.integer("GevSCSP", STREAM_SOURCE_PORT, "RO", "");
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::net::Ipv4Addr;

    use super::*;
    use crate::scene::PixelFormat;

    #[test]
    fn every_name_that_is_used_is_defined_once() {
        let text = description(&Identity {
            address: Ipv4Addr::LOCALHOST,
            serial: "1".into(),
            user_name: String::new(),
            width_px: 640,
            height_px: 320,
            pixel_formats: vec![PixelFormat::Mono8],
            rate_hz: (1.0, 60.0),
            exposure_s: 0.001,
            link_mbps: 1000,
            genicam: None,
        });
        let mut defined = BTreeSet::new();
        for part in text.split(" Name=\"").skip(1) {
            let name = part.split('"').next().unwrap();
            let entry = [
                "Mono8",
                "Continuous",
                "Off",
                "FrameStart",
                "Disabled",
                "Uncalibrated",
                "Slave",
            ]
            .contains(&name);
            assert!(entry || defined.insert(name), "{name} is defined twice");
        }
        let mut used = 0;
        for tag in ["<pFeature>", "<pValue>", "<pPort>"] {
            for part in text.split(tag).skip(1) {
                let name = part.split('<').next().unwrap();
                assert!(defined.contains(name), "{name} is used and not defined");
                used += 1;
            }
        }
        assert!(used > 80, "{used}");
    }
}
