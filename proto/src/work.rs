//! Work of an actor: leases, rollout slots, evaluation episodes.

use bytes::Bytes;

use crate::read::{digest, from_1_to, length, required};
use crate::tensor;
use crate::{Digest, Incarnation, LeaseId, PolicyVersion, Refusal, RunDescription, wire};

/// Work for one actor.
#[derive(Clone, Debug, PartialEq)]
pub struct Lease {
    /// Id of the lease.
    pub id: LeaseId,
    /// The incarnation of the learner that issued it.
    pub incarnation: Incarnation,
    /// The weights to use for acting.
    pub weights: WeightsName,
    /// Number of earlier leases for the same work.
    pub attempt: u32,
    /// The work.
    pub work: Work,
}

/// Identity of a policy snapshot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct WeightsName {
    /// Number of updates in the weights.
    pub version: PolicyVersion,
    /// SHA-256 of the snapshot's bytes.
    pub digest: Digest,
}

/// Kind of work.
#[derive(Clone, Debug, PartialEq)]
pub enum Work {
    /// Roll out a slot.
    Rollout(RolloutWork),
    /// Play an evaluation episode.
    Evaluation(EvaluationWork),
}

/// One slot: all its steps, from the first.
#[derive(Clone, Debug, PartialEq)]
pub struct RolloutWork {
    /// Its iteration.
    pub iteration: u64,
    /// The slot's index.
    pub slot: u32,
    /// `[E]`, in the order of the chunks' rows.
    pub environments: Vec<EnvironmentStart>,
}

/// The slot that a chunk belongs to. The chunk's digest covers it, so that no chunk passes for another slot's.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RolloutOrigin {
    /// The iteration.
    pub iteration: u64,
    /// The slot's index.
    pub slot: u32,
    /// `[E]`, the environments' indices over the whole run.
    pub environments: Vec<u32>,
}

/// Start of an environment in a slot.
#[derive(Clone, Debug, PartialEq)]
pub struct EnvironmentStart {
    /// Index in the whole run; part of the key of random draws.
    pub environment: u32,
    /// Its initial state.
    pub start: Start,
}

/// Initial state of an environment.
#[derive(Clone, Debug, PartialEq)]
pub enum Start {
    /// A new episode; recurrent states are zero.
    Fresh {
        /// Part of the key of the reset's random draws.
        episode: u64,
        /// Steps until this episode is truncated.
        limit: u32,
    },
    /// The end of an earlier slot.
    Continue {
        /// The environment's encoded state.
        state: Vec<u8>,
        /// For each agent `[H]`.
        recurrent: Vec<Vec<f32>>,
    },
}

/// One whole episode. Both fields are part of the key of its reset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EvaluationWork {
    /// The iteration whose weights are evaluated.
    pub iteration: u64,
    /// The episode's index.
    pub episode: u32,
}

impl Lease {
    /// Converts to the message.
    #[must_use]
    pub fn to_wire(&self) -> wire::Lease {
        let work = match &self.work {
            Work::Rollout(work) => wire::lease::Work::Rollout(work.to_wire()),
            Work::Evaluation(work) => wire::lease::Work::Evaluation(wire::EvaluationWork {
                iteration: work.iteration,
                episode: work.episode,
            }),
        };
        wire::Lease {
            lease_id: self.id.0,
            incarnation: self.incarnation.0,
            weights: Some(self.weights.to_wire()),
            attempt: self.attempt,
            work: Some(work),
        }
    }

    /// Reads the message of `run`.
    ///
    /// # Errors
    /// If a part is missing, or a start state has a wrong size.
    pub fn from_wire(wire: wire::Lease, run: &RunDescription) -> Result<Self, Refusal> {
        let work = match required(wire.work, "lease.work")? {
            wire::lease::Work::Rollout(work) => Work::Rollout(RolloutWork::from_wire(work, run)?),
            wire::lease::Work::Evaluation(work) => Work::Evaluation(EvaluationWork {
                iteration: work.iteration,
                episode: work.episode,
            }),
        };
        Ok(Self {
            id: LeaseId(wire.lease_id),
            incarnation: Incarnation(wire.incarnation),
            weights: WeightsName::from_wire(wire.weights, "lease.weights")?,
            attempt: wire.attempt,
            work,
        })
    }
}

