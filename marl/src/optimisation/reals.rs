//! Flat arrays in the precision of their network.

use candle_core::{DType, Device, Shape, Tensor};
use policy::arrays::Array;
use policy::parameters::TensorSpan;

use crate::error::MarlError;

/// Values of a tensor, row-major.
#[derive(Clone, Debug, PartialEq)]
pub enum Reals {
    /// 32-bit floats.
    Single(Vec<f32>),
    /// 64-bit floats.
    Double(Vec<f64>),
}

impl Reals {
    /// Values of `tensor`.
    ///
    /// # Errors
    /// If its elements are not floats.
    pub fn of(tensor: &Tensor) -> Result<Self, MarlError> {
        let flat = tensor.flatten_all()?;
        Ok(match tensor.dtype() {
            DType::F64 => Self::Double(flat.to_vec1()?),
            _ => Self::Single(flat.to_vec1()?),
        })
    }

    /// Zeros in the size and precision of `tensor`.
    #[must_use]
    pub fn zeros(tensor: &Tensor) -> Self {
        match tensor.dtype() {
            DType::F64 => Self::Double(vec![0.0; tensor.elem_count()]),
            _ => Self::Single(vec![0.0; tensor.elem_count()]),
        }
    }

    /// Converts to a tensor.
    ///
    /// # Errors
    /// If the number of elements does not match the shape.
    pub fn tensor(self, shape: &Shape) -> Result<Tensor, MarlError> {
        Ok(match self {
            Self::Single(data) => Tensor::from_vec(data, shape, &Device::Cpu)?,
            Self::Double(data) => Tensor::from_vec(data, shape, &Device::Cpu)?,
        })
    }

    /// Adds `other` element by element.
    ///
    /// # Panics
    /// If the precisions differ.
    pub fn add(&mut self, other: &Self) {
        match (self, other) {
            (Self::Single(own), Self::Single(other)) => {
                own.iter_mut().zip(other).for_each(|(own, other)| *own += other);
            }
            (Self::Double(own), Self::Double(other)) => {
                own.iter_mut().zip(other).for_each(|(own, other)| *own += other);
            }
            (own, other) => panic!("{own:?} and {other:?} differ in precision"),
        }
    }

    /// Divides every number by `count`.
    pub fn share(&mut self, count: usize) {
        match self {
            Self::Single(own) => own.iter_mut().for_each(|x| *x *= 1.0 / count as f32),
            Self::Double(own) => own.iter_mut().for_each(|x| *x *= 1.0 / count as f64),
        }
    }

    /// The values in f64.
    #[must_use]
    pub fn numbers(&self) -> Vec<f64> {
        match self {
            Self::Single(own) => own.iter().map(|&x| f64::from(x)).collect(),
            Self::Double(own) => own.clone(),
        }
    }

    /// Sum of all squares in f64: eight partial sums of every eighth element, then added in order.
    #[must_use]
    pub fn sum_of_squares(&self) -> f64 {
        match self {
            Self::Single(own) => sum_of_squares(own, f64::from),
            Self::Double(own) => sum_of_squares(own, |x| x),
        }
    }

    /// Converts the values of a parameter to an array.
    #[must_use]
    pub fn array(&self, span: &TensorSpan) -> Array {
        let (shape, range) = (span.shape.clone(), span.range.clone());
        match self {
            Self::Single(data) => Array::F32 { shape, data: data[range].to_vec() },
            Self::Double(data) => Array::F64 { shape, data: data[range].to_vec() },
        }
    }

    /// Copies the values of a parameter from an array; false if the array has another precision or shape.
    #[must_use]
    pub fn copy_from(&mut self, array: &Array, span: &TensorSpan) -> bool {
        match (self, array) {
            (Self::Single(own), Array::F32 { shape, data }) if *shape == span.shape => {
                own[span.range.clone()].copy_from_slice(data);
                true
            }
            (Self::Double(own), Array::F64 { shape, data }) if *shape == span.shape => {
                own[span.range.clone()].copy_from_slice(data);
                true
            }
            _ => false,
        }
    }
}

fn sum_of_squares<T: Copy>(numbers: &[T], to_double: impl Fn(T) -> f64) -> f64 {
    let mut sums = [0.0; 8];
    for part in numbers.chunks(sums.len()) {
        for (sum, &x) in sums.iter_mut().zip(part) {
            let x = to_double(x);
            *sum += x * x;
        }
    }
    sums.iter().sum()
}
