//! Typed access to the arrays of a checkpoint; each refusal names the array.

use policy::arrays::{Array, NamedArrays};

use super::CheckpointError;

/// An `F64` array of `count` numbers.
pub(crate) fn f64s<'a>(
    arrays: &'a NamedArrays,
    name: &str,
    count: usize,
) -> Result<&'a [f64], CheckpointError> {
    let data = all_f64s(arrays, name)?;
    length(name, data.len(), count)?;
    Ok(data)
}

/// An `F64` array of any length.
pub(crate) fn all_f64s<'a>(
    arrays: &'a NamedArrays,
    name: &str,
) -> Result<&'a [f64], CheckpointError> {
    match get(arrays, name)? {
        Array::F64 { data, .. } => Ok(data),
        _ => Err(wrong(name, "is not of type F64")),
    }
}

/// An `F32` array of `count` numbers.
pub(crate) fn f32s<'a>(
    arrays: &'a NamedArrays,
    name: &str,
    count: usize,
) -> Result<&'a [f32], CheckpointError> {
    match get(arrays, name)? {
        Array::F32 { data, .. } => length(name, data.len(), count).map(|()| data.as_slice()),
        _ => Err(wrong(name, "is not of type F32")),
    }
}

/// An `I64` array of `count` numbers, none below zero.
pub(crate) fn counts(
    arrays: &NamedArrays,
    name: &str,
    count: usize,
) -> Result<Vec<u64>, CheckpointError> {
    let Array::I64 { data, .. } = get(arrays, name)? else {
        return Err(wrong(name, "is not of type I64"));
    };
    length(name, data.len(), count)?;
    let unsigned = |value: &i64| {
        u64::try_from(*value).map_err(|_| wrong(name, &format!("holds {value}, below zero")))
    };
    data.iter().map(unsigned).collect()
}

/// One number of type `I64`, not below zero.
pub(crate) fn one_count(arrays: &NamedArrays, name: &str) -> Result<u64, CheckpointError> {
    counts(arrays, name, 1).map(|values| values[0])
}

/// A `U8` array.
pub(crate) fn bytes<'a>(arrays: &'a NamedArrays, name: &str) -> Result<&'a [u8], CheckpointError> {
    match get(arrays, name)? {
        Array::U8 { data, .. } => Ok(data),
        _ => Err(wrong(name, "is not of type U8")),
    }
}

fn get<'a>(arrays: &'a NamedArrays, name: &str) -> Result<&'a Array, CheckpointError> {
    arrays.get(name).ok_or_else(|| wrong(name, "is missing"))
}

fn length(name: &str, found: usize, expected: usize) -> Result<(), CheckpointError> {
    if found == expected {
        return Ok(());
    }
    Err(wrong(name, &format!("has {found} elements, expected {expected}")))
}

/// The error that the array `name` does not fit.
pub(super) fn wrong(name: &str, detail: &str) -> CheckpointError {
    CheckpointError::Other(format!("checkpoint: array {name} {detail}"))
}
