//! `pitchd import`, run as a person would: what it makes of images and videos.

#![allow(clippy::unwrap_used, clippy::panic)]

#[path = "lab/importing.rs"]
mod importing;

use std::fs;
use std::path::Path;
use std::process::Command;

use importing::{HEIGHT, Place, WIDTH, assert_done, assert_fails, frames, pixels};

#[test]
fn images_become_a_session() {
    for compress in ["raw", "png"] {
        let place = Place::new();
        let cameras = [
            "--camera",
            "first=first",
            "--camera",
            "third=third",
            "--compress",
            compress,
        ];
        let output = place.import_with(&cameras);
        assert_done(&output);
        assert_eq!(String::from_utf8_lossy(&output.stderr), "");
        let session = place.session();
        let got = frames(&session, "third");
        assert_eq!(got.len(), 5);
        for (k, (frame, stamp, bytes)) in got.iter().enumerate() {
            assert_eq!((*frame, *stamp), (k as u64, 100 * (k as i64 + 1)));
            assert_eq!(*bytes, pixels(k, WIDTH, HEIGHT));
        }
        assert_eq!(session.damage(), []);
        assert_eq!(
            session.rig_toml().unwrap(),
            fs::read_to_string(place.path("rig.toml")).unwrap()
        );
    }
}

#[test]
fn numbers_in_names_are_frame_numbers() {
    let place = Place::new();
    for frame in 0..5 {
        // The camera's number comes last and is the same in every name.
        fs::rename(
            place.frame("first", frame),
            place.path("first").join(format!("f{}_cam2.pgm", 8 + 2 * frame)),
        )
        .unwrap();
    }
    place.stamp("first", &[(8, 1), (9, 2), (10, 3), (12, 4), (14, 5), (16, 6)]);
    let output = place.import();
    assert_done(&output);
    let text = String::from_utf8_lossy(&output.stderr);
    assert!(
        text.contains("camera first: 1 frames of first/timestamps.csv have no image"),
        "{text}"
    );
    let got: Vec<_> = frames(&place.session(), "first")
        .into_iter()
        .map(|(f, t, p)| (f, t, p[1]))
        .collect();
    let wanted: Vec<_> = (0..5)
        .map(|k| (8 + 2 * k as u64, [1, 3, 4, 5, 6][k], pixels(k, WIDTH, HEIGHT)[1]))
        .collect();
    assert_eq!(got, wanted);
}

#[test]
fn names_without_numbers_go_by_order_and_it_is_said() {
    let place = Place::new();
    for (frame, name) in ["a", "b", "c", "d", "e"].iter().enumerate() {
        fs::rename(
            place.frame("first", frame),
            place.path("first").join(format!("{name}.pgm")),
        )
        .unwrap();
    }
    let output = place.import();
    assert_done(&output);
    let text = String::from_utf8_lossy(&output.stderr);
    assert!(text.contains("the image names hold no frame numbers"), "{text}");
    assert_eq!(frames(&place.session(), "first")[3].1, 400);
}

#[test]
fn a_rate_makes_stamps_where_there_is_no_list() {
    let place = Place::new();
    fs::remove_file(place.path("first/timestamps.csv")).unwrap();
    fs::remove_file(place.frame("first", 2)).unwrap();
    let output = place.import_with(&["--camera", "first=first", "--fps", "250"]);
    assert_done(&output);
    assert!(
        String::from_utf8_lossy(&output.stderr).contains("warning: camera third of rig.toml gets no images")
    );
    let stamps: Vec<_> = frames(&place.session(), "first")
        .into_iter()
        .map(|(f, t, _)| (f, t))
        .collect();
    assert_eq!(stamps, [(0, 0), (1, 4_000_000), (3, 12_000_000), (4, 16_000_000)]);
}

