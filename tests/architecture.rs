//! Holds the map of rooms: who may name whom (DESIGN.md, "Rooms").

#![allow(clippy::unwrap_used, reason = "a test may")]

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Room, and the rooms it may name. A room that is not here is an error: give it a place on the map first.
const ALLOWED: &[(&str, &[&str])] = &[
    ("time", &[]),
    ("geometry", &[]),
    ("scene", &["time", "geometry"]),
    ("vision", &["geometry"]),
    ("detection", &["time", "geometry", "scene"]),
    ("tracking", &["time", "geometry", "scene"]),
    // One camera's chain: the only worker that names two others, because a track is refined by its detector.
    ("eye", &["time", "geometry", "scene", "detection", "tracking"]),
    ("flight", &["time", "geometry", "scene"]),
    // The calibration solves flights too: it may take the trajectory model from its neighbour, not the reverse.
    ("calibration", &["time", "geometry", "scene", "vision", "flight"]),
    ("recording", &["time", "geometry", "scene"]),
    ("capture", &["time", "geometry", "scene", "recording", "vision"]),
    ("simulation", &["time", "geometry", "scene", "recording"]),
    (
        "emulation",
        &["time", "geometry", "scene", "recording", "simulation"],
    ),
    ("export", &["time", "geometry", "scene", "flight", "recording"]),
    (
        "evaluation",
        &[
            "time",
            "geometry",
            "scene",
            "flight",
            "calibration",
            "recording",
            "simulation",
            "detection",
            "tracking",
            "eye",
            "export",
        ],
    ),
    ("config", &["geometry", "scene"]),
    (
        "daemon",
        &[
            "time",
            "geometry",
            "scene",
            "vision",
            "detection",
            "tracking",
            "eye",
            "flight",
            "calibration",
            "recording",
            "capture",
            "simulation",
            "export",
            "config",
        ],
    ),
    (
        "cli",
        &[
            "time",
            "geometry",
            "scene",
            "vision",
            "detection",
            "tracking",
            "eye",
            "flight",
            "calibration",
            "recording",
            "capture",
            "simulation",
            "emulation",
            "export",
            "evaluation",
            "config",
            "daemon",
        ],
    ),
];

/// Crates that only one room may name.
const GUARDED: &[(&str, &str)] = &[
    ("aravis_sys", "capture"),
    ("opencv", "vision"),
    ("argmin", "calibration"),
    ("mcap", "recording"),
    ("clap", "cli"),
];

fn rust_files(folder: &Path, into: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            rust_files(&path, into);
        } else if path.extension().is_some_and(|e| e == "rs") {
            into.push(path);
        }
    }
}

/// The code of a file without comments and without its test module.
fn code_of(path: &Path) -> String {
    let text = std::fs::read_to_string(path).unwrap();
    let code = text.split("#[cfg(test)]").next().unwrap_or_default();
    code.lines()
        .map(|l| l.split("//").next().unwrap_or_default())
        .collect::<Vec<_>>()
        .join("\n")
}

/// Words that follow `prefix`, with the words inside one level of braces.
fn named_after(code: &str, prefix: &str) -> BTreeSet<String> {
    let word = |s: &str| -> String {
        s.chars()
            .take_while(|c| c.is_alphanumeric() || *c == '_')
            .collect()
    };
    let mut found = BTreeSet::new();
    for (at, _) in code.match_indices(prefix) {
        let rest = &code[at + prefix.len()..];
        if let Some(inside) = rest.strip_prefix('{') {
            found.extend(
                inside
                    .split('}')
                    .next()
                    .unwrap_or_default()
                    .split(',')
                    .map(|s| word(s.trim())),
            );
        } else {
            found.insert(word(rest));
        }
    }
    found.remove("");
    found
}

#[test]
fn rooms_only_name_the_rooms_below_them() {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let allowed: BTreeMap<_, _> = ALLOWED.iter().copied().collect();
    let mut files = Vec::new();
    rust_files(&source, &mut files);
    let (mut arrows, mut faults) = (BTreeSet::new(), Vec::new());
    for path in &files {
        let inside = path.strip_prefix(&source).unwrap();
        let mut parts = inside
            .components()
            .map(|c| c.as_os_str().to_string_lossy().into_owned());
        let room = parts.next().unwrap().trim_end_matches(".rs").to_owned();
        // Test modules may use any room.
        let is_test = inside
            .file_stem()
            .is_some_and(|s| s == "tests" || s.to_string_lossy().ends_with("_tests"));
        if room == "lib" || room == "main" || is_test {
            continue;
        }
        let Some(may) = allowed.get(room.as_str()) else {
            faults.push(format!("{}: room `{room}` is not on the map", inside.display()));
            continue;
        };
        let code = code_of(path);
        for other in named_after(&code, "crate::").into_iter().filter(|o| *o != room) {
            if allowed.contains_key(other.as_str()) {
                if !may.contains(&other.as_str()) {
                    faults.push(format!("{}: `{room}` may not name `{other}`", inside.display()));
                }
                arrows.insert((room.clone(), other));
            }
        }
        for (krate, home) in GUARDED {
            if room != *home
                && (code.contains(&format!("{krate}::")) || code.contains(&format!("use {krate}")))
            {
                faults.push(format!(
                    "{}: only `{home}` may name the crate `{krate}`",
                    inside.display()
                ));
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    assert!(
        files.len() >= 40 && arrows.len() >= 20,
        "saw {} files, {} arrows",
        files.len(),
        arrows.len()
    );
}

#[test]
fn the_map_has_no_circle() {
    let allowed: BTreeMap<_, _> = ALLOWED.iter().copied().collect();
    let mut placed: BTreeSet<&str> = BTreeSet::new();
    while placed.len() < allowed.len() {
        let ready: Vec<_> = allowed
            .iter()
            .filter(|(room, may)| !placed.contains(*room) && may.iter().all(|m| placed.contains(m)))
            .map(|(room, _)| *room)
            .collect();
        assert!(!ready.is_empty(), "a circle among the rooms not yet placed");
        placed.extend(ready);
    }
}

#[test]
fn every_room_stands_in_design_md() {
    let design = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("DESIGN.md")).unwrap();
    for (room, _) in ALLOWED {
        assert!(
            design.contains(&format!("`{room}/`")) || design.contains(&format!("`{room}`")),
            "{room}"
        );
    }
}

#[test]
fn every_file_says_what_it_is_for() {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    rust_files(&source, &mut files);
    for path in &files {
        let text = std::fs::read_to_string(path).unwrap();
        assert!(text.starts_with("//! "), "{} has no first line", path.display());
    }
}
