//! Arrays between Python and the crates, as bytes: little-endian f32; and errors of the crates.

use pyo3::PyErr;
use pyo3::exceptions::PyValueError;
use s2mia::embedded;

/// Numbers as bytes that NumPy reads in place.
pub(crate) fn bytes(numbers: impl Iterator<Item = f32>) -> Vec<u8> {
    numbers.flat_map(f32::to_le_bytes).collect()
}

/// The numbers of an array's bytes; what is left of an incomplete one does not count.
pub(crate) fn numbers(bytes: &[u8]) -> Vec<f32> {
    let (words, _) = bytes.as_chunks();
    words.iter().map(|word| f32::from_le_bytes(*word)).collect()
}

/// An error in one line.
pub(crate) fn refused(error: embedded::Error) -> PyErr {
    PyValueError::new_err(embedded::line(&error))
}
