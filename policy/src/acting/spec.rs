//! Sizes and action distribution of a policy, as snapshots have them.

use std::fmt;

use kernels::Activation;
use serde::{Deserialize, Serialize};

use crate::config::{CoreKind, InputNorm, PolicyConfig};
use crate::error::PolicyError;
use crate::head::Head;
use crate::layers::{LayerSpec, RELU_GAIN, TANH_GAIN};

/// Maximum of every size in an [`ActorSpec`].
const MAX_SIZE: usize = 1 << 20;

/// Sizes and action distribution of one agent's policy; part of a snapshot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ActorSpec {
    pub(super) core: CoreKind,
    /// Absent for a LayerNorm, for compatibility with older snapshots.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) input_norm: Option<InputNorm>,
    /// As `input_norm`, after each layer of the MLP core.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) hidden_norm: Option<InputNorm>,
    pub(super) observation: usize,
    pub(crate) action: usize,
    pub(super) encoder: usize,
    pub(super) hidden: usize,
    pub(super) width: usize,
    pub(super) layers: usize,
    pub(super) chunk_steps: usize,
    pub(super) sigma_scale: f32,
    /// Absent for a Gaussian, so that the bytes of its snapshot do not depend on which other heads exist.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) head: Option<Head>,
}

impl ActorSpec {
    pub(crate) fn new(
        config: &PolicyConfig,
        observation: usize,
        action: usize,
        head: Head,
    ) -> Result<Self, PolicyError> {
        let spec = Self {
            core: config.core,
            input_norm: Some(config.input_norm).filter(|norm| *norm != InputNorm::LayerNorm),
            hidden_norm: None,
            observation,
            action,
            encoder: config.encoder,
            hidden: config.hidden,
            width: config.width,
            layers: config.layers,
            chunk_steps: config.backpropagation_steps,
            sigma_scale: config.sigma_scale,
            head: Some(head).filter(|head| *head != Head::Gaussian),
        };
        spec.check()?;
        Ok(spec)
    }

    /// Rejects sizes that no network can have, before anything is computed from them.
    pub(super) fn check(&self) -> Result<(), PolicyError> {
        let of_core = match self.core {
            CoreKind::Gru => [("encoder", self.encoder), ("hidden", self.hidden)],
            CoreKind::Mlp => [("width", self.width), ("layers", self.layers)],
        };
        let shared = [("observation", self.observation), ("action", self.action)];
        for (name, size) in shared.into_iter().chain(of_core) {
            if !(1..=MAX_SIZE).contains(&size) {
                let detail = format!("{name} is {size}, expected 1 to {MAX_SIZE}");
                return Err(PolicyError::Snapshot(detail));
            }
        }
        self.head().check(self.action)
    }

    /// The network's layers; the head's weights are initialised with the gain `head_gain`.
    pub(crate) fn layer_specs(&self, head_gain: f64) -> Vec<LayerSpec> {
        let mut layers = Vec::new();
        if self.input_norm() == InputNorm::LayerNorm {
            layers.push(LayerSpec::norm("encoder.norm", self.observation));
        }
        match self.core {
            CoreKind::Gru => {
                let encoder = (self.observation, self.encoder);
                let tanh = Activation::Tanh;
                let gain = TANH_GAIN;
                layers.push(LayerSpec::linear("encoder.linear", encoder, tanh, gain));
                layers.push(LayerSpec::gru("gru", self.encoder, self.hidden));
                layers.push(LayerSpec::norm("output.norm", self.hidden));
            }
            CoreKind::Mlp => {
                let mut from = self.observation;
                for layer in 0..self.layers {
                    let name = format!("layers.{layer}.linear");
                    let shape = (from, self.width);
                    layers.push(LayerSpec::linear(&name, shape, Activation::Relu, RELU_GAIN));
                    if self.hidden_norm() == InputNorm::LayerNorm {
                        layers.push(LayerSpec::norm(&format!("layers.{layer}.norm"), self.width));
                    }
                    from = self.width;
                }
            }
        }
        let squashed = self.head().scale().is_some();
        let activation = if squashed { Activation::Tanh } else { Activation::Identity };
        let head = (self.feature_size(), self.outputs());
        layers.push(LayerSpec::linear("head", head, activation, head_gain));
        layers
    }

