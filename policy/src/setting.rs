//! Checks of settings against their ranges, for every crate with settings.

use std::fmt::Display;
use std::ops::RangeBounds;

use thiserror::Error;

/// A setting outside its range. The range names every other setting that decides it.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{key} = {found} is out of range: {range}")]
pub struct SettingError {
    /// Key in the run's configuration.
    pub key: &'static str,
    /// Value found.
    pub found: String,
    /// Values allowed.
    pub range: String,
}

impl SettingError {
    /// The error of the setting `key`, whose value is not in `range`.
    pub fn new(key: &'static str, found: impl Display, range: impl Into<String>) -> Self {
        Self { key, found: short(&found.to_string()), range: range.into() }
    }
}

/// A number with an exponent if it has more than 24 characters; other texts as they are.
fn short(text: &str) -> String {
    match text.parse::<f64>() {
        Ok(number) if text.len() > 24 => format!("{number:e}"),
        _ => text.to_owned(),
    }
}

/// Refuses a value that is not `allowed`; `range` describes the allowed values.
///
/// # Errors
/// Names the key, the value and the range.
pub fn within<T: PartialOrd + Display>(
    key: &'static str,
    value: T,
    allowed: impl RangeBounds<T>,
    range: &str,
) -> Result<(), SettingError> {
    if allowed.contains(&value) { Ok(()) } else { Err(SettingError::new(key, value, range)) }
}

/// Refuses a value below `least` or above `most`.
///
/// # Errors
/// As [`within`].
pub fn between<T: PartialOrd + Display>(
    key: &'static str,
    value: T,
    least: T,
    most: T,
) -> Result<(), SettingError> {
    let range = format!("{least} to {most}");
    within(key, value, least..=most, &range)
}

/// Refuses a number that is not finite and above 0.
///
/// # Errors
/// As [`within`].
pub fn positive(key: &'static str, value: f64) -> Result<(), SettingError> {
    within(key, value, f64::MIN_POSITIVE..f64::INFINITY, "a finite number above 0")
}

/// Refuses a number that is not finite and at least 0.
///
/// # Errors
/// As [`within`].
pub fn not_negative(key: &'static str, value: f64) -> Result<(), SettingError> {
    within(key, value, 0.0..f64::INFINITY, "a finite number of at least 0")
}

/// Refuses a learning rate outside `(0, 1]`: an optimiser step of Adam moves each weight by about the learning rate.
///
/// # Errors
/// As [`within`].
pub fn learning_rate(key: &'static str, value: f64) -> Result<(), SettingError> {
    within(key, value, f64::MIN_POSITIVE..=1.0, "above 0, at most 1")
}

/// Refuses 0.
///
/// # Errors
/// As [`within`].
pub fn count(key: &'static str, value: usize) -> Result<(), SettingError> {
    within(key, value, 1.., "at least 1")
}

/// Refuses a value that is not a multiple of `unit`, the value of `unit_key`.
///
/// # Errors
/// As [`within`].
pub fn multiple(
    key: &'static str,
    value: usize,
    unit_key: &str,
    unit: usize,
) -> Result<(), SettingError> {
    if value.is_multiple_of(unit) {
        return Ok(());
    }
    Err(SettingError::new(key, value, format!("a multiple of {unit_key} = {unit}")))
}

/// Refuses a value that does not divide `whole`, the value of `whole_key`.
///
/// # Errors
/// As [`within`].
pub fn divisor(
    key: &'static str,
    value: usize,
    whole_key: &str,
    whole: usize,
) -> Result<(), SettingError> {
    if whole.is_multiple_of(value) {
        return Ok(());
    }
    Err(SettingError::new(key, value, format!("a divisor of {whole_key} = {whole}")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_outside_its_range_is_refused_with_key_value_and_range() {
        let nan = positive("a.b", f64::NAN).unwrap_err().to_string();
        assert_eq!(nan, "a.b = NaN is out of range: a finite number above 0");
        for (refused, range) in [
            (between("a.b", 5, 1, 4), "5 is out of range: 1 to 4"),
            (not_negative("a.b", -1.0), "-1 is out of range: a finite number of at least 0"),
            (learning_rate("a.b", 1.5), "1.5 is out of range: above 0, at most 1"),
            (learning_rate("a.b", 1e300), "1e300 is out of range: above 0, at most 1"),
            (count("a.b", 0), "0 is out of range: at least 1"),
            (multiple("a.b", 5, "a.c", 2), "5 is out of range: a multiple of a.c = 2"),
            (divisor("a.b", 3, "a.c", 20), "3 is out of range: a divisor of a.c = 20"),
        ] {
            assert_eq!(refused.unwrap_err().to_string(), format!("a.b = {range}"));
        }
        let taken = [between("a", 4, 1, 4), count("a", 1), multiple("a", 0, "b", 2)];
        assert_eq!(taken, [Ok(()), Ok(()), Ok(())]);
    }
}
