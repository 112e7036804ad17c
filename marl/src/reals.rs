//! Flat numbers in the precision of the network that they belong to.

use candle_core::{DType, Device, Shape, Tensor};
use policy::arrays::Array;

use crate::error::MarlError;

/// Numbers of a tensor, row-major.
#[derive(Clone, Debug, PartialEq)]
pub enum Reals {
    /// 32-bit floats.
    Single(Vec<f32>),
    /// 64-bit floats.
    Double(Vec<f64>),
}

impl Reals {
    /// The numbers of `tensor`.
    ///
    /// # Errors
    /// If its elements are no floats.
    pub fn of(tensor: &Tensor) -> Result<Self, MarlError> {
        let flat = tensor.flatten_all()?;
        Ok(match tensor.dtype() {
            DType::F64 => Self::Double(flat.to_vec1()?),
            _ => Self::Single(flat.to_vec1()?),
        })
    }

    /// As many zeros as `tensor` has numbers, in its precision.
    #[must_use]
    pub fn zeros(tensor: &Tensor) -> Self {
        match tensor.dtype() {
            DType::F64 => Self::Double(vec![0.0; tensor.elem_count()]),
            _ => Self::Single(vec![0.0; tensor.elem_count()]),
        }
    }

    /// As a tensor.
    ///
    /// # Errors
    /// If the shape asks for another number of them.
    pub fn tensor(self, shape: &Shape) -> Result<Tensor, MarlError> {
        Ok(match self {
            Self::Single(data) => Tensor::from_vec(data, shape, &Device::Cpu)?,
            Self::Double(data) => Tensor::from_vec(data, shape, &Device::Cpu)?,
        })
    }

    /// Adds `other`, number by number.
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

    /// Multiplies every number by `1 / count`.
    pub fn share(&mut self, count: usize) {
        match self {
            Self::Single(own) => own.iter_mut().for_each(|x| *x *= 1.0 / count as f32),
            Self::Double(own) => own.iter_mut().for_each(|x| *x *= 1.0 / count as f64),
        }
    }

    /// The numbers in f64, in their order.
    #[must_use]
    pub fn numbers(&self) -> Vec<f64> {
        match self {
            Self::Single(own) => own.iter().map(|&x| f64::from(x)).collect(),
            Self::Double(own) => own.clone(),
        }
    }

    /// As an array of the given shape.
    #[must_use]
    pub fn array(&self, shape: Vec<usize>) -> Array {
        match self {
            Self::Single(data) => Array::F32 { shape, data: data.clone() },
            Self::Double(data) => Array::F64 { shape, data: data.clone() },
        }
    }

    /// Takes over an array of this precision and of shape `expected`; whether it was one.
    #[must_use]
    pub fn take_over(&mut self, array: &Array, expected: &[usize]) -> bool {
        match (self, array) {
            (Self::Single(own), Array::F32 { shape, data }) if shape == expected => {
                own.clone_from(data);
                true
            }
            (Self::Double(own), Array::F64 { shape, data }) if shape == expected => {
                own.clone_from(data);
                true
            }
            _ => false,
        }
    }
}
