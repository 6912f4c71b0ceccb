//! Daemon files: what is read, what is refused and where, what a reload may change.

use super::*;

const GOOD: &str = "rig = \"rig.toml\"\n[[camera]]\nid = \"first\"\naddress = \"10.0.0.5\"\n[[camera]]\nid = \"third\"\nserial = \"A7\"\n";

#[test]
fn a_file_is_read_with_its_defaults() {
    let config = parse_daemon(Path::new("/etc/pitchd/pitchd.toml"), GOOD).unwrap();
    assert_eq!(config.rig, Path::new("/etc/pitchd/rig.toml"));
    assert_eq!(config.cameras.len(), 2);
    assert_eq!(config.cameras[1].serial.as_deref(), Some("A7"));
    assert_eq!(
        (config.first_pitches, config.cameras[0].socket_buffer_bytes),
        (4, 32 << 20)
    );
}

#[test]
fn how_usb_frames_are_fetched_is_a_choice() {
    let path = Path::new("p.toml");
    let mode = |mode: &str| {
        parse_daemon(
            path,
            &GOOD.replace("\"A7\"", &format!("\"A7\"\nusb_mode = {mode}")),
        )
    };
    assert!(!parse_daemon(path, GOOD).unwrap().cameras[1].usb_async);
    assert!(mode("\"async\"").unwrap().cameras[1].usb_async);
    assert!(!mode("\"sync\"").unwrap().cameras[1].usb_async);
    assert!(mode("\"fast\"").unwrap_err().to_string().contains("p.toml:8: "));
}

#[test]
fn how_pixels_are_sent_is_a_choice() {
    let path = Path::new("p.toml");
    let format = |format: &str| parse_daemon(path, &format!("{GOOD}pixel_format = \"{format}\"\n"));
    assert_eq!(
        parse_daemon(path, GOOD).unwrap().cameras[1].pixel_format,
        PixelFormat::Mono8
    );
    for known in PixelFormat::ALL {
        assert_eq!(format(known.name()).unwrap().cameras[1].pixel_format, known);
    }
    let error = format("Mono14").unwrap_err().to_string();
    assert_eq!(
        error,
        "p.toml:8: pixel_format: unknown value `Mono14`; known: Mono8, Mono10p, Mono12p, Mono10Packed, Mono12Packed, \
         Mono10, Mono12"
    );
}

#[test]
fn how_balls_are_found_is_a_choice() {
    let path = Path::new("/etc/pitchd/pitchd.toml");
    let with = |detector: &str| parse_daemon(path, &format!("detector = \"{detector}\"\n{GOOD}"));
    let running = parse_daemon(path, GOOD).unwrap();
    assert_eq!(running.detector, DetectorKind::Ball);
    for known in DetectorKind::ALL {
        assert_eq!(with(known.name()).unwrap().detector, known);
    }
    assert_eq!(with("kim2019").unwrap().needs_restart(&running), ["detector"]);
    assert_eq!(
        with("peak").unwrap_err().to_string(),
        "/etc/pitchd/pitchd.toml:1: detector: unknown value `peak`; known: ball, kim2019"
    );
}

#[test]
fn features_keep_their_order_and_say_what_is_wrong() {
    let path = Path::new("/etc/pitchd/pitchd.toml");
    let with = |features: &str| parse_daemon(path, &format!("{GOOD}features = {features}\n"));
    let config =
        with("[[\"TriggerSelector\", \"FrameStart\"], [\"Rate\", 175.0], [\"A\", 3], [\"B\", true]]");
    assert_eq!(
        config.unwrap().cameras[1].features,
        [
            (
                "TriggerSelector".to_owned(),
                FeatureValue::Text("FrameStart".into())
            ),
            ("Rate".to_owned(), FeatureValue::Float(175.0)),
            ("A".to_owned(), FeatureValue::Integer(3)),
            ("B".to_owned(), FeatureValue::Switch(true)),
        ]
    );
    let error = with("[[\"Rate\", [1]]]").unwrap_err().to_string();
    assert!(
        error.contains("pitchd.toml:8: ") && error.contains("the value of Rate is of type array"),
        "{error}"
    );
}