impl WeightsName {
    /// Converts to the message.
    #[must_use]
    pub fn to_wire(&self) -> wire::WeightsName {
        wire::WeightsName {
            version: self.version.0,
            digest: Bytes::copy_from_slice(&self.digest.0),
        }
    }

    /// Reads the message at `field`.
    ///
    /// # Errors
    /// If the name is missing or the digest is not a SHA-256.
    pub fn from_wire(wire: Option<wire::WeightsName>, field: &str) -> Result<Self, Refusal> {
        let wire = required(wire, field)?;
        let digest = digest(&wire.digest, &format!("{field}.digest"))?;
        Ok(Self { version: PolicyVersion(wire.version), digest })
    }
}

impl RolloutWork {
    /// The slot, for the digests of its chunks.
    #[must_use]
    pub fn origin(&self) -> RolloutOrigin {
        RolloutOrigin {
            iteration: self.iteration,
            slot: self.slot,
            environments: self.environments.iter().map(|start| start.environment).collect(),
        }
    }

    fn to_wire(&self) -> wire::RolloutWork {
        wire::RolloutWork {
            iteration: self.iteration,
            slot: self.slot,
            environments: self.environments.iter().map(EnvironmentStart::to_wire).collect(),
        }
    }

    fn from_wire(wire: wire::RolloutWork, run: &RunDescription) -> Result<Self, Refusal> {
        let field = "lease.rollout.environments";
        let most = run.environments_per_slot as usize;
        from_1_to(most, wire.environments.len(), "entries", field)?;
        let starts = wire.environments.into_iter().enumerate();
        let start = |(i, wire)| EnvironmentStart::from_wire(wire, run, &format!("{field}[{i}]"));
        let environments = starts.map(start).collect::<Result<_, _>>()?;
        Ok(Self { iteration: wire.iteration, slot: wire.slot, environments })
    }
}

impl EnvironmentStart {
    fn to_wire(&self) -> wire::EnvironmentStart {
        let start = match &self.start {
            Start::Fresh { episode, limit } => {
                wire::environment_start::Start::Fresh(wire::FreshStart {
                    episode: *episode,
                    limit: *limit,
                })
            }
            Start::Continue { state, recurrent } => {
                wire::environment_start::Start::Continued(wire::ContinuedStart {
                    state: Bytes::copy_from_slice(state),
                    recurrent: recurrent.iter().map(|h| tensor::floats(&[h.len()], h)).collect(),
                })
            }
        };
        wire::EnvironmentStart { environment: self.environment, start: Some(start) }
    }

    fn from_wire(
        wire: wire::EnvironmentStart,
        run: &RunDescription,
        field: &str,
    ) -> Result<Self, Refusal> {
        let start = match required(wire.start, &format!("{field}.start"))? {
            wire::environment_start::Start::Fresh(fresh) => {
                Start::Fresh { episode: fresh.episode, limit: fresh.limit }
            }
            wire::environment_start::Start::Continued(continued) => {
                continued_from_wire(continued, run, &format!("{field}.continued"))?
            }
        };
        Ok(Self { environment: wire.environment, start })
    }
}

fn continued_from_wire(
    wire: wire::ContinuedStart,
    run: &RunDescription,
    field: &str,
) -> Result<Start, Refusal> {
    state_size(wire.state.len(), run, &format!("{field}.state"))?;
    length(wire.recurrent.len(), run.hidden_sizes.len(), &format!("{field}.recurrent"))?;
    let tensors = wire.recurrent.iter().zip(&run.hidden_sizes).enumerate();
    let recurrent = tensors.map(|(i, (tensor, size))| {
        tensor::read_floats(Some(tensor), &[*size as usize], &format!("{field}.recurrent[{i}]"))
    });
    Ok(Start::Continue {
        state: wire.state.to_vec(),
        recurrent: recurrent.collect::<Result<_, _>>()?,
    })
}

/// Checks that an encoded environment state is neither empty nor longer than the description allows.
pub(crate) fn state_size(found: usize, run: &RunDescription, field: &str) -> Result<(), Refusal> {
    from_1_to(run.environment.max_state_bytes as usize, found, "bytes", field)
}
