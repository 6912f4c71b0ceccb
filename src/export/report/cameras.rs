//! Delays and poses with their sigmas, and a map of where the cameras stand.

use nalgebra::{Matrix3, Vector3};

use crate::scene::{Calibration, CameraCalibration, CameraId, FieldPreset, ParameterKind, Rig, WorldFrame};

use super::chart::{Chart, Margins, Scale};
use super::html::{Column, escape, figure, number, table};

/// 1σ of the camera's centre along the world's axes, metres, and of its rotation, radians (the axes' root sum).
/// `None` where the covariance lacks them.
/// C = −Rᵀt; under x_c' = exp([ω]×)·x_c + υ it moves by −Rᵀυ, whatever ω is: Σ_C = Rᵀ·Σ_υ·R.
pub(super) fn pose_sigma(calibration: &Calibration, camera: &CameraCalibration) -> Option<([f64; 3], f64)> {
    use ParameterKind::{RotationX, RotationY, RotationZ, TranslationX, TranslationY, TranslationZ};
    let shift = block(
        calibration,
        &camera.id,
        [TranslationX, TranslationY, TranslationZ],
    )?;
    let r = camera.camera_from_world.rotation.matrix();
    let centre = r.transpose() * shift * r;
    let turn = block(calibration, &camera.id, [RotationX, RotationY, RotationZ]);
    let rotation = turn.map_or(f64::NAN, |m| m.trace().max(0.0).sqrt());
    Some((std::array::from_fn(|k| centre[(k, k)].max(0.0).sqrt()), rotation))
}

fn block(calibration: &Calibration, camera: &CameraId, kinds: [ParameterKind; 3]) -> Option<Matrix3<f64>> {
    let mut rows = [0; 3];
    for (row, kind) in rows.iter_mut().zip(kinds) {
        *row = calibration
            .parameters
            .iter()
            .position(|p| p.camera == *camera && p.kind == kind)?;
    }
    let mut found = Matrix3::zeros();
    for (i, row) in rows.iter().enumerate() {
        for (k, column) in rows.iter().enumerate() {
            found[(i, k)] = *calibration.covariance.get(*row)?.get(*column)?;
        }
    }
    Some(found)
}

const COLUMNS: [Column; 10] = [
    Column::words("Camera", "", "Camera id; the reference has delay 0"),
    Column::numbers("Delay τ", "ms", "Capture delay: true = stamped − τ, with 1σ"),
    Column::numbers("Delay", "frames", "The same in this camera's frames, with 1σ"),
    Column::numbers("Skew", "ppm", "Clock rate over the reference's; positive: fast"),
    Column::numbers(
        "Jitter",
        "µs",
        "1σ of the stamps, as residuals along the motion tell it",
    ),
    Column::numbers(
        "Position x, y, z",
        "m",
        "Centre of the camera in the world, with 1σ in cm",
    ),
    Column::numbers("Aim", "mrad", "1σ of the camera's rotation"),
    Column::numbers("Noise", "px", "1σ of one coordinate, as the residuals tell it"),
    Column::numbers(
        "RMS",
        "px",
        "Root mean square reprojection error of the points kept",
    ),
    Column::numbers("Points", "kept", "Points kept in the calibration"),
];

/// The table, one row a camera; cameras of the rig that could not be calibrated stand last.
pub(super) fn delay_and_pose_table(calibration: &Calibration, rig: &Rig) -> String {
    let mut rows: Vec<Vec<String>> = calibration
        .cameras
        .iter()
        .map(|camera| camera_row(calibration, rig, camera))
        .collect();
    let absent = rig.cameras.iter().filter(|c| calibration.camera(&c.id).is_none());
    rows.extend(absent.map(|camera| {
        let mut row = vec![escape(camera.id.as_str()), "not calibrated".to_owned()];
        row.resize(COLUMNS.len(), "–".to_owned());
        row
    }));
    table("Delay and pose of every camera", &COLUMNS, &rows)
}

