//! The settings of an existing run: its `config.toml`, or a checkpoint's copy if that file is damaged.

use std::path::{Path, PathBuf};

use learner::plain_file;
use learner::run_folder::{CONFIG, MANIFEST, RunFolder};
use sim::{AgentDescription, Robot};

use crate::config::ConfigError;
use crate::config::run_config::RunConfig;

/// Unit of continuous actions, in the manifest of a run; earlier versions did not record it.
pub(crate) const ACTION_UNIT: (&str, &str) = ("action_unit", "half_range");

/// The file with the settings of the run in `folder`, and what it says: `config.toml`, or the newest checkpoint's copy if
/// `config.toml` is damaged or has other semantic settings than the run. Refuses a run whose actions have another unit.
pub(crate) fn settings_of_run(folder: &Path) -> Result<(PathBuf, RunConfig), ConfigError> {
    let (file, config) = readable(folder)?;
    demand_unit(&file, folder, &config)?;
    Ok((file, config))
}

/// Refuses a run of an earlier version in which an agent acted in the unit of its motors' controls: if all of them had
/// the same range, actions were not scaled.
fn demand_unit(file: &Path, folder: &Path, config: &RunConfig) -> Result<(), ConfigError> {
    let (key, unit) = ACTION_UNIT;
    if config.task.definition.is_none()
        || RunFolder::recorded(&RunFolder::of(folder)).is_none_or(|manifest| manifest[key] == unit)
    {
        return Ok(());
    }
    let world =
        sim::environments(&config.task, 1).map_err(|error| unreadable(file, error.to_string()))?;
    let own = |robot: &Robot, agent: &AgentDescription| {
        let mut ranges = agent.joints.iter().filter_map(|joint| robot.control_range(joint));
        let first = ranges.next().unwrap_or([-1.0, 1.0]);
        first != [-1.0, 1.0] && ranges.all(|range| range == first)
    };
    let agents = &world.description().agents;
    if world.robot().is_none_or(|robot| !agents.iter().any(|agent| own(robot, agent))) {
        return Ok(());
    }
    let detail = "the run is of an earlier version, whose actions were the controls of the motors; now -1 and 1 are the \
                  limits of a motor's control range: train it again";
    Err(unreadable(file, detail.to_owned()))
}

fn readable(folder: &Path) -> Result<(PathBuf, RunConfig), ConfigError> {
    let file = folder.join(CONFIG);
    let read = match plain_file::refusal(&file) {
        None => RunConfig::of_file(&file),
        Some(why) => Err(unreadable(&file, why.to_string())),
    };
    let own = read.and_then(|config| unchanged(&file, folder, config));
    let Err(why) = own else { return own.map(|config| (file, config)) };
    let Ok(loaded) = learner::checkpoint::load_newest(folder) else { return Err(why) };
    let copy = loaded.path.join(learner::checkpoint::SETTINGS);
    let config = RunConfig::of_file(&copy).map_err(|_| why.clone())?;
    tracing::warn!("{why}; the settings in {} are used", copy.display());
    Ok((copy, config))
}

/// The configuration of the run in `folder`.
pub(crate) fn config_of_run(folder: &Path) -> Result<RunConfig, ConfigError> {
    settings_of_run(folder).map(|(_, config)| config)
}

/// Refuses settings with another hash than the run's manifest records.
fn unchanged(file: &Path, folder: &Path, config: RunConfig) -> Result<RunConfig, ConfigError> {
    let recorded = RunFolder::recorded_config_sha256(folder);
    let found = config.resolved.sha256_as(recorded.as_deref().unwrap_or_default());
    let found = policy::arrays::hex(&found);
    match recorded {
        Some(expected) if expected != found => {
            let detail = format!(
                "these are not the run's settings: their SHA-256 is {found}, {MANIFEST} has {expected}"
            );
            Err(unreadable(file, detail))
        }
        _ => Ok(config),
    }
}

fn unreadable(file: &Path, detail: String) -> ConfigError {
    ConfigError::Unreadable { place: file.display().to_string(), detail }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Request, layers};

    #[test]
    fn a_folder_of_an_earlier_version_whose_hash_covered_the_environments_of_a_slot_is_read() {
        let resolved = layers::resolve(&Request::default()).unwrap();
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join(CONFIG), resolved.to_toml()).unwrap();
        let read = |recorded: &str| {
            let manifest = serde_json::json!({"config_sha256": recorded}).to_string();
            std::fs::write(folder.path().join(MANIFEST), manifest).unwrap();
            settings_of_run(folder.path())
        };
        let earlier = policy::arrays::hex(&resolved.sha256s().nth(2).unwrap());
        assert!(read(&earlier).is_ok());
        let refusal = read(&"ab".repeat(32)).unwrap_err().to_string();
        assert!(refusal.contains("these are not the run's settings"), "{refusal}");
    }
}
