//! The canary recomputes log-probabilities and recurrent states that actors sent.

use learner::lease::canary::{self, Extent};
use learner::lease::exchange::{Caller, Exchange};
use learner::lease::slots::{ConnectionId, Trust};
use policy::{CoreKind, Noise};
use proto::{PushHeader, Reason, Refusal, RolloutOrigin, TrajectoryChunk};

use crate::actor::push;
use crate::one_slot::{exchange, lease, origin, rolled_out, rolled_out_with};

#[test]
fn a_chunk_of_another_slot_iteration_or_environment_is_refused() {
    let (run, policy, chunks) = rolled_out(CoreKind::Gru);
    let others = [
        RolloutOrigin { environments: vec![2, 3], slot: 1, ..origin() },
        RolloutOrigin { iteration: 1, ..origin() },
        RolloutOrigin { environments: vec![0, 3], ..origin() },
    ];
    for other in &others {
        let refusal =
            canary::check(&policy, &run, &chunks[0], (other, Trust::Exact), Extent::Chunk)
                .unwrap_err();
        assert_eq!(
            (refusal.reason, refusal.field.as_str()),
            (Reason::CanaryMismatch, "chunk.agents[0].action")
        );
    }
    assert_eq!(
        canary::check(&policy, &run, &chunks[0], (&others[0], Trust::Foreign), Extent::Chunk),
        Ok(())
    );
}

#[test]
fn chunks_of_the_named_policy_are_accepted_with_and_without_recurrence() {
    for core in [CoreKind::Gru, CoreKind::Mlp] {
        let (run, policy, chunks) = rolled_out(core);
        assert!(chunks.iter().any(|chunk| chunk.truncated.contains(&true)));
        for chunk in &chunks {
            assert_eq!(
                canary::check(&policy, &run, chunk, (&origin(), Trust::Exact), Extent::Chunk),
                Ok(())
            );
        }
    }
}

#[test]
fn chunks_of_agents_that_share_noise_are_checked_with_the_signals_of_their_slot() {
    let (run, policy, chunks) = rolled_out_with(|policy| {
        (policy.noise, policy.noise_loading) = (Some(Noise::Shared), Some(0.9));
        policy.noise_hold = Some(3);
    });
    let check = |chunk, origin: &RolloutOrigin, trust| {
        canary::check(&policy, &run, chunk, (origin, trust), Extent::Chunk)
    };
    for chunk in &chunks {
        assert_eq!(check(chunk, &origin(), Trust::Exact), Ok(()));
        assert_eq!(check(chunk, &origin(), Trust::Foreign), Ok(()));
    }
    let other = RolloutOrigin { iteration: 1, ..origin() };
    let refusal = check(&chunks[0], &other, Trust::Foreign).unwrap_err();
    assert_eq!(refusal.field, "chunk.agents[0].log_prob");
}

#[test]
fn a_changed_number_is_refused_with_its_agent_step_and_environment() {
    type Change = fn(&mut TrajectoryChunk);
    let changes: [(Change, &str, &str); 5] = [
        (|c| c.agents[1].log_prob[5] += 0.01, "agents[1].log_prob", "step 2 of environment 1"),
        (|c| c.agents[0].hidden[2 * 8 + 3] += 0.01, "agents[0].hidden", "step 2 of environment 0"),
        (|c| c.agents[0].action[6] += 0.5, "agents[0].log_prob", "step 3 of environment 0"),
        (
            |c| c.end.as_mut().unwrap().recurrent[1][15] += 0.01,
            "agents[1].hidden",
            "step 4 of environment 1, unit 7",
        ),
        // The first of several differences is reported.
        (
            |c| [6, 2].into_iter().for_each(|row| c.agents[0].log_prob[row] += 1.0),
            "agents[0].log_prob",
            "step 1 of environment 0",
        ),
    ];
    let (run, policy, chunks) = rolled_out(CoreKind::Gru);
    for (change, field, position) in changes {
        let mut chunk = chunks.last().unwrap().clone();
        change(&mut chunk);
        let refusal =
            canary::check(&policy, &run, &chunk, (&origin(), Trust::Exact), Extent::Chunk)
                .unwrap_err();
        assert_eq!(
            (refusal.reason, refusal.field),
            (Reason::CanaryMismatch, format!("chunk.{field}"))
        );
        assert!(refusal.detail.contains(position), "{}", refusal.detail);
    }
}

#[test]
fn outside_the_sample_only_the_first_step_of_a_chunk_is_checked() {
    for core in [CoreKind::Gru, CoreKind::Mlp] {
        let (run, policy, mut chunks) = rolled_out(core);
        let check = |chunk: &TrajectoryChunk| {
            canary::check(&policy, &run, chunk, (&origin(), Trust::Exact), Extent::FirstStep)
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

/// A new actor on a separate connection leases the slot and sends `chunk`.
fn send(exchange: &Exchange, connection: u64, chunk: TrajectoryChunk) -> Option<Refusal> {
    let connection = ConnectionId(connection);
    let lease = lease(exchange, connection);
    let header = PushHeader::of(&lease, chunk.digest(&origin()));
    let refusal = push(exchange, connection, &header, chunk).err()?;
    let caller = Caller { connection, peer: None, call: "push" };
    exchange.refused(&caller, Some(lease.id), &refusal);
    Some(refusal)
}

#[test]
fn after_the_first_mismatch_every_chunk_of_every_actor_is_checked_whole() {
    let (run, policy, chunks) = rolled_out(CoreKind::Gru);
    let exchange = exchange(run, &policy);
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
