//! One camera's detector: takes frames in time order, answers each a few frames later.

use super::blobs::{Blob, BlobFinder, Images, LARGE_SIDE_PX};
use super::bodies::Bodies;
use super::candidates::{apart, candidate, small_ball};
use super::config::DetectorConfig;
use super::dispatch::{Isa, Kernels};
use super::error::{DetectionError, check_size};
use super::expected::ExpectedBall;
use super::finds::{Behind, Finds, Found, Restless};
use super::history::{History, Triple};
use super::kernel::{TILE_HEIGHT_PX, TILE_WIDTH_PX};
use super::looked::Looked;
use super::movers::MoverSearch;
use super::packed::UnpackedFrames;
use super::patches::PatchPool;
use super::scan::Scan;
use super::tiles::TileMap;
use crate::scene::{Detection, Frame, FrameStamp, Track};

/// A blob of fewer pixels is noise.
const AREA_MIN_PX: usize = 4;

/// Frames before and after that show what moves behind a ball: at most so many.
const NEAR_FRAMES_MAX: usize = 3;
/// Large blobs looked into in one frame.
const LARGE_BLOBS_MAX: usize = 8;
/// A blob with a longer side may be a ball and something else, and so many of these are looked into.
const MIXED_SIDE_MIN_PX: usize = 12;
const MIXED_BLOBS_MAX: usize = 16;

/// Who is told the candidates, and may know better where to look.
pub trait Answers {
    /// Before a frame is searched: where are balls expected? Weak candidates there are accepted.
    fn expect(&mut self, _stamp: FrameStamp, _expected: &mut Vec<ExpectedBall>) {}
    /// The candidates of a frame, strongest first.
    fn answer(&mut self, stamp: FrameStamp, detections: &[Detection]);
    /// Whether nothing in the frame last answered, which has these candidates, is being followed: what it was compared
    /// with may change.
    fn is_quiet(&self, detections: &[Detection]) -> bool {
        detections.is_empty()
    }
}

/// What the detector has seen and left out.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct DetectorCounters {
    /// Frames taken.
    pub frames: u64,
    /// Windows begun (after a break in the stamps).
    pub windows: u64,
    /// Frames not searched because too much of the image changed at once.
    pub global_changes: u64,
    /// Candidates left out because a frame had more than `candidates_max`.
    pub candidates_dropped: u64,
    /// Frames whose changed pixels did not all fit.
    pub overflows: u64,
    /// Frames without two others to compare with.
    pub unanswered: u64,
    /// Frames that came between a frame and its answer, summed over all answers.
    pub waited: u64,
}

/// One camera's detector.
pub struct Detector {
    pub(super) config: DetectorConfig,
    pub(super) width_px: usize,
    pub(super) height_px: usize,
    pub(super) kernels: Kernels,
    pub(super) history: History,
    pub(super) unpacked: UnpackedFrames,
    pub(super) scan: Scan,
    lag: usize,
    next_lag: usize,
    next_answer: usize,
    tiles: TileMap,
    blobs: BlobFinder,
    bodies: Bodies,
    movers: MoverSearch,
    looked: Looked,
    pub(super) found: Finds,
    restless: Restless,
    pub(super) expected: Vec<ExpectedBall>,
    pub(super) detections: Vec<Detection>,
    pub(super) patches: PatchPool,
    counters: DetectorCounters,
}

impl Detector {
    /// A detector for frames of this size, on the instruction set that suits the machine.
    pub fn new(config: DetectorConfig, width_px: u32, height_px: u32) -> Self {
        Self::with_isa(config, width_px, height_px, Isa::detect())
    }

    /// The same on a chosen instruction set; answers do not depend on it.
    pub fn with_isa(config: DetectorConfig, width_px: u32, height_px: u32, isa: Isa) -> Self {
        let (width, height) = (width_px as usize, height_px as usize);
        let lag_max = config.lag_frames_max.max(config.lag_frames).max(1);
        Self {
            width_px: width,
            height_px: height,
            kernels: Kernels::new(isa),
            scan: Scan::new(&config, (width, height), isa),
            unpacked: UnpackedFrames::default(),
            history: History::new(3 * lag_max + 2, width, height),
            lag: config.lag_frames.max(1),
            next_lag: config.lag_frames.max(1),
            next_answer: 0,
            tiles: TileMap::new(width, height),
            blobs: BlobFinder::new(width, Kernels::new(isa)),
            bodies: Bodies::new(width, height),
            movers: MoverSearch::new(Kernels::new(isa)),
            looked: Looked::default(),
            found: Finds::new(),
            restless: Restless::new(width, height),
            expected: Vec::with_capacity(64),
            patches: PatchPool::new(config.patch_bytes),
            detections: Vec::with_capacity(config.candidates_max + 1),
            counters: DetectorCounters::default(),
            config,
        }
    }

