//! The cameras' part of `pitchd check`: each is opened as the daemon would open it, and watched for a second.

use std::net::Ipv4Addr;
use std::time::{Duration, Instant};

use super::check::{Line, Verdict, line};
use crate::capture::aravis::{CameraMemory, LiveCamera, LiveCounters, LiveError, LiveOptions, Next};
use crate::config::{CameraConnection, DaemonConfig};
use crate::daemon::pipeline::live_options;
use crate::scene::Rig;
use crate::time::{PtpDomain, StampedMidpoint, SystemClock};

const WATCHED: Duration = Duration::from_secs(1);
/// A camera's first frame may be this late.
const FIRST: Duration = Duration::from_secs(2);
/// Frames in memory while it is watched.
const BUFFERS: usize = 24;

/// One line a camera.
pub fn lines(config: &DaemonConfig, rig: &Rig) -> Vec<Line> {
    config
        .cameras
        .iter()
        .filter(|camera| rig.index_of(&camera.id).is_some())
        .map(|camera| try_camera(config, camera, rig))
        .collect()
}

fn try_camera(config: &DaemonConfig, camera: &CameraConnection, rig: &Rig) -> Line {
    let what = format!("camera {}", camera.id);
    let options = match live_options(config, camera, rig, &PtpDomain::default()) {
        Ok(options) => LiveOptions {
            buffers: BUFFERS,
            buffers_ready: BUFFERS,
            ..options
        },
        Err(error) => return line(Verdict::Fail, &what, error.to_string(), None),
    };
    let mut memory = CameraMemory::default();
    match LiveCamera::start(&options, &mut memory) {
        Ok(live) => watch(live, &mut memory, (&what, &options)),
        Err(error) => refused(&what, &error, camera.address),
    }
}

fn refused(what: &str, error: &LiveError, address: Option<Ipv4Addr>) -> Line {
    let text = error.to_string();
    let text = text.strip_prefix(&format!("{what}: ")).unwrap_or(&text);
    let (found, mend) = text.split_once("; ").map_or((text, None), |(f, m)| (f, Some(m)));
    if let LiveError::Held { .. } = error {
        let mend = "if that is the running daemon, all is well; else end that program";
        return line(Verdict::Warn, what, found.to_owned(), Some(mend));
    }
    let table = std::fs::read_to_string("/proc/net/route").unwrap_or_default();
    if let (LiveError::Absent { .. }, Some(address)) = (error, address)
        && !address.is_loopback()
        && !is_near(address, &table)
    {
        let [a, b, c, _] = address.octets();
        let found = format!("{found}: no interface of this host is in that network");
        let mend = format!(
            "ip addr add {a}.{b}.{c}.1/24 dev INTERFACE   (the one with the camera's cable), or correct `address`"
        );
        return line(Verdict::Fail, what, found, Some(&mend));
    }
    line(Verdict::Fail, what, found.to_owned(), mend)
}

/// Whether the kernel's table of routes has this address on a wire of this host, without a gateway.
fn is_near(address: Ipv4Addr, table: &str) -> bool {
    table.lines().skip(1).any(|route| {
        let fields: Vec<_> = route.split_whitespace().collect();
        // Hexadecimal in the order of this machine's bytes.
        let number = |k: usize| {
            let text = fields.get(k)?;
            Some(u32::from_str_radix(text, 16).ok()?.swap_bytes())
        };
        match (number(1), number(2), number(7)) {
            (Some(network), Some(0), Some(mask)) => mask != 0 && u32::from(address) & mask == network,
            _ => false,
        }
    })
}

/// What came within a second.
#[derive(Default)]
struct Came {
    first: Option<StampedMidpoint>,
    last: Option<StampedMidpoint>,
    frames: u64,
    misshapen: Option<String>,
}

fn watch(mut live: LiveCamera, memory: &mut CameraMemory, (what, options): (&str, &LiveOptions)) -> Line {
    let mut came = Came::default();
    let begun = Instant::now();
    let mut until = begun + FIRST;
    while Instant::now() < until {
        match live.next(memory, &SystemClock, Duration::from_millis(100)) {
            Next::Frame(frame) => {
                if came.first.is_none() {
                    until = Instant::now() + WATCHED;
                }
                came.frames += 1;
                live.look_at_clock();
                came.first.get_or_insert(frame.frame.stamp.stamped);
                came.last = Some(frame.frame.stamp.stamped);
            }
            Next::Misshapen(shape) => came.misshapen = Some(shape),
            Next::Incomplete | Next::Nothing => {}
        }
    }
    let place = format!(
        "{} at {}, {}{}{}",
        live.model(),
        live.place(),
        options.pixel_format,
        packets(live.packet_size()),
        live.ptp_state()
            .map_or_else(String::new, |state| format!(", PTP {state}"))
    );
    live.stop();
    told(what, &came, (options.frame_rate_hz, &place), memory.counters())
}

