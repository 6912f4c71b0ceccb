//! What a flight must be to be a pitch: from the mound, past the plate, and seen for a part of that way.
//!
//! The bounds are wide: what any arm throws at any batter lies within, a throw from second base, a ball that rolls and an
//! arm that looked like a ball in two cameras mostly do not.

use super::numbers::{NumbersError, PlaneState};
use super::outcome::SolvedFlight;

/// Farthest to the side of a release, and its lowest and highest z, metres: a submarine arm, and a tall one's on the mound.
const RELEASE_X_M: f64 = 2.5;
const RELEASE_Z_M: [f64; 2] = [0.2, 3.0];
/// Farthest to the side of the plate, and lowest and highest z there, metres: wild pitches are pitches.
const PLATE_X_M: f64 = 2.5;
const PLATE_Z_M: [f64; 2] = [-0.6, 4.0];
/// A ball that is seen in flight this far behind where release is stated was thrown from elsewhere, metres.
const BEHIND_M: f64 = 4.0;
/// Shortest part of the way along y that was seen, metres.
const SEEN_MIN_M: f64 = 2.0;
/// The bounds are left by at least so many sigmas.
const SIGMAS: f64 = 3.0;

/// Tells what a flight from these states lacks to be a pitch.
///
/// # Errors
/// [`NumbersError`] with the number that no pitch has.
pub fn check_pitch(
    flight: &SolvedFlight,
    release: (f64, &PlaneState),
    front: &PlaneState,
) -> Result<(), NumbersError> {
    let (release_y_m, release) = release;
    within(release, release_y_m, (RELEASE_X_M, RELEASE_Z_M), "from the mound")?;
    let plate_y_m = front.position_m.y;
    within(front, plate_y_m, (PLATE_X_M, PLATE_Z_M), "at the plate")?;
    let path = &flight.trajectory;
    let (first, last) = flight.observed_s;
    let (first_y_m, last_y_m) = (path.position_m(first).y, path.position_m(last).y);
    if first_y_m > release_y_m + BEHIND_M {
        return Err(NumbersError::FromBehindTheMound { y_m: first_y_m });
    }
    let seen_m = first_y_m - last_y_m;
    if seen_m < SEEN_MIN_M {
        return Err(NumbersError::BarelySeen { seen_m });
    }
    Ok(())
}

/// Whether a state may lie within |x| and z.
fn within(
    state: &PlaneState,
    y_m: f64,
    (x_max, [z_min, z_max]): (f64, [f64; 2]),
    what: &'static str,
) -> Result<(), NumbersError> {
    let (x, z) = (state.position_m.x, state.position_m.z);
    let (x_off, z_off) = (x.abs() - x_max, (z_min - z).max(z - z_max));
    if x_off > SIGMAS * state.sigma(0) || z_off > SIGMAS * state.sigma(2) {
        return Err(NumbersError::OutOfTheWay {
            what,
            y_m,
            x_m: x,
            z_m: z,
        });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{SMatrix, Vector3};

    fn at(x_m: f64, z_m: f64, sigma_m: f64) -> PlaneState {
        PlaneState {
            time_s: 0.0,
            position_m: Vector3::new(x_m, 16.6, z_m),
            velocity_mps: Vector3::new(0.0, -38.0, -1.0),
            speed_mps: 38.0,
            covariance: SMatrix::identity() * sigma_m * sigma_m,
        }
    }

    #[test]
    fn submarine_arms_pass_and_rolling_balls_do_not() {
        let passes = |state: PlaneState| within(&state, 16.6, (RELEASE_X_M, RELEASE_Z_M), "here").is_ok();
        for (x_m, z_m) in [(-1.4, 0.5), (0.6, 2.2), (1.1, 1.2)] {
            assert!(passes(at(x_m, z_m, 0.01)), "{x_m} {z_m}");
        }
        for (x_m, z_m) in [(0.0, 0.04), (4.0, 1.8), (0.3, 3.4)] {
            assert!(!passes(at(x_m, z_m, 0.01)), "{x_m} {z_m}");
            // What is known to half a metre may have been a pitch.
            assert!(passes(at(x_m, z_m, 0.6)), "{x_m} {z_m}");
        }
    }
}
