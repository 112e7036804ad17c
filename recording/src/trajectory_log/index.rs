//! Index of the shares of several logs: duplicates, contradictions and gaps.

use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};

use policy::arrays::hex;
use prost::Message;
use proto::trajectory_log::{AgentStep, Kind, Share};
use proto::{Digest, is_reward_log_name, rollout_episode_id};
use sha2::{Digest as _, Sha256};

use super::error::LogError;
use super::rewards::{About, RewardLines, known};
use super::shares::{ReadShares, read_shares};
use super::source::read_bytes;
use crate::share::LoggedShare;

/// Id of an episode; rollouts sort before evaluations.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum EpisodeId {
    /// Episode of a training rollout.
    Rollout {
        /// Global index of the environment.
        environment: u32,
        /// Index of the episode in its environment.
        episode: u64,
    },
    /// Episode of an evaluation.
    Evaluation {
        /// Iteration of the evaluated weights.
        iteration: u64,
        /// Index of the episode in its evaluation.
        episode: u64,
    },
}

impl EpisodeId {
    fn of(share: &Share) -> Self {
        let episode = share.episode;
        match share.kind() {
            Kind::Evaluation => Self::Evaluation { iteration: share.iteration, episode },
            _ => Self::Rollout { environment: share.environment, episode },
        }
    }
}

impl fmt::Display for EpisodeId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Rollout { environment, episode } => {
                f.write_str(&rollout_episode_id(*environment, *episode))
            }
            Self::Evaluation { iteration, episode } => {
                write!(f, "evaluation-{iteration}-{episode}")
            }
        }
    }
}

/// A share in a file.
#[derive(Clone, Debug)]
pub(super) struct Part {
    pub(super) file: usize,
    /// Times of the first and last message, nanoseconds.
    pub(super) nanos: (u64, u64),
    about: About,
    /// Digest of the share without its header's metadata and the intrinsic rewards.
    digest: [u8; 32],
    /// Digest of its intrinsic rewards, if it contains them.
    known: Option<Digest>,
}

impl Part {
    /// Whether the data that both shares contain is equal.
    fn agrees(&self, other: &Self) -> bool {
        let paid_alike = match (self.known, other.known) {
            (Some(one), Some(other)) => one == other,
            _ => true,
        };
        self.digest == other.digest && paid_alike
    }
}

/// Index of the shares of several logs of one run.
#[derive(Debug, Default)]
pub struct Index {
    pub(super) files: Vec<PathBuf>,
    /// Metadata of the first file.
    pub(super) log: ReadShares,
    /// Shares by episode and first step; several only if they differ.
    pub(super) parts: BTreeMap<EpisodeId, BTreeMap<u32, Vec<Part>>>,
    pub(super) rewards: RewardLines,
    copies: u64,
    torn_steps: u64,
    /// Lost shares and steps.
    lost: (u64, u64),
}

impl Index {
    /// Adds the shares of a log, or the intrinsic rewards of a reward log, which is recognised by its file name. Checks
    /// all checksums and schemas.
    ///
    /// # Errors
    /// If the file cannot be read completely, or belongs to a different run than earlier files.
    pub fn add(&mut self, path: &Path) -> Result<(), LogError> {
        let name = path.file_name().and_then(|name| name.to_str());
        match name.is_some_and(is_reward_log_name) {
            true => self.rewards.add(path),
            false => self.add_log(path),
        }
    }

    fn add_log(&mut self, path: &Path) -> Result<(), LogError> {
        let bytes = read_bytes(path)?;
        let file = self.files.len();
        let log = read_shares(&bytes, |share, nanos| {
            self.take(file, &share, nanos);
            Ok(())
        })?;
        if file > 0 && !same_run(&self.log, &log) {
            let of = |log: &ReadShares| log.words.get("run_id").cloned().unwrap_or_default();
            let (run, other) = (of(&log), of(&self.log));
            let why = format!(
                "it belongs to run {run} or has other settings; earlier files belong to run {other}"
            );
            return Err(LogError::Unfit(why));
        }
        self.torn_steps += log.torn_steps;
        let (shares, steps) = log.lost();
        self.lost = (self.lost.0.saturating_add(shares), self.lost.1.saturating_add(steps));
        self.files.push(path.to_path_buf());
        if file == 0 {
            self.log = log;
        }
        Ok(())
    }

    fn take(&mut self, file: usize, share: &LoggedShare, nanos: (u64, u64)) {
        let (about, digest, known) = (about(share), digest(share), known(share));
        let part = Part { file, nanos, about, digest, known };
        let episode = self.parts.entry(EpisodeId::of(&share.head)).or_default();
        let there = episode.entry(share.head.first_step).or_default();
        match there.iter_mut().find(|other| other.agrees(&part)) {
            None => there.push(part),
            Some(other) => {
                self.copies += 1;
                if other.known.is_none() {
                    *other = part;
                }
            }
        }
    }

    /// Number of trajectory logs.
    #[must_use]
    pub fn logs(&self) -> usize {
        self.files.len()
    }

    /// Number of episodes with at least one share.
    #[must_use]
    pub fn episodes(&self) -> usize {
        self.parts.len()
    }

    /// Number of shares and of steps, without duplicates.
    #[must_use]
    pub fn shares_and_steps(&self) -> (u64, u64) {
        let parts = self.parts.values().flat_map(BTreeMap::values).flatten();
        parts
            .fold((0, 0), |(shares, steps), part| (shares + 1, steps + u64::from(part.about.steps)))
    }

