//! Properties of keys: which affect the result of a run, and which are spelled alike.

use sim::spelling::nearest_by;
use strsim::osa_distance;

use super::scalar::Scalar;

/// Key of the run folder.
const FOLDER: &str = "run.dir";

/// Key of the URL of the program that provides the environment; empty for the simulator.
pub(crate) const URL: &str = "environment_service.url";

/// Key of the environments of a slot, and of those of the run, of which they are a divisor. Earlier versions hashed it as a
/// semantic key.
pub(crate) const PER_SLOT: (&str, &str) = ("environments.per_slot", "environments.count");

/// Keys and sections that affect where and when a run computes, never its result.
const OPERATIONAL: &[&str] = &[
    "run.actors",
    FOLDER,
    URL,
    PER_SLOT.0,
    "lease.",
    "audit.",
    "evaluation.",
    "checkpoint.",
    "metrics.",
    "learner.",
    "log.",
];

/// Keys that had another name in an earlier version, and their name now.
const RENAMED: &[(&str, &str)] = &[
    ("environment.url", URL),
    ("environment.description", "environment_service.description"),
    ("environments.chunk_steps", "environments.message_steps"),
    ("policy.chunk_steps", "policy.backpropagation_steps"),
    ("policy.initial_log_std", "policy.initial_sigma"),
    ("surprise.sigma_floor", "surprise.feature_sigma_floor"),
    ("surprise.vae_hidden", "surprise.vae.hidden"),
    ("surprise.vae_latent", "surprise.vae.latent"),
    ("surprise.vae_epochs", "surprise.vae.epochs"),
    ("surprise.vae_minibatches", "surprise.vae.minibatches"),
    ("surprise.vae_learning_rate", "surprise.vae.learning_rate"),
    ("influence.sigma_floor", "influence.posterior_sigma_floor"),
];

/// The new name of a key of an earlier version.
pub(crate) fn renamed(key: &str) -> Option<&'static str> {
    RENAMED.iter().find(|(old, _)| *old == key).map(|(_, now)| *now)
}

/// How the value of a renamed key differs from the old one, for messages.
pub(crate) fn other_meaning(now: &str) -> &'static str {
    match now {
        "policy.initial_sigma" => ", and is sigma itself: sigmoid(initial_log_std) * sigma_scale",
        _ => "",
    }
}

/// Semantic keys that a later version added, each with the value that means what earlier versions did, as TOML writes it.
/// With that value the key takes no part in the hash of the settings, so runs of earlier versions can be resumed.
pub(crate) const ADDED: &[(&str, &str)] =
    &[("task_file.text", "\"\""), ("task_file.model", "\"\""), ("critic.core", "\"mlp\"")];

/// The settings that have no effect because `key` has this `value`, which is the purpose of the value.
pub(super) fn switched_off(key: &str, value: &Scalar) -> &'static [&'static str] {
    match (key, *value == Scalar::Integer(0)) {
        ("run.iterations", false) => &["run.env_steps"],
        ("evaluation.every_steps", true) => &["evaluation.episodes", "evaluation.sampled"],
        _ => &[],
    }
}

/// The semantic key that the program fills in when a run starts.
pub(crate) const FILLED_IN: &str = "environment_service.description";

/// Keys that set only the length of a run; a resume may raise them.
pub(crate) const LENGTH: &[&str] = &["run.iterations", "run.env_steps"];

/// The setting and its value with which the length of a run changes every step.
pub(crate) const DEPENDS_ON_LENGTH: (&str, &str) = ("update.learning_rate_decay", "linear");

/// The operational keys and sections that a resume may change, for messages. The run folder cannot change.
pub(crate) fn free_on_resume() -> String {
    let named = OPERATIONAL.iter().filter(|key| **key != FOLDER);
    let named = named.map(|key| match key.strip_suffix('.') {
        Some(section) => format!("{section}.*"),
        None => (*key).to_owned(),
    });
    named.collect::<Vec<_>>().join(", ")
}

