//! Conditions on the settings and the environment of a run.

use std::cell::OnceCell;
use std::fmt;

use proto::{AgentSpec, EnvironmentSpec};
use sim::{ContactForces, ObservationMode, ObservationNorm, TaskConfig};
use toml::Value;

use super::keys::{START, URL};
use super::resolved::Resolved;
use super::run_config::RunConfig;

/// A condition on a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Condition {
    /// This setting has one of these values.
    Is(&'static str, &'static [&'static str]),
    /// This text is another one.
    Not(&'static str, &'static str),
    /// This number is above 0.
    Above0(&'static str),
    /// This number is 0.
    Zero(&'static str),
    /// Random weights that `policy.head_gain` scales: of the policies, or of q's second head.
    RandomHead,
    /// The environment has this property.
    Environment(Property),
}

/// A property of the run's environment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Property {
    /// A robot of the simulator.
    Robot,
    /// A robot whose task supports contact forces.
    Contacts,
    /// An agent with continuous actions.
    Continuous,
    /// An agent with discrete actions.
    Discrete,
    /// Several agents.
    Several,
}

/// Rules that update policies from the newest rollout only.
pub(super) const ON_POLICY: Condition = Condition::Is("update.rule", &["happo", "mappo"]);
/// Rules that update policies from a replay.
pub(super) const OFF_POLICY: Condition = Condition::Is("update.rule", OFF_POLICY_RULES);
/// Names of the rules with a replay.
pub(super) const OFF_POLICY_RULES: &[&str] = &["maddpg", "hasac"];
/// Multi-agent deterministic policy gradients.
pub(super) const MADDPG: Condition = Condition::Is("update.rule", &["maddpg"]);
/// Heterogeneous-agent soft actor-critic.
pub(super) const HASAC: Condition = Condition::Is("update.rule", &["hasac"]);
/// Rules whose policies are Gaussian with continuous actions, also before tanh.
pub(super) const GAUSSIAN: Condition = Condition::Is("update.rule", &["happo", "mappo", "hasac"]);
/// The agents share a part of their noise.
pub(super) const SHARED_NOISE: Condition = Condition::Is("policy.noise", &["shared"]);
/// The surprise term is on.
pub(super) const SURPRISE: Condition = Condition::Above0("surprise.alpha");
/// The influence term is on.
pub(super) const INFLUENCE: Condition = Condition::Above0("influence.lambda");

impl Condition {
    /// The setting on whose value it depends; `None` if it depends on the environment.
    pub(super) fn setting(self) -> Option<&'static str> {
        match self {
            Self::Is(key, _) | Self::Not(key, _) | Self::Above0(key) | Self::Zero(key) => Some(key),
            Self::RandomHead => Some(START),
            Self::Environment(_) => None,
        }
    }

    /// Whether it holds; `None` if the environment is not known.
    pub(super) fn holds(self, run: &RunContext<'_>) -> Option<bool> {
        let resolved = run.resolved;
        let number = |key| match resolved.entries.get(key).map(|entry| &entry.value) {
            Some(Value::Integer(number)) => *number as f64,
            Some(Value::Float(number)) => *number,
            _ => 0.0,
        };
        match self {
            Self::Is(key, values) => Some(values.contains(&resolved.text(key))),
            Self::Not(key, value) => Some(resolved.text(key) != value),
            Self::Above0(key) => Some(number(key) > 0.0),
            Self::Zero(key) => Some(number(key) == 0.0),
            Self::RandomHead => {
                let second_head = resolved.text("influence.q_training") == "shared"
                    && resolved.text("influence.estimator") == "variational_kl"
                    && number("influence.lambda") > 0.0;
                Some(resolved.text(START).is_empty() || second_head)
            }
            Self::Environment(property) => run.has(property),
        }
    }
}

impl fmt::Display for Condition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Is("update.rule", [rule @ ("maddpg" | "hasac")]) => {
                write!(f, "algorithm = {rule}")
            }
            Self::Is(key, values) => write!(f, "{key} = {}", values.join(" or ")),
            Self::Not(key, _) => f.write_str(key),
            Self::Above0(key) => write!(f, "{key} above 0"),
            Self::Zero(key) => write!(f, "{key} = 0"),
            Self::RandomHead => write!(f, "no {START}"),
            Self::Environment(property) => f.write_str(match property {
                Property::Robot => "a robot of the simulator",
                Property::Contacts => "a robot whose task supports contact forces, such as ant-4x2",
                Property::Continuous => "continuous actions",
                Property::Discrete => "discrete actions",
                Property::Several => "several agents",
            }),
        }
    }
}

/// The settings of a run and what is known of its environment.
pub(super) struct RunContext<'a> {
    /// All settings.
    pub(super) resolved: &'a Resolved,
    task: &'a TaskConfig,
    /// The environment, once it is known.
    offered: Option<&'a EnvironmentSpec>,
    /// The simulator's environment, and whether it is a robot; `None` if it cannot be built.
    simulated: OnceCell<Option<(EnvironmentSpec, bool)>>,
}

impl<'a> RunContext<'a> {
    /// The run of `config` in the environment `offered`, or in one that is not known yet.
    pub(super) fn of(config: &'a RunConfig, offered: Option<&'a EnvironmentSpec>) -> Self {
        Self { resolved: &config.resolved, task: &config.task, offered, simulated: OnceCell::new() }
    }

    /// Whether the environment has the property. `None` if the environment is not known yet or cannot be built, which has its
    /// own error.
    fn has(&self, property: Property) -> Option<bool> {
        let is_outside = !self.resolved.text(URL).is_empty();
        match property {
            Property::Robot | Property::Contacts if is_outside => Some(false),
            Property::Robot => self.simulated().map(|(_, is_robot)| *is_robot),
            Property::Contacts => Some(self.has_contact_forces()),
            Property::Continuous => self.any_agent(|agent| agent.action.choices.is_none()),
            Property::Discrete => self.any_agent(|agent| agent.action.choices.is_some()),
            Property::Several => self.environment().map(|spec| spec.agents.len() > 1),
        }
    }

    fn any_agent(&self, is_such: impl Fn(&AgentSpec) -> bool) -> Option<bool> {
        Some(self.environment()?.agents.iter().any(is_such))
    }

    /// The environment, if it is known.
    fn environment(&self) -> Option<&EnvironmentSpec> {
        match self.offered {
            Some(spec) => Some(spec),
            None if !self.resolved.text(URL).is_empty() => None,
            None => self.simulated().map(|(spec, _)| spec),
        }
    }

    /// Whether the description of the simulator's environment has contact forces if the settings ask for them.
    fn has_contact_forces(&self) -> bool {
        let mut task = self.plain();
        task.observation.contact_forces = ContactForces::Zeros;
        let world = sim::environments(&task, 1).ok();
        let described = world.as_ref().map(|world| world.description());
        described != self.simulated().map(|(spec, _)| spec)
    }

    fn simulated(&self) -> Option<&(EnvironmentSpec, bool)> {
        let built = || {
            let world = sim::environments(&self.plain(), 1).ok()?;
            Some((world.description().clone(), world.robot().is_some()))
        };
        self.simulated.get_or_init(built).as_ref()
    }

    /// The task with observations that every task supports.
    fn plain(&self) -> TaskConfig {
        let mut task = self.task.clone();
        task.observation.mode = ObservationMode::FullId;
        task.observation.norm = ObservationNorm::None;
        task.observation.contact_forces = ContactForces::Absent;
        task
    }
}
