//! Settings of trajectory logs.

use std::path::PathBuf;

use proto::Episodes;
use serde::Deserialize;

use super::error::LogStartError;

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
    pub fn validate(&self) -> Result<(), LogStartError> {
        match self.max_file_mib {
            1..=MOST_FILE_MIB => Ok(()),
            size => Err(LogStartError::FileSize { size, most: MOST_FILE_MIB }),
        }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_size_of_zero_is_rejected() {
        let refusal = |max_file_mib| {
            let settings = LogSettings { episodes: Episodes::All, max_file_mib };
            settings.validate().map_err(|error| error.to_string())
        };
        assert_eq!(refusal(64), Ok(()));
        let line = refusal(0).unwrap_err();
        assert!(line.contains("log.max_file_mib must be in 1..=65536, is 0"), "{line}");
    }
}
