//! A rig file as one text that needs no file beside it, for keeping in a recording.

use std::path::Path;

use super::ConfigError;

/// The text of a rig file with the lens files it names put in their places. A rig file that names none comes
/// back as it is, comments and all.
///
/// # Errors
/// A file cannot be read or is no TOML.
pub fn portable_rig(path: &Path) -> Result<String, ConfigError> {
    let text = read(path)?;
    let mut rig: toml::Table = toml::from_str(&text).map_err(|e| ConfigError::from_toml(path, &text, &e))?;
    let cameras = rig.get_mut("camera").and_then(toml::Value::as_array_mut);
    let mut changed = false;
    for camera in cameras
        .into_iter()
        .flatten()
        .filter_map(toml::Value::as_table_mut)
    {
        if let Some(toml::Value::String(name)) = camera.get("intrinsics") {
            let lens_path = path.parent().unwrap_or(Path::new(".")).join(name);
            let lens_text = read(&lens_path)?;
            let lens: toml::Table =
                toml::from_str(&lens_text).map_err(|e| ConfigError::from_toml(&lens_path, &lens_text, &e))?;
            camera.insert("intrinsics".to_owned(), toml::Value::Table(lens));
            changed = true;
        }
    }
    Ok(if changed { rig.to_string() } else { text })
}

fn read(path: &Path) -> Result<String, ConfigError> {
    std::fs::read_to_string(path).map_err(|source| ConfigError::Unreadable {
        path: path.to_owned(),
        source,
    })
}

#[cfg(test)]
mod tests {
    use super::super::{load_rig, parse_rig};
    use super::*;

    #[test]
    fn a_lens_file_is_put_in_its_place() {
        let folder = tempfile::tempdir().unwrap();
        let rig = folder.path().join("rig.toml");
        let head = "[site]\nname = \"x\" # kept\n[[camera]]\nid = \"a\"\nwidth_px = 640\nheight_px = 480\nframe_rate_hz = 100.0\n";
        let lens = "fx_px = 500.0\nfy_px = 501.0\ncx_px = 320.0\ncy_px = 240.0\ndistortion = [0.0, 0.1, 0.0, 0.0, 0.0]\n";
        std::fs::write(folder.path().join("lens.toml"), lens).unwrap();
        std::fs::write(&rig, format!("{head}intrinsics = \"lens.toml\"\n")).unwrap();
        let wanted = load_rig(&rig).unwrap();
        let text = portable_rig(&rig).unwrap();
        assert_eq!(parse_rig(Path::new("/nowhere/rig.toml"), &text).unwrap(), wanted);
        std::fs::write(&rig, format!("{head}[camera.intrinsics]\n{lens}")).unwrap();
        assert_eq!(
            portable_rig(&rig).unwrap(),
            std::fs::read_to_string(&rig).unwrap()
        );
    }
}