    /// What was seen and left out so far.
    pub fn counters(&self) -> DetectorCounters {
        self.counters
    }

    /// Frames between a frame and its answer.
    pub fn lag_frames(&self) -> usize {
        self.lag
    }

    /// Takes the next frame; `answers` is told of every frame that is now decided, in order, with its
    /// candidates (strongest first, possibly none).
    pub fn detect(&mut self, frame: &Frame, answers: &mut dyn Answers) -> Result<(), DetectionError> {
        check_size(frame, (self.width_px, self.height_px))?;
        self.begin(frame.stamp, answers);
        if self.evens() {
            self.take_evened(frame.clone(), answers);
            return Ok(());
        }
        let mut changed = self.history.spare_map(self.width_px, self.height_px);
        let previous = self.history.newest();
        let compared = previous.is_some();
        if let Some(previous) = previous {
            let pixels = (frame.bytes(), previous.searched().bytes());
            self.scan.bands(0, self.counters.frames, pixels, &mut changed);
        }
        self.take((frame.clone(), None), compared.then_some(changed), answers);
        Ok(())
    }

    /// Whether the next frame is to be evened first: lamps flicker.
    pub(super) fn evens(&mut self) -> bool {
        self.scan.light.evens()
    }

    /// Scans and takes a frame as under even light.
    pub(super) fn take_evened(&mut self, frame: Frame, answers: &mut dyn Answers) {
        let mut changed = self.history.spare_map(self.width_px, self.height_px);
        let previous = self.history.newest();
        let compared = previous.is_some();
        let even = self.scan.light.even(&frame, previous.map(|seen| &seen.frame));
        if let Some(previous) = previous {
            let searched = even.as_ref().unwrap_or(&frame);
            let pixels = (searched.bytes(), previous.searched().bytes());
            self.scan.bands(0, self.counters.frames, pixels, &mut changed);
        }
        self.take((frame, even), compared.then_some(changed), answers);
    }

    /// Ends the window where this stamp does not follow the last one.
    pub(super) fn begin(&mut self, stamp: FrameStamp, answers: &mut dyn Answers) {
        if let Some(newest) = self.history.newest() {
            let step = stamp.stamped.seconds_since(newest.frame.stamp.stamped.nanos());
            if step <= 0.0 || step > self.config.break_s {
                self.flush(answers);
            }
        }
        if self.history.count() == 0 {
            self.counters.windows += 1;
        }
        self.counters.frames += 1;
    }

    /// Takes a frame that has been scanned, and decides what can be decided.
    pub(super) fn take(
        &mut self,
        frame: (Frame, Option<Frame>),
        changed: Option<TileMap>,
        answers: &mut dyn Answers,
    ) {
        self.history.push(frame, changed);
        self.look_ahead();
        let newest = self.history.count() - 1;
        loop {
            let needs = if self.next_answer < self.lag {
                2 * self.lag
            } else {
                self.lag
            };
            if self.next_answer + needs > newest {
                break;
            }
            self.answer_next(false, answers);
            if self.next_lag != self.lag && answers.is_quiet(&self.detections) {
                tracing::debug!(
                    answered = self.next_answer,
                    from = self.lag,
                    to = self.next_lag,
                    "lag"
                );
                self.lag = self.next_lag;
                // What was seen in front of bodies belongs to the other lag.
                self.looked.restart_at(self.next_answer);
            }
        }
        // A longer lag may be asked for any time: what it looks back on is kept.
        let kept = (2 * self.lag).max(self.config.lag_frames_max);
        self.history.forget_before(self.next_answer.saturating_sub(kept));
    }

    /// Ends the window: decides the frames still open.
    pub fn flush(&mut self, answers: &mut dyn Answers) {
        while self.next_answer < self.history.count() {
            self.answer_next(true, answers);
        }
        self.history.restart();
        self.looked.restart_at(0);
        self.next_answer = 0;
        self.lag = self.next_lag;
    }

    /// Copies of the cut-outs kept for a track that has ended, for the second look ([`super::Refiner`]): of its points, and of
    /// the frames in which more of it may be found.
    pub fn cut_outs(&self, track: &Track) -> PatchPool {
        self.patches.of_track(track)
    }

    /// Copies of the cut-outs kept for the points of a track that may go on: enough to fit them.
    pub fn point_cut_outs(&self, track: &Track) -> PatchPool {
        self.patches.of_points(track)
    }

