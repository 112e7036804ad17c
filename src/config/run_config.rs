//! The configuration of a run as the crates' types; each section checks its own ranges.

use std::collections::BTreeMap;
use std::path::Path;

use marl::ObservationScale;
use policy::setting::{SettingError, between, within};
use proto::EnvironmentSpec;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use sim::{EnvironmentBatch, ObservationNorm, TaskDefinition};

use super::conditions::RunContext;
use super::layers::{self, Request};
use super::resolved::{ConfigError, Resolved, in_words};
use super::{agents, effect, keys, known, message_steps, own_task, rules};
use crate::run::start;

/// More actor processes than this on one machine are a mistake.
const ACTORS_LIMIT: usize = 1024;
/// Most environment steps of a run: numbers of JSON are exact up to it, so the metrics count each.
const MOST_STEPS: u64 = 1 << 53;

/// The section `run`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RunSection {
    /// Seed of every random draw.
    pub(crate) seed: u64,
    /// Environment steps after which the run ends, rounded up to whole iterations.
    pub(crate) env_steps: u64,
    /// Iterations after which the run ends; 0: from `env_steps`.
    pub(crate) iterations: u64,
    /// Actor processes on this machine; 0: one per core.
    pub(crate) actors: usize,
    /// Run folder; empty: named for task, algorithm, seed and time.
    #[expect(
        dead_code,
        reason = "it is read from the resolved settings, before a configuration is built"
    )]
    dir: String,
}

impl RunSection {
    fn validate(&self) -> Result<(), SettingError> {
        if self.iterations == 0 {
            within("run.env_steps", self.env_steps, 1.., "at least 1 with run.iterations = 0")?;
        }
        between("run.actors", self.actors, 0, ACTORS_LIMIT)
    }
}

/// The section `environment_service`: the external program that offers the environment.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct EnvironmentSection {
    /// URL of the program that offers the environment; empty: the simulator.
    pub(crate) url: String,
    /// SHA-256 of that program's description of the environment; empty without a program and before the start.
    pub(crate) description: String,
}

impl EnvironmentSection {
    /// Arguments that give an actor process the URL.
    pub(crate) fn arguments(&self) -> Vec<String> {
        match self.url.as_str() {
            "" => Vec::new(),
            url => vec!["--environment".to_owned(), url.to_owned()],
        }
    }
}

/// The sections that only this program combines.
#[derive(Deserialize)]
struct Sections {
    run: RunSection,
    environment_service: EnvironmentSection,
    observation: sim::ObservationConfig,
    policy: policy::PolicyConfig,
    log: recording::trajectory_log::LogSettings,
}

/// The whole configuration of a run.
#[derive(Clone, Debug)]
pub(crate) struct RunConfig {
    /// All settings with their origins.
    pub(crate) resolved: Resolved,
    /// Section `run`.
    pub(crate) run: RunSection,
    /// Section `environment_service`.
    pub(crate) environment: EnvironmentSection,
    /// `task` and section `observation`.
    pub(crate) task: sim::TaskConfig,
    /// Section `policy`.
    pub(crate) policy: policy::PolicyConfig,
    /// Sections `update`, `critic`, `surprise`, `influence`, `maddpg` and, with that algorithm only, `hasac`.
    pub(crate) training: marl::TrainingConfig,
    /// Sections `environments`, `lease`, `audit`, `evaluation`, `checkpoint`, `learner`.
    pub(crate) learner: learner::config::LearnerConfig,
    /// Section `log`.
    pub(crate) log: recording::trajectory_log::LogSettings,
}

impl RunConfig {
    /// The configuration with the settings that `request` names, as [`Self::build`]. The policies from which a new run starts
    /// are read.
    pub(crate) fn of(request: &Request) -> Result<Self, ConfigError> {
        let mut config = Self::build(layers::resolve(request)?)?;
        if request.resumed.is_none() || config.resolved.is_given(keys::START) {
            start::identify(&mut config)?;
        }
        config.resolved.remove_usual(known::is_usual);
        Ok(config)
    }

    /// The configuration with these settings, and no others of this process.
    pub(crate) fn with(settings: &[&str]) -> Result<Self, ConfigError> {
        let settings = settings.iter().map(|setting| (*setting).to_owned()).collect();
        Self::of(&Request { settings, ..Request::default() })
    }

    /// Checks all settings and converts them to the crates' types. An error names the place where the user wrote the setting
    /// that causes it.
    pub(crate) fn build(resolved: Resolved) -> Result<Self, ConfigError> {
        resolved.demand_normal()?;
        let config = Self::read(message_steps::followed(resolved))?;
        if let Err(error) = config.validate() {
            // Another value of a setting without an effect would be refused, too.
            effect::demand(&RunContext::of(&config, None))?;
            return Err(ConfigError::out_of_range(&config.resolved, &error));
        }
        config.demand_suitable(None)?;
        config.demand_terms()?;
        Ok(config)
    }

    /// The configuration with the settings of this file, of which each key has a value.
    pub(crate) fn of_file(file: &Path) -> Result<Self, ConfigError> {
        let resumed = Some(file.to_path_buf());
        Self::of(&Request { resumed, ..Request::default() })
    }

