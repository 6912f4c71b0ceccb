//! What the emulated camera sees: a script of frames with their times, and a test pattern.

use std::ops::Deref;
use std::sync::Arc;
use std::time::{Duration, Instant};

use crossbeam_channel::Receiver;

/// The pixels of one frame, shared.
pub type Pixels = Arc<dyn Deref<Target = [u8]> + Send + Sync>;

/// One frame of a script.
#[derive(Clone)]
pub struct ScriptedFrame {
    /// Begin of the exposure after the script's begin, nanoseconds; never falls.
    pub begin_ns: i64,
    /// Mono8, rows from the top.
    pub pixels: Pixels,
}

/// Shape of every frame of a script.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScriptShape {
    /// Columns.
    pub width_px: u32,
    /// Rows.
    pub height_px: u32,
    /// Frames a second.
    pub rate_hz: f64,
    /// Exposure, seconds.
    pub exposure_s: f64,
}

impl ScriptShape {
    /// Bytes of a frame.
    pub fn bytes(&self) -> usize {
        self.width_px as usize * self.height_px as usize
    }
    fn period(&self) -> Duration {
        Duration::from_secs_f64(1.0 / self.rate_hz.max(0.1))
    }
}

/// Frames in order, as a thread may read them.
pub type Script = Box<dyn Iterator<Item = ScriptedFrame> + Send>;

/// The same frames again and again, each time `every` after the last; for ever. All of them stay in memory.
pub fn repeated(frames: Vec<ScriptedFrame>, every: Duration) -> Script {
    let every_ns = i64::try_from(every.as_nanos()).unwrap_or(i64::MAX);
    Box::new((0_i64..).flat_map(move |round| {
        let shift_ns = round.saturating_mul(every_ns);
        let again = frames.clone();
        again.into_iter().map(move |frame| ScriptedFrame {
            begin_ns: frame.begin_ns.saturating_add(shift_ns),
            pixels: frame.pixels,
        })
    }))
}

/// A grey field with a bright ball that crosses it every 64 frames: for trying a camera out.
pub fn pattern(shape: ScriptShape) -> Script {
    let frames: Vec<Pixels> = (0..16).map(|phase| draw(&shape, phase)).collect();
    let period_s = shape.period().as_secs_f64();
    Box::new((0_i64..).filter_map(move |k| {
        let pixels = frames.get(usize::try_from(k % 16).ok()?)?.clone();
        Some(ScriptedFrame {
            begin_ns: (k as f64 * period_s * 1e9).round() as i64,
            pixels,
        })
    }))
}

fn draw(shape: &ScriptShape, phase: u32) -> Pixels {
    let (width, height) = (shape.width_px as usize, shape.height_px as usize);
    let mut pixels = vec![0_u8; width * height];
    let centre = (
        (f64::from(phase) + 0.5) / 16.0 * width as f64,
        0.5 * height as f64,
    );
    for (y, row) in pixels.chunks_mut(width.max(1)).enumerate() {
        for (x, pixel) in row.iter_mut().enumerate() {
            let far = (x as f64 - centre.0).hypot(y as f64 - centre.1);
            *pixel = if far < 5.0 {
                220
            } else {
                60 + ((x * 7 + y * 13) % 8) as u8
            };
        }
    }
    Arc::new(pixels)
}

/// One exposure of the camera.
pub(super) struct Slot {
    pub begin: Instant,
    pub pixels: Pixels,
}

/// What a camera shows when its script has nothing for it: before its begin, between two clips, after its end.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Idle {
    /// The first or last frame again and again: a camera does not stop because nothing happens.
    #[default]
    Still,
    /// Nothing, as a triggered camera: the receiver sees the script's frames and no others.
    Silent,
}

/// A gap longer than this is between two clips, not a lost frame or two.
const CLIP_GAP: Duration = Duration::from_millis(300);

/// Lays a script on the host's time line.
pub(super) struct Timeline {
    shape: ScriptShape,
    frames: Receiver<ScriptedFrame>,
    between: Idle,
    /// When the script begins; fixed by the first acquisition unless told.
    epoch: Option<Instant>,
    next: Option<ScriptedFrame>,
    last: Option<Slot>,
    /// Whether the script's next frame is one to wait for with idle exposures.
    idle: bool,
}

impl Timeline {
    pub fn new(
        shape: ScriptShape,
        frames: Receiver<ScriptedFrame>,
        (epoch, between): (Option<Instant>, Idle),
    ) -> Self {
        Self {
            shape,
            frames,
            between,
            epoch,
            next: None,
            last: None,
            idle: true,
        }
    }

