//! The canary recomputes log-probabilities and recurrent states that actors sent.

use std::time::Duration;

use learner::config::{AuditConfig, Fingerprint, LeaseConfig};
use learner::launch;
use learner::lease::canary::{self, Extent};
use learner::lease::exchange::{Caller, Exchange};
use learner::lease::slots::ConnectionId;
use learner::train::assemble::problem;
use policy::{CoreKind, PolicySnapshot};
use proto::{
    EnvironmentStart, Lease, LeaseAnswer, PolicyVersion, PushHeader, Reason, Refusal, Registered,
    RolloutOrigin, RolloutWork, RunDescription, Start, TrajectoryChunk,
};

use crate::actor::{push, registration};
use crate::settings::launch_in;
use crate::toy;

/// Rolls out a slot in which the first environment's episode ends with step 2, in the middle of a block of two steps.
fn rolled_out(core: CoreKind) -> (RunDescription, PolicySnapshot, Vec<TrajectoryChunk>) {
    let folder = tempfile::tempdir().unwrap();
    let mut launch = launch_in(folder.path(), 1);
    launch.policy.core = core;
    let problem = problem(&launch.environment);
    let algorithm = marl::build(&launch.training, &launch.policy, &problem, launch.seed).unwrap();
    let policy = algorithm.snapshot().unwrap();
    let run = launch::prepare(launch).unwrap().1;
    let chunks = toy::roll_out(&run, &policy, &work());
    (run, policy, chunks)
}

/// The slot.
fn work() -> RolloutWork {
    let start = |environment, limit| EnvironmentStart {
        environment,
        start: Start::Fresh { episode: 0, limit },
    };
    RolloutWork { iteration: 0, slot: 0, environments: vec![start(0, 3), start(1, 10)] }
}

/// The origin of the slot.
fn origin() -> RolloutOrigin {
    RolloutOrigin { iteration: 0, slot: 0, environments: vec![0, 1] }
}

#[test]
fn a_chunk_of_another_slot_iteration_or_environment_is_refused() {
    let (run, policy, chunks) = rolled_out(CoreKind::Gru);
    let others = [
        RolloutOrigin { environments: vec![2, 3], slot: 1, ..origin() },
        RolloutOrigin { iteration: 1, ..origin() },
        RolloutOrigin { environments: vec![0, 3], ..origin() },
    ];
    for other in others {
        let refusal =
            canary::check(&policy, &run, &chunks[0], Some(&other), Extent::Chunk).unwrap_err();
        assert_eq!(
            (refusal.reason, refusal.field.as_str()),
            (Reason::CanaryMismatch, "chunk.agents[0].action")
        );
    }
    assert_eq!(canary::check(&policy, &run, &chunks[0], None, Extent::Chunk), Ok(()));
}

#[test]
fn chunks_of_the_named_policy_are_accepted_with_and_without_recurrence() {
    for core in [CoreKind::Gru, CoreKind::Mlp] {
        let (run, policy, chunks) = rolled_out(core);
        assert!(chunks.iter().any(|chunk| chunk.truncated.contains(&true)));
        for chunk in &chunks {
            assert_eq!(canary::check(&policy, &run, chunk, Some(&origin()), Extent::Chunk), Ok(()));
        }
    }
}

#[test]
fn a_changed_number_is_refused_with_its_agent_step_and_environment() {
    type Change = fn(&mut TrajectoryChunk);
    let changes: [(Change, &str, &str); 4] = [
        (|c| c.agents[1].log_prob[5] += 0.01, "agents[1].log_prob", "step 2 of environment 1"),
        (|c| c.agents[0].hidden[2 * 8 + 3] += 0.01, "agents[0].hidden", "step 2 of environment 0"),
        (|c| c.agents[0].action[6] += 0.5, "agents[0].log_prob", "step 3 of environment 0"),
        (
            |c| c.end.as_mut().unwrap().recurrent[1][15] += 0.01,
            "agents[1].hidden",
            "step 4 of environment 1, unit 7",
        ),
    ];
    let (run, policy, chunks) = rolled_out(CoreKind::Gru);
    for (change, field, position) in changes {
        let mut chunk = chunks.last().unwrap().clone();
        change(&mut chunk);
        let refusal =
            canary::check(&policy, &run, &chunk, Some(&origin()), Extent::Chunk).unwrap_err();
        assert_eq!(
            (refusal.reason, refusal.field),
            (Reason::CanaryMismatch, format!("chunk.{field}"))
        );
        assert!(refusal.detail.contains(position), "{}", refusal.detail);
    }
}

