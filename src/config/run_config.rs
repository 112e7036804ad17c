//! The configuration of a run as the crates' types; each crate checks its sections.

use std::path::Path;

use marl::{ActionKind, ObservationScale};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use sim::ObservationNorm;

use crate::config::environment_section::EnvironmentSection;
use crate::config::{
    ConfigError, Request, Resolved, blame, effect, layers, message_steps, own_task,
};

/// More actor processes than this on one machine are a mistake.
const ACTORS_LIMIT: usize = 1024;

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
    /// Sections `update`, `critic`, `surprise`, `influence`, `maddpg`.
    pub(crate) training: marl::Config,
    /// Sections `environments`, `lease`, `audit`, `evaluation`, `checkpoint`, `learner`.
    pub(crate) learner: learner::config::Config,
    /// Section `log`.
    pub(crate) log: recording::trajectory_log::LogSettings,
}

impl RunConfig {
    /// Checks all settings and converts them to the crates' types. An error names the place where the user wrote the setting
    /// that causes it.
    pub(crate) fn build(resolved: Resolved) -> Result<Self, ConfigError> {
        let resolved = message_steps::followed(resolved);
        let config = Self::assemble(&resolved).map_err(|detail| {
            blame::refused(&resolved, &detail, |changed| Self::assemble(changed).map(drop))
        })?;
        effect::demand(&config, None)?;
        Ok(config)
    }

    pub(super) fn of_file(file: &Path) -> Result<Self, ConfigError> {
        let resumed = Some(file.to_path_buf());
        Self::build(layers::resolve(&Request { resumed, ..Request::default() })?)
    }

    /// The crates' types from the settings, or the message of the first crate that refuses its part.
    fn assemble(resolved: &Resolved) -> Result<Self, String> {
        let config = Self {
            run: section(resolved, "run")?,
            environment: section(resolved, "environment_service")?,
            task: task(resolved)?,
            policy: section(resolved, "policy")?,
            training: sections(resolved, &["update", "critic", "surprise", "influence", "maddpg"])?,
            learner: sections(
                resolved,
                &["environments", "lease", "audit", "evaluation", "checkpoint", "learner"],
            )?,
            log: section(resolved, "log")?,
            resolved: resolved.clone(),
        };
        config.validate()?;
        Ok(config)
    }

    fn validate(&self) -> Result<(), String> {
        self.policy.validate().map_err(|error| error.to_string())?;
        self.training.validate().map_err(|error| error.to_string())?;
        self.training.suits(&self.policy).map_err(|error| error.to_string())?;
        self.training.suits_observations(self.observations()).map_err(|error| error.to_string())?;
        self.learner.validate().map_err(|error| error.to_string())?;
        self.log.validate().map_err(|error| error.to_string())?;
        self.validate_run()?;
        match self.environment.url.is_empty() {
            true => self.validate_actions()?,
            false => self.environment.validate(self.log)?,
        }
        self.learner.suits(&self.policy).map_err(|error| error.to_string())
    }

    /// Builds the task only if the algorithm depends on its actions; without its scaling of observations, which has its
    /// own errors.
    fn validate_actions(&self) -> Result<(), String> {
        let kinds = [ActionKind::Continuous, ActionKind::Discrete { choices: 2 }];
        if kinds.iter().all(|&kind| self.training.suits_actions(kind).is_ok()) {
            return Ok(());
        }
        let mut task = self.task.clone();
        task.observation.norm = ObservationNorm::None;
        let task = sim::environments(&task, 1).map_err(|error| error.to_string())?;
        task.description().agents.iter().try_for_each(|agent| {
            let of_choices = |choices| ActionKind::Discrete { choices: choices as usize };
            let kind = agent.action.choices.map_or(ActionKind::Continuous, of_choices);
            self.training.suits_actions(kind).map_err(|error| error.to_string())
        })
    }

    fn validate_run(&self) -> Result<(), String> {
        if self.run.iterations == 0 && self.run.env_steps == 0 {
            return Err("one of run.env_steps and run.iterations must be at least 1".to_owned());
        }
        match self.run.actors {
            0..=ACTORS_LIMIT => Ok(()),
            actors => Err(format!("run.actors must lie in 0..={ACTORS_LIMIT}, is {actors}")),
        }
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
        self.iterations().saturating_mul(self.learner.environments.steps_per_iteration())
    }

    /// Actor processes on this machine.
    pub(crate) fn actors(&self) -> usize {
        match self.run.actors {
            0 => std::thread::available_parallelism().map_or(1, usize::from),
            actors => actors,
        }
    }
}

