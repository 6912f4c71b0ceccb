//! The textbook detector in OpenCV, one thread: absdiff, threshold, then contours or components. What the bench
//! compares with.

use opencv::core::{self, Mat, Point, Vector};
use opencv::imgproc;

use super::VisionError;

/// Keeps its images from call to call, as a fair opponent would.
#[derive(Debug)]
pub struct DifferenceBaseline {
    difference: Mat,
    mask: Mat,
    labels: Mat,
    statistics: Mat,
    centroids: Mat,
}

impl Default for DifferenceBaseline {
    fn default() -> Self {
        Self::new()
    }
}

impl DifferenceBaseline {
    /// On one thread.
    pub fn new() -> Self {
        // Without threads to set there is one anyway.
        let _ = core::set_num_threads(1);
        Self {
            difference: Mat::default(),
            mask: Mat::default(),
            labels: Mat::default(),
            statistics: Mat::default(),
            centroids: Mat::default(),
        }
    }

    /// Number of contours of what differs by more than `threshold` levels between two images of this width.
    ///
    /// # Errors
    /// OpenCV's.
    pub fn contours(
        &mut self,
        current: &[u8],
        previous: &[u8],
        width_px: i32,
        threshold: f64,
    ) -> Result<usize, VisionError> {
        self.mark(current, previous, width_px, threshold)?;
        let mut contours: Vector<Vector<Point>> = Vector::new();
        let (mode, method) = (imgproc::RETR_EXTERNAL, imgproc::CHAIN_APPROX_SIMPLE);
        imgproc::find_contours(&self.mask, &mut contours, mode, method, Point::new(0, 0))?;
        Ok(contours.len())
    }

    /// Number of connected components of the same, with their statistics.
    ///
    /// # Errors
    /// OpenCV's.
    pub fn components(
        &mut self,
        current: &[u8],
        previous: &[u8],
        width_px: i32,
        threshold: f64,
    ) -> Result<i32, VisionError> {
        self.mark(current, previous, width_px, threshold)?;
        let count = imgproc::connected_components_with_stats(
            &self.mask,
            &mut self.labels,
            &mut self.statistics,
            &mut self.centroids,
            8,
            core::CV_32S,
        )?;
        Ok(count)
    }

    /// Where two images differ by more than a threshold.
    fn mark(
        &mut self,
        current: &[u8],
        previous: &[u8],
        width_px: i32,
        threshold: f64,
    ) -> Result<(), VisionError> {
        let rows = current.len() as i32 / width_px.max(1);
        let current = Mat::new_rows_cols_with_data(rows, width_px, current)?;
        let previous = Mat::new_rows_cols_with_data(rows, width_px, previous)?;
        core::absdiff(&current, &previous, &mut self.difference)?;
        imgproc::threshold(
            &self.difference,
            &mut self.mask,
            threshold,
            255.0,
            imgproc::THRESH_BINARY,
        )?;
        Ok(())
    }
}
