//! The rig file (design §5): strict TOML to [`Rig`].

use std::path::{Path, PathBuf};

use nalgebra::Point3;
use serde::{Deserialize, Deserializer, de};

use super::{ConfigError, line_of, nearest};
use crate::geometry::{Intrinsics, Pixel};
use crate::scene::{
    CameraId, CameraSetup, DistanceMeasurement, FieldPreset, Landmark, LandmarkPosition, Motion, PixelRect,
    Rig, RollingShutter, Site,
};

/// Standard gravity, m/s² (domain §2).
const STANDARD_GRAVITY_MPS2: f64 = 9.80665;
/// Air density behind domain §2's K = 0.01757 /m.
const STANDARD_AIR_DENSITY_KGPM3: f64 = 1.194;
/// A click is good to about half a pixel.
const DEFAULT_CLICK_SIGMA_PX: f64 = 0.5;
/// A tape or total station is good to about this, metres.
const DEFAULT_POSITION_SIGMA_M: f64 = 0.05;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RigFile {
    #[serde(default)]
    site: SiteFile,
    #[serde(default)]
    camera: Vec<CameraFile>,
    #[serde(default)]
    distance: Vec<DistanceFile>,
}

#[derive(Deserialize, Default, Clone, Copy)]
#[serde(rename_all = "snake_case")]
enum MotionFile {
    #[default]
    Flight,
    Free,
}

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields)]
struct SiteFile {
    name: Option<String>,
    #[serde(default)]
    field: FieldPreset,
    #[serde(default)]
    motion: MotionFile,
    gravity_mps2: Option<f64>,
    air_density_kgpm3: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CameraFile {
    id: toml::Spanned<String>,
    #[serde(default)]
    reference: bool,
    width_px: u32,
    height_px: u32,
    frame_rate_hz: f64,
    exposure_s: Option<f64>,
    time_offset_s: Option<f64>,
    #[serde(default)]
    rolling_shutter: RollingShutterFile,
    position_m: Option<[f64; 3]>,
    position_sigma_m: Option<f64>,
    focal_sigma_relative: Option<f64>,
    #[serde(default)]
    regions_px: Vec<toml::Spanned<[u32; 4]>>,
    #[serde(default)]
    masks_px: Vec<toml::Spanned<[u32; 4]>>,
    intrinsics: IntrinsicsFile,
    #[serde(default)]
    landmark: Vec<LandmarkFile>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct LandmarkFile {
    name: Option<toml::Spanned<String>>,
    world_m: Option<[f64; 3]>,
    world_sigma_m: Option<f64>,
    pixel_px: toml::Spanned<[f64; 2]>,
    sigma_px: Option<ClickSigma>,
}

/// Of a click: along both axes, or along x and y.
#[derive(Clone, Copy, Deserialize)]
#[serde(untagged, expecting = "expected a number, or two: along x and along y")]
enum ClickSigma {
    Both(f64),
    Each([f64; 2]),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct DistanceFile {
    between: toml::Spanned<[String; 2]>,
    distance_m: f64,
    sigma_m: Option<f64>,
}

/// A table of numbers, or the path of a lens file that holds them.
enum IntrinsicsFile {
    Here(Intrinsics),
    File(String),
}

impl<'de> Deserialize<'de> for IntrinsicsFile {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Visitor;
        impl<'de> de::Visitor<'de> for Visitor {
            type Value = IntrinsicsFile;
            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("a table of intrinsics or the path of a lens file")
            }
            fn visit_str<E: de::Error>(self, path: &str) -> Result<Self::Value, E> {
                Ok(IntrinsicsFile::File(path.to_owned()))
            }
            fn visit_map<A: de::MapAccess<'de>>(self, map: A) -> Result<Self::Value, A::Error> {
                Intrinsics::deserialize(de::value::MapAccessDeserializer::new(map)).map(IntrinsicsFile::Here)
            }
        }
        deserializer.deserialize_any(Visitor)
    }
}

#[derive(Default)]
struct RollingShutterFile(Option<RollingShutter>);