    /// Chooses the lag for a ball that moves at least this far between frames and covers this length along its
    /// motion, pixels: far enough that it does not overlap itself. Takes effect at the first quiet frame
    /// ([`Answers::is_quiet`]): a shorter lag then answers some frames at once, a longer one waits.
    pub fn adapt_lag(&mut self, step_px: f64, length_px: f64) {
        let frames = ((length_px + 3.0) / step_px.max(0.1)).ceil();
        self.next_lag = (frames as usize).clamp(1, self.config.lag_frames_max.max(1));
    }

    /// A band of the frame and of the one before, read once: tiles that changed, and the noise of its regions.
    pub(super) fn scan_band(
        &mut self,
        band: usize,
        (current, before): (&[u8], &[u8]),
        changed: &mut TileMap,
    ) {
        self.scan
            .bands(band, self.counters.frames, (current, before), changed);
    }

    /// Decides the next frame.
    fn answer_next(&mut self, ended: bool, answers: &mut dyn Answers) {
        let index = self.next_answer;
        self.next_answer += 1;
        self.detections.clear();
        self.found.clear();
        // Out of `self` for now: the images borrow from it while the rest of `self` works.
        let history = std::mem::take(&mut self.history);
        if let Some(triple) = history.triple(index, self.lag, ended) {
            self.counters.waited += (history.count() - 1 - index) as u64;
            let near = history.near(index, near_step(self.lag));
            let like = self.scan.light.lag_from(self.lag);
            let alike = (like != self.lag)
                .then(|| history.triple(index, like, false))
                .flatten();
            self.answer((index, &triple), (near.as_ref(), alike.as_ref()), answers);
        } else {
            self.counters.unanswered += 1;
        }
        self.history = history;
    }

    /// Looks in front of the large bodies of frames whose near ones are there, for their answer later.
    fn look_ahead(&mut self) {
        let step = near_step(self.lag);
        let history = std::mem::take(&mut self.history);
        for index in self.looked.next.max(self.next_answer)..history.count().saturating_sub(step) {
            self.looked.next = index + 1;
            if let Some(near) = history.near(index, step)
                && self.take_tiles(&near)
            {
                let images = self.images(&near);
                self.look_before_bodies((index, &images), near.current.frame.stamp);
            }
        }
        self.history = history;
    }

    /// The tiles that changed before and after a frame; `false` where they are too many.
    fn take_tiles(&mut self, triple: &Triple<'_>) -> bool {
        self.tiles
            .set_both(triple.current.changed.as_ref(), triple.changed_after);
        let bound = self.config.busy_fraction_max * ((self.width_px * self.height_px) as f64)
            / ((TILE_WIDTH_PX * TILE_HEIGHT_PX) as f64);
        self.tiles.count() as f64 <= bound.max(16.0)
    }

