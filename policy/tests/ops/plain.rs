//! The reference: layers from candle's own operations, differentiated by candle, in any precision.

use candle_core::{Result, Tensor};
use candle_nn::ops::{layer_norm_slow, sigmoid};
use policy::ops::{Activation, LAYER_NORM_EPSILON, Layer, Network, RecurrentInput};

/// The output `[R, out]` for `x` `[R, in]` of a network with the parameters `flat`.
pub(crate) fn network(
    network: &Network,
    x: &Tensor,
    flat: &Tensor,
    recurrent: Option<RecurrentInput<'_>>,
) -> Result<Tensor> {
    let mut taken = 0;
    let mut next = |shape: &[usize]| {
        let count = shape.iter().product();
        taken += count;
        flat.narrow(0, taken - count, count)?.reshape(shape)
    };
    let mut y = x.clone();
    for layer in network.layers() {
        y = match *layer {
            Layer::Norm { width } => {
                layer_norm_slow(&y, &next(&[width])?, &next(&[width])?, LAYER_NORM_EPSILON)?
            }
            Layer::Linear { inputs, outputs, activation } => {
                linear(&y, &next(&[outputs, inputs])?, &next(&[outputs])?, activation)?
            }
            Layer::Gru { inputs, hidden } => {
                let identity = Activation::Identity;
                let gates = 3 * hidden;
                let projected = linear(&y, &next(&[gates, inputs])?, &next(&[gates])?, identity)?;
                let Some(RecurrentInput { start, mask }) = recurrent else {
                    candle_core::bail!("a recurrent network needs states and a mask")
                };
                let (w_hh, b_hh) = (next(&[gates, hidden])?, next(&[gates])?);
                gru_sequence(&projected, &w_hh, &b_hh, start, mask)?
            }
        };
    }
    Ok(y)
}

/// `activation(x W^T + b)`: `x` is `[R, in]`, `w` `[out, in]`, `b` `[out]`.
fn linear(x: &Tensor, w: &Tensor, b: &Tensor, activation: Activation) -> Result<Tensor> {
    let y = x.matmul(&w.t()?)?.broadcast_add(b)?;
    match activation {
        Activation::Identity => Ok(y),
        Activation::Tanh => y.tanh(),
        Activation::Relu => y.relu(),
    }
}

/// The recurrent part of [`Layer::Gru`]: `projected` is `x W_i^T + b_i`, `[T*B, 3H]`. Returns every `h_t`,
/// `[T*B, H]`.
fn gru_sequence(
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
        let r = sigmoid(&(gate(&input, 0)? + gate(&recurrent, 0)?)?)?;
        let z = sigmoid(&(gate(&input, 1)? + gate(&recurrent, 1)?)?)?;
        let n = (gate(&input, 2)? + (r * gate(&recurrent, 2)?)?)?.tanh()?;
        state = ((n.clone() - (&z * n)?)? + (z * before)?)?;
        states.push(state.clone());
    }
    Tensor::cat(&states, 0)
}
