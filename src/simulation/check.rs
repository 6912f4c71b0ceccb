//! Range checks of a scenario; every error names its key.

use super::error::SimulationError;
use super::scenario::{CameraSpec, Scenario};

fn within(key: &str, value: f64, low: f64, high: f64) -> Result<(), SimulationError> {
    // Also refuses NaN.
    if value >= low && value <= high {
        Ok(())
    } else {
        Err(SimulationError::value(
            key,
            format!("{value} is not within {low} … {high}"),
        ))
    }
}

impl Scenario {
    /// Checks ranges and contradictions; done by every way in.
    pub fn check(&self) -> Result<(), SimulationError> {
        if self.cameras.is_empty() {
            return Err(SimulationError::value("camera", "at least one is needed"));
        }
        for (i, camera) in self.cameras.iter().enumerate() {
            check_camera(camera, &format!("camera[{i}] ({})", camera.id))?;
            if self.cameras.iter().take(i).any(|c| c.id == camera.id) {
                return Err(SimulationError::value(
                    format!("camera[{i}].id"),
                    format!("{} is there twice", camera.id),
                ));
            }
        }
        if self.cameras.iter().filter(|c| c.reference).count() > 1 {
            return Err(SimulationError::value(
                "camera.reference",
                "only one camera can be the reference",
            ));
        }
        if let Some(camera) = self.cameras.get(self.reference())
            && (camera.total_delay_s() != 0.0 || camera.clock_skew_ppm != 0.0)
        {
            return Err(SimulationError::value(
                format!("camera ({}).capture_delay", camera.id),
                "the reference camera has no delay, offset or skew: it is the time scale",
            ));
        }
        self.check_products()
    }

    fn check_products(&self) -> Result<(), SimulationError> {
        let site = &self.site;
        within("site.gravity_mps2", site.gravity_mps2, 0.0, 30.0)?;
        within("site.air_density_kgpm3", site.air_density_kgpm3, 0.0, 2.0)?;
        for (i, pitch) in self.pitches.iter().enumerate() {
            if let Some(start) = pitch.start_s {
                within(&format!("pitch[{i}].start_s"), start, 0.5, 1e6)?;
            }
            if let Some(share) = pitch.active_spin {
                within(&format!("pitch[{i}].active_spin"), share, 0.0, 1.0)?;
            }
            if let Some(speed) = pitch.speed_mps {
                within(&format!("pitch[{i}].speed_mps"), speed, 1.0, 80.0)?;
            }
        }
        let detection = &self.detection;
        within("detection.sigma_px", detection.sigma_px, 0.0, 100.0)?;
        within("detection.quantisation_px", detection.quantisation_px, 0.0, 16.0)?;
        within("detection.miss_probability", detection.miss_probability, 0.0, 1.0)?;
        within(
            "detection.outlier_probability",
            detection.outlier_probability,
            0.0,
            1.0,
        )?;
        within("detection.outlier_range_px", detection.outlier_range_px, 0.0, 1e4)?;
        within("landmarks.sigma_px", self.landmarks.sigma_px, 0.0, 100.0)?;
        for name in self.landmarks.names.iter().flatten() {
            if let Err(unknown) = site.field.landmark(name) {
                return Err(SimulationError::value("landmarks.names", unknown.to_string()));
            }
        }
        self.render.check()
    }
}

impl super::options::RenderOptions {
    fn check(&self) -> Result<(), SimulationError> {
        let ranges = [
            ("render.lead_s", self.lead_s, 60.0),
            ("render.tail_s", self.tail_s, 60.0),
            ("render.idle_s", Some(self.idle_s), 3600.0),
            ("render.read_noise_dn", self.read_noise_dn, 50.0),
            ("render.flicker_amplitude", self.flicker_amplitude, 1.0),
            ("render.flicker_hz", self.flicker_hz, 1e4),
            ("render.crowd_flicker", self.crowd_flicker, 1.0),
            ("render.board_dn", self.board_dn, 255.0),
            ("render.occlusion", self.occlusion, 0.5),
            ("render.blur_sigma_px", self.blur_sigma_px, 5.0),
            ("render.white_dn", self.white_dn, 255.0),
            ("render.shading", self.shading, 1.0),
        ];
        for (key, value, high) in ranges {
            if let Some(value) = value {
                within(key, value, 0.0, high)?;
            }
        }
        match self.electrons_per_dn {
            Some(gain) => within("render.electrons_per_dn", gain, 1.0, 1e6),
            None => Ok(()),
        }
    }
}

fn check_camera(camera: &CameraSpec, key: &str) -> Result<(), SimulationError> {
    let of = |field: &str| format!("{key}.{field}");
    within(&of("width_px"), f64::from(camera.width_px), 16.0, 16384.0)?;
    within(&of("height_px"), f64::from(camera.height_px), 16.0, 16384.0)?;
    within(&of("frame_rate_hz"), camera.frame_rate_hz, 1.0, 10_000.0)?;
    within(
        &of("exposure_s"),
        camera.exposure_s,
        0.0,
        1.0 / camera.frame_rate_hz,
    )?;
    within(&of("intrinsics.fx_px"), camera.intrinsics.fx_px, 10.0, 1e6)?;
    within(&of("intrinsics.fy_px"), camera.intrinsics.fy_px, 10.0, 1e6)?;
    within(&of("clock_skew_ppm"), camera.clock_skew_ppm, -1e4, 1e4)?;
    within(&of("jitter_s"), camera.jitter_s, 0.0, 0.1)?;
    within(&of("drop_probability"), camera.drop_probability, 0.0, 0.99)?;
    within(
        &of("repeat_stamp_probability"),
        camera.repeat_stamp_probability,
        0.0,
        0.99,
    )?;
    within(&of("readout_s"), camera.readout_s, -0.1, 0.1)?;
    within(&of("capture_delay"), camera.total_delay_s(), -1e5, 1e5)?;
    let (c, l) = (camera.position_m, camera.look_at_m);
    let distance = (0..3).map(|i| (c[i] - l[i]).powi(2)).sum::<f64>().sqrt();
    within(&of("look_at_m (distance from position_m)"), distance, 0.1, 1e4)
}
