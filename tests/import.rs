//! `pitchd import`, run as a person would: what it makes, and what it says when something is wrong.

#![allow(clippy::unwrap_used, clippy::panic)]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use pitchd::recording::SessionReader;
use pitchd::scene::CameraId;

const WIDTH: usize = 64;
const HEIGHT: usize = 48;

const CAMERA: &str = r#"
[[camera]]
id = "ID"
width_px = 64
height_px = 48
frame_rate_hz = 175.0
[camera.intrinsics]
fx_px = 50.0
fy_px = 50.0
cx_px = 31.5
cy_px = 23.5
distortion = [0.0, 0.0, 0.0, 0.0, 0.0]
"#;

struct Place {
    folder: tempfile::TempDir,
}

impl Place {
    /// A rig of cameras `first` and `third`, each with five PGM frames and their stamps.
    fn new() -> Self {
        let place = Self {
            folder: tempfile::tempdir().unwrap(),
        };
        let rig = format!(
            "[site]\nname = \"x\"\n{}{}",
            CAMERA.replace("ID", "first"),
            CAMERA.replace("ID", "third")
        );
        fs::write(place.path("rig.toml"), rig).unwrap();
        for camera in ["first", "third"] {
            fs::create_dir(place.path(camera)).unwrap();
            for frame in 0..5 {
                fs::write(place.frame(camera, frame), pgm(frame, WIDTH, HEIGHT)).unwrap();
            }
            place.stamp(camera, &[(0, 100), (1, 200), (2, 300), (3, 400), (4, 500)]);
        }
        place
    }
    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }
    fn frame(&self, camera: &str, frame: usize) -> PathBuf {
        self.path(camera).join(format!("{frame:06}.pgm"))
    }
    fn stamp(&self, camera: &str, rows: &[(u64, i64)]) {
        let rows: String = rows.iter().map(|(f, t)| format!("{f},{t}\n")).collect();
        fs::write(
            self.path(camera).join("timestamps.csv"),
            format!("frame,timestamp_ns\n{rows}"),
        )
        .unwrap();
    }
    fn import_with(&self, arguments: &[&str]) -> Output {
        Command::new(env!("CARGO_BIN_EXE_pitchd"))
            .current_dir(self.folder.path())
            .args(["import", "out", "--rig", "rig.toml"])
            .args(arguments)
            .output()
            .unwrap()
    }
    fn import(&self) -> Output {
        self.import_with(&["--camera", "first=first", "--camera", "third=third"])
    }
    fn session(&self) -> SessionReader {
        SessionReader::open(&self.path("out")).unwrap()
    }
    /// The import fails with exit code 1 and one line that ends so.
    #[track_caller]
    fn fails(&self, ending: &str) {
        assert_fails(&self.import(), ending);
    }
}

#[track_caller]
fn assert_fails(output: &Output, ending: &str) {
    let text = String::from_utf8_lossy(&output.stderr);
    let errors: Vec<&str> = text.lines().filter(|l| !l.contains("warning:")).collect();
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert_eq!(errors.len(), 1, "{text}");
    assert!(errors[0].ends_with(ending), "{text}");
}

fn pixels(salt: usize, width: usize, height: usize) -> Vec<u8> {
    (0..width * height)
        .map(|i| (i * 7 + salt * 31 + i / width) as u8)
        .collect()
}

fn pgm(salt: usize, width: usize, height: usize) -> Vec<u8> {
    let mut bytes = format!("P5\n# made here\n{width} {height}\n255\n").into_bytes();
    bytes.extend(pixels(salt, width, height));
    bytes
}

/// Numbers, stamps and pixels of a camera's frames.
fn frames(session: &SessionReader, camera: &str) -> Vec<(u64, i64, Vec<u8>)> {
    let frames = session.frames(&CameraId::new(camera).unwrap()).unwrap();
    frames
        .map(|r| {
            (
                r.frame.stamp.frame,
                r.frame.stamp.stamped.nanos(),
                r.frame.bytes().to_vec(),
            )
        })
        .collect()
}

#[track_caller]
fn assert_done(output: &Output) {
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
}

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
fn a_video_becomes_a_camera() {
    use opencv::core::{CV_8UC1, Mat, Scalar, Size};
    use opencv::videoio::{VideoWriter, VideoWriterTrait, VideoWriterTraitConst};
    let place = Place::new();
    let file = place.path("clip.avi");
    let codec = VideoWriter::fourcc('M', 'J', 'P', 'G').unwrap();
    let size = Size::new(WIDTH as i32, HEIGHT as i32);
    let mut writer = VideoWriter::new(file.to_str().unwrap(), codec, 30.0, size, false).unwrap();
    assert!(writer.is_opened().unwrap());
    for frame in 0..4 {
        let grey = Scalar::all(40.0 + 20.0 * f64::from(frame));
        let image = Mat::new_rows_cols_with_default(HEIGHT as i32, WIDTH as i32, CV_8UC1, grey).unwrap();
        writer.write(&image).unwrap();
    }
    writer.release().unwrap();
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