#[test]
fn a_reload_knows_what_can_change_at_once() {
    let path = Path::new("/etc/pitchd/pitchd.toml");
    let (old, with) = (parse_daemon(path, GOOD).unwrap(), |text: &str| {
        parse_daemon(path, &format!("{text}{GOOD}")).unwrap()
    });
    let new = with("calibration = \"c.json\"\nresults = \"r\"\nin_flight = false\n");
    assert_eq!(new.holds_at_once(&old), ["calibration"]);
    assert_eq!(new.needs_restart(&old), ["results", "in_flight"]);
    let text = format!("{GOOD}[record]\nafter_s = 1.0\nmemory_mib = 64\n[calibrate]\nevery_pitches = 3\n");
    let new = parse_daemon(path, &text).unwrap();
    assert_eq!(
        new.holds_at_once(&old),
        ["calibrate.every_pitches", "record.after_s"]
    );
    assert_eq!(new.needs_restart(&old), ["record.memory_mib"]);
    assert!(old.needs_restart(&old).is_empty() && old.holds_at_once(&old).is_empty());
    let mut running = old.clone();
    running.take_what_holds_at_once(&new);
    assert!(new.holds_at_once(&running).is_empty());
    assert_eq!(new.needs_restart(&running), ["record.memory_mib"]);
}

#[test]
fn cameras_of_one_name_are_told_apart_by_their_serial_numbers() {
    let named = |first: &str, third: &str| {
        let text = GOOD.replace("address = \"10.0.0.5\"", &format!("{first}\nuser_name = \"a\""));
        let text = text.replace("serial = \"A7\"", &format!("{third}\nuser_name = \"a\""));
        parse_daemon(Path::new("p.toml"), &text).is_ok()
    };
    assert!(named("serial = \"A6\"", "serial = \"A7\""));
    assert!(!named("serial = \"A6\"", ""));
    assert!(!named("address = \"10.0.0.5\"", "address = \"10.0.0.6\""));
}

#[test]
fn nothing_is_recorded_unless_asked_for() {
    let path = Path::new("/etc/pitchd/pitchd.toml");
    assert_eq!(parse_daemon(path, GOOD).unwrap().record.mode, RecordMode::Off);
    let clips = format!("{GOOD}[record]\nmode = \"clips\"\nfolder = \"r\"\nmemory_mib = 64\n");
    let record = parse_daemon(path, &clips).unwrap().record;
    assert_eq!((record.mode, record.memory_bytes), (RecordMode::Clips, 64 << 20));
    assert_eq!(record.folder, Path::new("/etc/pitchd/r"));
    let error = parse_daemon(path, &clips.replace("clips", "clip"))
        .unwrap_err()
        .to_string();
    assert!(error.contains("clips"), "{error}");
}

#[test]
fn what_is_wrong_is_said_with_its_line() {
    for (wrong, line, part) in [
        (GOOD.replace("serial = \"A7\"", "serail = \"A7\""), 7, "serial"),
        (GOOD.replace("\"third\"", "\"first\""), 6, "twice"),
        (
            GOOD.replace("serial = \"A7\"", "address = \"10.0.0.5\""),
            6,
            "same device",
        ),
        (
            GOOD.replace("address = \"10.0.0.5\"", "user_name = \"a\"")
                .replace("serial = \"A7\"", "user_name = \"a\""),
            6,
            "`first` and `third` are the same device",
        ),
        (GOOD.replace("serial = \"A7\"", "gain_db = 1.0"), 6, "give serial"),
        (
            GOOD.replace("serial = \"A7\"", "serial = \"A7\"\npacket_size = 90"),
            8,
            "packet_size",
        ),
        (GOOD.replace("10.0.0.5", "10.0.0"), 4, ""),
    ] {
        let error = parse_daemon(Path::new("p.toml"), &wrong).unwrap_err().to_string();
        assert!(
            error.starts_with(&format!("p.toml:{line}: ")) && error.contains(part),
            "{error}"
        );
    }
}
