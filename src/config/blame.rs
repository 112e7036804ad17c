//! Finds the setting to which an error is attributed: the one that the user gave, if without it the error were another.

use super::error::ConfigError;
use super::layers;
use super::resolved::Resolved;

/// Folders of the program's files, each with the setting that chooses one of them.
const CHOICES: [(&str, &str); 3] = [
    ("configs/tasks/", "task"),
    ("configs/presets/", "preset"),
    ("configs/algorithms/", "algorithm"),
];

/// The error `detail`, which is what `assemble` says of `resolved`, with the place of the setting that causes it.
pub(super) fn refused(
    resolved: &Resolved,
    detail: &str,
    assemble: impl Fn(&Resolved) -> Result<(), String>,
) -> ConfigError {
    let subject = subject(resolved, detail);
    let key = cause(resolved, (detail, subject), assemble).or(subject).unwrap_or("run");
    laid_at(resolved, key, detail)
}

/// The error `detail` with the place of the setting with which it begins; `None` if it does not begin with one.
pub(crate) fn of_subject(resolved: &Resolved, detail: &str) -> Option<ConfigError> {
    subject(resolved, detail).map(|key| laid_at(resolved, key, detail))
}

/// The setting with which a message begins.
fn subject<'a>(resolved: &Resolved, detail: &'a str) -> Option<&'a str> {
    detail.split_whitespace().next().filter(|word| resolved.entries.contains_key(*word))
}

/// The error with the place of `key`, or of the user's choice of the file that sets it.
fn laid_at(resolved: &Resolved, key: &str, detail: &str) -> ConfigError {
    let key = chooser(resolved, key);
    let detail = match subject(resolved, detail) {
        Some(subject) if subject != key => {
            format!("{key} = {} does not fit: {detail}", resolved.plain(key))
        }
        _ => detail.to_owned(),
    };
    ConfigError::Refused { place: resolved.origin(key).to_owned(), key: key.to_owned(), detail }
}

/// The setting without whose value the error would be another: first those that the user gave and that the message names,
/// then others that it names, then the others that the user gave.
fn cause<'a>(
    resolved: &'a Resolved,
    (detail, subject): (&str, Option<&str>),
    assemble: impl Fn(&Resolved) -> Result<(), String>,
) -> Option<&'a str> {
    let defaults = layers::defaults();
    let rank = |key: &str| {
        let is_named = key.contains('.') && detail.contains(key);
        match (resolved.is_given(key), is_named) {
            (true, true) => (0, subject != Some(key)),
            (false, true) => (1, subject != Some(key)),
            (true, false) => (2, false),
            (false, false) => (3, false),
        }
    };
    let mut keys: Vec<&String> = resolved.entries.keys().collect();
    keys.sort_by_key(|key| rank(key.as_str()));
    let is_cause = |key: &&String| {
        let otherwise = resolved.given.get(*key).unwrap_or(&defaults.entries[*key].value);
        if resolved.entries[*key].value == *otherwise {
            return false;
        }
        let mut changed = resolved.clone();
        changed.set(key, otherwise.clone(), "");
        assemble(&changed).err().as_deref() != Some(detail)
    };
    keys.into_iter().find(is_cause).map(String::as_str)
}

/// The setting with which the user chose the file of the program that sets `key`; `key` itself if there is none.
fn chooser<'a>(resolved: &Resolved, key: &'a str) -> &'a str {
    let origin = resolved.origin(key);
    let choice = CHOICES.iter().find(|(folder, _)| origin.starts_with(folder));
    match choice {
        Some((_, choice)) if !resolved.is_given(key) && resolved.is_given(choice) => choice,
        _ => key,
    }
}
