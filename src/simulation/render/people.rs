//! Pitcher, batter, catcher and umpire: limbs that move with the pitch.
//!
//! `t` is seconds after the release of the nearest pitch. The shapes are rough; what matters to a detector is
//! there: white cloth that moves, a hand that carries the ball to its release, a bat, a glove that meets it.

use nalgebra::{Point3, Vector3};

use super::limb::Limb;

/// What the four need to know of one pitch.
#[derive(Debug, Clone, Copy)]
pub(super) struct Play {
    /// Release point and velocity.
    pub release_m: Point3<f64>,
    pub release_mps: Vector3<f64>,
    /// Where the glove meets the ball.
    pub glove_m: Point3<f64>,
    /// Release to plate, seconds.
    pub plate_s: f64,
    /// +1: the batter stands at x > 0.
    pub batter_side: f64,
    /// Does he swing?
    pub swing: bool,
    /// y of his stance, metres.
    pub batter_y_m: f64,
    /// Height of the ground under the pitcher's rubber, metres.
    pub mound_m: f64,
}

const ARM_M: f64 = 0.75;
/// The hand speeds up with this time constant, seconds.
const ARM_TIME_S: f64 = 0.03;
/// The ball leaves the glove this long before release, seconds.
const BALL_SHOWN_S: f64 = 0.36;

fn ease(from_s: f64, to_s: f64, t: f64) -> f64 {
    let u = ((t - from_s) / (to_s - from_s)).clamp(0.0, 1.0);
    u * u * (3.0 - 2.0 * u)
}

pub(super) fn mix(a: Point3<f64>, b: Point3<f64>, s: f64) -> Point3<f64> {
    a + (b - a) * s
}

impl Play {
    /// The throwing hand: a circle about the shoulder that meets the release point at the release velocity.
    fn hand(&self, t: f64) -> Point3<f64> {
        let speed = self.release_mps.norm();
        let (along, up) = self.arm_plane();
        let turn = speed / ARM_M * ARM_TIME_S * (1.0 - (-t.abs() / ARM_TIME_S).exp()) * t.signum();
        self.release_m + ARM_M * ((turn.cos() - 1.0) * up + turn.sin() * along)
    }

    /// Directions of the throw and of the arm at release.
    fn arm_plane(&self) -> (Vector3<f64>, Vector3<f64>) {
        let along = self.release_mps.normalize();
        let slot = Vector3::new(0.6 * self.release_m.x.signum(), 0.0, 0.8);
        let up = (slot - along * slot.dot(&along)).normalize();
        (along, up)
    }

    /// The ball in the hand before release; `None` while the glove hides it.
    pub(super) fn held_ball(&self, t: f64) -> Option<Point3<f64>> {
        (-BALL_SHOWN_S..0.0).contains(&t).then(|| self.throwing_hand(t))
    }

    fn throwing_hand(&self, t: f64) -> Point3<f64> {
        let rest = Point3::new(0.05 * self.release_m.x.signum(), 17.95, 1.25 + self.mound_m);
        let rest = mix(
            rest,
            self.hand(-0.3) + Vector3::new(0.0, 0.3, -0.2),
            ease(-0.6, -0.25, t),
        );
        mix(rest, self.hand(t), ease(-0.3, -0.12, t))
    }

    /// All limbs of all four: pitcher and batter at their own times, the others at `t`.
    pub(super) fn limbs(&self, t: f64, (pitcher_s, batter_s): (f64, f64), white: f32) -> Vec<Limb> {
        let mut all = Vec::with_capacity(64);
        // After the follow-through the pitcher goes slowly back to where he began.
        let back = (0.8 - (pitcher_s - 0.8) / 2.5).max(-1.5);
        self.pitcher(if pitcher_s > 0.8 { back } else { pitcher_s }, white, &mut all);
        self.batter(batter_s, white, &mut all);
        self.catcher(t, &mut all);
        self.umpire(t, &mut all);
        all
    }

