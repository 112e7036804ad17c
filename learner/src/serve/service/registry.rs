//! The open connections. Connections with actors have one limit. Those without (probes, viewers, unregistered peers)
//! have another; when it is reached, the oldest of them is closed to admit a new one.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use proto::{Reason, Refusal};
use tokio::sync::oneshot;

use crate::slots::ConnectionId;

/// Most connections without an actor.
const WITHOUT_ACTOR: usize = 256;

/// The open connections of one listener.
#[derive(Debug)]
pub(super) struct Registry {
    most_with_actors: usize,
    open: Mutex<BTreeMap<ConnectionId, Open>>,
}

#[derive(Debug)]
struct Open {
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

    /// Adds a new connection.
    pub(super) fn admit(&self, id: ConnectionId) -> Admission {
        let (close, closed) = oneshot::channel();
        let mut open = self.lock();
        let mut without = open.iter().filter(|(_, open)| !open.has_actor).map(|(id, _)| *id);
        let oldest = without.next();
        let full = without.count() + 1 >= WITHOUT_ACTOR;
        let evicted = oldest.filter(|_| full);
        evicted.map(|id| open.remove(&id));
        open.insert(id, Open { has_actor: false, _close: close });
        Admission { closed, evicted }
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

    #[test]
    fn the_oldest_connection_without_an_actor_is_closed_and_those_with_actors_stay() {
        let registry = Registry::new(2);
        let mut admitted = Vec::new();
        for id in 0..WITHOUT_ACTOR as u64 {
            let admission = registry.admit(ConnectionId(id));
            assert_eq!(admission.evicted, None);
            admitted.push(admission);
        }
        registry.note_actor(ConnectionId(0)).unwrap();
        // Connection 0 no longer counts as one without an actor.
        admitted.push(registry.admit(ConnectionId(1000)));
        let next = registry.admit(ConnectionId(1001));
        assert_eq!(next.evicted, Some(ConnectionId(1)));
        assert!(
            admitted[1].closed.try_recv().is_err_and(|e| e == oneshot::error::TryRecvError::Closed)
        );
        assert_eq!(registry.lock().len(), WITHOUT_ACTOR + 1);
    }

    #[test]
    fn actors_beyond_the_limit_are_rejected_until_one_disconnects() {
        let registry = Registry::new(1);
        let _admitted = [1, 2].map(|id| registry.admit(ConnectionId(id)));
        registry.note_actor(ConnectionId(1)).unwrap();
        registry.note_actor(ConnectionId(1)).unwrap();
        let refusal = registry.note_actor(ConnectionId(2)).unwrap_err();
        assert_eq!((refusal.reason, refusal.field.as_str()), (Reason::Busy, "connection"));
        registry.remove(ConnectionId(1));
        registry.note_actor(ConnectionId(2)).unwrap();
    }
}
