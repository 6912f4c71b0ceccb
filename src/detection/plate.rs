//! Home plate in a still picture: where its middle is seen, to a tenth of a pixel.
//!
//! A person's click is good to half a pixel, and what is left after all clicks shifts every pitch of a session alike: by 1 mm
//! (three cameras) or 3 mm (two opposite ones) at the plate. The plate itself is white, of known shape, and what pitches
//! are called against. So its picture, as the camera's pose by the clicks foretells it, is laid over the still
//! and moved to where it fits: ground of an even or sloping level, the plate's level, a blur along each axis. Gauss–Newton with
//! Tukey's weights, for feet and dust hide parts of it. What is left is mostly texture of the ground and dirt on the plate, alike in
//! pixels side by side: so neighbours' differences are compared, and levels hardly (the precision λ·I + L of a Gaussian Markov random
//! field, L the weighted Laplacian of the pixels' grid; Rue and Held 2005, section 3.2). Where chalk may be (the lines of the batter's
//! boxes, which are off by centimetres) nothing is compared.

mod foretold;

use nalgebra::{Point3, SMatrix, SVector, Vector2};

use self::foretold::{Fine, Foretold};
use super::median::{SIGMA_OVER_MEDIAN, median};
use super::still::Picture;
use crate::geometry::{Intrinsics, Pixel, Pose};
use crate::scene::PixelRect;

/// Pixels beside the plate that are looked at, and so many more that are kept of the picture.
const BESIDE_PX: i32 = 3;
const MARGIN_PX: f64 = 10.0;
/// The largest part of a picture that is looked at, and the smallest plate, pixels.
const PART_MAX_PX: u32 = 300;
const PLATE_MIN_PX: f64 = 12.0;
/// Blurs that are begun with, σ in pixels.
const BLURS_PX: [f64; 6] = [0.35, 0.5, 0.65, 0.8, 1.0, 1.3];
/// Times that the picture is foretold anew with the blur that was fitted, and the bounds of it.
const BLUR_ROUNDS: usize = 2;
const BLUR_BOUNDS_PX: [f64; 2] = [0.2, 3.0];
/// A blur's σ² is off by this much from the one begun with, pixels².
const BLUR_OFF_PX2: f64 = 0.3;
/// The plate is no further from where the clicks say, pixels.
pub const SHIFT_MAX_PX: f64 = 1.6;
/// Where the fit is begun besides there: all that end well must agree to this, or to so many σ where it is less sure.
const BEGUN_PX: f64 = 0.9;
const AGREE_PX: f64 = 0.2;
const AGREE_SIGMAS: f64 = 2.0;
const AGREE_COST: f64 = 1.15;
/// ... and so many of the four must.
const AGREE_MIN: usize = 2;
/// A fit has ended well when its last step was smaller than this, pixels, or than so many σ: the weights follow what they leave
/// out, and may go to and fro a little for ever.
const STEP_MAX_PX: f64 = 1e-3;
const STEP_SIGMAS: f64 = 0.05;
/// It is so much brighter than the ground, levels, and than so many times what is left unexplained.
const CONTRAST_MIN: f64 = 25.0;
const CONTRAST_SIGMAS: f64 = 6.0;
/// Pixels further off than this many σ have no say (Tukey). An edge is not foretold better than by so many pixels, or the only
/// pixels that tell where the plate is would be left out on even ground.
const TUKEY_SIGMAS: f64 = 4.685;
const EDGE_PX: f64 = 0.1;
/// Share of the levels themselves, beside that of neighbours' differences.
const LEVELS: f64 = 0.1;
/// Unlikeness of neighbours is no less, levels: about that of rounding to whole ones.
const UNLIKE_MIN: f64 = 0.3;
/// What is unexplained is no less than this share of the contrast.
const UNEXPLAINED_MIN: f64 = 0.01;
/// This share of the pixels on the plate, and beside it, must have a say.
const SAY_MIN: f64 = 0.6;
/// Texture is no such field in truth: σ counts so many times (errors in rendered stills are 1.1 to
/// 1.6 times what it would be).
const UNTRUE: f64 = 2.0;
/// σ of a plate's place at least, and the largest that is of use, pixels.
const SIGMA_PX: [f64; 2] = [0.05, 0.4];
const STEPS: usize = 25;