/// `task` and its sections, in the shape of the simulator's own type.
fn task(resolved: &Resolved) -> Result<sim::TaskConfig, String> {
    let mut table = tables(resolved, &["observation"]);
    table.insert("task".to_owned(), toml::Value::String(resolved.text("task").to_owned()));
    let (file, model) = (resolved.text(own_task::FILE), resolved.text(own_task::MODEL));
    if !file.is_empty() {
        let texts = [("file", file), ("model", model)];
        let texts = texts.map(|(key, text)| (key.to_owned(), toml::Value::String(text.to_owned())));
        let definition = toml::Value::Table(texts.into_iter().collect());
        table.insert("definition".to_owned(), definition);
    }
    typed(table)
}

/// One section as a type with the section's keys as fields.
fn section<T: DeserializeOwned>(resolved: &Resolved, name: &str) -> Result<T, String> {
    match tables(resolved, &[name]).remove(name) {
        Some(toml::Value::Table(table)) => typed(table),
        _ => unreachable!("configs/base.toml has the section `{name}`"),
    }
}

/// Several sections as a type with the sections as fields.
fn sections<T: DeserializeOwned>(resolved: &Resolved, names: &[&str]) -> Result<T, String> {
    typed(tables(resolved, names))
}

/// The tables `names`, with the tables inside them.
fn tables(resolved: &Resolved, names: &[&str]) -> toml::Table {
    let mut tables = toml::Table::new();
    for name in names {
        tables.insert((*name).to_owned(), toml::Value::Table(toml::Table::new()));
    }
    for (key, entry) in &resolved.entries {
        let mut path = key.split('.');
        if let Some(section) = path.next().and_then(|section| tables.get_mut(section)) {
            insert(section, path.collect(), entry.value.to_toml());
        }
    }
    tables
}

/// Puts `value` into `table` under the path `keys`, and makes the tables on the way.
fn insert(table: &mut toml::Value, keys: Vec<&str>, value: toml::Value) {
    let (last, sections) = keys.split_last().expect("every key of a section has a name");
    let mut inner = table;
    for section in sections {
        let tables = inner.as_table_mut().expect("a section holds tables and values");
        let empty = || toml::Value::Table(toml::Table::new());
        inner = tables.entry(*section).or_insert_with(empty);
    }
    let tables = inner.as_table_mut().expect("a section holds tables and values");
    tables.insert((*last).to_owned(), value);
}

