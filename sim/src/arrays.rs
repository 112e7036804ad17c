//! Arrays of a task file that have exactly as many entries as they need; by itself, serde ignores further ones.

use serde::de::Error;
use serde::{Deserialize, Deserializer};

/// Reads an array of `N` entries.
pub(crate) fn exact<'de, D, T, const N: usize>(deserializer: D) -> Result<[T; N], D::Error>
where
    D: Deserializer<'de>,
    T: Deserialize<'de>,
{
    let entries = Vec::<T>::deserialize(deserializer)?;
    entries.try_into().map_err(|entries: Vec<T>| {
        let count = entries.len();
        D::Error::custom(format!("an array of {N} is needed, it has {count} entries"))
    })
}

/// Reads an array of `N` entries where there may be none.
pub(crate) fn given<'de, D, T, const N: usize>(deserializer: D) -> Result<Option<[T; N]>, D::Error>
where
    D: Deserializer<'de>,
    T: Deserialize<'de>,
{
    exact(deserializer).map(Some)
}
