//! What a run tells whoever watches it.

use std::path::PathBuf;

use crate::evaluation::Spread;

/// Something happened that a watcher may show.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// The trainer goes over to something else.
    Stage(Stage),
    /// An iteration is finished.
    Iteration(IterationReport),
    /// Rollouts are coming in.
    Collecting {
        /// Finished iterations.
        iteration: u64,
        /// Environment steps so far, with those of the iteration that is being collected.
        env_steps: u64,
    },
    /// An evaluation is finished.
    Evaluation {
        /// Iterations after which these were the policies.
        iteration: u64,
        /// Environment steps of those iterations.
        env_steps: u64,
        /// Of the extrinsic returns.
        spread: Spread,
        /// Episodes.
        episodes: usize,
    },
    /// A checkpoint stands on disk.
    Checkpoint {
        /// Its directory.
        path: PathBuf,
        /// Its iteration.
        iteration: u64,
        /// How long it took to write.
        secs: f64,
        /// Size of its files.
        bytes: u64,
    },
    /// A checkpoint could not be written; the next iteration tries again.
    CheckpointFailed {
        /// Those in a row that could not.
        failures: u32,
    },
    /// No work is handed out until somebody resumes.
    Paused,
    /// Work is handed out again.
    Resumed,
    /// Nothing has come in for a while.
    Waiting {
        /// Seconds since anything did.
        seconds: f64,
        /// What is missing.
        reason: String,
    },
}

/// What the trainer is at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// It waits for rollouts.
    Collect,
    /// It learns from them.
    Update,
    /// It writes a checkpoint.
    Save,
}

impl Stage {
    /// All of them, in the order of an iteration.
    pub const ALL: [Self; 3] = [Self::Collect, Self::Update, Self::Save];

    /// Its name in lower case.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Collect => "collect",
            Self::Update => "update",
            Self::Save => "save",
        }
    }
}

/// What one iteration was like.
#[derive(Clone, Debug, PartialEq)]
pub struct IterationReport {
    /// Finished iterations, this one included.
    pub iteration: u64,
    /// Environment steps of all of them.
    pub env_steps: u64,
    /// From the end of the iteration before, or from the learner's start, to this one's end, whatever came between.
    pub iteration_secs: f64,
    /// From the lease of its slots to the last chunk.
    pub rollout_secs: f64,
    /// From the last chunk to the new policies, densities included.
    pub update_secs: f64,
    /// The part of it that densities took.
    pub density_secs: f64,
    /// Mean extrinsic return of the last finished episodes, at most 20; `None` before the first.
    pub episode_return: Option<f64>,
    /// Actors connected.
    pub actors: u64,
    /// Messages refused since the learner started.
    pub messages_refused: u64,
    /// Slots and episodes leased again since the learner started.
    pub leases_reissued: u64,
    /// The densities' and the algorithm's figures.
    pub metrics: Vec<(String, f64)>,
}

impl IterationReport {
    /// Environment steps per second of this iteration; all iterations have equally many.
    #[must_use]
    pub fn env_steps_per_sec(&self) -> f64 {
        self.env_steps as f64 / self.iteration as f64 / self.iteration_secs
    }
}
