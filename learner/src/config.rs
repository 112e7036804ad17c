//! The learner's settings: environments, leases, evaluation, checkpoints, threads. Defaults are in
//! the binary's configuration files, never here.

use policy::setting::{SettingError, between, divisor, within};
use serde::{Deserialize, Serialize};

mod audit;

pub use audit::{AuditConfig, Fingerprint};

/// Slots for each actor thread, if there are environments for them.
const SLOTS_PER_THREAD: usize = 2;
/// Most environments of a slot that is cut to the actor threads: more share a message, but one failure loses them all.
const MOST_PER_SLOT: usize = 10;

/// Most episodes of an evaluation.
pub const EPISODES_LIMIT: u32 = 10_000;

/// The learner's settings besides the algorithm, by section.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LearnerConfig {
    /// How many environments, and how they are cut into slots.
    pub environments: EnvironmentsConfig,
    /// How long an actor may be silent.
    pub lease: LeaseConfig,
    /// What is computed twice, and by whom.
    pub audit: AuditConfig,
    /// When and how policies are evaluated.
    pub evaluation: EvaluationConfig,
    /// When the run is saved.
    pub checkpoint: CheckpointConfig,
    /// The learner's own machine.
    pub learner: ThreadsConfig,
}

/// How many environments, and how they are cut into slots.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EnvironmentsConfig {
    /// Environments of the run.
    pub count: usize,
    /// Steps of each environment in one iteration.
    pub steps: usize,
    /// Environments in one slot, the unit of work that an actor leases; 0: cut to the connected actor threads.
    pub per_slot: usize,
    /// Steps in one message from an actor.
    pub message_steps: usize,
    /// When first episodes end.
    pub phase: Phase,
}

/// When the environments' first episodes end.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Phase {
    /// Evenly spread over the step limit, so that episodes end in every iteration.
    Staggered,
    /// All at the step limit.
    Lockstep,
}

/// How long an actor may be silent.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LeaseConfig {
    /// Time without a message after which a lease ends, seconds.
    pub ttl_secs: f64,
}

/// Heartbeats of an actor within the time to live of a lease: three may be lost.
const HEARTBEATS_PER_LEASE: f64 = 4.0;

impl LeaseConfig {
    /// Time between two heartbeats of an actor, seconds.
    #[must_use]
    pub fn heartbeat_secs(&self) -> f64 {
        self.ttl_secs / HEARTBEATS_PER_LEASE
    }

    fn validate(&self) -> Result<(), SettingError> {
        between("lease.ttl_secs", self.ttl_secs, 0.1, 3600.0)
    }
}

/// When and how policies are evaluated.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EvaluationConfig {
    /// Environment steps between two evaluations; 0: never.
    pub every_steps: u64,
    /// Number of whole episodes.
    pub episodes: u32,
    /// Whether actions are sampled instead of means or likeliest choices.
    pub sampled: bool,
}

impl EvaluationConfig {
    /// Whether the policies after `iteration` of `last_iteration` iterations are evaluated: at the start, at the end, and when the
    /// steps pass a multiple of `every_steps`, which is above 0.
    #[must_use]
    pub fn is_due(&self, iteration: u64, steps_per_iteration: u64, last_iteration: u64) -> bool {
        let passed = |iteration: u64| iteration * steps_per_iteration / self.every_steps;
        iteration == 0 || iteration == last_iteration || passed(iteration) > passed(iteration - 1)
    }
}

/// When the run is saved.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CheckpointConfig {
    /// Iterations between two checkpoints.
    pub every: u64,
    /// Newest checkpoints that stay in the run folder.
    pub keep_last: usize,
}

impl CheckpointConfig {
    fn validate(&self) -> Result<(), SettingError> {
        within("checkpoint.every", self.every, 1.., "at least 1")?;
        between("checkpoint.keep_last", self.keep_last, 1, 1_000_000)
    }
}

/// The learner's own machine.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ThreadsConfig {
    /// Threads of the update; 0: one per core. No result depends on it.
    pub threads: usize,
    /// Connections that may have actors.
    pub connections: usize,
    /// Whether actors of other builds may register if their fingerprint is the run's.
    pub other_builds: bool,
}

impl LearnerConfig {
    /// Refuses values outside their ranges.
    ///
    /// # Errors
    /// Names the first key that is wrong and its range.
    pub fn validate(&self) -> Result<(), SettingError> {
        self.environments.validate()?;
        self.lease.validate()?;
        self.audit.validate()?;
        if self.evaluation.every_steps > 0 {
            between("evaluation.episodes", self.evaluation.episodes, 1, EPISODES_LIMIT)?;
        }
        self.checkpoint.validate()?;
        between("learner.threads", self.learner.threads, 0, 1024)?;
        between("learner.connections", self.learner.connections, 1, 65_536)
    }
}

impl EnvironmentsConfig {
    /// Most slots of an iteration.
    pub(crate) fn most_slots(&self) -> usize {
        self.count / self.per_slot.max(1)
    }

    /// Environments of a slot for `threads` actor threads, if a slot may have `most`.
    #[must_use]
    pub fn slot_size(&self, threads: usize, most: usize) -> usize {
        slot_size(self.count, threads, self.per_slot).min(most)
    }

