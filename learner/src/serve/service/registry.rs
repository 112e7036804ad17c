//! The open connections. Connections with actors have one limit. Those without (probes, operators, unregistered peers)
//! have another; when it is reached, the oldest of them is closed to admit a new one. An address has a limit of
//! connections, too; a new one above it is refused.

use std::collections::BTreeMap;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use proto::{Reason, Refusal};
use tokio::sync::oneshot;

use crate::lease::slots::ConnectionId;

/// Most connections without an actor.
const WITHOUT_ACTOR: usize = 256;
/// Most connections of one address, so that one machine cannot use up all connections.
pub(super) const OF_ONE_ADDRESS: usize = 512;

/// The open connections of one listener.
#[derive(Debug)]
pub(super) struct Registry {
    most_with_actors: usize,
    open: Mutex<BTreeMap<ConnectionId, Open>>,
}

#[derive(Debug)]
struct Open {
    /// An IPv4-mapped IPv6 address counts as the IPv4 address.
    address: IpAddr,
    has_actor: bool,
    /// Dropped to close the connection.
    _close: oneshot::Sender<()>,
}

/// An admitted connection.
pub(super) struct Admission {
    /// Completes when the connection must close.
    pub(super) closed: oneshot::Receiver<()>,
    /// The connection that was closed to admit this one.
    pub(super) evicted: Option<ConnectionId>,
}

impl Registry {
    /// A registry that allows `most_with_actors` connections with actors.
    pub(super) fn new(most_with_actors: usize) -> Arc<Self> {
        Arc::new(Self { most_with_actors, open: Mutex::default() })
    }

    /// Adds a new connection of `address`; `None` if the address already has too many.
    pub(super) fn admit(&self, id: ConnectionId, address: IpAddr) -> Option<Admission> {
        let (close, closed) = oneshot::channel();
        let address = address.to_canonical();
        let mut open = self.lock();
        let of_address = open.values().filter(|open| open.address == address).count();
        if of_address >= OF_ONE_ADDRESS {
            return None;
        }
        let mut without = open.iter().filter(|(_, open)| !open.has_actor).map(|(id, _)| *id);
        let oldest = without.next();
        let full = without.count() + 1 >= WITHOUT_ACTOR;
        let evicted = oldest.filter(|_| full);
        evicted.map(|id| open.remove(&id));
        open.insert(id, Open { address, has_actor: false, _close: close });
        Some(Admission { closed, evicted })
    }

    /// Marks the connection as one with an actor.
    ///
    /// # Errors
    /// Too many connections have actors.
    pub(super) fn note_actor(&self, id: ConnectionId) -> Result<(), Refusal> {
        let mut open = self.lock();
        let with_actors = open.values().filter(|open| open.has_actor).count();
        let Some(own) = open.get_mut(&id) else {
            return Err(Refusal::new(Reason::Busy, "connection", "it is being closed"));
        };
        if !own.has_actor && with_actors >= self.most_with_actors {
            let most = self.most_with_actors;
            let detail =
                format!("{most} connections have actors (learner.connections); retry later");
            return Err(Refusal::new(Reason::Busy, "connection", detail));
        }
        own.has_actor = true;
        Ok(())
    }

    /// The connection closes.
    pub(super) fn remove(&self, id: ConnectionId) {
        self.lock().remove(&id);
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<ConnectionId, Open>> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn address(last: u8) -> IpAddr {
        IpAddr::from([10, 0, 0, last])
    }

    fn admit(registry: &Registry, id: u64) -> Admission {
        registry.admit(ConnectionId(id), address(1)).unwrap()
    }

    #[test]
    fn an_address_at_its_limit_gets_a_place_after_one_is_free_and_others_are_unaffected() {
        let registry = Registry::new(OF_ONE_ADDRESS);
        let mut admitted = Vec::new();
        for id in 0..OF_ONE_ADDRESS as u64 {
            admitted.push(admit(&registry, id));
            registry.note_actor(ConnectionId(id)).unwrap();
        }
        let mapped = "::ffff:10.0.0.1".parse().unwrap();
        assert!(registry.admit(ConnectionId(1000), mapped).is_none());
        assert!(registry.admit(ConnectionId(1001), address(2)).is_some());
        registry.remove(ConnectionId(7));
        assert!(registry.admit(ConnectionId(1002), mapped).is_some());
    }

    #[test]
    fn the_oldest_connection_without_an_actor_is_closed_and_those_with_actors_stay() {
        let registry = Registry::new(2);
        let mut admitted: Vec<_> =
            (0..WITHOUT_ACTOR as u64).map(|id| admit(&registry, id)).collect();
        assert!(admitted.iter().all(|admission| admission.evicted.is_none()));
        registry.note_actor(ConnectionId(0)).unwrap();
        // Connection 0 no longer counts as one without an actor.
        admitted.push(admit(&registry, 1000));
        let next = admit(&registry, 1001);
        assert_eq!(next.evicted, Some(ConnectionId(1)));
        assert_eq!(admitted[1].closed.try_recv(), Err(oneshot::error::TryRecvError::Closed));
        assert_eq!(registry.lock().len(), WITHOUT_ACTOR + 1);
    }

    #[test]
    fn actors_beyond_the_limit_are_rejected_until_one_disconnects() {
        let registry = Registry::new(1);
        let _admitted = [1, 2].map(|id| admit(&registry, id));
        registry.note_actor(ConnectionId(1)).unwrap();
        registry.note_actor(ConnectionId(1)).unwrap();
        let refusal = registry.note_actor(ConnectionId(2)).unwrap_err();
        assert_eq!((refusal.reason, refusal.field.as_str()), (Reason::Busy, "connection"));
        registry.remove(ConnectionId(1));
        registry.note_actor(ConnectionId(2)).unwrap();
    }
}
