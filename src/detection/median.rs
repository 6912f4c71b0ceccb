//! The middle of some values.

/// σ of a normal law over the median of distances from its middle.
pub const SIGMA_OVER_MEDIAN: f64 = 1.4826;

/// The value that half of them do not exceed; `None` of none.
pub fn median(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.into_iter().collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}
