//! Properties of keys: which affect the result of a run, which are spelled alike, and the kind of each one's value. Every setting
//! is a scalar, so that each can be set as `key.path=value`; its kind is that of the default in `configs/base.toml`.

use std::mem::discriminant;

use sim::spelling::nearest_by;
use strsim::osa_distance;
use toml::Value;

/// Key of the run folder.
const FOLDER: &str = "run.dir";

/// Key of the URL of the program that provides the environment; empty for the simulator.
pub(crate) const URL: &str = "environment_service.url";

/// Key of the place of the trained policies from which a run starts.
pub(crate) const START: &str = "policy.start";

/// Key of the SHA-256 of these policies, which the program fills in.
pub(crate) const START_SHA256: &str = "policy.start_sha256";

/// Keys that change what an evaluation finds.
pub(crate) const EVALUATED: [&str; 2] = ["evaluation.episodes", SAMPLED];

/// Key of whether evaluations sample actions.
pub(crate) const SAMPLED: &str = "evaluation.sampled";

/// Keys and sections that affect where and when a run computes, never its result.
const OPERATIONAL: &[&str] = &[
    "run.actors",
    FOLDER,
    URL,
    START,
    "environments.per_slot",
    "lease.",
    "audit.",
    "evaluation.",
    "checkpoint.",
    "learner.",
    "log.",
];

/// The semantic key that the program fills in when a run starts.
pub(crate) const FILLED_IN: &str = "environment_service.description";

/// The section of the weights of a task's reward terms. Its keys are the terms' names, and a key without a value leaves the
/// weight of the task's file, so `configs/base.toml` has none.
const WEIGHTS: &str = "reward.";

/// The reward term whose weight `key` is; `None` for other keys.
pub(crate) fn weighted_term(key: &str) -> Option<&str> {
    let is_name = |term: &&str| {
        let is_part = |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit() || byte == b'_';
        !term.is_empty() && term.bytes().all(is_part)
    };
    key.strip_prefix(WEIGHTS).filter(is_name)
}

/// Whether `key` is the section of the weights of reward terms.
pub(super) fn is_weights(key: &str) -> bool {
    WEIGHTS.strip_suffix('.') == Some(key)
}

/// Keys that set only the length of a run; a resume may raise them.
pub(crate) const LENGTH: &[&str] = &["run.iterations", "run.env_steps"];

/// The setting and its value with which the length of a run changes every step.
pub(crate) const DEPENDS_ON_LENGTH: (&str, &str) = ("update.learning_rate_decay", "linear");

/// Whole numbers up to this size are exact as `f64`.
const EXACT_INTEGER: f64 = 9_007_199_254_740_992.0;

/// The settings that have no effect because `key` has this `value`, which is the purpose of the value.
pub(super) fn switched_off(key: &str, value: &Value) -> &'static [&'static str] {
    match (key, *value == Value::Integer(0)) {
        ("run.iterations", false) => &["run.env_steps"],
        ("evaluation.every_steps", true) => &EVALUATED,
        _ => &[],
    }
}

/// The operational keys and sections that a resume may change, for messages. The run folder cannot change, nor can the policies
/// from which the run started.
pub(crate) fn free_on_resume() -> String {
    let named = OPERATIONAL.iter().filter(|key| ![FOLDER, START].contains(key));
    let named = named.map(|key| match key.strip_suffix('.') {
        Some(section) => format!("{section}.*"),
        None => (*key).to_owned(),
    });
    named.collect::<Vec<_>>().join(", ")
}

/// Whether `names` contains the key or its section, which ends with a dot.
pub(crate) fn covers(names: &[&str], key: &str) -> bool {
    names.iter().any(|name| *name == key || (name.ends_with('.') && key.starts_with(name)))
}

/// Whether a key's value changes what a run computes.
pub(crate) fn is_semantic(key: &str) -> bool {
    !is_length(key) && !covers(OPERATIONAL, key)
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

/// The kind of value that can replace this default, for messages.
pub(super) fn kind(default: &Value) -> &'static str {
    match default {
        Value::Boolean(_) => "true or false",
        Value::Integer(_) => "a whole number below 2^63",
        Value::Float(_) => "a finite number",
        _ => "text",
    }
}

