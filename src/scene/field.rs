//! Landmarks of a baseball field by name (domain §1), metres in the home-plate frame.

use nalgebra::Point3;
use serde::{Deserialize, Serialize};

/// A field of standard size.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FieldPreset {
    /// 90 ft bases, 60.5 ft to the rubber; also college and high school.
    #[default]
    #[serde(alias = "college", alias = "high_school")]
    Professional,
    /// Youth, 80 ft bases, 54 ft to the rubber.
    #[serde(rename = "youth_80_54", alias = "youth_80")]
    Youth80,
    /// Youth, 70 ft bases, 48 ft to the rubber.
    #[serde(rename = "youth_70_48", alias = "youth_70")]
    Youth70,
    /// Youth, 60 ft bases, 46 ft to the rubber.
    #[serde(rename = "youth_60_46", alias = "youth_60")]
    Youth60,
}

/// A name that is no landmark of the field.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("no landmark is called {name:?}; known: {known}")]
pub struct UnknownLandmark {
    /// The name asked for.
    pub name: String,
    /// All names, separated by spaces.
    pub known: String,
}

const FOOT: f64 = 0.3048;
const INCH: f64 = 0.0254;
/// Length of a base path to the apex of first base over the foot mark of 90 ft in x and y (domain §1:
/// 19.397 m is 90 ft · cos 45°).
const HALF_SQRT2: f64 = std::f64::consts::FRAC_1_SQRT_2;

impl FieldPreset {
    fn feet(self) -> (f64, f64, f64) {
        // base path, plate tip to front of rubber (ft), height of the rubber (in)
        match self {
            Self::Professional => (90.0, 60.5, 10.0),
            Self::Youth80 => (80.0, 54.0, 8.0),
            Self::Youth70 => (70.0, 48.0, 6.0),
            Self::Youth60 => (60.0, 46.0, 6.0),
        }
    }

    /// Every landmark: name and position in metres. left = −x, as the catcher sees.
    pub fn landmarks(self) -> Vec<(String, Point3<f64>)> {
        let (path_ft, rubber_ft, rubber_in) = self.feet();
        let (rubber_y, rubber_z) = (rubber_ft * FOOT, rubber_in * INCH);
        let base = path_ft * FOOT * HALF_SQRT2;
        let half_plate = 8.5 * INCH;
        let mut all = vec![
            ("plate_tip".to_owned(), Point3::origin()),
            ("first_base".to_owned(), Point3::new(base, base, 0.0)),
            ("third_base".to_owned(), Point3::new(-base, base, 0.0)),
            ("second_base".to_owned(), Point3::new(0.0, 2.0 * base, 0.0)),
            // 18 in. in front of the rubber's front edge is the mound circle's centre (59 ft from the tip).
            (
                "mound_center".to_owned(),
                Point3::new(0.0, rubber_y - 18.0 * INCH, rubber_z),
            ),
        ];
        for (side, sign) in [("left", -1.0), ("right", 1.0)] {
            let mut add =
                |name: String, x: f64, y: f64, z: f64| all.push((name, Point3::new(sign * x, y, z)));
            add(format!("plate_{side}"), half_plate, 8.5 * INCH, 0.0);
            add(format!("plate_front_{side}"), half_plate, 17.0 * INCH, 0.0);
            add(format!("rubber_front_{side}"), 12.0 * INCH, rubber_y, rubber_z);
            add(
                format!("rubber_back_{side}"),
                12.0 * INCH,
                rubber_y + 6.0 * INCH,
                rubber_z,
            );
            for (end, y) in [("front", 1.1303), ("back", -0.6985)] {
                add(format!("box_{side}_{end}_inner"), 0.3683, y, 0.0);
                add(format!("box_{side}_{end}_outer"), 1.5875, y, 0.0);
            }
        }
        all
    }

    /// Position of a landmark by name, metres.
    pub fn landmark(self, name: &str) -> Result<Point3<f64>, UnknownLandmark> {
        let all = self.landmarks();
        all.iter()
            .find(|(known, _)| known == name)
            .map(|(_, p)| *p)
            .ok_or_else(|| UnknownLandmark {
                name: name.to_owned(),
                known: all.iter().map(|(n, _)| n.as_str()).collect::<Vec<_>>().join(" "),
            })
    }
}
