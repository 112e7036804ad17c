//! Adam over a network's named parameters, with clipping by global norm and a state that can be
//! stored: PyTorch's formula, the epsilon added after the square root.

use candle_core::{Device, Tensor};
use libm::{pow, sqrt};
use policy::arrays::{Array, NamedArrays};
use policy::parameters::Parameters;

use crate::error::MarlError;
use crate::gradient::Gradients;

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
    /// Share of the configured step size that the next steps take.
    share: f64,
    names: Vec<String>,
    shapes: Vec<Vec<usize>>,
    first: Vec<Vec<f32>>,
    second: Vec<Vec<f32>>,
    steps: i64,
    skipped: i64,
}

impl Adam {
    /// An optimiser for `parameters` (f32) that has seen no step.
    #[must_use]
    pub fn new(config: AdamConfig, parameters: &Parameters) -> Self {
        let zeros: Vec<Vec<f32>> =
            parameters.iter().map(|(_, var)| vec![0.0; var.elem_count()]).collect();
        Self {
            config,
            share: 1.0,
            names: parameters.iter().map(|(name, _)| name.to_owned()).collect(),
            shapes: parameters.iter().map(|(_, var)| var.dims().to_vec()).collect(),
            first: zeros.clone(),
            second: zeros,
            steps: 0,
            skipped: 0,
        }
    }

    /// From now on steps have the share `share` of the configured size. It is not part of the state to keep.
    pub fn scale_learning_rate(&mut self, share: f64) {
        self.share = share;
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
        let scale = (self.config.max_gradient_norm / (norm + 1e-6)).min(1.0) as f32;
        for (index, (_, var)) in parameters.iter().enumerate() {
            let mut values = var.as_tensor().flatten_all()?.to_vec1::<f32>()?;
            self.move_values(index, &mut values, &gradients.0[index], scale);
            var.set(&Tensor::from_vec(values, var.shape().clone(), &Device::Cpu)?)?;
        }
        Ok(norm)
    }

    /// `m = b1 m + (1 - b1) g`, `v = b2 v + (1 - b2) g^2`,
    /// `x -= lr / (1 - b1^t) m / (sqrt(v) / sqrt(1 - b2^t) + eps)`.
    fn move_values(&mut self, index: usize, values: &mut [f32], gradient: &[f32], scale: f32) {
        let learning_rate = self.share * self.config.learning_rate;
        let step_size = (learning_rate / (1.0 - pow(BETA_1, self.steps as f64))) as f32;
        let root = sqrt(1.0 - pow(BETA_2, self.steps as f64)) as f32;
        let epsilon = self.config.epsilon as f32;
        let (keep_1, take_1) = (BETA_1 as f32, (1.0 - BETA_1) as f32);
        let (keep_2, take_2) = (BETA_2 as f32, (1.0 - BETA_2) as f32);
        let moments = self.first[index].iter_mut().zip(&mut self.second[index]);
        for ((value, gradient), (first, second)) in values.iter_mut().zip(gradient).zip(moments) {
            let gradient = gradient * scale;
            *first = keep_1 * *first + take_1 * gradient;
            *second = keep_2 * *second + take_2 * gradient * gradient;
            *value -= step_size * *first / (second.sqrt() / root + epsilon);
        }
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
                let (shape, data) = (self.shapes[index].clone(), moment[index].clone());
                arrays.insert(format!("{prefix}{kind}.{name}"), Array::F32 { shape, data });
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
            self.first[index] = stored_f32(arrays, &format!("{prefix}m.{name}"), shape)?;
            self.second[index] = stored_f32(arrays, &format!("{prefix}v.{name}"), shape)?;
        }
        self.steps = stored_count(arrays, &format!("{prefix}steps"))?;
        self.skipped = stored_count(arrays, &format!("{prefix}skipped"))?;
        Ok(())
    }
}

fn stored_f32(arrays: &NamedArrays, name: &str, expected: &[usize]) -> Result<Vec<f32>, MarlError> {
    match arrays.get(name) {
        Some(Array::F32 { shape, data }) if shape == expected => Ok(data.clone()),
        Some(_) => Err(MarlError::Restore(format!("{name} is not an f32 array of {expected:?}"))),
        None => Err(MarlError::Restore(format!("{name} is missing"))),
    }
}

fn stored_count(arrays: &NamedArrays, name: &str) -> Result<i64, MarlError> {
    match arrays.get(name) {
        Some(Array::I64 { data, .. }) if data.len() == 1 && data[0] >= 0 => Ok(data[0]),
        Some(_) => Err(MarlError::Restore(format!("{name} is not one count"))),
        None => Err(MarlError::Restore(format!("{name} is missing"))),
    }
}