#[test]
fn other_image_formats_and_colour() {
    use opencv::core::{Mat, MatTraitConst, Scalar, Vector};
    use opencv::imgcodecs::imwrite;
    let place = Place::new();
    let folder = place.path("first");
    for frame in 0..5 {
        fs::remove_file(place.frame("first", frame)).unwrap();
    }
    let grey = pixels(1, WIDTH, HEIGHT);
    let image = Mat::from_slice(&grey).unwrap();
    let image = image.reshape(1, HEIGHT as i32).unwrap().try_clone().unwrap();
    let write = |name: &str, image: &Mat| {
        assert!(imwrite(folder.join(name).to_str().unwrap(), image, &Vector::new()).unwrap());
    };
    write("0.png", &image);
    write("1.tif", &image);
    write("2.JPG", &image);
    // Pure red in BGR order; luma of BT.601 is 0.299·255 = 76.
    let red = Mat::new_rows_cols_with_default(
        HEIGHT as i32,
        WIDTH as i32,
        opencv::core::CV_8UC3,
        Scalar::new(0.0, 0.0, 255.0, 0.0),
    )
    .unwrap();
    write("3.png", &red);
    assert_eq!(red.channels(), 3);
    let output = place.import();
    assert_done(&output);
    let got = frames(&place.session(), "first");
    assert_eq!(got.len(), 4);
    assert_eq!(got[0].2, grey);
    assert_eq!(got[1].2, grey);
    assert!(got[3].2.iter().all(|p| *p == 76));

    let deep = Mat::new_rows_cols_with_default(
        HEIGHT as i32,
        WIDTH as i32,
        opencv::core::CV_16UC1,
        Scalar::all(4000.0),
    )
    .unwrap();
    write("0.png", &deep);
    fs::remove_dir_all(place.path("out")).unwrap();
    place.fails(
        "camera first: first/0.png: has 16 bits per value, and does not say how many of them the camera filled; give --bits \
         (10, 12, 14 or 16)",
    );
    // 4000 of twelve bits is 250 of eight.
    assert_done(&place.import_with(&["--camera", "first=first", "--bits", "12"]));
    assert_eq!(frames(&place.session(), "first")[0].2, vec![250; WIDTH * HEIGHT]);
    fs::remove_dir_all(place.path("out")).unwrap();
    let output = place.import_with(&["--camera", "first=first", "--bits", "10"]);
    assert_fails(
        &output,
        "camera first: first/0.png: has values of 12 bits, more than the 10 that it should have; correct --bits",
    );
}

#[test]
fn a_maximum_of_the_file_s_own_counts_and_it_is_said() {
    let place = Place::new();
    for frame in 0..5 {
        // 10 bits: 516 is 129 of eight.
        let mut bytes = format!("P5\n{WIDTH} {HEIGHT}\n1023\n").into_bytes();
        bytes.extend([2, 4].repeat(WIDTH * HEIGHT));
        fs::write(place.frame("first", frame), bytes).unwrap();
    }
    for (bits, told) in [
        (
            "12",
            "camera first: --bits 12 does not count for first/000000.pgm, whose own maximum has 10 bits",
        ),
        ("10", ""),
    ] {
        let output = place.import_with(&[
            "--camera",
            "first=first",
            "--camera",
            "third=third",
            "--bits",
            bits,
        ]);
        assert_done(&output);
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(text.trim_end().trim_start_matches("pitchd: warning: "), told);
        assert_eq!(frames(&place.session(), "first")[4].2, vec![129; WIDTH * HEIGHT]);
        assert_eq!(frames(&place.session(), "third")[4].2, pixels(4, WIDTH, HEIGHT));
        fs::remove_dir_all(place.path("out")).unwrap();
    }
}

#[test]
fn a_video_becomes_a_camera() {
    let place = Place::new();
    write_video(&place.path("clip.avi"), 4);
    let video = ["--camera", "first=clip.avi"];
    assert_fails(
        &place.import_with(&video),
        "camera first: clip.timestamps.csv: there is no such file; give the frame rate with --fps instead",
    );
    assert_done(&place.import_with(&["--camera", "first=clip.avi", "--fps", "100"]));
    let got = frames(&place.session(), "first");
    assert_eq!(got.len(), 4);
    assert_eq!((got[3].0, got[3].1), (3, 30_000_000));
    assert!(
        (i16::from(got[3].2[100]) - 100).abs() <= 3,
        "grey {}",
        got[3].2[100]
    );

    // A list beside it goes row by row; one that is too short stops the import with what it has.
    fs::write(
        place.path("clip.timestamps.csv"),
        "frame,timestamp_ns\n10,5\n11,6\n12,7\n",
    )
    .unwrap();
    let output = place.import_with(&["--camera", "first=clip.avi", "--force"]);
    assert_fails(
        &output,
        "camera first: clip.timestamps.csv: no timestamp for frame 3 (clip.avi)",
    );
    let kept: Vec<_> = frames(&place.session(), "first")
        .into_iter()
        .map(|(f, t, _)| (f, t))
        .collect();
    assert_eq!(kept, [(10, 5), (11, 6), (12, 7)]);
}

