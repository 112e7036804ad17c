//! Checks of single fields of received messages; errors name the field.

use crate::{Digest, Reason, Refusal, name};

/// A required submessage.
pub(crate) fn required<T>(value: Option<T>, field: &str) -> Result<T, Refusal> {
    value.ok_or_else(|| Refusal::new(Reason::MissingField, field, "must be set"))
}

/// Checks that a name can be shown in logs and on terminals.
pub(crate) fn short_name(name: &str, field: &str) -> Result<(), Refusal> {
    name::check(name, name::LONGEST).map_err(|error| bad_value(field, format!("a name {error}")))
}

/// Exactly 32 bytes.
pub(crate) fn digest(bytes: &[u8], field: &str) -> Result<Digest, Refusal> {
    array(bytes, "a SHA-256", field).map(Digest)
}

/// Exactly `N` bytes, which `what` has.
pub(crate) fn array<const N: usize>(
    bytes: &[u8],
    what: &str,
    field: &str,
) -> Result<[u8; N], Refusal> {
    let found = bytes.len();
    bytes.try_into().map_err(|_| bad_value(field, format!("{found} bytes, {what} has {N}")))
}

/// Checks the length of a list.
pub(crate) fn length(found: usize, expected: usize, field: &str) -> Result<(), Refusal> {
    if found == expected {
        return Ok(());
    }
    Err(Refusal::new(Reason::BadShape, field, format!("{found} entries, expected {expected}")))
}

/// Checks that two numbers are equal.
pub(crate) fn equal(reason: Reason, found: u64, expected: u64, field: &str) -> Result<(), Refusal> {
    if found == expected {
        return Ok(());
    }
    Err(Refusal::new(reason, field, format!("{found}, expected {expected}")))
}

/// A value outside its range.
pub(crate) fn bad_value(field: &str, detail: impl Into<String>) -> Refusal {
    Refusal::new(Reason::BadValue, field, detail)
}

/// Checks that a number of `unit` is from 1 to `max`.
pub(crate) fn from_1_to(max: usize, found: usize, unit: &str, field: &str) -> Result<(), Refusal> {
    if (1..=max).contains(&found) {
        return Ok(());
    }
    Err(bad_value(field, format!("{found} {unit}, expected 1 to {max}")))
}

/// Checks that a count is not 0.
pub(crate) fn positive(value: u64, field: &str) -> Result<(), Refusal> {
    if value > 0 { Ok(()) } else { Err(bad_value(field, "must be at least 1")) }
}

/// Checks that clocks and timers can hold a duration: 1 ns to 1e9 s.
pub(crate) fn seconds(value: f64, field: &str) -> Result<(), Refusal> {
    if (1e-9..=1e9).contains(&value) {
        return Ok(());
    }
    Err(bad_value(field, format!("{value:?} s, expected 1e-9 to 1e9")))
}

/// An unknown value of an enumeration.
pub(crate) fn unknown(field: &str, value: i32) -> Refusal {
    bad_value(field, format!("unknown value {value}"))
}
