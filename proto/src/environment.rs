//! Description of an environment, which must be equal on both sides.

use std::fmt::{Debug, Display};

use prost::Message as _;

use crate::read::{bad_value, positive, required, seconds, short_name};
use crate::{Digest, Refusal, wire};

/// Maximum number of choices of a discrete action.
const MAX_CHOICES: u32 = 1 << 16;

/// Description of an environment, which must be equal on both sides.
#[derive(Clone, Debug, PartialEq)]
pub struct EnvironmentSpec {
    /// For example `rapier/halfcheetah-2x3`.
    pub task: String,
    /// The agents; all per-agent data has this order.
    pub agents: Vec<AgentSpec>,
    /// Layout of the global state, `[S]`, which only the critic observes.
    pub state: Vec<FeatureSpec>,
    /// Simulated seconds of one step.
    pub dt_secs: f64,
    /// Steps after which an episode is truncated.
    pub episode_steps: u32,
    /// Name of the encoding of an environment's state.
    pub state_kind: String,
    /// Version of that encoding.
    pub state_version: u32,
    /// Longest encoded state, bytes.
    pub max_state_bytes: u32,
    /// The actor standardises each observation of an external program by the mean and standard deviation over its own
    /// features.
    pub feature_z: bool,
    /// Names of the terms whose sum is the reward, `[K]`; empty for games and external programs. Only metrics use them.
    pub reward_terms: Vec<String>,
}

/// One agent of the team.
#[derive(Clone, Debug, PartialEq)]
pub struct AgentSpec {
    /// For example `agent_0`.
    pub name: String,
    /// Joints that it controls, in the order of its action.
    pub joints: Vec<String>,
    /// Layout of its observation, `[obs]`.
    pub observation: Vec<FeatureSpec>,
    /// Indices in the global state of the observed features, unscaled; empty if the state lacks any of them.
    pub seen: Vec<usize>,
    /// Indices in the global state of the features that `k_nearest` would show; empty in the same case. Nothing here reads
    /// or compares them: programs of earlier versions do, and the digest of a description covers them.
    pub near: Vec<usize>,
    /// Its action.
    pub action: ActionSpec,
}

/// Largest continuous action, in units of half a range. Rewards count squares of actions that are not clamped: this bound keeps
/// them finite.
pub const LARGEST_ACTION: f32 = 1e6;

/// An agent's action, `[size]`: continuous, clamped by the world to `low..=high`, or one choice. In runs a continuous
/// action is in units of half a range: -1 and 1 are the limits of each number's own range, and 0 is its middle. The range
/// of a program that provides an environment is in its own unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ActionSpec {
    /// Number of dimensions.
    pub size: usize,
    /// Smallest value that has an effect.
    pub low: f32,
    /// Largest value that has an effect.
    pub high: f32,
    /// Number of choices of a discrete action, which is one value, the index of a choice. `None`:
    /// continuous.
    pub choices: Option<u32>,
}

/// One feature of an observation or state.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FeatureSpec {
    /// Human-readable name, such as `rootz.position`, `bthigh.velocity` or `id.0`.
    pub name: String,
    /// Kind of information. Densities use it to exclude features.
    pub role: FeatureRole,
}

/// Role of a feature.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FeatureRole {
    /// A measured quantity.
    Signal,
    /// Part of the agent's one-hot identity.
    Identity,
    /// A copy of an earlier feature of the same vector.
    Duplicate,
    /// Constant.
    Constant,
}

/// The first difference between two descriptions.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{field} is {found}, expected {expected}")]
pub struct SpecDifference {
    /// Path of the field, for example `agents[1].action.size`.
    pub field: String,
    /// The value found.
    pub found: String,
    /// The value expected.
    pub expected: String,
}

