//! The settings of one run after all layers: every key with its value and origin; and configuration errors, each with the place
//! where the user wrote the setting.

use std::collections::BTreeMap;
use std::fmt::Display;

use policy::SettingError;
use policy::arrays::hex;
use sha2::{Digest as _, Sha256};
use toml::Value;

use super::keys;
use super::layers::{SettingsLayer, Source};

/// Folders of the program's files, each with the setting that chooses one of them.
const CHOICES: [(&str, &str); 3] = [
    ("configs/tasks/", "task"),
    ("configs/presets/", "preset"),
    ("configs/algorithms/", "algorithm"),
];

/// Serde's names of number types and the words for users; TOML has no whole numbers above 2^63 - 1.
const NUMBERS: [(&str, &str); 3] = [
    ("expected u32", "expected a whole number that is not negative, up to 4294967295"),
    ("expected u64", "expected a whole number that is not negative"),
    ("expected usize", "expected a whole number that is not negative"),
];

/// A value and the layer that set it last.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Entry {
    /// The value.
    pub(crate) value: Value,
    /// Layer, as messages and `s2mia config` name it.
    pub(crate) origin: String,
}

/// All keys by dotted path.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Resolved {
    /// Sorted by path.
    pub(crate) entries: BTreeMap<String, Entry>,
    /// The keys that the user gave, each with the value that it would have otherwise, if it would be there at all.
    pub(crate) given: BTreeMap<String, Option<Value>>,
}

impl Resolved {
    /// Refuses a number that is not 0 but would be, or would lose digits, as a 32-bit float.
    pub(super) fn demand_normal(&self) -> Result<(), ConfigError> {
        let is_tiny = |entry: &Entry| {
            let number = entry.value.as_float().map_or(0.0, f64::abs);
            number > 0.0 && number < f64::from(f32::MIN_POSITIVE)
        };
        let Some((key, entry)) = self.entries.iter().find(|(_, entry)| is_tiny(entry)) else {
            return Ok(());
        };
        let detail = format!(
            "{key} = {:e} is too close to 0; the smallest number above 0 is 1.2e-38",
            entry.value.as_float().unwrap_or_default()
        );
        Err(ConfigError::at(&entry.origin, detail))
    }

    /// The settings of `layers`, of which later ones win; the first one has every key.
    pub(super) fn laid_over(layers: Vec<SettingsLayer>) -> Self {
        let mut resolved = Self { entries: BTreeMap::new(), given: BTreeMap::new() };
        for layer in layers {
            resolved.note(&layer);
            let entry = |value| Entry { value, origin: layer.place.clone() };
            resolved
                .entries
                .extend(layer.values.into_iter().map(|(key, value)| (key, entry(value))));
        }
        resolved
    }

    /// Notes what the user gives with `layer`, which is about to replace the values below. A value that switches another
    /// setting off also takes back what the user gave for that one.
    fn note(&mut self, layer: &SettingsLayer) {
        if layer.source == Source::Program {
            return;
        }
        for (key, value) in &layer.values {
            let below = self.entries.get(key).map(|entry| entry.value.clone());
            match layer.source {
                Source::Repeated if below.as_ref() == Some(value) => {
                    self.given.remove(key);
                }
                _ => {
                    self.given.entry(key.clone()).or_insert(below);
                }
            }
        }
        let off = layer.values.iter().flat_map(|(key, value)| keys::switched_off(key, value));
        for key in off {
            self.given.remove(*key);
        }
    }

    /// Removes the keys of the policies from which a run starts.
    pub(crate) fn remove_start(&mut self) {
        self.entries.retain(|key, _| ![keys::START, keys::START_SHA256].contains(&key.as_str()));
    }

    /// Removes what the user gave and `is_usual` without it.
    pub(super) fn remove_usual(&mut self, is_usual: impl Fn(&str, &Value) -> bool) {
        let Self { entries, given } = self;
        entries.retain(|key, entry| given.get(key) != Some(&None) || !is_usual(key, &entry.value));
        given.retain(|key, _| entries.contains_key(key));
    }