/// `value` in the kind of `default`: `5` is a number, `1e6` a whole one. `None` if it does not fit.
pub(super) fn fitted(value: Value, default: &Value) -> Option<Value> {
    match (value, default) {
        (Value::Integer(number), Value::Float(_)) => Some(Value::Float(number as f64)),
        (Value::Float(number), Value::Integer(_)) => {
            let whole = number.fract() == 0.0 && number.abs() <= EXACT_INTEGER;
            whole.then_some(Value::Integer(number as i64))
        }
        (Value::Float(number), Value::Float(_)) => {
            number.is_finite().then_some(Value::Float(number))
        }
        (value, default) => (discriminant(&value) == discriminant(default)).then_some(value),
    }
}

/// The right side of `key=value` in the kind of `default`; quotes around text are optional.
pub(super) fn parsed(text: &str, default: &Value) -> Option<Value> {
    match (written(text), default) {
        (Some(quoted @ Value::String(_)), Value::String(_)) => Some(quoted),
        (_, Value::String(_)) => Some(Value::from(text)),
        // Such as `.3`, which is no number in TOML.
        (None, Value::Float(_)) => {
            text.parse().ok().filter(|number: &f64| number.is_finite()).map(Value::Float)
        }
        (written, _) => fitted(written?, default),
    }
}

/// Edit distance; a word without its section is also compared with the last part of the key.
fn distance_to_key(word: &str, key: &str) -> usize {
    let whole = osa_distance(word, key);
    match key.rsplit_once('.') {
        Some((_, last)) if !word.contains('.') => whole.min(osa_distance(word, last)),
        _ => whole,
    }
}

/// Every value that is not a table, with its dotted path, and every empty table.
pub(super) fn leaves(table: &toml::Table) -> Vec<(String, &Value)> {
    let mut found = Vec::new();
    for (key, value) in table {
        match value {
            Value::Table(inner) if !inner.is_empty() => {
                found.extend(leaves(inner).into_iter().map(|(k, v)| (format!("{key}.{k}"), v)));
            }
            _ => found.push((key.clone(), value)),
        }
    }
    found
}

/// A value in TOML notation.
fn written(text: &str) -> Option<Value> {
    let mut table: toml::Table = format!("value = {text}").parse().ok()?;
    let value = table.remove("value");
    value.filter(|_| table.is_empty())
}

#[cfg(test)]
mod tests {
    use Value::{Float, Integer};

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
        let keys = ["update.gamma", "update.gae_lambda", "audit.share", "critic.max_gradient_norm"];
        for word in ["score", "gammas_and_more", "ga", "entropy.max_gradiant_normal"] {
            assert_eq!(nearest(word, keys), None, "{word}");
        }
        assert_eq!(nearest("gama", keys), Some("update.gamma"));
        assert_eq!(nearest("critik.max_gradient_nrm", keys), Some("critic.max_gradient_norm"));
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
    fn operational_keys_differ_from_semantic_ones() {
        let operational = "run.actors run.dir run.iterations run.env_steps environment_service.url policy.start \
                           environments.per_slot lease.ttl_secs learner.threads log.episodes";
        for key in operational.split(' ') {
            assert!(!is_semantic(key), "{key}");
        }
        let semantic = "task algorithm run.seed environment_service.description environments.count \
                        policy.core policy.start_sha256 update.gamma";
        for key in semantic.split(' ') {
            assert!(is_semantic(key), "{key}");
        }
    }

    #[test]
    fn whole_numbers_and_floats_take_each_other_where_nothing_is_lost() {
        assert_eq!(fitted(Integer(5), &Float(0.0)), Some(Float(5.0)));
        assert_eq!(fitted(Float(1e6), &Integer(0)), Some(Integer(1_000_000)));
        assert_eq!(fitted(Float(1.5), &Integer(0)), None);
        assert_eq!(fitted(Float(1e300), &Integer(0)), None);
    }

    #[test]
    fn text_needs_no_quotes_on_the_command_line() {
        let default = Value::from("");
        assert_eq!(parsed("gru", &default), Some(Value::from("gru")));
        assert_eq!(parsed("\"gru\"", &default), Some(Value::from("gru")));
        assert_eq!(parsed("7", &default), Some(Value::from("7")));
        assert_eq!(parsed("", &default), Some(Value::from("")));
    }

    #[test]
    fn numbers_are_finite_and_a_value_cannot_smuggle_in_a_second_key() {
        assert_eq!(parsed(".3", &Float(0.0)), Some(Float(0.3)));
        assert_eq!(parsed("007", &Integer(0)), None);
        assert_eq!(parsed("nan", &Float(0.0)), None);
        assert_eq!(parsed("inf", &Float(0.0)), None);
        assert_eq!(parsed("1\nother = 2", &Integer(0)), None);
    }
}