/// Half of the plate's width, and of its length (8.5 in), metres.
const HALF_PLATE_M: f64 = 0.2159;
/// Pixels with more of what may be chalk have no say.
const CHALK_MAX: f64 = 0.1;

/// Shift, level of the plate over the ground's, the ground's level and slopes, the blur's σ² beyond that of the picture.
const PARAMETERS: usize = 8;
const BLUR: [usize; 2] = [6, 7];
type Parameters = SVector<f64, PARAMETERS>;
type Information = SMatrix<f64, PARAMETERS, PARAMETERS>;

/// Home plate as a camera sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlateSeen {
    /// Where the middle of its square (0, 0.216, 0) is seen.
    pub middle: Pixel,
    /// σ along x and y, pixels: texture moves the ends of the plate more than its long edges.
    pub sigma_px: [f64; 2],
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
    let (mut best, fitting) = fit_blur(still, &foretold)?;
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
    let off_px = |other: &Fit| other.shift() - best.shift();
    let allowed_px = AGREE_PX.max(AGREE_SIGMAS * best.sigma_px.max());
    let here = |other: &&Fit| off_px(other).norm() < allowed_px;
    // What fits as well is as likely.
    let off_here_px = rivals.clone().filter(here).map(|rival| off_px(rival).abs());
    let spread_px = off_here_px.fold(Vector2::zeros(), |most, off_px| most.sup(&off_px));
    let agree = rivals.clone().all(|rival| here(&rival)) && others.iter().filter(here).count() >= AGREE_MIN;
    best.sigma_px = best.sigma_px.zip_map(&spread_px, f64::hypot);
    tracing::debug!(?best, agree, "home plate");
    let middle = lens.project(&pose.transform(&plate_middle())).ok()?.vector() + best.shift();
    (agree && best.is_plate()).then(|| PlateSeen {
        middle: Pixel::new(middle.x, middle.y),
        sigma_px: best.sigma_px.map(|sigma| sigma.max(SIGMA_PX[0])).into(),
        shift_px: best.shift(),
    })
}

/// The fit from where the pose puts the plate, with the blur that fits: the best of a few, then along each axis.
fn fit_blur(still: &Picture, foretold: &Foretold) -> Option<(Fit, Fitting)> {
    let mut best: Option<(Fit, Fitting, f64)> = None;
    for blur_px in BLURS_PX {
        let fitting = Fitting::new(still, foretold.blurred([blur_px; 2]))?;
        let fit = fitting.from(Vector2::zeros());
        if let Some(fit) = fit.filter(|fit| best.as_ref().is_none_or(|(best, ..)| fit.cost < best.cost)) {
            best = Some((fit, fitting, blur_px));
        }
    }
    let (mut fit, mut fitting, blur_px) = best?;
    let mut blur_px = [blur_px; 2];
    let [low, high] = BLUR_BOUNDS_PX;
    for _ in 0..BLUR_ROUNDS {
        for (sigma_px, parameter) in blur_px.iter_mut().zip(BLUR) {
            let squared = sigma_px.powi(2) + fit.values[parameter];
            *sigma_px = squared.max(0.0).sqrt().clamp(low, high);
        }
        fitting = Fitting::new(still, foretold.blurred(blur_px))?;
        fit = fitting.from(fit.shift())?;
    }
    Some((fit, fitting))
}

/// One pixel of the still: place in the part, level, and whether the plate is foretold there.
struct Seen {
    at: Vector2<f64>,
    level: f64,
    on_plate: bool,
}

/// Two pixels side by side, by their places in the list: along x (0) or y (1).
struct Pair {
    pixels: [usize; 2],
    axis: usize,
}

