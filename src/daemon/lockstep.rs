//! Cameras of a recording side by side in time: as live ones do they tell each other of a ball in flight, and none is ahead
//! of the others. Which thread runs when decides nothing.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

use super::sky::{flight_in_sky, flights_of, foreseen_paths};
use crate::eye::CameraEye;
use crate::scene::{Calibration, CameraId, ForeseenPath, Rig, Track};
use crate::time::{CameraTiming, StampedMidpoint};
use crate::tracking::TrackerConfig;

/// Cameras meet this often, nanoseconds of true time: as often as a ball in flight is estimated live.
const MEETING_NS: i64 = 10_000_000;

/// Where the cameras of one recording meet.
pub struct Lockstep<'a> {
    rig: &'a Rig,
    calibration: &'a Calibration,
    state: Mutex<State>,
    opened: Condvar,
}

struct State {
    /// The meeting before which all frames have been searched that will be.
    open: i64,
    places: Vec<Place>,
}

/// What one camera has brought, and what it will be told.
struct Place {
    camera: CameraId,
    /// The meeting of its next frame; `None` before its first frame, `i64::MAX` after its last.
    next: Option<i64>,
    flights: Vec<Track>,
    foreseen: Option<ForeseenPath>,
}

/// One camera's seat; giving it up lets the others go on.
pub struct Seat<'a> {
    meeting: &'a Lockstep<'a>,
    index: usize,
    camera: CameraId,
    timing: CameraTiming,
    config: TrackerConfig,
    at: i64,
}

impl<'a> Lockstep<'a> {
    /// For these cameras; those that the calibration lacks go alone.
    pub fn new(rig: &'a Rig, calibration: &'a Calibration, cameras: &[CameraId]) -> Self {
        let known = cameras.iter().filter(|id| calibration.camera(id).is_some());
        let places = known.map(|camera| Place {
            camera: camera.clone(),
            next: None,
            flights: Vec::new(),
            foreseen: None,
        });
        Self {
            rig,
            calibration,
            state: Mutex::new(State {
                open: i64::MIN,
                places: places.collect(),
            }),
            opened: Condvar::new(),
        }
    }

