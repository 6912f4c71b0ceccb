//! The emulated camera as its peers see it: Aravis' own tool, and a client made of bare sockets.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may")]

mod lab;

use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::process::Command;
use std::time::{Duration, Instant};

use pitchd::emulation::gvcp::{Command as Gvcp, Request};
use pitchd::emulation::{Drill, Emulator, EmulatorOptions, Faults, Handing, ScriptShape, pattern};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;

const SHAPE: ScriptShape = ScriptShape {
    width_px: 320,
    height_px: 160,
    rate_hz: 50.0,
    exposure_s: 0.001,
};

fn camera(last: u8, faults: Faults) -> (Emulator, Ipv4Addr) {
    let address = Ipv4Addr::new(127, 0, 90, last);
    let options = EmulatorOptions {
        faults,
        ..EmulatorOptions::new(address, &format!("SN{last}"))
    };
    (Emulator::start(&options, SHAPE, pattern(SHAPE)).unwrap(), address)
}

/// A GVCP client of a few lines.
struct Client {
    control: UdpSocket,
    stream: UdpSocket,
    id: u16,
}

impl Client {
    fn new(camera: Ipv4Addr) -> Self {
        let control = UdpSocket::bind("127.0.0.1:0").unwrap();
        control.connect(SocketAddr::from((camera, 3956))).unwrap();
        control.set_read_timeout(Some(Duration::from_secs(2))).unwrap();
        let stream = UdpSocket::bind("127.0.0.1:0").unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(2))).unwrap();
        Self {
            control,
            stream,
            id: 0,
        }
    }
    fn send(&mut self, word: u16, payload: &[u8]) {
        self.id += 1;
        let mut packet = vec![0x42, 1];
        for number in [word, payload.len() as u16, self.id] {
            packet.extend(number.to_be_bytes());
        }
        packet.extend(payload);
        self.control.send(&packet).unwrap();
    }
    /// Status and payload of the answer.
    fn ask(&mut self, word: u16, payload: &[u8]) -> Option<(u16, Vec<u8>)> {
        self.send(word, payload);
        let mut answer = [0; 600];
        let bytes = self.control.recv(&mut answer).ok()?;
        assert_eq!(answer[6..8], self.id.to_be_bytes());
        Some((
            u16::from_be_bytes([answer[0], answer[1]]),
            answer[8..bytes].to_vec(),
        ))
    }
    fn write(&mut self, address: u32, value: u32) -> u16 {
        let payload = [address.to_be_bytes(), value.to_be_bytes()].concat();
        self.ask(0x82, &payload).unwrap().0
    }
    fn read(&mut self, address: u32) -> u32 {
        let (status, payload) = self.ask(0x80, &address.to_be_bytes()).unwrap();
        assert_eq!(status, 0);
        u32::from_be_bytes(payload.try_into().unwrap())
    }
    fn start(&mut self) {
        let port = u32::from(self.stream.local_addr().unwrap().port());
        for (address, value) in [
            (0xa00, 2),
            (0xd00, port),
            (0xd18, 0x7f00_0001),
            (0xd04, 1500),
            (0x2_0018, 1),
        ] {
            assert_eq!(self.write(address, value), 0, "{address:x}");
        }
    }
    /// Next stream packet: block, format, packet number, data.
    fn packet(&self) -> Option<(u16, u8, u32, Vec<u8>)> {
        let mut bytes = [0; 2000];
        let n = self.stream.recv(&mut bytes).ok()?;
        let packet = u32::from_be_bytes([0, bytes[5], bytes[6], bytes[7]]);
        Some((
            u16::from_be_bytes([bytes[2], bytes[3]]),
            bytes[4],
            packet,
            bytes[8..n].to_vec(),
        ))
    }
}

