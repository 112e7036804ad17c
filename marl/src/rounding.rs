//! Rounding to single precision. Values, returns and advantages are computed in f64 and rounded as the networks' numbers
//! are.

/// `x` rounded to single precision.
pub(crate) fn round(x: f64) -> f64 {
    f64::from(x as f32)
}

/// [`round`] of every value.
pub(crate) fn rounded(numbers: Vec<f64>) -> Vec<f64> {
    numbers.into_iter().map(round).collect()
}
