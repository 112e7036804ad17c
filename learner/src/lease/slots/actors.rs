//! Registered actors: their connection, whether their results can be compared, and how many of their latest messages
//! were refused.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use proto::{ActorId, ProcessId, Reason, Refusal};

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

/// A registered actor and its connection. Only messages over this connection count as the actor's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Owner {
    pub(super) actor: ActorId,
    pub(super) connection: ConnectionId,
    pub(super) process: Process,
    pub(super) trust: Trust,
}

impl Owner {
    /// Whether both actors belong to one process; its results do not confirm each other.
    pub(super) fn shares_process(&self, other: &Self) -> bool {
        self.connection == other.connection || self.process == other.process
    }
}

/// The process of an actor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Process {
    /// The id that the actor sent.
    Named(ProcessId),
    /// No id was sent; the connection counts as a process.
    Connection(ConnectionId),
}

/// Whether an actor promises the same bits as the others.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Trust {
    /// It gave the run's fingerprint.
    Exact,
    /// It gave none: its results are not compared with others, and the run is not exactly repeatable.
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
    process: Process,
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
    /// The actors of each connection that has any.
    connected: BTreeMap<ConnectionId, BTreeSet<ActorId>>,
    /// How many exact actors each process has, if any.
    exact: BTreeMap<Process, usize>,
}

impl Actors {
    /// The first quarantine of an actor lasts `pause`.
    pub(super) fn new(pause: Duration) -> Self {
        Self {
            pause,
            last: 0,
            foreign: 0,
            registered: BTreeMap::new(),
            connected: BTreeMap::new(),
            exact: BTreeMap::new(),
        }
    }

    pub(super) fn register(
        &mut self,
        connection: ConnectionId,
        trust: Trust,
        process: Option<ProcessId>,
    ) -> ActorId {
        let process = process.map_or(Process::Connection(connection), Process::Named);
        self.last += 1;
        self.foreign += u64::from(trust == Trust::Foreign);
        let quarantined_until = Duration::ZERO;
        let actor = Actor { connection, process, trust, strikes: 0, quarantined_until };
        let id = ActorId(self.last);
        self.registered.insert(id, actor);
        self.connected.entry(connection).or_default().insert(id);
        if trust == Trust::Exact {
            *self.exact.entry(process).or_default() += 1;
        }
        id
    }

    /// The actor that must go before one more fits on the connection.
    pub(super) fn make_room(&mut self, connection: ConnectionId) -> Vec<ActorId> {
        let on_it = self.connected.get(&connection);
        let full = on_it.filter(|actors| actors.len() >= MOST_PER_CONNECTION);
        let first = full.and_then(BTreeSet::first).copied();
        first.into_iter().inspect(|id| self.remove(*id)).collect()
    }

    /// The actors that are gone with the connection.
    pub(super) fn disconnect(&mut self, connection: ConnectionId) -> Vec<ActorId> {
        let gone = self.of(connection);
        gone.iter().for_each(|id| self.remove(*id));
        gone
    }

    fn remove(&mut self, id: ActorId) {
        let Some(actor) = self.registered.remove(&id) else { return };
        let Actor { connection, process, trust, .. } = actor;
        if let Some(actors) = self.connected.get_mut(&connection) {
            actors.remove(&id);
            if actors.is_empty() {
                self.connected.remove(&connection);
            }
        }
        if trust == Trust::Exact
            && let Some(count) = self.exact.get_mut(&process)
        {
            *count -= 1;
            if *count == 0 {
                self.exact.remove(&process);
            }
        }
    }

    /// The actor, if it registered on this connection.
    pub(super) fn owner(&self, sender: ConnectionId, id: ActorId) -> Result<Owner, Refusal> {
        let actor = self.find(sender, id)?;
        let Actor { process, trust, .. } = *actor;
        Ok(Owner { actor: id, connection: sender, process, trust })
    }

    /// Whether any actor registered on this connection.
    pub(super) fn has(&self, connection: ConnectionId) -> bool {
        self.connected.contains_key(&connection)
    }

    /// Whether exact actors of two or more processes registered.
    pub(super) fn can_audit(&self) -> bool {
        self.exact.len() >= 2
    }

    pub(super) fn admit(
        &self,
        owner: Owner,
        leases: usize,
        now: Duration,
    ) -> Result<Admission, Refusal> {
        let id = owner.actor;
        let actor = self.find(owner.connection, id)?;
        if leases >= MOST_LEASES {
            let detail = format!("actor {id} holds {leases} leases, {MOST_LEASES} are allowed");
            return Err(Refusal::new(Reason::TooManyLeases, "actor_id", detail));
        }
        let wait = actor.quarantined_until.saturating_sub(now);
        Ok(if wait.is_zero() { Admission::Welcome } else { Admission::Quarantined(wait) })
    }

    fn find(&self, sender: ConnectionId, id: ActorId) -> Result<&Actor, Refusal> {
        let own = self.registered.get(&id).filter(|actor| actor.connection == sender);
        own.ok_or_else(|| {
            let detail = format!("actor {id} is not registered on this connection");
            Refusal::new(Reason::UnknownActor, "actor_id", detail)
        })
    }

    /// The actors of a connection.
    pub(super) fn of(&self, connection: ConnectionId) -> Vec<ActorId> {
        self.connected.get(&connection).into_iter().flatten().copied().collect()
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

    /// The process of each registered actor.
    pub(super) fn processes(&self) -> impl Iterator<Item = Process> {
        self.registered.values().map(|actor| actor.process)
    }

    pub(super) fn count(&self) -> usize {
        self.registered.len()
    }
}
