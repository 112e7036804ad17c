//! Reads a task file's TOML: errors name the line and the key in the words of the documents.

use serde::de::DeserializeOwned;

use super::definition::refused;
use super::disturbance::LONGEST_DELAY;
use crate::error::SimError;
use crate::spelling;

/// Bounds of whole numbers.
const WHOLE: [(&str, [u32; 2]); 4] = [
    ("frame_skip", [1, 1000]),
    ("episode_steps", [1, 1_000_000]),
    ("action_delay", [0, LONGEST_DELAY]),
    ("observation_delay", [0, LONGEST_DELAY]),
];

/// Bounds of a key with a whole number.
fn bounds_of(key: &str) -> [u32; 2] {
    let found = WHOLE.into_iter().find(|(name, _)| *name == key);
    found.map_or([0, u32::MAX], |(_, bounds)| bounds)
}

/// Refuses a number outside the key's bounds.
pub(super) fn whole(key: &str, value: u32) -> Result<(), SimError> {
    let [low, high] = bounds_of(key);
    if (low..=high).contains(&value) {
        Ok(())
    } else {
        Err(refused(format!("{key} must lie in {low}..={high}, is {value}")))
    }
}

/// Names of types in messages of the TOML library, and what to write instead.
const TYPES: [(&str, &str); 8] = [
    (
        "map, expected f32",
        "a table, expected a number; if it is a name with a dot, quote it: \"root.z\"",
    ),
    ("wanted exactly 1 element, more than 1 element", "expected only one of uniform and normal"),
    ("expected f32", "expected a number"),
    ("wanted string or table", "expected a table, such as { uniform = 0.1 }"),
    (
        "unit variant, expected newtype variant",
        "a word, expected a table such as { uniform = 0.1 }",
    ),
    ("map, expected a sequence", "a table, expected a list; one of tables has rows [[NAME]]"),
    ("expected a sequence", "expected a list, such as [..]"),
    ("expected a map", "expected a table"),
];

/// Parses TOML; an error names the line, the key and, for an unknown key or value, the nearest known one.
pub(super) fn typed<T: DeserializeOwned>(text: &str) -> Result<T, SimError> {
    toml::from_str(text).map_err(|error: toml::de::Error| {
        let before = error.span().and_then(|span| text.get(..span.start)).unwrap_or_default();
        let message = error.message().split_whitespace().collect::<Vec<_>>().join(" ");
        let message = TYPES.iter().fold(message, |text, (from, to)| text.replace(from, to));
        let message = match message.split_once("expected struct ") {
            Some((start, _)) => format!("{start}expected a table"),
            None => message,
        };
        let start = before.rsplit('\n').next().and_then(|line| line.rsplit_once('='));
        // The span of such a key is the key itself, and what is before it another one.
        let is_key = ["unknown field", "duplicate"].iter().any(|start| message.starts_with(start));
        let key = start
            .filter(|_| !is_key)
            .and_then(|(key, _)| key.trim().rsplit([' ', '{', ',']).next());
        let [low, high] = bounds_of(key.unwrap_or_default());
        let message = message
            .replace("expected u32", &format!("expected a whole number from {low} to {high}"));
        let key = key.map(|key| format!(", `{key}`")).unwrap_or_default();
        let line = before.matches('\n').count() + 1;
        let quoted: Vec<&str> = message.split('`').skip(1).step_by(2).collect();
        let nearest = match (message.starts_with("unknown "), quoted.split_first()) {
            (true, Some((found, known))) => spelling::nearest(found, known.iter().copied()),
            _ => None,
        };
        let hint = nearest.map(|name| format!("; did you mean `{name}`?")).unwrap_or_default();
        refused(format!("line {line}{key}: {message}{hint}"))
    })
}