impl EnvironmentSpec {
    /// The first difference of `found` from this description, in field order, but for [`AgentSpec::near`] and the reward's terms.
    #[must_use]
    pub fn first_difference(&self, found: &Self) -> Option<SpecDifference> {
        differ("task", &found.task, &self.task)
            .or_else(|| list("agents", &found.agents, &self.agents, agent))
            .or_else(|| list("state", &found.state, &self.state, feature))
            .or_else(|| differ("dt_secs", &found.dt_secs, &self.dt_secs))
            .or_else(|| differ("episode_steps", &found.episode_steps, &self.episode_steps))
            .or_else(|| differ("state_kind", &found.state_kind, &self.state_kind))
            .or_else(|| differ("state_version", &found.state_version, &self.state_version))
            .or_else(|| differ("max_state_bytes", &found.max_state_bytes, &self.max_state_bytes))
            .or_else(|| differ("feature_z", &found.feature_z, &self.feature_z))
    }

    /// SHA-256 of its message. Descriptions with equal digests are equal.
    #[must_use]
    pub fn digest(&self) -> Digest {
        Digest::of(&self.to_wire().encode_to_vec())
    }

    /// Rejects names that cannot be shown, sizes of 0, indices outside the global state, and invalid actions.
    pub(crate) fn check(&self, field: &str) -> Result<(), Refusal> {
        short_name(&self.task, &format!("{field}.task"))?;
        // An environment whose states cannot be saved has no encoding.
        if !self.state_kind.is_empty() {
            short_name(&self.state_kind, &format!("{field}.state_kind"))?;
        }
        check_names(&self.reward_terms, |i| format!("{field}.reward_terms[{i}]"))?;
        positive(self.agents.len() as u64, &format!("{field}.agents"))?;
        check_features(&self.state, &format!("{field}.state"))?;
        for (i, agent) in self.agents.iter().enumerate() {
            let agent_field = format!("{field}.agents[{i}]");
            agent.check_names(&agent_field)?;
            agent.action.check(&format!("{agent_field}.action.choices"))?;
            agent.check_indices(self.state.len(), &format!("{agent_field}.seen"))?;
        }
        positive(self.episode_steps.into(), &format!("{field}.episode_steps"))?;
        seconds(self.dt_secs, &format!("{field}.dt_secs"))
    }

    /// Reads the description that an external program sent.
    ///
    /// # Errors
    /// As [`Self::from_wire`]; also if a name or an action range is invalid, a size is 0, an index is outside the
    /// global state, or `feature_z` is set.
    pub fn from_service(wire: wire::DescribeEnvironmentResponse) -> Result<Self, Refusal> {
        let spec = Self::from_wire(required(wire.environment, "environment")?, "environment")?;
        // Answers to steps have no terms.
        let spec = Self { reward_terms: Vec::new(), ..spec };
        positive(spec.state.len() as u64, "environment.state")?;
        for (i, agent) in spec.agents.iter().enumerate() {
            let field = format!("environment.agents[{i}]");
            positive(agent.observation.len() as u64, &format!("{field}.observation"))?;
            positive(agent.action.size as u64, &format!("{field}.action.size"))?;
            agent.action.check_range(&format!("{field}.action.high"))?;
        }
        if spec.feature_z {
            return Err(bad_value("environment.feature_z", "must be unset; the learner sets it"));
        }
        spec.check("environment")?;
        Ok(spec)
    }

    /// Converts to the message.
    #[must_use]
    pub fn to_wire(&self) -> wire::EnvironmentSpec {
        wire::EnvironmentSpec {
            task: self.task.clone(),
            agents: self.agents.iter().map(AgentSpec::to_wire).collect(),
            state: self.state.iter().map(FeatureSpec::to_wire).collect(),
            dt_secs: self.dt_secs,
            episode_steps: self.episode_steps,
            state_kind: self.state_kind.clone(),
            state_version: self.state_version,
            max_state_bytes: self.max_state_bytes,
            feature_z: self.feature_z,
            reward_terms: self.reward_terms.clone(),
        }
    }

