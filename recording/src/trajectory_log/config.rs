//! Settings of trajectory logs.

use std::path::PathBuf;

use proto::Episodes;
use serde::Deserialize;

/// Size at which an actor's log continues in a new file, bytes: a file is small enough to copy and to open at once.
pub const FILE_BYTES: u64 = 64 << 20;

/// Section `log` of the settings.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LogSettings {
    /// Episodes that are logged.
    pub episodes: Episodes,
}

/// Log settings of an actor.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LogConfig {
    /// Folder of the files; created if it does not exist.
    pub folder: PathBuf,
    /// Episodes that are logged.
    pub episodes: Episodes,
    /// Size at which the log continues in a new file, bytes.
    pub file_bytes: u64,
}