/// A camera of the USB bus has none.
fn packets(size: u32) -> String {
    match size {
        0 => String::new(),
        bytes => format!(", packets of {bytes} bytes"),
    }
}

fn told(what: &str, came: &Came, (asked_hz, place): (f64, &str), counters: LiveCounters) -> Line {
    let span_s = match (came.first, came.last) {
        (Some(first), Some(last)) => last.seconds_since(first.nanos()),
        _ => 0.0,
    };
    if came.frames < 2 || span_s <= 0.0 {
        let (why, mend) = match &came.misshapen {
            Some(shape) => (format!("frames come as {shape}"), "power the camera off and on"),
            None if counters.incomplete > 0 => (
                "frames come, none of them whole".to_owned(),
                "look at cable, switch and the MTU of every port on the way, or set packet_size = 1500",
            ),
            None => (
                "no frames come".to_owned(),
                "let UDP from the camera through the firewall; look at the route back to this host",
            ),
        };
        return line(Verdict::Fail, what, format!("{place}: {why}"), Some(mend));
    }
    let seen = came.frames + counters.missing;
    let rate_hz = (seen - 1) as f64 / span_s;
    let found = format!(
        "{place}: {rate_hz:.1} Hz, {} of {seen} frames whole{}",
        came.frames,
        match counters.missing {
            0 => String::new(),
            _ => format!(
                " ({} with packets missing, {} without a free buffer)",
                counters.incomplete, counters.underruns
            ),
        }
    );
    if counters.missing > 0 {
        let mend = "raise net.core.rmem_max and the MTU (lines above), and see whether the host is busy";
        return line(Verdict::Warn, what, found, Some(mend));
    }
    if (rate_hz - asked_hz).abs() > 0.02 * asked_hz {
        let mend = format!(
            "the rig says {asked_hz} Hz: the camera does not keep it; lower the rate, the region or the exposure"
        );
        return line(Verdict::Warn, what, found, Some(&mend));
    }
    line(Verdict::Ok, what, found, None)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_is_near_if_a_route_without_gateway_leads_there() {
        let table = "Iface\tDestination\tGateway\tFlags\tRefCnt\tUse\tMetric\tMask\tMTU\tWindow\tIRTT\n\
                     eth0\t00000000\t0101A8C0\t0003\t0\t0\t0\t00000000\t0\t0\t0\n\
                     eth1\t00015D0A\t00000000\t0001\t0\t0\t0\t00FFFFFF\t0\t0\t0\n";
        assert!(is_near(Ipv4Addr::new(10, 93, 1, 2), table));
        assert!(
            !is_near(Ipv4Addr::new(10, 93, 2, 2), table),
            "the way out to the internet leads to no camera"
        );
        assert!(!is_near(Ipv4Addr::new(10, 93, 1, 2), ""));
    }

    #[test]
    fn a_camera_without_packets_is_not_said_to_have_empty_ones() {
        assert_eq!(packets(0), "");
        assert_eq!(packets(8000), ", packets of 8000 bytes");
    }

    #[test]
    fn what_came_is_judged() {
        let at = |ms: i64| Some(StampedMidpoint::from_nanos(ms * 1_000_000));
        let came = |frames: u64| Came {
            first: at(0),
            last: at(1000),
            frames,
            misshapen: None,
        };
        let judge = |came: &Came, counters| told("camera a", came, (50.0, "X at Y"), counters);
        let none = LiveCounters::default();
        assert_eq!(judge(&came(51), none).verdict, Verdict::Ok);
        assert_eq!(judge(&came(40), none).verdict, Verdict::Warn, "too slow");
        let missing = LiveCounters {
            missing: 3,
            incomplete: 2,
            ..none
        };
        let line = judge(&came(48), missing);
        assert_eq!(
            (line.verdict, line.found.as_str()),
            (
                Verdict::Warn,
                "X at Y: 50.0 Hz, 48 of 51 frames whole (2 with packets missing, 0 without a free buffer)"
            )
        );
        assert_eq!(judge(&Came::default(), none).verdict, Verdict::Fail);
        let other = Came {
            misshapen: Some("64x32 Mono8".into()),
            ..Came::default()
        };
        assert!(judge(&other, none).found.contains("64x32"));
    }
}
