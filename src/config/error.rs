//! Configuration errors, each with the place where the user wrote the setting.

use policy::SettingError;

use super::resolved::Resolved;

/// A configuration that cannot be used. Each message is one line.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub(crate) enum ConfigError {
    /// A file that cannot be read, or is not TOML.
    #[error("{place}: {detail}")]
    Unreadable {
        /// File, with the line where that is known.
        place: String,
        /// Reason.
        detail: String,
    },
    /// A key that no part of the program reads.
    #[error("{place}: unknown key `{key}`{}", suggestion(.nearest.as_deref()))]
    UnknownKey {
        /// Layer that sets the key.
        place: String,
        /// Dotted path.
        key: String,
        /// The known key that is spelled most alike.
        nearest: Option<String>,
    },
    /// A value of another kind than the default's.
    #[error("{place}: `{key}` must be {expected}, found {found}")]
    WrongKind {
        /// Layer that sets the key.
        place: String,
        /// Dotted path.
        key: String,
        /// Kind of value that fits.
        expected: String,
        /// The value that was found.
        found: String,
    },
    /// A value of the right kind that its crate refuses: out of range, or an unknown choice.
    #[error("{place}: {}", named(.key, .detail))]
    Refused {
        /// Layer that sets the key.
        place: String,
        /// Dotted path.
        key: String,
        /// Reason, with the allowed values.
        detail: String,
    },
    /// A setting that changes nothing in the run.
    #[error(
        "{place}: `{key}` has no effect in this run: it needs {needs}; leave it out or change that"
    )]
    NoEffect {
        /// Layer that sets the key.
        place: String,
        /// Dotted path.
        key: String,
        /// What would give it an effect, and what there is instead.
        needs: String,
    },
    /// An unknown name of a task, an algorithm or a preset.
    #[error("{place}: unknown {kind} `{name}`{}; known: {known}", suggestion(.nearest.as_deref()))]
    UnknownName {
        /// Layer that gives the name.
        place: String,
        /// `task`, `algorithm` or `preset`.
        kind: &'static str,
        /// The name as given.
        name: String,
        /// The known name that is spelled most alike.
        nearest: Option<String>,
        /// All known names.
        known: String,
    },
    /// An argument that is not `key.path=value`.
    #[error("`{0}` is no setting; write key.path=value, for example run.seed=7")]
    NoSetting(String),
    /// A task that follows a setting.
    #[error("`{0}` is a task, and the task comes first, before all settings")]
    TaskNotFirst(String),
    /// An environment variable with the prefix of settings that names no setting.
    #[error("environment variable {name} is no setting; write {meant}")]
    NoVariable {
        /// The variable.
        name: String,
        /// Variables that are settings.
        meant: String,
    },
    /// A setting that a resumed run may not change.
    #[error("{place}: `{key}` cannot change on resume: the run has {old}, found {new}; {allowed}")]
    FixedOnResume {
        /// Layer that sets the key.
        place: String,
        /// Dotted path.
        key: String,
        /// Value of the run, or its length.
        old: String,
        /// Requested value, or the resulting length.
        new: String,
        /// What a resume may change.
        allowed: String,
    },
}

/// Folders of the program's files, each with the setting that chooses one of them.
const CHOICES: [(&str, &str); 3] = [
    ("configs/tasks/", "task"),
    ("configs/presets/", "preset"),
    ("configs/algorithms/", "algorithm"),
];

impl ConfigError {
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
        Self::Refused { place: resolved.origin(key).to_owned(), key: key.to_owned(), detail }
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

/// The setting with which the user chose the file of the program that sets `key`.
fn choice(resolved: &Resolved, key: &str) -> Option<&'static str> {
    let origin = resolved.origin(key);
    let (_, choice) = CHOICES.iter().find(|(folder, _)| origin.starts_with(folder))?;
    resolved.is_given(choice).then_some(*choice)
}

/// Serde's names of number types and the words for users.
const NUMBERS: [(&str, &str); 3] = [
    ("expected u32", "expected a whole number from 0 to 4294967295"),
    ("expected u64", "expected a whole number from 0"),
    ("expected usize", "expected a whole number from 0"),
];

/// Adds the key to messages that lack it: crates name the key in an error of range, serde does not name it.
fn named(key: &str, detail: &str) -> String {
    if detail.contains(key) { detail.to_owned() } else { format!("`{key}`: {detail}") }
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

fn suggestion(nearest: Option<&str>) -> String {
    nearest.map_or_else(String::new, |name| format!("; did you mean `{name}`?"))
}