    /// Sizes that a slot may have, the largest first. With larger observations, messages leave room for smaller slots only.
    #[must_use]
    pub fn slot_sizes(&self) -> Vec<usize> {
        let most = if self.per_slot > 0 { self.per_slot } else { MOST_PER_SLOT };
        let sizes = (1..=most.min(self.count)).rev();
        sizes.filter(|size| self.count.is_multiple_of(*size)).collect()
    }

    /// Environment steps of one iteration.
    #[must_use]
    pub fn steps_per_iteration(&self) -> u64 {
        self.count as u64 * self.steps as u64
    }

    fn validate(&self) -> Result<(), SettingError> {
        between("environments.count", self.count, 1, 1_000_000)?;
        between("environments.steps", self.steps, 1, 1_000_000)?;
        between("environments.per_slot", self.per_slot, 0, self.count)?;
        let message = "environments.message_steps";
        let range = format!("1 to environments.steps = {}", self.steps);
        within(message, self.message_steps, 1..=self.steps, &range)?;
        if self.per_slot > 0 {
            divisor("environments.per_slot", self.per_slot, "environments.count", self.count)?;
        }
        divisor(message, self.message_steps, "environments.steps", self.steps)
    }
}

/// Environments of one slot: `per_slot`, or if that is 0, the largest divisor of `environments` of at most ten that leaves two
/// slots for each of `threads` actor threads, so that a thread steps one while it sends another. Every slot has the same number.
/// While no thread is connected, a slot has one environment, because the number of threads is unknown.
#[must_use]
pub fn slot_size(environments: usize, threads: usize, per_slot: usize) -> usize {
    if per_slot > 0 {
        return per_slot;
    }
    let most = match threads {
        0 => 1,
        threads => (environments / threads.saturating_mul(SLOTS_PER_THREAD)).min(MOST_PER_SLOT),
    };
    (1..=most).rev().find(|size| environments.is_multiple_of(*size)).unwrap_or(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config() -> EnvironmentsConfig {
        EnvironmentsConfig {
            count: 20,
            steps: 200,
            per_slot: 2,
            message_steps: 50,
            phase: Phase::Staggered,
        }
    }

    #[test]
    fn the_default_sizes_are_valid() {
        assert_eq!(config().validate(), Ok(()));
        assert_eq!((config().most_slots(), config().steps_per_iteration()), (10, 4000));
        assert_eq!(EnvironmentsConfig { per_slot: 0, ..config() }.validate(), Ok(()));
    }

    #[test]
    fn a_slot_leaves_two_for_each_thread_as_long_as_environments_suffice() {
        let sizes = |environments, threads: [usize; 6]| {
            threads.map(|threads| slot_size(environments, threads, 0))
        };
        // 20 environments: 1 thread has 2 slots of 10, 2 have 4 of 5, 3 have 10 of 2 (3 does not divide 20), 5 have 10 of 2.
        assert_eq!(sizes(20, [1, 2, 3, 5, 6, 1000]), [10, 5, 2, 2, 1, 1]);
        // 400 environments: at most ten in a slot.
        assert_eq!(sizes(400, [1, 20, 21, 40, 100, 200]), [10, 10, 8, 5, 2, 1]);
        // 23 environments have no smaller divisor than 1.
        assert_eq!(sizes(23, [1, 2, 3, 4, 11, 23]), [1; 6]);
        // While no thread is connected, one.
        assert_eq!((slot_size(20, 0, 0), slot_size(1, 0, 0), slot_size(1, 8, 0)), (1, 1, 1));
        // A set size holds for any number of threads.
        assert_eq!([0, 1, 50].map(|threads| slot_size(20, threads, 4)), [4; 3]);
    }

    #[test]
    fn a_slot_is_no_larger_than_its_messages_allow() {
        let config = EnvironmentsConfig { per_slot: 0, ..config() };
        assert_eq!(config.slot_sizes(), [10, 5, 4, 2, 1]);
        assert_eq!(EnvironmentsConfig { per_slot: 2, ..config }.slot_sizes(), [2, 1]);
        assert_eq!([10, 4, 1].map(|most| config.slot_size(1, most)), [10, 4, 1]);
    }

    #[test]
    fn sizes_that_do_not_fit_are_refused_by_name() {
        type Change = fn(&mut EnvironmentsConfig);
        let cases: [(Change, &str); 4] = [
            (|c| c.count = 0, "count = 0 is out of range: 1 to 1000000"),
            (
                |c| c.per_slot = 3,
                "per_slot = 3 is out of range: a divisor of environments.count = 20",
            ),
            (
                |c| c.message_steps = 300,
                "message_steps = 300 is out of range: 1 to environments.steps = 200",
            ),
            (
                |c| c.message_steps = 30,
                "message_steps = 30 is out of range: a divisor of environments.steps = 200",
            ),
        ];
        for (change, line) in cases {
            let mut config = config();
            change(&mut config);
            let error = config.validate().unwrap_err().to_string();
            assert_eq!(error, format!("environments.{line}"));
        }
    }
}
