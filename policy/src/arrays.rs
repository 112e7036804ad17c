//! Named arrays, the representation of weights and all other state: file format and hash.

use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap};
use std::io::{self, Write};
use std::ops::Range;

use safetensors::tensor::{Dtype, Metadata, SafeTensors, TensorInfo, TensorView};
use sha2::{Digest, Sha256};
use thiserror::Error;

/// Bytes before the header of a safetensors file: the header's length.
const LENGTH_BYTES: usize = 8;

/// An array with a shape, row-major.
#[derive(Clone, Debug, PartialEq)]
pub enum Array {
    /// 32-bit floats.
    F32 {
        /// Length of every axis.
        shape: Vec<usize>,
        /// Elements, row-major.
        data: Vec<f32>,
    },
    /// 64-bit floats.
    F64 {
        /// Length of every axis.
        shape: Vec<usize>,
        /// Elements, row-major.
        data: Vec<f64>,
    },
    /// 64-bit integers.
    I64 {
        /// Length of every axis.
        shape: Vec<usize>,
        /// Elements, row-major.
        data: Vec<i64>,
    },
    /// Bytes.
    U8 {
        /// Length of every axis.
        shape: Vec<usize>,
        /// Elements, row-major.
        data: Vec<u8>,
    },
}

/// Arrays sorted by name.
pub type NamedArrays = BTreeMap<String, Array>;

/// Arrays that cannot be encoded, or bytes that cannot be decoded.
#[derive(Debug, Error)]
pub enum ArrayError {
    /// Not a safetensors file.
    #[error("not a safetensors file: {0}")]
    Format(#[from] safetensors::SafeTensorError),
    /// The file could not be written.
    #[error(transparent)]
    Write(#[from] io::Error),
    /// An unsupported element type.
    #[error("array {name} has element type {dtype:?}; supported are F32, F64, I64, U8")]
    ElementType {
        /// Name of the array.
        name: String,
        /// Its element type.
        dtype: Dtype,
    },
    /// The number of elements does not match the shape.
    #[error("array {name} has {found} elements, its shape {shape:?} requires {expected}")]
    Length {
        /// Name of the array.
        name: String,
        /// Its shape.
        shape: Vec<usize>,
        /// Elements that the shape requires.
        expected: usize,
        /// Elements found.
        found: usize,
    },
}

impl Array {
    /// Length of every axis.
    #[must_use]
    pub fn shape(&self) -> &[usize] {
        match self {
            Self::F32 { shape, .. }
            | Self::F64 { shape, .. }
            | Self::I64 { shape, .. }
            | Self::U8 { shape, .. } => shape,
        }
    }

    /// Type of the elements.
    #[must_use]
    pub fn dtype(&self) -> Dtype {
        match self {
            Self::F32 { .. } => Dtype::F32,
            Self::F64 { .. } => Dtype::F64,
            Self::I64 { .. } => Dtype::I64,
            Self::U8 { .. } => Dtype::U8,
        }
    }

    /// Tag of the element type in the canonical hash.
    fn tag(&self) -> u8 {
        match self {
            Self::F32 { .. } => 1,
            Self::F64 { .. } => 2,
            Self::I64 { .. } => 3,
            Self::U8 { .. } => 4,
        }
    }

    fn len(&self) -> usize {
        match self {
            Self::F32 { data, .. } => data.len(),
            Self::F64 { data, .. } => data.len(),
            Self::I64 { data, .. } => data.len(),
            Self::U8 { data, .. } => data.len(),
        }
    }

    /// The elements as little-endian bytes.
    fn bytes(&self) -> Cow<'_, [u8]> {
        match self {
            Self::F32 { data, .. } => little_endian(data, f32::to_le_bytes),
            Self::F64 { data, .. } => little_endian(data, f64::to_le_bytes),
            Self::I64 { data, .. } => little_endian(data, i64::to_le_bytes),
            Self::U8 { data, .. } => Cow::Borrowed(data),
        }
    }

    fn check(&self, name: &str) -> Result<(), ArrayError> {
        let shape = self.shape().to_vec();
        let expected = shape.iter().product();
        let found = self.len();
        if expected == found {
            return Ok(());
        }
        Err(ArrayError::Length { name: name.to_owned(), shape, expected, found })
    }
}

/// The bytes of `numbers`, without a copy where memory has this order.
fn little_endian<N: bytemuck::NoUninit, const WIDTH: usize>(
    numbers: &[N],
    bytes: impl Fn(N) -> [u8; WIDTH],
) -> Cow<'_, [u8]> {
    if cfg!(target_endian = "little") {
        return Cow::Borrowed(bytemuck::cast_slice(numbers));
    }
    Cow::Owned(numbers.iter().flat_map(|number| bytes(*number)).collect())
}