    fn pitcher(&self, t: f64, white: f32, all: &mut Vec<Limb>) {
        let side = self.release_m.x.signum();
        let (along, up) = self.arm_plane();
        let sway = 0.015 * (2.1 * t).sin();
        let stride = ease(-0.8, -0.1, t);
        let follow = ease(0.0, 0.4, t);
        let shoulder = self.release_m - ARM_M * up;
        let standing = Point3::new(0.03 + sway, 18.25, 1.45 + self.mound_m);
        let thrown = shoulder + Vector3::new(-0.2 * side, 0.05, -0.02);
        let bent = thrown + along * 0.45 + Vector3::new(0.0, 0.0, -0.45);
        let chest = mix(mix(standing, thrown, stride), bent, follow);
        let hips = mix(
            Point3::new(sway, 18.3, 0.95 + self.mound_m),
            Point3::new(0.0, self.release_m.y + 0.5, 0.92),
            stride,
        ) + along * (0.15 * follow);
        let cloth = 0.86 * white;
        limb(all, hips, chest, [0.17, 0.2], cloth);
        let head = chest + (chest - hips).normalize() * 0.33;
        limb(all, head, head, [0.115, 0.115], 135.0);
        limb(
            all,
            head + Vector3::new(0.0, -0.05, 0.07),
            head + Vector3::new(0.0, 0.05, 0.08),
            [0.1, 0.1],
            45.0,
        );
        // Throwing arm.
        let joint = chest + Vector3::new(0.19 * side, 0.0, 0.02);
        let hand = self.throwing_hand(t);
        let elbow =
            mix(joint, hand, 0.5) + Vector3::new(0.08 * side, 0.1, -0.1) * (1.0 - ease(-0.05, 0.0, t));
        limb(all, joint, elbow, [0.07, 0.055], cloth);
        let wrist = hand + (elbow - hand).normalize() * 0.085;
        limb(all, elbow, wrist, [0.05, 0.042], 140.0);
        limb(all, wrist, wrist, [0.05, 0.05], 145.0);
        // Glove arm.
        let rest_glove = Point3::new(-0.05 * side, 17.95, 1.22 + self.mound_m);
        let tucked = chest + Vector3::new(-0.32 * side, -0.12, -0.25);
        let glove = mix(
            mix(rest_glove, chest + along * 0.55, ease(-0.6, -0.25, t)),
            tucked,
            ease(-0.2, 0.0, t),
        );
        let other = chest + Vector3::new(-0.19 * side, 0.0, 0.02);
        limb(all, other, glove, [0.07, 0.05], cloth);
        limb(all, glove, glove, [0.13, 0.13], 62.0);
        self.pitcher_legs(t, hips, cloth, all);
    }

    fn pitcher_legs(&self, t: f64, hips: Point3<f64>, cloth: f32, all: &mut Vec<Limb>) {
        let side = self.release_m.x.signum();
        let stride = ease(-0.6, -0.12, t);
        let raised = ease(-1.2, -0.7, t) * (1.0 - ease(-0.65, -0.25, t));
        let ground = self.mound_m;
        let back = Point3::new(0.1 * side, 18.35, 0.08 + ground);
        let dragged = Point3::new(0.15 * side, self.release_m.y + 0.55, 0.35);
        let back = mix(back, dragged, ease(0.0, 0.35, t));
        let front = mix(
            Point3::new(-0.1 * side, 18.1, 0.08 + ground),
            Point3::new(-0.15 * side, self.release_m.y - 0.15, 0.1),
            stride,
        ) + Vector3::new(0.0, 0.15, 0.75) * raised;
        for (foot, forward) in [(back, -0.05), (front, -0.2)] {
            let knee =
                mix(hips, foot, 0.5) + Vector3::new(0.0, forward, 0.03 + 0.25 * raised * -forward * 5.0);
            limb(all, hips, knee, [0.13, 0.085], cloth);
            limb(all, knee, foot, [0.08, 0.055], cloth * 0.97);
            limb(
                all,
                foot,
                foot + Vector3::new(0.0, -0.16, -0.02),
                [0.06, 0.05],
                35.0,
            );
        }
    }

