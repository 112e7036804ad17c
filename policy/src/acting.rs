//! The policy in an actor: weights and inference, without a graph.
//!
//! A row's result has the same bits in every batch, on every machine and in training, because the same kernels compute
//! it.

mod reader;

use kernels::{Activation, Input, Packed, SequenceLayout, Workspace};
use rand::RngCore;
use serde::{Deserialize, Serialize};

use crate::acting::reader::Reader;
use crate::arrays::{Array, NamedArrays};
use crate::config::{CoreKind, InputNorm, PolicyConfig};
use crate::error::PolicyError;
use crate::head::Head;
use crate::layers::{LayerSpec, RELU_GAIN, TANH_GAIN, network_of};
use crate::standardisation::Standardisation;

/// Maximum of every size in an [`ActorSpec`].
const MAX_SIZE: usize = 1 << 20;

/// Sizes and action distribution of one agent's policy; part of a snapshot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ActorSpec {
    core: CoreKind,
    /// Absent for a LayerNorm, for compatibility with older snapshots.
    #[serde(skip_serializing_if = "Option::is_none")]
    input_norm: Option<InputNorm>,
    /// As `input_norm`, after each layer of the MLP core.
    #[serde(skip_serializing_if = "Option::is_none")]
    hidden_norm: Option<InputNorm>,
    observation: usize,
    action: usize,
    encoder: usize,
    hidden: usize,
    width: usize,
    layers: usize,
    chunk_steps: usize,
    sigma_scale: f32,
    /// Absent for a Gaussian, so that the bytes of its snapshot do not depend on which other heads exist.
    #[serde(skip_serializing_if = "Option::is_none")]
    head: Option<Head>,
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
    fn check(&self) -> Result<(), PolicyError> {
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

/// One agent's policy.
#[derive(Clone, Debug)]
pub struct ActorPolicy {
    spec: ActorSpec,
    arrays: NamedArrays,
    /// Applied to observations before the network.
    standardisation: Option<Standardisation>,
    network: Packed,
    sigma: Vec<f32>,
}

/// Buffers of [`ActorPolicy::forward`]. The caller reuses them, so that a step does not allocate.
#[derive(Clone, Debug, Default)]
pub struct Scratch {
    observation: Vec<f32>,
    /// All ones: no state is reset within a step.
    mask: Vec<f32>,
    output: Vec<f32>,
    states: Vec<f32>,
    workspace: Workspace,
}

impl ActorPolicy {
    /// A policy of the MLP core without norms, for `observation` features and `action` action values. `parameters`
    /// has, for each layer and then the head, the weight `[out, in]` and the bias `[out]`.
    ///
    /// # Errors
    /// If `head` is invalid for `action` values, a number is not finite, or their count is wrong.
    pub fn without_norms(
        config: &PolicyConfig,
        (observation, action): (usize, usize),
        head: Head,
        mut parameters: &[f32],
    ) -> Result<Self, PolicyError> {
        let norm = Some(InputNorm::None);
        let spec = ActorSpec::new(config, observation, action, head)?;
        let spec = ActorSpec { input_norm: norm, hidden_norm: norm, ..spec };
        let layers = spec.layer_specs(1.0);
        let (given, expected) = (parameters.len(), network_of(&layers).parameters());
        if given != expected {
            return Err(PolicyError::Restore(format!("{given} parameters, expected {expected}")));
        }
        let mut arrays = NamedArrays::new();
        for (name, shape) in layers.iter().flat_map(LayerSpec::parameters) {
            let (own, rest) = parameters.split_at(shape.iter().product());
            arrays.insert(name, Array::F32 { shape, data: own.to_vec() });
            parameters = rest;
        }
        Self::new(spec, arrays)
    }

    /// A policy with the given spec and weights (PyTorch's names, `[out, in]`).
    pub(crate) fn new(spec: ActorSpec, arrays: NamedArrays) -> Result<Self, PolicyError> {
        spec.check()?;
        let mut reader = Reader { arrays: &arrays, used: 0 };
        let standardisation = reader.standardisation(spec.observation)?;
        if spec.core == CoreKind::Mlp && spec.layers > reader.arrays.len() {
            let layers = spec.layers;
            let found = reader.arrays.len();
            return Err(PolicyError::Snapshot(format!("{found} arrays for {layers} layers")));
        }
        let layers = spec.layer_specs(1.0);
        let network = Packed::new(&network_of(&layers), &reader.layers(&layers)?);
        let sigma = match (spec.head(), spec.head().fixed_sigma()) {
            (_, Some(sigma)) => vec![sigma; spec.action],
            (Head::Categorical { .. } | Head::TanhGaussian { .. }, None) => Vec::new(),
            (_, None) => {
                let log_std = reader.vector("head.log_std", spec.action)?;
                log_std.iter().map(|&x| kernels::sigmoid(x) * spec.sigma_scale).collect()
            }
        };
        if reader.used != arrays.len() {
            let found = arrays.len();
            let used = reader.used;
            return Err(PolicyError::Snapshot(format!("{found} arrays, the network has {used}")));
        }
        Ok(Self { spec, arrays, standardisation, network, sigma })
    }

    /// Sizes and action distribution.
    #[must_use]
    pub fn spec(&self) -> &ActorSpec {
        &self.spec
    }

    /// The weights, with PyTorch's names and layout.
    #[must_use]
    pub fn arrays(&self) -> &NamedArrays {
        &self.arrays
    }

    /// Number of observation features `obs`.
    #[must_use]
    pub fn observation_size(&self) -> usize {
        self.spec.observation
    }

    /// Number of action values `act`.
    #[must_use]
    pub fn action_size(&self) -> usize {
        self.spec.action
    }

    /// Action distribution.
    #[must_use]
    pub fn head(&self) -> Head {
        self.spec.head()
    }

    /// Number of network outputs `out`: means, means and deviations, or logits ([`Head::outputs`]).
    #[must_use]
    pub fn output_size(&self) -> usize {
        self.spec.outputs()
    }

    /// Width `H` of the recurrent state, 0 without a GRU.
    #[must_use]
    pub fn hidden_size(&self) -> usize {
        self.spec.hidden_size()
    }

    /// Steps between stored recurrent states.
    #[must_use]
    pub fn chunk_steps(&self) -> usize {
        self.spec.chunk_steps
    }

    /// Standard deviations of the action noise, `[act]`; empty for a policy of choices and for one whose deviations
    /// depend on the observation.
    #[must_use]
    pub fn sigma(&self) -> &[f32] {
        &self.sigma
    }

    /// The same network with actions drawn uniformly from its action range; it keeps no outputs for deviations.
    ///
    /// # Panics
    /// If the policy has no action range.
    #[must_use]
    pub fn uniform(mut self) -> Self {
        let (Head::Deterministic { low, high, .. }
        | Head::Uniform { low, high }
        | Head::TanhGaussian { low, high }) = self.head()
        else {
            panic!("{:?} has no range to draw from", self.head())
        };
        for name in ["head.weight", "head.bias"] {
            if let Some(Array::F32 { shape, data }) = self.arrays.get_mut(name) {
                data.truncate(data.len() / shape[0] * self.spec.action);
                shape[0] = self.spec.action;
            }
        }
        let spec = ActorSpec { head: Some(Head::Uniform { low, high }), ..self.spec };
        Self::new(spec, self.arrays).expect("the means of a valid network")
    }

    /// The same network with `standardisation` applied to its observations.
    ///
    /// # Panics
    /// If the number of features differs.
    #[must_use]
    pub fn standardised(mut self, standardisation: Standardisation) -> Self {
        assert_eq!(standardisation.mean.len(), self.spec.observation, "features");
        self.arrays.extend(standardisation.arrays());
        self.standardisation = Some(standardisation);
        self
    }

    /// Draws an action `[act]` from one row's output `[out]`.
    pub fn draw(&self, output: &[f32], rng: &mut impl RngCore, action: &mut [f32]) {
        self.head().draw(output, &self.sigma, rng, action);
    }

    /// The mode of the distribution, which evaluation uses: the mean `[act]`, or the likeliest choice.
    pub fn mode(&self, output: &[f32], action: &mut [f32]) {
        self.head().mode(output, action);
    }

    /// Log-probability, in nats, of an action `[act]` under one row's output `[out]`. The index of a choice must have
    /// been validated.
    #[must_use]
    pub fn log_prob(&self, output: &[f32], action: &[f32]) -> f32 {
        self.head().log_prob(output, &self.sigma, action)
    }

    /// Computes outputs `[rows, out]` for observations `[rows, obs]` as the environment returns them, and
    /// advances `hidden` `[rows, H]` by one step.
    pub fn forward(
        &self,
        rows: usize,
        observation: &[f32],
        hidden: &mut [f32],
        output: &mut [f32],
        scratch: &mut Scratch,
    ) {
        scratch.observation.clear();
        scratch.observation.extend_from_slice(&observation[..rows * self.spec.observation]);
        if let Some(standardisation) = &self.standardisation {
            standardisation.apply(&mut scratch.observation);
        }
        let hidden = &mut hidden[..rows * self.hidden_size()];
        let Scratch { observation, mask, output: found, states, workspace } = scratch;
        mask.resize(rows, 1.0);
        let sequences = SequenceLayout { start: hidden, mask: &mask[..rows], count: rows };
        let gru = self.network.network().gru();
        let input = Input { rows: observation, sequences: gru.map(|_| sequences) };
        self.network.forward(input, workspace);
        if let Some((layer, _)) = gru {
            states.clear();
            workspace.append_last_states(layer, rows, states);
            hidden.copy_from_slice(states);
        }
        found.clear();
        workspace.append_output(found);
        let output = &mut output[..found.len()];
        output.copy_from_slice(found);
        self.head().scale_output(output);
    }
}
