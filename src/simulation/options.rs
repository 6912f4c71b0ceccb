//! Noise, clicks, clutter and picture options of a scenario.

use serde::Deserialize;

/// What a 2-D detector adds to the true centres (`simulate_tracks` only).
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DetectionNoise {
    /// Gaussian 1σ per axis, pixels.
    pub sigma_px: f64,
    /// Centres are rounded to multiples of this, pixels; 0: not at all.
    pub quantisation_px: f64,
    /// Chance that a visible ball is missed.
    pub miss_probability: f64,
    /// Chance that a point is false.
    pub outlier_probability: f64,
    /// A false point lies within this distance of the true one per axis, pixels.
    pub outlier_range_px: f64,
    /// Does the track file say its sigma?
    pub report_sigma: bool,
}

impl Default for DetectionNoise {
    fn default() -> Self {
        Self {
            sigma_px: 0.3,
            quantisation_px: 0.0,
            miss_probability: 0.0,
            outlier_probability: 0.0,
            outlier_range_px: 30.0,
            report_sigma: true,
        }
    }
}

impl DetectionNoise {
    /// Gaussian noise alone.
    pub fn gaussian(sigma_px: f64) -> Self {
        Self {
            sigma_px,
            ..Self::default()
        }
    }
}

/// Landmarks as a person would click them.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LandmarkClicks {
    /// Preset names; none: every one of the field's. Only those in view are clicked.
    pub names: Option<Vec<String>>,
    /// Gaussian 1σ per axis, pixels.
    pub sigma_px: f64,
}

impl Default for LandmarkClicks {
    fn default() -> Self {
        Self {
            names: None,
            sigma_px: 0.5,
        }
    }
}

impl LandmarkClicks {
    /// A rig without landmarks.
    pub fn none() -> Self {
        Self {
            names: Some(Vec::new()),
            ..Self::default()
        }
    }
}

/// False tracks (`simulate_tracks` only).
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ClutterSpec {
    /// False tracks per camera around every pitch: things that cross the picture on a gentle curve.
    pub tracks_per_pitch: usize,
}

/// Ready-made looks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Preset {
    /// Day game: steady light, still crowd, quiet boards.
    #[default]
    Clean,
    /// Crowd flicker, a board nearly as bright as the ball, shadow near the plate, wires, 120 Hz lamps.
    Hard,
}

/// Pictures.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RenderOptions {
    /// Look; the keys below override it one by one.
    pub preset: Preset,
    /// Rendered before each release, seconds (0.3).
    pub lead_s: Option<f64>,
    /// Rendered after the ball has passed the plate, seconds (0.3).
    pub tail_s: Option<f64>,
    /// Render everything from the first lead to the last tail, not only windows around the pitches.
    pub continuous: bool,
    /// Idle play rendered after the last ball, seconds.
    pub idle_s: f64,
    /// Read noise 1σ, grey levels (1.2).
    pub read_noise_dn: Option<f64>,
    /// Photo-electrons per grey level, for the shot noise (40).
    pub electrons_per_dn: Option<f64>,
    /// Lamp flicker, relative amplitude (0; hard 0.03).
    pub flicker_amplitude: Option<f64>,
    /// Lamp flicker frequency, Hz (120).
    pub flicker_hz: Option<f64>,
    /// Share of crowd cells that change each frame, relative brightness amplitude (0; hard 0.15).
    pub crowd_flicker: Option<f64>,
    /// Grey level of the bright advertising board; 0: none (0; hard 205).
    pub board_dn: Option<f64>,
    /// A shadow edge near the plate.
    pub shadow: Option<bool>,
    /// Share of the flight hidden behind wires and poles (0; hard 0.04).
    pub occlusion: Option<f64>,
    /// Lens blur 1σ, pixels (0.5).
    pub blur_sigma_px: Option<f64>,
    /// Grey level of a white surface in full light (230).
    pub white_dn: Option<f64>,
    /// Lambert shading of the ball from above: 0 flat, 1 full (1).
    pub shading: Option<f64>,
    /// Birds and blown paper that cross the picture (0; hard 4).
    pub birds: Option<usize>,
    /// Flags in the wind (0).
    pub flags: usize,
    /// Drops of rain in the picture (0).
    pub rain: usize,
    /// Between pitches: throws without a ball, swings at nothing, people who walk and run, balls that roll.
    pub idle_play: bool,
    /// Pitcher, batter, catcher and umpire.
    pub people: Option<bool>,
}
