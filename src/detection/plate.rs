//! Home plate in a still picture: where its middle is seen, to a tenth of a pixel.
//!
//! A person's click is good to half a pixel, and what is left after all clicks shifts every pitch of a session alike: by 1 mm
//! (three cameras) or 3 mm (two opposite ones) at the plate. The plate itself is white, of known shape, and what pitches
//! are called against. So its picture, as the camera's pose by the clicks foretells it, is laid over the still
//! and moved to where it fits: ground of an even or sloping level, the plate's level, a blur. Gauss–Newton with Tukey's weights,
//! for feet and dust hide parts of it. Where chalk may be (the lines of the batter's boxes, which are off by centimetres) nothing is
//! compared.

mod foretold;

use nalgebra::{Point3, SMatrix, SVector, Vector2};

use self::foretold::{Fine, Foretold};
use super::median::median;
use super::still::Picture;
use crate::geometry::{Intrinsics, Pixel, Pose};
use crate::scene::PixelRect;

/// Pixels beside the plate that are looked at, and so many more that are kept of the picture.
const BESIDE_PX: i32 = 3;
const MARGIN_PX: f64 = 10.0;
/// The largest part of a picture that is looked at, and the smallest plate, pixels.
const PART_MAX_PX: u32 = 300;
const PLATE_MIN_PX: f64 = 12.0;
/// Blurs that are tried, σ in pixels.
const BLURS_PX: [f64; 6] = [0.35, 0.5, 0.65, 0.8, 1.0, 1.3];
/// The plate is no further from where the clicks say, pixels.
pub const SHIFT_MAX_PX: f64 = 1.6;
/// Where the fit is begun besides there: all that end well must agree to this.
const BEGUN_PX: f64 = 0.9;
const AGREE_PX: f64 = 0.2;
const AGREE_COST: f64 = 1.15;
/// ... and so many of the four must.
const AGREE_MIN: usize = 2;
/// A fit has ended well when its last step was smaller than this, pixels.
const STEP_MAX_PX: f64 = 1e-3;
/// It is so much brighter than the ground, levels, and than so many times what is left unexplained.
const CONTRAST_MIN: f64 = 25.0;
const CONTRAST_SIGMAS: f64 = 6.0;
/// Pixels further off than this many σ have no say (Tukey).
const TUKEY_SIGMAS: f64 = 4.685;
/// What is unexplained is no less than this share of the contrast.
const UNEXPLAINED_MIN: f64 = 0.01;
/// This share of the pixels on the plate, and beside it, must have a say.
const SAY_MIN: f64 = 0.6;
/// What is unexplained is alike in neighbouring pixels: σ counts so many times.
const ALIKE: f64 = 2.0;
/// σ of a plate's place at least, and the largest that is of use, pixels.
const SIGMA_PX: [f64; 2] = [0.1, 0.4];
const STEPS: usize = 25;

/// Half of the plate's width, and of its length (8.5 in), metres.
const HALF_PLATE_M: f64 = 0.2159;
/// Pixels with more of what may be chalk have no say.
const CHALK_MAX: f64 = 0.1;

/// Shift, level of the plate over the ground's, the ground's level and slopes.
const PARAMETERS: usize = 6;
type Parameters = SVector<f64, PARAMETERS>;
type Information = SMatrix<f64, PARAMETERS, PARAMETERS>;

/// Home plate as a camera sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlateSeen {
    /// Where the middle of its square (0, 0.216, 0) is seen.
    pub middle: Pixel,
    /// σ per axis, pixels.
    pub sigma_px: f64,
    /// From where the pose puts it to there, pixels.
    pub shift_px: Vector2<f64>,
}

/// The middle of the plate's square, metres.
pub fn plate_middle() -> Point3<f64> {
    Point3::new(0.0, HALF_PLATE_M, 0.0)
}