/// Pixels side by side in a list that goes row by row, each row from the left.
fn pairs(pixels: &[Seen]) -> Vec<Pair> {
    let key = |at: &Vector2<f64>| (at.y as i64, at.x as i64);
    let mut pairs = Vec::with_capacity(2 * pixels.len());
    for (index, seen) in pixels.iter().enumerate() {
        let (row, column) = key(&seen.at);
        for (axis, beside) in [(row, column + 1), (row + 1, column)].into_iter().enumerate() {
            if let Ok(other) = pixels.binary_search_by_key(&beside, |seen| key(&seen.at)) {
                let pixels = [index, other];
                pairs.push(Pair { pixels, axis });
            }
        }
    }
    pairs
}

/// A pixel's level less the model's, levels, and the model's derivatives.
struct Look {
    residual: f64,
    slopes: Parameters,
}

impl Look {
    /// 1 where the model fits, 0 and less where it does not at all.
    fn share(&self, scale: f64) -> f64 {
        let edge2 = EDGE_PX.powi(2) * self.slopes.fixed_rows::<2>(0).norm_squared();
        1.0 - self.residual.powi(2) / (TUKEY_SIGMAS.powi(2) * (scale * scale + edge2))
    }
}

/// The normal equations of one step.
struct Normal {
    information: Information,
    gradient: Parameters,
    /// Sum of the weighted squares.
    squares: f64,
}

impl Normal {
    /// The blur is about that of the picture: what else is unexplained counts `scale` levels.
    fn new(values: &Parameters, scale: f64) -> Self {
        let mut information = Information::identity() * 1e-9;
        let mut gradient = Parameters::zeros();
        let weight = (scale / BLUR_OFF_PX2).powi(2);
        for parameter in BLUR {
            information[(parameter, parameter)] += weight;
            gradient[parameter] -= weight * values[parameter];
        }
        Self {
            information,
            gradient,
            squares: 0.0,
        }
    }

    fn add(&mut self, slopes: &Parameters, residual: f64, weight: f64) {
        self.information += slopes * slopes.transpose() * weight;
        self.gradient += slopes * (residual * weight);
        self.squares += weight * residual * residual;
    }
}

struct Fitting {
    plate: Fine,
    pixels: Vec<Seen>,
    pairs: Vec<Pair>,
    middle: Vector2<f64>,
}

#[derive(Debug, Clone, Copy)]
struct Fit {
    values: Parameters,
    /// Tukey's, over that of pixels that have no say.
    cost: f64,
    unexplained: f64,
    sigma_px: Vector2<f64>,
    /// Of the pixels on the plate and of those beside it.
    say: [f64; 2],
}

impl Fit {
    fn shift(&self) -> Vector2<f64> {
        self.values.fixed_rows::<2>(0).into_owned()
    }

