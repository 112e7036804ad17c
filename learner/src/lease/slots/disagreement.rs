//! Two valid results of the same work that differ.

use std::fmt;

use proto::{ActorId, Digest, LeaseId, Work};

use super::works::iteration;

/// The digest of a chunk or of an episode's result, and who computed it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ComputedPart {
    /// The actor that computed it.
    pub actor: ActorId,
    /// The lease under which it was computed.
    pub lease: LeaseId,
    /// The digest.
    pub digest: Digest,
}

/// A part of an actor's work that has a digest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// A chunk of a slot.
    Chunk {
        /// The slot.
        slot: u32,
        /// The chunk's place in the slot.
        sequence: u32,
    },
    /// The result of an evaluation episode.
    Episode(u32),
}

/// Two valid results that differ: a machine, the program or the environment is not deterministic, or an actor
/// sent a wrong result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Disagreement {
    /// The iteration.
    pub iteration: u64,
    /// The first part that differs.
    pub part: Part,
    /// The earlier result.
    pub first: ComputedPart,
    /// The later one.
    pub second: ComputedPart,
}

/// The digests of a result, from its first part on, and who computed it.
#[derive(Clone, Debug)]
pub(super) struct Computed {
    pub(super) actor: ActorId,
    pub(super) lease: LeaseId,
    pub(super) digests: Vec<Digest>,
}

impl Computed {
    /// The first part that both have, with different digests.
    pub(super) fn first_difference(&self, other: &Self) -> Option<usize> {
        self.digests.iter().zip(&other.digests).position(|(one, other)| one != other)
    }

    fn part(&self, at: usize) -> ComputedPart {
        ComputedPart { actor: self.actor, lease: self.lease, digest: self.digests[at] }
    }
}

impl Disagreement {
    /// The first difference of two results of `work`, if there is one.
    pub(super) fn between(work: &Work, first: &Computed, second: &Computed) -> Option<Self> {
        let at = first.first_difference(second)?;
        let part = match work {
            Work::Rollout(slot) => Part::Chunk { slot: slot.slot, sequence: at as u32 },
            Work::Evaluation(episode) => Part::Episode(episode.episode),
        };
        let (first, second) = (first.part(at), second.part(at));
        Some(Self { iteration: iteration(work), part, first, second })
    }
}

impl fmt::Display for Disagreement {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { iteration, part, first, second } = self;
        let (what, wrong) = match part {
            Part::Chunk { slot, sequence } => (
                format!("chunk {sequence} of slot {slot} in iteration {iteration}"),
                format!("checkpoints after iteration {iteration}"),
            ),
            Part::Episode(episode) => (
                format!("evaluation episode {episode} of iteration {iteration}"),
                "other evaluations of this run".to_owned(),
            ),
        };
        write!(
            f,
            "{what}: actor {} gave {}, actor {} gave {}; a machine, the program or the environment is not \
             deterministic; {wrong} may hold wrong results; audit.share = 0 switches this comparison off",
            first.actor, first.digest, second.actor, second.digest
        )
    }
}
