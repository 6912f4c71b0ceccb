//! The working picture: the still background plus what moves, restored after every frame.

/// A small picture with transparency: out = behind·(1 − coverage) + light.
#[derive(Debug, Clone)]
pub(super) struct Patch {
    /// Column of its first pixel.
    pub left: i64,
    /// Row of its first pixel.
    pub top: i64,
    /// Columns.
    pub width: usize,
    /// Row by row.
    pub coverage: Vec<f32>,
    /// Grey levels times coverage.
    pub light: Vec<f32>,
}

/// Part of a picture, end exclusive.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Region {
    pub left: usize,
    pub top: usize,
    pub right: usize,
    pub bottom: usize,
}

/// The working picture.
pub(super) struct Canvas {
    pub width: usize,
    pub height: usize,
    /// Grey levels, row by row.
    pub tones: Vec<f32>,
    dirty: Vec<Region>,
}

impl Canvas {
    pub(super) fn new(background: &[f32], width: usize) -> Self {
        Self {
            width,
            height: background.len() / width.max(1),
            tones: background.to_vec(),
            dirty: Vec::new(),
        }
    }

    /// Puts the background back wherever something was drawn.
    pub(super) fn restore(&mut self, background: &[f32]) {
        for region in self.dirty.drain(..) {
            for y in region.top..region.bottom {
                let span = y * self.width + region.left..y * self.width + region.right;
                self.tones[span.clone()].copy_from_slice(&background[span]);
            }
        }
    }

    /// The part of the picture within these bounds, to be drawn on; `None` if there is none.
    pub(super) fn region(&mut self, left: f64, top: f64, right: f64, bottom: f64) -> Option<Region> {
        let clip = |value: f64, length: usize| value.clamp(0.0, length as f64) as usize;
        let region = Region {
            left: clip(left.floor(), self.width),
            top: clip(top.floor(), self.height),
            right: clip(right.ceil() + 1.0, self.width),
            bottom: clip(bottom.ceil() + 1.0, self.height),
        };
        let some = region.left < region.right && region.top < region.bottom;
        if some {
            self.dirty.push(region);
        }
        some.then_some(region)
    }

    /// One row of a region.
    pub(super) fn row(&mut self, region: &Region, y: usize) -> &mut [f32] {
        &mut self.tones[y * self.width + region.left..y * self.width + region.right]
    }

    /// Lays a patch over the picture.
    pub(super) fn compose(&mut self, patch: &Patch) {
        let height = patch.coverage.len() / patch.width.max(1);
        let (left, top) = (patch.left as f64, patch.top as f64);
        let (right, bottom) = (left + patch.width as f64 - 1.0, top + height as f64 - 1.0);
        let Some(region) = self.region(left, top, right, bottom) else {
            return;
        };
        for y in region.top..region.bottom {
            let start =
                (y as i64 - patch.top) as usize * patch.width + (region.left as i64 - patch.left) as usize;
            let over = start..start + (region.right - region.left);
            let (Some(coverage), Some(light)) = (patch.coverage.get(over.clone()), patch.light.get(over))
            else {
                continue;
            };
            for ((tone, c), l) in self.row(&region, y).iter_mut().zip(coverage).zip(light) {
                *tone = *tone * (1.0 - c) + l;
            }
        }
    }
}
