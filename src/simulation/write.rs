//! Products on disk: `rig.toml`, `tracks/<camera>.csv`, `truth/` (design §5).

use std::fmt::Write as _;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use super::error::SimulationError;
use super::truth::{TrueCentre, Truth};
use crate::scene::{FieldPreset, Motion, Rig, RollingShutter, Track};

pub(super) fn at(path: &Path) -> impl FnOnce(std::io::Error) -> SimulationError {
    let path = path.to_owned();
    |source| SimulationError::Write { path, source }
}

pub(super) fn make_folder(path: &Path) -> Result<(), SimulationError> {
    fs::create_dir_all(path).map_err(at(path))
}

fn write_text(path: &Path, text: &str) -> Result<(), SimulationError> {
    fs::write(path, text).map_err(at(path))
}

/// Writes `DIR/rig.toml`: what a person would know, not the truth.
pub fn write_rig(folder: &Path, rig: &Rig) -> Result<PathBuf, SimulationError> {
    make_folder(folder)?;
    let path = folder.join("rig.toml");
    write_text(&path, &rig_text(rig))?;
    Ok(path)
}

/// A rig in the form of design §5.
fn rig_text(rig: &Rig) -> String {
    let field = match rig.site.field {
        FieldPreset::Professional => "professional",
        FieldPreset::Youth80 => "youth_80_54",
        FieldPreset::Youth70 => "youth_70_48",
        FieldPreset::Youth60 => "youth_60_46",
    };
    let motion = match rig.site.motion {
        Motion::Flight => "flight",
        Motion::Free => "free",
    };
    let mut out = String::new();
    // Writing to a String cannot fail.
    let _ = writeln!(
        out,
        "# Made by `pitchd simulate`: the rig as a person would write it, not the truth.\n[site]\nname = {}\n\
         field = \"{field}\"\nmotion = \"{motion}\"\ngravity_mps2 = {:?}\nair_density_kgpm3 = {:?}",
        toml::Value::from(rig.site.name.as_str()),
        rig.site.gravity_mps2,
        rig.site.air_density_kgpm3,
    );
    for (index, camera) in rig.cameras.iter().enumerate() {
        let _ = writeln!(out, "\n[[camera]]\nid = \"{}\"", camera.id);
        if index == rig.reference {
            let _ = writeln!(out, "reference = true");
        }
        let _ = writeln!(
            out,
            "width_px = {}\nheight_px = {}\nframe_rate_hz = {:?}",
            camera.width_px, camera.height_px, camera.frame_rate_hz
        );
        if let Some(exposure_s) = camera.exposure_s {
            let _ = writeln!(out, "exposure_s = {exposure_s:?}");
        }
        if let Some(offset_s) = camera.time_offset_s {
            let _ = writeln!(out, "time_offset_s = {offset_s:?}");
        }
        let _ = match camera.rolling_shutter {
            RollingShutter::Global => Ok(()),
            RollingShutter::Estimate => writeln!(out, "rolling_shutter = \"estimate\""),
            RollingShutter::ReadoutSeconds(s) => writeln!(out, "rolling_shutter = {s:?}"),
        };
        for (key, areas) in [("regions_px", &camera.regions), ("masks_px", &camera.masks)] {
            if !areas.is_empty() {
                let areas = areas.iter().map(|a| [a.x_px, a.y_px, a.width_px, a.height_px]);
                let _ = writeln!(out, "{key} = {:?}", areas.collect::<Vec<_>>());
            }
        }
        if let Some((p, sigma_m)) = camera.position {
            let _ = writeln!(out, "position_m = [{:?}, {:?}, {:?}]", p.x, p.y, p.z);
            let _ = writeln!(out, "position_sigma_m = {sigma_m:?}");
        }
        let lens = &camera.intrinsics;
        let _ = writeln!(
            out,
            "[camera.intrinsics]\nfx_px = {:?}\nfy_px = {:?}\ncx_px = {:?}\ncy_px = {:?}\ndistortion = {:?}",
            lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px, lens.distortion
        );
        for landmark in &camera.landmarks {
            let _ = writeln!(
                out,
                "[[camera.landmark]]\nname = \"{}\"\npixel_px = [{:.4}, {:.4}]",
                landmark.name, landmark.pixel.x, landmark.pixel.y
            );
            let _ = match landmark.sigma_px {
                [x, y] if x == y => writeln!(out, "sigma_px = {x:?}"),
                each => writeln!(out, "sigma_px = {each:?}"),
            };
            let at = landmark.position.world_m;
            if rig.site.field.landmark(&landmark.name).ok() != Some(at) {
                let _ = writeln!(out, "world_m = [{:?}, {:?}, {:?}]", at.x, at.y, at.z);
            }
        }
    }
    out
}

/// Writes `DIR/tracks/<camera>.csv`: distorted pixels and stamped midpoints. Cameras without a track get an
/// empty table, so that their absence is not an error.
pub fn write_tracks(folder: &Path, rig: &Rig, tracks: &[Track]) -> Result<(), SimulationError> {
    let folder = folder.join("tracks");
    make_folder(&folder)?;
    for camera in &rig.cameras {
        let own = || tracks.iter().filter(|t| t.camera == camera.id);
        let with_sigma = own().flat_map(|t| &t.points).any(|p| p.covariance_px2.is_some());
        let sigma_head = if with_sigma { ",sigma_px" } else { "" };
        let mut out = format!("track,frame,timestamp_ns,x_px,y_px{sigma_head}\n");
        for track in own() {
            for p in &track.points {
                let stamp = p.stamped.nanos();
                let _ = write!(
                    out,
                    "{},{},{stamp},{:.5},{:.5}",
                    track.track, p.frame, p.pixel.x, p.pixel.y
                );
                let _ = match p.covariance_px2 {
                    Some(c) => writeln!(out, ",{:.5}", (0.5 * c.trace()).sqrt()),
                    None if with_sigma => writeln!(out, ","),
                    None => writeln!(out),
                };
            }
        }
        write_text(&folder.join(format!("{}.csv", camera.id)), &out)?;
    }
    Ok(())
}

/// Writes `DIR/truth/`: `truth.json` and the centres `<camera>.csv`.
pub fn write_truth(folder: &Path, truth: &Truth) -> Result<(), SimulationError> {
    let folder = folder.join("truth");
    make_folder(&folder)?;
    let path = folder.join("truth.json");
    let json = serde_json::to_vec_pretty(truth).map_err(|e| at(&path)(e.into()))?;
    let mut file = fs::File::create(&path).map_err(at(&path))?;
    file.write_all(&json).map_err(at(&path))?;
    for camera in &truth.centres {
        let text = centres_text(&camera.centres);
        write_text(&folder.join(format!("{}.csv", camera.camera)), &text)?;
    }
    Ok(())
}

fn centres_text(centres: &[TrueCentre]) -> String {
    let mut out = String::from("pitch,frame,timestamp_ns,x_px,y_px,visible,radius_px\n");
    for c in centres {
        let _ = writeln!(
            out,
            "{},{},{},{:.6},{:.6},{},{:.4}",
            c.pitch,
            c.frame,
            c.stamped.nanos(),
            c.pixel.x,
            c.pixel.y,
            u8::from(c.visible),
            c.radius_px
        );
    }
    out
}
