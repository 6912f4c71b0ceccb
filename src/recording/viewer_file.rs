//! Results for a viewer: one MCAP file with 2-D points, camera poses and 3-D flights, to open beside a session.
//!
//! | topic | schema | time |
//! |---|---|---|
//! | `/<camera>/calibration` | `foxglove.CameraCalibration` | the first message of the file |
//! | `/<camera>/ball` | `foxglove.ImageAnnotations` | that camera's stamped midpoint, as its images have it |
//! | `/tf` | `foxglove.FrameTransform`, `world` → camera | the first message of the file |
//! | `/flight` | `foxglove.SceneUpdate` in `world` | the ball: true time of each sample; the line: release |
//! | `/pitch` | `foxglove.Log` | the plate |

use std::path::Path;

use foxglove::messages::{
    CameraCalibration as LensMessage, Color, Duration, FrameTransform, ImageAnnotations, LinePrimitive, Log,
    Point2, Point3, PointsAnnotation, Pose, Quaternion, SceneEntity, SceneUpdate, SpherePrimitive, Vector3,
    line_primitive, log, points_annotation,
};
use foxglove::{Encode, Schema};
use nalgebra::UnitQuaternion;
use prost::Message;

use super::error::RecordingError;
use super::payload::foxglove_time;
use super::segment::{Attached, Segment};
use super::writer::DiskPath;
use crate::scene::{Calibration, CameraCalibration, Pitch, Track};

/// Frame of the flights; cameras hang below it.
const WORLD: &str = "world";
/// A baseball's diameter, metres.
const BALL_DIAMETER_M: f64 = 0.0732;
const LINE_PX: f64 = 2.0;
const BALL: Color = Color {
    r: 1.0,
    g: 0.85,
    b: 0.1,
    a: 1.0,
};
const FLIGHT: Color = Color {
    r: 0.2,
    g: 0.6,
    b: 1.0,
    a: 1.0,
};

/// What a viewer is shown.
pub struct ViewerInput<'a> {
    /// Text of `calibration.json`, attached to the file.
    pub calibration_json: &'a str,
    /// Poses and lenses.
    pub calibration: &'a Calibration,
    /// Flights.
    pub pitches: &'a [Pitch],
    /// Points.
    pub tracks: &'a [Track],
}

/// One message before it has its place in time.
struct Timed {
    channel: u16,
    time_ns: i64,
    data: Vec<u8>,
}

/// Writes `file`, replacing one that is there.
///
/// # Errors
/// What the disk says, with the path.
pub fn write_viewer_file(file: &Path, input: &ViewerInput<'_>) -> Result<(), RecordingError> {
    let attached = Attached {
        rig_toml: String::new(),
        calibration_json: Some(input.calibration_json.to_owned()),
    };
    let about = [("content", "results".to_owned())];
    let mut segment = Segment::create(file.to_owned(), DiskPath::Buffered, &attached, &about)?;
    let mut messages = Vec::new();
    flights(&mut segment, input.pitches, &mut messages)?;
    points(&mut segment, input.tracks, &mut messages)?;
    let begin_ns = messages.iter().map(|m| m.time_ns).min().unwrap_or(0);
    for camera in &input.calibration.cameras {
        place(&mut segment, camera, begin_ns, &mut messages)?;
    }
    messages.sort_by_key(|m| m.time_ns);
    for (sequence, message) in (0..).zip(&messages) {
        segment.write(message.channel, sequence, message.time_ns, &message.data)?;
    }
    segment.finish()?.wait()
}

fn channel(segment: &mut Segment, topic: &str, schema: Option<Schema>) -> Result<u16, RecordingError> {
    segment.add_channel(topic, &schema.expect("foxglove's own messages have schemas"))
}

