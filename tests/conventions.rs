//! One hand-computed number for every sign, axis, pixel origin and delay direction.

#![allow(clippy::unwrap_used, reason = "a test may")]

use nalgebra::{Point3, Vector3};
use pitchd::flight::{NineParameter, PLATE_FRONT_Y_FT, PLATE_MIDDLE_Y_FT};
use pitchd::geometry::{Intrinsics, Pixel, Pose, triangulate_refined};
use pitchd::scene::FieldPreset;
use pitchd::time::{ArrivalTime, CameraTiming, ClockModel, ClockModelOptions, DeviceTime, StampedMidpoint};

const PLAIN: Intrinsics = Intrinsics {
    fx_px: 1000.0,
    fy_px: 1000.0,
    cx_px: 640.0,
    cy_px: 360.0,
    distortion: [0.0; 5],
};

fn close(a: f64, b: f64, tolerance: f64) {
    assert!((a - b).abs() <= tolerance, "{a} is not {b} ± {tolerance}");
}

/// A camera 10 m to the first-base side (+x), 2 m up, looks along −x at the plate.
fn first_base_side() -> Pose {
    Pose::looking_at(Point3::new(10.0, 0.0, 2.0), Point3::new(0.0, 0.0, 2.0))
}

#[test]
fn a_camera_on_the_first_base_side_sees_the_pitcher_to_its_right() {
    // Looking along −x with z up, the image's right is +y (toward the pitcher): forward × up = (−x) × z = +y.
    let pose = first_base_side();
    let pitcher = PLAIN
        .project(&pose.transform(&Point3::new(0.0, 1.0, 2.0)))
        .unwrap();
    close(pitcher.x, 640.0 + 100.0, 1e-9); // 1000 px · 1 m / 10 m
    close(pitcher.y, 360.0, 1e-9);
    // Up in the world is up in the image: rows fall.
    let above = PLAIN
        .project(&pose.transform(&Point3::new(0.0, 0.0, 3.0)))
        .unwrap();
    close(above.x, 640.0, 1e-9);
    close(above.y, 360.0 - 100.0, 1e-9);
}

#[test]
fn camera_from_world_is_r_x_plus_t_and_the_centre_is_minus_rt_t() {
    let pose = first_base_side();
    // The plate is 10 m in front and 2 m below: x_c = (0, +2, 10), since camera y points down.
    let plate = pose.transform(&Point3::origin());
    assert!((plate - Vector3::new(0.0, 2.0, 10.0)).norm() < 1e-12, "{plate}");
    assert!((pose.centre_m() - Point3::new(10.0, 0.0, 2.0)).norm() < 1e-12);
    let back = pose.inverse_transform(&plate);
    assert!(back.coords.norm() < 1e-12);
    assert!((pose.compose(&pose.inverse()).translation_m).norm() < 1e-12);
}

#[test]
fn the_perturbation_turns_the_camera_coordinates() {
    // exp([ω]×)·x_c with ω = 0.1 rad about z turns (1, 0, 0) toward +y.
    let turned = Pose::identity().perturbed(&[0.0, 0.0, 0.1, 0.0, 0.0, 0.5]);
    let x = turned.transform(&Point3::new(1.0, 0.0, 0.0));
    close(x.x, 0.1_f64.cos(), 1e-12);
    close(x.y, 0.1_f64.sin(), 1e-12);
    close(x.z, 0.5, 1e-12);
}

#[test]
fn the_centre_of_the_top_left_pixel_is_zero_zero() {
    // A 1280×720 camera whose axis pierces the middle of the sensor has cx = 639.5, cy = 359.5: columns
    // 0 … 1279 are centred on 639.5.
    let middle = Intrinsics {
        cx_px: 639.5,
        cy_px: 359.5,
        ..PLAIN
    };
    let seen = middle.project(&Vector3::new(0.0, 0.0, 5.0)).unwrap();
    assert_eq!(seen, Pixel::new(639.5, 359.5));
}

#[test]
fn distortion_is_k1_k2_p1_p2_k3_in_opencv_s_order() {
    // By hand at x = 0.2, y = −0.1: r² = 0.05, r⁴ = 0.0025, r⁶ = 0.000125.
    // radial = 1 + 0.05·(−0.1) + 0.0025·0.04 + 0.000125·0.2 = 0.995125
    // x_d = 0.2·0.995125 + 2·0.001·(0.2·−0.1) + 0.002·(0.05 + 2·0.04) = 0.199025 − 0.00004 + 0.00026 = 0.199245
    // y_d = −0.1·0.995125 + 0.001·(0.05 + 2·0.01) + 2·0.002·(0.2·−0.1) = −0.0995125 + 0.00007 − 0.00008 = −0.0995225
    let lens = Intrinsics {
        distortion: [-0.1, 0.04, 0.001, 0.002, 0.2],
        ..PLAIN
    };
    let seen = lens.project(&Vector3::new(0.4, -0.2, 2.0)).unwrap();
    close(seen.x, 640.0 + 199.245, 1e-9);
    close(seen.y, 360.0 - 99.5225, 1e-9);
    let back = lens.direction(seen).unwrap();
    close(back.x, 0.2, 1e-12);
    close(back.y, -0.1, 1e-12);
}