    /// Whether the user gave `key`.
    pub(crate) fn is_given(&self, key: &str) -> bool {
        self.given.contains_key(key)
    }

    /// The whole number under `key`, if it is one of at least 0.
    pub(crate) fn whole(&self, key: &str) -> Option<u64> {
        match self.entries.get(key).map(|entry| &entry.value) {
            Some(Value::Integer(number)) => u64::try_from(*number).ok(),
            _ => None,
        }
    }

    /// Text under `key`; empty if the value is not text.
    pub(crate) fn text(&self, key: &str) -> &str {
        match self.entries.get(key) {
            Some(Entry { value: Value::String(text), .. }) => text,
            _ => "",
        }
    }

    /// The value under `key` in one line: as TOML writes it, or the SHA-256 of a text of several lines.
    pub(crate) fn shown(&self, key: &str) -> String {
        match self.entries.get(key).map(|entry| &entry.value) {
            Some(Value::String(text)) if text.contains('\n') => {
                let digest: [u8; 32] = Sha256::digest(text).into();
                format!("a text with the SHA-256 {}", hex(&digest))
            }
            Some(value) => value.to_string(),
            None => "none".to_owned(),
        }
    }

    /// The value under `key` for messages: as [`Self::shown`], but a text without quotes.
    pub(crate) fn plain(&self, key: &str) -> String {
        match self.text(key) {
            text if text.is_empty() || text.contains('\n') => self.shown(key),
            text => text.to_owned(),
        }
    }

    /// The keys that affect the result; includes the length if every step depends on it.
    pub(crate) fn semantic(&self) -> impl Iterator<Item = (&str, &Value)> {
        let depends = self.depends_on_length();
        let all = self.entries.iter().map(|(key, entry)| (key.as_str(), &entry.value));
        all.filter(move |(key, _)| keys::is_semantic(key) || (depends && keys::is_length(key)))
    }

    /// Whether every step depends on the length of the run.
    pub(crate) fn depends_on_length(&self) -> bool {
        let (key, value) = keys::DEPENDS_ON_LENGTH;
        self.text(key) == value
    }

    /// The layer that set `key`.
    pub(crate) fn origin(&self, key: &str) -> &str {
        self.entries.get(key).map_or("configs/base.toml", |entry| &entry.origin)
    }

    /// Sets a value that the program determines, such as the name of the run folder.
    pub(crate) fn set(&mut self, key: &str, value: impl Into<Value>, origin: &str) {
        let value = value.into();
        self.entries.insert(key.to_owned(), Entry { value, origin: origin.to_owned() });
    }

    /// Takes from `other` the settings that only this machine's part in a run depends on: neither results nor evaluations,
    /// nor where an external environment is.
    pub(crate) fn take_machine(&mut self, other: &Self) {
        let kept = |key: &str| {
            let is_of_run = keys::is_semantic(key) || keys::is_length(key);
            is_of_run || key == keys::URL || key.starts_with("evaluation.")
        };
        let taken = other.entries.iter().filter(|(key, _)| !kept(key));
        self.entries.extend(taken.map(|(key, entry)| (key.clone(), entry.clone())));
    }

    /// SHA-256 over `key = value` lines of the semantic keys. Length and run folder are excluded.
    pub(crate) fn sha256(&self) -> [u8; 32] {
        let mut hasher = Sha256::new();
        self.semantic().for_each(|(key, value)| hasher.update(format!("{key} = {value}\n")));
        hasher.finalize().into()
    }

    /// The settings as TOML that can be read again.
    pub(crate) fn to_toml(&self) -> String {
        self.lines(|_, _| String::new())
    }

    /// The settings as TOML, each line with the origin of its value and a `remark` on the key as a comment.
    pub(crate) fn to_toml_with_origins(&self, remark: impl Fn(&str) -> String) -> String {
        self.lines(|key, entry| format!("  # {}{}", entry.origin, remark(key)))
    }

