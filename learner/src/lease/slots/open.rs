//! The open leases, and the indexes by which they are found and counted without a look at all of them: by deadline, by
//! actor and by process.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use proto::{ActorId, LeaseId};

use super::actors::Process;
use super::leases::OpenLease;

/// The open leases by id.
#[derive(Debug, Default)]
pub(super) struct OpenLeases {
    leases: BTreeMap<LeaseId, OpenLease>,
    /// All leases, ordered by deadline.
    deadlines: BTreeSet<(Duration, LeaseId)>,
    /// All leases, by actor.
    owned: BTreeSet<(ActorId, LeaseId)>,
    /// How many leases each process holds, if any.
    held: BTreeMap<Process, usize>,
}

impl OpenLeases {
    pub(super) fn insert(&mut self, id: LeaseId, lease: OpenLease) {
        self.deadlines.insert((lease.deadline, id));
        self.owned.insert((lease.owner.actor, id));
        *self.held.entry(lease.owner.process).or_default() += 1;
        self.leases.insert(id, lease);
    }

    pub(super) fn remove(&mut self, id: LeaseId) -> Option<OpenLease> {
        let lease = self.leases.remove(&id)?;
        self.deadlines.remove(&(lease.deadline, id));
        self.owned.remove(&(lease.owner.actor, id));
        if let Some(held) = self.held.get_mut(&lease.owner.process) {
            *held -= 1;
            if *held == 0 {
                self.held.remove(&lease.owner.process);
            }
        }
        Some(lease)
    }

    /// Leases of this process.
    pub(super) fn held_by(&self, process: Process) -> usize {
        self.held.get(&process).copied().unwrap_or(0)
    }

    /// Processes that hold a lease.
    pub(super) fn holders(&self) -> usize {
        self.held.len()
    }

    pub(super) fn get(&self, id: LeaseId) -> Option<&OpenLease> {
        self.leases.get(&id)
    }

    /// Changes a lease, which keeps its owner. Returns the result of `change`; `None` if there is no such lease.
    pub(super) fn change<T>(
        &mut self,
        id: LeaseId,
        change: impl FnOnce(&mut OpenLease) -> T,
    ) -> Option<T> {
        let lease = self.leases.get_mut(&id)?;
        let before = lease.deadline;
        let result = change(lease);
        if lease.deadline != before {
            self.deadlines.remove(&(before, id));
            self.deadlines.insert((lease.deadline, id));
        }
        Some(result)
    }

    /// Ends the leases that `ends` covers. Looks at all of them.
    pub(super) fn end(&mut self, ends: impl Fn(&OpenLease) -> bool) {
        let ended = self.iter().filter(|(_, lease)| ends(lease)).map(|(id, _)| id);
        let ended = ended.collect::<Vec<_>>();
        ended.into_iter().for_each(|id| drop(self.remove(id)));
    }

    /// The leases past their deadline, the oldest first.
    pub(super) fn expired(&self, now: Duration) -> Vec<LeaseId> {
        let over = self.deadlines.iter().take_while(|(deadline, _)| *deadline <= now);
        let mut over = over.map(|(_, id)| *id).collect::<Vec<_>>();
        over.sort_unstable();
        over
    }

    /// When the next lease ends.
    pub(super) fn first_deadline(&self) -> Option<Duration> {
        self.deadlines.first().map(|(deadline, _)| *deadline)
    }

    /// The actor's leases, the oldest first.
    pub(super) fn of(&self, actor: ActorId) -> impl Iterator<Item = (LeaseId, &OpenLease)> {
        let own = self.owned.range((actor, LeaseId(0))..=(actor, LeaseId(u64::MAX)));
        own.map(|(_, id)| (*id, &self.leases[id]))
    }

    /// All leases, the oldest first.
    pub(super) fn iter(&self) -> impl Iterator<Item = (LeaseId, &OpenLease)> {
        self.leases.iter().map(|(id, lease)| (*id, lease))
    }

    pub(super) fn len(&self) -> usize {
        self.leases.len()
    }
}
