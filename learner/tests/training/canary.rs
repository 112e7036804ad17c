//! The canary recomputes log-probabilities and recurrent states that actors sent.

use learner::assemble::problem;
use learner::{canary, launch};
use policy::{CoreKind, PolicySnapshot};
use proto::{
    EnvironmentStart, Reason, RolloutOrigin, RolloutWork, RunDescription, Start, TrajectoryChunk,
};

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
    let start = |environment, limit| EnvironmentStart {
        environment,
        start: Start::Fresh { episode: 0, limit },
    };
    let work = RolloutWork { iteration: 0, slot: 0, environments: vec![start(0, 3), start(1, 10)] };
    let chunks = toy::roll_out(&run, &policy, &work);
    (run, policy, chunks)
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
        let refusal = canary::check(&policy, &run, &chunks[0], Some(&other)).unwrap_err();
        assert_eq!(
            (refusal.reason, refusal.field.as_str()),
            (Reason::CanaryMismatch, "chunk.agents[0].action")
        );
    }
    assert_eq!(canary::check(&policy, &run, &chunks[0], None), Ok(()));
}

#[test]
fn chunks_of_the_named_policy_are_accepted_with_and_without_recurrence() {
    for core in [CoreKind::Gru, CoreKind::Mlp] {
        let (run, policy, chunks) = rolled_out(core);
        assert!(chunks.iter().any(|chunk| chunk.truncated.contains(&true)));
        for chunk in &chunks {
            assert_eq!(canary::check(&policy, &run, chunk, Some(&origin())), Ok(()));
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
        let refusal = canary::check(&policy, &run, &chunk, Some(&origin())).unwrap_err();
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
    let refusal = canary::check(&policy, &run, &chunks[0], Some(&origin())).unwrap_err();
    assert!(refusal.detail.contains("step 1 of environment 0"), "{}", refusal.detail);
}