    /// The first exposure at or after `earliest`, in order; `None` if there is none any more.
    pub fn next_after(&mut self, earliest: Instant) -> Option<Slot> {
        let epoch = *self.epoch.get_or_insert(earliest);
        let period = self.shape.period();
        loop {
            if self.next.is_none() {
                self.next = self.frames.recv().ok();
            }
            let Some(next) = &self.next else {
                return self.idle_after_end(earliest, period);
            };
            let begin = epoch + Duration::from_nanos(u64::try_from(next.begin_ns).unwrap_or(0));
            // An idle exposure where a whole one still fits before the script's: before its begin, and between clips.
            // A shorter gap is a frame that the recording does not have, and stays one.
            let due = match &self.last {
                Some(last) => (last.begin + period).max(earliest),
                None => earliest,
            };
            let clip = self
                .last
                .as_ref()
                .is_some_and(|last| begin.saturating_duration_since(last.begin) > CLIP_GAP);
            self.idle = self.between == Idle::Still && (self.idle || clip);
            if self.idle && begin.checked_sub(period / 2).is_some_and(|latest| due < latest) {
                // On the script's own grid, counted back from its begin.
                let ahead = begin.duration_since(due).as_secs_f64() / period.as_secs_f64();
                let back = period.mul_f64(ahead.floor().max(1.0));
                let still = self
                    .last
                    .as_ref()
                    .map_or(&next.pixels, |last| &last.pixels)
                    .clone();
                let slot = Slot {
                    begin: begin - back,
                    pixels: still,
                };
                return Some(self.remember(slot));
            }
            let Some(next) = self.next.take() else { continue };
            self.idle = false;
            let slot = Slot {
                begin,
                pixels: next.pixels,
            };
            if begin < earliest {
                self.remember(slot);
                continue;
            }
            return Some(self.remember(slot));
        }
    }

    fn idle_after_end(&mut self, earliest: Instant, period: Duration) -> Option<Slot> {
        let last = self.last.as_ref().filter(|_| self.between != Idle::Silent)?;
        let passed = earliest.saturating_duration_since(last.begin).as_secs_f64() / period.as_secs_f64();
        let begin = last.begin + period.mul_f64(passed.ceil().max(1.0));
        let still = last.pixels.clone();
        let slot = Slot { begin, pixels: still };
        Some(self.remember(slot))
    }

    fn remember(&mut self, slot: Slot) -> Slot {
        self.last = Some(Slot {
            begin: slot.begin,
            pixels: slot.pixels.clone(),
        });
        slot
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_repeated_script_goes_on_at_its_period() {
        let frame = |begin_ns| ScriptedFrame {
            begin_ns,
            pixels: Arc::new(vec![0; 4]),
        };
        let script = repeated(vec![frame(3), frame(8)], Duration::from_nanos(100));
        let begins: Vec<i64> = script.take(5).map(|f| f.begin_ns).collect();
        assert_eq!(begins, [3, 8, 103, 108, 203]);
    }

    #[test]
    fn the_camera_idles_before_and_after_its_script() {
        let shape = ScriptShape {
            width_px: 8,
            height_px: 8,
            rate_hz: 100.0,
            exposure_s: 0.001,
        };
        let (send, frames) = crossbeam_channel::unbounded();
        for k in 0..3_u8 {
            let pixels: Pixels = Arc::new(vec![k; 64]);
            send.send(ScriptedFrame {
                begin_ns: i64::from(k) * 10_000_000,
                pixels,
            })
            .unwrap();
        }
        drop(send);
        let start = Instant::now();
        let ms = Duration::from_millis;
        let mut line = Timeline::new(shape, frames, (Some(start + ms(35)), Idle::Still));
        let mut seen = Vec::new();
        let mut now = start;
        for _ in 0..8 {
            let slot = line.next_after(now).unwrap();
            seen.push(((slot.begin - start).as_millis(), slot.pixels[0]));
            now = slot.begin + ms(1);
        }
        // 35 ms − 3 periods = 5 ms; then the script at 35, 45, 55; then on at its rate.
        assert_eq!(
            seen,
            [
                (5, 0),
                (15, 0),
                (25, 0),
                (35, 0),
                (45, 1),
                (55, 2),
                (65, 2),
                (75, 2)
            ]
        );
        // What was missed is skipped, on the same grid.
        assert_eq!(
            (line.next_after(start + ms(91)).unwrap().begin - start).as_millis(),
            95
        );
    }
}
