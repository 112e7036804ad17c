//! The keys that settings may have: those of `configs/base.toml`, of the algorithms' files and of the tasks' reward terms.

use std::collections::BTreeMap;
use std::sync::LazyLock;

use toml::{Table, Value};

use super::keys;
use super::presets::{self, Preset};
use super::resolved::ConfigError;

/// Values by dotted path.
pub(super) type Values = BTreeMap<String, Value>;

/// A value of the kind of a reward term's weight, which has no default here.
static A_WEIGHT: Value = Value::Float(0.0);

/// Every key of `configs/base.toml` with its default.
pub(super) static DEFAULTS: LazyLock<Values> = LazyLock::new(|| written_in(presets::BASE.text));

/// The keys that a run has only if they are given, with what a run without them does.
pub(super) static OPTIONAL: LazyLock<Values> = LazyLock::new(|| written_in(&presets::optional()));

/// Every key with its default, but the weights of reward terms. The section of one algorithm is in that algorithm's file
/// alone, and so only in the settings of its runs.
static KNOWN: LazyLock<Values> = LazyLock::new(|| {
    let own = presets::ALGORITHMS.iter().copied().flat_map(own_section);
    own.chain(DEFAULTS.clone()).chain(OPTIONAL.clone()).collect()
});

/// Whether a run without `key` does what it does with this `value`.
pub(super) fn is_usual(key: &str, value: &Value) -> bool {
    OPTIONAL.get(key) == Some(value)
}

/// The names in [`KNOWN`].
pub(super) fn names() -> impl Iterator<Item = &'static str> {
    KNOWN.keys().map(String::as_str)
}

/// The values of an algorithm's file whose keys `configs/base.toml` lacks, also in its comments.
pub(super) fn own_section(algorithm: Preset) -> Values {
    let mut values = written_in(algorithm.text);
    values.retain(|key, _| !DEFAULTS.contains_key(key) && !OPTIONAL.contains_key(key));
    values
}

/// The values in a text of the program.
fn written_in(text: &str) -> Values {
    let table: Table = text.parse().expect("tests read every file of the program");
    let values = keys::leaves(&table).into_iter().filter(|(_, value)| !value.is_table());
    values.map(|(key, value)| (key, value.clone())).collect()
}

/// The settings whose keys equal `word` apart from separators, with or without their section.
pub(crate) fn spelled(word: &str) -> Vec<&'static str> {
    keys::spelled(word, names())
}

/// The first key of the section `key`; `None` if it is no section.
pub(super) fn first_inside(key: &str) -> Option<&'static String> {
    let section = format!("{key}.");
    KNOWN.keys().find(|known| known.starts_with(&section))
}

/// The default under `key`, whose kind a value must have.
pub(super) fn known(place: &str, key: &str) -> Result<&'static Value, ConfigError> {
    if let Some(default) = KNOWN.get(key) {
        return Ok(default);
    }
    if keys::weighted_term(key).is_some() {
        return Ok(&A_WEIGHT);
    }
    if let Some(inside) = first_inside(key) {
        let expected = format!("a table with keys such as `{inside}`");
        return Err(wrong_kind(place, key, &expected, "a value"));
    }
    let tip = tip(key, names());
    Err(ConfigError::UnknownKey { place: place.to_owned(), key: key.to_owned(), tip })
}

/// The refusal of a value under `key` that is not what is `expected`.
pub(super) fn wrong_kind(place: &str, key: &str, expected: &str, found: &str) -> ConfigError {
    let found = found.split_whitespace().collect::<Vec<_>>().join(" ");
    ConfigError::at(place, format!("`{key}` must be {expected}, found {found}"))
}

/// What was probably meant by `word`, if it is spelt like one of these names.
pub(super) fn tip<'a>(word: &str, known: impl Iterator<Item = &'a str>) -> String {
    let nearest = keys::nearest(word, known);
    nearest.map_or_else(String::new, |name| format!("; did you mean `{name}`?"))
}