/// The part of a camera's picture with home plate in it; `None` where it is not in view, or too small.
pub fn plate_place(lens: &Intrinsics, pose: &Pose, (width_px, height_px): (u32, u32)) -> Option<PixelRect> {
    let half = HALF_PLATE_M;
    let corners = [
        (0.0, 0.0),
        (-half, half),
        (half, half),
        (-half, 2.0 * half),
        (half, 2.0 * half),
    ];
    let mut low = Vector2::repeat(f64::INFINITY);
    let mut high = -low;
    for (x, y) in corners {
        let seen = lens
            .project(&pose.transform(&Point3::new(x, y, 0.0)))
            .ok()?
            .vector();
        (low, high) = (low.inf(&seen), high.sup(&seen));
    }
    if (high - low).amax() < PLATE_MIN_PX {
        return None;
    }
    let (low, high) = (low.add_scalar(-MARGIN_PX), high.add_scalar(MARGIN_PX));
    let inside = low.min() >= 0.0 && high.x < f64::from(width_px) && high.y < f64::from(height_px);
    let size = high - low;
    (inside && size.amax() < f64::from(PART_MAX_PX)).then(|| PixelRect {
        x_px: low.x as u32,
        y_px: low.y as u32,
        width_px: size.x.ceil() as u32,
        height_px: size.y.ceil() as u32,
    })
}

/// Seeks home plate in a still of [`plate_place`]; `None` where the picture does not show it for sure.
pub fn seek_plate(still: &Picture, lens: &Intrinsics, pose: &Pose) -> Option<PlateSeen> {
    let foretold = Foretold::new(still.place, lens, pose)?;
    let mut best: Option<(Fit, Fitting)> = None;
    for blur_px in BLURS_PX {
        let fitting = Fitting::new(still, foretold.blurred(blur_px))?;
        let fit = fitting.from(Vector2::zeros());
        if let Some(fit) = fit.filter(|fit| best.as_ref().is_none_or(|(best, _)| fit.cost < best.cost)) {
            best = Some((fit, fitting));
        }
    }
    let (mut best, fitting) = best?;
    let begins = [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)];
    let mut others = Vec::new();
    for (x, y) in begins {
        others.extend(fitting.from(Vector2::new(x, y) * BEGUN_PX));
    }
    for other in &others {
        if other.cost < best.cost {
            best = *other;
        }
    }
    let rivals = others.iter().filter(|other| other.cost < AGREE_COST * best.cost);
    let here = |other: &&Fit| (other.shift() - best.shift()).norm() < AGREE_PX;
    let agree = rivals.clone().all(|rival| here(&rival)) && others.iter().filter(here).count() >= AGREE_MIN;
    tracing::debug!(?best, agree, "home plate");
    let middle = lens.project(&pose.transform(&plate_middle())).ok()?.vector() + best.shift();
    (agree && best.is_plate()).then(|| PlateSeen {
        middle: Pixel::new(middle.x, middle.y),
        sigma_px: best.sigma_px.max(SIGMA_PX[0]),
        shift_px: best.shift(),
    })
}

/// One pixel of the still: place in the part, level, and whether the plate is foretold there.
struct Seen {
    at: Vector2<f64>,
    level: f64,
    on_plate: bool,
}

struct Fitting {
    plate: Fine,
    pixels: Vec<Seen>,
    middle: Vector2<f64>,
}

#[derive(Debug, Clone, Copy)]
struct Fit {
    values: Parameters,
    /// Tukey's, over that of pixels that have no say.
    cost: f64,
    unexplained: f64,
    sigma_px: f64,
    /// Of the pixels on the plate and of those beside it.
    say: [f64; 2],
}

impl Fit {
    fn shift(&self) -> Vector2<f64> {
        self.values.fixed_rows::<2>(0).into_owned()
    }

    fn is_plate(&self) -> bool {
        self.shift().norm() < SHIFT_MAX_PX
            && self.sigma_px < SIGMA_PX[1]
            && self.values[2] > CONTRAST_MIN.max(CONTRAST_SIGMAS * self.unexplained)
            && self.say.iter().all(|say| *say > SAY_MIN)
    }
}