    /// Converts the settings to the crates' types.
    fn read(resolved: Resolved) -> Result<Self, ConfigError> {
        let mut sectioned = resolved.clone();
        sectioned.remove_start();
        let text = sectioned.to_toml();
        let sections: Sections = typed(&resolved, &text)?;
        let [file, model] =
            [own_task::FILE, own_task::MODEL].map(|key| resolved.text(key).to_owned());
        let definition = (!file.is_empty()).then_some(TaskDefinition { file, model });
        let weights: BTreeMap<String, f32> = weights(&resolved).collect();
        Ok(Self {
            run: sections.run,
            environment: sections.environment_service,
            task: sim::TaskConfig {
                task: resolved.text("task").to_owned(),
                definition,
                weights: (!weights.is_empty()).then_some(weights),
                observation: sections.observation,
            },
            policy: sections.policy,
            training: typed(&resolved, &text)?,
            learner: typed(&resolved, &text)?,
            log: sections.log,
            resolved,
        })
    }

    fn validate(&self) -> Result<(), SettingError> {
        self.run.validate()?;
        self.policy.validate()?;
        self.training.validate()?;
        self.learner.validate()?;
        let iteration = self.learner.environments.steps_per_iteration();
        between("run.env_steps", self.run.env_steps, 0, MOST_STEPS)?;
        between("run.iterations", self.run.iterations, 0, MOST_STEPS / iteration)?;
        rules::numbers(self)
    }

    /// Refuses settings that exclude each other or the environment `offered`, and given settings without an effect.
    pub(crate) fn demand_suitable(
        &self,
        offered: Option<&EnvironmentSpec>,
    ) -> Result<(), ConfigError> {
        let run = RunContext::of(self, offered);
        rules::demand(&run)?;
        if let Some(environment) = offered {
            agents::demand(self, environment)?;
        }
        // Before, given settings of HASAC without its rule are refused by name.
        effect::demand(&run)?;
        let whole = rules::demand_rule_of_settings(self);
        whole.map_err(|error| ConfigError::out_of_range(&self.resolved, &error))
    }

    /// Refuses a task of the simulator that cannot be built with these settings, or whose agents do not suit them.
    pub(crate) fn demand_task(&self) -> Result<(), ConfigError> {
        if !self.environment.url.is_empty() {
            return Ok(());
        }
        self.demand_suitable(Some(self.environments(1)?.description()))
    }

    /// Environments of the simulator's task.
    ///
    /// # Errors
    /// As of [`sim::environments`], with the place that chose the task.
    pub(crate) fn environments(
        &self,
        count: usize,
    ) -> Result<Box<dyn EnvironmentBatch>, ConfigError> {
        sim::environments(&self.task, count).map_err(|why| {
            let detail = format!("cannot build the task: {why}");
            ConfigError::refused(&self.resolved, &["task"], &detail)
        })
    }

    /// Refuses weights of reward terms that the task does not have.
    fn demand_terms(&self) -> Result<(), ConfigError> {
        let keys = self.resolved.entries.keys();
        let mut weights = keys.filter_map(|key| Some((key, keys::weighted_term(key)?))).peekable();
        let Some((first, _)) = weights.peek().copied() else { return Ok(()) };
        self.task.check().map_err(|error| {
            let unknown = weights.find(|(_, term)| self.task.weight_in_file(term).is_err());
            let key = unknown.map_or(first, |(key, _)| key);
            ConfigError::refused(&self.resolved, &[key], &error.to_string())
        })
    }

    /// How the learner scales observations.
    pub(crate) fn observations(&self) -> ObservationScale {
        match self.task.observation.norm {
            ObservationNorm::Running => ObservationScale::Running,
            ObservationNorm::FeatureZ | ObservationNorm::None => ObservationScale::AsShown,
        }
    }

    /// Iterations of the whole run.
    pub(crate) fn iterations(&self) -> u64 {
        match self.run.iterations {
            0 => self.run.env_steps.div_ceil(self.learner.environments.steps_per_iteration()),
            iterations => iterations,
        }
    }

    /// Environment steps of the whole run.
    pub(crate) fn env_steps(&self) -> u64 {
        self.iterations() * self.learner.environments.steps_per_iteration()
    }

    /// Actor processes on this machine.
    pub(crate) fn actors(&self) -> usize {
        match self.run.actors {
            0 => std::thread::available_parallelism().map_or(1, usize::from),
            actors => actors,
        }
    }
}

/// The weights of reward terms that replace those of the task's file, by term.
fn weights(resolved: &Resolved) -> impl Iterator<Item = (String, f32)> {
    resolved.entries.iter().filter_map(|(key, entry)| {
        let weight = entry.value.as_float()? as f32;
        Some((keys::weighted_term(key)?.to_owned(), weight))
    })
}

/// The sections of `text`, which are the settings as TOML, in a type with these sections as fields.
fn typed<T: DeserializeOwned>(resolved: &Resolved, text: &str) -> Result<T, ConfigError> {
    toml::from_str(text).map_err(|error| {
        let key = key_at(text, error.span().map_or(0, |span| span.start));
        ConfigError::refused(resolved, &[&key], &in_words(error.message()))
    })
}

/// The key of the value at `offset` in `text`.
fn key_at(text: &str, offset: usize) -> String {
    let before = &text[..offset];
    let line = before.rfind('\n').map_or(0, |end| end + 1);
    let name = text[line..].split(" = ").next().unwrap_or_default();
    let section = before.rsplit_once("\n[").and_then(|(_, section)| section.split_once(']'));
    section.map_or_else(|| name.to_owned(), |(section, _)| format!("{section}.{name}"))
}

#[cfg(test)]
mod tests;
