//! The systemd unit as systemd itself judges it, and as it runs it; the package.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may")]

mod lab;

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

fn unit() -> String {
    std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("systemd/pitchd.service")).unwrap()
}

/// `systemd-analyze` with these arguments; `None` where there is none.
fn analyze(arguments: &[&str]) -> Option<(bool, String)> {
    let Ok(output) = Command::new("systemd-analyze").args(arguments).output() else {
        lab::skip("systemd-analyze (Debian: systemd)");
        return None;
    };
    let text = [output.stdout, output.stderr].concat();
    Some((
        output.status.success(),
        String::from_utf8_lossy(&text).into_owned(),
    ))
}

#[test]
fn the_unit_is_clean() {
    // `verify` wants the program to be there: the test's own binary stands in for the installed one.
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("pitchd.service");
    let text = unit().replace("/usr/bin/pitchd", env!("CARGO_BIN_EXE_pitchd"));
    assert!(text.contains(env!("CARGO_BIN_EXE_pitchd")));
    std::fs::write(&path, text).unwrap();
    let Some((good, said)) = analyze(&["verify", path.to_str().unwrap()]) else {
        return;
    };
    let ours: Vec<_> = said.lines().filter(|l| l.contains("pitchd.service")).collect();
    assert!(good && ours.is_empty(), "{said}");
}

#[test]
fn the_unit_is_sandboxed() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("systemd/pitchd.service");
    let Some((good, said)) = analyze(&[
        "security",
        "--offline=true",
        "--threshold=25",
        "--no-pager",
        path.to_str().unwrap(),
    ]) else {
        return;
    };
    assert!(good, "{said}");
    assert!(said.contains("Overall exposure level"), "{said}");
}

/// A systemd of its own, in namespaces, with the unit and an emulated camera.
struct Booted {
    first: Child,
    /// Its process 1 as this namespace numbers it.
    init: String,
    folder: PathBuf,
}

impl Booted {
    /// The reason where this machine does not allow it.
    fn new(folder: &Path) -> Result<Self, String> {
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let mut first = Command::new(root.join("tests/lab/boot.sh"))
            .args([folder.as_os_str(), env!("CARGO_BIN_EXE_pitchd").as_ref()])
            .arg(root.join("systemd"))
            .stdout(Stdio::piped())
            .stderr(std::fs::File::create(folder.join("boot.log")).unwrap())
            .spawn()
            .map_err(|e| e.to_string())?;
        let lines = BufReader::new(first.stdout.take().unwrap()).lines();
        let ready = lines.map_while(Result::ok).any(|line| line == "ready");
        let children = format!("/proc/{0}/task/{0}/children", first.id());
        let init = std::fs::read_to_string(children)
            .unwrap_or_default()
            .trim()
            .to_owned();
        let booted = Self {
            first,
            init,
            folder: folder.to_owned(),
        };
        if ready && !booted.init.is_empty() {
            return Ok(booted);
        }
        Err(std::fs::read_to_string(folder.join("boot.log")).unwrap_or_default())
    }

    /// Runs a command inside.
    fn run(&self, command: &[&str]) -> (bool, String) {
        let root = self.folder.join("root");
        let output = Command::new("nsenter")
            .args(["-t", &self.init, "-m", "-p", "-n", "chroot"])
            .arg(root)
            .args(command)
            .output()
            .unwrap();
        let text = [output.stdout, output.stderr].concat();
        (
            output.status.success(),
            String::from_utf8_lossy(&text).into_owned(),
        )
    }

    /// A property of the unit.
    fn shows(&self, property: &str) -> String {
        let (_, text) = self.run(&["systemctl", "show", "pitchd", "--value", "-p", property]);
        text.trim().to_owned()
    }

