//! Whatever else a camera can do: features that the rig's owner sets by their GenICam names, before the camera streams.

use aravis::Camera;
use aravis::glib::prelude::ObjectExt;
use aravis::prelude::*;

use super::error::LiveError;
use super::options::LiveOptions;
use crate::scene::FeatureValue;

/// Sets the features asked for, in their order.
///
/// # Errors
/// The first that the camera has not, or refuses.
pub fn set(options: &LiveOptions, camera: &Camera) -> Result<(), LiveError> {
    for (feature, value) in &options.features {
        let refused = |reason: String| LiveError::Feature {
            camera: options.camera.clone(),
            feature: feature.clone(),
            value: value.to_string(),
            reason,
        };
        if !camera.is_feature_available(feature).unwrap_or(false) {
            return Err(refused("the camera has no such feature, or not now".to_owned()));
        }
        let device = camera.device();
        let is_command = device
            .as_ref()
            .and_then(|device| device.feature(feature))
            .is_some_and(|node| node.is::<aravis::GcCommand>());
        let set = match value {
            FeatureValue::Switch(true) if is_command => camera.execute_command(feature),
            FeatureValue::Switch(value) => camera.set_boolean(feature, *value),
            FeatureValue::Integer(value) => camera.set_integer(feature, *value),
            FeatureValue::Float(value) => camera.set_float(feature, *value),
            FeatureValue::Text(value) => camera.set_string(feature, value),
        };
        set.map_err(|error| refused(error.message().to_owned()))?;
    }
    Ok(())
}
