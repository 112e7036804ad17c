//! Reads a density's stored arrays. Errors name the array.

use policy::arrays::{Array, NamedArrays};

use crate::error::MarlError;

/// The array `name` as f64, if it has this shape. `None` allows any length.
pub(super) fn reals(
    arrays: &NamedArrays,
    name: &str,
    expected: &[Option<usize>],
) -> Result<Vec<f64>, MarlError> {
    match arrays.get(name) {
        Some(Array::F64 { shape, data }) if fits(shape, expected) => Ok(data.clone()),
        _ => Err(wrong(name, expected)),
    }
}

/// The array `name` as i64, if it has this shape.
pub(super) fn integers(
    arrays: &NamedArrays,
    name: &str,
    expected: &[Option<usize>],
) -> Result<Vec<i64>, MarlError> {
    match arrays.get(name) {
        Some(Array::I64 { shape, data }) if fits(shape, expected) => Ok(data.clone()),
        _ => Err(wrong(name, expected)),
    }
}

fn fits(shape: &[usize], expected: &[Option<usize>]) -> bool {
    let same = |(found, wanted): (&usize, &Option<usize>)| wanted.is_none_or(|w| w == *found);
    shape.len() == expected.len() && shape.iter().zip(expected).all(same)
}

fn wrong(name: &str, expected: &[Option<usize>]) -> MarlError {
    let length = |axis: &Option<usize>| axis.map_or("any".to_owned(), |axis| axis.to_string());
    let shape = expected.iter().map(length).collect::<Vec<_>>().join(", ");
    MarlError::Restore(format!("{name} is missing or has another type or shape than [{shape}]"))
}
