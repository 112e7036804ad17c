//! Adam over a network's named parameters, with clipping by global norm and a state that can be
//! stored: PyTorch's formula, the epsilon added after the square root.

use libm::{pow, sqrt};
use policy::arrays::{Array, NamedArrays};
use policy::math::Real;
use policy::parameters::Parameters;

use crate::error::MarlError;
use crate::gradient::Gradients;
use crate::reals::Reals;

const BETA_1: f64 = 0.9;
const BETA_2: f64 = 0.999;

/// Adam's settings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdamConfig {
    /// Step size.
    pub learning_rate: f64,
    /// Added to the root of the second moment.
    pub epsilon: f64,
    /// Gradients whose global norm is larger are scaled down to it.
    pub max_gradient_norm: f64,
}

/// First and second moments of every parameter, and how many steps they have seen.
#[derive(Clone, Debug, PartialEq)]
pub struct Adam {
    config: AdamConfig,
    names: Vec<String>,
    shapes: Vec<Vec<usize>>,
    first: Vec<Reals>,
    second: Vec<Reals>,
    steps: i64,
    skipped: i64,
}

impl Adam {
    /// An optimiser for `parameters`, in their precision, that has seen no step.
    #[must_use]
    pub fn new(config: AdamConfig, parameters: &Parameters) -> Self {
        let zeros: Vec<Reals> = parameters.iter().map(|(_, var)| Reals::zeros(var)).collect();
        Self {
            config,
            names: parameters.iter().map(|(name, _)| name.to_owned()).collect(),
            shapes: parameters.iter().map(|(_, var)| var.dims().to_vec()).collect(),
            first: zeros.clone(),
            second: zeros,
            steps: 0,
            skipped: 0,
        }
    }

    /// Takes one step down the gradient and returns the gradient's norm before clipping. A gradient
    /// that is not finite changes nothing and is counted.
    ///
    /// # Errors
    /// Passes on a tensor error.
    pub fn step(
        &mut self,
        parameters: &Parameters,
        gradients: &Gradients,
    ) -> Result<f64, MarlError> {
        let norm = gradients.norm();
        if !norm.is_finite() {
            self.skipped += 1;
            return Ok(norm);
        }
        self.steps += 1;
        // As torch.nn.utils.clip_grad_norm_ has it.
        let scale = (self.config.max_gradient_norm / (norm + 1e-6)).min(1.0);
        let stride = Stride {
            scale,
            length: self.config.learning_rate / (1.0 - pow(BETA_1, self.steps as f64)),
            root: sqrt(1.0 - pow(BETA_2, self.steps as f64)),
            epsilon: self.config.epsilon,
        };
        let moments = self.first.iter_mut().zip(&mut self.second);
        for (((_, var), gradient), (first, second)) in
            parameters.iter().zip(&gradients.0).zip(moments)
        {
            var.set(
                &stride.moved(Reals::of(var)?, gradient, (first, second)).tensor(var.shape())?,
            )?;
        }
        Ok(norm)
    }

    /// Steps that were skipped because their gradient was not finite.
    #[must_use]
    pub fn skipped(&self) -> i64 {
        self.skipped
    }

    /// The state to keep: `PREFIXm.NAME`, `PREFIXv.NAME`, `PREFIXsteps`, `PREFIXskipped`.
    #[must_use]
    pub fn arrays(&self, prefix: &str) -> NamedArrays {
        let mut arrays = NamedArrays::new();
        for (index, name) in self.names.iter().enumerate() {
            for (kind, moment) in [("m", &self.first), ("v", &self.second)] {
                let array = moment[index].array(self.shapes[index].clone());
                arrays.insert(format!("{prefix}{kind}.{name}"), array);
            }
        }
        for (name, count) in [("steps", self.steps), ("skipped", self.skipped)] {
            let array = Array::I64 { shape: vec![1], data: vec![count] };
            arrays.insert(format!("{prefix}{name}"), array);
        }
        arrays
    }

