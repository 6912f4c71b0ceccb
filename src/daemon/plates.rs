//! Home plate as a landmark of every camera that sees it: what a still of the frames adds to a person's clicks.

use crate::calibration::resection::resect_camera;
use crate::detection::{SHIFT_MAX_PX, Still, StillPicture, plate_middle, plate_place, seek_plate};
use crate::geometry::Pose;
use crate::scene::{CameraId, CameraSetup, Landmark, LandmarkPosition, Motion, Rig};

/// Name of the landmark that is added: no person's.
const NAME: &str = "home_plate_seen";
/// Times that the plate is sought: the second time from the pose that the first gives.
const PASSES: usize = 2;

/// Gathers the still in which a camera's home plate will be sought; `None` where its clicks do not say where it is.
pub fn still_of(rig: &Rig, camera: &CameraId) -> Option<Still> {
    let setup = rig.camera(camera).filter(|_| rig.site.motion == Motion::Flight)?;
    let pose = pose_of(setup)?;
    plate_place(&setup.intrinsics, &pose, (setup.width_px, setup.height_px)).map(Still::new)
}

/// Adds home plate to a camera's landmarks, if a still of it shows the plate; what is then known, for people. One that was added
/// before goes: the newest still decides.
pub fn add_plate(rig: &mut Rig, camera: &CameraId, still: &StillPicture) -> Option<String> {
    let setup = rig.cameras.iter_mut().find(|setup| setup.id == *camera)?;
    setup.landmarks.retain(|landmark| landmark.name != NAME);
    let by_clicks = pose_of(setup)?.transform(&plate_middle());
    let by_clicks = setup.intrinsics.project(&by_clicks).ok()?;
    let mut with_plate = setup.clone();
    let mut found = None;
    for _ in 0..PASSES {
        let plate = seek_plate(still, &setup.intrinsics, &pose_of(&with_plate)?)?;
        with_plate.landmarks.clone_from(&setup.landmarks);
        with_plate.landmarks.push(Landmark {
            name: NAME.to_owned(),
            position: LandmarkPosition {
                world_m: plate_middle(),
                world_sigma_m: 0.0,
            },
            pixel: plate.middle,
            sigma_px: plate.sigma_px,
        });
        found = Some(plate);
    }
    let plate = found?;
    let off_px = (plate.middle.vector() - by_clicks.vector()).norm();
    // The pose with it must not leave it out as a wrong click.
    if off_px > SHIFT_MAX_PX || pose_of(&with_plate).is_none() {
        return None;
    }
    *setup = with_plate;
    let [x, y] = plate.sigma_px;
    Some(format!(
        "home plate seen {off_px:.2} px from where the clicks put it (± {x:.2}, {y:.2} px)"
    ))
}

/// The one pose that a camera's landmarks allow, if it holds the plate among them.
fn pose_of(setup: &CameraSetup) -> Option<Pose> {
    match resect_camera(setup).ok()?.as_slice() {
        [only] if !only.rejected.iter().any(|name| name == NAME) => Some(only.pose),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulation::{CameraRenderer, Scenario, simulate_tracks};

    const SCENARIO: &str = r#"
seed = 5
[landmarks]
sigma_px = 0.5
[render]
preset = "clean"
[[camera]]
id = "first"
width_px = 1000
height_px = 560
frame_rate_hz = 175.0
position_m = [20.1, 6.2, 3.3]
look_at_m = [0.0, 4.5, 0.9]
[camera.intrinsics]
fx_px = 1400.0
fy_px = 1400.0
cx_px = 500.0
cy_px = 280.0
distortion = [-0.08, 0.02, 0.0004, -0.0003, 0.0]
[[pitch]]
release_m = [-0.55, 16.6, 1.83]
speed_mps = 42.6
target_m = [0.1, 0.95]
"#;

    #[test]
    fn home_plate_is_a_better_landmark_than_a_click() {
        let scenario = Scenario::from_str(SCENARIO).unwrap();
        let simulated = simulate_tracks(&scenario).unwrap();
        let mut rig = simulated.rig;
        let camera = rig.cameras[0].id.clone();
        let mut still = still_of(&rig, &camera).unwrap();
        for frame in CameraRenderer::new(&scenario, 0).unwrap().frames().take(60) {
            if still.is_due() {
                still.take(&frame);
            }
        }
        let clicked = rig.cameras[0].landmarks.len();
        let told = add_plate(&mut rig, &camera, &still.picture().unwrap()).unwrap();
        assert!(told.contains("home plate seen"), "{told}");
        let setup = &rig.cameras[0];
        assert_eq!(setup.landmarks.len(), clicked + 1);
        let plate = setup.landmarks.last().unwrap();
        let truth = &simulated.truth.cameras[0];
        let seen = truth.camera_from_world.transform(&plate_middle());
        let off_px = plate.pixel.vector() - setup.intrinsics.project(&seen).unwrap().vector();
        assert!(
            off_px.norm() < 0.15 && plate.sigma_px.iter().all(|sigma| *sigma < 0.2),
            "{off_px:?} {plate:?}"
        );

        // It is written into rig.toml with its place in the world.
        let folder = tempfile::tempdir().unwrap();
        let file = crate::simulation::write_rig(folder.path(), &rig).unwrap();
        let read = crate::config::load_rig(&file).unwrap();
        let (written, read) = (plate, read.cameras[0].landmarks.last().unwrap());
        assert_eq!((&read.name, &read.position), (&written.name, &written.position));
        assert!((read.pixel.vector() - written.pixel.vector()).norm() < 1e-3);
        assert_eq!(read.sigma_px, written.sigma_px);

        // Again: one in its place, and a person's own of a like name stays.
        rig.cameras[0].landmarks[0].name = "home_plate".to_owned();
        add_plate(&mut rig, &camera, &still.picture().unwrap()).unwrap();
        assert_eq!(rig.cameras[0].landmarks.len(), clicked + 1);
        assert_eq!(rig.cameras[0].landmarks[0].name, "home_plate");

        // Ground without a plate adds nothing, and takes the one before away.
        let mut bare = still.picture().unwrap();
        bare.levels.fill(120.0);
        assert_eq!(add_plate(&mut rig, &camera, &bare), None);
        assert_eq!(rig.cameras[0].landmarks.len(), clicked);
    }
}
