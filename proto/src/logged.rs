//! What actors' trajectory logs and the learner's reward log agree on: which episodes they hold, how these are named,
//! and what a line of a reward log says. Nothing of it travels between actor and learner.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

const REWARD_LOG_PREFIX: &str = "rewards-";
const REWARD_LOG_SUFFIX: &str = ".jsonl";

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

/// A line of a reward log: what the learner paid the agents for the steps of a share, besides the task's reward.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ShareRewards {
    /// The share's episode.
    pub episode_id: String,
    /// Steps of the episode before the share.
    pub first_step: u32,
    /// The iteration that the steps belong to.
    pub iteration: u64,
    /// SHA-256 of the snapshot of the weights that acted, hexadecimal.
    pub weights_sha256: String,
    /// For each agent and step of the share, `[N][T]`: the second term of Eq. (9).
    pub intrinsic_reward: Vec<Vec<f32>>,
}

/// Name of the reward log of the learner's start number `start`.
#[must_use]
pub fn reward_log_name(start: u64) -> String {
    format!("{REWARD_LOG_PREFIX}{start:04}{REWARD_LOG_SUFFIX}")
}

/// Whether a file of this name is a learner's reward log.
#[must_use]
pub fn is_reward_log_name(name: &str) -> bool {
    name.starts_with(REWARD_LOG_PREFIX) && name.ends_with(REWARD_LOG_SUFFIX)
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

    #[test]
    fn every_start_of_a_learner_has_a_reward_log_of_its_own() {
        assert_eq!(reward_log_name(12), "rewards-0012.jsonl");
        assert!(is_reward_log_name(&reward_log_name(12_345)));
        assert!(!is_reward_log_name("metrics.jsonl") && !is_reward_log_name("rewards-0001.mcap"));
    }
}
