//! `pitchd check`: is this host fit for live cameras, and what to do where it is not.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;

use rustix::process::{Resource, getrlimit};

use super::check_cameras;
use crate::config::{load_daemon, load_rig};

/// Check host and cameras.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  pitchd check
  pitchd check --config /etc/pitchd/pitchd.toml --json

With --config every camera of it that no program holds is opened as `pitchd run` would open it, and its frames are
watched for a second. Exit code 1 if anything fails; warnings do not.")]
pub struct CheckArgs {
    /// Check this configuration and its cameras too.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// JSON.
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Verdict {
    Ok,
    Warn,
    Fail,
}

#[derive(Debug, serde::Serialize)]
pub(super) struct Line {
    pub verdict: Verdict,
    pub what: String,
    pub found: String,
    /// The command that mends it.
    pub mend: Option<String>,
}

const SOCKET_BUFFER_BYTES: u64 = 32 << 20;

/// Prints one line a check.
///
/// # Errors
/// Something fails.
pub fn run(args: &CheckArgs) -> anyhow::Result<()> {
    let mut lines = host_lines();
    if let Some(path) = &args.config {
        lines.extend(config_lines(path));
    }
    if args.json {
        say_line!("{}", serde_json::to_string_pretty(&lines)?);
    } else {
        for line in &lines {
            let verdict = match line.verdict {
                Verdict::Ok => "OK  ",
                Verdict::Warn => "warn",
                Verdict::Fail => "FAIL",
            };
            say_line!("{verdict}  {}: {}", line.what, line.found);
            if let Some(mend) = line.mend.as_ref().filter(|_| line.verdict != Verdict::Ok) {
                say_line!("      mend: {mend}");
            }
        }
    }
    let failed = lines.iter().filter(|l| l.verdict == Verdict::Fail).count();
    if failed > 0 {
        anyhow::bail!("{failed} check(s) failed");
    }
    Ok(())
}

pub(super) fn line(verdict: Verdict, what: &str, found: String, mend: Option<&str>) -> Line {
    Line {
        verdict,
        what: what.to_owned(),
        found,
        mend: mend.map(str::to_owned),
    }
}

fn number_in(path: &str) -> Option<u64> {
    std::fs::read_to_string(path).ok()?.trim().parse().ok()
}

/// A number of the system against the least that is wanted.
fn at_least(what: &str, (found, wanted): (Option<u64>, u64), below: Verdict, mend: &str) -> Line {
    match found {
        Some(n) if n >= wanted => line(Verdict::Ok, what, n.to_string(), None),
        Some(n) => line(below, what, format!("{n}, wanted {wanted}"), Some(mend)),
        None => line(Verdict::Warn, what, "cannot be read".to_owned(), None),
    }
}

fn host_lines() -> Vec<Line> {
    let mut lines = vec![
        at_least(
            "socket buffers (net.core.rmem_max)",
            (number_in("/proc/sys/net/core/rmem_max"), SOCKET_BUFFER_BYTES),
            Verdict::Warn,
            "sysctl -w net.core.rmem_max=33554432   (for good: the sysctl.d file that make install puts in place)",
        ),
        at_least(
            "input queue (net.core.netdev_max_backlog)",
            (number_in("/proc/sys/net/core/netdev_max_backlog"), 5000),
            Verdict::Warn,
            "sysctl -w net.core.netdev_max_backlog=10000",
        ),
    ];
    lines.extend(interface_lines());
    if let Some(mib) = number_in("/sys/module/usbcore/parameters/usbfs_memory_mb") {
        lines.push(at_least(
            "USB memory (usbfs_memory_mb)",
            (Some(mib), 1000),
            Verdict::Warn,
            "echo 1000 > /sys/module/usbcore/parameters/usbfs_memory_mb   (matters for USB3 cameras only)",
        ));
    }
    let limit = |resource| getrlimit(resource).current.unwrap_or(u64::MAX);
    lines.push(at_least(
        "real-time priority limit",
        (Some(if is_root() { 99 } else { limit(Resource::Rtprio) }), 20),
        Verdict::Warn,
        "run under the systemd unit (LimitRTPRIO), or: ulimit -r 60",
    ));
    lines.push(at_least(
        "locked memory limit, bytes",
        (
            Some(if is_root() {
                u64::MAX
            } else {
                limit(Resource::Memlock)
            }),
            1 << 30,
        ),
        Verdict::Warn,
        "run under the systemd unit (LimitMEMLOCK), or: ulimit -l unlimited",
    ));
    lines.push(disk_line(&std::env::temp_dir()));
    lines
}

fn is_root() -> bool {
    rustix::process::geteuid().is_root()
}

/// MTU and speed of every Ethernet interface that is up.
fn interface_lines() -> Vec<Line> {
    let Ok(folder) = std::fs::read_dir("/sys/class/net") else {
        return vec![line(
            Verdict::Warn,
            "network interfaces",
            "cannot be listed".to_owned(),
            None,
        )];
    };
    let mut lines = Vec::new();
    for entry in folder.flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        let read = |key: &str| std::fs::read_to_string(entry.path().join(key)).unwrap_or_default();
        // 1: Ethernet.
        if read("type").trim() != "1" || read("operstate").trim() != "up" {
            continue;
        }
        let (mtu, speed) = (read("mtu"), read("speed"));
        let speed = speed.trim().parse::<i64>().ok().filter(|s| *s > 0);
        let speed = speed.map_or("speed unknown".to_owned(), |s| format!("{s} Mb/s"));
        let small = mtu.trim().parse::<u32>().is_ok_and(|m| m < 9000);
        lines.push(line(
            if small { Verdict::Warn } else { Verdict::Ok },
            &format!("interface {name}"),
            format!("MTU {}, {speed}", mtu.trim()),
            Some(&format!("if cameras are on it: ip link set dev {name} mtu 9000")),
        ));
    }
    lines
}

