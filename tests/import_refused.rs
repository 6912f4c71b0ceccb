//! `pitchd import`, run as a person would: what it says when something is wrong, and what it leaves as it was.

#![allow(clippy::unwrap_used, clippy::panic)]

#[path = "lab/importing.rs"]
mod importing;

use std::fs;

use importing::{HEIGHT, Place, WIDTH, assert_done, assert_fails, frames, pgm};

#[test]
fn an_empty_folder_is_named() {
    let place = Place::new();
    for frame in 0..5 {
        fs::remove_file(place.frame("third", frame)).unwrap();
    }
    place.fails("camera third: third: holds no images (pgm, png, tif, tiff, jpg, jpeg)");
    fs::remove_dir_all(place.path("third")).unwrap();
    place.fails("camera third: third: there is no such folder or file");
    assert!(
        !place.path("out").exists(),
        "nothing is begun before everything was looked at"
    );
}

#[test]
fn a_missing_timestamp_is_named() {
    let place = Place::new();
    place.stamp("third", &[(0, 1), (1, 2), (2, 3), (4, 5)]);
    place.fails("camera third: third/timestamps.csv: no timestamp for frame 3 (third/000003.pgm)");
    fs::remove_file(place.path("third/timestamps.csv")).unwrap();
    place.fails(
        "camera third: third/timestamps.csv: there is no such file; give the frame rate with --fps instead",
    );
}

#[test]
fn a_wrong_list_of_timestamps_is_named() {
    let place = Place::new();
    let list = place.path("first/timestamps.csv");
    let cases = [
        (
            "frame,timestamp_ns\n0,10\n1,20\n2,20\n3,40\n4,50\n",
            "timestamps do not rise: frame 2 has 20 ns, frame 1 before it 20 ns",
        ),
        (
            "frame,timestamp_ns\n0,10\n1,20\n1,30\n",
            "line 4: frame 1 is listed twice",
        ),
        (
            "frame,time\n0,10\n",
            "line 1: no column \"timestamp_ns\"; the columns are frame,time",
        ),
        (
            "frame,timestamp_ns\n0,1e9\n",
            "line 2: timestamp_ns \"1e9\" is not a whole number",
        ),
        ("frame,timestamp_ns\n-1,5\n", "line 2: frame -1 is negative"),
        ("frame,timestamp_ns\n", "lists no frame"),
    ];
    for (text, told) in cases {
        fs::write(&list, text).unwrap();
        place.fails(&format!("camera first: first/timestamps.csv: {told}"));
    }
}

#[test]
fn a_frame_that_is_there_twice_is_named() {
    let place = Place::new();
    fs::copy(place.frame("first", 2), place.path("first/2.pgm")).unwrap();
    place.fails("camera first: frame 2 is there twice: first/000002.pgm and first/2.pgm");
}

#[test]
fn a_camera_that_is_not_in_the_rig_is_named() {
    let place = Place::new();
    assert_fails(
        &place.import_with(&["--camera", "frist=first"]),
        "--camera frist: rig.toml has no such camera; did you mean first?",
    );
    assert_fails(
        &place.import_with(&["--camera", "first=first", "--camera", "first=third"]),
        "camera first is given twice",
    );
}

#[test]
fn a_frame_of_the_wrong_size_is_named_and_those_before_it_are_kept() {
    let place = Place::new();
    fs::write(place.frame("first", 3), pgm(3, WIDTH, HEIGHT - 1)).unwrap();
    place.fails("camera first: first/000003.pgm: is 64x47 pixels, the rig says 64x48");
    let session = place.session();
    assert_eq!(frames(&session, "first").len(), 3);
    assert_eq!(frames(&session, "third").len(), 5);
    assert_eq!(session.damage(), []);
}

#[test]
fn an_image_that_cannot_be_read_is_named() {
    let place = Place::new();
    let file = place.frame("first", 0);
    let whole = fs::read(&file).unwrap();
    let cases: [(&[u8], &str); 5] = [
        (&[], "is empty"),
        (b"P5 64", "is cut short in its header (width)"),
        (
            b"P5 64 48 65535 ",
            "is cut short: 0 bytes of pixels, 64x48 need 6144",
        ),
        (
            &whole[..1000],
            "is cut short: 975 bytes of pixels, 64x48 need 3072",
        ),
        (b"not an image", "is not a readable image"),
    ];
    for (bytes, told) in cases {
        fs::write(&file, bytes).unwrap();
        place.fails(&format!("camera first: first/000000.pgm: {told}"));
    }
}

#[test]
fn a_folder_that_is_not_empty_is_kept_unless_forced() {
    let place = Place::new();
    assert_done(&place.import());
    place.fails("out: exists and is not empty; --force replaces a session");
    let forced = ["--camera", "first=first", "--force"];
    assert_done(&place.import_with(&forced));
    assert_eq!(place.session().cameras().count(), 1);
    fs::write(place.path("out/notes.txt"), "mine").unwrap();
    assert_fails(
        &place.import_with(&forced),
        "out: holds notes.txt, which is no part of a session",
    );
    assert_eq!(frames(&place.session(), "first").len(), 5, "nothing was removed");
}

#[test]
fn wrong_usage_is_exit_code_2() {
    let place = Place::new();
    for arguments in [
        &["--camera", "first"][..],
        &["--camera", "a b=first"],
        &["--camera", "first="],
        &["--camera", "first=first", "--fps", "-3"],
        &["--camera", "first=first", "--compres", "png"],
        &[],
    ] {
        assert_eq!(
            place.import_with(arguments).status.code(),
            Some(2),
            "{arguments:?}"
        );
    }
}