impl<'de> Deserialize<'de> for RollingShutterFile {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Visitor;
        impl de::Visitor<'_> for Visitor {
            type Value = RollingShutterFile;
            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("\"estimate\", \"global\" or a readout time in seconds")
            }
            fn visit_str<E: de::Error>(self, word: &str) -> Result<Self::Value, E> {
                match word {
                    "estimate" => Ok(RollingShutterFile(Some(RollingShutter::Estimate))),
                    "global" | "none" => Ok(RollingShutterFile(Some(RollingShutter::Global))),
                    _ => Err(E::invalid_value(de::Unexpected::Str(word), &self)),
                }
            }
            fn visit_f64<E: de::Error>(self, readout_s: f64) -> Result<Self::Value, E> {
                if readout_s.is_finite() && readout_s.abs() < 1.0 {
                    Ok(RollingShutterFile(Some(RollingShutter::ReadoutSeconds(
                        readout_s,
                    ))))
                } else {
                    Err(E::invalid_value(de::Unexpected::Float(readout_s), &self))
                }
            }
            fn visit_i64<E: de::Error>(self, readout_s: i64) -> Result<Self::Value, E> {
                self.visit_f64(readout_s as f64)
            }
            fn visit_bool<E: de::Error>(self, rolling: bool) -> Result<Self::Value, E> {
                let shutter = if rolling {
                    RollingShutter::Estimate
                } else {
                    RollingShutter::Global
                };
                Ok(RollingShutterFile(Some(shutter)))
            }
        }
        deserializer.deserialize_any(Visitor)
    }
}

/// Reads and checks a rig file; a lens file it names is found relative to it.
///
/// # Errors
/// [`ConfigError`] with file, line and key or camera.
pub fn load_rig(path: &Path) -> Result<Rig, ConfigError> {
    let text = std::fs::read_to_string(path).map_err(|source| ConfigError::Unreadable {
        path: path.to_owned(),
        source,
    })?;
    parse_rig(path, &text)
}

/// Checks the text of a rig file; `path` names it in errors and anchors relative lens files.
///
/// # Errors
/// [`ConfigError`] with file, line and key or camera.
pub fn parse_rig(path: &Path, text: &str) -> Result<Rig, ConfigError> {
    let file: RigFile = toml::from_str(text).map_err(|e| ConfigError::from_toml(path, text, &e))?;
    Checker { path, text }.rig(file)
}

struct Checker<'a> {
    path: &'a Path,
    text: &'a str,
}