    /// Reads the message at `field`.
    ///
    /// # Errors
    /// If a part is missing or a role is unknown.
    pub fn from_wire(wire: wire::EnvironmentSpec, field: &str) -> Result<Self, Refusal> {
        let agents = wire.agents.into_iter().enumerate();
        let agents =
            agents.map(|(i, agent)| AgentSpec::from_wire(agent, &format!("{field}.agents[{i}]")));
        Ok(Self {
            task: wire.task,
            agents: agents.collect::<Result<_, _>>()?,
            state: features(wire.state, &format!("{field}.state"))?,
            dt_secs: wire.dt_secs,
            episode_steps: wire.episode_steps,
            state_kind: wire.state_kind,
            state_version: wire.state_version,
            max_state_bytes: wire.max_state_bytes,
            feature_z: wire.feature_z,
            reward_terms: wire.reward_terms,
        })
    }
}

impl AgentSpec {
    /// Converts to the message.
    #[must_use]
    pub fn to_wire(&self) -> wire::AgentSpec {
        let ActionSpec { size, low, high, choices } = self.action;
        let size = size as u32;
        let choices = choices.unwrap_or(0);
        let indices = |places: &[usize]| places.iter().map(|&place| place as u32).collect();
        wire::AgentSpec {
            name: self.name.clone(),
            joints: self.joints.clone(),
            observation: self.observation.iter().map(FeatureSpec::to_wire).collect(),
            seen: indices(&self.seen),
            near: indices(&self.near),
            action: Some(wire::ActionSpec { size, low, high, choices }),
        }
    }

    fn check_names(&self, field: &str) -> Result<(), Refusal> {
        short_name(&self.name, &format!("{field}.name"))?;
        check_names(&self.joints, |i| format!("{field}.joints[{i}]"))?;
        check_features(&self.observation, &format!("{field}.observation"))
    }

    /// Checks the indices of what it observes in a global state of `state` features.
    fn check_indices(&self, state: usize, field: &str) -> Result<(), Refusal> {
        let Some(index) = self.seen.iter().find(|index| **index >= state) else { return Ok(()) };
        let detail = format!("index {index} in a global state of {state} features");
        Err(bad_value(field, detail))
    }

    pub(crate) fn from_wire(wire: wire::AgentSpec, field: &str) -> Result<Self, Refusal> {
        let action = required(wire.action, &format!("{field}.action"))?;
        let indices = |places: Vec<u32>| places.into_iter().map(|place| place as usize).collect();
        Ok(Self {
            name: wire.name,
            joints: wire.joints,
            observation: features(wire.observation, &format!("{field}.observation"))?,
            seen: indices(wire.seen),
            near: indices(wire.near),
            action: ActionSpec::from_wire(action),
        })
    }
}

impl ActionSpec {
    /// A continuous action with `size` numbers, in units of half a range.
    #[must_use]
    pub const fn continuous(size: usize) -> Self {
        Self { size, low: -1.0, high: 1.0, choices: None }
    }

    /// The unit of the action's numbers in runs, as files state it.
    #[must_use]
    pub fn unit(&self) -> &'static str {
        match self.choices {
            None => "half_range",
            Some(_) => "choice",
        }
    }

    fn from_wire(wire: wire::ActionSpec) -> Self {
        let choices = Some(wire.choices).filter(|choices| *choices > 0);
        Self { size: wire.size as usize, low: wire.low, high: wire.high, choices }
    }

    /// Checks its range.
    fn check_range(&self, field: &str) -> Result<(), Refusal> {
        let Self { low, high, .. } = self;
        if low.is_finite() && high.is_finite() && low <= high {
            return Ok(());
        }
        Err(bad_value(field, format!("the range {low} to {high} is invalid")))
    }

    /// Checks its choices: a choice is one value, and every index is exact in an f32.
    fn check(&self, field: &str) -> Result<(), Refusal> {
        let detail = match self.choices {
            Some(choices) if self.size != 1 => {
                format!("{choices} choices with size {}, a choice has size 1", self.size)
            }
            Some(choices) if choices > MAX_CHOICES => {
                format!("{choices} choices, at most {MAX_CHOICES} are allowed")
            }
            _ => return Ok(()),
        };
        Err(bad_value(field, detail))
    }
}