fn camera_row(calibration: &Calibration, rig: &Rig, camera: &CameraCalibration) -> Vec<String> {
    let is_reference = camera.id == calibration.reference;
    let with_sigma = |value: f64, sigma: f64, decimals: usize| {
        // A method without an uncertainty leaves 0.
        let sigma = if sigma > 0.0 {
            number(sigma, decimals)
        } else {
            "–".to_owned()
        };
        format!("{} <i>± {sigma}</i>", number(value, decimals))
    };
    let delay = |unit: f64, decimals: usize| {
        if is_reference {
            "0 <i>reference</i>".to_owned()
        } else {
            with_sigma(
                camera.capture_delay_s * unit,
                camera.capture_delay_sigma_s * unit,
                decimals,
            )
        }
    };
    let rate_hz = rig.camera(&camera.id).map(|setup| setup.frame_rate_hz);
    let centre = camera.camera_from_world.centre_m();
    let pose_sigma = pose_sigma(calibration, camera);
    let position = centre
        .iter()
        .map(|v| number(*v, 3))
        .collect::<Vec<_>>()
        .join(", ");
    let position_sigma = pose_sigma.map_or("± –".to_owned(), |(sigma, _)| {
        let each: Vec<String> = sigma.iter().map(|s| number(100.0 * s, 1)).collect();
        format!("± {} cm", each.join(", "))
    });
    vec![
        escape(camera.id.as_str()),
        delay(1e3, 4),
        rate_hz.map_or("–".to_owned(), |rate| delay(rate, 4)),
        number(camera.clock_skew_ppm, 2),
        number(1e6 * camera.jitter_sigma_s, 1),
        format!("{position}<br><i>{position_sigma}</i>"),
        pose_sigma.map_or("–".to_owned(), |(_, turn)| number(1e3 * turn, 3)),
        number(camera.noise_sigma_px, 3),
        number(camera.reprojection_rms_px, 3),
        camera.points.to_string(),
    ]
}

/// The map from above: cameras, where they look, and the field where the world is the home plate's.
pub(super) fn map(calibration: &Calibration, field: FieldPreset) -> String {
    if calibration.cameras.is_empty() {
        return String::new();
    }
    let at_home = calibration.world == WorldFrame::HomePlate;
    let centres: Vec<Vector3<f64>> = calibration
        .cameras
        .iter()
        .map(|c| c.camera_from_world.centre_m().coords)
        .collect();
    let mut seen: Vec<[f64; 2]> = centres.iter().map(|c| [c.x, c.y]).collect();
    if at_home {
        seen.extend([[-3.0, -3.0], [3.0, 20.0]]);
    }
    let Some((x, y)) = square(&seen) else {
        return String::new();
    };
    let margins = Margins {
        left: 44.0,
        top: 26.0,
        right: 14.0,
        bottom: 42.0,
    };
    let mut chart = Chart::new([358.0, 368.0], margins, x, y);
    let unit = if at_home {
        ["x, m (catcher’s right →)", "y, m ↑ (pitcher)"]
    } else {
        ["x", "y"]
    };
    chart.axes(unit, [6, 6]);
    if at_home {
        draw_field(&mut chart, field);
    }
    let reach = 0.16 * (x.to - x.from);
    for (camera, centre) in calibration.cameras.iter().zip(&centres) {
        draw_camera(&mut chart, camera, centre, reach);
    }
    let caption = "<b>From above</b>: where each camera stands and what it sees across.";
    figure("card", &chart.finish("Map of the cameras"), caption)
}

/// Two scales of the same length around the points.
fn square(points: &[[f64; 2]]) -> Option<(Scale, Scale)> {
    let limits = |k: usize| {
        let values = || points.iter().map(|p| p[k]).filter(|v| v.is_finite());
        let (low, high) = (
            values().fold(f64::INFINITY, f64::min),
            values().fold(f64::NEG_INFINITY, f64::max),
        );
        (low <= high).then_some((0.5 * (low + high), high - low))
    };
    let ((x, wide), (y, high)) = (limits(0)?, limits(1)?);
    let half = 0.5 * wide.max(high).max(1e-3) * 1.3;
    Some((
        Scale::linear(x - half, x + half),
        Scale::linear(y - half, y + half),
    ))
}