    fn images<'a>(&self, triple: &Triple<'a>) -> Images<'a> {
        Images {
            kernels: self.kernels,
            width_px: self.width_px,
            height_px: self.height_px,
            current: triple.current.searched().bytes(),
            one: triple.one.searched().bytes(),
            other: triple.other.searched().bytes(),
        }
    }

    /// The images as they came, not evened.
    fn images_as_seen<'a>(&self, triple: &Triple<'a>) -> Images<'a> {
        Images {
            current: triple.current.frame.bytes(),
            one: triple.one.frame.bytes(),
            other: triple.other.frame.bytes(),
            ..self.images(triple)
        }
    }

    fn answer(
        &mut self,
        (index, triple): (usize, &Triple<'_>),
        (near, alike): (Option<&Triple<'_>>, Option<&Triple<'_>>),
        answers: &mut dyn Answers,
    ) {
        let stamp = triple.current.frame.stamp;
        if !self.take_tiles(triple) {
            self.counters.global_changes += 1;
            answers.answer(stamp, &[]);
            return;
        }
        let images = self.images(triple);
        let near = near.map(|near| self.images(near));
        if let Some(near) = near.as_ref().filter(|_| self.looked.next <= index) {
            self.looked.next = index + 1;
            self.look_before_bodies((index, near), stamp);
        }
        if self.looked.take_rest(index, &mut self.tiles) {
            self.blobs.fetch_ahead(&images, &self.tiles);
        }
        while let Some((found, spot)) = self.looked.take_spot(index) {
            self.found.push(Found {
                detection: found,
                blob: spot,
                behind: Behind::Near,
                expected: false,
            });
        }
        self.find_blobs(&images);
        self.look_into_blobs(&images, near.as_ref(), stamp);
        self.expected.clear();
        answers.expect(stamp, &mut self.expected);
        self.look_where_expected(&images, stamp);
        let extra = self
            .found
            .keep_strongest(self.config.candidates_max, &self.restless);
        self.counters.candidates_dropped += extra as u64;
        // What is behind a ball is seen best in the light that is on it, and as it came: evened, a ball across the border of
        // two cells has a step.
        let far = alike.map_or(images, |alike| self.images_as_seen(alike));
        for found in self.found.all() {
            let behind = near
                .as_ref()
                .filter(|_| found.behind == Behind::Near)
                .unwrap_or(&far);
            self.patches.keep(behind, &found.blob, &found.detection);
            self.detections.push(found.detection);
        }
        self.keep_where_missed(&far, stamp);
        answers.answer(stamp, &self.detections);
    }

    /// The blobs that stand out, strongest first.
    fn find_blobs(&mut self, images: &Images<'_>) {
        self.blobs.find(images, &self.tiles, &self.scan.noise);
        self.counters.overflows += u64::from(self.blobs.overflowed);
        let sigmas = self.config.threshold_sigmas;
        let blobs = &mut self.blobs.blobs;
        blobs.retain(|blob| {
            f64::from(blob.peak) > sigmas * f64::from(blob.difference_sigma) && blob.area_px >= AREA_MIN_PX
        });
        let extra = blobs.len().saturating_sub(self.config.candidates_max);
        self.counters.candidates_dropped += extra as u64;
        self.restless.learn(blobs);
        if extra > 0 {
            // The moments are dear: only the strongest blobs get them.
            let rank = |blob: &Blob| blob.significance() * self.restless.share(blob);
            blobs.sort_unstable_by(|a, b| rank(b).total_cmp(&rank(a)));
            blobs.truncate(self.config.candidates_max);
        }
        blobs.sort_unstable_by(|a, b| b.significance().total_cmp(&a.significance()));
    }

    /// Spots in front of large bodies, where there are many; their tiles are not searched further.
    fn look_before_bodies(&mut self, (index, near): (usize, &Images<'_>), stamp: FrameStamp) {
        self.bodies.find(&mut self.tiles);
        self.looked.keep_rest(index, &self.tiles);
        for body in &self.bodies.large {
            let (band, column) = body.middle();
            let sigma = self.scan.noise.difference_sigma(band, column);
            let limits = spot_limits(&self.config, self.lag, sigma);
            let tiles = self.bodies.tiles(body);
            for (moments, spot) in self.movers.find_in_front(near, tiles, limits, sigma) {
                if let Some(found) = candidate(&self.config, stamp, &moments) {
                    self.looked.keep_spot(index, found, spot);
                }
            }
        }
    }

    /// Small blobs are candidates; in larger ones spots in front of what moves are.
    fn look_into_blobs(&mut self, images: &Images<'_>, near: Option<&Images<'_>>, stamp: FrameStamp) {
        let (mut large, mut mixed) = (LARGE_BLOBS_MAX, MIXED_BLOBS_MAX);
        for blob in &self.blobs.blobs {
            let whole = if blob.side_px() > LARGE_SIDE_PX {
                None
            } else {
                small_ball(images, blob).and_then(|m| candidate(&self.config, stamp, &m))
            };
            if let Some(found) = whole {
                self.found.push(Found {
                    detection: found,
                    blob: *blob,
                    behind: Behind::Far,
                    expected: false,
                });
            }
            // Larger than a ball: a player with a ball before him, or a ball that touches something that moves.
            let budget = if blob.side_px() > LARGE_SIDE_PX {
                &mut large
            } else if blob.side_px() > MIXED_SIDE_MIN_PX {
                &mut mixed
            } else {
                continue;
            };
            let (Some(left), Some(near)) = (budget.checked_sub(1), near) else {
                continue;
            };
            *budget = left;
            let limits = spot_limits(&self.config, self.lag, blob.difference_sigma);
            for (moments, spot) in self.movers.find(near, blob, limits) {
                if let Some(found) = candidate(&self.config, stamp, &moments)
                    && whole.is_none_or(|whole| apart(&whole, &found))
                {
                    self.found.push(Found {
                        detection: found,
                        blob: spot,
                        behind: Behind::Near,
                        expected: false,
                    });
                }
            }
        }
    }
}

/// Frames before and after that show what moves behind a ball.
fn near_step(lag: usize) -> usize {
    lag.div_ceil(2).min(NEAR_FRAMES_MAX)
}

/// How far what moves behind a ball may have moved, and what a spot in front of it has to change by.
fn spot_limits(config: &DetectorConfig, lag: usize, difference_sigma: f32) -> (usize, u8) {
    let sigmas = 0.5 * config.threshold_sigmas * f64::from(difference_sigma);
    (near_step(lag) + 1, sigmas.clamp(1.0, 254.0) as u8)
}