#[test]
fn aravis_own_tool_reads_and_writes_its_features() {
    let (_camera, address) = camera(1, Faults::default());
    let tool = Command::new("arv-tool-0.8")
        .args(["-a", &address.to_string(), "control"])
        .args([
            "DeviceSerialNumber",
            "Width",
            "Height",
            "PixelFormat",
            "PayloadSize",
        ])
        .args([
            "ExposureTime=2000",
            "AcquisitionFrameRate=25",
            "GevSCPSPacketSize=9000",
        ])
        .output();
    let Ok(output) = tool else {
        lab::skip("arv-tool-0.8 (Debian: aravis-tools-cli)");
        return;
    };
    let text = String::from_utf8_lossy(&output.stdout);
    for line in [
        "DeviceSerialNumber = SN1",
        "Width = 320",
        "Height = 160",
        "PixelFormat = Mono8",
        "PayloadSize = 51200",
        "ExposureTime = 2000",
        "AcquisitionFrameRate = 25",
        "GevSCPSPacketSize = 9000",
    ] {
        assert!(text.contains(line), "no `{line}` in:\n{text}");
    }
}

#[test]
fn gstreamers_source_takes_its_frames() {
    let address = Ipv4Addr::new(127, 0, 90, 6);
    // As root the library behind the source receives through a packet socket.
    let options = EmulatorOptions {
        handing: Handing::OneByOne,
        ..EmulatorOptions::new(address, "SN6")
    };
    let _camera = Emulator::start(&options, SHAPE, pattern(SHAPE)).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("frames");
    let output = Command::new("timeout")
        .args(["20", "gst-launch-1.0", "-q", "aravissrc", "num-buffers=10"])
        .args([
            &format!("camera-name={address}"),
            "!",
            "video/x-raw,format=GRAY8,width=320,height=160",
        ])
        .args(["!", "filesink", &format!("location={}", file.display())])
        .output();
    let there = Command::new("gst-launch-1.0").arg("--version").output().is_ok();
    let (true, Ok(output)) = (there, output) else {
        lab::skip("gst-launch-1.0 (Debian: gstreamer1.0-tools)");
        return;
    };
    let bytes = std::fs::read(&file).unwrap_or_default();
    let expected: Vec<Vec<u8>> = pattern(SHAPE).take(16).map(|f| f.pixels.to_vec()).collect();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    if said.contains("no element \"aravissrc\"") {
        lab::skip("the GStreamer plugin of Aravis (Debian: libaravis-0.8-0)");
        return;
    }
    assert_eq!(bytes.len(), 10 * 320 * 160, "{said}");
    assert!(bytes.chunks(320 * 160).all(|f| expected.iter().any(|e| e == f)));
}

#[test]
fn frames_arrive_whole_and_lost_packets_are_sent_again() {
    let (camera, address) = camera(
        2,
        Faults {
            clock_offset_s: 1000.0,
            ..Faults::default()
        },
    );
    let mut client = Client::new(address);
    client.start();
    // 1500 − 36 = 1464 bytes a packet: 51 200 bytes are 35 packets; packet 36 is the trailer.
    let (mut image, mut leader_ticks) = (Vec::new(), 0);
    let expected = pattern(SHAPE).next().unwrap();
    loop {
        let (block, format, number, data) = client.packet().unwrap();
        assert_eq!(block, 1);
        match format {
            1 => leader_ticks = u64::from_be_bytes(data[4..12].try_into().unwrap()),
            3 => image.extend_from_slice(&data),
            _ => {
                assert_eq!(number, 36);
                break;
            }
        }
    }
    assert!(image == expected.pixels.to_vec(), "the image that was sent");
    assert!(
        (1_000_000_000_000..1_010_000_000_000).contains(&leader_ticks),
        "{leader_ticks}"
    );
    // Stream 0, block 1, packets 3 to 4.
    client.send(0x40, &[0, 0, 0, 1, 0, 0, 0, 3, 0, 0, 0, 4, 0, 0, 0, 0]);
    let mut again = Vec::new();
    while again.len() < 2 {
        let (block, _, number, data) = client.packet().unwrap();
        if block == 1 {
            assert!(
                data == image[(number as usize - 1) * 1464..][..1464],
                "packet {number}"
            );
            again.push(number);
        }
    }
    assert_eq!(again, [3, 4]);
    // The camera counts a packet after it has sent it.
    let patience = Instant::now() + Duration::from_secs(5);
    while camera.counters().resent < 2 && Instant::now() < patience {
        std::thread::sleep(Duration::from_millis(5));
    }
    assert_eq!(camera.counters().resent, 2);
}

