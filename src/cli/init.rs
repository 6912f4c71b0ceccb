//! `pitchd init`: a first `pitchd.toml` and rig file from the cameras that are there.

use std::fmt::Write as _;
use std::net::Ipv4Addr;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, bail};

use super::seen::{self, Seen};

/// Write a first pitchd.toml and rig.toml from the cameras found.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  pitchd init --out /etc/pitchd
  pitchd init --out . --address 127.0.0.5 --address 127.0.0.6

Files that are there already are left alone. What a person has to measure is marked with `measure` in rig.toml.")]
pub struct InitArgs {
    /// Folder for pitchd.toml and rig.toml.
    #[arg(long, value_name = "DIR", default_value = ".")]
    pub out: PathBuf,
    /// Ask these addresses instead of all interfaces.
    #[arg(long, value_name = "IP")]
    pub address: Vec<Ipv4Addr>,
}

/// Writes both files.
///
/// # Errors
/// No camera, or a file that is there already.
pub fn run(args: &InitArgs) -> anyhow::Result<()> {
    let found = seen::cameras(&args.address, Duration::from_millis(800));
    if found.is_empty() {
        bail!(
            "no GigE Vision camera answered, and no USB3 Vision camera is plugged in: `pitchd check` looks at the host, \
             --address asks one address"
        );
    }
    let names = names_of(&found);
    std::fs::create_dir_all(&args.out).with_context(|| args.out.display().to_string())?;
    write_new(&args.out.join("pitchd.toml"), &daemon_file(&found, &names))?;
    write_new(&args.out.join("rig.toml"), &rig_file(&found, &names))?;
    say_line!(
        "next: measure what rig.toml asks for, then `pitchd check --config {}`",
        args.out.join("pitchd.toml").display()
    );
    Ok(())
}

fn write_new(path: &Path, text: &str) -> anyhow::Result<()> {
    use std::io::Write as _;
    let mut file = std::fs::OpenOptions::new()
        .write(true)
        .create_new(true)
        .open(path)
        .with_context(|| format!("{} is left as it is", path.display()))?;
    file.write_all(text.as_bytes())
        .with_context(|| path.display().to_string())?;
    say_line!("{}", path.display());
    Ok(())
}

/// An id for each camera: its user-defined name where that is one and the only one, else cam1, cam2, …
fn names_of(found: &[Seen]) -> Vec<String> {
    let usable = |name: &str| {
        crate::scene::CameraId::new(name).is_ok() && found.iter().filter(|f| f.user_name == name).count() == 1
    };
    found
        .iter()
        .enumerate()
        .map(|(k, camera)| {
            if usable(&camera.user_name) {
                camera.user_name.clone()
            } else {
                format!("cam{}", k + 1)
            }
        })
        .collect()
}

/// A TOML string; a camera's own words may hold anything.
fn quoted(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}

fn daemon_file(found: &[Seen], names: &[String]) -> String {
    let mut text = "\
# pitchd's own file: which camera is which, and where results go. Paths are beside this file unless absolute.
rig = \"rig.toml\"
results = \"/var/lib/pitchd/results\"
# calibration = \"calibration.json\"   # to begin with; otherwise the first pitches calibrate
# in_flight = false                    # no estimates while a ball flies
# detector = \"kim2019\"               # peaks of the difference image, as in the paper, to compare with

[calibrate]
first_pitches = 4      # before the first calibration
window_pitches = 16    # looked back on
every_pitches = 8      # new ones before the next

[record]
mode = \"off\"           # off, clips (0.5 s before to 0.5 s after every pitch) or continuous
folder = \"/var/lib/pitchd/recordings\"
memory_mib = 2048      # most memory for frames
quota_gib = 100        # the oldest recordings go beyond this
"
    .to_owned();
    for (camera, name) in found.iter().zip(names) {
        // Writing to a String cannot fail.
        let _ = write!(
            text,
            "\n# {} {}, seen at {}\n[[camera]]\nid = {}\nserial = {}   # the same camera at any place\n{}\
             # pixel_format = \"Mono12p\"   # Mono8 unless given; the upper eight bits are used\n\
             # gain_db = 6.0\n\
             # features = [[\"BlackLevel\", 4.0]]   # whatever else it can do, by GenICam name, in this order\n",
            one_line(&camera.vendor),
            one_line(&camera.model),
            one_line(&place_of(camera)),
            quoted(name),
            quoted(&camera.serial),
            link_choices(camera.gige)
        );
    }
    text
}