    /// This camera's seat.
    pub fn seat(&'a self, camera: &CameraId, config: &TrackerConfig) -> Option<Seat<'a>> {
        let index = self
            .lock()
            .places
            .iter()
            .position(|place| place.camera == *camera)?;
        Some(Seat {
            meeting: self,
            index,
            camera: camera.clone(),
            timing: self.calibration.camera(camera)?.timing(),
            config: config.clone(),
            at: i64::MIN,
        })
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Once every camera is here: estimates the flight, and opens the next meeting's frames.
    fn open_if_all_are_here(&self, state: &mut State) {
        let Some(next) = state.places.iter().map(|place| place.next).min().flatten() else {
            return;
        };
        if next <= state.open {
            return;
        }
        let flights: Vec<&Track> = state.places.iter().flat_map(|place| &place.flights).collect();
        if let Some(flight) = flight_in_sky(self.rig, self.calibration, &flights) {
            let mut foreseen = foreseen_paths(self.calibration, &flight);
            for place in &mut state.places {
                place.foreseen = foreseen.remove(&place.camera);
            }
        }
        state.open = next;
        self.opened.notify_all();
    }
}

impl Seat<'_> {
    /// Before a frame with this stamp is searched: waits until no camera is behind, and tells the eye what all see.
    pub fn before(&mut self, stamped: StampedMidpoint, eye: &mut CameraEye) {
        let middle_px = 0.5 * f64::from(self.timing.height_px);
        let next = self
            .timing
            .true_midpoint(stamped, middle_px)
            .nanos()
            .div_euclid(MEETING_NS);
        if next <= self.at {
            return;
        }
        self.at = next;
        let (open, off_light_px) = eye.open();
        // A curve for every point: not while others wait for the lock.
        let flights = flights_of(&open, off_light_px, (&self.camera, &self.config));
        let mut state = self.meeting.lock();
        if let Some(place) = state.places.get_mut(self.index) {
            place.flights = flights;
            place.next = Some(next);
        }
        self.meeting.open_if_all_are_here(&mut state);
        while state.open < next {
            state = self
                .meeting
                .opened
                .wait(state)
                .unwrap_or_else(PoisonError::into_inner);
        }
        let place = state.places.get_mut(self.index);
        if let Some(path) = place.and_then(|place| place.foreseen.take()) {
            eye.foresee(path);
        }
    }
}

impl Drop for Seat<'_> {
    fn drop(&mut self) {
        let mut state = self.meeting.lock();
        if let Some(place) = state.places.get_mut(self.index) {
            place.flights.clear();
            place.next = Some(i64::MAX);
        }
        self.meeting.open_if_all_are_here(&mut state);
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;

    use super::*;
    use crate::detection::painter::{Ball, Canvas};
    use crate::eye::EyeConfig;
    use crate::flight::sighting::CameraModel;
    use crate::flight::synthetic::{Flown, calibrated, camera, seeded, throw};
    use crate::geometry::Pixel;
    use crate::scene::{BALL_RADIUS_M, CameraCalibration, FieldPreset, Frame, Motion, Site};

    const SIZE_PX: (u32, u32) = (1024, 256);
    const FIRST_STAMP_NS: i64 = 1_000_000_000;
    const RELEASE_S: f64 = 0.1;
    const EXPOSURE_S: f64 = 0.001;

    /// Two cameras on one side and one on the other, cut to the middle of the flight.
    fn cameras() -> Vec<CameraModel> {
        let mut cameras = vec![
            camera("first", [20.0, 6.0, 3.0], [0.0, 9.0, 1.2], 0.0),
            camera("third", [-20.0, 7.0, 3.2], [0.0, 9.0, 1.2], 0.0041),
            camera("weak", [19.0, 11.0, 4.0], [0.0, 9.0, 1.2], -0.0067),
        ];
        for camera in &mut cameras {
            (camera.intrinsics.cx_px, camera.intrinsics.cy_px) = (513.0, 125.0);
        }
        cameras
    }

    fn calibration(cameras: &[CameraModel]) -> Calibration {
        let one = |c: &CameraModel| CameraCalibration {
            capture_delay_sigma_s: 2e-5,
            width_px: SIZE_PX.0,
            height_px: SIZE_PX.1,
            reprojection_rms_px: 0.1,
            noise_sigma_px: 0.1,
            ..calibrated(c)
        };
        Calibration::without_covariance(cameras.iter().map(one).collect())
    }

    /// Where a camera sees the ball this long after its first stamp, and its radius, pixels.
    fn seen(camera: &CameraModel, flown: &Flown, after_s: f64) -> Option<(Pixel, f64)> {
        let t_s = after_s - camera.timing.capture_delay_s - RELEASE_S;
        let flies = (0.0..flown.duration_s()).contains(&t_s);
        let ball = camera.pose.transform(&flown.position_m(t_s.max(0.0)));
        let pixel = camera.intrinsics.project(&ball).ok().filter(|_| flies)?;
        Some((pixel, 1790.0 * BALL_RADIUS_M / ball.z))
    }

    /// A camera's frames of a pitch that is so much brighter than what is behind it, in shade and in full light.
    fn frames(camera: &CameraModel, flown: &Flown, contrast: [f64; 2]) -> Vec<Frame> {
        let (width, height) = (SIZE_PX.0 as usize, SIZE_PX.1 as usize);
        let still = Canvas {
            width,
            height,
            light: (0..width * height)
                .map(|i| 50.0 + 0.01 * (i % width) as f32)
                .collect(),
        };
        let frame = |number: u64| {
            let mut canvas = still.clone();
            let at = |share: f64| seen(camera, flown, number as f64 / 175.0 + share * EXPOSURE_S);
            if let (Some((centre, radius)), Some((from, _)), Some((to, _))) = (at(0.0), at(-0.5), at(0.5)) {
                let streak: Vector2<f64> = to.vector() - from.vector();
                canvas.ball(&Ball {
                    centre: [centre.x, centre.y],
                    streak: [streak.x, streak.y],
                    radius,
                    shade: 55.0 + contrast[0],
                    light: 55.0 + contrast[1],
                    to_light: [0.1, -0.9, -0.4],
                });
            }
            canvas.frame(number, 175.0, 1.5)
        };
        (0..90).map(frame).collect()
    }

    /// The pitches that every camera finds in its frames, alone or with the others.
    fn tracks(frames: &[Vec<Frame>], cameras: &[CameraModel], together: bool) -> Vec<Vec<Track>> {
        let site = Site {
            name: String::new(),
            field: FieldPreset::Professional,
            motion: Motion::Flight,
            gravity_mps2: 9.80665,
            air_density_kgpm3: 1.2,
        };
        let rig = Rig {
            site,
            reference: 0,
            cameras: Vec::new(),
            distances: Vec::new(),
        };
        let calibration = calibration(cameras);
        let ids: Vec<CameraId> = cameras.iter().map(|c| c.id.clone()).collect();
        let lockstep = Lockstep::new(&rig, &calibration, &ids);
        std::thread::scope(|scope| {
            let threads: Vec<_> = cameras
                .iter()
                .zip(frames)
                .map(|(camera, frames)| {
                    let mut config = EyeConfig::default();
                    config.detector.exposure_s = Some(EXPOSURE_S);
                    config.detector.lens = Some(camera.intrinsics);
                    let mut seat = lockstep.seat(&camera.id, &config.tracker).filter(|_| together);
                    let mut eye = CameraEye::new(camera.id.clone(), config, SIZE_PX.0, SIZE_PX.1);
                    scope.spawn(move || {
                        for frame in frames {
                            if let Some(seat) = &mut seat {
                                seat.before(frame.stamp.stamped, &mut eye);
                            }
                            eye.push(frame).unwrap();
                        }
                        drop(seat);
                        eye.finish();
                        eye.drain_pitches()
                    })
                })
                .collect();
            threads.into_iter().map(|t| t.join().unwrap()).collect()
        })
    }

    #[test]
    fn two_cameras_tell_the_third_where_the_ball_is() {
        let cameras = cameras();
        let flown = throw("slider", &mut seeded(5)).fly();
        let contrasts = [[10.0, 140.0], [10.0, 140.0], [1.0, 8.0]];
        let frames: Vec<Vec<Frame>> = cameras
            .iter()
            .zip(contrasts)
            .map(|(camera, contrast)| frames(camera, &flown, contrast))
            .collect();
        let alone = tracks(&frames, &cameras, false);
        let told = tracks(&frames, &cameras, true);
        let points =
            |of: &[Vec<Track>], index: usize| -> usize { of[index].iter().map(|t| t.points.len()).sum() };
        println!(
            "points alone {:?}, told {:?}",
            [0, 1, 2].map(|i| points(&alone, i)),
            [0, 1, 2].map(|i| points(&told, i))
        );
        assert!(points(&alone, 0) > 40 && points(&alone, 1) > 40);
        for (alone, told) in alone[..2].iter().zip(&told) {
            assert_eq!((alone.len(), told.len()), (1, 1));
            for (a, b) in alone[0].points.iter().zip(&told[0].points) {
                let apart_px = (a.pixel.vector() - b.pixel.vector()).norm();
                assert!(
                    a.frame == b.frame && apart_px < 0.02,
                    "{apart_px} px: it needs no help"
                );
            }
        }
        assert!(points(&alone, 2) < 10 && told[2].len() == 1);
        let track = &told[2][0];
        let squares = track.points.iter().map(|p| {
            let (truth, _) = seen(&cameras[2], &flown, p.stamped.seconds_since(FIRST_STAMP_NS)).unwrap();
            (p.pixel.vector() - truth.vector()).norm_squared()
        });
        let rms_px = (squares.sum::<f64>() / track.points.len() as f64).sqrt();
        println!("{} points, {rms_px:.2} px", track.points.len());
        assert!(track.points.len() >= 30 && rms_px < 0.4);
        // Which thread runs when decides nothing.
        assert!(told == tracks(&frames, &cameras, true), "another time otherwise");
    }

    #[test]
    fn a_camera_without_frames_stops_no_other() {
        let cameras = cameras();
        let flown = throw("slider", &mut seeded(5)).fly();
        let mut frames: Vec<Vec<Frame>> = cameras.iter().map(|c| frames(c, &flown, [10.0, 140.0])).collect();
        frames[2].clear();
        frames[1].truncate(40);
        let found = tracks(&frames, &cameras, true);
        assert_eq!(found[0].len(), 1);
    }
}
