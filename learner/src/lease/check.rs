//! The check of what an actor sends for a lease, before it reaches the table: a pure function of the message and of what
//! is known of the lease. It runs the policies over all or the first of a chunk's steps, so it takes milliseconds.

use std::sync::Arc;

use proto::wire::push_trajectory_request::Content;
use proto::{
    Digest, EvaluationResult, Reason, Refusal, RolloutWork, RunDescription, TrajectoryChunk, Work,
};

use crate::lease::canary::{self, Extent};
use crate::lease::end_states::{StateReader, follow};
use crate::lease::published::Published;
use crate::lease::slots::{Assignment, ResultPart};

/// What the next part of a lease's result is checked against.
#[derive(Clone, Debug)]
pub struct Check {
    /// What the table knows of the lease.
    pub assignment: Assignment,
    /// The weights that the lease names.
    pub weights: Arc<Published>,
    /// How much of a chunk is checked.
    pub extent: Extent,
}

impl Check {
    /// Decodes and checks the content of a message for the lease, whose digest its header gives.
    ///
    /// # Errors
    /// Refuses a content that is malformed or has another digest, and what [`Self::chunk`] refuses.
    ///
    /// # Panics
    /// If the content is of another kind than the lease's work, which the table refuses.
    pub fn read(
        &self,
        content: &Content,
        digest: Digest,
        run: &RunDescription,
        states: &StateReader,
    ) -> Result<ResultPart, Refusal> {
        match (content, &*self.assignment.work) {
            (Content::Chunk(chunk), Work::Rollout(slot)) => {
                let chunk = TrajectoryChunk::from_wire(chunk, run, &slot.origin(), digest)?;
                self.chunk(&chunk, slot, run, states)?;
                Ok(ResultPart::Chunk(chunk))
            }
            (Content::Evaluation(result), Work::Evaluation(work)) => {
                let result = EvaluationResult::from_wire(result, run, work.iteration, digest)?;
                if work.episode != result.episode {
                    let detail = format!("{}, the lease is for {}", result.episode, work.episode);
                    return Err(Refusal::new(Reason::BadValue, "evaluation.episode", detail));
                }
                Ok(ResultPart::Episode(result))
            }
            (_, work) => unreachable!("the table refuses other content for {work:?}"),
        }
    }

    /// Checks a chunk of `slot`, which is the lease's and has been validated for `run`.
    ///
    /// # Errors
    /// Refuses a chunk that the lease's weights do not explain, and end states that cannot be decoded or do not continue
    /// the slot's episodes.
    pub fn chunk(
        &self,
        chunk: &TrajectoryChunk,
        slot: &RolloutWork,
        run: &RunDescription,
        states: &StateReader,
    ) -> Result<(), Refusal> {
        let made = (&slot.origin(), self.assignment.trust);
        canary::check(&self.weights.policy, run, chunk, made, self.extent)?;
        let (Some(end), Some(courses)) = (&chunk.end, &self.assignment.courses) else {
            return Ok(());
        };
        let mut courses = courses.clone();
        follow(&mut courses, chunk);
        states.check_end(slot, &courses, &end.environments, run)
    }
}
