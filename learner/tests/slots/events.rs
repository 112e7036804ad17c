//! Events and messages of a simulated cluster.

use learner::lease::slots::{ConnectionId, Offer};
use proto::{ActorId, Heartbeat, Incarnation, Lease, LeaseId, ProcessId};

/// Number of actors.
pub(crate) const ACTORS: usize = 4;
/// Most messages in transit; further ones are lost.
pub(crate) const MOST_IN_FLIGHT: usize = 48;

/// The first two actors are connections of one process. The third names its process, and the last one does not.
pub(crate) fn process_of(actor: usize) -> Option<ProcessId> {
    [Some(ProcessId([1; 16])), Some(ProcessId([1; 16])), Some(ProcessId([2; 16])), None][actor]
}

/// An event. Numbers are indices of actors or of messages in transit.
#[derive(Clone, Debug)]
pub(crate) enum SimulatedEvent {
    /// An actor takes its next step: it requests work or sends a result.
    Act(usize),
    /// An actor sends a heartbeat.
    Heartbeat(usize),
    /// A message arrives; index 0 is the oldest.
    Arrive(usize),
    /// A message arrives and is duplicated.
    ArriveTwice(usize),
    /// A message is lost.
    Lose(usize),
    /// A message of an actor about its lease is refused.
    Refuse(usize),
    /// An actor is killed; its messages may still arrive.
    Kill(usize),
    /// An actor freezes; its connection stays open.
    Freeze(usize),
    /// A frozen actor continues.
    Thaw(usize),
    /// A killed actor is restarted on a new connection.
    Join(usize),
    /// The trainer takes a complete iteration and opens the next.
    Learn,
    /// The learner restarts and resumes with the open iteration.
    Restart,
    /// Time passes, in tenths of the time to live.
    Pass(u32),
}

/// Identifies a lease across restarts of the learner.
pub(crate) type LeaseKey = (Incarnation, LeaseId);

pub(crate) fn key(lease: &Lease) -> LeaseKey {
    (lease.incarnation, lease.id)
}

/// The content of a [`Packet`].
#[derive(Clone, Debug)]
pub(crate) enum Message {
    Ask(ActorId),
    Chunk(Lease, u32),
    Episode(Lease),
    Beat(Heartbeat),
    Offered(Offer),
    Acknowledged { lease: LeaseKey, sequence: u32, finished: bool },
    Ended(LeaseKey),
    Unknown,
}

/// A message to or from an actor. `actor` and `incarnation` are those of the actor when it was sent.
#[derive(Clone, Debug)]
pub(crate) struct Packet {
    pub(crate) index: usize,
    pub(crate) connection: ConnectionId,
    pub(crate) actor: ActorId,
    pub(crate) incarnation: Incarnation,
    pub(crate) message: Message,
}
