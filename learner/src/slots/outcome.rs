//! What the table of slots hands out: leases, complete slots, things to be done.

use std::time::Duration;

use proto::{ActorId, Digest, EvaluationResult, Lease, LeaseId, TrajectoryChunk};

use super::Disagreement;

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

/// A complete evaluation.
#[derive(Clone, Debug, PartialEq)]
pub struct EvaluationOutcome {
    /// The iteration whose weights were evaluated.
    pub iteration: u64,
    /// By episode.
    pub episodes: Vec<EvaluationResult>,
}

/// What the table wants done.
#[derive(Clone, Debug, PartialEq)]
pub enum Effect {
    /// Work came free, or the run's state changed: wake whoever waits for a lease.
    WorkFreed,
    /// The open iteration is complete, ordered by slot.
    Iteration(Vec<SlotRollout>),
    /// An evaluation is complete.
    Evaluation(EvaluationOutcome),
    /// Two valid results differ.
    Failed(Box<Disagreement>),
}

/// The answer to an actor that asks for work.
#[derive(Clone, Debug, PartialEq)]
pub enum Offer {
    /// Do this.
    Lease(Lease),
    /// Nothing is free.
    Nothing,
    /// Too many of the actor's messages were refused: nothing for this actor until then.
    Quarantined(Duration),
    /// The run is over.
    Done,
}

/// How far the table is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Chunks accepted in the open iteration, of open leases and complete slots.
    pub chunks: u64,
    /// Registered actors.
    pub actors: usize,
    /// Registrations without a fingerprint, over the whole run.
    pub foreign: u64,
    /// Slots and episodes that had to be leased again, over the whole run.
    pub reissued: u64,
}
