//! Environments whose start state cannot be used begin a new episode, with the key of that episode.

use std::path::Path;

use proto::{RolloutOrigin, RolloutWork};

use crate::train::trainer::{RunningTrainer, Trainer};

impl RunningTrainer {
    /// Begins new episodes in the environments of a slot of the open iteration.
    pub(super) fn begin_again(&mut self, slot: &RolloutOrigin) {
        if slot.iteration != self.trainer.iteration {
            return;
        }
        slot.environments.iter().for_each(|environment| self.trainer.begin_again(*environment));
        tracing::error!(
            "slot {} of iteration {}: no actor can continue its episodes; its environments {:?} begin new ones",
            slot.slot,
            slot.iteration,
            slot.environments
        );
        self.outside.exchange.replace(RolloutWork {
            iteration: slot.iteration,
            slot: slot.slot,
            environments: self.trainer.environments.starts_of(&slot.environments),
        });
    }
}

impl Trainer {
    /// Begins a new episode in an environment that continues one, and notifies the learning rule.
    fn begin_again(&mut self, environment: u32) {
        if self.environments.begin_again(environment) {
            self.algorithm.begin_again(environment as usize);
        }
    }

    /// Begins new episodes in the environments whose states in the checkpoint at `path` are invalid.
    pub(crate) fn begin_invalid_again(&mut self, path: &Path) {
        for (environment, why) in self.environments.invalid(&self.launch.states) {
            self.begin_again(environment);
            tracing::error!(
                "environment {environment} begins a new episode: its state in {} cannot be restored: {why}",
                path.display()
            );
        }
    }
}
