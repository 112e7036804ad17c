//! Adam with clipping by global norm and a state that can be stored. As in PyTorch, epsilon is added after the square
//! root.

use candle_core::Var;
use libm::{pow, sqrt};
use policy::parameters::{Parameters, TensorSpan};

use crate::error::MarlError;
use crate::optimisation::gradient::Gradients;
use crate::optimisation::learning_rate::adapted;
use crate::state::{Visitor, visit_count, visit_number, visit_spans};

/// Usual decay of the first moment.
const BETA_1: f64 = 0.9;
const BETA_2: f64 = 0.999;

/// Adam's settings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct AdamConfig {
    /// Learning rate.
    pub learning_rate: f64,
    /// Added to the root of the second moment.
    pub epsilon: f64,
    /// Global norm to which gradients are clipped.
    pub max_gradient_norm: f64,
}

/// Adam: first and second moments of every parameter, and the number of steps.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Adam {
    config: AdamConfig,
    /// Decay of the first moment.
    beta_1: f64,
    /// Fraction of the configured learning rate in this iteration. Not part of the stored state.
    decay: f64,
    /// Fraction of the configured learning rate after adaptation to the divergence.
    adapted: f64,
    spans: Vec<TensorSpan>,
    /// Moments of every variable's elements.
    first: Vec<Vec<f32>>,
    second: Vec<Vec<f32>>,
    steps: i64,
    skipped: i64,
}

impl Adam {
    /// An optimiser for `parameters`, without steps.
    pub(crate) fn new(config: AdamConfig, parameters: &Parameters) -> Self {
        let zeros = |var: &Var| vec![0.0; var.elem_count()];
        let zeros: Vec<Vec<f32>> = parameters.vars().iter().map(zeros).collect();
        Self {
            config,
            beta_1: BETA_1,
            decay: 1.0,
            adapted: 1.0,
            spans: parameters.spans().to_vec(),
            first: zeros.clone(),
            second: zeros,
            steps: 0,
            skipped: 0,
        }
    }

    /// The same optimiser with the decay `beta_1` of the first moment.
    pub(crate) fn with_first_decay(self, beta_1: f64) -> Self {
        Self { beta_1, ..self }
    }

    /// Sets the fraction of the configured learning rate for the next steps. Not part of the stored state.
    pub(crate) fn scale_learning_rate(&mut self, share: f64) {
        self.decay = share;
    }

    /// Adapts the learning rate to an update with a divergence of `kl` nats where `desired` were wanted. `desired` = 0:
    /// no adaptation.
    pub(crate) fn adapt(&mut self, kl: f64, desired: f64) {
        if desired > 0.0 {
            self.adapted = adapted(self.adapted, kl, desired);
        }
    }

    /// Learning rate of the next step.
    pub(crate) fn learning_rate(&self) -> f64 {
        self.decay * self.adapted * self.config.learning_rate
    }

    /// Takes one descent step and returns the gradient's norm before clipping. If the gradient is not finite, the step
    /// is skipped and counted.
    ///
    /// # Errors
    /// If a tensor operation fails.
    pub(crate) fn step(
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
        // As in torch.nn.utils.clip_grad_norm_.
        let scale = (self.config.max_gradient_norm / (norm + 1e-6)).min(1.0);
        let constants = StepConstants {
            scale,
            beta_1: self.beta_1,
            length: self.learning_rate() / (1.0 - pow(self.beta_1, self.steps as f64)),
            root: sqrt(1.0 - pow(BETA_2, self.steps as f64)),
            epsilon: self.config.epsilon,
        };
        let mut values = parameters.values()?;
        let moments = self.first.iter_mut().zip(&mut self.second);
        for ((values, gradient), (first, second)) in
            values.iter_mut().zip(&gradients.0).zip(moments)
        {
            constants.apply(values, gradient, first, second);
        }
        parameters.set(values)?;
        Ok(norm)
    }

    /// Number of steps skipped because their gradient was not finite.
    pub(crate) fn skipped(&self) -> i64 {
        self.skipped
    }