fn flights(segment: &mut Segment, pitches: &[Pitch], out: &mut Vec<Timed>) -> Result<(), RecordingError> {
    let scene = channel(segment, "/flight", SceneUpdate::get_schema())?;
    let told = channel(segment, "/pitch", Log::get_schema())?;
    for pitch in pitches {
        let line = LinePrimitive {
            r#type: line_primitive::Type::LineStrip as i32,
            pose: Some(pose_at([0.0; 3])),
            thickness: LINE_PX,
            scale_invariant: true,
            points: pitch.flight.iter().map(|s| point(s.position_m)).collect(),
            color: Some(FLIGHT),
            ..LinePrimitive::default()
        };
        let id = format!("pitch {}", pitch.pitch);
        let whole = SceneEntity {
            lines: vec![line],
            ..entity(pitch.release_time_ns, &id)
        };
        out.push(timed(scene, pitch.release_time_ns, &update(whole)));
        for sample in &pitch.flight {
            let ball = SpherePrimitive {
                pose: Some(pose_at(sample.position_m)),
                size: Some(Vector3 {
                    x: BALL_DIAMETER_M,
                    y: BALL_DIAMETER_M,
                    z: BALL_DIAMETER_M,
                }),
                color: Some(BALL),
            };
            let flying = SceneEntity {
                spheres: vec![ball],
                ..entity(sample.time_ns, "ball")
            };
            out.push(timed(scene, sample.time_ns, &update(flying)));
        }
        let [x_m, z_m] = pitch.plate_mid_m;
        let message = Log {
            timestamp: Some(foxglove_time(pitch.plate_time_ns)),
            level: log::Level::Info as i32,
            message: format!(
                "pitch {}: {:.2} m/s, plate x {:.1} cm z {:.1} cm, strike {:.0} %",
                pitch.pitch,
                pitch.release_speed_mps,
                100.0 * x_m,
                100.0 * z_m,
                100.0 * pitch.strike_probability
            ),
            name: "pitchd".to_owned(),
            ..Log::default()
        };
        out.push(timed(told, pitch.plate_time_ns, &message));
    }
    Ok(())
}

fn points(segment: &mut Segment, tracks: &[Track], out: &mut Vec<Timed>) -> Result<(), RecordingError> {
    for track in tracks {
        let topic = format!("/{}/ball", track.camera);
        let channel = channel(segment, &topic, ImageAnnotations::get_schema())?;
        for seen in &track.points {
            let time_ns = seen.stamped.nanos();
            let timestamp = Some(foxglove_time(time_ns));
            // A viewer's pixels begin at the corner of the top-left pixel, ours at its centre.
            let centre = Point2 {
                x: seen.pixel.x + 0.5,
                y: seen.pixel.y + 0.5,
            };
            let mark = PointsAnnotation {
                timestamp,
                r#type: points_annotation::Type::Points as i32,
                points: vec![centre],
                outline_color: Some(BALL),
                thickness: LINE_PX,
                ..PointsAnnotation::default()
            };
            let message = ImageAnnotations {
                timestamp,
                points: vec![mark],
                ..ImageAnnotations::default()
            };
            out.push(timed(channel, time_ns, &message));
        }
    }
    Ok(())
}

fn place(
    segment: &mut Segment,
    camera: &CameraCalibration,
    time_ns: i64,
    out: &mut Vec<Timed>,
) -> Result<(), RecordingError> {
    let timestamp = Some(foxglove_time(time_ns));
    let lens = &camera.intrinsics;
    let k = vec![
        lens.fx_px, 0.0, lens.cx_px, 0.0, lens.fy_px, lens.cy_px, 0.0, 0.0, 1.0,
    ];
    let mut p = Vec::with_capacity(12);
    for row in k.chunks(3) {
        p.extend_from_slice(row);
        p.push(0.0);
    }
    let message = LensMessage {
        timestamp,
        frame_id: camera.id.to_string(),
        width: camera.width_px,
        height: camera.height_px,
        distortion_model: "plumb_bob".to_owned(),
        d: lens.distortion.to_vec(),
        k,
        r: vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p,
    };
    let topic = format!("/{}/calibration", camera.id);
    let lens_channel = channel(segment, &topic, LensMessage::get_schema())?;
    out.push(timed(lens_channel, time_ns, &message));
    // Foxglove's transform takes the child's coordinates to the parent's: the inverse of camera_from_world.
    let centre = camera.camera_from_world.centre_m();
    let turn = UnitQuaternion::from_rotation_matrix(&camera.camera_from_world.rotation.inverse());
    let message = FrameTransform {
        timestamp,
        parent_frame_id: WORLD.to_owned(),
        child_frame_id: camera.id.to_string(),
        translation: Some(Vector3 {
            x: centre.x,
            y: centre.y,
            z: centre.z,
        }),
        rotation: Some(Quaternion {
            x: turn.i,
            y: turn.j,
            z: turn.k,
            w: turn.w,
        }),
    };
    let tf = channel(segment, "/tf", FrameTransform::get_schema())?;
    out.push(timed(tf, time_ns, &message));
    Ok(())
}

fn timed(channel: u16, time_ns: i64, message: &impl Message) -> Timed {
    Timed {
        channel,
        time_ns,
        data: message.encode_to_vec(),
    }
}

fn update(entity: SceneEntity) -> SceneUpdate {
    SceneUpdate {
        deletions: Vec::new(),
        entities: vec![entity],
    }
}

