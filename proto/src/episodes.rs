//! Selection and ids of the episodes in the actors' trajectory logs.

use std::fmt;
use std::str::FromStr;

use serde::Deserialize;

/// Selection of logged episodes. It depends only on an episode's indices in the run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(try_from = "String")]
pub enum Episodes {
    /// No episodes.
    None,
    /// Evaluation episodes.
    Evaluation,
    /// All episodes.
    All,
    /// One of every `n` episodes in each environment and each evaluation; `n` is at least 1.
    Every(u64),
}

impl Episodes {
    /// Whether episode `episode` of environment `environment` is logged. The selected index differs between environments.
    #[must_use]
    pub fn include_rollout(self, environment: u32, episode: u64) -> bool {
        match self {
            Self::None | Self::Evaluation => false,
            Self::All => true,
            Self::Every(count) => (episode % count + u64::from(environment)).is_multiple_of(count),
        }
    }

    /// Whether episode `episode` of an evaluation is logged.
    #[must_use]
    pub fn include_evaluation(self, episode: u32) -> bool {
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
                "log.episodes is {text}, expected none, evaluation, all or a whole number from 1"
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

/// Id of training episode `episode` of environment `environment`.
#[must_use]
pub fn rollout_episode_id(environment: u32, episode: u64) -> String {
    format!("rollout-{environment}-{episode}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_selection_survives_the_round_trip_through_text() {
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
            let held = (0..9).filter(|&episode| three.include_rollout(environment, episode));
            assert_eq!(held.count(), 3, "environment {environment}");
        }
        let held = (0..9).filter(|&environment| three.include_rollout(environment, 4));
        assert_eq!(held.count(), 3);
        assert!(three.include_rollout(0, 0) && three.include_evaluation(0));
        assert!(!three.include_evaluation(2));
        assert!(three.include_rollout(u32::MAX, u64::MAX), "3 divides both");
    }

    #[test]
    fn rollouts_are_only_logged_if_selected() {
        assert!(Episodes::Evaluation.include_evaluation(7));
        assert!(!Episodes::Evaluation.include_rollout(0, 0));
        assert!(!Episodes::None.include_evaluation(0) && Episodes::All.include_rollout(5, 1));
    }
}