impl FeatureSpec {
    fn to_wire(&self) -> wire::FeatureSpec {
        wire::FeatureSpec { name: self.name.clone(), role: self.role.to_wire().into() }
    }
}

impl FeatureRole {
    fn to_wire(self) -> wire::FeatureRole {
        match self {
            Self::Signal => wire::FeatureRole::Signal,
            Self::Identity => wire::FeatureRole::Identity,
            Self::Duplicate => wire::FeatureRole::Duplicate,
            Self::Constant => wire::FeatureRole::Constant,
        }
    }

    fn from_wire(wire: wire::FeatureRole) -> Option<Self> {
        match wire {
            wire::FeatureRole::Unspecified => None,
            wire::FeatureRole::Signal => Some(Self::Signal),
            wire::FeatureRole::Identity => Some(Self::Identity),
            wire::FeatureRole::Duplicate => Some(Self::Duplicate),
            wire::FeatureRole::Constant => Some(Self::Constant),
        }
    }
}

fn features(wire: Vec<wire::FeatureSpec>, field: &str) -> Result<Vec<FeatureSpec>, Refusal> {
    let feature = |(i, wire): (usize, wire::FeatureSpec)| {
        let role = wire::FeatureRole::try_from(wire.role).ok().and_then(FeatureRole::from_wire);
        let unknown =
            || bad_value(&format!("{field}[{i}].role"), format!("unknown role {}", wire.role));
        Ok(FeatureSpec { role: role.ok_or_else(unknown)?, name: wire.name })
    };
    wire.into_iter().enumerate().map(feature).collect()
}

fn check_features(features: &[FeatureSpec], field: &str) -> Result<(), Refusal> {
    let names = features.iter().map(|feature| &feature.name);
    check_names(names, |i| format!("{field}[{i}].name"))
}

fn check_names<'a>(
    names: impl IntoIterator<Item = &'a String>,
    field: impl Fn(usize) -> String,
) -> Result<(), Refusal> {
    names.into_iter().enumerate().try_for_each(|(i, name)| short_name(name, &field(i)))
}

fn agent(found: &AgentSpec, expected: &AgentSpec) -> Option<SpecDifference> {
    let (act, right) = (&found.action, &expected.action);
    differ("name", &found.name, &expected.name)
        .or_else(|| list("joints", &found.joints, &expected.joints, |a, b| differ("", a, b)))
        .or_else(|| list("observation", &found.observation, &expected.observation, feature))
        .or_else(|| differ("seen", &found.seen, &expected.seen))
        .or_else(|| differ("action.size", &act.size, &right.size))
        .or_else(|| differ("action.low", &act.low, &right.low))
        .or_else(|| differ("action.high", &act.high, &right.high))
        .or_else(|| differ("action.choices", &act.choices, &right.choices))
}

fn feature(found: &FeatureSpec, expected: &FeatureSpec) -> Option<SpecDifference> {
    differ("name", &found.name, &expected.name)
        .or_else(|| differ("role", &found.role, &expected.role))
}

fn differ<T: PartialEq + Debug>(field: &str, found: &T, expected: &T) -> Option<SpecDifference> {
    let difference = || SpecDifference {
        field: field.to_owned(),
        found: format!("{found:?}"),
        expected: format!("{expected:?}"),
    };
    (found != expected).then(difference)
}

fn list<T>(
    field: &str,
    found: &[T],
    expected: &[T],
    differ_in: impl Fn(&T, &T) -> Option<SpecDifference>,
) -> Option<SpecDifference> {
    if found.len() != expected.len() {
        return differ(&format!("{field}.len"), &found.len(), &expected.len());
    }
    let mut pairs = found.iter().zip(expected).enumerate();
    pairs.find_map(|(i, (a, b))| {
        differ_in(a, b).map(|inner| inside(&format!("{field}[{i}]"), inner))
    })
}

fn inside(outer: &impl Display, inner: SpecDifference) -> SpecDifference {
    let dot = if inner.field.is_empty() { "" } else { "." };
    SpecDifference { field: format!("{outer}{dot}{}", inner.field), ..inner }
}