fn entity(time_ns: i64, id: &str) -> SceneEntity {
    SceneEntity {
        timestamp: Some(foxglove_time(time_ns)),
        frame_id: WORLD.to_owned(),
        id: id.to_owned(),
        lifetime: Some(Duration::new(0, 0)),
        ..SceneEntity::default()
    }
}

fn point([x, y, z]: [f64; 3]) -> Point3 {
    Point3 { x, y, z }
}

fn pose_at([x, y, z]: [f64; 3]) -> Pose {
    Pose {
        position: Some(Vector3 { x, y, z }),
        orientation: Some(Quaternion {
            x: 0.0,
            y: 0.0,
            z: 0.0,
            w: 1.0,
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Intrinsics, Pixel, Pose as CameraPose};
    use crate::scene::{CameraId, TrackPoint};
    use crate::time::StampedMidpoint;
    use nalgebra::{Rotation3, Vector3 as V};
    use std::collections::BTreeMap;

    fn read(file: &Path) -> BTreeMap<String, Vec<(u64, Vec<u8>)>> {
        let bytes = std::fs::read(file).unwrap();
        let mut found: BTreeMap<String, Vec<(u64, Vec<u8>)>> = BTreeMap::new();
        for message in mcap::MessageStream::new(&bytes).unwrap() {
            let message = message.unwrap();
            let list = found.entry(message.channel.topic.clone()).or_default();
            list.push((message.log_time, message.data.to_vec()));
        }
        found
    }

    /// A camera at (0, −5, 2) looking along +y: its z is the world's y, its y is down.
    fn camera() -> CameraCalibration {
        let rotation = Rotation3::from_basis_unchecked(&[
            V::new(1.0, 0.0, 0.0),
            V::new(0.0, 0.0, 1.0),
            V::new(0.0, -1.0, 0.0),
        ]);
        let translation_m = -(rotation * V::new(0.0, -5.0, 2.0));
        CameraCalibration {
            id: CameraId::new("first").unwrap(),
            camera_from_world: CameraPose {
                rotation,
                translation_m,
            },
            capture_delay_s: 0.0,
            capture_delay_sigma_s: 0.0,
            clock_skew_ppm: 0.0,
            skew_epoch_ns: 0,
            network_clock: false,
            readout_s: 0.0,
            intrinsics: Intrinsics {
                fx_px: 1000.0,
                fy_px: 1001.0,
                cx_px: 319.5,
                cy_px: 239.5,
                distortion: [0.0; 5],
            },
            width_px: 640,
            height_px: 480,
            reprojection_rms_px: 0.0,
            points: 0,
            noise_sigma_px: 0.0,
            jitter_sigma_s: 0.0,
        }
    }

    #[test]
    fn a_viewer_gets_points_poses_and_lenses_at_their_times() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("results.mcap");
        let calibration = Calibration::without_covariance(vec![camera()]);
        let points = vec![TrackPoint {
            frame: 7,
            stamped: StampedMidpoint::from_nanos(2_000_000_500),
            pixel: Pixel { x: 10.0, y: 20.25 },
            covariance_px2: None,
        }];
        let tracks = [Track {
            camera: camera().id,
            track: 1,
            points,
        }];
        let input = ViewerInput {
            calibration_json: "{}",
            calibration: &calibration,
            pitches: &[],
            tracks: &tracks,
        };
        write_viewer_file(&file, &input).unwrap();
        write_viewer_file(&file, &input).unwrap(); // replaced, not refused
        let found = read(&file);
        let (time, data) = &found["/first/ball"][0];
        assert_eq!(*time, 2_000_000_500);
        let mark = ImageAnnotations::decode(data.as_slice()).unwrap();
        let at = &mark.points[0].points[0];
        // Centre of the top-left pixel is (0, 0) here and (0.5, 0.5) there.
        assert_eq!((at.x, at.y), (10.5, 20.75));
        let tf = FrameTransform::decode(found["/tf"][0].1.as_slice()).unwrap();
        let centre = tf.translation.unwrap();
        assert!((centre.y + 5.0).abs() < 1e-12 && (centre.z - 2.0).abs() < 1e-12);
        // The camera's z axis, told in the world, is +y.
        let q = tf.rotation.unwrap();
        let turn = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(q.w, q.x, q.y, q.z));
        assert!((turn * V::z() - V::y()).norm() < 1e-12);
        let lens = LensMessage::decode(found["/first/calibration"][0].1.as_slice()).unwrap();
        assert_eq!(lens.k, [1000.0, 0.0, 319.5, 0.0, 1001.0, 239.5, 0.0, 0.0, 1.0]);
    }
}
