//! Which episodes are logged, and where to.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

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

/// Which episodes are logged. What decides is an episode's place in the run, never who plays it or when.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(try_from = "String")]
pub enum Episodes {
    /// No log.
    None,
    /// Those of evaluations.
    Evaluation,
    /// Every one.
    All,
    /// One in so many, in each environment and in each evaluation; at least 1.
    Every(u64),
}

impl Episodes {
    /// Whether episode `episode` of environment `environment` is logged. Environments take turns.
    pub(crate) fn hold_rollout(self, environment: u32, episode: u64) -> bool {
        match self {
            Self::None | Self::Evaluation => false,
            Self::All => true,
            Self::Every(count) => (episode % count + u64::from(environment)).is_multiple_of(count),
        }
    }

    /// Whether episode `episode` of an evaluation is logged.
    pub(crate) fn hold_evaluation(self, episode: u32) -> bool {
        match self {
            Self::None => false,
            Self::All | Self::Evaluation => true,
            Self::Every(count) => u64::from(episode).is_multiple_of(count),
        }
    }
}

impl FromStr for Episodes {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match (text, text.parse()) {
            ("none", _) => Ok(Self::None),
            ("evaluation", _) => Ok(Self::Evaluation),
            ("all", _) => Ok(Self::All),
            (_, Ok(count)) if count > 0 => Ok(Self::Every(count)),
            _ => Err(format!(
                "log.episodes must be none, evaluation, all or a whole number from 1, is {text}"
            )),
        }
    }
}

impl TryFrom<String> for Episodes {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl fmt::Display for Episodes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::None => f.write_str("none"),
            Self::Evaluation => f.write_str("evaluation"),
            Self::All => f.write_str("all"),
            Self::Every(count) => write!(f, "{count}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_what_is_read() {
        for text in ["none", "evaluation", "all", "1", "25"] {
            assert_eq!(
                text.parse::<Episodes>().map(|episodes| episodes.to_string()),
                Ok(text.into())
            );
        }
        for text in ["", "0", "-1", "2.5", "some", "every"] {
            let refusal = text.parse::<Episodes>().unwrap_err();
            assert!(refusal.contains("none, evaluation, all or a whole number"), "{refusal}");
        }
    }

    #[test]
    fn one_in_three_is_one_in_three_in_each_environment_and_in_each_episode() {
        let three = Episodes::Every(3);
        for environment in 0..6 {
            let held = (0..9).filter(|episode| three.hold_rollout(environment, *episode)).count();
            assert_eq!(held, 3, "environment {environment}");
        }
        let held = (0..9).filter(|environment| three.hold_rollout(*environment, 4)).count();
        assert_eq!(held, 3);
        assert!(three.hold_rollout(0, 0) && three.hold_evaluation(0) && !three.hold_evaluation(2));
        assert!(three.hold_rollout(u32::MAX, u64::MAX), "3 divides both");
    }

    #[test]
    fn evaluations_alone_leave_rollouts_out() {
        assert!(Episodes::Evaluation.hold_evaluation(7));
        assert!(!Episodes::Evaluation.hold_rollout(0, 0));
        assert!(!Episodes::None.hold_evaluation(0) && Episodes::All.hold_rollout(5, 1));
    }

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
