//! Registered actors: on which connection they live, whether their numbers can be compared, and how often
//! they were refused of late.

use std::collections::BTreeMap;
use std::time::Duration;

use proto::{ActorId, Reason, Refusal};

/// Leases one actor may hold at a time.
const MOST_LEASES: usize = 4;
/// Actors of one connection. A client that registers over and over must not fill the memory.
const MOST_PER_CONNECTION: usize = 16;
/// Refusals in a row after which an actor gets no work for a while.
const STRIKES: u32 = 3;
/// The pause doubles with each further refusal, this many times at most.
const MOST_DOUBLINGS: u32 = 5;

/// One connection to the service.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ConnectionId(pub u64);

/// Whether an actor promises the same bits as the others.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Trust {
    /// It gave the run's fingerprint.
    Exact,
    /// It gave none: its results are not compared with anybody's, and the run is not exactly repeatable.
    Foreign,
}

/// Whether an actor may get work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Admission {
    /// It may.
    Welcome,
    /// Not before this time has passed.
    Quarantined(Duration),
}

#[derive(Debug)]
struct Actor {
    connection: ConnectionId,
    trust: Trust,
    strikes: u32,
    quarantined_until: Duration,
}

/// The registered actors.
#[derive(Debug)]
pub(super) struct Actors {
    pause: Duration,
    last: u64,
    /// Registrations of foreign actors so far.
    pub(super) foreign: u64,
    registered: BTreeMap<ActorId, Actor>,
}

impl Actors {
    /// The first quarantine of an actor lasts `pause`.
    pub(super) fn new(pause: Duration) -> Self {
        Self { pause, last: 0, foreign: 0, registered: BTreeMap::new() }
    }

    pub(super) fn register(&mut self, connection: ConnectionId, trust: Trust) -> ActorId {
        self.last += 1;
        self.foreign += u64::from(trust == Trust::Foreign);
        let actor = Actor { connection, trust, strikes: 0, quarantined_until: Duration::ZERO };
        self.registered.insert(ActorId(self.last), actor);
        ActorId(self.last)
    }

    /// The actor that must go before one more fits on the connection.
    pub(super) fn make_room(&mut self, connection: ConnectionId) -> Vec<ActorId> {
        let on_it = |actor: &&Actor| actor.connection == connection;
        if self.registered.values().filter(on_it).count() < MOST_PER_CONNECTION {
            return Vec::new();
        }
        let first = self.registered.iter().find(|(_, actor)| on_it(actor)).map(|(id, _)| *id);
        self.registered.retain(|id, _| Some(*id) != first);
        first.into_iter().collect()
    }

    /// The actors that are gone with the connection.
    pub(super) fn disconnect(&mut self, connection: ConnectionId) -> Vec<ActorId> {
        let of_it =
            |(id, actor): (&ActorId, &Actor)| (actor.connection == connection).then_some(*id);
        let gone = self.registered.iter().filter_map(of_it).collect::<Vec<_>>();
        self.registered.retain(|_, actor| actor.connection != connection);
        gone
    }

    pub(super) fn known(&self, id: ActorId) -> Result<(), Refusal> {
        self.find(id).map(|_| ())
    }

    pub(super) fn admit(
        &self,
        id: ActorId,
        leases: usize,
        now: Duration,
    ) -> Result<Admission, Refusal> {
        let actor = self.find(id)?;
        if leases >= MOST_LEASES {
            let detail = format!("actor {id} holds {leases} leases, {MOST_LEASES} are allowed");
            return Err(Refusal::new(Reason::TooManyLeases, "actor_id", detail));
        }
        let wait = actor.quarantined_until.saturating_sub(now);
        Ok(if wait.is_zero() { Admission::Welcome } else { Admission::Quarantined(wait) })
    }

    fn find(&self, id: ActorId) -> Result<&Actor, Refusal> {
        self.registered.get(&id).ok_or_else(|| {
            let detail = format!("actor {id} is not registered, or its connection has closed");
            Refusal::new(Reason::UnknownActor, "actor_id", detail)
        })
    }

    pub(super) fn trust(&self, id: ActorId) -> Result<Trust, Refusal> {
        self.find(id).map(|actor| actor.trust)
    }

    pub(super) fn finished(&mut self, id: ActorId) {
        if let Some(actor) = self.registered.get_mut(&id) {
            actor.strikes = 0;
        }
    }

    /// Counts a refusal; the pause, if the actor gets no work for a while now.
    pub(super) fn strike(&mut self, id: ActorId, now: Duration) -> Option<Duration> {
        let actor = self.registered.get_mut(&id)?;
        actor.strikes += 1;
        let doublings = actor.strikes.checked_sub(STRIKES)?;
        let pause = self.pause * 2_u32.pow(doublings.min(MOST_DOUBLINGS));
        actor.quarantined_until = now + pause;
        Some(pause)
    }

    pub(super) fn count(&self) -> usize {
        self.registered.len()
    }
}
