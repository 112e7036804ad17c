//! Results of actors: decoded and checked without the lock, then taken in.

use proto::{
    Ack, AckState, EvaluationResult, LeaseId, PushHeader, Reason, Refusal, ReturnedLease,
    RolloutOrigin, TrajectoryChunk,
};

use super::Exchange;
use crate::canary::{self, Extent};
use crate::slots::{ChunkPreview, ConnectionId, EvaluationPreview, Trust};

impl Exchange {
    /// Whether an actor of this connection holds a lease.
    #[must_use]
    pub fn holds_lease(&self, connection: ConnectionId) -> bool {
        self.lock().table.holds_lease(connection)
    }

    /// Whether an actor registered on this connection.
    #[must_use]
    pub fn is_registered(&self, connection: ConnectionId) -> bool {
        self.lock().table.is_registered(connection)
    }

    /// Takes in a chunk, which `read` decodes and checks as one of the slot that it is given. Runs the policies over
    /// all or the first of its steps, so it belongs on a thread that may block.
    ///
    /// # Errors
    /// Refuses what [`crate::slots::SlotTable::preview_chunk`] and `read` refuse, a chunk that the lease's weights
    /// do not explain, and end states that cannot be decoded or do not continue the slot's episodes.
    pub fn accept_chunk(
        &self,
        sender: ConnectionId,
        header: &PushHeader,
        sequence: u32,
        read: impl FnOnce(&RolloutOrigin) -> Result<TrajectoryChunk, Refusal>,
    ) -> Result<Ack, Refusal> {
        let preview = self.change(|shared| shared.table.preview_chunk(sender, header, sequence))?;
        let (origin, trust) = match preview {
            ChunkPreview::Repeated(ack) => return Ok(ack),
            ChunkPreview::Next { origin, trust } => (origin, trust),
        };
        // Not under the lock: this takes milliseconds.
        let chunk = read(&origin)?;
        let published = self.lock().weights.find(header.weights)?;
        let drawn = (trust == Trust::Exact).then_some(&origin);
        let extent = self.extent(header.lease, sequence);
        canary::check(&published.policy, &self.run, &chunk, drawn, extent)?;
        let course = self.lock().table.course(header.lease, &chunk);
        course.map_or(Ok(()), |course| self.states.check_end(&course, &self.run))?;
        self.change(|shared| {
            // An audit has no environments of its own: its end states are only compared. Only the last chunk has some.
            let lease = shared.table.lease_of(sender, header.lease).filter(|_| chunk.end.is_some());
            let ended =
                lease.map(|lease| (lease.actor, shared.table.environments_of(header.lease)));
            let ack = shared.table.chunk(sender, header, chunk)?;
            shared.chunks_accepted += u64::from(ack.state == AckState::Accepted);
            if let Some((actor, environments)) = ended.filter(|_| ack.lease_finished) {
                shared.names.note_sender(actor, &environments);
            }
            Ok(ack)
        })
    }

    /// An actor returns a lease that it cannot process.
    ///
    /// # Errors
    /// Refuses unknown actors and other incarnations.
    pub fn give_back(&self, sender: ConnectionId, returned: &ReturnedLease) -> Result<(), Refusal> {
        self.change(|shared| shared.table.give_back(sender, returned))
    }

    /// How much of a chunk is checked: all of it if the secret sample covers it, or if any actor has failed a check since
    /// this start. A suspect could otherwise register again.
    fn extent(&self, lease: LeaseId, sequence: u32) -> Extent {
        let failed = self.lock().refusals.contains_key(Reason::CanaryMismatch.name());
        match failed || self.checked.covers([lease.0, sequence.into()]) {
            true => Extent::Chunk,
            false => Extent::FirstStep,
        }
    }

    /// Takes in the result of an evaluation episode, which `read` checks as one of the iteration that it is given.
    ///
    /// # Errors
    /// See [`crate::slots::SlotTable::evaluation`].
    pub fn accept_evaluation(
        &self,
        sender: ConnectionId,
        header: &PushHeader,
        read: impl FnOnce(u64) -> Result<EvaluationResult, Refusal>,
    ) -> Result<Ack, Refusal> {
        match self.change(|shared| shared.table.preview_evaluation(sender, header))? {
            EvaluationPreview::Repeated(ack) => Ok(ack),
            EvaluationPreview::Next(work) => {
                let result = read(work.iteration)?;
                self.change(|shared| shared.table.evaluation(sender, header, result))
            }
        }
    }
}
