//! What a resume may change, and which program may resume or verify a run: one that computes the same bits and resolves the same
//! settings.

use std::path::Path;

use learner::store::run_folder::{CONFIG, MANIFEST, RunFolder};
use proto::Digest;

use crate::config::keys::{START, START_SHA256};
use crate::config::message_steps::MESSAGE;
use crate::config::run_config::RunConfig;
use crate::config::{ConfigError, keys};
use crate::errors::Usage;
use crate::figures::chart;
use crate::run::{BUILD, build_of};

const DECAYS: &str =
    "with update.learning_rate_decay = linear every step depends on the length of the run";
const MAY_RISE: &str = "it may only be raised";

/// Refuses a setting of `new` that would change the result of the run, by name: the first that the user gave, then the first
/// that follows one.
pub(crate) fn check(old: &RunConfig, new: &RunConfig) -> Result<(), ConfigError> {
    let value = |config: &RunConfig, key: &str| {
        config.resolved.entries.get(key).map(|entry| entry.value.clone())
    };
    let added = new.resolved.semantic().filter(|(key, _)| value(old, key).is_none());
    let mut settings: Vec<&str> =
        old.resolved.semantic().chain(added).map(|(key, _)| key).collect();
    settings.sort_by_key(|key| !new.resolved.is_given(key));
    for key in settings {
        if keys::FILLED_IN == key && new.environment.description.is_empty() {
            // The environment's description is not known yet; `Offered` compares it later.
            continue;
        }
        if key == MESSAGE && !new.resolved.is_given(key) && !new.environment.url.is_empty() {
            // The run's value may be lower, so that the messages of its environment fit.
            continue;
        }
        if value(new, key) != value(old, key) {
            let allowed = if keys::is_length(key) { DECAYS.to_owned() } else { may_change() };
            let names_others = value(new, START) != value(old, START);
            let key = if key == START_SHA256 && names_others { START } else { key };
            let values = (old.resolved.shown(key), new.resolved.shown(key));
            return Err(fixed(new, key, values, &allowed));
        }
    }
    if new.iterations() < old.iterations() {
        let lowered = |key: &&&str| new.resolved.shown(key) != old.resolved.shown(key);
        let key = keys::LENGTH.iter().find(lowered).unwrap_or(&keys::LENGTH[0]);
        return Err(fixed(new, key, (length(old), length(new)), MAY_RISE));
    }
    Ok(())
}

fn fixed(
    config: &RunConfig,
    key: &str,
    (old, new): (String, String),
    allowed: &str,
) -> ConfigError {
    let detail =
        format!("`{key}` cannot change on resume: the run has {old}, found {new}; {allowed}");
    match config.resolved.entries.get(key) {
        Some(entry) => ConfigError::at(&entry.origin, detail),
        None => ConfigError::Other(detail),
    }
}

/// Length of a run in iterations, with `run.env_steps` if that setting determines it.
fn length(config: &RunConfig) -> String {
    let iterations = chart::count_of(config.iterations(), "iteration");
    match config.run.iterations {
        0 => format!("{iterations} (run.env_steps = {})", config.run.env_steps),
        _ => iterations,
    }
}

/// Refuses the run in `folder` if this program, whose fingerprint is `rollout`, computes other bits or resolves
/// its settings to another hash than `config`.
pub(crate) fn demand_same_program(
    folder: &Path,
    rollout: Digest,
    config: Digest,
) -> anyhow::Result<()> {
    let Some(manifest) = RunFolder::recorded(folder) else {
        // The checkpoint has the hash of its settings, too, and the learner writes the manifest again.
        let file = folder.join(MANIFEST);
        tracing::warn!("{} is missing or damaged: its fingerprint is not compared", file.display());
        return Ok(());
    };
    let recorded = |key: &str| manifest[key].as_str().unwrap_or("unknown").to_owned();
    let folder = folder.display();
    let build = build_of(&manifest);
    for (key, own, differs) in [
        ("rollout_fingerprint", rollout, "computes other numbers"),
        ("config_sha256", config, "has other settings"),
    ] {
        let of_run = recorded(key);
        let own = own.to_string();
        // Builds without a repository are not distinguished.
        let is_own_build = build == BUILD && !build.ends_with("+unknown");
        if of_run != own && key == "config_sha256" && is_own_build {
            return Err(Usage::new(format!(
                "{folder}/{MANIFEST} is of other settings: its {key} is {of_run}, that of {folder}/{CONFIG} is {own}; if \
                 another build made the run, use that one; otherwise restore the file that is not of this run, or move {MANIFEST} \
                 away to have it written again"
            ))
            .into());
        }
        if of_run != own {
            return Err(Usage::new(format!(
                "{folder} was trained by a program that {differs}: its {key} is {of_run}, this \
                 program's is {own}; use version {}, commit {} instead of {BUILD}",
                recorded("version"),
                recorded("git_commit"),
            ))
            .into());
        }
    }
    Ok(())
}

