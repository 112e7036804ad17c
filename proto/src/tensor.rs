//! Tensors in messages. Type, shape and length are checked before values are decoded.

use std::fmt::{Display, LowerExp};

use bytes::Bytes;

use crate::{Reason, Refusal, wire};

/// Largest accepted magnitude of a float. Squares and sums of such values stay finite in `f32`; physical
/// quantities are far smaller.
pub const MAX_MAGNITUDE: f32 = 1e9;

/// Refusal of `value`, which is not finite or exceeds `limit`; `what` begins the detail.
pub(crate) fn unusable<F>(field: &str, what: &str, value: F, limit: F) -> Refusal
where
    F: Copy + Display + LowerExp + Into<f64>,
{
    if value.into().is_finite() {
        let detail = format!("{what} {value:e}, its magnitude must be at most {limit:e}");
        return Refusal::new(Reason::BadValue, field, detail);
    }
    Refusal::new(Reason::NotFinite, field, format!("{what} {value}"))
}

/// Floats as a tensor of `shape`.
pub(crate) fn floats(shape: &[usize], values: &[f32]) -> wire::Tensor {
    debug_assert_eq!(shape.iter().product::<usize>(), values.len(), "shape {shape:?}");
    let data = values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<_>>();
    tensor(wire::DataType::F32, shape, data)
}

/// Floats as a tensor whose last axis follows from the others, `rows`.
pub(crate) fn in_rows(rows: &[usize], values: &[f32]) -> wire::Tensor {
    let width = values.len() / rows.iter().product::<usize>().max(1);
    floats(&[rows, &[width]].concat(), values)
}

/// Encoded floats as a tensor of `shape`.
pub(crate) fn encoded(shape: &[usize], data: Vec<u8>) -> wire::Tensor {
    tensor(wire::DataType::F32, shape, data)
}

/// Flags as a tensor of `shape`, one byte each.
pub(crate) fn flags(shape: &[usize], values: &[bool]) -> wire::Tensor {
    debug_assert_eq!(shape.iter().product::<usize>(), values.len(), "shape {shape:?}");
    tensor(wire::DataType::Bool, shape, values.iter().copied().map(u8::from).collect())
}

fn tensor(data_type: wire::DataType, shape: &[usize], data: Vec<u8>) -> wire::Tensor {
    let shape =
        shape.iter().map(|size| u32::try_from(*size).expect("an axis fits 32 bits")).collect();
    wire::Tensor { data_type: data_type.into(), shape, data: Bytes::from(data) }
}

/// The values of a float tensor of `shape`: finite, and at most [`MAX_MAGNITUDE`].
pub(crate) fn read_floats(
    tensor: Option<&wire::Tensor>,
    shape: &[usize],
    field: &str,
) -> Result<Vec<f32>, Refusal> {
    let bytes = bytes(tensor, wire::DataType::F32, shape, field)?.as_chunks::<4>().0.iter();
    let values = bytes.map(|bytes| f32::from_le_bytes(*bytes)).collect::<Vec<_>>();
    let sane = -MAX_MAGNITUDE..=MAX_MAGNITUDE;
    match values.iter().position(|value| !sane.contains(value)) {
        None => Ok(values),
        Some(at) => Err(unusable(field, &format!("element {at} is"), values[at], MAX_MAGNITUDE)),
    }
}

/// The values of a tensor of flags of `shape`.
pub(crate) fn read_flags(
    tensor: Option<&wire::Tensor>,
    shape: &[usize],
    field: &str,
) -> Result<Vec<bool>, Refusal> {
    let bytes = bytes(tensor, wire::DataType::Bool, shape, field)?;
    if let Some(at) = bytes.iter().position(|byte| *byte > 1) {
        let detail = format!("element {at} is {}, a flag is 0 or 1", bytes[at]);
        return Err(Refusal::new(Reason::BadValue, field, detail));
    }
    Ok(bytes.iter().map(|byte| *byte == 1).collect())
}

/// The encoded values of a tensor with this type, shape and length, which are checked without an allocation.
pub(crate) fn bytes<'a>(
    tensor: Option<&'a wire::Tensor>,
    data_type: wire::DataType,
    shape: &[usize],
    field: &str,
) -> Result<&'a [u8], Refusal> {
    let bad = |reason, detail| Err(Refusal::new(reason, field, detail));
    let Some(tensor) = tensor else {
        // An empty array may be omitted, for example the state of a policy without recurrence.
        return if shape.contains(&0) {
            Ok(&[])
        } else {
            bad(Reason::MissingField, "must be set".to_owned())
        };
    };
    if tensor.data_type != i32::from(data_type) {
        let found = tensor.data_type().as_str_name();
        return bad(Reason::BadType, format!("{found}, expected {}", data_type.as_str_name()));
    }
    let declared = Declared(&tensor.shape);
    let length = tensor.data.len();
    let width = if data_type == wire::DataType::F32 { 4 } else { 1 };
    let Some(bytes) = declared.elements().and_then(|elements| elements.checked_mul(width)) else {
        return bad(Reason::BadShape, format!("{declared} has too many elements"));
    };
    if bytes != length as u64 {
        return bad(Reason::BadShape, format!("{declared} requires {bytes} bytes, found {length}"));
    }
    if !tensor.shape.iter().map(|size| *size as usize).eq(shape.iter().copied()) {
        return bad(Reason::BadShape, format!("{declared}, expected {shape:?}"));
    }
    Ok(&tensor.data)
}

/// A shape declared by a peer: any length, any sizes.
struct Declared<'a>(&'a [u32]);

impl Declared<'_> {
    fn elements(&self) -> Option<u64> {
        self.0.iter().try_fold(1_u64, |product, size| product.checked_mul((*size).into()))
    }
}

impl std::fmt::Display for Declared<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.0.len() {
            0..=8 => write!(f, "{:?}", self.0),
            rank => write!(f, "a shape with {rank} axes"),
        }
    }
}
