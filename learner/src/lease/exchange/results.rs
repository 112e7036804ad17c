//! What actors send for their leases: results, returned leases, and refused messages.

use proto::{Ack, AckState, LeaseId, PushHeader, Reason, Refusal, ReturnedLease, Work};

use super::{Caller, Exchange};
use crate::lease::canary::Extent;
use crate::lease::check::Check;
use crate::lease::slots::{ConnectionId, Preview, ResultPart};

impl Exchange {
    /// Whether an actor of this connection holds a lease.
    pub(crate) fn holds_lease(&self, connection: ConnectionId) -> bool {
        self.lock().table.holds_lease(connection)
    }

    /// Whether an actor registered on this connection.
    pub(crate) fn is_registered(&self, connection: ConnectionId) -> bool {
        self.lock().table.is_registered(connection)
    }

    /// An actor returns a lease that it cannot process.
    ///
    /// # Errors
    /// Refuses unknown actors and other incarnations.
    pub fn give_back(&self, sender: ConnectionId, returned: &ReturnedLease) -> Result<(), Refusal> {
        self.change(|shared| shared.table.give_back(sender, returned))
    }

    /// What a part of a result under `header` is checked against: chunk `sequence` of a slot, or, with `None`, the result of
    /// an episode. An acknowledgement if it was taken in before.
    ///
    /// # Errors
    /// What [`SlotTable::preview`](crate::lease::slots::SlotTable::preview) refuses, and weights that are not held.
    pub fn expected(
        &self,
        sender: ConnectionId,
        header: &PushHeader,
        sequence: Option<u32>,
    ) -> Result<Preview<Check>, Refusal> {
        self.change(|shared| match shared.table.preview(sender, header, sequence)? {
            Preview::Repeated(ack) => Ok(Preview::Repeated(ack)),
            Preview::Next(assignment) => {
                let weights = shared.weights.find(header.weights)?;
                // A suspect could register again, so one failed check counts for all actors.
                let failed = shared.refusals.contains_key(Reason::CanaryMismatch.name());
                let key = [header.lease.0, sequence.unwrap_or(0).into()];
                let whole = failed || self.checked.covers(key);
                let extent = if whole { Extent::Chunk } else { Extent::FirstStep };
                Ok(Preview::Next(Check { assignment, weights, extent }))
            }
        })
    }

    /// Takes in a part of a result that `check` has passed.
    ///
    /// # Errors
    /// What [`SlotTable::preview`](crate::lease::slots::SlotTable::preview) refuses: the lease may have ended meanwhile.
    pub fn take(
        &self,
        sender: ConnectionId,
        header: &PushHeader,
        check: &Check,
        part: ResultPart,
    ) -> Result<Ack, Refusal> {
        self.change(|shared| {
            let is_chunk = part.sequence().is_some();
            let ack = shared.table.take(sender, header, part)?;
            shared.chunks_accepted += u64::from(is_chunk && ack.state == AckState::Accepted);
            let Check { assignment, .. } = check;
            if let Work::Rollout(slot) = &*assignment.work
                && ack.lease_finished
                && assignment.courses.is_some()
            {
                shared.names.note_sender(assignment.actor, &slot.origin().environments);
            }
            Ok(ack)
        })
    }

    /// Logs and counts a refusal. If it was about a lease of the caller, the lease ends.
    pub fn refused(&self, caller: &Caller, lease: Option<LeaseId>, refusal: &Refusal) {
        // What a lease did before it ended, or under another learner, cannot end it again.
        let is_about_the_lease =
            !matches!(refusal.reason, Reason::UnknownLease | Reason::OtherIncarnation);
        self.change(|shared| {
            *shared.refusals.entry(refusal.reason.name().to_owned()).or_default() += 1;
            if let (Some(id), Reason::NotFinite) = (lease, refusal.reason) {
                shared.table.diverged(caller.connection, id, &refusal.detail);
            }
            let ended = if is_about_the_lease {
                shared.table.refuse(caller.connection, lease)
            } else {
                None
            };
            shared.notices.push(shared.names.refusal(caller, refusal, ended.as_ref()));
        });
    }
}
