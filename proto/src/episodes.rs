//! Which episodes the trajectory logs of actors and the reward log of the learner hold, and how they are named.

use std::fmt;
use std::str::FromStr;

use serde::Deserialize;

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
    /// Whether any episode of training is logged.
    #[must_use]
    pub fn hold_rollouts(self) -> bool {
        matches!(self, Self::All | Self::Every(_))
    }

    /// Whether episode `episode` of environment `environment` is logged. Environments take turns.
    #[must_use]
    pub fn hold_rollout(self, environment: u32, episode: u64) -> bool {
        match self {
            Self::None | Self::Evaluation => false,
            Self::All => true,
            Self::Every(count) => (episode % count + u64::from(environment)).is_multiple_of(count),
        }
    }

    /// Whether episode `episode` of an evaluation is logged.
    #[must_use]
    pub fn hold_evaluation(self, episode: u32) -> bool {
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

/// Name of episode `episode` of environment `environment`, in training.
#[must_use]
pub fn rollout_episode_id(environment: u32, episode: u64) -> String {
    format!("rollout-{environment}-{episode}")
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
        let holding = [Episodes::None, Episodes::Evaluation, Episodes::All, Episodes::Every(9)];
        assert_eq!(holding.map(Episodes::hold_rollouts), [false, false, true, true]);
    }
}
