//! A network of namespaces: one for the daemon, one behind a veth pair for every camera. Nothing of it is in the
//! host's own namespace, and all of it goes when the value is dropped.

#![allow(dead_code, reason = "every test uses its own part of it")]

use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::SystemTime;

/// Namespaces `<name>h` (daemon) and `<name>0`, `<name>1`, … (cameras), addresses 10.93.<camera>.1 and .2.
pub struct Lab {
    name: String,
    cameras: usize,
}

/// This machine lacks what a test needs: the test skips, and says what. Where every test must run
/// (`PITCHD_TESTS_MUST_RUN=1`, as `.ci/run` has it) that is a failure.
pub fn skip(missing: &str) {
    let must_run = std::env::var("PITCHD_TESTS_MUST_RUN").is_ok_and(|v| v == "1");
    assert!(
        !must_run,
        "PITCHD_TESTS_MUST_RUN=1, and this machine lacks what the test needs: {missing}"
    );
    println!("skipped: {missing}");
}

/// Now, seconds of Unix time.
pub fn unix_s() -> f64 {
    let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
    now.unwrap().as_secs_f64()
}

/// Whether memory can be locked is this machine's matter; that it is, or that the log says it is not, is the daemon's.
/// `status`: the text of `/proc/<id>/status`.
pub fn is_locked_or_said(status: &str, log: &str) -> bool {
    let line = status.lines().find(|l| l.starts_with("VmLck:")).unwrap();
    println!("{line}");
    let kib: u64 = line.split_whitespace().nth(1).unwrap().parse().unwrap();
    kib > 1024 || log.contains("memory is not locked")
}

fn ip(arguments: &str) -> Result<(), String> {
    let words = arguments.split_whitespace();
    match Command::new("ip").args(words).output() {
        Ok(output) if output.status.success() => Ok(()),
        Ok(output) => Err(format!(
            "ip {arguments}: {}",
            String::from_utf8_lossy(&output.stderr).trim()
        )),
        Err(error) => Err(format!("ip {arguments}: {error}")),
    }
}

impl Lab {
    /// Sets it up; the reason where this machine does not allow it.
    pub fn new(tag: char, cameras: usize) -> Result<Self, String> {
        let lab = Self {
            name: format!("pd{tag}{}", std::process::id()),
            cameras,
        };
        let host = lab.host();
        ip(&format!("netns add {host}"))?;
        ip(&format!("-n {host} link set lo up"))?;
        for k in 0..cameras {
            let camera = lab.camera(k);
            ip(&format!("netns add {camera}"))?;
            ip(&format!("-n {camera} link set lo up"))?;
            ip(&format!(
                "-n {host} link add cam{k} mtu 9000 type veth peer name eth0 mtu 9000 netns {camera}"
            ))?;
            ip(&format!("-n {host} addr add 10.93.{k}.1/24 dev cam{k}"))?;
            ip(&format!("-n {host} link set cam{k} up"))?;
            ip(&format!("-n {camera} addr add {}/24 dev eth0", Self::address(k)))?;
            ip(&format!("-n {camera} link set eth0 up"))?;
            ip(&format!("-n {camera} route add default dev eth0"))?;
        }
        Ok(lab)
    }

    /// The daemon's namespace.
    pub fn host(&self) -> String {
        format!("{}h", self.name)
    }

    /// A camera's namespace.
    pub fn camera(&self, k: usize) -> String {
        format!("{}{k}", self.name)
    }

    /// A camera's address.
    pub fn address(k: usize) -> String {
        format!("10.93.{k}.2")
    }

    /// `ip` in the daemon's namespace.
    pub fn on_host(&self, arguments: &str) {
        ip(&format!("-n {} {arguments}", self.host())).unwrap();
    }

    /// `ip` in a camera's namespace.
    pub fn on_camera(&self, k: usize, arguments: &str) {
        ip(&format!("-n {} {arguments}", self.camera(k))).unwrap();
    }

    /// Starts `pitchd run` with `pitchd.toml` of this folder in the daemon's namespace; it tells of its cameras five times
    /// a second.
    pub fn daemon(&self, folder: &Path, (out, log): (&Path, &Path)) -> Reaped {
        let config = folder.join("pitchd.toml");
        let status = ["-v", "run", "--status-every", "0.2", "--config"];
        let arguments = [status.as_slice(), &[config.to_str().unwrap()]].concat();
        Reaped(Self::start((&self.host(), None), &arguments, out, log))
    }

    /// Starts the program under test in a namespace; both outputs go to files, standard input stays open. With a
    /// real-time priority if one is given: a camera does not wait for a busy machine.
    pub fn start(
        (namespace, priority): (&str, Option<u8>),
        arguments: &[&str],
        out: &Path,
        log: &Path,
    ) -> Child {
        let file = |path: &Path| Stdio::from(std::fs::File::create(path).unwrap());
        let priority = priority.map(|p| p.to_string());
        let mut words: Vec<&str> = priority.iter().flat_map(|p| ["chrt", "-r", p]).collect();
        words.extend(["ip", "netns", "exec", namespace, env!("CARGO_BIN_EXE_pitchd")]);
        words.extend(arguments);
        Command::new(words[0])
            .args(&words[1..])
            .env("NO_COLOR", "1")
            .stdin(Stdio::piped())
            .stdout(file(out))
            .stderr(file(log))
            .spawn()
            .unwrap()
    }
}

impl Drop for Lab {
    fn drop(&mut self) {
        // What was never made cannot be deleted: nothing to say about it.
        for k in 0..self.cameras {
            let _ = ip(&format!("netns del {}", self.camera(k)));
        }
        let _ = ip(&format!("netns del {}", self.host()));
    }
}

/// A child that does not outlive the test.
pub struct Reaped(pub Child);

impl Drop for Reaped {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}