    /// Number of training shares with intrinsic rewards, and of all training shares.
    #[must_use]
    pub fn paid(&self) -> (u64, u64) {
        let (mut paid, mut all) = (0, 0);
        for (episode, parts) in &self.parts {
            if let EpisodeId::Evaluation { .. } = episode {
                continue;
            }
            let id = episode.to_string();
            let is_paid = |(first, parts): &(&u32, &Vec<Part>)| {
                parts[0].known.is_some() || self.rewards.hold(&id, **first)
            };
            paid += parts.iter().filter(is_paid).count() as u64;
            all += parts.len() as u64;
        }
        (paid, all)
    }

    /// Reports of incomplete last lines in reward logs, which killed learners leave.
    #[must_use]
    pub fn remarks(&self) -> &[String] {
        self.rewards.remarks()
    }

    /// Reports of reward logs with damaged lines, which were skipped.
    #[must_use]
    pub fn damaged(&self) -> &[String] {
        self.rewards.damaged()
    }

    /// Number of duplicate shares.
    #[must_use]
    pub fn copies(&self) -> u64 {
        self.copies
    }

    /// Number of steps of incomplete shares.
    #[must_use]
    pub fn torn_steps(&self) -> u64 {
        self.torn_steps
    }

    /// Shares and steps that the actors reported as lost.
    #[must_use]
    pub fn lost(&self) -> (u64, u64) {
        self.lost
    }

    /// Descriptions of shares that contradict each other or the intrinsic rewards.
    #[must_use]
    pub fn contradictions(&self) -> Vec<String> {
        let mut found = self.rewards.foreign(self.log.words.get("config_sha256"));
        for (episode, parts) in &self.parts {
            for (first, parts) in parts.iter().filter(|(_, parts)| parts.len() > 1) {
                let files = [&parts[0], &parts[1]].map(|part| self.files[part.file].display());
                let [one, other] = files;
                found.push(format!("{episode} from step {first} on: {one} and {other} differ"));
            }
            let id = episode.to_string();
            let paid = parts.iter().filter_map(|(first, parts)| {
                self.rewards.contradiction((&id, *first), &parts[0].about, parts[0].known)
            });
            found.extend(paid);
            for (first, next) in parts.keys().zip(parts.keys().skip(1)) {
                let end = first.saturating_add(parts[first][0].about.steps);
                if end > *next {
                    found.push(format!("{episode}: steps {next} to {} are in two shares", end - 1));
                }
            }
        }
        found
    }

    /// Descriptions of missing steps before the last known step of each episode.
    #[must_use]
    pub fn gaps(&self) -> Vec<String> {
        let mut found = Vec::new();
        for (episode, parts) in &self.parts {
            let mut next = 0;
            for (first, parts) in parts {
                if *first > next {
                    found.push(format!("{episode}: steps {next} to {}", first - 1));
                }
                next = first.saturating_add(parts[0].about.steps);
            }
        }
        found
    }
}

impl ReadShares {
    /// Lost shares and steps that the log reports.
    fn lost(&self) -> (u64, u64) {
        let total = |name: &str| {
            let count = self.totals.as_ref().and_then(|totals| totals.get(name));
            count.and_then(|count| count.parse().ok()).unwrap_or(0)
        };
        (total("lost_shares"), total("lost_steps"))
    }
}

/// Whether two logs belong to the same run. A restarted learner keeps the run's id and settings.
fn same_run(one: &ReadShares, other: &ReadShares) -> bool {
    ["run_id", "seed", "config_sha256"]
        .iter()
        .all(|word| one.words.get(*word) == other.words.get(*word))
}

fn about(share: &LoggedShare) -> About {
    About {
        steps: share.steps.len() as u32,
        iteration: share.head.iteration,
        weights_sha256: hex(&share.head.weights_sha256),
    }
}

fn digest(share: &LoggedShare) -> [u8; 32] {
    let mut hash = Sha256::new();
    hash.update(&share.head.environment_state);
    for step in &share.steps {
        for agent in &step.agents {
            let unpaid = AgentStep { intrinsic_reward: None, ..agent.clone() };
            hash.update(unpaid.encode_length_delimited_to_vec());
        }
        hash.update(step.step.encode_length_delimited_to_vec());
    }
    hash.update(share.end.encode_length_delimited_to_vec());
    hash.finalize().into()
}

#[cfg(test)]
mod tests {
    use proto::trajectory_log::{Share, ShareEnd, Step};

    use super::*;
    use crate::share::LoggedStep;

    #[test]
    fn a_forged_first_step_is_reported_as_a_gap_and_breaks_nothing() {
        let step =
            LoggedStep { pose: sim::Pose::default(), agents: Vec::new(), step: Step::default() };
        let share = |first_step| LoggedShare {
            head: Share { episode_id: "rollout-0-0".to_owned(), first_step, ..Share::default() },
            steps: vec![step.clone(); 3],
            end: ShareEnd::default(),
        };
        let mut index = Index::default();
        index.take(0, &share(u32::MAX - 1), (0, 0));
        index.take(0, &share(u32::MAX), (0, 0));
        assert_eq!(index.gaps(), ["rollout-0-0: steps 0 to 4294967293"]);
        assert!(index.contradictions().is_empty());
    }
}