/// Writes 64 MiB and waits until they are on the disk.
fn disk_line(folder: &Path) -> Line {
    let path = folder.join(format!("pitchd-check-{}", std::process::id()));
    let write = || -> std::io::Result<f64> {
        let block = vec![0x5a_u8; 1 << 20];
        let begun = Instant::now();
        let mut file = std::fs::File::create(&path)?;
        for _ in 0..64 {
            file.write_all(&block)?;
        }
        file.sync_all()?;
        Ok(64.0 / begun.elapsed().as_secs_f64() * 1.048_576)
    };
    let rate = write();
    let _ = std::fs::remove_file(&path);
    let what = format!("disk under {}", folder.display());
    match rate {
        Ok(rate) if rate >= 400.0 => line(Verdict::Ok, &what, format!("{rate:.0} MB/s"), None),
        Ok(rate) => line(
            Verdict::Warn,
            &what,
            format!("{rate:.0} MB/s; continuous recording of one 2048x1024 camera at 175 Hz is 367 MB/s"),
            Some("record clips, not continuously, or record to an NVMe disk"),
        ),
        Err(error) => line(Verdict::Fail, &what, error.to_string(), None),
    }
}

fn config_lines(path: &Path) -> Vec<Line> {
    let what = format!("configuration {}", path.display());
    let config = match load_daemon(path) {
        Ok(config) => config,
        Err(error) => return vec![line(Verdict::Fail, &what, error.to_string(), None)],
    };
    let mut lines = vec![line(
        Verdict::Ok,
        &what,
        format!("{} camera(s)", config.cameras.len()),
        None,
    )];
    match load_rig(&config.rig) {
        Ok(rig) => {
            lines.extend(check_cameras::lines(&config, &rig));
            for camera in config.cameras.iter().filter(|c| rig.index_of(&c.id).is_none()) {
                let found = format!("camera `{}` is not in {}", camera.id, config.rig.display());
                lines.push(line(Verdict::Fail, "rig", found, None));
            }
            lines.push(line(
                Verdict::Ok,
                "rig",
                format!("{} camera(s)", rig.cameras.len()),
                None,
            ));
        }
        Err(error) => lines.push(line(Verdict::Fail, "rig", error.to_string(), None)),
    }
    lines
}
