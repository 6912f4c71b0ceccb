//! The page as a whole: complete, closed, and safe against what the texts say.

use super::super::fixture;
use super::*;
use crate::scene::{CalibrationMethod, CostStep};

fn residuals(pitches: &[Pitch], calibration: &Calibration) -> Vec<Residual> {
    // Low-discrepancy spread through a logistic quantile: the same on every run, and roughly normal.
    let draw = |i: usize, step: f64| {
        let u = (0.5 + i as f64 * step).fract().clamp(1e-3, 1.0 - 1e-3);
        0.13 * (u / (1.0 - u)).ln()
    };
    let mut all = Vec::new();
    for camera in &calibration.cameras {
        for pitch in pitches {
            for k in 0..72 {
                let i = all.len();
                let wild = if k == 40 { 4.0 } else { 0.0 };
                all.push(Residual {
                    camera: camera.id.clone(),
                    pitch: pitch.pitch,
                    time_s: (pitch.release_time_ns - 1_775_001_600_000_000_000) as f64 / 1e9,
                    dx_px: draw(i, 0.618_033_99) + wild,
                    dy_px: draw(i, 0.414_213_56),
                    kept: k != 40,
                });
            }
        }
    }
    all
}

fn with_page(calibration: &Calibration, pitches: &[Pitch], check: impl Fn(&str)) {
    let rig = fixture::rig();
    let facts = [("Points".to_owned(), "864 <of> 870".to_owned())];
    let page = html(&ReportInput {
        title: "bullpen <script>alert(1)</script> & \"more\"",
        rig: &rig,
        calibration,
        pitches,
        residuals: &residuals(pitches, calibration),
        warnings: &["camera third moved by 1.5 px & was <not> repaired".to_owned()],
        facts: &facts,
        plane: PlatePlane::Front,
    });
    check(&page);
}

#[test]
fn every_pitch_and_camera_is_on_the_page() {
    let pitches = fixture::pitches();
    with_page(&fixture::calibration(), &pitches, |page| {
        assert_eq!(pitches.len(), 6);
        for pitch in &pitches {
            assert!(page.contains(&format!("id=\"pitch-{}\"", pitch.pitch)));
            assert!(page.contains(&format!("<title>pitch {}: x ", pitch.pitch)));
        }
        for words in [
            "6 pitches from 2 cameras",
            "88.63 <i>± 0.05</i>",
            "Home plate frame: x to catcher’s right",
            "3.2100 <i>± 0.0120</i>",
            // 3.21 ms at 175 Hz.
            "0.5618 <i>± 0.0021</i>",
            "14.000, 5.000, 2.500<br><i>± 1.0, 1.0, 1.0 cm</i>",
            "2026-04-01 00:00:12.34 UTC",
            "outliers</span>",
        ] {
            assert!(page.contains(words), "{words}");
        }
    });
}

#[test]
fn texts_are_escaped_and_nothing_comes_from_outside() {
    with_page(&fixture::calibration(), &fixture::pitches(), |page| {
        assert!(!page.contains("<script") && !page.contains("<late>") && !page.contains("<weak>"));
        assert!(!page.contains("<A>") && !page.contains("<of>") && !page.contains("<not>"));
        assert!(page.contains("first points &lt;late&gt; &amp; few"));
        for outside in ["http:", "https:", "//", "src=", "@import", "url(", "<link"] {
            assert!(!page.contains(outside), "{outside}");
        }
        assert!(!page.contains("NaN") && !page.contains("inf\""));
    });
}

/// Every element is closed where it should be: a page that a browser need not repair.
#[test]
fn elements_nest() {
    with_page(&fixture::calibration(), &fixture::pitches(), |page| {
        let body = page.split("</style>").nth(1).unwrap();
        let mut open: Vec<&str> = vec!["html", "head"];
        let mut seen = 0;
        for tag in body.split('<').skip(1).map(|t| t.split('>').next().unwrap()) {
            let name = tag.trim_start_matches('/').split_whitespace().next().unwrap();
            if let Some(closed) = tag.strip_prefix('/') {
                assert_eq!(open.pop(), Some(closed), "after {seen} elements");
            } else if !tag.ends_with('/') && name != "br" {
                open.push(name);
                seen += 1;
            }
        }
        assert!(open.is_empty() && seen > 300, "{open:?} {seen}");
    });
}

