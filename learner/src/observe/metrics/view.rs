//! A second format of `metrics.jsonl`.

use std::fmt::Debug;
use std::path::Path;

use serde_json::{Map, Value};

use crate::durable::FileError;

/// A file with the figures of `metrics.jsonl` in another format.
pub(super) trait View: Debug + Send {
    /// Adds one line.
    fn add(&mut self, line: &Map<String, Value>) -> Result<(), FileError>;

    /// Path of the file.
    fn path(&self) -> &Path;
}
