//! Requests to trained policies and their answers. `validate/acting.rs` checks received steps.

use crate::name::printable;
use crate::read::{required, unknown};
use crate::{AgentSpec, Reason, Refusal, WeightsName, tensor, wire};

/// A team of served policies.
#[derive(Clone, Debug, PartialEq)]
pub struct PolicyDescription {
    /// Human-readable name of the run.
    pub run_id: String,
    /// For example `halfcheetah-2x3`.
    pub task: String,
    /// The weights that a new stream would use.
    pub weights: WeightsName,
    /// The agents of the team.
    pub agents: Vec<PolicyAgent>,
    /// Seconds between observations.
    pub dt_secs: f64,
}

/// One agent and its policy.
#[derive(Clone, Debug, PartialEq)]
pub struct PolicyAgent {
    /// Its name, observations and actions.
    pub agent: AgentSpec,
    /// Units of its recurrent state, 0 without one.
    pub hidden_size: u32,
    /// Its action distribution.
    pub distribution: ActionDistribution,
}

/// Kind of action distribution.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ActionDistribution {
    /// A Gaussian with learnt standard deviations.
    Gaussian,
    /// A categorical distribution over choices.
    Categorical,
    /// A Gaussian with fixed standard deviation, clamped to the action range.
    ClampedGaussian,
    /// Uniform over the action range.
    Uniform,
}

/// How actions are chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ActionChoice {
    /// The mean, or the likeliest choice.
    Mean,
    /// Sampled from the distribution.
    Sampled {
        /// Seed of the draws.
        seed: u64,
    },
}

/// Observations of some agents.
#[derive(Clone, Debug, PartialEq)]
pub struct ActStep {
    /// Whether a new episode starts.
    pub reset: bool,
    /// Agent index and observation `[obs]`; each agent at most once.
    pub observations: Vec<(usize, Vec<f32>)>,
}

/// The answer to a step.
#[derive(Clone, Debug, PartialEq)]
pub struct Acted {
    /// The weights that acted.
    pub weights: WeightsName,
    /// Agent index and action `[act]`, before clamping.
    pub actions: Vec<(usize, Vec<f32>)>,
}

impl PolicyDescription {
    /// Converts to the message.
    #[must_use]
    pub fn to_wire(&self) -> wire::DescribePolicyResponse {
        wire::DescribePolicyResponse {
            run_id: self.run_id.clone(),
            task: self.task.clone(),
            weights: Some(self.weights.to_wire()),
            agents: self.agents.iter().map(PolicyAgent::to_wire).collect(),
            dt_secs: self.dt_secs,
        }
    }

    /// Reads the message.
    ///
    /// # Errors
    /// If a part is missing or a distribution is unknown.
    pub fn from_wire(wire: wire::DescribePolicyResponse) -> Result<Self, Refusal> {
        let agents = wire.agents.into_iter().enumerate();
        let agents =
            agents.map(|(i, agent)| PolicyAgent::from_wire(agent, &format!("agents[{i}]")));
        Ok(Self {
            run_id: printable(&wire.run_id),
            task: printable(&wire.task),
            weights: WeightsName::from_wire(wire.weights, "weights")?,
            agents: agents.collect::<Result<_, _>>()?,
            dt_secs: wire.dt_secs,
        })
    }
}

impl PolicyAgent {
    fn to_wire(&self) -> wire::PolicyAgent {
        let distribution = match self.distribution {
            ActionDistribution::Gaussian => wire::ActionDistribution::Gaussian,
            ActionDistribution::Categorical => wire::ActionDistribution::Categorical,
            ActionDistribution::ClampedGaussian => wire::ActionDistribution::ClampedGaussian,
            ActionDistribution::Uniform => wire::ActionDistribution::Uniform,
        };
        wire::PolicyAgent {
            agent: Some(self.agent.to_wire()),
            hidden_size: self.hidden_size,
            distribution: distribution.into(),
        }
    }

    fn from_wire(wire: wire::PolicyAgent, field: &str) -> Result<Self, Refusal> {
        let distribution = match wire::ActionDistribution::try_from(wire.distribution) {
            Ok(wire::ActionDistribution::Gaussian) => ActionDistribution::Gaussian,
            Ok(wire::ActionDistribution::Categorical) => ActionDistribution::Categorical,
            Ok(wire::ActionDistribution::ClampedGaussian) => ActionDistribution::ClampedGaussian,
            Ok(wire::ActionDistribution::Uniform) => ActionDistribution::Uniform,
            Ok(wire::ActionDistribution::Unspecified) | Err(_) => {
                return Err(unknown(&format!("{field}.distribution"), wire.distribution));
            }
        };
        let agent = format!("{field}.agent");
        let agent = AgentSpec::from_wire(required(wire.agent, &agent)?, &agent)?;
        Ok(Self { agent, hidden_size: wire.hidden_size, distribution })
    }
}

impl ActionChoice {
    /// The first message of a stream.
    #[must_use]
    pub fn to_wire(self) -> wire::ActRequest {
        let choice = match self {
            Self::Mean => wire::act_start::Choice::Mean(wire::MeanAction {}),
            Self::Sampled { seed } => {
                wire::act_start::Choice::Sampled(wire::SampledAction { seed })
            }
        };
        let start = wire::ActStart { choice: Some(choice) };
        wire::ActRequest { content: Some(wire::act_request::Content::Start(start)) }
    }

    /// Reads the first message of a stream.
    ///
    /// # Errors
    /// If it is another message, or the choice is missing.
    pub fn from_wire(wire: wire::ActRequest) -> Result<Self, Refusal> {
        let Some(wire::act_request::Content::Start(start)) = wire.content else {
            return Err(Refusal::new(Reason::MissingField, "start", "must come first"));
        };
        Ok(match required(start.choice, "start.choice")? {
            wire::act_start::Choice::Mean(_) => Self::Mean,
            wire::act_start::Choice::Sampled(sampled) => Self::Sampled { seed: sampled.seed },
        })
    }
}

impl ActStep {
    /// Converts to the message.
    #[must_use]
    pub fn to_wire(&self) -> wire::ActRequest {
        let observation = |(agent, observation): &(usize, Vec<f32>)| wire::AgentObservation {
            agent: *agent as u32,
            observation: Some(tensor::floats(&[observation.len()], observation)),
        };
        let observations = self.observations.iter().map(observation).collect();
        let step = wire::ActStep { reset: self.reset, observations };
        wire::ActRequest { content: Some(wire::act_request::Content::Step(step)) }
    }
}

impl Acted {
    /// Converts to the message.
    #[must_use]
    pub fn to_wire(&self) -> wire::ActResponse {
        let action = |(agent, action): &(usize, Vec<f32>)| wire::AgentAction {
            agent: *agent as u32,
            action: Some(tensor::floats(&[action.len()], action)),
        };
        let actions = self.actions.iter().map(action).collect();
        wire::ActResponse { weights: Some(self.weights.to_wire()), actions }
    }
}