#[test]
fn a_positive_delay_means_the_stamp_is_late() {
    // [Kim19 eq. 2]: the frame stamped t shows the ball where it was at t − τ.
    let timing = CameraTiming::with_delay(0.002);
    let stamped = StampedMidpoint::from_nanos(1_000_000_000);
    assert_eq!(timing.true_midpoint(stamped, 0.0).nanos(), 998_000_000);
    close(timing.true_seconds(stamped, 0.0, 0), 0.998, 1e-15);
    // A clock that runs 100 ppm fast has stamped 10.001 s when 10 s have passed.
    let fast = CameraTiming {
        clock_skew_ppm: 100.0,
        skew_epoch_ns: 0,
        ..CameraTiming::with_delay(0.0)
    };
    close(
        fast.true_seconds(StampedMidpoint::from_nanos(10_001_000_000), 0.0, 0),
        9.9999999,
        1e-9,
    );
}

#[test]
fn a_stamp_is_the_device_s_begin_of_exposure_on_the_host_s_clock_plus_half_the_exposure() {
    // The device counts 5 s when the host counts 100 s and runs 100 ppm fast: after 20 host seconds it has counted
    // 20.002 s. The frame begun then, exposed for 1 ms, is stamped 120.0005 s (not 120.0025, not 119.9995).
    let mut clock = ClockModel::new(ClockModelOptions::default());
    let mut last = None;
    for frame in 0..=2000_i64 {
        let host_ns = 100_000_000_000 + frame * 10_000_000;
        let device_ns = 5_000_000_000 + frame * 10_001_000;
        let (device, arrival) = (
            DeviceTime::from_nanos(device_ns),
            ArrivalTime::from_nanos(host_ns),
        );
        last = Some(clock.push(device, arrival, 0.001));
    }
    let stamp = last.unwrap().stamped;
    close(stamp.seconds_since(120_000_000_000), 0.0005, 2e-6);
    // Positive: this camera's clock runs fast.
    close(clock.skew_ppm().unwrap().0, 100.0, 1.0);
}

#[test]
fn a_rolling_shutter_reads_later_rows_later() {
    let rolling = CameraTiming {
        readout_s: 0.010,
        height_px: 1000,
        ..CameraTiming::with_delay(0.0)
    };
    let stamped = StampedMidpoint::from_nanos(0);
    // Row 0 is centred half a row after the readout begins: −5 ms + 5 µs; the middle of the image is at the stamp.
    close(rolling.true_seconds(stamped, 0.0, 0), -0.004_995, 1e-12);
    close(rolling.true_seconds(stamped, 499.5, 0), 0.0, 1e-12);
    close(rolling.true_seconds(stamped, 999.0, 0), 0.004_995, 1e-12);
}

#[test]
fn unix_nanoseconds_keep_their_last_digit() {
    // 2026-04-01 in Unix nanoseconds is not an f64: differences are taken in integers.
    let epoch = 1_775_001_600_000_000_000;
    let stamped = StampedMidpoint::from_nanos(epoch + 7);
    close(stamped.seconds_since(epoch), 7e-9, 1e-18);
    assert_eq!(
        CameraTiming::with_delay(0.0).true_midpoint(stamped, 0.0).nanos(),
        epoch + 7
    );
}

#[test]
fn landmarks_stand_where_the_rule_book_puts_them() {
    let field = FieldPreset::Professional;
    let expected = [
        ("plate_tip", [0.0, 0.0, 0.0]),
        ("plate_right", [0.2159, 0.2159, 0.0]),
        ("plate_front_left", [-0.2159, 0.4318, 0.0]),
        ("rubber_front_right", [0.3048, 18.4404, 0.254]),
        ("rubber_back_left", [-0.3048, 18.5928, 0.254]),
        ("first_base", [19.397, 19.397, 0.0]),
        ("third_base", [-19.397, 19.397, 0.0]),
        ("second_base", [0.0, 38.795, 0.0]),
        ("box_right_front_inner", [0.3683, 1.1303, 0.0]),
        ("box_left_back_outer", [-1.5875, -0.6985, 0.0]),
    ];
    for (name, [x, y, z]) in expected {
        let at = field.landmark(name).unwrap();
        assert!((at - Point3::new(x, y, z)).norm() < 1e-3, "{name}: {at}");
    }
    close(field.landmark("mound_center").unwrap().y, 17.9832, 1e-9);
    assert!(field.landmark("fourth_base").is_err());
}

