//! What goes on between pitches: the pitcher throws without a ball, the batter swings at nothing, people walk, jog and
//! run, balls roll over the grass. None of it is a pitch.
//!
//! Everything follows from the true time alone, the same for every camera.

use nalgebra::{Point3, Vector3};
use rand::Rng;
use rand_pcg::Pcg64Mcg;

use super::limb::Limb;
use super::people::{Play, limb, mix};
use crate::scene::BALL_RADIUS_M;

/// Practice begins this long after a pitch and ends this long before the next, seconds.
const AFTER_S: f64 = 7.0;
const BEFORE_S: f64 = 4.0;
/// A dry throw and a swing at nothing begin anew after so long, seconds.
const THROW_PERIOD_S: f64 = 9.0;
const SWING_PERIOD_S: f64 = 5.2;
/// A dry throw is this much slower than a pitch.
const THROW_PACE: f64 = 0.75;
/// A batter at practice: seconds into the turn, and where his swing then stands against a pitch's arrival at the plate.
const SWING: [(f64, f64); 6] = [
    (0.0, -0.9),
    (1.0, -0.2),
    (1.4, 0.2),
    (2.2, 0.2),
    (3.2, -0.2),
    (SWING_PERIOD_S, -0.9),
];
/// Walkers, joggers and runners: how many, at which speed (m/s), with which step (m), on which ground.
const GAITS: [(usize, f64, f64, Ground); 5] = [
    (2, 1.4, 0.7, OUTSIDE),
    (2, 3.2, 1.1, OUTSIDE),
    (1, 7.5, 1.9, OUTSIDE),
    (1, 1.2, 0.7, BEHIND),
    (3, 1.4, 0.7, LANE),
];
/// x and y of two corners, metres.
type Ground = [[f64; 2]; 2];
/// Beyond the mound, behind the umpire, and where pitches fly: nobody is there during a pitch.
const OUTSIDE: Ground = [[-17.0, 21.0], [17.0, 36.0]];
const BEHIND: Ground = [[-9.0, -6.0], [9.0, -3.2]];
const LANE: Ground = [[-7.0, -1.0], [7.0, 19.5]];
/// Balls that roll: how many, their first speed, what slows them down, and how long until they are rolled again.
const ROLLERS: usize = 2;
const ROLL_MPS: std::ops::Range<f64> = 3.0..12.0;
const ROLL_SLOWS_MPS2: f64 = 1.6;
const ROLL_PERIOD_S: f64 = 9.0;

/// Times of pitcher and batter after the release of their pitch, while they practise; `None` around the pitch itself.
pub(super) fn practice(play: &Play, t: f64) -> Option<(f64, f64)> {
    if (-BEFORE_S..AFTER_S).contains(&t) {
        return None;
    }
    // Both end a turn at −BEFORE_S and begin one at AFTER_S.
    let into = |period_s: f64| {
        let since = if t < 0.0 { t + BEFORE_S } else { t - AFTER_S };
        since.rem_euclid(period_s)
    };
    let pitcher_s = into(THROW_PERIOD_S) * THROW_PACE - 1.5;
    let turn_s = into(SWING_PERIOD_S);
    let piece = SWING.windows(2).find_map(|pair| match pair {
        [(from, a), (to, b)] if turn_s <= *to => Some(a + (b - a) * (turn_s - from) / (to - from)),
        _ => None,
    });
    Some((pitcher_s, play.plate_s + piece.unwrap_or(0.0)))
}

/// Somebody on the way from one place to another and back.
#[derive(Debug, Clone, Copy)]
struct Walker {
    from: Point3<f64>,
    way: Vector3<f64>,
    speed_mps: f64,
    step_m: f64,
    begins_s: f64,
    cloth: f32,
    ground: Ground,
}

/// A ball that is rolled again and again.
#[derive(Debug, Clone, Copy)]
struct Roller {
    from: Point3<f64>,
    velocity_mps: Vector3<f64>,
    begins_s: f64,
}

/// Everybody and everything on the field that has no part in the pitch.
#[derive(Debug, Clone, Default)]
pub(super) struct Idle {
    walkers: Vec<Walker>,
    rollers: Vec<Roller>,
    white: f32,
}

impl Idle {
    /// Chooses who walks where.
    pub(super) fn new(white: f32, rng: &mut Pcg64Mcg) -> Self {
        let mut walkers = Vec::new();
        for (count, speed_mps, step_m, ground) in GAITS {
            for _ in 0..count {
                let (from, to) = (place(&ground, rng), place(&ground, rng));
                walkers.push(Walker {
                    from,
                    way: to - from,
                    speed_mps: speed_mps * rng.random_range(0.85..1.15),
                    step_m,
                    begins_s: rng.random_range(0.0..60.0),
                    cloth: if rng.random::<bool>() {
                        0.84 * white
                    } else {
                        0.3 * white
                    },
                    ground,
                });
            }
        }
        let roller = |_| {
            let (from, turn) = (place(&LANE, rng), rng.random_range(0.0..std::f64::consts::TAU));
            Roller {
                from,
                velocity_mps: Vector3::new(turn.cos(), turn.sin(), 0.0) * rng.random_range(ROLL_MPS),
                begins_s: rng.random_range(0.0..ROLL_PERIOD_S),
            }
        };
        Self {
            walkers,
            rollers: (0..ROLLERS).map(roller).collect(),
            white,
        }
    }

