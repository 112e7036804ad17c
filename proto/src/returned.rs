//! A lease that an actor returns because it cannot process it.

use crate::read::unknown;
use crate::refusal::truncated;
use crate::{ActorId, Incarnation, LeaseId, Refusal, wire};

/// A lease that its actor cannot process.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReturnedLease {
    /// The sender.
    pub actor: ActorId,
    /// Incarnation of the registration.
    pub incarnation: Incarnation,
    /// The lease.
    pub lease: LeaseId,
    /// What prevents its processing.
    pub failure: LeaseFailure,
    /// The cause, one line.
    pub detail: String,
}

/// What prevents an actor from processing a lease.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LeaseFailure {
    /// A start state of the lease cannot be restored.
    StartState,
    /// The environment failed or does not answer.
    Environment,
}

impl ReturnedLease {
    /// Converts to the message.
    #[must_use]
    pub fn to_wire(&self) -> wire::ReturnLeaseRequest {
        let failure = match self.failure {
            LeaseFailure::StartState => wire::LeaseFailure::StartState,
            LeaseFailure::Environment => wire::LeaseFailure::Environment,
        };
        wire::ReturnLeaseRequest {
            actor_id: self.actor.0,
            incarnation: self.incarnation.0,
            lease_id: self.lease.0,
            failure: failure.into(),
            detail: self.detail.clone(),
        }
    }

    /// Reads the message. Control characters of the cause are replaced, because it is logged.
    ///
    /// # Errors
    /// If the failure is unknown.
    pub fn from_wire(wire: &wire::ReturnLeaseRequest) -> Result<Self, Refusal> {
        let failure = match wire::LeaseFailure::try_from(wire.failure) {
            Ok(wire::LeaseFailure::StartState) => LeaseFailure::StartState,
            Ok(wire::LeaseFailure::Environment) => LeaseFailure::Environment,
            _ => return Err(unknown("failure", wire.failure)),
        };
        Ok(Self {
            actor: ActorId(wire.actor_id),
            incarnation: Incarnation(wire.incarnation),
            lease: LeaseId(wire.lease_id),
            failure,
            detail: truncated(&wire.detail),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_returned_lease_survives_the_round_trip_and_its_cause_becomes_one_line() {
        let returned = ReturnedLease {
            actor: ActorId(3),
            incarnation: Incarnation(4),
            lease: LeaseId(5),
            failure: LeaseFailure::StartState,
            detail: "no state".to_owned(),
        };
        let mut wire = returned.to_wire();
        assert_eq!(ReturnedLease::from_wire(&wire), Ok(returned.clone()));
        wire.detail = "no\n\tstate".to_owned();
        assert_eq!(ReturnedLease::from_wire(&wire), Ok(returned));
        wire.failure = 0;
        assert_eq!(ReturnedLease::from_wire(&wire).unwrap_err().field, "failure");
    }
}
