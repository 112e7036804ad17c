//! The fused operations out of candle's own: slower, differentiable by candle, on any device.

use candle_core::{Result, Tensor};

use super::{Activation, LAYER_NORM_EPSILON};

/// [`super::linear`] out of candle's operations.
///
/// # Errors
/// If shapes or element types do not fit.
pub fn linear(x: &Tensor, w: &Tensor, b: &Tensor, activation: Activation) -> Result<Tensor> {
    let y = x.matmul(&w.t()?)?.broadcast_add(b)?;
    match activation {
        Activation::Identity => Ok(y),
        Activation::Tanh => y.tanh(),
        Activation::Relu => y.relu(),
    }
}

/// [`super::layer_norm`] out of candle's operations.
///
/// # Errors
/// If shapes or element types do not fit.
pub fn layer_norm(x: &Tensor, weight: &Tensor, bias: &Tensor) -> Result<Tensor> {
    let centred = x.broadcast_sub(&x.mean_keepdim(1)?)?;
    let variance = centred.sqr()?.mean_keepdim(1)?;
    let normal = centred.broadcast_div(&(variance + LAYER_NORM_EPSILON)?.sqrt()?)?;
    normal.broadcast_mul(weight)?.broadcast_add(bias)
}

/// [`super::gru_sequence`] out of candle's operations.
///
/// # Errors
/// If shapes or element types do not fit.
pub fn gru_sequence(
    projected: &Tensor,
    w_hh: &Tensor,
    b_hh: &Tensor,
    h0: &Tensor,
    mask: &Tensor,
) -> Result<Tensor> {
    let (steps, sequences) = mask.dims2()?;
    let width = h0.dim(1)?;
    let mut state = h0.clone();
    let mut states = Vec::with_capacity(steps);
    for step in 0..steps {
        let before = state.broadcast_mul(&mask.get(step)?.reshape((sequences, 1))?)?;
        let input = projected.narrow(0, step * sequences, sequences)?;
        let recurrent = before.matmul(&w_hh.t()?)?.broadcast_add(b_hh)?;
        let gate = |of: &Tensor, index: usize| of.narrow(1, index * width, width);
        let r = candle_nn::ops::sigmoid(&(gate(&input, 0)? + gate(&recurrent, 0)?)?)?;
        let z = candle_nn::ops::sigmoid(&(gate(&input, 1)? + gate(&recurrent, 1)?)?)?;
        let n = (gate(&input, 2)? + (r * gate(&recurrent, 2)?)?)?.tanh()?;
        state = ((n.clone() - (&z * n)?)? + (z * before)?)?;
        states.push(state.clone());
    }
    Tensor::cat(&states, 0)
}
