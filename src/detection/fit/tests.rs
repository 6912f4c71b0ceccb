//! The fit on painted balls whose centre is known.

use super::shared::KNOWN_SIGMA_SHARE;
use super::*;
use crate::detection::painter::{Ball, Canvas};
use crate::scene::Frame;

struct Case {
    radius: f64,
    streak: f64,
    noise: f32,
    shade: f64,
    to_light: [f64; 3],
    /// Optics, σ in pixels; 0: none.
    blur_px: f64,
    /// From this trial on the direct light is gone.
    shade_from: u64,
}

/// Bias and rms along and across the motion over sub-pixel places, against the painter's truth, and the mean
/// squared error over its covariance.
fn errors(case: &Case, sigma_edge: f64) -> ([f64; 2], [f64; 2], f64, f64, Shared, f64) {
    let seen = |canvas: &Canvas| match case.blur_px {
        0.0 => canvas.clone(),
        blur_px => canvas.blurred(blur_px),
    };
    let edge = Edge::new(sigma_edge);
    let angle = 0.3f64;
    let direction = Vector2::new(angle.cos(), angle.sin());
    let mut truths = Vec::new();
    let mut frames: Vec<[Frame; 3]> = Vec::new();
    for trial in 0..60u64 {
        let centre = [
            31.0 + 0.137 * (trial % 13) as f64,
            32.0 + 0.211 * (trial % 7) as f64,
        ];
        truths.push(Vector2::new(centre[0], centre[1]));
        // What is behind the rim of a ball is blurred with it, and draws one ball to one side.
        let sharp = Canvas::stand(64, 64, 5 + trial, 30.0);
        let stand = seen(&sharp);
        let mut canvas = sharp.clone();
        canvas.ball(&Ball {
            centre,
            streak: [case.streak * direction.x, case.streak * direction.y],
            radius: case.radius,
            light: if trial >= case.shade_from {
                case.shade
            } else {
                200.0
            },
            shade: case.shade,
            to_light: case.to_light,
        });
        frames.push([
            seen(&canvas).frame(trial, 175.0, case.noise),
            stand.frame(1000 + trial, 175.0, case.noise),
            stand.frame(2000 + trial, 175.0, case.noise),
        ]);
    }
    let mut pictures: Vec<Picture> = frames
        .iter()
        .zip(&truths)
        .enumerate()
        .map(|(i, ([c, a, b], truth))| {
            let patch = Patch {
                left: 0,
                top: 0,
                width: 64,
                current: c.bytes(),
                one: a.bytes(),
                other: b.bytes(),
                difference_sigma: f64::from(case.noise) * 1.414,
                radius_px: case.radius,
            };
            let start = PictureStart {
                view: View::default(),
                centre_px: truth + Vector2::new(0.5, -0.6),
                streak_px: direction * case.streak,
                radius_px: case.radius * 1.1,
                place: i as f64 / 59.0 - 0.5,
            };
            Picture::new(&patch, &start, &edge).unwrap()
        })
        .collect();
    let first = Shared::start(0.75 * case.radius, 0.03, case.shade_from < 60);
    let mut shared = first_fit(&mut pictures, &first, &edge, 10).unwrap();
    shared.release_light();
    let (mut covariance, cost) = fit_shared(&mut pictures, &mut shared, &edge, 15).unwrap();
    if let Some(shaded) = fit_shares(&pictures, &shared, &edge, 15) {
        (pictures, shared, covariance) = shaded;
    }
    let shares: Vec<f64> = pictures.iter().map(|p| p.share().1).collect();
    println!("{shares:.2?} {:.2?}", shared.values.as_slice());
    for (picture, trial) in pictures.iter().zip(0..) {
        let (_, share) = picture.share();
        assert!(
            if trial >= case.shade_from {
                share < 0.3
            } else {
                (share - 1.0).abs() < 0.3
            },
            "picture {trial}: {share}"
        );
    }
    let (mut sum, mut squares, mut n, mut chi, mut nees) = ([0.0; 2], [0.0; 2], 0.0, 0.0, 0.0);
    for (picture, truth) in pictures.iter_mut().zip(&truths) {
        let ball = fit_centre(picture, &shared, &covariance, &edge).unwrap();
        let off = ball.centre_px - truth;
        let parts = [off.dot(&direction), off.y * direction.x - off.x * direction.y];
        for i in 0..2 {
            sum[i] += parts[i];
            squares[i] += parts[i] * parts[i];
        }
        nees += (off.transpose() * ball.covariance_px2.try_inverse().unwrap() * off)[0] / 2.0;
        chi += ball.chi2;
        n += 1.0;
    }
    (
        sum.map(|s| s / n),
        squares.map(|s| f64::sqrt(s / n)),
        chi / n,
        nees / n,
        shared,
        cost,
    )
}

