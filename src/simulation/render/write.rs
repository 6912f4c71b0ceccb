//! `DIR/frames/<camera>/NNNNNN.pgm` with `timestamps.csv` (`frame,timestamp_ns`), as `pitchd import` reads them.

use std::fmt::Write as _;
use std::fs;
use std::io::{BufWriter, Write};
use std::path::Path;

use super::CameraRenderer;
use crate::simulation::error::SimulationError;
use crate::simulation::write::{at, make_folder};

/// Renders and writes every frame of one camera; `progress` hears of each. Returns how many.
pub fn write_frames(
    folder: &Path,
    renderer: &mut CameraRenderer,
    mut progress: impl FnMut(),
) -> Result<usize, SimulationError> {
    let folder = folder.join("frames").join(renderer.camera().as_str());
    make_folder(&folder)?;
    let (width, height) = renderer.size_px();
    let mut pixels = vec![0u8; width as usize * height as usize];
    let mut stamps = String::from("frame,timestamp_ns\n");
    let mut count = 0;
    for exposure in renderer.exposures() {
        renderer.render(&exposure, &mut pixels);
        let path = folder.join(format!("{:06}.pgm", exposure.frame));
        let mut file = BufWriter::new(fs::File::create(&path).map_err(at(&path))?);
        let head = format!("P5\n{width} {height}\n255\n");
        file.write_all(head.as_bytes())
            .and_then(|()| file.write_all(&pixels))
            .and_then(|()| file.flush())
            .map_err(at(&path))?;
        // Writing to a String cannot fail.
        let _ = writeln!(stamps, "{},{}", exposure.frame, exposure.stamped.nanos());
        count += 1;
        progress();
    }
    let path = folder.join("timestamps.csv");
    fs::write(&path, stamps).map_err(at(&path))?;
    Ok(count)
}