fn numbers<const WIDTH: usize, N>(bytes: &[u8], number: impl Fn([u8; WIDTH]) -> N) -> Vec<N> {
    let (whole, _) = bytes.as_chunks::<WIDTH>();
    whole.iter().map(|chunk| number(*chunk)).collect()
}

fn from_view(name: &str, view: &TensorView<'_>) -> Result<Array, ArrayError> {
    let shape = view.shape().to_vec();
    let bytes = view.data();
    match view.dtype() {
        Dtype::F32 => Ok(Array::F32 { shape, data: numbers(bytes, f32::from_le_bytes) }),
        Dtype::F64 => Ok(Array::F64 { shape, data: numbers(bytes, f64::from_le_bytes) }),
        Dtype::I64 => Ok(Array::I64 { shape, data: numbers(bytes, i64::from_le_bytes) }),
        Dtype::U8 => Ok(Array::U8 { shape, data: bytes.to_vec() }),
        dtype => Err(ArrayError::ElementType { name: name.to_owned(), dtype }),
    }
}

/// Encodes arrays as a safetensors file. With at most one metadata entry the bytes depend only on the
/// contents.
///
/// # Errors
/// Names an array whose length does not match its shape.
pub fn to_safetensors(
    arrays: &NamedArrays,
    metadata: &BTreeMap<String, String>,
) -> Result<Vec<u8>, ArrayError> {
    let mut bytes = Vec::new();
    write_safetensors(arrays, metadata, &mut bytes)?;
    Ok(bytes)
}

/// Writes arrays as [`to_safetensors`] encodes them, one after the other: no second copy of large arrays is held.
///
/// # Errors
/// As [`to_safetensors`]; if the bytes cannot be written.
pub fn write_safetensors<'a>(
    arrays: impl IntoIterator<Item = (&'a String, &'a Array)>,
    metadata: &BTreeMap<String, String>,
    file: &mut impl Write,
) -> Result<(), ArrayError> {
    let mut arrays: Vec<(&String, &Array)> = arrays.into_iter().collect();
    // Large elements first, so that all are aligned.
    arrays.sort_by(|(name, array), (next_name, next)| {
        next.dtype().cmp(&array.dtype()).then(name.cmp(next_name))
    });
    let mut end = 0;
    let mut tensors = Vec::with_capacity(arrays.len());
    for (name, array) in &arrays {
        array.check(name)?;
        let (dtype, shape, start) = (array.dtype(), array.shape().to_vec(), end);
        end += array.bytes().len();
        tensors.push(((*name).clone(), TensorInfo { dtype, shape, data_offsets: (start, end) }));
    }
    let metadata: HashMap<String, String> = metadata.clone().into_iter().collect();
    let header = Metadata::new((!metadata.is_empty()).then_some(metadata), tensors)?;
    let mut header = serde_json::to_vec(&header).map_err(safetensors::SafeTensorError::from)?;
    header.resize(header.len().next_multiple_of(LENGTH_BYTES), b' ');
    file.write_all(&(header.len() as u64).to_le_bytes())?;
    file.write_all(&header)?;
    arrays.iter().try_for_each(|(_, array)| file.write_all(&array.bytes()))?;
    Ok(())
}

/// Decodes arrays and metadata of a safetensors file. The safetensors crate first checks the header length and
/// overlapping or missing bytes, so that malicious bytes cause an error.
///
/// # Errors
/// If the bytes are not a safetensors file, or an array has an unsupported element type.
pub fn from_safetensors(
    bytes: &[u8],
) -> Result<(NamedArrays, BTreeMap<String, String>), ArrayError> {
    let (_, header) = SafeTensors::read_metadata(bytes)?;
    let metadata = header.metadata().clone().unwrap_or_default().into_iter().collect();
    let file = SafeTensors::deserialize(bytes)?;
    let mut arrays = NamedArrays::new();
    for (name, view) in file.iter() {
        arrays.insert(name.to_owned(), from_view(name, &view)?);
    }
    Ok((arrays, metadata))
}

/// Names of the arrays of a safetensors file and their bytes' places in it, in the order of the places.
///
/// # Errors
/// If the bytes are not a safetensors file.
pub(crate) fn places(bytes: &[u8]) -> Result<Vec<(String, Range<usize>)>, ArrayError> {
    let (header, metadata) = SafeTensors::read_metadata(bytes)?;
    let first = LENGTH_BYTES + header;
    let place = |name: String| {
        let (from, to) = metadata.info(&name)?.data_offsets;
        Some((name, first + from..first + to))
    };
    Ok(metadata.offset_keys().into_iter().filter_map(place).collect())
}