    /// Normalisation of the network's input.
    #[must_use]
    pub fn input_norm(&self) -> InputNorm {
        self.input_norm.unwrap_or(InputNorm::LayerNorm)
    }

    /// Normalisation after each layer of the MLP core.
    #[must_use]
    pub fn hidden_norm(&self) -> InputNorm {
        self.hidden_norm.unwrap_or(InputNorm::LayerNorm)
    }

    /// Kind of network.
    #[must_use]
    pub fn core(&self) -> CoreKind {
        self.core
    }

    /// Number of layers of the MLP core.
    #[must_use]
    pub fn layers(&self) -> usize {
        self.layers
    }

    /// Action distribution.
    #[must_use]
    pub fn head(&self) -> Head {
        self.head.unwrap_or(Head::Gaussian)
    }

    /// The same policy with this fraction of the loadings of shared noise; without shared noise nothing changes.
    pub(crate) fn with_noise_share(mut self, share: f32) -> Self {
        self.head = self.head.map(|head| head.with_noise_share(share));
        self
    }

    pub(crate) fn outputs(&self) -> usize {
        self.head().outputs(self.action)
    }

    pub(crate) fn feature_size(&self) -> usize {
        match self.core {
            CoreKind::Gru => self.hidden,
            CoreKind::Mlp => self.width,
        }
    }

    pub(crate) fn hidden_size(&self) -> usize {
        match self.core {
            CoreKind::Gru => self.hidden,
            CoreKind::Mlp => 0,
        }
    }

    pub(crate) fn sigma_scale(&self) -> f64 {
        f64::from(self.sigma_scale)
    }
}

/// Name of the array of `log_std`, where `sigma = sigmoid(log_std) * sigma_scale`.
pub(crate) const LOG_STD: &str = "head.log_std";

/// Raises `log_std` so that sigma is at least `floor`, which must be below `scale`.
pub(crate) fn raise_log_std(values: &mut [f32], floor: f64, scale: f64) {
    let share = floor / scale;
    let lowest = libm::log(share / (1.0 - share));
    let low = values.iter_mut().filter(|value| f64::from(**value) < lowest);
    low.for_each(|value| *value = lowest as f32);
}

/// What determines the shapes of the weights and the meaning of the outputs.
impl fmt::Display for ActorSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} observation features, ", self.observation)?;
        match self.core {
            CoreKind::Gru => write!(f, "gru with encoder {}, hidden {}", self.encoder, self.hidden),
            CoreKind::Mlp => write!(f, "mlp with width {}, layers {}", self.width, self.layers),
        }?;
        if self.input_norm() == InputNorm::LayerNorm {
            f.write_str(" after a layer_norm")?;
        }
        if self.hidden_norm() == InputNorm::None {
            f.write_str(" without layer norms")?;
        }
        match (self.head(), self.head().scale()) {
            (Head::Categorical { choices }, _) => write!(f, ", {choices} choices"),
            (Head::TanhGaussian { low, high, .. }, _) => {
                write!(f, ", {} tanh-Gaussian actions from {low} to {high}", self.action)
            }
            (_, None) => {
                let (action, scale) = (self.action, self.sigma_scale);
                write!(f, ", {action} Gaussian actions with sigma_scale {scale}")
            }
            (_, Some((half, middle))) => {
                let (low, high) = (middle - half, middle + half);
                write!(f, ", {} actions squashed into {low} to {high}", self.action)
            }
        }?;
        self.head().shared_noise().map_or(Ok(()), |noise| write!(f, " and {noise}"))
    }
}
