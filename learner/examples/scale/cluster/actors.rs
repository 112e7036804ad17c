//! The actors of a cluster: they register, fetch weights, step leases, and fail.

use std::time::Duration;

use learner::slots::{ConnectionId, Trust};
use policy::randomness::{Draw, Purpose, RunSeed, generator, standard_normal};
use proto::{ActorId, Lease, LeaseId, WeightsName};

use super::{Chunk, Cluster, Event, Stage};
use crate::scenario::Cores;

/// An actor.
pub(super) struct Actor {
    pub(super) id: ActorId,
    pub(super) connection: ConnectionId,
    /// Whether it waits for work.
    pub(super) asks: bool,
    /// The lease that it steps.
    stepping: Option<LeaseId>,
    /// Its leases whose end it has not learnt.
    pub(super) open: Vec<LeaseId>,
    /// The weights that it has.
    weights: Option<WeightsName>,
    /// How often it registered.
    starts: u64,
}

impl Cluster {
    /// An actor registers and asks for work.
    pub(super) fn start(&mut self, index: usize) {
        self.connections += 1;
        let connection = ConnectionId(self.connections);
        let id = self.table.register(connection, Trust::Exact, None);
        let starts = self.actors.get(index).map_or(0, |actor| actor.starts) + 1;
        let (open, weights) = (Vec::new(), None);
        let actor = Actor { id, connection, asks: false, stepping: None, open, weights, starts };
        match self.actors.get_mut(index) {
            Some(before) => *before = actor,
            None => self.actors.push(actor),
        }
        if let Some(mean) = self.scenario.failures.every {
            let time = time_to_failure(self.scenario.seed, index, starts, mean);
            self.fail_at(self.now + time, index);
        }
        self.ask(index);
    }

    /// Asks for work unless the actor asks already, steps, or has too many leases.
    fn ask(&mut self, index: usize) {
        let actor = &mut self.actors[index];
        if !actor.asks && actor.stepping.is_none() && actor.open.len() < self.scenario.leases {
            actor.asks = true;
            self.at(self.now + self.scenario.network.latency, Event::Ask(index));
        }
    }

    /// A lease is `answered`: the actor fetches weights that it does not have, and steps.
    pub(super) fn begin(&mut self, index: usize, lease: Lease, answered: Duration) {
        self.free = self.free.saturating_sub(1);
        let network = self.scenario.network;
        let actor = &mut self.actors[index];
        actor.asks = false;
        actor.stepping = Some(lease.id);
        actor.open.push(lease.id);
        let mut ready = answered + network.latency;
        if actor.weights.replace(lease.weights) != Some(lease.weights) {
            let requested = ready + network.latency;
            ready = self.outgoing.serve(requested, network.weights) + network.latency;
        }
        self.at(answered + self.scenario.lease.heartbeat, Event::Beat(index, lease.id));
        self.at(ready, Event::Step(index, lease, 0));
    }

    pub(super) fn step(&mut self, index: usize, lease: Lease, sequence: u32) {
        if self.actors[index].stepping != Some(lease.id) {
            return;
        }
        let slow = self.scenario.slow;
        let factor = if slow.contain(index) { slow.factor } else { 1 };
        let length = self.scenario.step * factor;
        let end = match self.scenario.cores {
            Cores::Own(_) => self.now + length,
            Cores::Shared(_) => self.cores.serve(self.now, length),
        };
        self.totals.busy += length;
        self.at(end, Event::Stepped(index, lease, sequence));
    }

    pub(super) fn stepped(&mut self, index: usize, lease: Lease, sequence: u32) {
        let actor = &mut self.actors[index];
        if actor.stepping != Some(lease.id) {
            return;
        }
        let connection = actor.connection;
        let chunk = Chunk { actor: index, connection, lease: lease.clone(), sequence };
        let arrival = self.now + self.scenario.network.latency;
        self.at(arrival, Event::Chunk(Stage::Link, chunk));
        if sequence + 1 < self.scenario.chunks {
            return self.step(index, lease, sequence + 1);
        }
        self.actors[index].stepping = None;
        self.ask(index);
    }

    /// The actor stops what it does for the lease.
    pub(super) fn ended(&mut self, index: usize, lease: LeaseId) {
        let actor = &mut self.actors[index];
        if !actor.open.contains(&lease) {
            // Its machine has failed since then.
            return;
        }
        actor.open.retain(|open| *open != lease);
        actor.stepping = actor.stepping.filter(|stepping| *stepping != lease);
        self.ask(index);
    }

    /// The machine of an actor fails, without a message to the learner.
    pub(super) fn fail(&mut self, index: usize) {
        let failures = self.scenario.failures;
        let actor = &mut self.actors[index];
        (actor.asks, actor.stepping) = (false, None);
        actor.open.clear();
        let connection = actor.connection;
        self.waiting.retain(|waiting| *waiting != index);
        self.totals.failures += 1;
        self.totals.away += failures.away;
        self.at(self.now + failures.silent, Event::Disconnect(connection));
        self.at(self.now + failures.away, Event::Return(index));
    }
}

/// Exponentially distributed with this mean: half the sum of two squared normal numbers. The draw's key is the actor and
/// how often it has started.
fn time_to_failure(seed: u64, actor: usize, starts: u64, mean: Duration) -> Duration {
    let key = Draw::of(Purpose::Probe).environment(actor as u32).iteration(starts);
    let mut rng = generator(RunSeed(seed), key);
    let mut square = || {
        let number = f64::from(standard_normal(&mut rng));
        number * number
    };
    mean.mul_f64((square() + square()) / 2.0)
}