    /// Limbs of those who walk at a true time while a pitch is thrown.
    pub(super) fn during_pitch(&self, true_s: f64) -> Vec<Limb> {
        let mut all = Vec::with_capacity(10 * self.walkers.len());
        for walker in self.walkers.iter().filter(|w| w.ground != LANE) {
            walker.limbs(true_s, &mut all);
        }
        all
    }

    /// Limbs of all who walk, and the balls that roll, at a true time between pitches.
    pub(super) fn between_pitches(&self, true_s: f64) -> Vec<Limb> {
        let mut all = self.during_pitch(true_s);
        for walker in self.walkers.iter().filter(|w| w.ground == LANE) {
            walker.limbs(true_s, &mut all);
        }
        for roller in &self.rollers {
            let at = roller.at(true_s);
            limb(&mut all, at, at, [BALL_RADIUS_M; 2], 0.9 * self.white);
        }
        all
    }
}

fn place([[x0, y0], [x1, y1]]: &Ground, rng: &mut Pcg64Mcg) -> Point3<f64> {
    Point3::new(rng.random_range(*x0..*x1), rng.random_range(*y0..*y1), 0.0)
}

impl Walker {
    fn limbs(&self, true_s: f64, all: &mut Vec<Limb>) {
        let length_m = self.way.norm().max(1.0);
        let gone_m = self.speed_mps * (true_s + self.begins_s);
        // There and back: a saw of two slopes.
        let there = gone_m.rem_euclid(2.0 * length_m);
        let (along_m, sense) = if there < length_m {
            (there, 1.0)
        } else {
            (2.0 * length_m - there, -1.0)
        };
        let forward = self.way / length_m * sense;
        let at = self.from + self.way / length_m * along_m;
        // Who turns round makes small steps.
        let stride_m = self.step_m * along_m.min(length_m - along_m).min(1.0);
        let phase = std::f64::consts::PI * gone_m / self.step_m;
        let up = Vector3::z();
        let bob = 0.03 * (2.0 * phase).cos();
        let (hips, chest) = (at + up * (0.93 + bob), at + up * (1.38 + bob) + forward * 0.05);
        let across = Vector3::new(-self.way.y, self.way.x, 0.0) / length_m;
        limb(all, hips, chest, [0.16, 0.19], self.cloth);
        let head = chest + up * 0.32;
        limb(all, head, head, [0.12, 0.12], 90.0);
        for side in [-1.0, 1.0] {
            let swing = 0.5 * stride_m * (phase + 0.5 * std::f64::consts::PI * (1.0 + side)).sin();
            let foot = at + forward * swing + across * (0.1 * side) + up * (0.07 + 0.1 * swing.abs());
            let knee = mix(hips, foot, 0.5) + forward * 0.08;
            limb(all, hips, knee, [0.13, 0.08], self.cloth);
            limb(all, knee, foot, [0.08, 0.055], self.cloth);
            let hand = chest - forward * (0.8 * swing) + across * (0.24 * side) - up * 0.5;
            let elbow = mix(chest + across * (0.2 * side), hand, 0.5) - forward * 0.06;
            limb(
                all,
                chest + across * (0.2 * side),
                elbow,
                [0.07, 0.05],
                self.cloth,
            );
            limb(all, elbow, hand, [0.05, 0.045], 140.0);
        }
    }
}

impl Roller {
    fn at(&self, true_s: f64) -> Point3<f64> {
        let speed_mps = self.velocity_mps.norm();
        let rolls_s = (true_s + self.begins_s)
            .rem_euclid(ROLL_PERIOD_S)
            .min(speed_mps / ROLL_SLOWS_MPS2);
        let way_m = speed_mps * rolls_s - 0.5 * ROLL_SLOWS_MPS2 * rolls_s * rolls_s;
        self.from + self.velocity_mps / speed_mps * way_m + Vector3::z() * BALL_RADIUS_M
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulation::clock::{Purpose, stream};

    #[test]
    fn nobody_jumps_and_the_lane_is_empty_during_a_pitch() {
        let idle = Idle::new(200.0, &mut stream(3, Purpose::Scenery, 0, 1));
        let step_s = 1.0 / 175.0;
        let mut compared = 0;
        for i in 0..4000 {
            let true_s = f64::from(i) * step_s;
            let (now, next) = (
                idle.between_pitches(true_s),
                idle.between_pitches(true_s + step_s),
            );
            // The balls come last, and are rolled anew.
            let people = now.len() - ROLLERS;
            for (a, b) in now.iter().zip(&next).take(people) {
                // A hand swings twice as fast as a runner of 8.6 m/s runs.
                let moved_m = (a.b - b.b).norm();
                assert!(moved_m < 0.25, "{moved_m} m at {true_s} s");
                compared += 1;
            }
            let in_lane = |limb: &Limb| (-0.5..18.0).contains(&limb.a.y) && limb.a.x.abs() < 2.0;
            assert!(!idle.during_pitch(true_s).iter().any(in_lane), "at {true_s} s");
        }
        assert!(compared > 100_000, "{compared}");
    }
}
