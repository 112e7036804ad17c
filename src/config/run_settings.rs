//! The settings of an existing run: its `config.toml`, or a checkpoint's copy if that file is damaged.

use std::path::{Path, PathBuf};

use learner::store::plain_file;
use learner::store::run_folder::{CONFIG, MANIFEST, RunFolder};

use crate::config::ConfigError;
use crate::config::run_config::RunConfig;

/// The file with the settings of the run in `folder`, and what it says: `config.toml`, or the newest checkpoint's copy if
/// `config.toml` is damaged or has other semantic settings than the run.
pub(crate) fn settings_of_run(folder: &Path) -> Result<(PathBuf, RunConfig), ConfigError> {
    let file = folder.join(CONFIG);
    let read = match plain_file::refusal(&file) {
        None => RunConfig::of_file(&file).map_err(|error| of_another_version(folder, error)),
        Some(why) => Err(unreadable(&file, why.to_string())),
    };
    let own = read.and_then(|config| unchanged(&file, folder, config));
    let Err(why) = own else { return own.map(|config| (file, config)) };
    let Ok(loaded) = learner::store::checkpoint::load_newest(folder) else { return Err(why) };
    let copy = loaded.path.join(learner::store::checkpoint::SETTINGS);
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
    let found = policy::arrays::hex(&config.resolved.sha256());
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

/// Explains a key in a run's own settings that this program does not know, if another version or commit made the run.
fn of_another_version(folder: &Path, error: ConfigError) -> ConfigError {
    let (ConfigError::UnknownKey { place, key, .. }, Some(manifest)) =
        (&error, RunFolder::recorded(folder))
    else {
        return error;
    };
    let recorded = |field: &str| manifest[field].as_str().unwrap_or("unknown").to_owned();
    let (version, commit) = (recorded("version"), recorded("git_commit"));
    if (version.as_str(), commit.as_str()) == (env!("CARGO_PKG_VERSION"), env!("S2MIA_GIT_COMMIT"))
    {
        return error;
    }
    let detail = format!(
        "unknown key `{key}`: another version made the run, {version}, commit {commit}; train again"
    );
    ConfigError::Unreadable { place: place.clone(), detail }
}

fn unreadable(file: &Path, detail: String) -> ConfigError {
    ConfigError::Unreadable { place: file.display().to_string(), detail }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Request, layers};

    #[test]
    fn an_unknown_key_in_the_settings_of_a_run_names_the_version_that_made_it() {
        let resolved = layers::resolve(&Request::default()).unwrap();
        let text = resolved.to_toml().replace("[critic]\n", "[critic]\ninput = \"state\"\n");
        let folder = tempfile::tempdir().unwrap();
        let start = serde_json::json!({"version": "0.0.1", "git_commit": "abc"});
        RunFolder::claim_new(folder.path()).unwrap().begin(&text, &start).unwrap();
        let refusal = settings_of_run(folder.path()).unwrap_err().to_string();
        let expected = "config.toml: unknown key `critic.input`: another version made the run, 0.0.1, commit abc; train again";
        assert!(refusal.ends_with(expected), "{refusal}");
    }

    #[test]
    fn a_folder_with_other_settings_than_its_manifest_records_is_refused() {
        let resolved = layers::resolve(&Request::default()).unwrap();
        let read = |recorded: &str| {
            let folder = tempfile::tempdir().unwrap();
            let start = serde_json::json!({"config_sha256": recorded});
            RunFolder::claim_new(folder.path())
                .unwrap()
                .begin(&resolved.to_toml(), &start)
                .unwrap();
            settings_of_run(folder.path())
        };
        assert!(read(&policy::arrays::hex(&resolved.sha256())).is_ok());
        let refusal = read(&"ab".repeat(32)).unwrap_err().to_string();
        assert!(refusal.contains("these are not the run's settings"), "{refusal}");
    }
}