/// A video of so many frames at 30 Hz, each a little brighter than the one before.
fn write_video(file: &Path, frames: i32) {
    use opencv::core::{CV_8UC1, Mat, Scalar, Size};
    use opencv::videoio::{VideoWriter, VideoWriterTrait, VideoWriterTraitConst};
    let codec = VideoWriter::fourcc('M', 'J', 'P', 'G').unwrap();
    let size = Size::new(WIDTH as i32, HEIGHT as i32);
    let mut writer = VideoWriter::new(file.to_str().unwrap(), codec, 30.0, size, false).unwrap();
    assert!(writer.is_opened().unwrap());
    for frame in 0..frames {
        let grey = Scalar::all(40.0 + 20.0 * f64::from(frame % 10));
        let image = Mat::new_rows_cols_with_default(HEIGHT as i32, WIDTH as i32, CV_8UC1, grey).unwrap();
        writer.write(&image).unwrap();
    }
    writer.release().unwrap();
}

#[test]
fn a_video_that_is_cut_off_is_told_of() {
    let place = Place::new();
    let file = place.path("clip.avi");
    write_video(&file, 60);
    let whole = fs::read(&file).unwrap();
    let arguments = ["--camera", "first=clip.avi", "--fps", "100", "--force"];
    let output = place.import_with(&arguments);
    assert_done(&output);
    assert!(!String::from_utf8_lossy(&output.stderr).contains("clip.avi"));

    fs::write(&file, &whole[..whole.len() * 3 / 5]).unwrap();
    let output = place.import_with(&arguments);
    assert_eq!(output.status.code(), Some(1));
    let read = frames(&place.session(), "first").len();
    assert!((1..50).contains(&read), "{read} frames");
    let told = String::from_utf8_lossy(&output.stderr);
    let expected = format!(
        "clip.avi: its header tells of 60 frames, {read} could be read: it is damaged, cut off or has gaps"
    );
    assert!(told.contains(&expected), "{told}");
    let losses = "imported with losses: the file of first ended too early";
    assert!(told.contains(losses), "{told}");

    fs::write(&file, b"").unwrap();
    assert_fails(&place.import_with(&arguments), "camera first: clip.avi: is empty");
}

/// Runs `pitchd info` or `recover` on the session.
fn run(place: &Place, arguments: &[&str]) -> (Option<i32>, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_pitchd"))
        .current_dir(place.folder.path())
        .args(arguments)
        .output()
        .unwrap();
    let text = [output.stdout, output.stderr].concat();
    (output.status.code(), String::from_utf8_lossy(&text).into_owned())
}

#[test]
fn info_and_recover_tell_of_damage() {
    let place = Place::new();
    assert_done(&place.import());
    let (code, text) = run(&place, &["info", "out", "--verify"]);
    assert_eq!(code, Some(0), "{text}");
    assert!(text.contains("10 frames read, checksums right"), "{text}");
    flip(&place.path("out/first.0000.mcap"));
    let (code, text) = run(&place, &["info", "out", "--verify", "--json"]);
    assert_eq!(code, Some(1), "{text}");
    assert!(
        text.contains("\"frames_lost\": 1") && text.contains("first.0000.mcap"),
        "{text}"
    );
    let (code, text) = run(&place, &["recover", "out"]);
    assert_eq!(code, Some(1), "{text}");
    assert!(text.contains("out: 1 frames are lost"), "{text}");
    let (code, text) = run(&place, &["info", "out", "--verify"]);
    assert_eq!(code, Some(0), "{text}");
    assert!(
        text.contains("lost in an earlier repair: first.0000.mcap"),
        "{text}"
    );
    let (code, text) = run(&place, &["recover", "out"]);
    assert_eq!(code, Some(0), "{text}");
    assert!(text.contains("nothing to mend"), "{text}");
}

fn flip(file: &Path) {
    let mut bytes = fs::read(file).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(file, bytes).unwrap();
}
