//! Peers that lie: answers on the control port that are cut, mixed up or noise, and cameras that describe themselves by
//! broken GenICam files. The daemon's own code may refuse them and go on; nothing may end it.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may")]

mod lab;

use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use pitchd::capture::aravis::{
    CameraAddress, CameraMemory, LiveCamera, LiveOptions, discover, is_held, ping,
};
use pitchd::emulation::{Drill, Emulator, EmulatorOptions, Faults, ScriptShape, StrangeDescription, pattern};
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

/// How a camera of 64×32 pixels at 40 Hz is opened at this address.
fn small_live(address: Ipv4Addr) -> LiveOptions {
    let which = CameraAddress {
        address: Some(address),
        ..CameraAddress::default()
    };
    LiveOptions {
        buffers: 8,
        packet_size: Some(1500),
        realtime_priority: None,
        ..LiveOptions::new(CameraId::new("first").unwrap(), which, (64, 32), 40.0)
    }
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
            genicam: Some(genicam.into()),
            ..EmulatorOptions::new(address, "H1")
        };
        let _camera = Emulator::start(&options, shape, pattern(shape)).unwrap();
        let live = small_live(address);
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

/// A description that states another address, size or packing than it has, or that no program could walk.
fn strange(good: &str) -> Vec<(&'static str, StrangeDescription)> {
    let at = |stated: &str| StrangeDescription {
        stated: Some(stated.to_owned()),
        ..StrangeDescription::from(good.to_owned())
    };
    let holds = |bytes: Vec<u8>, name: &str| StrangeDescription {
        name: name.to_owned(),
        bytes,
        stated: None,
    };
    let with = |nodes: &str| {
        good.replace(
            "</RegisterDescription>",
            &format!("{nodes}</RegisterDescription>"),
        )
    };
    let chain = |uses: usize| {
        let nodes = (0..60).map(|k| {
            let next = format!("<pVariable Name=\"V\">K{}</pVariable>", k + 1).repeat(uses);
            format!("<IntSwissKnife Name=\"K{k}\">{next}<Formula>1</Formula></IntSwissKnife>")
        });
        with(&nodes.collect::<String>())
    };
    let itself = good
        .replace("<pValue>WidthReg</pValue>", "<pValue>Width</pValue>")
        .replace(
            "<Integer Name=\"PayloadSize\">",
            "<Integer Name=\"PayloadSize\"><pValue>PayloadSize</pValue>",
        );
    assert_ne!(itself, good);
    let zip = b"PK\x03\x04"
        .iter()
        .chain(good.as_bytes())
        .copied()
        .collect::<Vec<u8>>();
    vec![
        ("absurd size", at("Local:a.xml;1000000;FFFFFFFFFFFF")),
        ("absurd size", at("Local:a.xml;1000000;7FFFFFFFFFFFFFFF")),
        ("stopped answering", at("Local:a.xml;1000000;F00000")),
        ("stopped answering", at("Local:a.xml;7000000;100")),
        ("own memory", at("File:///dev/zero")),
        ("own memory", at("http://127.0.0.1/a.xml")),
        ("cut short", holds(zip.clone(), "a.zip")),
        ("cut short", holds(b"PK\x03\x04\x14\0".to_vec(), "a.zip")),
        ("cut short", holds(vec![0xa5; 900_000], "a.zip")),
        ("no XML", holds(vec![0x3c; 900_000], "a.xml")),
        ("nested", holds("<a>".repeat(300_000).into_bytes(), "a.xml")),
        ("depends on itself", StrangeDescription::from(itself)),
        ("takes", StrangeDescription::from(chain(2))),
        (
            "length",
            StrangeDescription::from(
                good.replace("<Length>8</Length>", "<Length>0x7fffffffffffffff</Length>"),
            ),
        ),
        (
            "no XML",
            StrangeDescription::from(format!(
                "<!DOCTYPE a [<!ENTITY b \"{}\">]>{good}",
                "x".repeat(9000)
            )),
        ),
    ]
}

#[test]
fn what_the_library_would_not_survive_never_reaches_it() {
    let shape = ScriptShape {
        width_px: 64,
        height_px: 32,
        rate_hz: 40.0,
        exposure_s: 0.001,
    };
    let start = |last: u8, genicam: Option<StrangeDescription>| {
        let address = Ipv4Addr::new(127, 0, 94, last);
        let options = EmulatorOptions {
            genicam,
            ..EmulatorOptions::new(address, "H2")
        };
        let camera = Emulator::start(&options, shape, pattern(shape)).unwrap();
        let live = small_live(address);
        (camera, live)
    };
    let (own, live) = start(50, None);
    let good = own.genicam();
    LiveCamera::start(&live, &mut CameraMemory::default())
        .unwrap()
        .stop();
    let cases = strange(&good);
    for (k, (why, genicam)) in cases.iter().enumerate() {
        let (_camera, live) = start(51 + k as u8, Some(genicam.clone()));
        let begun = Instant::now();
        let error = LiveCamera::start(&live, &mut CameraMemory::default())
            .err()
            .unwrap();
        let text = error.to_string();
        println!("{:.2} s: {text}", begun.elapsed().as_secs_f64());
        assert!(
            text.contains("describes itself") && text.contains(why),
            "{why}: {text}"
        );
        assert!(text.len() < 300 && !text.contains('\n'), "{text}");
        assert!(begun.elapsed() < Duration::from_secs(12), "{why}");
    }
    assert!(cases.len() >= 15);
}

