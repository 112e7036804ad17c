//! Settings of trajectory logs.

use std::path::PathBuf;

use policy::setting::{SettingError, between};
use proto::Episodes;
use serde::Deserialize;

/// Upper bound of the file size, MiB.
const MOST_FILE_MIB: u64 = 1 << 16;

/// Section `log` of the settings.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LogSettings {
    /// Episodes that are logged.
    pub episodes: Episodes,
    /// Size at which a log continues in a new file, MiB.
    pub max_file_mib: u64,
}

impl LogSettings {
    /// Checks the file size.
    ///
    /// # Errors
    /// If the file size is out of range.
    pub fn validate(&self) -> Result<(), SettingError> {
        between("log.max_file_mib", self.max_file_mib, 1, MOST_FILE_MIB)
    }
}

/// Log settings of an actor.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LogConfig {
    /// Folder of the files; created if it does not exist.
    pub folder: PathBuf,
    /// Content and size of the files.
    pub settings: LogSettings,
}
