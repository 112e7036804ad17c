//! Which settings have an effect in a run. A setting that the user gives and that has none is refused: a sweep over it would
//! be flat.

use std::cell::OnceCell;
use std::fmt;

use proto::EnvironmentSpec;
use sim::{ContactForces, ObservationMode, ObservationNorm, TaskConfig};

use super::conditions::{Condition, Property, TABLE};
use super::error::ConfigError;
use super::keys::URL;
use super::resolved::Resolved;
use super::run_config::RunConfig;
use super::scalar::Scalar;

impl Condition {
    fn holds(self, run: &Run<'_>) -> bool {
        let resolved = run.resolved;
        let number = |key| match resolved.entries.get(key).map(|entry| &entry.value) {
            Some(Scalar::Integer(number)) => *number as f64,
            Some(Scalar::Float(number)) => *number,
            _ => 0.0,
        };
        match self {
            Self::Is(key, values) => values.contains(&resolved.text(key)),
            Self::Not(key, value) => resolved.text(key) != value,
            Self::Above0(key) => number(key) > 0.0,
            Self::Zero(key) => number(key) == 0.0,
            Self::Filled(key) => !resolved.text(key).is_empty(),
            Self::Environment(property) => run.has(property),
        }
    }
}

/// The settings of a run and what is known of its environment.
struct Run<'a> {
    resolved: &'a Resolved,
    task: &'a TaskConfig,
    /// The environment from outside, once it is known.
    offered: Option<&'a EnvironmentSpec>,
    /// The simulator's environment, and whether it is a robot; `None` if it cannot be built.
    simulated: OnceCell<Option<(EnvironmentSpec, bool)>>,
}

impl<'a> Run<'a> {
    fn of(config: &'a RunConfig, offered: Option<&'a EnvironmentSpec>) -> Self {
        Self { resolved: &config.resolved, task: &config.task, offered, simulated: OnceCell::new() }
    }

    /// Whether the environment is such. What is not known yet is taken to hold, and so is everything about a task that cannot be
    /// built, which has its own error.
    fn has(&self, property: Property) -> bool {
        let is_outside = !self.resolved.text(URL).is_empty();
        match property {
            Property::Robot | Property::Contacts if is_outside => false,
            Property::Robot => self.simulated().is_none_or(|(_, is_robot)| *is_robot),
            Property::Contacts => {
                self.changes(|task| task.observation.contact_forces = ContactForces::Zeros)
            }
            Property::Continuous => self
                .environment(|spec| spec.agents.iter().any(|agent| agent.action.choices.is_none())),
            Property::Several => self.environment(|spec| spec.agents.len() > 1),
        }
    }

    /// Whether the environment is such, if it is known.
    fn environment(&self, is_such: impl Fn(&EnvironmentSpec) -> bool) -> bool {
        match self.offered {
            Some(spec) => is_such(spec),
            None if !self.resolved.text(URL).is_empty() => true,
            None => self.simulated().is_none_or(|(spec, _)| is_such(spec)),
        }
    }

    /// Whether the simulator's environment is another one after `change`.
    fn changes(&self, change: impl Fn(&mut TaskConfig)) -> bool {
        let plain = self.plain();
        let mut changed = plain.clone();
        change(&mut changed);
        let described = |task: &TaskConfig| {
            sim::environments(task, 1).map(|world| world.description().clone()).ok()
        };
        described(&plain) != described(&changed)
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

    /// What `key` lacks for an effect: `None` if it has one.
    fn missing(&self, key: &str) -> Option<Missing> {
        let (_, alternatives) = TABLE.iter().find(|(keys, _)| keys.contains(&key))?;
        let failing = |all: &&[Condition]| -> Vec<Condition> {
            all.iter().copied().filter(|condition| !condition.holds(self)).collect()
        };
        let failing: Vec<Vec<Condition>> = alternatives.iter().map(failing).collect();
        (!failing.iter().any(Vec::is_empty)).then_some(Missing(failing))
    }
}

/// Conditions that do not hold: all of one list are needed.
struct Missing(Vec<Vec<Condition>>);

impl Missing {
    /// The first setting that is not as needed, with its value and origin.
    fn instead(&self, resolved: &Resolved) -> String {
        let first = self.0.iter().flatten().find_map(|condition| condition.setting());
        let shown =
            |key| format!(", and {key} is {} ({})", resolved.plain(key), resolved.origin(key));
        first.map_or_else(String::new, shown)
    }
}

impl fmt::Display for Missing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let all = |conditions: &Vec<Condition>| {
            conditions.iter().map(ToString::to_string).collect::<Vec<_>>().join(" and ")
        };
        f.write_str(&self.0.iter().map(all).collect::<Vec<_>>().join(", or "))
    }
}

/// Refuses the first setting that the user gave and that has no effect in the run. `offered` is its environment from outside,
/// if it has one that is known already.
pub(crate) fn demand(
    config: &RunConfig,
    offered: Option<&EnvironmentSpec>,
) -> Result<(), ConfigError> {
    let (resolved, run) = (&config.resolved, Run::of(config, offered));
    let without = resolved.given.keys().find_map(|key| Some((key, run.missing(key)?)));
    let Some((key, missing)) = without else { return Ok(()) };
    Err(ConfigError::NoEffect {
        place: resolved.origin(key).to_owned(),
        key: key.clone(),
        needs: format!("{missing}{}", missing.instead(resolved)),
    })
}

/// Remarks on settings without an effect, for the comments of a configuration; empty for other settings.
pub(crate) fn remarks(config: &RunConfig) -> impl Fn(&str) -> String {
    let run = Run::of(config, None);
    move |key| {
        let missing = run.missing(key);
        missing.map_or_else(String::new, |missing| format!("; no effect: it needs {missing}"))
    }
}

#[cfg(test)]
mod tests;
