//! An exchange whose only work is one slot, and the chunks of this slot.

use std::sync::Arc;
use std::time::Duration;

use learner::config::{AuditConfig, Fingerprint, LeaseConfig};
use learner::lease::exchange::Exchange;
use learner::lease::slots::ConnectionId;
use learner::train::assemble::problem;
use learner::train::prepare::prepare;
use policy::{CoreKind, PolicyConfig, PolicySnapshot};
use proto::{
    EnvironmentStart, Lease, LeaseAnswer, PolicyVersion, RolloutOrigin, RolloutWork,
    RunDescription, Start, TrajectoryChunk,
};

use crate::actor::{ask, registration};
use crate::hopper;
use crate::settings::launch_in;

/// Rolls out a slot in which the first environment's episode ends with step 2, in the middle of a block of two steps.
pub(crate) fn rolled_out(core: CoreKind) -> (RunDescription, PolicySnapshot, Vec<TrajectoryChunk>) {
    rolled_out_with(|policy| policy.core = core)
}

/// As [`rolled_out`], by policies with other settings.
pub(crate) fn rolled_out_with(
    change: impl Fn(&mut PolicyConfig),
) -> (RunDescription, PolicySnapshot, Vec<TrajectoryChunk>) {
    let folder = tempfile::tempdir().unwrap();
    let mut launch = launch_in(folder.path(), 1);
    change(&mut launch.policy);
    let problem = problem(&launch.environment);
    let algorithm = marl::build(&launch.training, &launch.policy, &problem, launch.seed).unwrap();
    let policy = algorithm.snapshot().unwrap();
    let run = prepare(launch).unwrap().1;
    let chunks = hopper::roll_out(&run, &policy, &work());
    (run, policy, chunks)
}

/// The slot.
pub(crate) fn work() -> RolloutWork {
    let start = |environment, limit| EnvironmentStart {
        environment,
        start: Start::Fresh { episode: 0, limit },
    };
    RolloutWork { iteration: 0, slot: 0, environments: vec![start(0, 3), start(1, 10)] }
}

/// The origin of the slot.
pub(crate) fn origin() -> RolloutOrigin {
    RolloutOrigin { iteration: 0, slot: 0, environments: vec![0, 1] }
}

/// An exchange that waits for the slot.
pub(crate) fn exchange(run: RunDescription, policy: &PolicySnapshot) -> Arc<Exchange> {
    let lease = LeaseConfig { ttl_secs: 20.0 };
    let audit = AuditConfig { share: 0.0, fingerprint: Fingerprint::Optional };
    let exchange = Exchange::new(run, lease, audit, hopper::states());
    exchange.publish(PolicyVersion(0), policy.to_bytes().unwrap().into()).unwrap();
    exchange.open_iteration(0, PolicyVersion(0), vec![work()]);
    exchange
}

/// Registers an actor on a connection and leases the slot to it.
pub(crate) fn lease(exchange: &Exchange, connection: ConnectionId) -> Lease {
    let own = exchange.register(connection, &registration(&exchange.run)).unwrap();
    match ask(exchange, connection, own, Duration::ZERO) {
        LeaseAnswer::Lease(lease) => lease,
        other => panic!("expected a lease, got {other:?}"),
    }
}
