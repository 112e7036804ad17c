//! Small readers for fields of received messages, each of which names the field it refuses.

use crate::{Digest, Reason, Refusal};

/// A submessage that must be there.
pub(crate) fn required<T>(value: Option<T>, field: &str) -> Result<T, Refusal> {
    value.ok_or_else(|| Refusal::new(Reason::MissingField, field, "must be set"))
}

/// Longest name by which a peer is called in logs, bytes.
const MAX_NAME_BYTES: usize = 128;

/// A name that can be kept and stands in one line of a log.
pub(crate) fn short_line(name: &str, field: &str) -> Result<(), Refusal> {
    let bytes = name.len();
    let short = bytes <= MAX_NAME_BYTES && !name.contains(char::is_control);
    let detail = || format!("{bytes} bytes; a name is one line of at most {MAX_NAME_BYTES}");
    hold(short.then_some(()).ok_or_else(detail), field)
}

/// Exactly 32 bytes.
pub(crate) fn digest(bytes: &[u8], field: &str) -> Result<Digest, Refusal> {
    let found = bytes.len();
    bytes.try_into().map(Digest).map_err(|_| {
        Refusal::new(Reason::BadValue, field, format!("{found} bytes, a SHA-256 has 32"))
    })
}

/// A list of known length.
pub(crate) fn length(found: usize, expected: usize, field: &str) -> Result<(), Refusal> {
    if found == expected {
        return Ok(());
    }
    Err(Refusal::new(Reason::BadShape, field, format!("{found} entries, expected {expected}")))
}

/// A number that must equal another one.
pub(crate) fn equal(reason: Reason, found: u64, expected: u64, field: &str) -> Result<(), Refusal> {
    if found == expected {
        return Ok(());
    }
    Err(Refusal::new(reason, field, format!("{found}, expected {expected}")))
}

/// A value that must hold a condition, which `detail` describes.
pub(crate) fn hold(condition: Result<(), String>, field: &str) -> Result<(), Refusal> {
    condition.map_err(|detail| Refusal::new(Reason::BadValue, field, detail))
}

/// A count that is not 0.
pub(crate) fn positive(value: u64, field: &str) -> Result<(), Refusal> {
    hold((value > 0).then_some(()).ok_or_else(|| "must be at least 1".to_owned()), field)
}

/// A time that passes.
pub(crate) fn seconds(value: f64, field: &str) -> Result<(), Refusal> {
    let good = value.is_finite() && value > 0.0;
    hold(good.then_some(()).ok_or_else(|| format!("{value} s is no positive time")), field)
}

/// An enumeration's value that this version does not know.
pub(crate) fn unknown(field: &str, value: i32) -> Refusal {
    Refusal::new(Reason::BadValue, field, format!("unknown value {value}"))
}
