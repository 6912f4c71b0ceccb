//! The systemd unit as systemd itself judges it.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may")]

use std::path::Path;
use std::process::Command;

fn unit() -> String {
    std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("systemd/pitchd.service")).unwrap()
}

/// `systemd-analyze` with these arguments; `None` where there is none.
fn analyze(arguments: &[&str]) -> Option<(bool, String)> {
    let Ok(output) = Command::new("systemd-analyze").args(arguments).output() else {
        println!("skipped: no systemd-analyze on this machine");
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
