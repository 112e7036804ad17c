//! What the exchange says of itself.

use std::collections::BTreeMap;

use tokio::sync::watch;

use crate::exchange::{Exchange, ExchangeError};
use crate::slots::{EvaluationOutcome, SlotRollout};

/// Why the trainer woke up.
#[derive(Clone, Debug, PartialEq)]
pub enum Wake {
    /// The open iteration is complete.
    Iteration {
        /// Every slot, in order.
        rollouts: Vec<SlotRollout>,
        /// From the opening of its slots to the last chunk.
        secs: f64,
    },
    /// An evaluation is complete.
    Evaluation(EvaluationOutcome),
    /// The run cannot go on.
    Failed(ExchangeError),
    /// Nothing happened for as long as it was willing to wait.
    Patience,
}

/// How far the exchange is.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Progress {
    /// Environment steps accepted in the open iteration.
    pub steps_collected: u64,
    /// Chunks accepted since the learner started.
    pub chunks_accepted: u64,
    /// Bytes of results that came in since the learner started.
    pub bytes_taken_in: u64,
    /// Steps that actors' trajectory logs and the learner's reward log lost since the learner started.
    pub log_steps_lost: u64,
    /// Size of the newest weights.
    pub weights_bytes: u64,
    /// Actors that are connected.
    pub actors: usize,
    /// Registrations without a fingerprint so far: with any, the run is not exactly repeatable.
    pub foreign_actors: u64,
    /// Refused messages by reason.
    pub refusals: BTreeMap<String, u64>,
    /// Slots and episodes that had to be leased again.
    pub leases_reissued: u64,
    /// Whether no work is handed out until somebody resumes.
    pub paused: bool,
}

/// Whether what the run learns reaches the disk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Storage {
    /// It does.
    Sound,
    /// The last checkpoint that was due could not be written.
    Degraded,
}

impl Exchange {
    /// How far it is.
    #[must_use]
    pub fn progress(&self) -> Progress {
        let shared = self.lock();
        let counts = shared.table.counts();
        let steps = u64::from(self.run.chunk_steps) * u64::from(self.run.environments_per_slot);
        Progress {
            steps_collected: counts.chunks * steps,
            chunks_accepted: shared.chunks_accepted,
            bytes_taken_in: shared.bytes_taken_in,
            log_steps_lost: shared.log_steps_lost,
            weights_bytes: shared.weights.newest_bytes(),
            actors: counts.actors,
            foreign_actors: counts.foreign,
            refusals: shared.refusals.clone(),
            leases_reissued: counts.reissued,
            paused: shared.table.is_paused(),
        }
    }

    /// Says whether checkpoints reach the disk.
    pub fn report_storage(&self, storage: Storage) {
        self.storage.send_replace(storage);
    }

    /// Whether checkpoints reach the disk, now and whenever it changes.
    #[must_use]
    pub fn storage(&self) -> watch::Receiver<Storage> {
        self.storage.subscribe()
    }
}