    /// Visits `PREFIXm.NAME`, `PREFIXv.NAME`, `PREFIXsteps`, `PREFIXskipped`, `PREFIXadapted`.
    pub(crate) fn visit(
        &mut self,
        prefix: &str,
        visitor: &mut dyn Visitor,
    ) -> Result<(), MarlError> {
        visit_spans(visitor, &format!("{prefix}m."), &self.spans, &mut self.first)?;
        visit_spans(visitor, &format!("{prefix}v."), &self.spans, &mut self.second)?;
        visit_count(visitor, &format!("{prefix}steps"), &mut self.steps)?;
        visit_count(visitor, &format!("{prefix}skipped"), &mut self.skipped)?;
        let name = format!("{prefix}adapted");
        visit_number(visitor, &name, &mut self.adapted)?;
        match self.adapted {
            share if share > 0.0 && share <= 1.0 => Ok(()),
            share => {
                Err(MarlError::Restore(format!("{name} is {share}, expected above 0, at most 1")))
            }
        }
    }
}

/// Constants of one step, equal for all parameters.
#[derive(Clone, Copy)]
struct StepConstants {
    /// Factor that clips the gradient.
    scale: f64,
    beta_1: f64,
    /// `lr / (1 - b1^t)`.
    length: f64,
    /// `sqrt(1 - b2^t)`.
    root: f64,
    epsilon: f64,
}

impl StepConstants {
    /// `m = b1 m + (1 - b1) g`, `v = b2 v + (1 - b2) g^2`,
    /// `x -= lr / (1 - b1^t) m / (sqrt(v) / sqrt(1 - b2^t) + eps)`.
    fn apply(self, values: &mut [f32], gradient: &[f32], first: &mut [f32], second: &mut [f32]) {
        let [scale, length, root, epsilon] =
            [self.scale, self.length, self.root, self.epsilon].map(|x| x as f32);
        let [keep_1, take_1, keep_2, take_2] =
            [self.beta_1, 1.0 - self.beta_1, BETA_2, 1.0 - BETA_2].map(|x| x as f32);
        let moments = first.iter_mut().zip(second);
        for ((value, &gradient), (first, second)) in values.iter_mut().zip(gradient).zip(moments) {
            let gradient = gradient * scale;
            *first = keep_1 * *first + take_1 * gradient;
            *second = keep_2 * *second + take_2 * gradient * gradient;
            *value -= length * *first / (second.sqrt() / root + epsilon);
        }
    }
}

#[cfg(test)]
mod tests {
    use candle_core::{Device, Tensor};
    use policy::arrays::Array;

    use super::*;
    use crate::state::{restored, saved};

    const CONFIG: AdamConfig =
        AdamConfig { learning_rate: 0.1, epsilon: 1e-8, max_gradient_norm: 100.0 };

    fn zeros() -> Parameters {
        let mut parameters = Parameters::new();
        for name in ["a", "b"] {
            parameters.add(name, Tensor::new(&[0.0_f32], &Device::Cpu).unwrap()).unwrap();
        }
        parameters
    }

    #[test]
    fn moments_of_another_type_and_invalid_counts_are_rejected_by_name() {
        let mut adam = Adam::new(CONFIG, &zeros());
        let stored = saved("", |visitor| adam.visit("x.", visitor)).unwrap();
        for (name, wrong, expected) in [
            ("x.m.a", Array::F64 { shape: vec![1], data: vec![0.0] }, "expected [1] F32"),
            ("x.steps", Array::I64 { shape: vec![1], data: vec![-1] }, "x.steps is -1"),
            ("x.adapted", Array::F64 { shape: vec![1], data: vec![0.0] }, "x.adapted is 0"),
        ] {
            let mut arrays = stored.clone();
            arrays.insert(name.to_owned(), wrong);
            let error = restored(&arrays, |visitor| adam.visit("x.", visitor)).unwrap_err();
            assert!(error.to_string().contains(name), "{error}");
            assert!(error.to_string().contains(expected), "{error}");
        }
    }

    #[test]
    fn a_step_with_a_nan_gradient_is_skipped_and_counted() {
        let parameters = zeros();
        let mut adam = Adam::new(CONFIG, &parameters);
        let norm = adam.step(&parameters, &Gradients(vec![vec![1.0], vec![f32::NAN]])).unwrap();
        assert!(norm.is_nan() && adam.skipped == 1 && adam.steps == 0);
        assert_eq!(adam.first, [[0.0], [0.0]]);
        assert_eq!(parameters.values().unwrap(), [[0.0], [0.0]]);
    }
}