#[test]
fn the_search_is_drawn_where_there_was_one() {
    let mut calibration = fixture::calibration();
    with_page(&calibration, &fixture::pitches(), |page| {
        assert!(!page.contains("The search"))
    });
    calibration.method = CalibrationMethod::Kim2019;
    calibration.cost_trace = (0..60)
        .map(|i| CostStep {
            evaluation: i,
            capture_delay_s: vec![0.003 + 0.001 * (-0.1 * i as f64).exp()],
            cost_px: 0.4 + 9.0 * (-0.2 * i as f64).exp(),
        })
        .collect();
    with_page(&calibration, &fixture::pitches(), |page| {
        assert!(page.contains("The search") && page.contains("60 evaluations, from 9.400 to 0.400 px"));
    });
}

#[test]
fn a_calibration_without_a_covariance_says_so() {
    let mut calibration = fixture::calibration();
    with_page(&calibration, &fixture::pitches(), |page| {
        assert!(
            page.contains("includes the uncertainty of the calibration") && !page.contains("taken as exact")
        );
    });
    calibration.covariance.clear();
    calibration.parameters.clear();
    calibration.cameras[1].capture_delay_sigma_s = 0.0;
    with_page(&calibration, &fixture::pitches(), |page| {
        assert!(page.contains("taken as exact") && page.contains("3.2100 <i>± –</i>"));
        assert!(page.contains("± – <small>µs</small>"));
    });
}

#[test]
fn an_empty_session_and_a_world_without_a_plate_have_a_page_too() {
    let mut calibration = fixture::calibration();
    with_page(&calibration, &[], |page| {
        assert!(page.contains("No pitch was solved."))
    });
    calibration.world = WorldFrame::ReferenceCamera;
    with_page(&calibration, &fixture::pitches(), |page| {
        assert!(page.contains("The reference camera’s frame") && !page.contains("Catcher’s view"));
    });
    calibration.cameras.clear();
    with_page(&calibration, &[], |page| {
        assert!(page.contains("0 pitches from 0 cameras"))
    });
}

#[test]
fn a_pitch_with_numbers_that_are_not_finite_does_not_spoil_the_page() {
    let mut pitches = fixture::pitches();
    pitches[0].plate_mid_m = [f64::NAN, f64::INFINITY];
    pitches[0].flight[0].position_m = [f64::NAN; 3];
    pitches[0].strike_probability = f64::NAN;
    pitches[1].flight.clear();
    pitches[2].plate_mid_m = [9.0, -3.0];
    with_page(&fixture::calibration(), &pitches, |page| {
        assert!(!page.contains("NaN"));
        assert!(page.contains("drawn at its edge: 1, 3."));
    });
}

#[test]
fn a_free_motion_has_its_own_page() {
    let (rig, mut calibration) = (fixture::rig(), fixture::calibration());
    calibration.world = WorldFrame::ReferenceCamera;
    // A helix of 60 s at 30 Hz with a gap of 4 s in it.
    let rows: Vec<TrajectoryRow> = (0..1800)
        .filter(|i| !(600..720).contains(i))
        .map(|i| {
            let t = f64::from(i) / 30.0;
            TrajectoryRow {
                time_ns: i64::from(i) * 33_333_333,
                position_m: [8.0 * (0.3 * t).sin(), 12.0 + 8.0 * (0.3 * t).cos(), 1.0 + 0.1 * t],
                sigma_m: [0.05, 0.11, 0.04],
                cameras: 2,
            }
        })
        .collect();
    let mut motion = residuals(&fixture::pitches(), &calibration);
    for (i, residual) in motion.iter_mut().enumerate() {
        (residual.pitch, residual.time_s) = (0, (i % 432) as f64 / 7.2);
    }
    let page = free_html(&FreeReportInput {
        title: "drone <1>",
        rig: &rig,
        calibration: &calibration,
        rows: &rows,
        residuals: &motion,
        warnings: &[],
        facts: &[],
    });
    for words in [
        "A trajectory of 60.0 s from 2 cameras",
        "<b>2</b><span>unbroken pieces",
        "drone &lt;1&gt;",
        "First and third axis",
        "rms over the motion",
        "trajectory.csv",
    ] {
        assert!(page.contains(words), "{words}");
    }
    assert!(!page.contains("NaN") && !page.contains("Catcher"));
    let none = FreeReportInput {
        title: "",
        rig: &rig,
        calibration: &calibration,
        rows: &[],
        residuals: &[],
        warnings: &[],
        facts: &[],
    };
    assert!(free_html(&none).contains("No part of the motion was solved."));
}
