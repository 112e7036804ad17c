//! The policy as an actor holds it: plain numbers, no graph.
//!
//! A row's result has the same bits whatever batch it is in, on every machine, and in training: the same kernels compute
//! it.

mod reader;

use kernels::{Activation, Input, Memory, Packed, Workspace};
use rand::RngCore;
use serde::{Deserialize, Serialize};

use crate::acting::reader::Reader;
use crate::arrays::NamedArrays;
use crate::config::{CoreKind, InputNorm, PolicyConfig};
use crate::error::PolicyError;
use crate::head::Head;
use crate::layers::{LayerSpec, RELU_GAIN, TANH_GAIN, network_of};
use crate::standardisation::Standardisation;

/// No policy of ours is wider or deeper.
const MOST_UNITS: usize = 1 << 20;

/// Sizes of one agent's policy and how it acts; travels with its weights.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ActorSpec {
    core: CoreKind,
    /// Left out where it is a LayerNorm, as in snapshots that know nothing else.
    #[serde(skip_serializing_if = "Option::is_none")]
    input_norm: Option<InputNorm>,
    observation: usize,
    action: usize,
    encoder: usize,
    hidden: usize,
    width: usize,
    layers: usize,
    chunk_steps: usize,
    sigma_scale: f32,
    /// Left out of a Gaussian policy's snapshot, so that its bytes do not depend on which other heads exist.
    #[serde(skip_serializing_if = "Option::is_none")]
    head: Option<Head>,
}