#[test]
fn the_centre_has_no_bias_from_the_light() {
    let mut cases = 0;
    for (shade, to_light) in [(60.0, [0.3, -1.0, -0.5]), (100.0, [0.5, -1.0, -1.0])] {
        for (radius, streak) in [(2.2, 4.0), (3.0, 1.0), (3.0, 6.0)] {
            let case = Case {
                radius,
                streak,
                noise: 2.0,
                shade,
                to_light,
                blur_px: 0.0,
                shade_from: u64::MAX,
            };
            let (bias, rms, chi2, nees, shared, cost) = errors(&case, 0.3);
            println!(
                "shade {shade} radius {radius} streak {streak}: bias {bias:.3?} rms {rms:.3?} chi2 {chi2:.2} \
                 nees {nees:.2} cost {cost:.0} shared {:.2?}",
                shared.values.as_slice()
            );
            assert!(
                bias.iter().all(|b| b.abs() < 0.07),
                "bias {bias:?} px, radius {radius}, streak {streak}"
            );
            assert!(
                rms.iter().all(|r| *r < 0.1),
                "rms {rms:?} px, radius {radius}, streak {streak}"
            );
            cases += 1;
        }
    }
    assert_eq!(cases, 6);
}

#[test]
fn the_centre_has_no_bias_from_optics_that_blur() {
    // From above, from the side, from behind the ball (z forward), from the camera.
    let lights = [
        [0.3, -1.0, -0.5],
        [-0.5, -0.8, -0.2],
        [0.35, -0.87, 0.33],
        [0.1, -0.6, -0.8],
    ];
    let mut cases = 0;
    for blur_px in [0.6, 0.8, 0.95] {
        for to_light in lights {
            let case = Case {
                radius: 3.4,
                streak: 2.5,
                noise: 1.5,
                shade: 75.0,
                to_light,
                blur_px,
                shade_from: u64::MAX,
            };
            // A pixel's area adds a twelfth.
            let (bias, rms, chi2, nees, shared, _) = errors(&case, blur_px.hypot(12f64.powf(-0.5)));
            println!(
                "blur {blur_px} light {to_light:?}: bias {bias:.3?} rms {rms:.3?} chi2 {chi2:.2} nees {nees:.2} \
                 radius {:.2}",
                shared.values[0]
            );
            assert!(
                bias.iter().all(|b| b.abs() < 0.03),
                "blur {blur_px}, light {to_light:?}: {bias:?} px"
            );
            cases += 1;
        }
    }
    assert_eq!(cases, 12);
}

#[test]
fn in_the_shade_a_ball_is_lit_by_the_sky_alone() {
    for shade_from in [35, 48] {
        let case = Case {
            radius: 3.4,
            streak: 2.5,
            noise: 1.5,
            shade: 110.0,
            to_light: [0.3, -1.0, -0.5],
            blur_px: 0.6,
            shade_from,
        };
        let (bias, rms, chi2, nees, shared, _) = errors(&case, 0.6f64.hypot(12f64.powf(-0.5)));
        println!(
            "shade from {shade_from}: bias {bias:.3?} rms {rms:.3?} chi2 {chi2:.2} nees {nees:.2} light {:.2?}",
            &shared.values.as_slice()[8..11]
        );
        assert!(
            bias.iter().all(|b| b.abs() < 0.03) && rms.iter().all(|r| *r < 0.1),
            "{bias:?} {rms:?}"
        );
    }
}

#[test]
fn what_is_known_of_a_size_goes_on_with_the_ball() {
    // 1/r is linear: r = 4 / (1 − τ/2) is 4 px in the middle and 4/0.875 a quarter of the way on.
    let mut known = Shared::start(4.0, 0.1, true);
    known.know_size(4.0, -0.5);
    known.values[1] = -0.5;
    let over = known.over(0.25, 1.0);
    assert!((over.prior[0] - 4.0 / 0.875).abs() < 1e-9 && (over.prior[1] + 0.5 / 0.875).abs() < 1e-9);
    assert_eq!((over.values[0], over.values[1]), (over.prior[0], over.prior[1]));
    // One percent of it still.
    assert!((over.weights[0].powf(-0.5) / over.prior[0] - KNOWN_SIGMA_SHARE).abs() < 1e-9);
    let unknown = Shared::start(4.0, 0.1, true);
    let over = unknown.over(0.25, 1.5);
    assert_eq!((over.prior, over.weights), (unknown.prior, unknown.weights));
}
