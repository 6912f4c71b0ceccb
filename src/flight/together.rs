//! Whether the paths of two cameras may be of one pitched ball: a look at a few instants, before a flight is solved.

use nalgebra::{Point3, Vector2};

use super::sighting::CameraModel;
use crate::geometry::{Normalized, Pixel, Pose, triangulate_dlt};
use crate::scene::{Track, TrackPoint};

/// Both must have seen it for so long at the same time, seconds.
const OVERLAP_MIN_S: f64 = 0.03;
/// Shares of that time that are looked at: the begin may still be the hand's.
const INSTANTS: [f64; 3] = [0.4, 0.7, 1.0];
/// Rays of one ball pass each other no further than this in the picture, pixels: centres are drawn to the light.
const APART_MAX_PX: f64 = 6.0;
/// Where a pitch is between hand and glove, metres: aside, along, up.
const ASIDE_M: f64 = 3.0;
const ALONG_M: [f64; 2] = [-2.0, 19.5];
const HEIGHT_M: [f64; 2] = [-0.5, 4.5];
/// Its velocity toward the plate, and across, m/s: three instants tell it roughly.
const TOWARD_MPS: [f64; 2] = [10.0, 70.0];
const ACROSS_MAX_MPS: f64 = 15.0;

/// One camera's path by true time.
struct Seen<'a> {
    camera: &'a CameraModel,
    track: &'a Track,
    epoch_ns: i64,
}

impl Seen<'_> {
    fn time_s(&self, index: usize) -> Option<f64> {
        let point = self.track.points.get(index)?;
        let timing = self.camera.timing;
        Some(timing.true_seconds(point.stamped, point.pixel.y, self.epoch_ns))
    }

    fn span_s(&self) -> Option<(f64, f64)> {
        Some((
            self.time_s(0)?,
            self.time_s(self.track.points.len().checked_sub(1)?)?,
        ))
    }

    /// Where the ball is at a time within the span, on the line between two points.
    fn place(&self, t_s: f64) -> Option<Vector2<f64>> {
        let timing = self.camera.timing;
        let points = &self.track.points;
        let time_s = |p: &TrackPoint| timing.true_seconds(p.stamped, p.pixel.y, self.epoch_ns);
        let after = points
            .partition_point(|p| time_s(p) < t_s)
            .clamp(1, points.len().checked_sub(1)?);
        let (from, to) = (points.get(after - 1)?, points.get(after)?);
        let share = (t_s - time_s(from)) / (time_s(to) - time_s(from)).max(1e-9);
        let (from, to) = (from.pixel.vector(), to.pixel.vector());
        Some(from + (to - from) * share)
    }

    fn view(&self, place_px: Vector2<f64>) -> Option<(Pose, Normalized)> {
        let direction = self
            .camera
            .intrinsics
            .direction(Pixel::new(place_px.x, place_px.y));
        Some((self.camera.pose, direction.ok()?))
    }
}

/// Whether these two paths, in the home-plate frame of the cameras, may be of one ball on its way to the plate.
pub fn may_be_one_pitch(one: (&CameraModel, &Track), other: (&CameraModel, &Track)) -> bool {
    let Some(epoch_ns) = one.1.points.first().map(|p| p.stamped.nanos()) else {
        return false;
    };
    let seen = [one, other].map(|(camera, track)| Seen {
        camera,
        track,
        epoch_ns,
    });
    let ([Some(a), Some(b)], [first, second]) = ([seen[0].span_s(), seen[1].span_s()], &seen) else {
        return false;
    };
    let (begin_s, end_s) = (a.0.max(b.0), a.1.min(b.1));
    if end_s - begin_s < OVERLAP_MIN_S {
        return false;
    }
    let instants = INSTANTS.map(|share| begin_s + share * (end_s - begin_s));
    let places = instants.map(|t_s| ball_at(first, second, t_s));
    let [Some(from), Some(_), Some(to)] = places else {
        return false;
    };
    let velocity = (to - from) / (instants[2] - instants[0]);
    (TOWARD_MPS[0]..TOWARD_MPS[1]).contains(&-velocity.y) && velocity.x.hypot(velocity.z) < ACROSS_MAX_MPS
}

/// Where both see it at one time, if they see one thing, where a pitch may be.
fn ball_at(one: &Seen<'_>, other: &Seen<'_>, t_s: f64) -> Option<Point3<f64>> {
    let places = [one.place(t_s)?, other.place(t_s)?];
    let views = [one.view(places[0])?, other.view(places[1])?];
    let ball = triangulate_dlt(&views).ok()?;
    let in_view = |seen: &Seen<'_>, place: Vector2<f64>| {
        let camera = seen.camera;
        let pixel = camera.intrinsics.project(&camera.pose.transform(&ball));
        pixel.is_ok_and(|pixel| (pixel.vector() - place).norm() < APART_MAX_PX)
    };
    let plausible = ball.x.abs() < ASIDE_M
        && (ALONG_M[0]..ALONG_M[1]).contains(&ball.y)
        && (HEIGHT_M[0]..HEIGHT_M[1]).contains(&ball.z);
    (plausible && in_view(one, places[0]) && in_view(other, places[1])).then_some(ball)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flight::synthetic::{Spoil, observe, seeded, three_cameras, throw};

    /// A pitch in every camera, with centres as a first look has them.
    fn pitch(seed: u64, release_ns: i64) -> Vec<Track> {
        let mut random = seeded(seed);
        let flown = throw("slider", &mut random).fly();
        let spoil = Spoil {
            noise_px: 0.7,
            outliers: 0.0,
            misses: 0.1,
            jitter_s: 1e-4,
        };
        let cameras = three_cameras();
        let seen = cameras.iter();
        seen.map(|camera| observe(camera, &flown, release_ns, &spoil, &mut random))
            .collect()
    }

    #[test]
    fn a_pitch_is_one_from_its_first_sixty_milliseconds_and_other_things_are_not() {
        let cameras = three_cameras();
        for seed in 0..20 {
            let ball = pitch(seed, 1_000_000_000);
            let later = pitch(seed + 50, 1_700_000_000);
            for (a, b) in [(0, 1), (0, 2), (1, 2)] {
                for points in [12, 30, 60] {
                    let begin = |track: &Track| Track {
                        points: track.points.iter().take(points).copied().collect(),
                        ..track.clone()
                    };
                    let are_one =
                        |one: &Track, two: &Track| may_be_one_pitch((&cameras[a], one), (&cameras[b], two));
                    let (one, two) = (begin(&ball[a]), begin(&ball[b]));
                    let case = format!("seed {seed}, cameras {a} {b}, {points} points");
                    assert!(are_one(&one, &two), "{case}");
                    assert!(!are_one(&one, &begin(&later[b])), "{case}: of two times");
                    assert!(!are_one(&back(&one), &back(&two)), "{case}: thrown back");
                    let mut above = two.clone();
                    for point in &mut above.points {
                        point.pixel.y -= 60.0;
                    }
                    assert!(!are_one(&one, &above), "{case}: two things");
                }
            }
        }
    }

    /// The same way in the other sense.
    fn back(track: &Track) -> Track {
        let mut back = track.clone();
        for (point, seen) in back.points.iter_mut().zip(track.points.iter().rev()) {
            point.pixel = seen.pixel;
        }
        back
    }
}