#[test]
fn one_program_holds_the_camera_until_it_falls_silent() {
    let (_camera, address) = camera(3, Faults::default());
    let (mut first, mut second) = (Client::new(address), Client::new(address));
    assert_eq!(first.write(0x938, 500), 0x8006, "no control yet");
    assert_eq!(first.write(0xa00, 2), 0);
    assert_eq!(first.write(0x938, 500), 0);
    assert_eq!(second.write(0xa00, 2), 0x8006);
    assert_eq!(second.read(0xa00), 2, "anybody may read");
    std::thread::sleep(Duration::from_millis(700));
    assert_eq!(second.write(0xa00, 2), 0, "the heartbeat of the first has lapsed");
    assert_eq!(first.write(0x938, 900), 0x8006);
}

#[test]
fn drills_freeze_silence_and_reboot_the_camera() {
    let (camera, address) = camera(
        4,
        Faults {
            clock_offset_s: 500.0,
            ..Faults::default()
        },
    );
    let mut client = Client::new(address);
    client.start();
    client.packet().unwrap();
    camera.drill(Drill::Freeze(Duration::from_millis(600)));
    std::thread::sleep(Duration::from_millis(50));
    client
        .stream
        .set_read_timeout(Some(Duration::from_millis(100)))
        .unwrap();
    while client.packet().is_some() {}
    assert_eq!(client.read(0xa00), 2, "frozen, control still answers");
    client
        .stream
        .set_read_timeout(Some(Duration::from_secs(2)))
        .unwrap();
    client.packet().unwrap();

    camera.drill(Drill::Reboot(Duration::from_millis(400)));
    let down = Instant::now();
    client
        .control
        .set_read_timeout(Some(Duration::from_millis(200)))
        .unwrap();
    assert_eq!(client.ask(0x80, &0xa00_u32.to_be_bytes()), None, "off");
    client
        .control
        .set_read_timeout(Some(Duration::from_secs(2)))
        .unwrap();
    std::thread::sleep(Duration::from_millis(450).saturating_sub(down.elapsed()));
    assert_eq!(client.read(0xa00), 0, "nobody holds a camera that has restarted");
    assert_eq!(client.write(0xa00, 2), 0);
    assert_eq!(client.write(0x944, 2), 0);
    let ticks = u64::from(client.read(0x948)) << 32 | u64::from(client.read(0x94c));
    assert!(ticks < 5_000_000_000, "its clock began anew: {ticks}");
}

/// A command of any kind, perhaps spoilt; none that sends the stream anywhere but here.
fn any_command(random: &mut Pcg64) -> Vec<u8> {
    let word = [0x02, 0x40, 0x80, 0x82, 0x84, 0x86, random.random::<u16>()][random.random_range(0..7)];
    let addresses: [u32; 12] = [
        0,
        0x200,
        0x938,
        0x944,
        0xa00,
        0xd00,
        0xd04,
        0x100_0000,
        0x2_0000,
        0x2_0018,
        0x2_0020,
        random.random(),
    ];
    let mut payload = Vec::new();
    for _ in 0..random.random_range(0..40) {
        let near = addresses[random.random_range(0..addresses.len())];
        let number: u32 = [
            near,
            near.wrapping_add(4),
            random.random_range(0..600),
            random.random(),
        ][random.random_range(0..4)];
        payload.extend(number.to_be_bytes());
    }
    let mut packet = vec![0x42, random.random_range(0..2)];
    for number in [word, payload.len() as u16, random.random_range(1..9)] {
        packet.extend(number.to_be_bytes());
    }
    packet.extend(payload);
    match random.random_range(0..4) {
        0 => packet.truncate(random.random_range(0..packet.len() + 1)),
        1 => {
            for _ in 0..random.random_range(1..5) {
                let at = random.random_range(0..packet.len());
                packet[at] = random.random();
            }
        }
        2 => packet.extend(vec![0xff; random.random_range(0..1400)]),
        _ => {}
    }
    let goes_elsewhere = match Gvcp::parse(&packet).map(|c| c.request) {
        Some(Request::WriteRegisters(writes)) => writes.iter().any(|(at, _)| (0xd18..0xd1c).contains(at)),
        Some(Request::WriteMemory { address, .. }) => (0xc00..0xd20).contains(&address),
        _ => false,
    };
    if goes_elsewhere { Vec::new() } else { packet }
}