/// Where a camera is, in words.
fn place_of(camera: &Seen) -> String {
    match camera.gige {
        Some(address) => address.to_string(),
        None => format!("{} {}", camera.protocol, camera.address),
    }
}

/// What can be chosen of a camera's link.
fn link_choices(address: Option<Ipv4Addr>) -> String {
    match address {
        Some(address) => format!(
            "# address = \"{address}\"      # only this address\n# packet_size = 9000      # negotiated unless given\n\
             # ptp = true            # its clock follows the network's (PTP)\n"
        ),
        None => "# usb_mode = \"async\"    # fetch several transfers at once\n".to_owned(),
    }
}

fn one_line(text: &str) -> String {
    text.chars().filter(|c| !c.is_control()).collect()
}

fn rig_file(found: &[Seen], names: &[String]) -> String {
    let mut text = "\
# What a person knows of the site. `measure`: the numbers below are a guess.
[site]
name = \"New site\"
field = \"professional\"
motion = \"flight\"
"
    .to_owned();
    for (camera, name) in found.iter().zip(names) {
        let _ = write!(
            text,
            "\n# {} {}\n[[camera]]\nid = {}\nwidth_px = 2048\nheight_px = 1024\nframe_rate_hz = 175.0\nexposure_s = 0.001\n\
             [camera.intrinsics]   # measure\nfx_px = 1790.0\nfy_px = 1790.0\ncx_px = 1023.5\ncy_px = 511.5\n\
             distortion = [0.0, 0.0, 0.0, 0.0, 0.0]\n\
             # Landmarks: at least four that this camera sees, clicked in its image (measure).\n\
             # [[camera.landmark]]\n# name = \"plate_tip\"\n# pixel_px = [912.3, 640.8]\n# sigma_px = 0.5\n",
            one_line(&camera.vendor),
            one_line(&camera.model),
            quoted(name)
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::aravis::{Found, ListedDevice};
    use crate::config::{parse_daemon, parse_rig};

    fn on_the_network(last: u8, user_name: &str) -> Seen {
        Seen::from(Found {
            address: Ipv4Addr::new(10, 0, 0, last),
            vendor: "A\nB".to_owned(),
            model: "M".to_owned(),
            serial: format!("S\"{last}"),
            user_name: user_name.to_owned(),
        })
    }

    #[test]
    fn what_is_written_can_be_read() {
        let found = [
            on_the_network(5, "first"),
            on_the_network(6, "x"),
            on_the_network(7, "x"),
            on_the_network(8, ""),
        ];
        let names = names_of(&found);
        assert_eq!(names, ["first", "cam2", "cam3", "cam4"]);
        let config = parse_daemon(Path::new("/e/pitchd.toml"), &daemon_file(&found, &names)).unwrap();
        assert_eq!(config.cameras[3].serial.as_deref(), Some("S\"8"));
        let rig = parse_rig(Path::new("/e/rig.toml"), &rig_file(&found, &names)).unwrap();
        assert_eq!(rig.cameras.len(), 4);
    }

    #[test]
    fn a_usb_camera_is_named_by_its_serial_number() {
        let near = ListedDevice {
            id: "V-M-U7".to_owned(),
            vendor: "V".to_owned(),
            model: "M".to_owned(),
            serial: "U7".to_owned(),
            address: "1-2".to_owned(),
            protocol: "USB3Vision".to_owned(),
        };
        let found = [on_the_network(5, "first"), Seen::from(near)];
        let names = names_of(&found);
        let text = daemon_file(&found, &names);
        assert!(text.contains("# V M, seen at USB3Vision 1-2\n"), "{text}");
        let (_, usb) = text.split_once("U7").unwrap();
        assert!(!usb.contains("packet_size") && !usb.contains("ptp"), "{usb}");
        // As it is, and with every choice taken: what is offered is understood.
        let chosen: String = text
            .lines()
            .map(|l| match l.strip_prefix("# ") {
                Some(choice) if choice.contains(" = ") => format!("{choice}\n"),
                _ => format!("{l}\n"),
            })
            .collect();
        for (text, usb_async) in [(text, false), (chosen, true)] {
            let config = parse_daemon(Path::new("/e/pitchd.toml"), &text).unwrap();
            let usb = &config.cameras[1];
            assert_eq!((usb.id.as_str(), usb.serial.as_deref()), ("cam2", Some("U7")));
            assert_eq!((usb.address, usb.usb_async), (None, usb_async));
        }
    }
}
