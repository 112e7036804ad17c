//! Events of a run, for its observers.

use std::path::PathBuf;

use serde::Serialize;

/// An event of a run.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// The trainer enters another stage.
    Stage(Stage),
    /// An iteration is finished.
    Iteration(IterationReport),
    /// Results have arrived for the open iteration.
    Collecting {
        /// Finished iterations.
        iteration: u64,
        /// Environment steps so far, those of the open iteration included.
        env_steps: u64,
    },
    /// An evaluation is finished.
    Evaluation(EvaluationReport),
    /// A checkpoint has been written.
    Checkpoint(WrittenCheckpoint),
    /// A checkpoint could not be written; it is retried after the next iteration.
    CheckpointFailed {
        /// Consecutive failures.
        failures: u32,
    },
    /// No results have arrived for a while.
    Waiting {
        /// Seconds since the last result.
        seconds: f64,
        /// Why no results arrive.
        reason: String,
    },
}

/// A finished evaluation, with the names that its figures have in `metrics.jsonl`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct EvaluationReport {
    /// Finished iterations of the evaluated policies.
    pub iteration: u64,
    /// Environment steps of these iterations.
    pub env_steps: u64,
    /// Statistics of the extrinsic returns.
    #[serde(flatten)]
    pub spread: Spread,
    /// Number of episodes.
    pub episodes: usize,
    /// Whether actions were sampled instead of means or likeliest choices.
    pub sampled: bool,
    /// Mean over the episodes of the sum of each reward term, by the metric's name.
    #[serde(skip)]
    pub metrics: Vec<(String, f64)>,
}

/// A checkpoint on disk.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WrittenCheckpoint {
    /// Iteration of the checkpoint.
    pub iteration: u64,
    /// Duration of writing it, seconds.
    pub secs: f64,
    /// Size of its files, bytes.
    pub bytes: u64,
}

/// The trainer's current activity.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Stage {
    /// Waiting for rollouts.
    #[default]
    Collect,
    /// Updating densities, policies and critics.
    Update,
    /// Writing a checkpoint.
    Save,
}

impl Stage {
    /// All stages, in the order of an iteration.
    pub const ALL: [Self; 3] = [Self::Collect, Self::Update, Self::Save];

    /// The stage's name in lower case.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Collect => "collect",
            Self::Update => "update",
            Self::Save => "save",
        }
    }
}

/// The figures of one iteration, with the names that they have in `metrics.jsonl`.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct IterationReport {
    /// Finished iterations, this one included.
    pub iteration: u64,
    /// Environment steps of all finished iterations.
    pub env_steps: u64,
    /// From the end of the previous iteration, or the learner's start, to the end of this one, evaluations and
    /// checkpoints included.
    pub iteration_secs: f64,
    /// From the opening of its slots to the last chunk.
    pub rollout_secs: f64,
    /// From the last chunk to the new policies, densities included.
    pub update_secs: f64,
    /// The part of `update_secs` spent on densities.
    pub density_secs: f64,
    /// Mean extrinsic return of the last 20 finished episodes; `None` before the first.
    pub episode_return: Option<f64>,
    /// Connected actors.
    pub actors: u64,
    /// Messages refused since the learner started.
    pub messages_refused: u64,
    /// Slots and episodes leased again since the learner started.
    pub leases_reissued: u64,
    /// Figures of the densities, the algorithm and the reward's terms.
    #[serde(skip)]
    pub metrics: Vec<(String, f64)>,
}

impl IterationReport {
    /// Environment steps per second of this iteration; all iterations have the same number of steps.
    #[must_use]
    pub fn env_steps_per_sec(&self) -> f64 {
        self.env_steps as f64 / self.iteration as f64 / self.iteration_secs
    }
}

/// Fields of the lines of an iteration that depend on time, connections and disks, or on how slots were cut and leased. All
/// others are the same in equal runs.
pub const INCIDENTAL: [&str; 10] = [
    "slots",
    "iteration_secs",
    "rollout_secs",
    "update_secs",
    "density_secs",
    "env_steps_per_sec",
    "actors",
    "messages_refused",
    "leases_reissued",
    "checkpoints_failed",
];

/// Statistics of the extrinsic returns of one evaluation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Spread {
    /// Mean return.
    pub mean: f64,
    /// Population standard deviation: divided by the number of episodes.
    pub standard_deviation: f64,
    /// Smallest return.
    pub minimum: f64,
    /// Largest return.
    pub maximum: f64,
}

impl Spread {
    /// The statistics of the extrinsic returns of at least one episode.
    #[must_use]
    pub fn of(returns: impl ExactSizeIterator<Item = f64> + Clone) -> Self {
        let count = returns.len() as f64;
        let mean = returns.clone().sum::<f64>() / count;
        let square = |value: f64| (value - mean) * (value - mean);
        let variance = returns.clone().map(square).sum::<f64>() / count;
        Self {
            mean,
            standard_deviation: variance.sqrt(),
            minimum: returns.clone().fold(f64::INFINITY, f64::min),
            maximum: returns.fold(f64::NEG_INFINITY, f64::max),
        }
    }
}

/// How a run ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Summary {
    /// Finished iterations.
    pub iteration: u64,
    /// Environment steps of all finished iterations.
    pub env_steps: u64,
    /// The last checkpoint.
    pub checkpoint: PathBuf,
    /// Whether the run was stopped before its last iteration or its last evaluation had finished.
    pub stopped_early: bool,
    /// Hash of the weights, hexadecimal.
    pub weights_sha256: String,
    /// Hash of the whole state, hexadecimal.
    pub state_sha256: String,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_statistics_of_two_episodes_match_a_hand_calculation() {
        let spread = Spread { mean: 3.0, standard_deviation: 2.0, minimum: 1.0, maximum: 5.0 };
        assert_eq!(Spread::of([1.0, 5.0].into_iter()), spread);
    }
}
