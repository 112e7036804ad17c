//! Gradients of parameters from gradients with respect to networks' outputs, which are computed by hand.

use candle_core::{DType, Device, Tensor, Var};
use policy::ops::Backward;
use policy::parameters::Parameters;

use crate::error::MarlError;

/// Gradients in the order of a network's variables, each row-major.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Gradients(pub Vec<Vec<f32>>);

/// A network's output and the gradient of the loss with respect to it, row-major.
pub(crate) struct OutputGradient<'a> {
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
pub(crate) fn root(outputs: &[OutputGradient<'_>]) -> Result<Tensor, MarlError> {
    let mut total = None;
    for OutputGradient { output, gradient } in outputs {
        let gradient: Vec<f32> = gradient.iter().map(|&x| x as f32).collect();
        let constant = Tensor::from_vec(gradient, output.shape(), &Device::Cpu)?;
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
    pub(crate) fn of(parameters: &Parameters, root: &Tensor) -> Result<Self, MarlError> {
        let mut backward = Backward::from(root)?;
        let vars = parameters.vars().iter().enumerate();
        let one = |(index, var)| by(&mut backward, var, parameters.name_of(index));
        Ok(Self(vars.map(one).collect::<Result<_, MarlError>>()?))
    }

    /// Adds `other` element by element.
    pub(crate) fn add(&mut self, other: &Self) {
        for (own, other) in self.0.iter_mut().zip(&other.0) {
            own.iter_mut().zip(other).for_each(|(own, other)| *own += other);
        }
    }

    /// Mean of several agents' gradients of the same parameters, added in agent order.
    pub(crate) fn mean(agents: Vec<Self>) -> Self {
        let count = agents.len();
        let mut agents = agents.into_iter();
        let mut mean = agents.next().unwrap_or(Self(Vec::new()));
        agents.for_each(|agent| mean.add(&agent));
        let share = 1.0 / count as f32;
        mean.0.iter_mut().for_each(|gradient| gradient.iter_mut().for_each(|x| *x *= share));
        mean
    }

    /// Euclidean norm over all parameters. Squares are summed in f64, in parameter order.
    pub(crate) fn norm(&self) -> f64 {
        libm::sqrt(self.0.iter().map(|gradient| sum_of_squares(gradient)).sum())
    }
}

/// Gradient with respect to a variable whose first parameter is `name`.
///
/// # Errors
/// If the backward pass did not reach the variable.
pub(crate) fn by(backward: &mut Backward, var: &Var, name: &str) -> Result<Vec<f32>, MarlError> {
    if let Some(fused) = backward.take_fused(var) {
        return Ok(fused);
    }
    let found = backward.by(var)?.ok_or_else(|| MarlError::NoGradient(name.to_owned()))?;
    Ok(found.flatten_all()?.to_vec1()?)
}

/// Sum of all squares in f64: eight partial sums of every eighth element, then added in order.
fn sum_of_squares(numbers: &[f32]) -> f64 {
    let mut sums = [0.0; 8];
    for part in numbers.chunks(sums.len()) {
        for (sum, &x) in sums.iter_mut().zip(part) {
            *sum += f64::from(x) * f64::from(x);
        }
    }
    sums.iter().sum()
}

/// Values of a tensor in f64, row-major.
///
/// # Errors
/// If a tensor operation fails.
pub(crate) fn numbers(tensor: &Tensor) -> Result<Vec<f64>, MarlError> {
    Ok(tensor.to_dtype(DType::F64)?.flatten_all()?.to_vec1::<f64>()?)
}
