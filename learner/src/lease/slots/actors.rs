//! Registered actors: their connection, whether their results can be compared, and how many of their latest messages
//! were refused and leases expired.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use proto::{ActorId, ProcessId, Reason, Refusal};

use super::processes::Processes;

/// Leases one actor may hold at a time.
const MOST_LEASES: usize = 4;
/// Actors of one connection. A client that registers over and over must not fill the memory.
const MOST_PER_CONNECTION: usize = 16;
/// Refusals and expiries in a row after which an actor gets no work for a while.
const STRIKES: u32 = 3;
/// The pause doubles with each further one, this many times at most.
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

/// The process of an actor: the same for all actors of a connection.
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

#[derive(Debug)]
struct Actor {
    connection: ConnectionId,
    process: Process,
    trust: Trust,
    strikes: u32,
    quarantined_until: Duration,
    /// When the latest expiry of a lease counted.
    expired: Option<Duration>,
    /// Whether any of its results was accepted.
    counted: bool,
}

/// The registered actors.
#[derive(Debug)]
pub(super) struct Actors {
    pause: Duration,
    last: u64,
    /// Foreign actors so far of which a result was accepted.
    pub(super) foreign: u64,
    pub(super) processes: Processes,
    registered: BTreeMap<ActorId, Actor>,
    /// The actors of each connection that has any.
    connected: BTreeMap<ConnectionId, BTreeSet<ActorId>>,
}

impl Actors {
    /// The first quarantine of an actor lasts `pause`.
    pub(super) fn new(pause: Duration) -> Self {
        Self {
            pause,
            last: 0,
            foreign: 0,
            processes: Processes::default(),
            registered: BTreeMap::new(),
            connected: BTreeMap::new(),
        }
    }

    pub(super) fn register(
        &mut self,
        connection: ConnectionId,
        trust: Trust,
        process: Option<ProcessId>,
        now: Duration,
    ) -> ActorId {
        // A connection has one process, whatever ids its later registrations give.
        let first = self.connected.get(&connection).and_then(BTreeSet::first);
        let process = first.and_then(|id| self.registered.get(id)).map_or_else(
            || process.map_or(Process::Connection(connection), Process::Named),
            |actor| actor.process,
        );
        self.last += 1;
        let actor = Actor {
            connection,
            process,
            trust,
            strikes: 0,
            quarantined_until: Duration::ZERO,
            expired: None,
            counted: false,
        };
        let id = ActorId(self.last);
        self.registered.insert(id, actor);
        self.connected.entry(connection).or_default().insert(id);
        self.processes.join(process, trust, now);
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
        self.processes.leave(process, trust);
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

    /// How long an actor that holds so many leases gets no work; zero outside of quarantine.
    pub(super) fn quarantine(
        &self,
        owner: Owner,
        leases: usize,
        now: Duration,
    ) -> Result<Duration, Refusal> {
        let id = owner.actor;
        let actor = self.find(owner.connection, id)?;
        if leases >= MOST_LEASES {
            let detail = format!("actor {id} holds {leases} leases, {MOST_LEASES} are allowed");
            return Err(Refusal::new(Reason::TooManyLeases, "actor_id", detail));
        }
        Ok(actor.quarantined_until.saturating_sub(now))
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

    /// A lease of the actor ended with its result.
    pub(super) fn finished(&mut self, owner: Owner) {
        self.processes.finished(owner.process);
        if let Some(actor) = self.registered.get_mut(&owner.actor) {
            actor.strikes = 0;
        }
    }

    /// A result of the actor was accepted.
    pub(super) fn counted(&mut self, owner: Owner) {
        if owner.trust == Trust::Foreign
            && let Some(actor) = self.registered.get_mut(&owner.actor)
        {
            self.foreign += u64::from(!actor.counted);
            actor.counted = true;
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

    /// Counts the expiry of a lease that began at `begun`, as [`Self::strike`] counts a refusal. Leases that were held
    /// at the same time count once: a machine that slept lets all of them expire.
    pub(super) fn expired(
        &mut self,
        owner: Owner,
        begun: Duration,
        now: Duration,
    ) -> Option<Duration> {
        self.processes.lost(owner.process);
        let actor = self.registered.get_mut(&owner.actor)?;
        if actor.expired.is_some_and(|latest| begun < latest) {
            return None;
        }
        actor.expired = Some(now);
        self.strike(owner.actor, now)
    }

    pub(super) fn count(&self) -> usize {
        self.registered.len()
    }

    /// How many gave the run's fingerprint.
    pub(super) fn count_exact(&self) -> usize {
        self.registered.values().filter(|actor| actor.trust == Trust::Exact).count()
    }
}
