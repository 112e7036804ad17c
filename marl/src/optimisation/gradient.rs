//! From a loss written by hand to gradients of parameters: the seam between our formulas and the
//! networks' automatic differentiation.

use candle_core::{DType, Device, Tensor, Var};
use policy::ops::Backward;
use policy::parameters::Parameters;

use crate::error::MarlError;
use crate::optimisation::reals::Reals;

/// Gradients in the order of a network's variables, in their precision.
#[derive(Clone, Debug, PartialEq)]
pub struct Gradients(pub Vec<Reals>);

/// A network's output and the gradient of the loss by it, row-major.
pub struct OutputGradient<'a> {
    /// The output.
    pub output: &'a Tensor,
    /// Gradient of the loss by each of its elements.
    pub gradient: &'a [f64],
}

/// A scalar whose gradient by every output is the given one, `sum <output, gradient>`: the chain
/// rule's first step, after which backward passes of the networks do the rest. Its own value means
/// nothing.
///
/// # Errors
/// Passes on a tensor error.
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
    /// Gradients of `root` by every parameter.
    ///
    /// # Errors
    /// Names a parameter that the root does not reach: a silent hole in a backward pass would
    /// otherwise leave it untrained.
    pub fn of(parameters: &Parameters, root: &Tensor) -> Result<Self, MarlError> {
        let mut backward = Backward::from(root)?;
        let vars = parameters.vars().iter().enumerate();
        let one = |(index, var)| by(&mut backward, var, parameters.name_of(index));
        Ok(Self(vars.map(one).collect::<Result<_, MarlError>>()?))
    }

    /// Adds `other`, number by number.
    pub fn add(&mut self, other: &Self) {
        for (own, other) in self.0.iter_mut().zip(&other.0) {
            own.add(other);
        }
    }

    /// The mean of several agents' gradients of the same parameters, added in their order.
    #[must_use]
    pub fn mean(agents: Vec<Self>) -> Self {
        let count = agents.len();
        let mut agents = agents.into_iter();
        let mut mean = agents.next().unwrap_or(Self(Vec::new()));
        agents.for_each(|agent| mean.add(&agent));
        mean.0.iter_mut().for_each(|gradient| gradient.share(count));
        mean
    }

    /// Euclidean norm over all parameters, their squares summed in their order in f64.
    #[must_use]
    pub fn norm(&self) -> f64 {
        libm::sqrt(self.0.iter().map(Reals::sum_of_squares).sum())
    }
}

/// The gradient by a variable whose first parameter is `name`.
///
/// # Errors
/// If the backward pass has not reached it.
pub fn by(backward: &mut Backward, var: &Var, name: &str) -> Result<Reals, MarlError> {
    if let Some(fused) = backward.take_fused(var) {
        return Ok(Reals::Single(fused));
    }
    let found = backward.by(var)?;
    Reals::of(&found.ok_or_else(|| MarlError::NoGradient(name.to_owned()))?)
}

/// The numbers of a tensor in f64, row-major.
///
/// # Errors
/// Passes on a tensor error.
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
