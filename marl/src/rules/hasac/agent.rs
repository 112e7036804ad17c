//! One agent of HASAC: a tanh-Gaussian policy, and the temperature that keeps its entropy at a target.

use candle_core::{Device, Tensor};
use policy::parameters::Parameters;
use policy::randomness::{Draw, Purpose, RunSeed, generator, standard_normal};
use policy::{ActorPolicy, Head, PolicyConfig};
use rand::RngCore;

use crate::config::{HasacConfig, TrainingConfig};
use crate::data::batch::{AgentShape, Problem};
use crate::error::MarlError;
use crate::optimisation::gradient::Gradients;
use crate::optimisation::optimizer::{Adam, AdamConfig};
use crate::rules::hasac::actions::DrawnActions;
use crate::rules::hasac::loadings::Loadings;
use crate::rules::hasac::network::{FrozenNetwork, NormalisedNetwork};
use crate::state::{Visitor, visit_parameters};

/// An agent in training.
pub(super) struct HasacAgent {
    index: usize,
    shape: AgentShape,
    config: PolicyConfig,
    /// The distribution of actions, with the current fraction of the loadings of shared noise.
    head: Head,
    network: NormalisedNetwork,
    /// The network with its running statistics, as actors have it.
    frozen: FrozenNetwork,
    temperature: Temperature,
    /// Of shared noise, if they are learnt.
    loadings: Option<Loadings>,
}

/// Metrics of one optimiser step of a policy.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PolicyMetrics {
    pub(super) policy_loss: f64,
    /// Mean of the smaller action values of the policy's actions.
    pub(super) action_value: f64,
    /// Of the actions after tanh, nats.
    pub(super) entropy: f64,
    pub(super) gradient_norm: f64,
    /// Between the agent's actions and the others', nats; only with learnt loadings.
    pub(super) information: f64,
}

impl HasacAgent {
    pub(super) fn new(
        (config, own): (&TrainingConfig, &HasacConfig),
        policy: &PolicyConfig,
        problem: &Problem,
        seed: RunSeed,
        index: usize,
    ) -> Result<Self, MarlError> {
        let shape = problem.agents[index].clone();
        let mut rng = generator(seed, Draw::of(Purpose::Initialisation).agent(index as u32));
        let sizes = (shape.observation, policy.width, policy.layers, 2 * shape.action);
        let adam = config.update.adam();
        let network = NormalisedNetwork::new(sizes, (adam, own), &mut rng)?;
        let (low, high) = shape.action_range;
        let head = policy.with_noise(Head::TanhGaussian { low, high, noise: None });
        let learnt = head.shared_noise().filter(|noise| noise.loading.is_none());
        let lambda = config.influence.lambda;
        let loadings = learnt.map(|noise| Loadings::new(noise, shape.action, adam, lambda));
        Ok(Self {
            index,
            config: policy.clone(),
            head,
            frozen: network.frozen()?,
            network,
            temperature: Temperature::new(own.initial_temperature, shape.action, adam)?,
            loadings: loadings.transpose()?,
            shape,
        })
    }

    /// Number of action dimensions.
    pub(super) fn actions(&self) -> usize {
        self.shape.action
    }

    /// The policy for acting.
    pub(super) fn policy(&self) -> Result<ActorPolicy, MarlError> {
        let sizes = (self.shape.observation, self.shape.action);
        let loading = self.loadings.as_ref().map(Loadings::parameters).transpose()?;
        let parameters = self.network.folded()?;
        let parameters = (parameters.as_slice(), loading.as_deref());
        Ok(ActorPolicy::without_norms(&self.config, sizes, self.head, parameters)?)
    }

    /// The loadings of shared noise, if they are learnt.
    pub(super) fn loadings(&self) -> Option<&Loadings> {
        self.loadings.as_ref()
    }

    /// From now on with this fraction of the loadings of shared noise.
    pub(super) fn scale_noise(&mut self, share: f32) {
        self.head = self.head.with_noise_share(share);
        self.loadings.iter_mut().for_each(|loadings| loadings.scale(share));
    }

    pub(super) fn temperature(&self) -> Result<f64, MarlError> {
        self.temperature.value()
    }

    pub(super) fn skipped(&self) -> i64 {
        let loadings = self.loadings.as_ref().map_or(0, Loadings::skipped);
        self.network.skipped() + self.temperature.adam.skipped() + loadings
    }

