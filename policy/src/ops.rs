//! Networks as operations on tensors: a whole network is one node of the graph, computed by the crate `kernels`.

mod network;

use candle_core::{CpuStorage, CustomOp1, Layout, Result, Shape, Tensor, WithDType};

pub use kernels::{Activation, Input, LAYER_NORM_EPSILON, Layer, Network, Packed, Workspace};
pub use network::{Backward, LayerStack, RecurrentInput, Weights};

/// `1 / (1 + exp(-x))` of every element, with the bits of `kernels`.
///
/// # Errors
/// If the elements are not f32.
pub fn sigmoid(x: &Tensor) -> Result<Tensor> {
    x.contiguous()?.apply_op1(Sigmoid)
}

struct Sigmoid;

impl CustomOp1 for Sigmoid {
    fn name(&self) -> &'static str {
        "sigmoid"
    }

    fn cpu_fwd(&self, x: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        let y: Vec<f32> = operand(x, layout)?.iter().map(|&x| kernels::sigmoid(x)).collect();
        Ok((f32::to_cpu_storage_owned(y), layout.shape().clone()))
    }

    fn bwd(&self, _x: &Tensor, y: &Tensor, g: &Tensor) -> Result<Option<Tensor>> {
        Ok(Some((g * (y * (1.0 - y)?)?)?))
    }
}

/// The elements of a contiguous operand of a custom operation.
fn operand<'a>(storage: &'a CpuStorage, layout: &Layout) -> Result<&'a [f32]> {
    let Some((start, end)) = layout.contiguous_offsets() else {
        candle_core::bail!("a fused operation needs contiguous tensors, got {layout:?}")
    };
    Ok(&storage.as_slice::<f32>()?[start..end])
}
