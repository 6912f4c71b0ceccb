//! Pictures of what a search missed and of what it took for a ball, cut out of the frames.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::DetectionScore;
use crate::geometry::Pixel;
use crate::recording::encode_png;
use crate::scene::{Frame, Track};

/// Side of a cut-out, pixels of the frame, and how many of the picture each becomes.
const SIDE_PX: usize = 96;
const SCALE: usize = 4;
/// Length and level of the four marks on the picture's edges that point to the place, picture pixels.
const MARK_PX: usize = 12;
const MARK_LEVEL: u8 = 255;

/// Most pictures of one camera: a detector that finds nothing misses thousands.
const PICTURES_MAX: usize = 1000;

/// A picture that cannot be written.
#[derive(Debug, thiserror::Error)]
#[error("{}: {reason}", path.display())]
pub struct PictureError {
    /// The picture's file.
    pub path: PathBuf,
    /// What is wrong.
    pub reason: String,
}

/// The pictures of one camera, by frame: where, and what it is called.
#[derive(Debug, Default)]
pub struct Pictures {
    wanted: BTreeMap<u64, Vec<(Pixel, String)>>,
    /// Pictures written.
    pub written: usize,
    /// Pictures that would be too many.
    pub left_out: usize,
}

impl Pictures {
    /// Of every miss, and of the middle point of every false track.
    pub fn of(score: &DetectionScore, tracks: &[Track]) -> Self {
        let mut pictures = Self::default();
        for ball in &score.missed {
            let name = format!("miss-pitch{}-frame{}", ball.pitch, ball.frame);
            pictures.want(ball.frame, Pixel::new(ball.x_px, ball.y_px), name);
        }
        let is_false =
            |track: &&Track| track.camera == score.camera && score.false_track_numbers.contains(&track.track);
        for track in tracks.iter().filter(is_false) {
            if let Some(point) = track.points.get(track.points.len() / 2) {
                let name = format!("false-track{}-frame{}", track.track, point.frame);
                pictures.want(point.frame, point.pixel, name);
            }
        }
        pictures
    }

    fn want(&mut self, frame: u64, place: Pixel, name: String) {
        if self.missing() >= PICTURES_MAX {
            self.left_out += 1;
            return;
        }
        self.wanted.entry(frame).or_default().push((place, name));
    }

    /// Pictures whose frame has not come.
    pub fn missing(&self) -> usize {
        self.wanted.values().map(Vec::len).sum()
    }

    /// Writes what is wanted of a frame into `folder`, which is made.
    ///
    /// # Errors
    /// [`PictureError`] with the file.
    pub fn cut(&mut self, frame: &Frame, folder: &Path) -> Result<(), PictureError> {
        for (place, name) in self.wanted.remove(&frame.stamp.frame).unwrap_or_default() {
            let path = folder.join(format!("{name}.png"));
            let failed = |reason: String| PictureError {
                path: path.clone(),
                reason,
            };
            let png = encode_png(&cut_out(frame, place)).map_err(|error| failed(error.to_string()))?;
            std::fs::create_dir_all(folder)
                .and_then(|()| std::fs::write(&path, png))
                .map_err(|error| failed(error.to_string()))?;
            self.written += 1;
        }
        Ok(())
    }
}

/// The surroundings of a place, enlarged, black beyond the frame; marks on the edges point to it.
fn cut_out(frame: &Frame, place: Pixel) -> Frame {
    let side = SIDE_PX * SCALE;
    let (left, top) = (
        place.x.round() as i64 - SIDE_PX as i64 / 2,
        place.y.round() as i64 - SIDE_PX as i64 / 2,
    );
    let level = |x: i64, y: i64| {
        let inside =
            (0..i64::from(frame.width_px)).contains(&x) && (0..i64::from(frame.height_px)).contains(&y);
        let index = (y * i64::from(frame.width_px) + x) as usize;
        frame.bytes().get(index).copied().filter(|_| inside).unwrap_or(0)
    };
    // Where the place is in the picture: pixels have their centres at whole numbers, there as here.
    let at = |value: f64, begin: i64| ((value - begin as f64 + 0.5) * SCALE as f64 - 0.5).round() as usize;
    let (column, row) = (at(place.x, left), at(place.y, top));
    let is_edge = |at: usize| at < MARK_PX || at >= side - MARK_PX;
    let mut pixels = Vec::with_capacity(side * side);
    for y in 0..side {
        for x in 0..side {
            let marked = x == column && is_edge(y) || y == row && is_edge(x);
            pixels.push(if marked {
                MARK_LEVEL
            } else {
                level(left + (x / SCALE) as i64, top + (y / SCALE) as i64)
            });
        }
    }
    Frame {
        stamp: frame.stamp,
        width_px: side as u32,
        height_px: side as u32,
        pixels: Arc::new(pixels),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::FrameStamp;
    use crate::time::StampedMidpoint;

    #[test]
    fn a_place_is_where_the_marks_point() {
        let (width, height) = (200, 150);
        let mut pixels = vec![10u8; width * height];
        pixels[30 * width + 190] = 200;
        let frame = Frame {
            stamp: FrameStamp {
                frame: 7,
                device: None,
                arrival: None,
                stamped: StampedMidpoint::from_nanos(0),
            },
            width_px: width as u32,
            height_px: height as u32,
            pixels: Arc::new(pixels),
        };
        let picture = cut_out(&frame, Pixel::new(190.0, 30.0));
        let side = SIDE_PX * SCALE;
        let bytes = picture.bytes();
        let column = bytes
            .iter()
            .take(side)
            .position(|level| *level == MARK_LEVEL)
            .unwrap();
        let row = bytes.chunks(side).position(|row| row[0] == MARK_LEVEL).unwrap();
        assert_eq!(bytes[row * side + column], 200, "{column} {row}");
        // Right of column 199 there is no picture.
        assert_eq!(bytes[row * side + side - MARK_PX - 1], 0);
        let mut pictures = Pictures::default();
        pictures.want(7, Pixel::new(190.0, 30.0), "miss".to_owned());
        pictures.want(8, Pixel::new(0.0, 0.0), "other".to_owned());
        let folder = tempfile::tempdir().unwrap();
        pictures.cut(&frame, &folder.path().join("new")).unwrap();
        assert!(folder.path().join("new/miss.png").exists());
        assert_eq!((pictures.written, pictures.missing()), (1, 1));
    }
}
