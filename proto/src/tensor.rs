//! Tensors in messages: checks of type, shape and length, and, only after that, decoding.

use std::fmt::{Display, LowerExp};

use bytes::Bytes;

use crate::{Reason, Refusal, wire};

/// Largest accepted magnitude of a float. Squares and sums of such values stay finite in `f32`; physical
/// quantities are far smaller.
pub(crate) const MAX_MAGNITUDE: f32 = 1e9;

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

/// A float tensor with checked type, shape and length, and unchecked values.
pub(crate) struct Floats<'a> {
    data: &'a [u8],
    field: String,
}

impl<'a> Floats<'a> {
    /// Checks type, shape and length, without allocating.
    pub(crate) fn check(
        tensor: Option<&'a wire::Tensor>,
        shape: &[usize],
        field: String,
    ) -> Result<Self, Refusal> {
        let data = checked(tensor, wire::DataType::F32, shape, &field)?;
        Ok(Self { data, field })
    }

    /// The encoded values.
    pub(crate) fn bytes(&self) -> &'a [u8] {
        self.data
    }

    /// Decodes the values and checks that they are finite and at most [`MAX_MAGNITUDE`].
    pub(crate) fn decode(&self) -> Result<Vec<f32>, Refusal> {
        let bytes = self.data.as_chunks::<4>().0.iter();
        let values = bytes.map(|bytes| f32::from_le_bytes(*bytes)).collect::<Vec<_>>();
        let sane = -MAX_MAGNITUDE..=MAX_MAGNITUDE;
        match values.iter().position(|value| !sane.contains(value)) {
            None => Ok(values),
            Some(at) => {
                let what = format!("element {at} is");
                Err(unusable(&self.field, &what, values[at], MAX_MAGNITUDE))
            }
        }
    }
}

/// A flag tensor with checked type, shape and length.
pub(crate) struct Flags<'a> {
    data: &'a [u8],
    field: &'static str,
}

impl<'a> Flags<'a> {
    /// Checks type, shape and length, without allocating.
    pub(crate) fn check(
        tensor: Option<&'a wire::Tensor>,
        shape: &[usize],
        field: &'static str,
    ) -> Result<Self, Refusal> {
        Ok(Self { data: checked(tensor, wire::DataType::Bool, shape, field)?, field })
    }

    /// Decodes the values and checks that each byte is 0 or 1.
    pub(crate) fn decode(&self) -> Result<Vec<bool>, Refusal> {
        if let Some(at) = self.data.iter().position(|byte| *byte > 1) {
            let detail = format!("element {at} is {}, a flag is 0 or 1", self.data[at]);
            return Err(Refusal::new(Reason::BadValue, self.field, detail));
        }
        Ok(self.data.iter().map(|byte| *byte == 1).collect())
    }
}

fn checked<'a>(
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
