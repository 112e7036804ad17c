//! What is simulated: the costs of one run on one cluster, in seconds and bytes.

use std::time::Duration;

/// A run on a cluster.
#[derive(Clone, Debug)]
pub(crate) struct Scenario {
    /// Seed of all random draws.
    pub(crate) seed: u64,
    /// Actors, each on a machine and a connection of its own.
    pub(crate) actors: usize,
    /// Leases that an actor has at a time: with two it steps the next one while the last chunk of the previous one is
    /// acknowledged.
    pub(crate) leases: usize,
    /// Slots of an iteration.
    pub(crate) slots: u32,
    /// Chunks of a slot.
    pub(crate) chunks: u32,
    /// Processor time in which a typical actor computes a chunk.
    pub(crate) step: Duration,
    /// Duration of an update, from the last chunk to the opening of the next iteration.
    pub(crate) update: Duration,
    /// Processors of the learner.
    pub(crate) cores: Cores,
    /// Processor time in which the learner receives and checks a chunk.
    pub(crate) check: Duration,
    /// Calls of the slot table.
    pub(crate) calls: Calls,
    /// The network between actors and learner.
    pub(crate) network: Network,
    /// When leases end.
    pub(crate) lease: LeaseTimes,
    /// Whether the learner leases slots a second time.
    pub(crate) duplicates: Duplicates,
    /// Slow machines.
    pub(crate) slow: SlowMachines,
    /// Failures of machines.
    pub(crate) failures: Failures,
}

/// Processors of the learner.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Cores {
    /// Every actor has a core, and the learner has this many.
    Own(usize),
    /// Actors and learner share this many.
    Shared(usize),
}

/// Durations of calls of the slot table, which hold its lock.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Calls {
    /// A request for work.
    pub(crate) request: Duration,
    /// Any other: before and after the check of a chunk, and for a heartbeat.
    pub(crate) other: Duration,
}

/// The network between actors and learner.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Network {
    /// Time of a message from one side to the other.
    pub(crate) latency: Duration,
    /// Time of a chunk in the learner's incoming link.
    pub(crate) chunk: Duration,
    /// Time of the weights in its outgoing link.
    pub(crate) weights: Duration,
}

/// When leases end.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LeaseTimes {
    /// Time to live without a message.
    pub(crate) ttl: Duration,
    /// Interval of heartbeats.
    pub(crate) heartbeat: Duration,
}

/// Slots that are computed twice.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Duplicates {
    /// None.
    No,
    /// Backups of slow slots, and audits of this share of the slots.
    BackupsAndAudits(f64),
}

/// Machines that compute more slowly than others.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SlowMachines {
    /// Share of the actors, spread evenly.
    pub(crate) share: f64,
    /// Their time for a step, in times of a typical one.
    pub(crate) factor: u32,
}

/// Failures of an actor's machine, independent of each other.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Failures {
    /// Mean time from start to failure; `None` if none fail.
    pub(crate) every: Option<Duration>,
    /// Time from a failure until the actor registers again.
    pub(crate) away: Duration,
    /// Time from a failure until the learner sees the connection closed.
    pub(crate) silent: Duration,
}

impl SlowMachines {
    /// Whether the machine at this index is slow.
    pub(crate) fn contain(self, index: usize) -> bool {
        let before = |index: usize| (index as f64 * self.share + 0.5).floor();
        before(index + 1) > before(index)
    }
}
