//! The look of the pictures: a preset with single values overridden.

use crate::simulation::options::{Preset, RenderOptions};

/// Every value the renderer needs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Look {
    pub lead_s: f64,
    pub tail_s: f64,
    pub read_noise_dn: f32,
    pub electrons_per_dn: f32,
    pub flicker_amplitude: f64,
    pub flicker_hz: f64,
    pub crowd_flicker: f32,
    pub board_dn: f32,
    pub shadow: bool,
    pub occlusion: f64,
    pub blur_sigma_px: f64,
    pub white_dn: f32,
    pub shading: f32,
    pub people: bool,
    pub batter_y_m: f64,
    pub birds: usize,
    pub flags: usize,
    pub rain: usize,
    pub idle_play: bool,
}

impl Look {
    pub(super) fn of(options: &RenderOptions) -> Self {
        let base = match options.preset {
            Preset::Clean => CLEAN,
            Preset::Hard => HARD,
        };
        let single = |value: Option<f64>, other: f32| value.map_or(other, |v| v as f32);
        Self {
            lead_s: options.lead_s.unwrap_or(base.lead_s),
            tail_s: options.tail_s.unwrap_or(base.tail_s),
            read_noise_dn: single(options.read_noise_dn, base.read_noise_dn),
            electrons_per_dn: single(options.electrons_per_dn, base.electrons_per_dn),
            flicker_amplitude: options.flicker_amplitude.unwrap_or(base.flicker_amplitude),
            flicker_hz: options.flicker_hz.unwrap_or(base.flicker_hz),
            crowd_flicker: single(options.crowd_flicker, base.crowd_flicker),
            board_dn: single(options.board_dn, base.board_dn),
            shadow: options.shadow.unwrap_or(base.shadow),
            occlusion: options.occlusion.unwrap_or(base.occlusion),
            blur_sigma_px: options.blur_sigma_px.unwrap_or(base.blur_sigma_px),
            white_dn: single(options.white_dn, base.white_dn),
            shading: single(options.shading, base.shading),
            people: options.people.unwrap_or(base.people),
            batter_y_m: base.batter_y_m,
            birds: options.birds.unwrap_or(base.birds),
            flags: options.flags,
            rain: options.rain,
            idle_play: options.idle_play,
        }
    }
}

const CLEAN: Look = Look {
    lead_s: 0.3,
    tail_s: 0.3,
    read_noise_dn: 1.2,
    electrons_per_dn: 40.0,
    flicker_amplitude: 0.0,
    flicker_hz: 120.0,
    crowd_flicker: 0.0,
    board_dn: 0.0,
    shadow: false,
    occlusion: 0.0,
    blur_sigma_px: 0.5,
    white_dn: 230.0,
    shading: 1.0,
    people: true,
    batter_y_m: -0.15,
    birds: 0,
    flags: 0,
    rain: 0,
    idle_play: false,
};

const HARD: Look = Look {
    read_noise_dn: 1.8,
    electrons_per_dn: 25.0,
    flicker_amplitude: 0.03,
    crowd_flicker: 0.15,
    board_dn: 205.0,
    shadow: true,
    occlusion: 0.04,
    batter_y_m: 0.25,
    birds: 4,
    ..CLEAN
};