/// Frames of `first` in the last status line of the log.
fn frames_of_first(log: &std::path::Path) -> u64 {
    let log = std::fs::read_to_string(log).unwrap();
    let line = log
        .lines()
        .rev()
        .find(|l| l.contains("first Streaming: "))
        .unwrap_or_default();
    let number = line.split("first Streaming: ").nth(1).unwrap_or("0");
    number.split(' ').next().unwrap().parse().unwrap()
}

#[test]
fn a_hostile_camera_harms_neither_the_daemon_nor_the_other_camera() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let shape = ScriptShape {
        width_px: 320,
        height_px: 160,
        rate_hz: 40.0,
        exposure_s: 0.001,
    };
    let (mut rig, mut config) = (
        String::new(),
        "rig = \"rig.toml\"\nresults = \"results\"\n".to_owned(),
    );
    for (id, last) in [("first", 101), ("third", 102)] {
        rig += &format!(
            "[[camera]]\nid = \"{id}\"\nwidth_px = 320\nheight_px = 160\nframe_rate_hz = 40.0\n[camera.intrinsics]\n\
             fx_px = 300.0\nfy_px = 300.0\ncx_px = 159.5\ncy_px = 79.5\n"
        );
        config += &format!("[[camera]]\nid = \"{id}\"\naddress = \"127.0.94.{last}\"\npacket_size = 1500\n");
    }
    std::fs::write(path("rig.toml"), rig).unwrap();
    std::fs::write(path("pitchd.toml"), config).unwrap();
    let camera = |last: u8| {
        let options = EmulatorOptions::new(Ipv4Addr::new(127, 0, 94, last), "H3");
        Emulator::start(&options, shape, pattern(shape)).unwrap()
    };
    let (healthy, hostile) = (camera(101), camera(102));
    let daemon = std::process::Command::new(env!("CARGO_BIN_EXE_pitchd"))
        .args(["-v", "run", "--status-every", "0.2", "--config"])
        .arg(path("pitchd.toml"))
        .stdout(std::process::Stdio::null())
        .stderr(std::fs::File::create(path("log")).unwrap())
        .spawn()
        .unwrap();
    let mut daemon = lab::Reaped(daemon);
    let id = daemon.0.id().to_string();
    let mut wait = |wanted: &str, from: usize| {
        let until = Instant::now() + Duration::from_secs(60);
        loop {
            let log = std::fs::read_to_string(path("log")).unwrap();
            if log[from.min(log.len())..].contains(wanted) {
                return log.len();
            }
            assert_eq!(daemon.0.try_wait().unwrap(), None, "it ended:\n{log}");
            assert!(Instant::now() < until, "no {wanted:?} in:\n{}", &log[from..]);
            std::thread::sleep(Duration::from_millis(50));
        }
    };
    wait("first Streaming", 0);
    let mut at = wait("third Streaming", 0);
    let manglings = [
        "noise", "cut", "long", "number", "block", "kind", "status", "leader", "trailer", "bits", "any",
    ];
    let mut phases: Vec<(String, f64)> = Vec::new();
    for mangling in manglings {
        phases.push((format!("mangle=1,mangling={mangling}"), 0.7));
        phases.push((format!("mangle=0.02,mangling={mangling}"), 0.7));
    }
    phases.push(("mangle=1,mangling=payload".into(), 3.0));
    phases.push(("mangle=0".into(), 1.0));
    phases.push(("mangle=1,mangling=shape".into(), 3.0));
    // Opened anew while it lies about everything.
    phases.push(("mangle_control=0.1".into(), 4.0));
    phases.push(("mangle_control=0.6,mangle=0.3".into(), 8.0));
    for (text, lasts_s) in &phases {
        let (before, sent_before) = (frames_of_first(&path("log")), healthy.counters().frames);
        hostile.drill(Drill::Faults(Faults::default().changed_by(text).unwrap()));
        if text.starts_with("mangle_control") {
            hostile.drill(Drill::Reboot(Duration::from_millis(300)));
        }
        std::thread::sleep(Duration::from_secs_f64(*lasts_s));
        at = wait("first Streaming", at);
        let sent = healthy.counters().frames - sent_before;
        let came = frames_of_first(&path("log")) - before;
        // The log tells five times a second.
        assert!(came + 24 > sent, "{text}: {came} frames of {sent}");
    }
    hostile.drill(Drill::Faults(Faults::default()));
    wait("third Streaming", at);
    assert!(
        std::process::Command::new("kill")
            .args(["-TERM", &id])
            .status()
            .unwrap()
            .success()
    );
    let status = daemon.0.wait().unwrap();
    let log = std::fs::read_to_string(path("log")).unwrap();
    for line in log.lines().filter(|l| l.starts_with("pitchd: ")) {
        println!("{line}");
    }
    assert!(status.success(), "{log}");
    let first = log
        .lines()
        .rev()
        .find(|l| l.starts_with("pitchd: first"))
        .unwrap();
    let number = |word: &str| -> u64 {
        let before = first.split(word).next().unwrap();
        before.rsplit(' ').next().unwrap().parse().unwrap()
    };
    // Not one by the other camera's doing; a host that stands still loses some.
    let (frames, lost) = (number(" frames"), number(" missing") + number(" dropped"));
    assert!(100 * lost <= 2 * frames, "{first}");
    let third = log
        .lines()
        .rev()
        .find(|l| l.starts_with("pitchd: third"))
        .unwrap();
    assert!(!third.contains(" 0 of another shape"), "{third}");
    assert!(
        log.lines()
            .any(|l| l.starts_with("pitchd: first") && l.contains("lost 0 times")),
        "{log}"
    );
    assert!(
        log.contains("frames come as 160x160 Mono8") && log.contains("none of them whole"),
        "what is wrong is said:\n{log}"
    );
}