    fn wait(&self, property: &str, wanted: &str, patience: Duration) {
        let until = Instant::now() + patience;
        while self.shows(property) != wanted {
            let (now, log) = (self.shows(property), self.run(&["cat", "/run/pitchd.log"]).1);
            assert!(
                Instant::now() < until,
                "{property} is {now:?}, wanted {wanted:?}:\n{log}"
            );
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    fn does(&self, command: &[&str]) {
        let (good, text) = self.run(command);
        assert!(good, "{command:?}: {text}");
    }
}

impl Drop for Booted {
    fn drop(&mut self) {
        // The end of its process 1 is the end of all others in there.
        let _ = Command::new("kill").args(["-KILL", &self.init]).status();
        let _ = self.first.kill();
        let _ = self.first.wait();
        let group = std::fs::read_to_string(self.folder.join("cgroup")).unwrap_or_default();
        let group = group.trim();
        if group.contains("/pitchd-lab-") {
            std::thread::sleep(Duration::from_millis(200));
            let _ = Command::new("find")
                .args([group, "-depth", "-type", "d", "-exec", "rmdir", "{}", ";"])
                .output();
        }
    }
}

const ALL_STREAM: &str = "1 of 1 cameras streaming";

#[test]
fn the_unit_runs_under_a_real_systemd() {
    let folder = tempfile::tempdir().unwrap();
    let etc = folder.path().join("etc");
    std::fs::create_dir(&etc).unwrap();
    let camera = "[[camera]]\nid = \"first\"\n";
    let rig = format!(
        "{camera}width_px = 320\nheight_px = 160\nframe_rate_hz = 40.0\n[camera.intrinsics]\n\
         fx_px = 300.0\nfy_px = 300.0\ncx_px = 159.5\ncy_px = 79.5\n"
    );
    let config = format!(
        "rig = \"rig.toml\"\nresults = \"/var/lib/pitchd/results\"\n[record]\nmode = \"continuous\"\n\
         folder = \"/var/lib/pitchd/recordings\"\nmemory_mib = 64\n{camera}address = \"127.0.0.9\"\npacket_size = 1500\n"
    );
    std::fs::write(etc.join("rig.toml"), rig).unwrap();
    std::fs::write(etc.join("pitchd.toml"), config).unwrap();
    let booted = match Booted::new(folder.path()) {
        Ok(booted) => booted,
        Err(why) => return lab::skip(&format!("a systemd that can be booted: {why}")),
    };
    // READY=1 makes it active; STATUS comes with the watchdog, which is fed by frames that were processed.
    booted.wait("ActiveState", "active", Duration::from_secs(30));
    booted.wait("StatusText", ALL_STREAM, Duration::from_secs(20));
    let log = || booted.run(&["cat", "/run/pitchd.log"]).1;
    assert!(!log().contains("stays an ordinary thread"), "{}", log());
    let id = booted.shows("MainPID");
    let (_, threads) = booted.run(&["sh", "-c", &format!("cat /proc/{id}/task/*/stat")]);
    // Name and, 39 words behind its bracket, the policy: 2 is SCHED_RR.
    let policies = threads.lines().filter_map(|line| {
        let (head, tail) = line.rsplit_once(')')?;
        let name = head.split_once('(')?.1;
        Some((name, tail.split_whitespace().nth(38)?))
    });
    // The library's own threads go by the name of the one that made them.
    let policies: Vec<_> = policies.collect();
    println!("{policies:?}");
    for name in [
        "arv_gv_stream",
        "cap-first",
        "eye-first",
        "look-first",
        "assemble",
    ] {
        assert!(
            policies.contains(&(name, "2")),
            "{name} is an ordinary thread: {policies:?}"
        );
    }
    let (_, status) = booted.run(&["cat", &format!("/proc/{id}/status")]);
    assert!(
        status.contains("NoNewPrivs:\t1") && status.contains("Seccomp:\t2"),
        "{status}"
    );
    assert!(lab::is_locked_or_said(&status, &log()), "{status}\n{}", log());

    // Reload by the unit's own command.
    booted.does(&[
        "sed",
        "-i",
        "s/^address/# &\\naddress/",
        "/etc/pitchd/pitchd.toml",
    ]);
    booted.does(&["systemctl", "reload", "pitchd"]);
    let until = Instant::now() + Duration::from_secs(10);
    while !log().contains("reload: nothing has changed") {
        assert!(Instant::now() < until, "{}", log());
        std::thread::sleep(Duration::from_millis(50));
    }

    // Killed: systemd starts it again, and frames come again.
    booted.does(&["systemctl", "kill", "-s", "KILL", "--kill-whom=main", "pitchd"]);
    let killed = Instant::now();
    booted.wait("NRestarts", "1", Duration::from_secs(10));
    booted.wait("StatusText", ALL_STREAM, Duration::from_secs(20));
    println!(
        "streaming again {:.1} s after kill -9 (the status comes with the watchdog)",
        killed.elapsed().as_secs_f64()
    );
    // Standing still: the watchdog is not fed, and that is the end of it.
    booted.does(&["systemctl", "kill", "-s", "STOP", "--kill-whom=main", "pitchd"]);
    booted.wait("NRestarts", "2", Duration::from_secs(20));
    booted.wait("StatusText", ALL_STREAM, Duration::from_secs(20));
    let (_, recorded) = booted.run(&["sh", "-c", "ls -d /var/lib/pitchd/recordings/continuous-*/"]);
    assert_eq!(
        recorded.lines().count(),
        3,
        "a recording of every run: {recorded}"
    );

    booted.does(&["systemctl", "stop", "pitchd"]);
    assert_eq!(
        (
            booted.shows("Result").as_str(),
            booted.shows("ExecMainStatus").as_str()
        ),
        ("success", "0"),
        "{}",
        log()
    );
    assert!(log().contains("pitchd: first Streaming"), "{}", log());
}

/// `make deb` as a person calls it, with the test's own program in place of a release build.
#[test]
fn the_package_holds_all_that_an_installation_needs() {
    let there = |program: &str| Command::new(program).arg("--version").output().is_ok();
    if !(there("make") && there("dpkg-deb")) {
        return lab::skip("make and dpkg-deb");
    }
    let folder = tempfile::tempdir().unwrap();
    let made = Command::new("make")
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .args(["deb", &format!("PROGRAM={}", env!("CARGO_BIN_EXE_pitchd"))])
        .arg(format!("DEB={}", folder.path().display()))
        .output()
        .unwrap();
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    let files = std::fs::read_dir(folder.path())
        .unwrap()
        .map(|e| e.unwrap().path());
    let package = files
        .into_iter()
        .find(|p| p.extension().is_some_and(|e| e == "deb"))
        .unwrap();
    let ask = |what: &str| {
        let output = Command::new("dpkg-deb").arg(what).arg(&package).output().unwrap();
        assert!(output.status.success());
        String::from_utf8_lossy(&output.stdout).into_owned()
    };
    let (info, contents) = (ask("--info"), ask("--contents"));
    println!("{info}");
    for line in [
        "Package: pitchd",
        "Version: ",
        "Architecture: ",
        "Maintainer: ",
        "libaravis-0.8",
        "postinst",
        "prerm",
        "postrm",
    ] {
        assert!(info.contains(line), "no {line:?} in:\n{info}");
    }
    for file in [
        "./usr/bin/pitchd",
        "./usr/lib/systemd/system/pitchd.service",
        "./usr/lib/sysctl.d/60-pitchd.conf",
        "./usr/lib/udev/rules.d/70-pitchd-usb3vision.rules",
        "./usr/lib/sysusers.d/pitchd.conf",
        "./usr/lib/tmpfiles.d/pitchd.conf",
        "./usr/share/man/man1/pitchd-run.1",
        "./usr/share/bash-completion/completions/pitchd",
        "./usr/share/zsh/vendor-completions/_pitchd",
        "./usr/share/doc/pitchd/README.md",
        "./usr/share/doc/pitchd/copyright",
    ] {
        assert!(contents.contains(file), "no {file} in:\n{contents}");
    }
    let foreign = contents.lines().filter(|l| !l.contains("root/root"));
    assert_eq!(foreign.count(), 0, "all belongs to root:\n{contents}");
}