impl Fitting {
    fn new(still: &Picture, [plate, chalk]: [Fine; 2]) -> Option<Self> {
        let near = |x: u32, y: u32| {
            let steps = || -BESIDE_PX..=BESIDE_PX;
            steps().any(|dy| {
                steps()
                    .any(|dx| plate.at(f64::from(x) + f64::from(dx), f64::from(y) + f64::from(dy))[0] > 0.02)
            })
        };
        let mut pixels = Vec::new();
        for y in 0..still.place.height_px {
            for x in (0..still.place.width_px).filter(|x| near(*x, y)) {
                let level = still.at(still.place.x_px + x, still.place.y_px + y)?;
                let at = Vector2::new(f64::from(x), f64::from(y));
                if chalk.at(at.x, at.y)[0] > CHALK_MAX {
                    continue;
                }
                pixels.push(Seen {
                    at,
                    level: f64::from(level),
                    on_plate: plate.at(at.x, at.y)[0] > 0.5,
                });
            }
        }
        let middle = pixels.iter().map(|p| p.at).sum::<Vector2<f64>>() / pixels.len().max(1) as f64;
        (pixels.len() > 4 * PARAMETERS).then_some(Self {
            plate,
            pixels,
            middle,
        })
    }

    /// A pixel's model and its derivatives.
    fn model(&self, seen: &Seen, values: &Parameters) -> (f64, Parameters) {
        let place = seen.at - values.fixed_rows::<2>(0);
        let [plate, plate_x, plate_y] = self.plate.at(place.x, place.y);
        let off = 0.1 * (seen.at - self.middle);
        let model = values[2] * plate + values[3] + values[4] * off.x + values[5] * off.y;
        let slopes = [
            -values[2] * plate_x,
            -values[2] * plate_y,
            plate,
            1.0,
            off.x,
            off.y,
        ];
        (model, Parameters::from(slopes))
    }

    /// The fit from a shift on.
    fn from(&self, shift: Vector2<f64>) -> Option<Fit> {
        let mut values = Parameters::zeros();
        values.fixed_rows_mut::<2>(0).copy_from(&shift);
        // Levels first, as if all were in view.
        let [on, off] = [true, false].map(|on| {
            let levels = self
                .pixels
                .iter()
                .filter(|seen| seen.on_plate == on)
                .map(|seen| seen.level);
            median(levels)
        });
        (values[2], values[3]) = (on? - off?, off?);
        let mut scale = f64::INFINITY;
        let (mut state, mut last_px) = (None, f64::INFINITY);
        for step in 0..STEPS {
            let looks: Vec<(f64, Parameters)> =
                self.pixels.iter().map(|seen| self.model(seen, &values)).collect();
            let residuals: Vec<f64> = self
                .pixels
                .iter()
                .zip(&looks)
                .map(|(seen, (model, _))| seen.level - model)
                .collect();
            let unexplained = 1.4826 * median(residuals.iter().map(|r| r.abs()))?;
            let floor = UNEXPLAINED_MIN * values[2].abs();
            // What is unexplained only falls, or the weights would follow what they leave out.
            scale = f64::min(scale, unexplained.max(floor).max(0.3));
            let mut information = Information::identity() * 1e-9;
            let mut gradient = Parameters::zeros();
            let (mut cost, mut says) = (0.0, [[0.0; 2]; 2]);
            for ((seen, (_, slopes)), residual) in self.pixels.iter().zip(&looks).zip(&residuals) {
                let share = 1.0 - (residual / (TUKEY_SIGMAS * scale)).powi(2);
                let say = share.max(0.0).powi(2);
                cost += 1.0 - share.max(0.0).powi(3);
                says[usize::from(!seen.on_plate)][0] += f64::from(u8::from(say > 0.25));
                says[usize::from(!seen.on_plate)][1] += 1.0;
                information += slopes * slopes.transpose() * say;
                gradient += slopes * (residual * say);
            }
            let factor = information.cholesky()?;
            let mut change = factor.solve(&gradient);
            let far = change.fixed_rows::<2>(0).norm();
            if far > 0.4 {
                change *= 0.4 / far;
            }
            let covariance = factor.inverse() * (ALIKE * scale).powi(2);
            state = Some(Fit {
                values,
                cost: cost * scale * scale,
                unexplained: scale,
                sigma_px: covariance[(0, 0)].max(covariance[(1, 1)]).sqrt(),
                say: says.map(|[kept, all]| kept / f64::max(all, 1.0)),
            });
            values += change;
            if values.fixed_rows::<2>(0).norm() > 2.0 * SHIFT_MAX_PX || !values.iter().all(|v| v.is_finite())
            {
                return None;
            }
            last_px = far;
            if step > 5 && far < 0.1 * STEP_MAX_PX {
                break;
            }
        }
        state.filter(|_| last_px < STEP_MAX_PX)
    }
}

#[cfg(test)]
mod tests;
