//! One agent of MADDPG: a deterministic actor, its central action value, and a target network of each.

use candle_core::{DType, Device, Tensor};
use policy::parameters::Parameters;
use policy::randomness::{Draw, Purpose, RunSeed, generator};
use policy::{ActorNetwork, ActorPolicy, Distribution, Head, PolicyConfig, SequenceInput};

use crate::config::TrainingConfig;
use crate::critic::StateScale;
use crate::data::batch::Problem;
use crate::error::MarlError;
use crate::optimisation::gradient::{Gradients, OutputGradient, numbers, root};
use crate::optimisation::layers::rows;
use crate::optimisation::optimizer::Adam;
use crate::rules::maddpg::q::ActionValue;
use crate::rules::off_policy::replay::Sample;
use crate::state::{Visitor, visit_parameters};

/// An agent in training.
pub(super) struct MaddpgAgent {
    index: usize,
    actor: ActorNetwork,
    target_actor: ActorNetwork,
    value: ActionValue,
    target_value: ActionValue,
    states: StateScale,
    actor_adam: Adam,
    value_adam: Adam,
    polyak: f64,
}

/// Metrics of one optimiser step.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct StepMetrics {
    pub(super) value_loss: f64,
    /// Mean action value of the policy's actions.
    pub(super) action_value: f64,
    pub(super) gradient_norm: f64,
}

impl MaddpgAgent {
    pub(super) fn new(
        config: &TrainingConfig,
        policy: &PolicyConfig,
        problem: &Problem,
        seed: RunSeed,
        index: usize,
    ) -> Result<Self, MarlError> {
        let draw = |purpose| generator(seed, Draw::of(purpose).agent(index as u32));
        let shape = &problem.agents[index];
        let (low, high) = shape.action_range;
        let noise_sigma = config.maddpg.noise as f32 * 0.5 * (high - low);
        let head = Head::Deterministic { noise_sigma, low, high };
        let actor = || {
            let mut rng = draw(Purpose::Initialisation);
            let (observation, action) = (shape.observation, shape.action);
            ActorNetwork::new(policy, observation, action, head, &mut rng)
        };
        let inputs = problem.state + problem.agents.iter().map(|agent| agent.action).sum::<usize>();
        let value = || {
            let mut rng = draw(Purpose::CriticInitialisation);
            ActionValue::new(&config.critic, inputs, &mut rng)
        };
        let (update, critic) = (&config.update, &config.critic);
        let (first, q) = (actor()?, value()?);
        Ok(Self {
            index,
            actor_adam: Adam::new(update.adam(), first.parameters()),
            value_adam: Adam::new(critic.adam(update.adam_epsilon), &q.parameters),
            actor: first,
            target_actor: actor()?,
            value: q,
            target_value: value()?,
            states: StateScale::new(critic.state_norm, problem.state),
            polyak: config.maddpg.polyak,
        })
    }

    pub(super) fn policy(&self) -> Result<ActorPolicy, MarlError> {
        Ok(self.actor.policy()?)
    }

    pub(super) fn skipped(&self) -> i64 {
        self.actor_adam.skipped() + self.value_adam.skipped()
    }

    /// The target actor's actions after `sample`, `[R, act]`.
    pub(super) fn next_actions(&self, sample: &Sample) -> Result<Tensor, MarlError> {
        let observation = &sample.next.observation[self.index];
        Ok(self.actions(&self.target_actor, observation, sample.discount.len())?.detach())
    }

    /// One step of the action value towards its target, one ascent step of the actor on the action value, and an update
    /// of the target networks. `next` are the actions of all agents' target actors.
    pub(super) fn learn(
        &mut self,
        sample: &Sample,
        next: &[Tensor],
    ) -> Result<StepMetrics, MarlError> {
        let target = self.targets(sample, next)?;
        let taken = sample.action.iter().zip(next);
        let taken = taken.map(|(action, like)| rows(action.clone(), like.dim(1)?));
        let taken = taken.collect::<Result<Vec<_>, MarlError>>()?;
        let value_loss = self.fit_value(sample, &taken, &target)?;
        let (action_value, gradient_norm) = self.update_actor(sample, taken)?;
        polyak_update(self.target_actor.parameters(), self.actor.parameters(), self.polyak)?;
        polyak_update(&self.target_value.parameters, &self.value.parameters, self.polyak)?;
        Ok(StepMetrics { value_loss, action_value, gradient_norm })
    }

    /// `sum_k gamma^k r_(t+k) + gamma^m Q'(s_(t+m), mu'(o_(t+m)))`, `[R]`.
    fn targets(&self, sample: &Sample, next: &[Tensor]) -> Result<Vec<f64>, MarlError> {
        let input = self.joint_input(&sample.next.state, next)?;
        let values = numbers(&self.target_value.forward_as_constant(&input)?)?;
        let parts = sample.reward[self.index].iter().zip(&sample.discount).zip(values);
        Ok(parts.map(|((reward, discount), value)| reward + discount * value).collect())
    }

    /// One descent step on the mean squared error.
    fn fit_value(
        &mut self,
        sample: &Sample,
        taken: &[Tensor],
        target: &[f64],
    ) -> Result<f64, MarlError> {
        let output = self.value.forward(&self.joint_input(&sample.now.state, taken)?)?;
        let share = 1.0 / target.len() as f64;
        let errors: Vec<f64> = numbers(&output)?.iter().zip(target).map(|(q, y)| q - y).collect();
        let gradient: Vec<f64> = errors.iter().map(|error| 2.0 * share * error).collect();
        let root = root(&[OutputGradient { output: &output, gradient: &gradient }])?;
        let gradients = Gradients::of(&self.value.parameters, &root)?;
        self.value_adam.step(&self.value.parameters, &gradients)?;
        Ok(share * errors.iter().map(|error| error * error).sum::<f64>())
    }

