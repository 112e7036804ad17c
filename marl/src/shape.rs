//! Assertions of shapes at the entry of public functions.

use std::fmt::Debug;

/// Checks a shape that a caller inside this program could get wrong.
///
/// # Panics
/// If `found` is not `expected`; the message has both.
#[track_caller]
pub(crate) fn assert_shape<Shape: Debug + PartialEq>(name: &str, found: Shape, expected: Shape) {
    assert!(found == expected, "{name} has the shape {found:?}, expected {expected:?}");
}