fn draw_field(chart: &mut Chart, field: FieldPreset) {
    let at = |name: &str| field.landmark(name).map_or([0.0, 0.0], |p| [p.x, p.y]);
    let [first, second, third] = ["first_base", "second_base", "third_base"].map(at);
    chart.line(
        "thirds",
        &[
            [4.0 * third[0], 4.0 * third[1]],
            [0.0, 0.0],
            [4.0 * first[0], 4.0 * first[1]],
        ],
    );
    chart.line("thirds", &[first, second, third]);
    let mound = at("mound_center");
    let around: Vec<[f64; 2]> = (0..36)
        .map(|i| {
            let (s, c) = (f64::from(i) * 10.0).to_radians().sin_cos();
            [mound[0] + 2.7432 * c, mound[1] + 2.7432 * s]
        })
        .collect();
    chart.shape("mound", &around);
    chart.line(
        "plane",
        &[[0.0, 0.0], at("rubber_front_left").map(|v| v.max(0.0))],
    );
    for base in [[0.0, 0.0], first, second, third] {
        chart.circle("base", base, 3.0);
    }
}

fn draw_camera(chart: &mut Chart, camera: &CameraCalibration, centre: &Vector3<f64>, reach: f64) {
    let from = [centre.x, centre.y];
    // Half of the view across at mid-height; rays in camera coordinates, turned to the world, seen from above.
    let lens = &camera.intrinsics;
    let edges = [0.0, f64::from(camera.width_px)].map(|u| (u - lens.cx_px) / lens.fx_px);
    let ray = |x: f64| {
        let world = camera.camera_from_world.rotation.inverse() * Vector3::new(x, 0.0, 1.0);
        let flat = world.xy().norm().max(1e-6);
        [from[0] + reach * world.x / flat, from[1] + reach * world.y / flat]
    };
    chart.shape(
        "sight",
        &[
            from,
            ray(edges[0]),
            ray(0.5 * (edges[0] + edges[1])),
            ray(edges[1]),
        ],
    );
    chart.circle("camera", from, 4.5);
    let [px, py] = chart.place(from[0], from[1]);
    chart.text("name", [px, py + 18.0], "middle", camera.id.as_str());
}

#[cfg(test)]
mod tests {
    use super::super::super::fixture;
    use super::*;
    use crate::scene::Parameter;

    #[test]
    fn the_centre_s_sigma_turns_with_the_camera() {
        // A camera on the +x side that looks along −x: its depth axis is the world's x, its columns the world's y.
        let mut calibration = fixture::calibration();
        let camera = CameraCalibration {
            camera_from_world: crate::geometry::Pose::looking_at(
                nalgebra::Point3::new(10.0, 0.0, 1.0),
                nalgebra::Point3::new(0.0, 0.0, 1.0),
            ),
            ..calibration.cameras[0].clone()
        };
        use ParameterKind::{RotationX, RotationY, RotationZ, TranslationX, TranslationY, TranslationZ};
        calibration.parameters = [
            RotationX,
            RotationY,
            RotationZ,
            TranslationX,
            TranslationY,
            TranslationZ,
        ]
        .map(|kind| Parameter {
            camera: camera.id.clone(),
            kind,
        })
        .to_vec();
        let sigma = [1e-4, 2e-4, 2e-4, 0.01, 0.02, 0.05];
        calibration.covariance = (0..6)
            .map(|i| {
                (0..6)
                    .map(|j| if i == j { sigma[i] * sigma[i] } else { 0.0 })
                    .collect()
            })
            .collect();
        let (centre, turn) = pose_sigma(&calibration, &camera).unwrap();
        for (told, expected) in centre.iter().zip([0.05, 0.01, 0.02]) {
            assert!((told - expected).abs() < 1e-12, "{centre:?}");
        }
        assert!((turn - 3e-4).abs() < 1e-12);
    }

    #[test]
    fn a_covariance_without_the_camera_has_no_sigma() {
        let mut calibration = fixture::calibration();
        calibration.covariance.truncate(2);
        let camera = calibration.cameras[0].clone();
        assert_eq!(pose_sigma(&calibration, &camera), None);
        assert!(delay_and_pose_table(&calibration, &fixture::rig()).contains("± –"));
    }
}
