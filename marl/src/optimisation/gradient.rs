//! Gradients of parameters from gradients with respect to networks' outputs, which are computed by hand.

use candle_core::{DType, Device, Tensor, Var};
use policy::ops::Backward;
use policy::parameters::Parameters;

use crate::error::MarlError;
use crate::optimisation::reals::Reals;

/// Gradients in the order of a network's variables, in their precision.
#[derive(Clone, Debug, PartialEq)]
pub struct Gradients(pub Vec<Reals>);

/// A network's output and the gradient of the loss with respect to it, row-major.
pub struct OutputGradient<'a> {
    /// The output.
    pub output: &'a Tensor,
    /// Gradient of the loss with respect to each element of the output.
    pub gradient: &'a [f64],
}

/// A scalar whose gradient with respect to every output is the given one: `sum <output, gradient>`. A backward pass
/// from it gives the gradients of the parameters. Its value has no meaning.
///
/// # Errors
/// If a tensor operation fails.
pub fn root(outputs: &[OutputGradient<'_>]) -> Result<Tensor, MarlError> {
    let mut total = None;
    for OutputGradient { output, gradient } in outputs {
        let constant = like(output, gradient)?;
        let part = (*output * constant)?.sum_all()?;
        total = Some(match total {
            None => part,
            Some(sum) => (sum + part)?,
        });
    }
    total.ok_or_else(|| MarlError::Batch("a loss without outputs".to_owned()))
}

impl Gradients {
    /// Gradients of `root` with respect to every parameter.
    ///
    /// # Errors
    /// Names a parameter that `root` does not depend on. It would otherwise never be trained.
    pub fn of(parameters: &Parameters, root: &Tensor) -> Result<Self, MarlError> {
        let mut backward = Backward::from(root)?;
        let vars = parameters.vars().iter().enumerate();
        let one = |(index, var)| by(&mut backward, var, parameters.name_of(index));
        Ok(Self(vars.map(one).collect::<Result<_, MarlError>>()?))
    }

    /// Adds `other` element by element.
    pub fn add(&mut self, other: &Self) {
        for (own, other) in self.0.iter_mut().zip(&other.0) {
            own.add(other);
        }
    }

    /// Mean of several agents' gradients of the same parameters, added in agent order.
    #[must_use]
    pub fn mean(agents: Vec<Self>) -> Self {
        let count = agents.len();
        let mut agents = agents.into_iter();
        let mut mean = agents.next().unwrap_or(Self(Vec::new()));
        agents.for_each(|agent| mean.add(&agent));
        mean.0.iter_mut().for_each(|gradient| gradient.share(count));
        mean
    }

    /// Euclidean norm over all parameters. Squares are summed in f64, in parameter order.
    #[must_use]
    pub fn norm(&self) -> f64 {
        libm::sqrt(self.0.iter().map(Reals::sum_of_squares).sum())
    }
}

/// Gradient with respect to a variable whose first parameter is `name`.
///
/// # Errors
/// If the backward pass did not reach the variable.
pub fn by(backward: &mut Backward, var: &Var, name: &str) -> Result<Reals, MarlError> {
    if let Some(fused) = backward.take_fused(var) {
        return Ok(Reals::Single(fused));
    }
    let found = backward.by(var)?;
    Reals::of(&found.ok_or_else(|| MarlError::NoGradient(name.to_owned()))?)
}

/// Values of a tensor in f64, row-major.
///
/// # Errors
/// If a tensor operation fails.
pub fn numbers(tensor: &Tensor) -> Result<Vec<f64>, MarlError> {
    Ok(tensor.to_dtype(DType::F64)?.flatten_all()?.to_vec1::<f64>()?)
}

fn like(output: &Tensor, data: &[f64]) -> Result<Tensor, MarlError> {
    let shape = output.shape().clone();
    if output.dtype() == DType::F64 {
        return Ok(Tensor::from_vec(data.to_vec(), shape, &Device::Cpu)?);
    }
    let data: Vec<f32> = data.iter().map(|&x| x as f32).collect();
    Ok(Tensor::from_vec(data, shape, &Device::Cpu)?)
}