#[test]
fn the_first_of_several_differences_is_reported() {
    let (run, policy, mut chunks) = rolled_out(CoreKind::Gru);
    chunks[0].agents[0].log_prob[6] += 1.0;
    chunks[0].agents[0].log_prob[2] += 1.0;
    let refusal =
        canary::check(&policy, &run, &chunks[0], Some(&origin()), Extent::Chunk).unwrap_err();
    assert!(refusal.detail.contains("step 1 of environment 0"), "{}", refusal.detail);
}

#[test]
fn outside_the_sample_only_the_first_step_of_a_chunk_is_checked() {
    for core in [CoreKind::Gru, CoreKind::Mlp] {
        let (run, policy, mut chunks) = rolled_out(core);
        let check = |chunk: &TrajectoryChunk| {
            canary::check(&policy, &run, chunk, Some(&origin()), Extent::FirstStep)
        };
        let chunk = chunks.last_mut().unwrap();
        chunk.agents[0].log_prob[2] += 1.0;
        chunk.end.as_mut().unwrap().recurrent[0].iter_mut().for_each(|unit| *unit += 1.0);
        assert_eq!(check(chunk), Ok(()));
        chunk.agents[1].log_prob[1] += 1.0;
        let refusal = check(chunk).unwrap_err();
        assert_eq!(refusal.field, "chunk.agents[1].log_prob");
        assert!(refusal.detail.contains("step 0 of environment 1"), "{}", refusal.detail);
    }
}

/// A new actor on a connection of its own leases the slot and sends `chunk`.
fn send(exchange: &Exchange, connection: u64, chunk: TrajectoryChunk) -> Option<Refusal> {
    let connection = ConnectionId(connection);
    let own = exchange.register(connection, &registration(exchange.run())).unwrap();
    let lease = lease(exchange, connection, own);
    let header = PushHeader::of(&lease, chunk.digest(&origin()));
    let refusal = push(exchange, connection, &header, chunk).err()?;
    let caller = Caller { connection, peer: None, call: "push" };
    exchange.refused(&caller, Some(lease.id), &refusal);
    Some(refusal)
}

fn lease(exchange: &Exchange, connection: ConnectionId, own: Registered) -> Lease {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().unwrap();
    let answer = exchange.lease(connection, own.actor, own.incarnation, Duration::ZERO);
    match runtime.block_on(answer).unwrap() {
        LeaseAnswer::Lease(lease) => lease,
        other => panic!("expected a lease, got {other:?}"),
    }
}

#[test]
fn after_the_first_mismatch_every_chunk_of_every_actor_is_checked_whole() {
    let (run, policy, chunks) = rolled_out(CoreKind::Gru);
    let lease = LeaseConfig { ttl_secs: 20.0, heartbeat_secs: 5.0 };
    let audit = AuditConfig { share: 0.0, fingerprint: Fingerprint::Optional };
    let exchange = Exchange::new(run, lease, audit, toy::states());
    exchange.publish(PolicyVersion(0), policy.to_bytes().unwrap().into()).unwrap();
    exchange.open_iteration(0, PolicyVersion(0), vec![work()]);
    let changed = |row: usize| {
        let mut chunk = chunks[0].clone();
        chunk.agents[1].log_prob[row] += 1.0;
        chunk
    };
    for (actor, row) in std::iter::once(0).chain([7; 32]).enumerate() {
        let refusal = send(&exchange, actor as u64, changed(row)).unwrap();
        assert_eq!(refusal.reason, Reason::CanaryMismatch, "{refusal}");
    }
    assert_eq!(send(&exchange, 33, chunks[0].clone()), None);
}
