//! The learner of a cluster: it opens iterations, answers requests for work, takes chunks in and updates.

use std::time::Duration;

use learner::slots::{Effect, Incident, Offer, SlotRollout};
use proto::{
    Digest, Heartbeat, Lease, LeaseId, LeasedWork, PolicyVersion, PushHeader, RolloutWork,
    TrajectoryChunk, WeightsName, Work,
};

use super::actors::Actor;
use super::{Chunk, Cluster, Event, INCARNATION, Stage};
use crate::scenario::Duplicates;

/// A waiting request is repeated this long after the table's next deadline, as in the exchange.
const AFTER_DEADLINE: Duration = Duration::from_millis(1);
/// Actors that get nothing before the others need not ask: the only work that one actor gets and another does not is a
/// duplicate of that other's own slot, so two actors without work mean that there is none.
const REFUSALS: usize = 2;

impl Cluster {
    /// Tells the table the time.
    pub(super) fn tick(&mut self) {
        self.table.tick(self.now);
    }

    pub(super) fn open(&mut self) {
        self.tick();
        let iteration = self.iteration;
        let work = |slot| RolloutWork { iteration, slot, environments: Vec::new() };
        let weights = WeightsName { version: PolicyVersion(iteration), digest: Digest([0; 32]) };
        let slots = (0..self.scenario.slots).map(work).collect();
        self.table.open_iteration(iteration, weights, slots);
        (self.opened, self.free) = (self.now, u64::from(self.scenario.slots));
        self.settle();
    }

    /// Carries out what the table wants done.
    pub(super) fn settle(&mut self) {
        for incident in self.table.incidents() {
            let lost = match incident {
                Incident::Expired(lease) => vec![lease],
                Incident::Gone { leases, .. } => leases,
                Incident::Returned { lease, .. } => vec![lease],
                Incident::Quarantined { .. } => Vec::new(),
            };
            let slots = lost.iter().filter(|lease| matches!(lease.work, LeasedWork::Slot(_)));
            self.free += slots.count() as u64;
        }
        for effect in self.table.effects() {
            match effect {
                Effect::WorkFreed => self.wake(),
                Effect::Iteration(rollouts) => self.update(&rollouts),
                other => panic!("no actor gives a wrong result, but the table wants {other:?}"),
            }
        }
    }

    fn update(&mut self, rollouts: &[SlotRollout]) {
        self.totals.slots += rollouts.len() as u64;
        self.totals.rollouts += self.now - self.opened;
        self.at(self.now + self.scenario.update, Event::Updated);
    }

    /// All waiting requests are repeated.
    pub(super) fn wake(&mut self) {
        let calls = self.waiting.len();
        let (mut asked, mut refused) = (0, 0);
        while asked < calls && refused < REFUSALS {
            let Some(actor) = self.waiting.pop_front() else { break };
            asked += 1;
            refused += usize::from(!self.offer(actor));
        }
        self.locked(self.scenario.calls.request * (calls - asked) as u32);
    }

    /// End of calls that hold the table's lock for this long.
    fn locked(&mut self, length: Duration) -> Duration {
        self.totals.locked += length;
        self.lock.serve(self.now, length)
    }

    /// Answers a request for work, or lets it wait. Whether there was work.
    pub(super) fn offer(&mut self, actor: usize) -> bool {
        let answered = self.locked(self.scenario.calls.request);
        let Actor { id, connection, .. } = self.actors[actor];
        let offer = match self.scenario.duplicates == Duplicates::No && self.free == 0 {
            true => Offer::Nothing,
            false => self
                .table
                .lease(connection, id, INCARNATION)
                .expect("a registered actor with few leases"),
        };
        match offer {
            Offer::Lease(lease) => self.begin(actor, lease, answered),
            Offer::Nothing => {
                self.waiting.push_back(actor);
                self.expect_deadline();
                return false;
            }
            other => panic!("no actor does anything wrong, but gets {other:?}"),
        }
        true
    }

    fn expect_deadline(&mut self) {
        let Some(next) = self.table.next_deadline().map(|at| at + AFTER_DEADLINE) else { return };
        if self.deadline.is_none_or(|planned| next < planned) {
            self.deadline = Some(next);
            self.at(next, Event::Deadline);
        }
    }

    /// Moves a chunk into its next stage.
    pub(super) fn advance(&mut self, stage: &Stage, chunk: Chunk) {
        let now = self.now;
        let (next, time) = match stage {
            Stage::Link => (Stage::Cores, self.incoming.serve(now, self.scenario.network.chunk)),
            Stage::Cores => (Stage::Lock, self.cores.serve(now, self.scenario.check)),
            // The table is asked before and after the check.
            Stage::Lock => (Stage::Table, self.locked(self.scenario.calls.other * 2)),
            Stage::Table => return self.take_in(&chunk),
        };
        self.at(time, Event::Chunk(next, chunk));
    }

    fn take_in(&mut self, chunk: &Chunk) {
        let Chunk { actor, connection, ref lease, sequence } = *chunk;
        self.tick();
        let header = PushHeader::of(lease, digest(lease, sequence));
        let answer = self.table.chunk(connection, &header, content(sequence));
        if answer.is_ok_and(|ack| !ack.lease_finished) {
            return self.settle();
        }
        self.at(self.now + self.scenario.network.latency, Event::Ended(actor, lease.id));
        self.settle();
    }

    pub(super) fn beat(&mut self, index: usize, lease: LeaseId) {
        let actor = &self.actors[index];
        if !actor.open.contains(&lease) {
            return;
        }
        let beat = Heartbeat { actor: actor.id, incarnation: INCARNATION, lease, slot_step: 0 };
        let connection = actor.connection;
        self.locked(self.scenario.calls.other);
        self.tick();
        match self.table.heartbeat(connection, &beat) {
            Ok(true) => {
                self.at(self.now + self.scenario.lease.heartbeat, Event::Beat(index, lease))
            }
            _ => self.at(self.now + self.scenario.network.latency, Event::Ended(index, lease)),
        }
        self.settle();
    }
}

/// The digest that every actor computes for a chunk.
fn digest(lease: &Lease, sequence: u32) -> Digest {
    let Work::Rollout(work) = &lease.work else { panic!("the run has no evaluations") };
    let mut bytes = [0; 32];
    bytes[..8].copy_from_slice(&work.iteration.to_le_bytes());
    bytes[8..12].copy_from_slice(&work.slot.to_le_bytes());
    bytes[12..16].copy_from_slice(&sequence.to_le_bytes());
    Digest(bytes)
}

/// A chunk without data, which the table does not read.
fn content(sequence: u32) -> TrajectoryChunk {
    TrajectoryChunk {
        sequence,
        first_step: sequence,
        steps: 1,
        agents: Vec::new(),
        state: Vec::new(),
        reward: Vec::new(),
        terminated: Vec::new(),
        truncated: Vec::new(),
        finals: Vec::new(),
        end: None,
    }
}
