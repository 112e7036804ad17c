//! Shape assertions for public functions.

use std::fmt::Debug;

/// Checks a shape, which only an error in this program can violate.
///
/// # Panics
/// If `found` is not `expected`. The message contains both.
#[track_caller]
pub(crate) fn assert_shape<Shape: Debug + PartialEq>(name: &str, found: Shape, expected: Shape) {
    assert!(found == expected, "{name} has the shape {found:?}, expected {expected:?}");
}
