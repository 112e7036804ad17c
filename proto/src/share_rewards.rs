//! A line of the learner's reward log, which is joined with actors' trajectory logs. Never sent between actor and
//! learner.

use serde::{Deserialize, Serialize};

use crate::Digest;
use crate::digest::of_share_rewards;

const PREFIX: &str = "rewards-";
const SUFFIX: &str = ".jsonl";

/// Intrinsic rewards of the agents for the steps of a share.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ShareRewards {
    /// Id of the episode.
    pub episode_id: String,
    /// Steps of the episode before the share.
    pub first_step: u32,
    /// The iteration of the steps.
    pub iteration: u64,
    /// SHA-256 of the acting policies' snapshot, hexadecimal.
    pub weights_sha256: String,
    /// Hash of the run's settings and seed, hexadecimal.
    pub config_sha256: String,
    /// For each agent and step of the share, `[N][T]`: the second term of Eq. (9); `None` if it is not finite.
    pub intrinsic_reward: Vec<Vec<Option<f32>>>,
    /// [`ShareRewards::checksum`], hexadecimal.
    pub sha256: String,
}

impl ShareRewards {
    /// The same line with its checksum.
    #[must_use]
    pub fn sealed(mut self) -> Self {
        self.sha256 = self.checksum().to_string();
        self
    }

    /// SHA-256 of `s2mia.log.ShareRewards` and all other fields in order. Strings and each agent's rewards follow their
    /// length in bytes. Lengths and the iteration have 8 bytes, the step 4, rewards are 4-byte floats, all little-endian;
    /// `None` is the float 0x7fc00000.
    #[must_use]
    pub fn checksum(&self) -> Digest {
        of_share_rewards(self)
    }

    /// Number of steps of the share.
    #[must_use]
    pub fn steps(&self) -> usize {
        self.intrinsic_reward.first().map_or(0, Vec::len)
    }

    /// Checks the line for corruption.
    ///
    /// # Errors
    /// If agents have different numbers of rewards, or the checksum is wrong.
    pub fn check(&self) -> Result<(), String> {
        let steps = self.steps();
        if steps == 0 {
            return Err("there are no rewards".to_owned());
        }
        if let Some(other) = self.intrinsic_reward.iter().find(|rewards| rewards.len() != steps) {
            let other = other.len();
            return Err(format!("agents have different numbers of rewards: {steps} and {other}"));
        }
        match self.sha256 == self.checksum().to_string() {
            true => Ok(()),
            false => Err("the checksum does not match the content".to_owned()),
        }
    }
}

/// File name of the reward log of the learner's start number `start`.
#[must_use]
pub fn reward_log_name(start: u64) -> String {
    format!("{PREFIX}{start:04}{SUFFIX}")
}

/// Whether `name` is the name of a reward log.
#[must_use]
pub fn is_reward_log_name(name: &str) -> bool {
    name.starts_with(PREFIX) && name.ends_with(SUFFIX)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line() -> ShareRewards {
        let unsealed = ShareRewards {
            episode_id: "rollout-0-3".to_owned(),
            first_step: 20,
            iteration: 7,
            weights_sha256: "ab".to_owned(),
            config_sha256: "cd".to_owned(),
            intrinsic_reward: vec![vec![Some(0.5), None], vec![Some(-1.0), Some(2.0)]],
            sha256: String::new(),
        };
        unsealed.sealed()
    }

    #[test]
    fn a_line_has_the_digest_that_python_computes() {
        let expected = "cec0c5a4caa5f73bf3ca1f2b9b77a1ab5457b9b970281f567dc773633b10273a";
        assert_eq!(line().sha256, expected);
        assert_eq!(line().check(), Ok(()));
    }

    #[test]
    fn every_change_of_a_line_is_detected() {
        let changes: [fn(&mut ShareRewards); 8] = [
            |line| line.episode_id.push('0'),
            |line| line.first_step += 1,
            |line| line.iteration += 1,
            |line| line.weights_sha256.push('0'),
            |line| line.config_sha256.push('0'),
            |line| line.intrinsic_reward[1][1] = Some(2.5),
            |line| line.intrinsic_reward.swap(0, 1),
            |line| line.sha256.push('0'),
        ];
        for change in changes {
            let mut changed = line();
            change(&mut changed);
            assert!(changed.check().unwrap_err().contains("checksum"), "{changed:?}");
        }
        let mut uneven = line();
        uneven.intrinsic_reward[0].pop();
        assert!(
            uneven.sealed().check().unwrap_err().contains("different numbers of rewards: 1 and 2")
        );
    }

    #[test]
    fn every_start_of_a_learner_has_a_separate_reward_log() {
        assert_eq!(reward_log_name(12), "rewards-0012.jsonl");
        assert!(is_reward_log_name(&reward_log_name(12_345)));
        assert!(!is_reward_log_name("metrics.jsonl") && !is_reward_log_name("rewards-0001.mcap"));
    }
}