fn typed<T: DeserializeOwned>(table: toml::Table) -> Result<T, String> {
    // A parser's message in one line.
    let told =
        |error: toml::de::Error| error.message().split_whitespace().collect::<Vec<_>>().join(" ");
    toml::Value::Table(table).try_into().map_err(told)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::presets;

    fn built(settings: &[&str]) -> Result<RunConfig, ConfigError> {
        let settings = settings.iter().map(|s| (*s).to_owned()).collect();
        RunConfig::build(layers::resolve(&Request { settings, ..Request::default() }).unwrap())
    }

    fn tasks_and_presets() -> Vec<(&'static str, &'static str)> {
        let presets = || presets::PRESETS.iter().map(|preset| preset.name);
        presets::TASKS.iter().flat_map(|task| presets().map(|preset| (task.name, preset))).collect()
    }

    #[test]
    fn every_task_with_every_algorithm_and_preset_is_valid_but_a_game_with_maddpg() {
        for (task, preset) in tasks_and_presets() {
            for algorithm in presets::ALGORITHMS {
                if sim::Robot::of_task(task).is_err() && algorithm.name == "maddpg" {
                    continue;
                }
                let algorithm = format!("algorithm={}", algorithm.name);
                let config = built(&[task, &algorithm, &format!("preset={preset}")]).unwrap();
                assert_eq!(config.task.task, task);
                sim::environments(&config.task, 1).unwrap();
            }
        }
    }

    #[test]
    fn an_external_environment_suits_every_algorithm_and_preset() {
        let (url, harl) = ("environment_service.url=http://localhost:7", "preset=harl");
        for algorithm in presets::ALGORITHMS {
            for preset in presets::PRESETS {
                let algorithm = format!("algorithm={}", algorithm.name);
                built(&[url, &algorithm, &format!("preset={}", preset.name)]).unwrap();
            }
        }
        assert_eq!(built(&[url, harl]).unwrap().resolved.text("observation.norm"), "feature_z");
    }

    #[test]
    fn a_variant_of_happo_is_its_three_weights_whatever_the_task_and_preset() {
        for (algorithm, alpha, lambda, entropy) in [
            ("happo", 0.0, 0.0, 0.01),
            ("happo-sm", 0.01, 0.0, 0.0),
            ("happo-smh", 0.01, 0.0, 0.01),
            ("happo-s2mia", 0.01, 0.01, 0.0),
            ("happo-mi", 0.0, 0.01, 0.0),
            ("happo-0", 0.0, 0.0, 0.0),
        ] {
            for (task, preset) in tasks_and_presets() {
                let settings =
                    [task, &format!("algorithm={algorithm}"), &format!("preset={preset}")];
                let marl::Config { update, surprise, influence, .. } =
                    built(&settings).unwrap().training;
                let harls = preset == "harl" && ["walker2d-2x3", "ant-4x2"].contains(&task);
                let entropy = if algorithm == "happo" && harls { 0.0 } else { entropy };
                let found = (surprise.alpha, influence.lambda, update.entropy);
                assert_eq!(found, (alpha, lambda, entropy), "{settings:?}");
            }
        }
    }

    #[test]
    fn counts_are_refused_for_numbers_and_taken_for_choices() {
        let count = "influence.estimator=count";
        assert!(built(&["cue-2x1", count]).is_ok());
        let message = built(&["halfcheetah-6x1", count]).unwrap_err().to_string();
        assert!(
            message.contains("for continuous actions: counts need discrete actions"),
            "{message}"
        );
    }

    #[test]
    fn maddpg_is_refused_for_choices_by_its_own_key() {
        let message = built(&["cue-2x1", "algorithm=maddpg"]).unwrap_err().to_string();
        let expected = "command line: algorithm = maddpg does not fit: update.rule = maddpg is out of \
                        range: happo or mappo for a task with discrete actions";
        assert_eq!(message, expected);
    }

    #[test]
    fn the_default_run_is_a_million_env_steps() {
        let config = built(&[]).unwrap();
        assert_eq!((config.iterations(), config.env_steps()), (1000, 1_000_000));
        assert_eq!(built(&["run.env_steps=1001"]).unwrap().iterations(), 2);
        assert_eq!(built(&["run.iterations=5"]).unwrap().env_steps(), 5_000);
    }

    #[test]
    fn maddpg_lays_what_it_refuses_at_the_setting_that_the_user_wrote() {
        for (setting, key) in [
            ("surprise.alpha=0.01", "surprise.alpha"),
            ("influence.lambda=0.01", "influence.lambda"),
            ("policy.core=gru", "policy.core"),
            ("observation.norm=running", "observation.norm"),
            ("critic.core=gru", "critic.core"),
            ("critic.state_norm=running", "critic.state_norm"),
        ] {
            let message = built(&["algorithm=maddpg", setting]).unwrap_err().to_string();
            assert!(message.contains(&format!("{key} = ")), "{message}");
            assert!(message.contains("with update.rule = maddpg"), "{message}");
        }
    }

    #[test]
    fn a_value_out_of_range_is_laid_at_its_key_and_place() {
        for (setting, key) in [
            ("update.gamma=1.5", "update.gamma"),
            ("update.learning_rate=-1", "update.learning_rate"),
            ("environments.count=0", "environments.count"),
            ("environments.message_steps=25", "environments.message_steps"),
            ("policy.core=lstm", "policy.core"),
            ("policy.hidden=0", "policy.hidden"),
            ("observation.mode=eyes", "observation.mode"),
            ("observation.norm=mean", "observation.norm"),
            ("critic.core=lstm", "critic.core"),
            ("critic.state_norm=mean", "critic.state_norm"),
            ("run.seed=-1", "run.seed"),
            ("run.actors=100000", "run.actors"),
            ("run.env_steps=0", "run.env_steps"),
            ("surprise.density=oracle", "surprise.density"),
            ("surprise.alpha=-1", "surprise.alpha"),
            ("influence.kappa=-1", "influence.kappa"),
            ("influence.lag=2", "influence.lag"),
            ("influence.estimator=count", "influence.estimator"),
            ("lease.ttl_secs=0", "lease.ttl_secs"),
            ("critic.clip=-1", "critic.clip"),
            ("maddpg.replay=2000000", "maddpg.replay"),
            ("maddpg.polyak=0", "maddpg.polyak"),
            ("log.episodes=some", "log.episodes"),
            ("log.episodes=0", "log.episodes"),
            ("log.max_file_mib=0", "log.max_file_mib"),
        ] {
            let message =
                built(&["halfcheetah-6x1", "algorithm=happo", setting]).unwrap_err().to_string();
            assert!(message.starts_with("command line: "), "{message}");
            assert!(message.contains(key) && !message.contains('\n'), "{message}");
        }
    }
}