impl ActorSpec {
    pub(crate) fn new(
        config: &PolicyConfig,
        observation: usize,
        (action, head): (usize, Head),
    ) -> Result<Self, PolicyError> {
        let spec = Self {
            core: config.core,
            input_norm: Some(config.input_norm).filter(|norm| *norm != InputNorm::LayerNorm),
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

    /// Refuses sizes with which no network can be built, before anything is computed from them.
    fn check(&self) -> Result<(), PolicyError> {
        let of_core = match self.core {
            CoreKind::Gru => [("encoder", self.encoder), ("hidden", self.hidden)],
            CoreKind::Mlp => [("width", self.width), ("layers", self.layers)],
        };
        let shared = [("observation", self.observation), ("action", self.action)];
        for (name, size) in shared.into_iter().chain(of_core) {
            if !(1..=MOST_UNITS).contains(&size) {
                let detail = format!("{name} is {size}, expected 1 to {MOST_UNITS}");
                return Err(PolicyError::Snapshot(detail));
            }
        }
        self.head().check(self.action)
    }

    /// The network's layers; the head's weights start with the gain `head_gain`.
    pub(crate) fn layer_specs(&self, head_gain: f64) -> Vec<LayerSpec> {
        let mut layers = Vec::new();
        if self.input_norm() == InputNorm::LayerNorm {
            layers.push(LayerSpec::norm("encoder.norm", self.observation));
        }
        match self.core {
            CoreKind::Gru => {
                let encoder = (self.observation, self.encoder);
                let (tanh, gain) = (Activation::Tanh, TANH_GAIN);
                layers.push(LayerSpec::linear("encoder.linear", encoder, tanh, gain));
                layers.push(LayerSpec::gru("gru", (self.encoder, self.hidden)));
                layers.push(LayerSpec::norm("output.norm", self.hidden));
            }
            CoreKind::Mlp => {
                let mut from = self.observation;
                for layer in 0..self.layers {
                    let (name, shape) = (format!("layers.{layer}.linear"), (from, self.width));
                    layers.push(LayerSpec::linear(&name, shape, Activation::Relu, RELU_GAIN));
                    layers.push(LayerSpec::norm(&format!("layers.{layer}.norm"), self.width));
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

    /// What stands before the first layer.
    #[must_use]
    pub fn input_norm(&self) -> InputNorm {
        self.input_norm.unwrap_or(InputNorm::LayerNorm)
    }

    /// Whether the policy remembers.
    #[must_use]
    pub fn core(&self) -> CoreKind {
        self.core
    }

    /// Layers of a network that does not remember.
    #[must_use]
    pub fn layers(&self) -> usize {
        self.layers
    }

    /// What actions are drawn from.
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
    /// Applied to observations before the trunk sees them.
    standardisation: Option<Standardisation>,
    network: Packed,
    sigma: Vec<f32>,
}

/// Buffers of [`ActorPolicy::forward`], kept by the caller so that a step allocates nothing.
#[derive(Clone, Debug, Default)]
pub struct Scratch {
    observation: Vec<f32>,
    /// Ones: no state is reset inside a step.
    mask: Vec<f32>,
    output: Vec<f32>,
    states: Vec<f32>,
    workspace: Workspace,
}

impl ActorPolicy {
    /// A policy of this shape with these weights (PyTorch's names, `[out, in]`).
    pub(crate) fn new(spec: ActorSpec, arrays: NamedArrays) -> Result<Self, PolicyError> {
        spec.check()?;
        let mut reader = Reader { arrays: &arrays, used: 0 };
        let standardisation = reader.standardisation(spec.observation)?;
        if spec.core == CoreKind::Mlp && spec.layers > reader.arrays.len() {
            let (layers, found) = (spec.layers, reader.arrays.len());
            return Err(PolicyError::Snapshot(format!("{found} arrays for {layers} layers")));
        }
        let layers = spec.layer_specs(1.0);
        let network = Packed::new(&network_of(&layers), &reader.layers(&layers)?);
        let sigma = match (spec.head(), spec.head().fixed_sigma()) {
            (_, Some(sigma)) => vec![sigma; spec.action],
            (Head::Categorical { .. }, None) => Vec::new(),
            (_, None) => {
                let log_std = reader.vector("head.log_std", spec.action)?;
                log_std.iter().map(|&x| kernels::sigmoid(x) * spec.sigma_scale).collect()
            }
        };
        if reader.used != arrays.len() {
            let (found, used) = (arrays.len(), reader.used);
            return Err(PolicyError::Snapshot(format!("{found} arrays, the network has {used}")));
        }
        Ok(Self { spec, arrays, standardisation, network, sigma })
    }

    /// Sizes of the policy and how it acts.
    #[must_use]
    pub fn spec(&self) -> &ActorSpec {
        &self.spec
    }

    /// The weights, as in PyTorch.
    #[must_use]
    pub fn arrays(&self) -> &NamedArrays {
        &self.arrays
    }

    /// Number of observation features.
    #[must_use]
    pub fn observation_size(&self) -> usize {
        self.spec.observation
    }

    /// Numbers in an action.
    #[must_use]
    pub fn action_size(&self) -> usize {
        self.spec.action
    }

    /// The kind of its action distribution.
    #[must_use]
    pub fn head(&self) -> Head {
        self.spec.head()
    }

    /// Numbers that the network gives for an action: means or logits.
    #[must_use]
    pub fn output_size(&self) -> usize {
        self.spec.outputs()
    }

    /// Width of the recurrent state, 0 without one.
    #[must_use]
    pub fn hidden_size(&self) -> usize {
        self.spec.hidden_size()
    }

    /// Steps between stored recurrent states.
    #[must_use]
    pub fn chunk_steps(&self) -> usize {
        self.spec.chunk_steps
    }

    /// Deviations of the action noise, `[act]`; none of a choice.
    #[must_use]
    pub fn sigma(&self) -> &[f32] {
        &self.sigma
    }

    /// The same network, whose actions are now drawn uniformly from the range of its own.
    ///
    /// # Panics
    /// If the policy has no range.
    #[must_use]
    pub fn uniform(self) -> Self {
        let (Head::Deterministic { low, high, .. } | Head::Uniform { low, high }) = self.head()
        else {
            panic!("{:?} has no range to draw from", self.head())
        };
        let head = Head::Uniform { low, high };
        let sigma = vec![head.fixed_sigma().expect("not learnt"); self.spec.action];
        Self { spec: ActorSpec { head: Some(head), ..self.spec }, sigma, ..self }
    }

    /// The same network, which from now on sees observations as `standardisation` leaves them.
    ///
    /// # Panics
    /// If it is of another number of features.
    #[must_use]
    pub fn standardised(mut self, standardisation: Standardisation) -> Self {
        assert_eq!(standardisation.mean.len(), self.spec.observation, "features");
        self.arrays.extend(standardisation.arrays());
        self.standardisation = Some(standardisation);
        self
    }

    /// An action `[act]` drawn from one row's output `[out]`.
    pub fn draw(&self, output: &[f32], rng: &mut impl RngCore, action: &mut [f32]) {
        self.head().draw(output, &self.sigma, rng, action);
    }

    /// The action `[act]` that evaluation takes: the mean, or the likeliest choice.
    pub fn settle(&self, output: &[f32], action: &mut [f32]) {
        self.head().settle(output, action);
    }

    /// Log-probability of an action `[act]` under one row's output `[out]`, nats. The index of a choice has
    /// been validated.
    #[must_use]
    pub fn log_prob(&self, output: &[f32], action: &[f32]) -> f32 {
        self.head().log_prob(output, &self.sigma, action)
    }

    /// Outputs `[rows, out]`, means or logits, for observations `[rows, obs]`; `hidden` `[rows, H]` moves on by a
    /// step. Observations are as the environment shows them.
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
        let memory = Memory { start: hidden, mask: &mask[..rows], sequences: rows };
        let gru = self.network.network().gru();
        let input = Input { rows: observation, memory: gru.map(|_| memory) };
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
        self.head().spread(output);
    }
}