    /// Takes over a kept state.
    ///
    /// # Errors
    /// Names the array that is missing or has another shape or type.
    pub fn restore(&mut self, prefix: &str, arrays: &NamedArrays) -> Result<(), MarlError> {
        for index in 0..self.names.len() {
            let (name, shape) = (&self.names[index], &self.shapes[index]);
            take_over(&mut self.first[index], arrays, &format!("{prefix}m.{name}"), shape)?;
            take_over(&mut self.second[index], arrays, &format!("{prefix}v.{name}"), shape)?;
        }
        self.steps = stored_count(arrays, &format!("{prefix}steps"))?;
        self.skipped = stored_count(arrays, &format!("{prefix}skipped"))?;
        Ok(())
    }
}

/// One step's figures, the same for every parameter.
#[derive(Clone, Copy)]
struct Stride {
    /// What clips the gradient.
    scale: f64,
    /// `lr / (1 - b1^t)`.
    length: f64,
    /// `sqrt(1 - b2^t)`.
    root: f64,
    epsilon: f64,
}

impl Stride {
    /// Where a parameter goes. All four have the network's precision.
    fn moved(self, values: Reals, gradient: &Reals, moments: (&mut Reals, &mut Reals)) -> Reals {
        match (values, gradient, moments) {
            (
                Reals::Single(values),
                Reals::Single(gradient),
                (Reals::Single(first), Reals::Single(second)),
            ) => Reals::Single(self.apply(values, gradient, first, second)),
            (
                Reals::Double(values),
                Reals::Double(gradient),
                (Reals::Double(first), Reals::Double(second)),
            ) => Reals::Double(self.apply(values, gradient, first, second)),
            (values, gradient, _) => panic!("{values:?} and {gradient:?} differ in precision"),
        }
    }

    /// `m = b1 m + (1 - b1) g`, `v = b2 v + (1 - b2) g^2`,
    /// `x -= lr / (1 - b1^t) m / (sqrt(v) / sqrt(1 - b2^t) + eps)`.
    fn apply<T: Real>(
        self,
        mut values: Vec<T>,
        gradient: &[T],
        first: &mut [T],
        second: &mut [T],
    ) -> Vec<T> {
        let [scale, length, root, epsilon] =
            [self.scale, self.length, self.root, self.epsilon].map(T::from_f64);
        let [keep_1, take_1, keep_2, take_2] =
            [BETA_1, 1.0 - BETA_1, BETA_2, 1.0 - BETA_2].map(T::from_f64);
        let moments = first.iter_mut().zip(second);
        for ((value, &gradient), (first, second)) in values.iter_mut().zip(gradient).zip(moments) {
            let gradient = gradient * scale;
            *first = keep_1 * *first + take_1 * gradient;
            *second = keep_2 * *second + take_2 * gradient * gradient;
            *value -= length * *first / (second.root() / root + epsilon);
        }
        values
    }
}

/// Takes over a moment of shape `expected`.
fn take_over(
    moment: &mut Reals,
    arrays: &NamedArrays,
    name: &str,
    expected: &[usize],
) -> Result<(), MarlError> {
    let array = arrays.get(name).ok_or_else(|| MarlError::Restore(format!("{name} is missing")))?;
    match moment.take_over(array, expected) {
        true => Ok(()),
        false => Err(MarlError::Restore(format!(
            "{name} is not an array of {expected:?} in the run's precision"
        ))),
    }
}

fn stored_count(arrays: &NamedArrays, name: &str) -> Result<i64, MarlError> {
    match arrays.get(name) {
        Some(Array::I64 { data, .. }) if data.len() == 1 && data[0] >= 0 => Ok(data[0]),
        Some(_) => Err(MarlError::Restore(format!("{name} is not one count"))),
        None => Err(MarlError::Restore(format!("{name} is missing"))),
    }
}