/// Warns if another build began the run in `folder`.
pub(crate) fn warn_of_other_build(folder: &Path) {
    let build = RunFolder::recorded(folder).map(|manifest| build_of(&manifest));
    if let Some(build) = build.filter(|build| build != BUILD) {
        tracing::warn!(
            "{} was begun by {build}, this program is {BUILD}: the fingerprints are equal, but they do not cover the update of \
             the policies; for the same weights, use that build",
            folder.display()
        );
    }
}

fn may_change() -> String {
    let free = keys::free_on_resume();
    format!("a resume may change {free}, and raise run.iterations or run.env_steps")
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn config(settings: &[&str]) -> RunConfig {
        RunConfig::with(settings).unwrap()
    }

    #[test]
    fn operational_keys_may_change_and_the_length_may_rise() {
        let old = ["run.iterations=5"];
        let linear = ["run.iterations=5", "update.learning_rate_decay=linear"];
        for (old, new) in [
            (&old[..], &["run.iterations=5", "run.actors=7", "checkpoint.every=3"][..]),
            (&old, &["run.iterations=9"]),
            (&old, &["run.iterations=0", "run.env_steps=1e6"]),
            (&linear, &[linear[0], linear[1], "run.actors=7"]),
        ] {
            assert_eq!(check(&config(old), &config(new)), Ok(()), "{new:?}");
        }
    }

    #[test]
    fn a_change_of_what_is_computed_is_refused_by_name_with_what_may_change() {
        let linear = "update.learning_rate_decay=linear";
        let outside = |description: &str| {
            let description = format!("environment_service.description={description}");
            config(&["environment_service.url=http://localhost:7", &description])
        };
        assert_eq!(check(&outside("abc"), &outside("")), Ok(()), "it is asked for later");
        let five = || config(&["run.iterations=5"]);
        for (old, new, words) in [
            (
                five(),
                config(&["run.iterations=5", "update.clip=0.3"]),
                "`update.clip` cannot change on resume: the run has 0.1, found 0.3; a resume may change run.actors, \
                 environment_service.url, environments.per_slot, lease.*, audit.*, evaluation.*, checkpoint.*, learner.*, \
                 log.*, and raise run.iterations or run.env_steps",
            ),
            (
                five(),
                config(&["run.iterations=5", "run.seed=2"]),
                "`run.seed` cannot change on resume",
            ),
            (
                config(&["run.iterations=5", linear]),
                config(&["run.iterations=9", linear]),
                "`run.iterations` cannot change on resume: the run has 5, found 9; with \
                 update.learning_rate_decay = linear every step depends on the length of the run",
            ),
            (
                outside("abc"),
                outside("def"),
                "`environment_service.description` cannot change on resume",
            ),
            (
                five(),
                config(&["run.iterations=4"]),
                "`run.iterations` cannot change on resume: the run has 5 iterations, found 4 iterations; it may only be raised",
            ),
            (
                config(&["run.env_steps=2001"]),
                config(&["run.iterations=1"]),
                "`run.iterations` cannot change on resume: the run has 3 iterations (run.env_steps = 2001), found 1 \
                 iteration; it may only be raised",
            ),
            (
                config(&["run.env_steps=2001"]),
                config(&["run.env_steps=2000"]),
                "`run.env_steps` cannot change on resume: the run has 3 iterations (run.env_steps = 2001), found 2 \
                 iterations (run.env_steps = 2000); it may only be raised",
            ),
        ] {
            let error = check(&old, &new).unwrap_err().to_string();
            let (line, is_whole) =
                (format!("command line: {words}"), !words.ends_with("on resume"));
            assert!(error.starts_with(&line) && (!is_whole || error == line), "{error}");
        }
    }

    #[test]
    fn only_a_run_with_this_programs_fingerprint_and_settings_is_resumed() {
        let resume_of = |commit: &str, rollout: u8, config: u8| {
            let manifest = json!({
                "rollout_fingerprint": Digest([rollout; 32]).to_string(),
                "config_sha256": Digest([config; 32]).to_string(),
                "version": "0.1.0",
                "git_commit": commit,
            });
            let folder = tempfile::tempdir().unwrap();
            RunFolder::claim_new(folder.path()).unwrap().begin("", &manifest).unwrap();
            let known = demand_same_program(folder.path(), Digest([1; 32]), Digest([4; 32]));
            known.map_err(|error| error.to_string())
        };
        let resume = |rollout, config| resume_of("abc", rollout, config);
        assert_eq!(resume(1, 4), Ok(()));
        let (_, own) = BUILD.split_once('+').unwrap();
        let refusal = resume_of(own, 1, 3).unwrap_err();
        let remedy = "or move manifest.json away to have it written again";
        assert!(
            refusal.contains("manifest.json is of other settings") && refusal.ends_with(remedy)
        );
        for (other, named) in [
            (resume(3, 4), "computes other numbers: its rollout_fingerprint is 0303"),
            (resume(1, 3), "has other settings: its config_sha256 is 0303"),
        ] {
            let refusal = other.unwrap_err();
            assert!(refusal.contains(named), "{refusal}");
            let builds = format!("; use version 0.1.0, commit abc instead of {BUILD}");
            assert!(refusal.ends_with(&builds), "{refusal}");
        }
    }
}