#[test]
fn no_command_ends_the_camera_and_no_answer_is_long() {
    let (camera, address) = camera(7, Faults::default());
    let mut random = Pcg64::seed_from_u64(23);
    let holder = Client::new(address);
    let mut answer = [0; 65536];
    let (mut sent, mut answers, mut granted) = (0, 0, 0);
    holder
        .control
        .set_read_timeout(Some(Duration::from_millis(200)))
        .unwrap();
    let loopback = [0x42, 1, 0, 0x82, 0, 8, 0, 77, 0, 0, 0x0d, 0x18, 127, 0, 0, 1];
    holder
        .control
        .send(&[0x42, 1, 0, 0x82, 0, 8, 0, 76, 0, 0, 0x0a, 0, 0, 0, 0, 2])
        .unwrap();
    holder.control.send(&loopback).unwrap();
    for round in 0..1000 {
        for _ in 0..30 {
            let packet = any_command(&mut random);
            sent += usize::from(!packet.is_empty());
            holder.control.send(&packet).unwrap();
        }
        // A read whose answer ends the round; it comes after all others.
        let mark = [0x42, 1, 0, 0x80, 0, 4, 0x7a, (round % 200) as u8, 0, 0, 0, 0];
        holder.control.send(&mark).unwrap();
        let until = Instant::now() + Duration::from_secs(5);
        loop {
            assert!(Instant::now() < until, "no answer after {sent} commands");
            let Ok(bytes) = holder.control.recv(&mut answer) else {
                continue;
            };
            assert!((8..=548).contains(&bytes), "{bytes} bytes of answer");
            if answer[2..4] == [0, 0x81] && answer[6..8] == mark[6..8] {
                break;
            }
            answers += 1;
            granted += usize::from(answer[..2] == [0, 0]);
        }
    }
    println!("{sent} commands, {answers} answers, {granted} granted");
    assert!(sent > 25_000 && granted > 1000 && answers > granted);
    // Whatever patience was written: it is 500 ms again, and nobody holds the camera.
    for write in [[0, 0, 9, 0x38, 0, 0, 1, 244], [0, 0, 0x0a, 0, 0, 0, 0, 0]] {
        let command = [&[0x42, 1, 0, 0x82, 0, 8, 0, 78][..], &write].concat();
        holder.control.send(&command).unwrap();
    }
    drop(holder);
    // Control was claimed and lost many times over: whoever asks gets it in the end, and frames flow.
    let until = Instant::now() + Duration::from_secs(30);
    let mut client = Client::new(address);
    while client.write(0xa00, 2) != 0 {
        assert!(Instant::now() < until, "nobody can hold it any more");
        std::thread::sleep(Duration::from_millis(100));
        client = Client::new(address);
    }
    for (at, value) in [(0x2_0008, 0), (0x2_000c, 0), (0x2_0000, 320), (0x2_0004, 160)] {
        assert_eq!(client.write(at, value), 0, "{at:x}");
    }
    let before = camera.counters().frames;
    client.start();
    client.packet().unwrap();
    assert!(camera.counters().frames + 1 > before);
}