    /// Keys without a section come first: in TOML they could not follow one.
    fn lines(&self, comment: impl Fn(&str, &Entry) -> String) -> String {
        let (mut top, mut sections) = (String::new(), String::new());
        let mut current = "";
        for (key, entry) in &self.entries {
            let Some((section, name)) = key.rsplit_once('.') else {
                top += &format!("{key} = {}{}\n", entry.value, comment(key, entry));
                continue;
            };
            if section != current {
                sections += &format!("\n[{section}]\n");
                current = section;
            }
            sections += &format!("{name} = {}{}\n", entry.value, comment(key, entry));
        }
        top + &sections
    }
}

/// A configuration that cannot be used. Each message is one line.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub(crate) enum ConfigError {
    /// A key that no part of the program reads.
    #[error("{place}: unknown key `{key}`{tip}")]
    UnknownKey {
        /// Layer that sets the key.
        place: String,
        /// Dotted path.
        key: String,
        /// The known key that is spelled most alike, as a question.
        tip: String,
    },
    /// Any other error, in words.
    #[error("{0}")]
    Other(String),
}

impl ConfigError {
    /// An error of the layer or file `place`.
    pub(crate) fn at(place: impl Display, detail: impl Display) -> Self {
        Self::Other(format!("{place}: {detail}"))
    }

    /// The error `detail` about `keys`, with the place of the first of them that the user gave, or whose file the user chose;
    /// with that of the first if there is none. The error begins with the first key.
    pub(crate) fn refused(resolved: &Resolved, keys: &[&str], detail: &str) -> Self {
        let given = keys.iter().copied().find(|key| resolved.is_given(key));
        let chosen = || keys.iter().find_map(|key| choice(resolved, key));
        let key = given.or_else(chosen).unwrap_or(keys[0]);
        let detail = if key == keys[0] {
            detail.to_owned()
        } else {
            format!("{key} = {} does not fit: {detail}", resolved.plain(key))
        };
        Self::of_key(resolved.origin(key), key, &detail)
    }

    /// The error `detail`, or one with the key where that lacks it, as serde's do.
    pub(super) fn of_key(place: &str, key: &str, detail: &str) -> Self {
        if detail.contains(key) {
            Self::at(place, detail)
        } else {
            Self::at(place, format!("`{key}`: {detail}"))
        }
    }

    /// As [`Self::refused`], about the key of `error` and the keys that its range names.
    pub(super) fn out_of_range(resolved: &Resolved, error: &SettingError) -> Self {
        let is_part = |letter: char| letter.is_ascii_alphanumeric() || "_.".contains(letter);
        let words = error.range.split(|letter| !is_part(letter));
        let is_key = |word: &&str| word.contains('.') && resolved.entries.contains_key(*word);
        let keys: Vec<&str> = [error.key].into_iter().chain(words.filter(is_key)).collect();
        Self::refused(resolved, &keys, &error.to_string())
    }
}

/// The line of `text` at which a parser failed, and its message in one line.
pub(crate) fn line_and_message(text: &str, error: &toml::de::Error) -> (usize, String) {
    let before = error.span().and_then(|span| text.get(..span.start)).unwrap_or_default();
    (before.matches('\n').count() + 1, in_words(error.message()))
}

/// Serde's message in one line, without Rust's type names.
pub(super) fn in_words(message: &str) -> String {
    let line = message.split_whitespace().collect::<Vec<_>>().join(" ");
    let replaced = |text: String, (rust, words): (&str, &str)| text.replace(rust, words);
    NUMBERS.into_iter().fold(line, replaced)
}

/// The setting with which the user chose the file of the program that sets `key`.
fn choice(resolved: &Resolved, key: &str) -> Option<&'static str> {
    let origin = resolved.origin(key);
    let (_, choice) = CHOICES.iter().find(|(folder, _)| origin.starts_with(folder))?;
    resolved.is_given(choice).then_some(*choice)
}
