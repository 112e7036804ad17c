//! What the table of slots hands out: leases, complete slots, things to be done.

use std::time::Duration;

use proto::{
    ActorId, Digest, EvaluationResult, Lease, LeaseFailure, LeaseId, LeaseStatus, LeasedWork,
    RolloutOrigin, TrajectoryChunk,
};

use super::Disagreement;
use crate::observe::snapshot::AuditCounts;

/// A complete slot.
#[derive(Clone, Debug, PartialEq)]
pub struct SlotRollout {
    /// The slot's index.
    pub slot: u32,
    /// Who computed it.
    pub actor: ActorId,
    /// Under which lease.
    pub lease: LeaseId,
    /// All its chunks, in order.
    pub chunks: Vec<TrajectoryChunk>,
    /// Their digests.
    pub digests: Vec<Digest>,
}

impl SlotRollout {
    /// `E`, the slot's environments; 0 without a chunk.
    #[must_use]
    pub fn environments(&self) -> usize {
        self.chunks.first().map_or(0, |chunk| chunk.reward.len() / chunk.steps as usize)
    }
}

/// A complete evaluation.
#[derive(Clone, Debug, PartialEq)]
pub struct EvaluationOutcome {
    /// The iteration whose weights were evaluated.
    pub iteration: u64,
    /// By episode.
    pub episodes: Vec<EvaluationResult>,
}

/// An action that the table requests of the exchange.
#[derive(Clone, Debug, PartialEq)]
pub enum Effect {
    /// Work came free, or the run's state changed: tasks that wait for a lease are woken.
    WorkFreed,
    /// The open iteration is complete, ordered by slot.
    Iteration(Vec<SlotRollout>),
    /// An evaluation is complete.
    Evaluation(EvaluationOutcome),
    /// Two valid results differ.
    Failed(Box<Disagreement>),
    /// The start states of this slot cannot be used: it waits for others ([`super::SlotTable::replace`]).
    BeginAgain(RolloutOrigin),
    /// Work that no actor can do.
    GivenUp {
        /// The last actor that failed.
        actor: ActorId,
        /// The work.
        work: LeasedWork,
        /// How often it failed.
        times: u32,
        /// The last cause.
        detail: String,
    },
}

/// What went wrong with an actor's work, for the log.
#[derive(Clone, Debug, PartialEq)]
pub enum Incident {
    /// The actor's connection closed, or had no more room for it.
    Gone {
        /// The actor.
        actor: ActorId,
        /// Its leases, which end now.
        leases: Vec<LeaseStatus>,
    },
    /// No message came for this lease for its time to live, it made no progress for long, or it is too old.
    Expired(LeaseStatus),
    /// The actor cannot process this lease and returned it.
    Returned {
        /// The lease, ended now.
        lease: LeaseStatus,
        /// What prevents its processing.
        failure: LeaseFailure,
        /// The cause.
        detail: String,
        /// The slot's environments; empty for other work.
        environments: Vec<u32>,
    },
    /// Too many messages in a row were refused, or leases expired.
    Quarantined {
        /// The actor.
        actor: ActorId,
        /// How long it gets no work.
        pause: Duration,
    },
}

/// The answer to an actor that asks for work.
#[derive(Clone, Debug, PartialEq)]
pub enum Offer {
    /// A lease of work.
    Lease(Lease),
    /// Nothing is free.
    Nothing,
    /// Too many of the actor's messages were refused or of its leases expired: nothing for this actor until then.
    Quarantined(Duration),
    /// The run is over.
    Done,
}

/// Progress of the table, and its number of entries of each kind. Each kind has a bound, which no message can exceed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Chunks accepted in the open iteration, of complete slots and of the lease of each held slot that is furthest.
    pub chunks: u64,
    /// Chunks in memory: at most all of the open iteration twice.
    pub held_chunks: u64,
    /// Registered actors: at most 16 for each open connection.
    pub actors: usize,
    /// Actors without a fingerprint of which a result was accepted, over the whole run.
    pub foreign: u64,
    /// Slots and episodes that had to be leased again, over the whole run.
    pub reissued: u64,
    /// Slots and episodes that were leased a second time because the first lease was slow, over the whole run.
    pub backups: u64,
    /// Slots and episodes computed twice for comparison, over the whole run.
    pub audits: AuditCounts,
    /// Slots to be computed again for comparison: at most 8.
    pub open_audits: usize,
    /// Open leases: at most two for each slot and each episode of an open evaluation, and one for each audit.
    pub leases: usize,
    /// Finished leases whose results are recognised when they come again: at most 4,096.
    pub finished_leases: usize,
    /// Digests of ended leases: at most 8 lists for each slot.
    pub earlier_results: usize,
    /// Slots of the open iteration.
    pub slots: usize,
    /// Environments of all these slots.
    pub environments: usize,
    /// Environments of each of these slots; of the largest, if they differ.
    pub environments_per_slot: usize,
    /// Slots of the open iteration that are leased.
    pub held_slots: usize,
    /// Median time from lease to result of the latest slots, for each of a slot's environments; `None` before the first.
    pub slot_time: Option<Duration>,
    /// Slots of the open iteration whose result is complete.
    pub complete_slots: usize,
}