impl Checker<'_> {
    fn at(&self, offset: usize, reason: String) -> ConfigError {
        ConfigError::Invalid {
            path: self.path.to_owned(),
            line: line_of(self.text, offset),
            reason,
        }
    }

    fn inconsistent(&self, reason: String) -> ConfigError {
        ConfigError::Inconsistent {
            path: self.path.to_owned(),
            reason,
        }
    }

    fn rig(&self, file: RigFile) -> Result<Rig, ConfigError> {
        if file.camera.is_empty() {
            return Err(self.inconsistent("no [[camera]]: a rig needs at least one".to_owned()));
        }
        let site = self.site(&file.site)?;
        let marked: Vec<usize> = (0..file.camera.len())
            .filter(|i| file.camera[*i].reference)
            .collect();
        if marked.len() > 1 {
            let ids: Vec<_> = marked
                .iter()
                .map(|i| file.camera[*i].id.get_ref().as_str())
                .collect();
            let reason = format!("several cameras say `reference = true`: {}", ids.join(", "));
            return Err(self.inconsistent(reason));
        }
        let mut cameras: Vec<CameraSetup> = Vec::new();
        for camera in file.camera {
            let offset = camera.id.span().start;
            let camera = self.camera(camera, site.field)?;
            if cameras.iter().any(|c| c.id == camera.id) {
                return Err(self.at(offset, format!("two cameras are called `{}`", camera.id)));
            }
            cameras.push(camera);
        }
        let distances = file
            .distance
            .iter()
            .map(|d| self.distance(d, &cameras))
            .collect::<Result<Vec<_>, _>>()?;
        Ok(Rig {
            site,
            reference: marked.first().copied().unwrap_or(0),
            cameras,
            distances,
        })
    }

    fn site(&self, file: &SiteFile) -> Result<Site, ConfigError> {
        let gravity_mps2 = file.gravity_mps2.unwrap_or(STANDARD_GRAVITY_MPS2);
        let air_density_kgpm3 = file.air_density_kgpm3.unwrap_or(STANDARD_AIR_DENSITY_KGPM3);
        self.within("site", "gravity_mps2", gravity_mps2, 9.0..=10.5)?;
        self.within("site", "air_density_kgpm3", air_density_kgpm3, 0.0..=2.0)?;
        Ok(Site {
            name: file.name.clone().unwrap_or_default(),
            field: file.field,
            motion: match file.motion {
                MotionFile::Flight => Motion::Flight,
                MotionFile::Free => Motion::Free,
            },
            gravity_mps2,
            air_density_kgpm3,
        })
    }

    fn within(
        &self,
        owner: &str,
        key: &str,
        value: f64,
        range: std::ops::RangeInclusive<f64>,
    ) -> Result<(), ConfigError> {
        // A NaN is in no range.
        if range.contains(&value) {
            return Ok(());
        }
        Err(self.inconsistent(format!(
            "{owner}: `{key} = {value}` is out of range ({} to {})",
            short(*range.start()),
            short(*range.end())
        )))
    }

    fn camera(&self, file: CameraFile, field: FieldPreset) -> Result<CameraSetup, ConfigError> {
        let offset = file.id.span().start;
        let id = CameraId::new(file.id.get_ref()).map_err(|e| self.at(offset, e.to_string()))?;
        let owner = format!("camera `{id}`");
        self.within(&owner, "width_px", f64::from(file.width_px), 8.0..=65536.0)?;
        self.within(&owner, "height_px", f64::from(file.height_px), 8.0..=65536.0)?;
        self.within(&owner, "frame_rate_hz", file.frame_rate_hz, 0.1..=100_000.0)?;
        if let Some(exposure_s) = file.exposure_s {
            self.within(
                &owner,
                "exposure_s",
                exposure_s,
                0.0..=1.0 / file.frame_rate_hz * 1.001,
            )?;
        }
        if let Some(offset_s) = file.time_offset_s {
            self.within(&owner, "time_offset_s", offset_s, -1e9..=1e9)?;
        }
        let focal_sigma_relative = file.focal_sigma_relative.unwrap_or(0.0);
        self.within(&owner, "focal_sigma_relative", focal_sigma_relative, 0.0..=0.5)?;
        let position = match file.position_m {
            Some(p) => {
                let sigma = file.position_sigma_m.unwrap_or(DEFAULT_POSITION_SIGMA_M);
                self.within(&owner, "position_sigma_m", sigma, 1e-4..=100.0)?;
                for value in p {
                    self.within(&owner, "position_m", value, -1e4..=1e4)?;
                }
                Some((Point3::from(p), sigma))
            }
            None if file.position_sigma_m.is_some() => {
                return Err(self.inconsistent(format!(
                    "{owner}: `position_sigma_m` is given without `position_m`"
                )));
            }
            None => None,
        };
        let intrinsics = self.intrinsics(&owner, file.intrinsics)?;
        let landmarks = file
            .landmark
            .iter()
            .map(|l| self.landmark(&owner, l, field, [file.width_px, file.height_px]))
            .collect::<Result<Vec<_>, _>>()?;
        let size_px = [file.width_px, file.height_px];
        let regions = self.areas(&owner, "regions_px", &file.regions_px, size_px)?;
        let masks = self.areas(&owner, "masks_px", &file.masks_px, size_px)?;
        Ok(CameraSetup {
            id,
            width_px: file.width_px,
            height_px: file.height_px,
            frame_rate_hz: file.frame_rate_hz,
            exposure_s: file.exposure_s,
            time_offset_s: file.time_offset_s,
            rolling_shutter: file.rolling_shutter.0.unwrap_or(RollingShutter::Global),
            intrinsics,
            focal_sigma_relative,
            position,
            landmarks,
            regions,
            masks,
        })
    }

    /// Rectangles `[left, top, width, height]` that lie within the picture.
    fn areas(
        &self,
        owner: &str,
        key: &str,
        areas: &[toml::Spanned<[u32; 4]>],
        [width_px, height_px]: [u32; 2],
    ) -> Result<Vec<PixelRect>, ConfigError> {
        let area = |spanned: &toml::Spanned<[u32; 4]>| {
            let [left, top, width, height] = *spanned.get_ref();
            let ends = |begin: u32, count: u32| begin.checked_add(count).filter(|_| count > 0);
            let right = ends(left, width).filter(|right| *right <= width_px);
            let bottom = ends(top, height).filter(|bottom| *bottom <= height_px);
            if right.is_none() || bottom.is_none() {
                let reason = format!(
                    "{owner}: `{key}` has [{left}, {top}, {width}, {height}]: not a rectangle [left, top, width, height] \
                     within the picture of {width_px}x{height_px}"
                );
                return Err(self.at(spanned.span().start, reason));
            }
            Ok(PixelRect {
                x_px: left,
                y_px: top,
                width_px: width,
                height_px: height,
            })
        };
        areas.iter().map(area).collect()
    }

    fn intrinsics(&self, owner: &str, file: IntrinsicsFile) -> Result<Intrinsics, ConfigError> {
        let intrinsics = match file {
            IntrinsicsFile::Here(intrinsics) => intrinsics,
            IntrinsicsFile::File(name) => {
                let path: PathBuf = self.path.parent().unwrap_or(Path::new(".")).join(name);
                let text = std::fs::read_to_string(&path).map_err(|source| ConfigError::Unreadable {
                    path: path.clone(),
                    source,
                })?;
                toml::from_str(&text).map_err(|e| ConfigError::from_toml(&path, &text, &e))?
            }
        };
        self.within(owner, "intrinsics.fx_px", intrinsics.fx_px, 10.0..=1e6)?;
        self.within(owner, "intrinsics.fy_px", intrinsics.fy_px, 10.0..=1e6)?;
        self.within(owner, "intrinsics.cx_px", intrinsics.cx_px, -1e5..=1e5)?;
        self.within(owner, "intrinsics.cy_px", intrinsics.cy_px, -1e5..=1e5)?;
        for value in intrinsics.distortion {
            self.within(owner, "intrinsics.distortion", value, -1e3..=1e3)?;
        }
        Ok(intrinsics)
    }

    fn landmark(
        &self,
        owner: &str,
        file: &LandmarkFile,
        field: FieldPreset,
        size_px: [u32; 2],
    ) -> Result<Landmark, ConfigError> {
        let at = file.pixel_px.span().start;
        let name = file.name.as_ref().map_or("", |n| n.get_ref().as_str());
        let world_m = match (file.world_m, &file.name) {
            (Some(world), _) => Point3::from(world),
            (None, Some(spanned)) => field
                .landmark(name)
                .map_err(|e| self.at(spanned.span().start, unknown_landmark(&e)))?,
            (None, None) => {
                let reason = format!("{owner}: a landmark needs a preset `name` or `world_m`");
                return Err(self.at(at, reason));
            }
        };
        let [x, y] = *file.pixel_px.get_ref();
        let label = format!("{owner}, landmark `{name}`");
        let sigma_px = match file.sigma_px.unwrap_or(ClickSigma::Both(DEFAULT_CLICK_SIGMA_PX)) {
            ClickSigma::Both(both) => [both; 2],
            ClickSigma::Each(each) => each,
        };
        let world_sigma_m = file.world_sigma_m.unwrap_or(0.0);
        for sigma_px in sigma_px {
            self.within(&label, "sigma_px", sigma_px, 1e-3..=1e3)?;
        }
        self.within(&label, "world_sigma_m", world_sigma_m, 0.0..=10.0)?;
        for value in [world_m.x, world_m.y, world_m.z] {
            self.within(&label, "world_m", value, -1e4..=1e4)?;
        }
        let inside = |v: f64, size: u32, sigma_px: f64| {
            v >= -0.5 - 5.0 * sigma_px && v <= f64::from(size) - 0.5 + 5.0 * sigma_px
        };
        if !inside(x, size_px[0], sigma_px[0]) || !inside(y, size_px[1], sigma_px[1]) {
            let [w, h] = size_px;
            let reason = format!("{label}: pixel ({x}, {y}) lies outside the {w}×{h} image");
            return Err(self.at(at, reason));
        }
        Ok(Landmark {
            name: name.to_owned(),
            position: LandmarkPosition {
                world_m,
                world_sigma_m,
            },
            pixel: Pixel::new(x, y),
            sigma_px,
        })
    }

    fn distance(
        &self,
        file: &DistanceFile,
        cameras: &[CameraSetup],
    ) -> Result<DistanceMeasurement, ConfigError> {
        let at = file.between.span().start;
        let find = |name: &String| {
            let found = cameras
                .iter()
                .find(|c| c.id.as_str() == name)
                .map(|c| c.id.clone());
            found.ok_or_else(|| self.at(at, unknown_camera(name, cameras.iter().map(|c| c.id.as_str()))))
        };
        let [a, b] = file.between.get_ref();
        let between = (find(a)?, find(b)?);
        if between.0 == between.1 {
            return Err(self.at(at, format!("distance between `{a}` and itself")));
        }
        let sigma_m = file.sigma_m.unwrap_or(DEFAULT_POSITION_SIGMA_M);
        self.within("distance", "distance_m", file.distance_m, 1e-3..=1e4)?;
        self.within("distance", "sigma_m", sigma_m, 1e-5..=1e3)?;
        Ok(DistanceMeasurement {
            between,
            distance_m: file.distance_m,
            sigma_m,
        })
    }
}

/// Six figures: 0.00572 rather than 0.005719999999999999.
fn short(value: f64) -> String {
    format!("{value:.5e}").parse::<f64>().unwrap_or(value).to_string()
}

fn unknown_landmark(error: &crate::scene::UnknownLandmark) -> String {
    match nearest(&error.name, error.known.split(' ')) {
        Some(near) => format!("no landmark is called `{}`: did you mean `{near}`?", error.name),
        None => error.to_string(),
    }
}

fn unknown_camera<'a>(name: &str, known: impl Iterator<Item = &'a str> + Clone) -> String {
    match nearest(name, known.clone()) {
        Some(near) => format!("no camera is called `{name}`: did you mean `{near}`?"),
        None => format!(
            "no camera is called `{name}`; known: {}",
            known.collect::<Vec<_>>().join(", ")
        ),
    }
}

#[cfg(test)]
#[path = "rig_file_tests.rs"]
mod tests;
