//! What a line of the learner's reward log says. It is read beside actors' trajectory logs and never travels between
//! actor and learner.

use serde::{Deserialize, Serialize};

use crate::Digest;
use crate::digest::of_share_rewards;

const PREFIX: &str = "rewards-";
const SUFFIX: &str = ".jsonl";

/// What the learner paid the agents for the steps of a share, besides the task's reward.
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
    /// Hash of the run's settings and seed, hexadecimal.
    pub config_sha256: String,
    /// For each agent and step of the share, `[N][T]`: the second term of Eq. (9); `None` where it is no finite number.
    pub intrinsic_reward: Vec<Vec<Option<f32>>>,
    /// [`ShareRewards::checksum`], hexadecimal.
    pub sha256: String,
}

impl ShareRewards {
    /// The same with its checksum.
    #[must_use]
    pub fn sealed(mut self) -> Self {
        self.sha256 = self.checksum().to_string();
        self
    }

    /// SHA-256 over `s2mia.log.ShareRewards` and all other fields in their order: texts and each agent's numbers behind
    /// their length in bytes; lengths and the iteration as 8 bytes, the step as 4, numbers as floats of 4, all little
    /// endian, and `None` as the float 0x7fc00000.
    #[must_use]
    pub fn checksum(&self) -> Digest {
        of_share_rewards(self)
    }

    /// Steps of the share.
    #[must_use]
    pub fn steps(&self) -> usize {
        self.intrinsic_reward.first().map_or(0, Vec::len)
    }

    /// Refuses a line that was damaged.
    ///
    /// # Errors
    /// Says what is wrong.
    pub fn check(&self) -> Result<(), String> {
        let steps = self.steps();
        if steps == 0 || self.intrinsic_reward.iter().any(|rewards| rewards.len() != steps) {
            return Err("its agents are not paid for as many steps each".to_owned());
        }
        match self.sha256 == self.checksum().to_string() {
            true => Ok(()),
            false => Err("its checksum is not that of its content".to_owned()),
        }
    }
}

/// Name of the reward log of the learner's start number `start`.
#[must_use]
pub fn reward_log_name(start: u64) -> String {
    format!("{PREFIX}{start:04}{SUFFIX}")
}

/// Whether a file of this name is a learner's reward log.
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
    fn a_line_hashes_to_what_python_gives_for_the_documented_bytes() {
        let expected = "cec0c5a4caa5f73bf3ca1f2b9b77a1ab5457b9b970281f567dc773633b10273a";
        assert_eq!(line().sha256, expected);
        assert_eq!(line().check(), Ok(()));
    }

    #[test]
    fn whatever_is_changed_in_a_line_is_noticed() {
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
        assert!(uneven.sealed().check().unwrap_err().contains("as many steps"));
    }

    #[test]
    fn every_start_of_a_learner_has_a_reward_log_of_its_own() {
        assert_eq!(reward_log_name(12), "rewards-0012.jsonl");
        assert!(is_reward_log_name(&reward_log_name(12_345)));
        assert!(!is_reward_log_name("metrics.jsonl") && !is_reward_log_name("rewards-0001.mcap"));
    }
}
