//! What is logged, and where to.

use std::path::PathBuf;

use proto::Episodes;
use serde::Deserialize;

use crate::error::ActorError;

/// The largest file that may be asked for, MiB.
const MOST_FILE_MIB: u64 = 1 << 16;

/// Section `log` of the settings.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LogSettings {
    /// Which episodes.
    pub episodes: Episodes,
    /// Size after which a log goes on in another file, MiB.
    pub max_file_mib: u64,
}

impl LogSettings {
    /// Refuses a file size that is none.
    ///
    /// # Errors
    /// Names the setting, its value and what is allowed.
    pub fn validate(&self) -> Result<(), ActorError> {
        match self.max_file_mib {
            1..=MOST_FILE_MIB => Ok(()),
            size => Err(ActorError::Log(format!(
                "log.max_file_mib must lie in 1..={MOST_FILE_MIB}, is {size}"
            ))),
        }
    }
}

/// What an actor is told about its log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LogConfig {
    /// Folder of the files; made if it is not there.
    pub folder: PathBuf,
    /// What goes into them.
    pub settings: LogSettings,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_size_of_nothing_is_refused() {
        let refusal = |max_file_mib| {
            let settings = LogSettings { episodes: Episodes::All, max_file_mib };
            settings.validate().map_err(|error| error.to_string())
        };
        assert_eq!(refusal(64), Ok(()));
        let line = refusal(0).unwrap_err();
        assert!(line.contains("log.max_file_mib must lie in 1..=65536, is 0"), "{line}");
    }
}
