//! The measured costs, and the scenarios that follow from them.
//!
//! `cargo bench -p s2mia -- sizing traffic leases load` measures them.

use std::time::Duration;

use crate::scenario::{
    Calls, Cores, Duplicates, Failures, LeaseTimes, Network, Scenario, SlowMachines,
};

/// Costs of a task.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Task {
    /// Name in tables.
    pub(crate) name: &'static str,
    /// Environment steps per second of an actor core; section `sizing`.
    pub(crate) rate: f64,
    /// Processor seconds of an update, for each environment step; section `sizing`.
    pub(crate) update_secs: f64,
    /// Bytes of the chunks, for each environment step; section `traffic`.
    pub(crate) bytes: f64,
    /// The same with the observations that the learner restores; section `traffic`.
    pub(crate) restored_bytes: f64,
    /// Bytes of the weights; section `traffic`.
    pub(crate) weights: f64,
}

/// The tasks with preset `harl` and `mlp`. A slow simulator is one that needs 10 ms for an environment step.
pub(crate) const TASKS: [Task; 3] = [
    Task {
        name: "halfcheetah-6x1",
        rate: 6_300.0,
        update_secs: 2.47 / 4_000.0,
        bytes: 219.0,
        restored_bytes: 682.0,
        weights: 899_056.0,
    },
    Task {
        name: "ant-4x2",
        rate: 4_700.0,
        update_secs: 0.86 / 4_000.0,
        bytes: 967.0,
        restored_bytes: 2_354.0,
        weights: 792_832.0,
    },
    Task {
        name: "ant-4x2, slow simulator",
        rate: 100.0,
        update_secs: 0.86 / 4_000.0,
        bytes: 967.0,
        restored_bytes: 2_354.0,
        weights: 792_832.0,
    },
];

/// Environment steps of a slot: 1 environment x 200 steps.
pub(crate) const SLOT_STEPS: f64 = 200.0;
/// Chunks of a slot: 50 steps each.
const CHUNKS: u32 = 4;
/// The learner's processor seconds for a byte of a chunk with all observations: section `load`.
const CHECK_SECS_PER_BYTE: f64 = 14e-9;
/// Seconds of a request for work and of another call of the slot table with 10,000 leases; section `leases`.
const CALL_SECS: (f64, f64) = (0.13e-6, 0.16e-6);
/// Bytes per second of the learner's network, each way: 10 Gbit/s.
const NETWORK_BYTES_PER_SEC: f64 = 1.25e9;
/// One way between two machines of a data centre, seconds.
const LATENCY_SECS: f64 = 0.25e-3;
/// Share of an update that runs on one thread (docs/PERFORMANCE.md).
const SERIAL_SHARE: f64 = 0.01;
/// Default of `audit.share`.
const AUDIT_SHARE: f64 = 0.01;
const LEASE: LeaseTimes =
    LeaseTimes { ttl: Duration::from_secs(20), heartbeat: Duration::from_secs(5) };

/// No machine fails.
pub(crate) const NO_FAILURES: Failures =
    Failures { every: None, away: Duration::ZERO, silent: Duration::ZERO };
/// All machines are equal.
pub(crate) const EQUAL_MACHINES: SlowMachines = SlowMachines { share: 0.0, factor: 1 };

/// A learner with this many threads, and this many actors with two slots each, at least 20 slots.
pub(crate) fn scenario(task: &Task, threads: usize, actors: usize) -> Scenario {
    let slots = 2 * actors.max(10);
    let steps = SLOT_STEPS / f64::from(CHUNKS);
    let speed_up = 1.0 / (SERIAL_SHARE + (1.0 - SERIAL_SHARE) / threads as f64);
    let secs = Duration::from_secs_f64;
    Scenario {
        seed: 1,
        actors,
        leases: 2,
        slots: slots as u32,
        chunks: CHUNKS,
        step: secs(steps / task.rate),
        update: secs(task.update_secs * SLOT_STEPS * slots as f64 / speed_up),
        cores: Cores::Own(threads),
        check: secs(steps * task.restored_bytes * CHECK_SECS_PER_BYTE),
        calls: calls(),
        network: Network {
            latency: secs(LATENCY_SECS),
            chunk: secs(steps * task.bytes / NETWORK_BYTES_PER_SEC),
            weights: secs(task.weights / NETWORK_BYTES_PER_SEC),
        },
        lease: LEASE,
        duplicates: Duplicates::BackupsAndAudits(AUDIT_SHARE),
        slow: EQUAL_MACHINES,
        failures: NO_FAILURES,
    }
}

fn calls() -> Calls {
    let secs = Duration::from_secs_f64;
    Calls { request: secs(CALL_SECS.0), other: secs(CALL_SECS.1) }
}

/// 5 % of the machines take three times as long.
pub(crate) const SLOW_MACHINES: SlowMachines = SlowMachines { share: 0.05, factor: 3 };

/// A machine fails once a day without a word, and is back after five minutes. Its connection closes when it has not
/// answered a keepalive ping.
pub(crate) const DAILY_FAILURES: Failures = Failures {
    every: Some(Duration::from_secs(24 * 3600)),
    away: Duration::from_secs(300),
    silent: Duration::from_secs(30),
};

/// A preemptible machine: it is taken away once an hour, with a signal that ends the actor, and another takes its place
/// after two minutes.
pub(crate) const PREEMPTIBLE: Failures = Failures {
    every: Some(Duration::from_secs(3600)),
    away: Duration::from_secs(120),
    silent: Duration::ZERO,
};

/// The load test (`benches/speed/load.rs`): 256 slots of 200 steps, computed on the learner's two cores by actors that do
/// not step, have one lease at a time, and fetch no weights.
pub(crate) mod load {
    use super::*;

    /// Numbers of actors.
    pub(crate) const ACTORS: [usize; 5] = [1, 4, 16, 64, 256];
    /// Slots of an iteration.
    pub(crate) const SLOTS: u32 = 256;
    /// Environment steps of a slot.
    pub(crate) const STEPS: f64 = 200.0;
    /// An actor's processor seconds for a slot.
    const ACTOR_SECS: f64 = 0.29e-3;
    /// The learner's processor seconds for a slot.
    const LEARNER_SECS: f64 = 0.88e-3;
    /// Time between two processes in which no processor works for them, seconds.
    const LATENCY_SECS: f64 = 0.19e-3;
    /// Duration of the update, seconds.
    const UPDATE_SECS: f64 = 0.43;

    /// The load test with this many actors.
    pub(crate) fn scenario(actors: usize) -> Scenario {
        let secs = Duration::from_secs_f64;
        Scenario {
            seed: 1,
            actors,
            leases: 1,
            slots: SLOTS,
            chunks: CHUNKS,
            step: secs(ACTOR_SECS / f64::from(CHUNKS)),
            update: secs(UPDATE_SECS),
            cores: Cores::Shared(2),
            check: secs(LEARNER_SECS / f64::from(CHUNKS)),
            calls: calls(),
            network: Network {
                latency: secs(LATENCY_SECS),
                chunk: Duration::ZERO,
                weights: Duration::ZERO,
            },
            lease: LEASE,
            duplicates: Duplicates::BackupsAndAudits(AUDIT_SHARE),
            slow: EQUAL_MACHINES,
            failures: NO_FAILURES,
        }
    }
}
