//! The policy in an actor: weights and inference, without a graph.
//!
//! A row's result has the same bits in every batch, on every machine and in training, because the same kernels compute
//! it.

mod reader;
mod spec;

use kernels::{Input, Packed, SequenceLayout, Workspace};
use rand::RngCore;

use crate::acting::reader::Reader;
pub use crate::acting::spec::ActorSpec;
pub(crate) use crate::acting::spec::{LOG_STD, raise_log_std};
use crate::arrays::{Array, NamedArrays};
use crate::config::{CoreKind, InputNorm, PolicyConfig};
use crate::error::PolicyError;
use crate::head::Head;
use crate::layers::{LayerSpec, network_of};
use crate::randomness::{Draw, RunSeed};
use crate::shared_noise::{GivenSignal, LOADING};
use crate::standardisation::Standardisation;

/// One agent's policy.
#[derive(Clone, Debug)]
pub struct ActorPolicy {
    spec: ActorSpec,
    arrays: NamedArrays,
    /// Applied to observations before the network.
    standardisation: Option<Standardisation>,
    network: Packed,
    sigma: Vec<f32>,
    /// Only with noise that agents share.
    given_signal: Option<GivenSignal>,
    /// Part of every deviation that is the agent's own given the signal, `[act]`; 1 if noise is independent.
    own: Vec<f64>,
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
    /// has, for each layer and then the head, the weight `[out, in]` and the bias `[out]`; `loading` has the parameters
    /// `[act, K]` of learnt loadings, if the noise has any.
    ///
    /// # Errors
    /// If `head` is invalid for `action` values, a number is not finite, or their count is wrong.
    pub fn without_norms(
        config: &PolicyConfig,
        (observation, action): (usize, usize),
        head: Head,
        (mut parameters, loading): (&[f32], Option<&[f32]>),
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
        if let Some(loading) = loading {
            let shape = vec![action, loading.len() / action];
            arrays.insert(LOADING.to_owned(), Array::F32 { shape, data: loading.to_vec() });
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
                let log_std = reader.array(LOG_STD, &[spec.action])?;
                log_std.iter().map(|&x| kernels::sigmoid(x) * spec.sigma_scale).collect()
            }
        };
        let given_signal = match (spec.head(), spec.head().shared_noise()) {
            (_, None) => None,
            (head, Some(noise)) => {
                // Deviations that depend on the observation are part of the output.
                let ones = vec![1.0; spec.action];
                let of = if matches!(head, Head::TanhGaussian { .. }) { &ones } else { &sigma };
                let sizes = [spec.action, noise.size];
                let learnt = noise.loading.is_none().then(|| reader.array(LOADING, &sizes));
                Some(GivenSignal::new(noise, of, learnt.transpose()?))
            }
        };
        let own = given_signal.as_ref();
        let own = own.map_or_else(|| vec![1.0; spec.action], |given| given.own.clone());
        if reader.used != arrays.len() {
            let found = arrays.len();
            let used = reader.used;
            return Err(PolicyError::Snapshot(format!("{found} arrays, the network has {used}")));
        }
        Ok(Self { spec, arrays, standardisation, network, sigma, given_signal, own })
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

    /// The standardisation of observations before the network, if any.
    #[must_use]
    pub fn standardisation(&self) -> Option<&Standardisation> {
        self.standardisation.as_ref()
    }

    /// Standard deviations of the action noise, `[act]`; empty for a policy of choices and for one whose deviations
    /// depend on the observation.
    #[must_use]
    pub fn sigma(&self) -> &[f32] {
        &self.sigma
    }

    /// The same policy with every sigma at least `floor`, as an optimiser step leaves it in a run with that floor.
    ///
    /// # Errors
    /// None for a `floor` that settings may have.
    pub fn with_sigma_from(&self, floor: f32) -> Result<Self, PolicyError> {
        let mut arrays = self.arrays.clone();
        if let Some(Array::F32 { data, .. }) = arrays.get_mut(LOG_STD) {
            raise_log_std(data, floor.into(), self.spec.sigma_scale());
        }
        Self::new(self.spec.clone(), arrays)
    }

    /// The same network with actions drawn uniformly from its action range; it keeps no outputs for deviations.
    ///
    /// # Panics
    /// If the policy has no action range.
    #[must_use]
    pub fn uniform(mut self) -> Self {
        let (Head::Deterministic { low, high, .. }
        | Head::Uniform { low, high }
        | Head::TanhGaussian { low, high, .. }) = self.head()
        else {
            panic!("{:?} has no range to draw from", self.head())
        };
        for name in ["head.weight", "head.bias"] {
            if let Some(Array::F32 { shape, data }) = self.arrays.get_mut(name) {
                data.truncate(data.len() / shape[0] * self.spec.action);
                shape[0] = self.spec.action;
            }
        }
        self.arrays.remove(LOADING);
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

    /// Mean norm of the loadings of an action dimension; `None` if agents share no noise.
    #[must_use]
    pub fn mean_loading(&self) -> Option<f64> {
        self.given_signal.as_ref().map(GivenSignal::mean_loading)
    }

    /// Shifts one row's output `[out]` by the noise that all agents share in the step of the action's key `action`. To be
    /// called once before [`Self::draw`] and [`Self::log_prob`]. Without shared noise nothing changes.
    pub fn add_shared_noise(&self, seed: RunSeed, action: Draw, output: &mut [f32]) {
        if let Some(given) = &self.given_signal {
            given.shift(seed, action, output);
        }
    }

    /// Part of every standard deviation that is the agent's own given the signal that agents share, `[act]`; 1 if noise is
    /// independent.
    #[must_use]
    pub fn own_part(&self) -> &[f64] {
        &self.own
    }

    /// Standard deviations of an action given the noise that agents share, and [`Self::own_part`] of them, `[act]`.
    fn deviations(&self) -> (&[f32], &[f64]) {
        let sigma = self.given_signal.as_ref().map_or(&self.sigma, |given| &given.deviations);
        (sigma, &self.own)
    }

    /// Draws an action `[act]` from one row's output `[out]`.
    pub fn draw(&self, output: &[f32], rng: &mut impl RngCore, action: &mut [f32]) {
        self.head().draw(output, self.deviations(), rng, action);
    }

    /// The mode of the distribution, which evaluation uses: the mean `[act]`, or the likeliest choice.
    pub fn mode(&self, output: &[f32], action: &mut [f32]) {
        self.head().mode(output, action);
    }

    /// Log-probability, in nats, of an action `[act]` under one row's output `[out]`. The index of a choice must have
    /// been validated.
    #[must_use]
    pub fn log_prob(&self, output: &[f32], action: &[f32]) -> f32 {
        self.head().log_prob(output, self.deviations(), action)
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
