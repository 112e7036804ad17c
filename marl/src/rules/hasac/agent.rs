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
use crate::rules::hasac::network::{FrozenNetwork, NormalisedNetwork};
use crate::state::{Visitor, visit_parameters};

/// An agent in training.
pub(super) struct HasacAgent {
    index: usize,
    shape: AgentShape,
    config: PolicyConfig,
    network: NormalisedNetwork,
    /// The network with its running statistics, as actors have it.
    frozen: FrozenNetwork,
    temperature: Temperature,
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
        Ok(Self {
            index,
            config: policy.clone(),
            frozen: network.frozen()?,
            network,
            temperature: Temperature::new(own.initial_temperature, shape.action, adam)?,
            shape,
        })
    }

    /// Number of action dimensions.
    pub(super) fn actions(&self) -> usize {
        self.shape.action
    }

    /// The policy for acting, with this fraction of the loadings of shared noise.
    pub(super) fn policy(&self, noise_share: f32) -> Result<ActorPolicy, MarlError> {
        let (low, high) = self.shape.action_range;
        let sizes = (self.shape.observation, self.shape.action);
        let head = self.config.with_noise(Head::TanhGaussian { low, high, noise: None });
        let head = head.with_noise_share(noise_share);
        Ok(ActorPolicy::without_norms(&self.config, sizes, head, &self.network.folded()?)?)
    }

    pub(super) fn temperature(&self) -> Result<f64, MarlError> {
        self.temperature.value()
    }

    pub(super) fn skipped(&self) -> i64 {
        self.network.skipped()
    }

    /// Actions for observations `[R, obs]`, with running statistics.
    pub(super) fn act(&mut self, observation: &[f32], rng: &mut impl RngCore) -> DrawnActions {
        let output = self.frozen.forward(observation);
        self.drawn(&output, rng)
    }

    /// Actions for observations `[R, obs]`, with the statistics of these observations.
    pub(super) fn act_in_training(
        &mut self,
        observation: &[f32],
        rng: &mut impl RngCore,
    ) -> Result<DrawnActions, MarlError> {
        let output = self.network.forward(observation)?;
        Ok(self.drawn(&output, rng))
    }

    fn drawn(&self, output: &[f32], rng: &mut impl RngCore) -> DrawnActions {
        let count = output.len() / 2;
        let noise: Vec<f32> = (0..count).map(|_| standard_normal(rng)).collect();
        DrawnActions::new(output, &noise, self.shape.action, self.shape.action_range)
    }

    /// One descent step on `mean(temperature log_prob - value)` of the actions of [`Self::act_in_training`], with every
    /// row's value `[R]` and its gradient by the agent's action `[R, act]`; then a step of the temperature.
    pub(super) fn improve(
        &mut self,
        drawn: &DrawnActions,
        values: &[f64],
        by_action: &[f32],
    ) -> Result<PolicyMetrics, MarlError> {
        let temperature = self.temperature.value()?;
        let gradient = drawn.gradient(temperature, by_action);
        let gradient_norm = self.network.descend(&gradient)?;
        self.frozen = self.network.frozen()?;
        let entropy = drawn.entropy();
        self.temperature.step(entropy)?;
        let action_value = values.iter().sum::<f64>() / values.len() as f64;
        let policy_loss = -temperature * entropy - action_value;
        Ok(PolicyMetrics { policy_loss, action_value, entropy, gradient_norm })
    }

    pub(super) fn scale_learning_rates(&mut self, share: f64) {
        self.network.scale_learning_rate(share);
        self.temperature.adam.scale_learning_rate(share);
    }

    /// Visits the arrays of `agent_I` and `temperature_I`.
    pub(super) fn visit(&mut self, visitor: &mut dyn Visitor) -> Result<(), MarlError> {
        self.network.visit(&format!("agent_{}", self.index), visitor)?;
        self.frozen = self.network.frozen()?;
        self.temperature.visit(&format!("temperature_{}", self.index), visitor)
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