    fn is_plate(&self) -> bool {
        self.shift().norm() < SHIFT_MAX_PX
            && self.sigma_px.max() < SIGMA_PX[1]
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
            pairs: pairs(&pixels),
            plate,
            pixels,
            middle,
        })
    }

    fn look(&self, seen: &Seen, values: &Parameters) -> Look {
        let place = seen.at - values.fixed_rows::<2>(0);
        let [plate, plate_x, plate_y] = self.plate.at(place.x, place.y);
        // A blur whose σ² is more by b adds b/2 times the second derivative (the heat equation).
        let [curve_x, curve_y] = self.plate.curves(place.x, place.y).map(|curve| 0.5 * curve);
        let plate = plate + values[BLUR[0]] * curve_x + values[BLUR[1]] * curve_y;
        let off = 0.1 * (seen.at - self.middle);
        let model = values[2] * plate + values[3] + values[4] * off.x + values[5] * off.y;
        let slopes = [
            -values[2] * plate_x,
            -values[2] * plate_y,
            plate,
            1.0,
            off.x,
            off.y,
            values[2] * curve_x,
            values[2] * curve_y,
        ];
        Look {
            residual: seen.level - model,
            slopes: Parameters::from(slopes),
        }
    }

    /// A shift, and the levels as if all were in view.
    fn begin(&self, shift: Vector2<f64>) -> Option<Parameters> {
        let [on, off] = [true, false].map(|on| {
            let pixels = self.pixels.iter().filter(|seen| seen.on_plate == on);
            median(pixels.map(|seen| seen.level))
        });
        let mut values = Parameters::zeros();
        values.fixed_rows_mut::<2>(0).copy_from(&shift);
        (values[2], values[3]) = (on? - off?, off?);
        Some(values)
    }

    /// What tells pixels side by side apart along each axis, over the geometric mean of both: a pixel of flat ground is many times
    /// longer than wide.
    fn unlike(&self, looks: &[Look]) -> [f64; 2] {
        let along = |axis: usize| {
            let pairs = self.pairs.iter().filter(|pair| pair.axis == axis);
            let steps = pairs.filter_map(|pair| {
                let [one, other] = pair.pixels;
                Some((looks.get(one)?.residual - looks.get(other)?.residual).abs())
            });
            median(steps).unwrap_or(0.0).max(UNLIKE_MIN)
        };
        let unlike = [along(0), along(1)];
        let mean = (unlike[0] * unlike[1]).sqrt();
        unlike.map(|unlike| unlike / mean)
    }

    /// The step's equations: levels, and differences of neighbours of which both have a say.
    fn normal(&self, looks: &[Look], values: &Parameters, scale: f64) -> Normal {
        let say: Vec<f64> = looks
            .iter()
            .map(|look| look.share(scale).max(0.0).powi(2))
            .collect();
        let mut normal = Normal::new(values, scale);
        for (look, say) in looks.iter().zip(&say) {
            normal.add(&look.slopes, look.residual, LEVELS * say);
        }
        let unlike = self.unlike(looks);
        for pair in &self.pairs {
            let [one, other] = pair.pixels;
            let weight = say[one] * say[other] / unlike[pair.axis].powi(2);
            let (one, other) = (&looks[one], &looks[other]);
            normal.add(
                &(one.slopes - other.slopes),
                one.residual - other.residual,
                weight,
            );
        }
        normal
    }

    /// How well the model fits, and which pixels have a say.
    fn judge(&self, looks: &[Look], values: &Parameters, scale: f64) -> Fit {
        let (mut cost, mut says) = (0.0, [[0.0; 2]; 2]);
        for (seen, look) in self.pixels.iter().zip(looks) {
            let share = look.share(scale).max(0.0);
            cost += 1.0 - share.powi(3);
            let [kept, all] = &mut says[usize::from(!seen.on_plate)];
            *kept += f64::from(u8::from(share > 0.5));
            *all += 1.0;
        }
        Fit {
            values: *values,
            cost: cost * scale * scale,
            unexplained: scale,
            sigma_px: Vector2::repeat(f64::INFINITY),
            say: says.map(|[kept, all]| kept / f64::max(all, 1.0)),
        }
    }

    /// The fit from a shift on.
    fn from(&self, shift: Vector2<f64>) -> Option<Fit> {
        let mut values = self.begin(shift)?;
        let mut scale = f64::INFINITY;
        let (mut fit, mut last_px) = (None, f64::INFINITY);
        for step in 0..STEPS {
            let looks: Vec<Look> = self.pixels.iter().map(|seen| self.look(seen, &values)).collect();
            let unexplained = SIGMA_OVER_MEDIAN * median(looks.iter().map(|look| look.residual.abs()))?;
            let floor = UNEXPLAINED_MIN * values[2].abs();
            // What is unexplained only falls, or the weights would follow what they leave out.
            scale = f64::min(scale, unexplained.max(floor).max(0.3));
            let normal = self.normal(&looks, &values, scale);
            let factor = normal.information.cholesky()?;
            let mut change = factor.solve(&normal.gradient);
            let far = change.fixed_rows::<2>(0).norm();
            if far > 0.4 {
                change *= 0.4 / far;
            }
            let freedom = (self.pixels.len() - PARAMETERS) as f64;
            let covariance = factor.inverse() * (UNTRUE.powi(2) * normal.squares / freedom);
            fit = Some(Fit {
                sigma_px: Vector2::new(covariance[(0, 0)], covariance[(1, 1)]).map(f64::sqrt),
                ..self.judge(&looks, &values, scale)
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
        fit.filter(|fit| last_px < STEP_MAX_PX.max(STEP_SIGMAS * fit.sigma_px.max()))
    }
}

#[cfg(test)]
mod tests;