    /// One ascent step on the value of the agent's own actions joined with those that the others took.
    fn update_actor(
        &mut self,
        sample: &Sample,
        mut joint: Vec<Tensor>,
    ) -> Result<(f64, f64), MarlError> {
        let count = sample.discount.len();
        joint[self.index] =
            self.actions(&self.actor, &sample.now.observation[self.index], count)?;
        let output =
            self.value.forward_as_constant(&self.joint_input(&sample.now.state, &joint)?)?;
        let share = 1.0 / count as f64;
        let gradient = vec![-share; count];
        let root = root(&[OutputGradient { output: &output, gradient: &gradient }])?;
        let gradients = Gradients::of(self.actor.parameters(), &root)?;
        let norm = self.actor_adam.step(self.actor.parameters(), &gradients)?;
        Ok((share * numbers(&output)?.iter().sum::<f64>(), norm))
    }

    /// An actor's actions `[R, act]` for observations `[R, obs]`.
    fn actions(
        &self,
        actor: &ActorNetwork,
        observation: &[f32],
        count: usize,
    ) -> Result<Tensor, MarlError> {
        let unread = Tensor::zeros((1, 1), DType::F32, &Device::Cpu)?;
        let input = SequenceInput {
            observation: rows(observation.to_vec(), observation.len() / count)?,
            hidden: unread.clone(),
            mask: unread,
        };
        match actor.distribution(&actor.weights()?, &input)? {
            Distribution::Gaussian(gaussian) => Ok(gaussian.mean),
            Distribution::Categorical(_) => unreachable!("MADDPG's heads are deterministic"),
        }
    }

    /// Scaled states `[R, S]` joined with all agents' actions, `[R, S + A]`.
    fn joint_input(&self, state: &[f32], actions: &[Tensor]) -> Result<Tensor, MarlError> {
        let (mut state, width) = (state.to_vec(), state.len() / actions[0].dim(0)?);
        self.states.apply(&mut state, width);
        let mut parts = vec![rows(state, width)?];
        parts.extend(actions.iter().cloned());
        Ok(Tensor::cat(&parts, 1)?)
    }

    pub(super) fn scale_learning_rates(&mut self, share: f64) {
        self.actor_adam.scale_learning_rate(share);
        self.value_adam.scale_learning_rate(share);
    }

    /// Visits `weights/*_I.*` of all four networks and `optimizer/*_I.*` of those that are trained.
    pub(super) fn visit(&mut self, visitor: &mut dyn Visitor) -> Result<(), MarlError> {
        let i = self.index;
        for (name, parameters) in [
            ("agent", self.actor.parameters()),
            ("q", &self.value.parameters),
            ("target_agent", self.target_actor.parameters()),
            ("target_q", &self.target_value.parameters),
        ] {
            visit_parameters(visitor, &format!("weights/{name}_{i}."), parameters)?;
        }
        self.actor_adam.visit(&format!("optimizer/agent_{i}."), visitor)?;
        self.value_adam.visit(&format!("optimizer/q_{i}."), visitor)
    }
}

/// Polyak averaging: `target' = (1 - share) target + share source`, parameter by parameter.
fn polyak_update(target: &Parameters, source: &Parameters, share: f64) -> Result<(), MarlError> {
    let share = share as f32;
    let mut slow = target.values()?;
    let fast = source.values()?;
    for (slow, fast) in slow.iter_mut().flatten().zip(fast.iter().flatten()) {
        *slow = (1.0 - share) * *slow + share * fast;
    }
    Ok(target.set(slow)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::StateNorm;
    use crate::sample;

    #[test]
    fn the_target_after_a_termination_is_the_agents_own_reward() {
        let (problem, config) = (sample::problem(), sample::config());
        let mut drawn = Sample { reward: vec![vec![1.0], vec![2.0]], ..Sample::default() };
        (drawn.discount, drawn.next.state) = (vec![0.0], vec![0.5; problem.state]);
        let next = [1, 1].map(|rows| Tensor::zeros((rows, 3), DType::F32, &Device::Cpu).unwrap());
        let target = |index| {
            let agent =
                MaddpgAgent::new(&config, &sample::policy(), &problem, RunSeed(0), index).unwrap();
            agent.targets(&drawn, &next).unwrap()
        };
        assert_eq!([target(0), target(1)], [[1.0], [2.0]]);
    }

    #[test]
    fn action_values_scale_states_with_feature_z() {
        let (problem, mut config) = (sample::problem(), sample::config());
        let seen = |norm, config: &mut TrainingConfig| {
            config.critic.state_norm = norm;
            let agent =
                MaddpgAgent::new(config, &sample::policy(), &problem, RunSeed(0), 0).unwrap();
            let action = Tensor::new(&[[9.0_f32]], &Device::Cpu).unwrap();
            agent.joint_input(&[1.0, 5.0], &[action]).unwrap().to_vec2::<f32>().unwrap()
        };
        assert_eq!(seen(StateNorm::None, &mut config), [[1.0, 5.0, 9.0]]);
        assert_eq!(seen(StateNorm::FeatureZ, &mut config), [[-1.0, 1.0, 9.0]]);
    }
}
