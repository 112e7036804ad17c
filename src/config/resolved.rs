//! The settings of one run after all layers: every key with its value and origin.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use policy::arrays::hex;
use sha2::{Digest as _, Sha256};
use toml::Value;

use super::keys;
use super::layers::{SettingsLayer, Source};

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
    /// The keys that the user gave, each with the value that it would have otherwise.
    pub(crate) given: BTreeMap<String, Value>,
}

impl Resolved {
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
            let below = self.entries.get(key).map_or(value, |entry| &entry.value).clone();
            match layer.source {
                Source::Repeated if below == *value => {
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
            None => String::new(),
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
    pub(crate) fn set_text(&mut self, key: &str, value: &str, origin: &str) {
        self.set(key, Value::String(value.to_owned()), origin);
    }

    /// Sets a value that the program determines.
    pub(crate) fn set(&mut self, key: &str, value: Value, origin: &str) {
        self.entries.insert(key.to_owned(), Entry { value, origin: origin.to_owned() });
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
                push_line(&mut top, key, entry, &comment(key, entry));
                continue;
            };
            if section != current {
                push_text(&mut sections, &format!("\n[{section}]\n"));
                current = section;
            }
            push_line(&mut sections, name, entry, &comment(key, entry));
        }
        top + &sections
    }
}

fn push_line(text: &mut String, name: &str, entry: &Entry, comment: &str) {
    push_text(text, &format!("{name} = {}{comment}\n", entry.value));
}

fn push_text(text: &mut String, more: &str) {
    text.write_str(more).expect("writing to a string cannot fail");
}
