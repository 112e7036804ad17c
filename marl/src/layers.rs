//! The layers of the networks that never leave the learner: critic and posteriors.

use candle_core::{Device, Tensor, Var};
use policy::Precision;
use policy::initialise::orthogonal;
use policy::ops::{Activation, layer_norm, linear};
use policy::parameters::Parameters;
use rand::RngCore;

use crate::error::MarlError;

/// Gain of an orthogonal start before a rectifier.
pub(crate) const RELU_GAIN: f64 = core::f64::consts::SQRT_2;
/// Gain of an orthogonal start before a hyperbolic tangent.
pub(crate) const TANH_GAIN: f64 = 5.0 / 3.0;

/// A linear map with its activation.
#[derive(Debug)]
pub(crate) struct Dense {
    weight: Var,
    bias: Var,
    activation: Activation,
}

/// A layer normalisation.
#[derive(Debug)]
pub(crate) struct Norm {
    weight: Var,
    bias: Var,
}

impl Dense {
    /// `[R, in]` to `[R, out]`.
    pub(crate) fn apply(&self, x: &Tensor) -> Result<Tensor, MarlError> {
        Ok(linear(x, self.weight.as_tensor(), self.bias.as_tensor(), self.activation)?)
    }

    /// As [`Dense::apply`], but no gradient is asked for by weight and bias.
    pub(crate) fn apply_as_constant(&self, x: &Tensor) -> Result<Tensor, MarlError> {
        let (weight, bias) = (self.weight.as_tensor().detach(), self.bias.as_tensor().detach());
        Ok(linear(x, &weight, &bias, self.activation)?)
    }
}

impl Norm {
    /// `[R, F]` to `[R, F]`.
    pub(crate) fn apply(&self, x: &Tensor) -> Result<Tensor, MarlError> {
        Ok(layer_norm(x, self.weight.as_tensor(), self.bias.as_tensor())?)
    }
}

/// Declares layers, drawing their starts in order.
pub(crate) struct Builder<'a, R> {
    pub(crate) parameters: Parameters,
    pub(crate) precision: Precision,
    pub(crate) rng: &'a mut R,
}

impl<R: RngCore> Builder<'_, R> {
    pub(crate) fn parameter(
        &mut self,
        name: &str,
        data: Vec<f32>,
        shape: &[usize],
    ) -> Result<Var, MarlError> {
        let value =
            Tensor::from_vec(data, shape, &Device::Cpu)?.to_dtype(self.precision.dtype())?;
        Ok(self.parameters.add(name, value)?)
    }

    pub(crate) fn norm(&mut self, name: &str, width: usize) -> Result<Norm, MarlError> {
        let weight = self.parameter(&format!("{name}.weight"), vec![1.0; width], &[width])?;
        let bias = self.parameter(&format!("{name}.bias"), vec![0.0; width], &[width])?;
        Ok(Norm { weight, bias })
    }

    /// A linear map of `from` to `to` numbers with an orthogonal start.
    pub(crate) fn dense(
        &mut self,
        name: &str,
        (from, to): (usize, usize),
        gain: f64,
        activation: Activation,
    ) -> Result<Dense, MarlError> {
        let start = orthogonal(self.rng, to, from, gain);
        let weight = self.parameter(&format!("{name}.weight"), start, &[to, from])?;
        let bias = self.parameter(&format!("{name}.bias"), vec![0.0; to], &[to])?;
        Ok(Dense { weight, bias, activation })
    }
}

/// `[R, width]` numbers as a constant tensor.
pub(crate) fn rows(
    data: Vec<f32>,
    width: usize,
    precision: Precision,
) -> Result<Tensor, MarlError> {
    let count = data.len() / width;
    Ok(Tensor::from_vec(data, (count, width), &Device::Cpu)?.to_dtype(precision.dtype())?)
}
