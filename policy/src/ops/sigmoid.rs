//! The logistic function as a tensor operation, with the bits of [`crate::math`].

use candle_core::backend::BackendStorage as _;
use candle_core::{CpuStorage, CustomOp1, DType, Layout, Result, Shape, Tensor};

use super::values::operand;
use crate::math::Real;

/// `1 / (1 + exp(-x))` of every element.
///
/// # Errors
/// If the element type is not a float.
pub fn sigmoid(x: &Tensor) -> Result<Tensor> {
    x.contiguous()?.apply_op1(Sigmoid)
}

struct Sigmoid;

impl CustomOp1 for Sigmoid {
    fn name(&self) -> &'static str {
        "sigmoid"
    }

    fn cpu_fwd(&self, x: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        macro_rules! run {
            ($float:ty) => {{
                let y: Vec<$float> =
                    operand::<$float>(x, layout)?.iter().map(|&x| Real::sigmoid(x)).collect();
                Ok((candle_core::WithDType::to_cpu_storage_owned(y), layout.shape().clone()))
            }};
        }
        match x.dtype() {
            DType::F32 => run!(f32),
            DType::F64 => run!(f64),
            other => candle_core::bail!("sigmoid: element type {other:?}"),
        }
    }

    fn bwd(&self, _x: &Tensor, y: &Tensor, g: &Tensor) -> Result<Option<Tensor>> {
        Ok(Some((g * (y * (1.0 - y)?)?)?))
    }
}