    fn batter(&self, t: f64, white: f32, all: &mut Vec<Limb>) {
        let side = self.batter_side;
        let sway = 0.02 * (5.0 * t).sin();
        let x = 0.88 * side;
        let y = self.batter_y_m;
        let hips = Point3::new(x, y - 0.02 + sway, 0.93);
        let chest = Point3::new(x - 0.06 * side, y + sway, 1.38);
        let cloth = 0.66 * white;
        limb(all, hips, chest, [0.17, 0.2], cloth);
        let head = Point3::new(x - 0.1 * side, y + sway, 1.68);
        limb(all, head, head, [0.13, 0.13], 50.0);
        for foot_y in [-0.38, 0.36] {
            let foot = Point3::new(x + 0.05 * side, y + foot_y, 0.07);
            let knee = mix(hips, foot, 0.5) + Vector3::new(-0.1 * side, 0.0, 0.05);
            limb(all, hips, knee, [0.14, 0.09], cloth * 1.15);
            limb(all, knee, foot, [0.09, 0.06], cloth * 1.15);
        }
        let swing = if self.swing {
            ease(self.plate_s - 0.13, self.plate_s + 0.09, t)
        } else {
            0.0
        };
        let angle = 4.4 * swing + 0.1 * (6.0 * t).sin() * (1.0 - swing);
        let inward = -side;
        let flat = Vector3::new(inward * angle.sin(), -angle.cos(), 0.0);
        let hands = Point3::new(
            x + 0.3 * inward * (0.3 + 0.7 * (angle * 0.7).sin().max(0.0)),
            y - 0.25 + 0.5 * swing,
            1.4 - 0.5 * swing,
        );
        let bat = (flat + Vector3::new(0.0, 0.0, 1.4 * (1.0 - ease(0.0, 0.4, swing)) - 0.12)).normalize();
        for shoulder_y in [-0.17, 0.17] {
            let shoulder = chest + Vector3::new(0.0, shoulder_y, 0.05);
            limb(all, shoulder, hands, [0.065, 0.05], cloth);
        }
        limb(all, hands, hands + bat * 0.42, [0.016, 0.024], 150.0);
        limb(all, hands + bat * 0.42, hands + bat * 0.84, [0.026, 0.033], 165.0);
    }

    fn catcher(&self, t: f64, all: &mut Vec<Limb>) {
        let sway = 0.01 * (3.0 * t).sin();
        let waiting = Point3::new(0.05, -0.62, 0.62);
        let meets = self.glove_m + Vector3::new(0.0, -0.09, 0.0);
        let glove = mix(waiting, meets, ease(self.plate_s - 0.3, self.plate_s, t));
        let x = 0.4 * self.glove_m.x + sway;
        let hips = Point3::new(x, -1.35, 0.42);
        let chest = Point3::new(x, -1.15, 0.86);
        limb(all, hips, chest, [0.2, 0.22], 72.0);
        let head = Point3::new(x, -1.08, 1.2);
        limb(all, head, head, [0.14, 0.14], 48.0);
        for side in [-1.0, 1.0] {
            let knee = Point3::new(x + 0.38 * side, -0.98, 0.42);
            limb(all, hips, knee, [0.13, 0.1], 150.0);
            limb(
                all,
                knee,
                Point3::new(x + 0.3 * side, -1.2, 0.07),
                [0.1, 0.07],
                80.0,
            );
        }
        limb(
            all,
            chest + Vector3::new(-0.2, 0.0, 0.05),
            glove,
            [0.07, 0.05],
            120.0,
        );
        limb(all, glove, glove, [0.135, 0.135], 78.0);
        let bare = Point3::new(x + 0.3, -1.1, 0.45);
        limb(
            all,
            chest + Vector3::new(0.2, 0.0, 0.05),
            bare,
            [0.07, 0.05],
            120.0,
        );
    }

    fn umpire(&self, t: f64, all: &mut Vec<Limb>) {
        let sway = 0.01 * (1.7 * t).sin();
        let x = 0.3 * self.batter_side + sway;
        let hips = Point3::new(x, -2.4, 0.78);
        let chest = Point3::new(x, -2.1, 1.12);
        limb(all, hips, chest, [0.2, 0.24], 38.0);
        let head = Point3::new(x, -1.98, 1.42);
        limb(all, head, head, [0.14, 0.14], 42.0);
        for side in [-1.0, 1.0] {
            let foot = Point3::new(x + 0.3 * side, -2.2, 0.07);
            let knee = mix(hips, foot, 0.5) + Vector3::new(0.0, 0.12, 0.0);
            limb(all, hips, knee, [0.14, 0.09], 95.0);
            limb(all, knee, foot, [0.09, 0.06], 95.0);
            let hand = knee + Vector3::new(0.0, 0.05, 0.1);
            limb(
                all,
                chest + Vector3::new(0.24 * side, 0.0, 0.05),
                hand,
                [0.075, 0.05],
                38.0,
            );
        }
    }
}

pub(super) fn limb(all: &mut Vec<Limb>, a: Point3<f64>, b: Point3<f64>, radius_m: [f64; 2], tone: f32) {
    all.push(Limb { a, b, radius_m, tone });
}