    /// Actions for observations `[R, obs]` and the signal that agents share `[R, K]`, with running statistics.
    pub(super) fn act(
        &mut self,
        observation: &[f32],
        signal: &[f32],
        rng: &mut impl RngCore,
    ) -> Result<DrawnActions, MarlError> {
        let output = self.frozen.forward(observation);
        self.drawn(&output, signal, rng)
    }

    /// As [`Self::act`], with the statistics of these observations.
    pub(super) fn act_in_training(
        &mut self,
        observation: &[f32],
        signal: &[f32],
        rng: &mut impl RngCore,
    ) -> Result<DrawnActions, MarlError> {
        let output = self.network.forward(observation)?;
        self.drawn(&output, signal, rng)
    }

    fn drawn(
        &self,
        output: &[f32],
        signal: &[f32],
        rng: &mut impl RngCore,
    ) -> Result<DrawnActions, MarlError> {
        let noise = match &self.loadings {
            Some(loadings) => loadings.noise(signal, rng)?,
            None => (0..output.len() / 2).map(|_| standard_normal(rng)).collect(),
        };
        Ok(DrawnActions::new(output, noise, self.shape.action, self.shape.action_range))
    }

    /// One descent step on `mean(temperature log_prob - value)` of the actions of [`Self::act_in_training`], with every
    /// row's value `[R]` and its gradient by the agent's action `[R, act]`; then a step of the temperature, and of the loadings for this
    /// `shared` signal `[R, K]` and the precision `[K, K]` that the others' actions add to it.
    pub(super) fn improve(
        &mut self,
        drawn: &DrawnActions,
        (values, by_action): (&[f64], &[f32]),
        (signal, others): (&[f32], &[f64]),
    ) -> Result<PolicyMetrics, MarlError> {
        let temperature = self.temperature.value()?;
        let gradient = drawn.gradient(temperature, by_action);
        let gradient_norm = self.network.descend(&gradient)?;
        self.frozen = self.network.frozen()?;
        let entropy = drawn.entropy();
        self.temperature.step(entropy)?;
        let action_value = values.iter().sum::<f64>() / values.len() as f64;
        let policy_loss = -temperature * entropy - action_value;
        let mut figures =
            PolicyMetrics { policy_loss, action_value, entropy, gradient_norm, information: 0.0 };
        if let Some(loadings) = &mut self.loadings {
            let by_noise = drawn.noise_gradient(temperature, by_action);
            figures.information = loadings.step((&drawn.noise, &by_noise), signal, others)?;
        }
        Ok(figures)
    }

    pub(super) fn scale_learning_rates(&mut self, share: f64) {
        self.network.scale_learning_rate(share);
        self.temperature.adam.scale_learning_rate(share);
        self.loadings.iter_mut().for_each(|loadings| loadings.scale_learning_rate(share));
    }

    /// Visits the arrays of `agent_I`, `temperature_I` and `noise_I`.
    pub(super) fn visit(&mut self, visitor: &mut dyn Visitor) -> Result<(), MarlError> {
        self.network.visit(&format!("agent_{}", self.index), visitor)?;
        self.frozen = self.network.frozen()?;
        self.temperature.visit(&format!("temperature_{}", self.index), visitor)?;
        let name = format!("noise_{}", self.index);
        self.loadings.as_mut().map_or(Ok(()), |loadings| loadings.visit(&name, visitor))
    }
}

/// The weight of a policy's entropy. It rises while the entropy is below its target, minus the number of actions.
struct Temperature {
    /// `log`, the logarithm.
    parameters: Parameters,
    adam: Adam,
    target: f64,
}

impl Temperature {
    fn new(initial: f64, actions: usize, adam: AdamConfig) -> Result<Self, MarlError> {
        let mut parameters = Parameters::new();
        let start = Tensor::full(libm::log(initial) as f32, 1, &Device::Cpu)?;
        parameters.add("log", start)?;
        let adam = Adam::new(adam, &parameters);
        Ok(Self { adam, parameters, target: -(actions as f64) })
    }

    fn value(&self) -> Result<f64, MarlError> {
        Ok(libm::exp(f64::from(self.parameters.values()?[0][0])))
    }

    /// One descent step on `temperature (entropy - target)`.
    fn step(&mut self, entropy: f64) -> Result<(), MarlError> {
        let slope = self.value()? * (entropy - self.target);
        self.adam.step(&self.parameters, &Gradients(vec![vec![slope as f32]]))?;
        Ok(())
    }

    fn visit(&mut self, name: &str, visitor: &mut dyn Visitor) -> Result<(), MarlError> {
        visit_parameters(visitor, &format!("weights/{name}."), &self.parameters)?;
        self.adam.visit(&format!("optimizer/{name}."), visitor)
    }
}