/// Whether a key's value changes what a run computes.
pub(crate) fn is_semantic(key: &str) -> bool {
    !is_length(key)
        && !OPERATIONAL.iter().any(|o| *o == key || (o.ends_with('.') && key.starts_with(o)))
}

/// Whether a key sets only the length of the run.
pub(crate) fn is_length(key: &str) -> bool {
    LENGTH.contains(&key)
}

/// The keys that equal `word` apart from separators, with or without their section.
pub(crate) fn spelled<'a>(word: &str, known: impl IntoIterator<Item = &'a str>) -> Vec<&'a str> {
    let plain = |text: &str| text.replace(['.', '-'], "_").replace("__", "_");
    let word = plain(word);
    let last = |key: &'a str| key.rsplit('.').next().unwrap_or(key);
    known.into_iter().filter(|key| plain(key) == word || last(key) == word).collect()
}

/// The candidate most similar to `word`, if it is a few typing errors away at most.
pub(crate) fn nearest<'a>(
    word: &str,
    candidates: impl IntoIterator<Item = &'a str>,
) -> Option<&'a str> {
    nearest_by(word, candidates, distance_to_key)
}

/// Edit distance; a word without its section is also compared with the last part of the key.
fn distance_to_key(word: &str, key: &str) -> usize {
    let whole = osa_distance(word, key);
    match key.rsplit_once('.') {
        Some((_, last)) if !word.contains('.') => whole.min(osa_distance(word, last)),
        _ => whole,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_key_is_found_with_and_without_its_section() {
        let keys = ["update.gamma", "update.learning_rate", "run.seed"];
        assert_eq!(nearest("update.lerning_rate", keys), Some("update.learning_rate"));
        assert_eq!(nearest("seed", keys), Some("run.seed"));
        assert_eq!(nearest("zebra.stripes", keys), None);
    }

    #[test]
    fn a_word_that_shares_few_letters_with_a_key_suggests_none() {
        let keys =
            ["update.gamma", "update.gae_lambda", "audit.share", "surprise.feature_sigma_floor"];
        for word in ["score", "gammas_and_more", "ga", "entropy.feature_sigma_flavour"] {
            assert_eq!(nearest(word, keys), None, "{word}");
        }
        assert_eq!(nearest("gama", keys), Some("update.gamma"));
        assert_eq!(
            nearest("surprize.feature_sigma_flor", keys),
            Some("surprise.feature_sigma_floor")
        );
    }

    #[test]
    fn a_key_is_known_by_its_words_whatever_stands_between_them() {
        let keys = ["update.learning_rate", "critic.learning_rate", "run.seed"];
        assert_eq!(spelled("run_seed", keys), ["run.seed"]);
        assert_eq!(spelled("run__seed", keys), ["run.seed"]);
        assert_eq!(
            spelled("learning-rate", keys),
            ["update.learning_rate", "critic.learning_rate"]
        );
        assert!(spelled("run", keys).is_empty());
    }

    #[test]
    fn the_document_of_commands_names_what_a_resume_may_change() {
        let document = include_str!("../../docs/USING.md");
        for named in free_on_resume().split(", ") {
            assert!(document.contains(&format!("`{named}`")), "{named}");
        }
    }

    #[test]
    fn a_renamed_key_is_known_by_its_new_name_alone() {
        let defaults = crate::config::layers::defaults();
        for (old, now) in RENAMED {
            assert!(!defaults.entries.contains_key(*old), "{old}");
            assert!(defaults.entries.contains_key(*now), "{now}");
        }
    }

    #[test]
    fn operational_keys_are_told_from_semantic_ones() {
        for key in [
            "run.actors",
            "run.dir",
            "environment_service.url",
            "environments.per_slot",
            "lease.ttl_secs",
            "learner.threads",
            "log.episodes",
            "run.env_steps",
        ] {
            assert!(!is_semantic(key), "{key}");
        }
        for key in [
            "task",
            "run.seed",
            "environment_service.description",
            "environments.count",
            "policy.core",
        ] {
            assert!(is_semantic(key), "{key}");
        }
    }
}