/// SHA-256 of arrays sorted by name. For each: length of the name (8 bytes), its bytes,
/// tag of the element type (1 byte: f32 1, f64 2, i64 3, u8 4), number of axes (8), length of each
/// axis (8), elements. All little-endian.
#[must_use]
pub fn sha256<'a>(arrays: impl IntoIterator<Item = (&'a String, &'a Array)>) -> [u8; 32] {
    let mut hash = Sha256::new();
    for (name, array) in arrays {
        hash.update((name.len() as u64).to_le_bytes());
        hash.update(name.as_bytes());
        hash.update([array.tag()]);
        hash.update((array.shape().len() as u64).to_le_bytes());
        for &axis in array.shape() {
            hash.update((axis as u64).to_le_bytes());
        }
        hash.update(array.bytes());
    }
    hash.finalize().into()
}

/// `digest` in lower-case hexadecimal digits.
#[must_use]
pub fn hex(digest: &[u8]) -> String {
    digest.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample() -> NamedArrays {
        NamedArrays::from([
            ("a".to_owned(), Array::F32 { shape: vec![2, 1], data: vec![1.5, -0.0] }),
            ("b/c".to_owned(), Array::F64 { shape: vec![1], data: vec![f64::MIN_POSITIVE] }),
            ("d".to_owned(), Array::I64 { shape: vec![], data: vec![-7] }),
            ("e".to_owned(), Array::U8 { shape: vec![0], data: vec![] }),
        ])
    }

    #[test]
    fn files_are_those_of_the_safetensors_crate_byte_for_byte() {
        for metadata in [BTreeMap::new(), BTreeMap::from([("key".to_owned(), "value".to_owned())])]
        {
            let arrays = sample();
            let view = |(name, array): (&String, &Array)| {
                let bytes: Vec<u8> = match array {
                    Array::F32 { data, .. } => data.iter().flat_map(|x| x.to_le_bytes()).collect(),
                    Array::F64 { data, .. } => data.iter().flat_map(|x| x.to_le_bytes()).collect(),
                    Array::I64 { data, .. } => data.iter().flat_map(|x| x.to_le_bytes()).collect(),
                    Array::U8 { data, .. } => data.clone(),
                };
                (name.clone(), array.dtype(), array.shape().to_vec(), bytes)
            };
            let contents: Vec<_> = arrays.iter().map(view).collect();
            let views = contents.iter().map(|(name, dtype, shape, bytes)| {
                (name.as_str(), TensorView::new(*dtype, shape.clone(), bytes).unwrap())
            });
            let named: HashMap<String, String> = metadata.clone().into_iter().collect();
            let named = (!named.is_empty()).then_some(named);
            let expected = safetensors::serialize(views, named).unwrap();
            assert_eq!(to_safetensors(&arrays, &metadata).unwrap(), expected);
        }
    }

    #[test]
    fn arrays_survive_a_round_trip_with_their_metadata() {
        let metadata = BTreeMap::from([("key".to_owned(), "value".to_owned())]);
        let bytes = to_safetensors(&sample(), &metadata).expect("shapes fit");
        let (arrays, back) = from_safetensors(&bytes).expect("own bytes");
        assert_eq!((arrays, back), (sample(), metadata));
    }

    #[test]
    fn the_hash_covers_names_types_shapes_and_every_bit() {
        let base = sha256(&sample());
        let mut renamed = sample();
        let a = renamed.remove("a").expect("there");
        renamed.insert("aa".to_owned(), a);
        let mut reshaped = sample();
        reshaped.insert("a".to_owned(), Array::F32 { shape: vec![1, 2], data: vec![1.5, -0.0] });
        let mut signed = sample();
        signed.insert("a".to_owned(), Array::F32 { shape: vec![2, 1], data: vec![1.5, 0.0] });
        for other in [renamed, reshaped, signed] {
            assert_ne!(sha256(&other), base);
        }
        assert_eq!(hex(&base).len(), 64);
    }

    #[test]
    fn a_wrong_shape_is_rejected_by_name() {
        let wrong = Array::F32 { shape: vec![3], data: vec![1.0] };
        let error = to_safetensors(&NamedArrays::from([("x".to_owned(), wrong)]), &BTreeMap::new())
            .expect_err("lengths differ");
        assert_eq!(error.to_string(), "array x has 1 elements, its shape [3] requires 3");
    }
}