#[test]
fn two_rays_meet_where_they_were_sent() {
    let truth = Point3::new(0.3, 5.0, 1.2);
    let cameras = [
        Pose::looking_at(Point3::new(15.0, 2.0, 3.0), Point3::new(0.0, 8.0, 1.0)),
        Pose::looking_at(Point3::new(-15.0, 2.0, 3.0), Point3::new(0.0, 8.0, 1.0)),
    ];
    let views: Vec<_> = cameras
        .iter()
        .map(|p| (*p, PLAIN, PLAIN.project(&p.transform(&truth)).unwrap()))
        .collect();
    let (point, _) = triangulate_refined(&views).unwrap();
    assert!((point - truth).norm() < 1e-9, "{point}");
}

/// One row of domain §4's table of real pitches.
struct StatcastVector {
    name: &'static str,
    start: [f64; 2],
    velocity: [f64; 3],
    acceleration: [f64; 3],
    release_y: f64,
    release_speed: f64,
    front: [f64; 2],
    middle: [f64; 2],
    movement: [f64; 2],
}

#[rustfmt::skip]
const STATCAST: [StatcastVector; 6] = [
    StatcastVector { name: "RHP FF", start: [-0.9001, 6.1657], velocity: [3.8351, -128.8867, -6.0460], acceleration: [-3.8055, 27.5059, -12.9495], release_y: 54.31, release_speed: 88.63, front: [0.314, 2.784], middle: [0.328, 2.717], movement: [-0.270, 1.642] },
    StatcastVector { name: "RHP CU", start: [-1.1480, 5.9186], velocity: [1.2845, -117.0051, -0.0903], acceleration: [2.3033, 21.7438, -38.0715], release_y: 53.96, release_speed: 80.28, front: [-0.377, 2.317], middle: [-0.362, 2.207], movement: [0.275, -0.617] },
    StatcastVector { name: "LHP CH", start: [0.9814, 5.5593], velocity: [-3.6367, -120.7126, -2.7090], acceleration: [12.4747, 23.6924, -25.7908], release_y: 54.35, release_speed: 82.94, front: [0.554, 2.150], middle: [0.564, 2.063], movement: [1.212, 0.627] },
    StatcastVector { name: "RHP SL", start: [-1.9511, 5.7177], velocity: [5.1864, -129.1777, -5.6475], acceleration: [4.9379, 26.1753, -27.6022], release_y: 54.03, release_speed: 88.76, front: [0.459, 1.389], middle: [0.501, 1.291], movement: [0.532, 0.322] },
    StatcastVector { name: "RHP EP", start: [-1.1849, 5.7138], velocity: [3.5024, -92.1384, 4.6877], acceleration: [6.3260, 14.8070, -40.6506], release_y: 55.15, release_speed: 63.60, front: [1.710, 2.113], middle: [1.770, 1.961], movement: [1.259, -1.359] },
    StatcastVector { name: "LHP SI", start: [1.7936, 6.1527], velocity: [-3.8655, -128.4064, -4.8056], acceleration: [14.2663, 25.7934, -21.4067], release_y: 54.58, release_speed: 88.27, front: [1.378, 2.599], middle: [1.389, 2.519], movement: [1.235, 0.919] },
];

#[test]
fn statcast_formulas_reproduce_real_pitches() {
    for p in &STATCAST {
        let nine = NineParameter {
            position_ft: Vector3::new(p.start[0], 50.0, p.start[1]),
            velocity_ftps: p.velocity.into(),
            acceleration_ftps2: p.acceleration.into(),
        };
        let at = |y: f64| nine.position(nine.time_at_y(y).unwrap());
        // Table rounding: 0.001 ft of the printed values, 0.01 mph.
        for (y, [x, z]) in [(PLATE_FRONT_Y_FT, p.front), (PLATE_MIDDLE_Y_FT, p.middle)] {
            assert!(
                (at(y).x - x).abs() < 0.0011 && (at(y).z - z).abs() < 0.0011,
                "{}: {}",
                p.name,
                at(y)
            );
        }
        close(nine.speed_at_y_mph(p.release_y).unwrap(), p.release_speed, 0.011);
        let movement = nine.movement(p.release_y).unwrap();
        close(movement.x_ft, p.movement[0], 0.0025);
        close(movement.z_ft, p.movement[1], 0.0025);
    }
}
