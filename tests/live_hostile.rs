//! Peers that lie: answers on the control port that are cut, mixed up or noise, and cameras that describe themselves by
//! broken GenICam files. The daemon's own code may refuse them and go on; nothing may end it.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may")]

use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

use pitchd::capture::aravis::{
    CameraAddress, CameraMemory, LiveCamera, LiveOptions, discover, is_held, ping,
};
use pitchd::emulation::{Emulator, EmulatorOptions, ScriptShape, pattern};
use pitchd::scene::CameraId;
use rand::{Rng, RngCore, SeedableRng};
use rand_pcg::Pcg64;

/// An answer to a request, spoilt in one of many ways; now and then it is right.
fn spoilt(request: &[u8], random: &mut Pcg64) -> Vec<u8> {
    let word = u16::from_be_bytes([request[2], request[3]]) + 1;
    let mut payload = vec![0; random.random_range(0..600)];
    random.fill_bytes(&mut payload);
    let size = u16::try_from(payload.len()).unwrap();
    let mut answer: Vec<u8> = [0, word, size].iter().flat_map(|w| w.to_be_bytes()).collect();
    answer.extend_from_slice(&request[6..8]);
    answer.extend(payload);
    match random.random_range(0..6) {
        0 => answer.truncate(random.random_range(0..12)),
        1 => answer[6] ^= 0x55,
        2 => answer[random.random_range(0..8)] = random.random(),
        3 => random.fill_bytes(&mut answer),
        4 => answer.extend(std::iter::repeat_n(0xff, 400)),
        _ => {}
    }
    answer
}

#[test]
fn a_peer_of_noise_is_read_or_left() {
    let address = Ipv4Addr::new(127, 0, 94, 1);
    let socket = UdpSocket::bind(SocketAddr::from((address, 3956))).unwrap();
    socket.set_read_timeout(Some(Duration::from_millis(50))).unwrap();
    let (stop, asked) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicUsize::new(0)));
    let (stopped, counted) = (stop.clone(), asked.clone());
    let liar = std::thread::spawn(move || {
        let mut random = Pcg64::seed_from_u64(7);
        let mut datagram = [0; 1024];
        while !stopped.load(Ordering::Relaxed) {
            let Ok((bytes, from)) = socket.recv_from(&mut datagram) else {
                continue;
            };
            counted.fetch_add(1, Ordering::Relaxed);
            for _ in 0..random.random_range(1..4) {
                let answer = spoilt(&datagram[..bytes.max(8)], &mut random);
                socket.send_to(&answer, from).unwrap();
            }
        }
    });
    let patience = Duration::from_millis(5);
    let (mut found, mut held) = (0, 0);
    for _ in 0..400 {
        if let Some(camera) = ping(address, patience) {
            assert!(camera.serial.chars().all(|c| !c.is_control()));
            found += 1;
        }
        held += usize::from(is_held(address, patience).is_some());
    }
    stop.store(true, Ordering::Relaxed);
    liar.join().unwrap();
    let _ = discover(Duration::from_millis(20));
    println!("{found} times believed to be a camera, {held} times asked who holds it");
    assert!(asked.load(Ordering::Relaxed) == 800 && found > 0 && found < 400 && held > 0);
}

/// The camera's own description, broken in one place.
fn broken(good: &str, random: &mut Pcg64) -> String {
    let at = random.random_range(0..good.len());
    let (head, tail) = good.split_at(at);
    match random.random_range(0..5) {
        0 => head.to_owned(),
        1 => format!("{head}</Category><![CDATA[{tail}"),
        2 => good.replace("<Integer", "<Float").replace("</Integer", "</Float"),
        3 => good.replacen("Address>0x", "Address>-", 9),
        _ => good.replace("PayloadSize", "PayloadSise"),
    }
}

#[test]
fn broken_descriptions_are_refused_in_words() {
    let shape = ScriptShape {
        width_px: 64,
        height_px: 32,
        rate_hz: 40.0,
        exposure_s: 0.001,
    };
    let good = {
        let address = Ipv4Addr::new(127, 0, 94, 2);
        let options = EmulatorOptions::new(address, "H0");
        let camera = Emulator::start(&options, shape, pattern(shape)).unwrap();
        camera.genicam()
    };
    assert!(good.contains("PayloadSize"));
    let mut random = Pcg64::seed_from_u64(11);
    let (mut refused, mut opened) = (0, 0);
    for k in 0..24_u8 {
        let genicam = match k {
            0 => String::new(),
            1 => "\u{0}\u{1}\u{2}".repeat(100),
            2 => "<".repeat(3000),
            _ => broken(&good, &mut random),
        };
        let address = Ipv4Addr::new(127, 0, 94, 10 + k);
        let options = EmulatorOptions {
            genicam: Some(genicam),
            ..EmulatorOptions::new(address, "H1")
        };
        let _camera = Emulator::start(&options, shape, pattern(shape)).unwrap();
        let which = CameraAddress {
            address: Some(address),
            ..CameraAddress::default()
        };
        let live = LiveOptions {
            buffers: 8,
            packet_size: Some(1500),
            realtime_priority: None,
            ..LiveOptions::new(CameraId::new("first").unwrap(), which, (64, 32), 40.0)
        };
        match LiveCamera::start(&live, &mut CameraMemory::default()) {
            Ok(camera) => {
                opened += 1;
                camera.stop();
            }
            Err(error) => {
                refused += 1;
                let text = error.to_string();
                assert!(text.starts_with("camera first: "), "{text}");
            }
        }
    }
    println!("{refused} refused, {opened} opened all the same");
    assert!(refused >= 12, "{refused}");
}
