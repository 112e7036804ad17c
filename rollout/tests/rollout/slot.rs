//! Tests that the rollout of a slot is a pure function of its lease and weights.

use std::ops::ControlFlow;

use policy::Scratch;
use proto::{EnvironmentStart, RolloutWork, Start, TrajectoryChunk};
use sim::{EnvironmentBatch, TaskConfig};

use crate::cue;
use crate::fixture::{ENVIRONMENTS, HIDDEN, HIDDEN_EVERY, policy, policy_for, task, world};
use crate::work::{CHUNK, STEPS, fresh_work, run, run_of};

/// Tasks with continuous and with discrete actions.
fn tasks() -> [TaskConfig; 2] {
    [task(), cue()]
}

fn open(task: &TaskConfig) -> Box<dyn EnvironmentBatch> {
    sim::environments(task, ENVIRONMENTS).unwrap()
}

/// Rolls out `work` in new environments.
fn roll(task: &TaskConfig, work: &RolloutWork) -> Vec<TrajectoryChunk> {
    roll_in(open(task).as_mut(), task, work)
}

fn roll_in(
    world: &mut dyn EnvironmentBatch,
    task: &TaskConfig,
    work: &RolloutWork,
) -> Vec<TrajectoryChunk> {
    let policy = policy_for(world.description());
    let mut chunks = Vec::new();
    let emit = |chunk| {
        chunks.push(chunk);
        ControlFlow::Continue(())
    };
    rollout::roll_out(&run_of(task), work, &policy, world, |_| {}, emit).unwrap();
    chunks
}

/// The work of the next iteration, which continues `chunks`.
fn next_work(chunks: &[TrajectoryChunk]) -> RolloutWork {
    let end = chunks.last().unwrap().end.clone().unwrap();
    let start = |(position, state): (usize, Vec<u8>)| {
        let of = position * HIDDEN..(position + 1) * HIDDEN;
        let recurrent = end.recurrent.iter().map(|rows| rows[of.clone()].to_vec()).collect();
        EnvironmentStart {
            environment: 6 + position as u32,
            start: Start::Continue { state, recurrent },
        }
    };
    let environments = end.environments.iter().cloned().enumerate().map(start).collect();
    RolloutWork { iteration: 5, slot: 3, environments }
}

#[test]
fn a_slot_is_repeatable_in_used_and_new_environments() {
    for task in tasks() {
        let mut used = open(&task);
        let first = roll_in(used.as_mut(), &task, &fresh_work());
        assert_eq!(roll_in(used.as_mut(), &task, &fresh_work()), first, "{}", task.task);
        assert_eq!(roll(&task, &fresh_work()), first, "{}", task.task);
        let next = roll_in(used.as_mut(), &task, &next_work(&first));
        assert_eq!(roll(&task, &next_work(&first)), next, "{}", task.task);
        assert_ne!(next[0].agents[0].action, first[0].agents[0].action, "{}", task.task);
    }
}

#[test]
fn the_chunks_of_a_slot_are_complete_and_survive_the_protocol() {
    for task in tasks() {
        let run = run_of(&task);
        let origin = fresh_work().origin();
        assert_eq!(run.validate(), Ok(()), "{}", task.task);
        let chunks = roll(&task, &fresh_work());
        assert_eq!(chunks.len() as u32, STEPS / CHUNK, "{}", task.task);
        for chunk in chunks {
            let (message, digest) = chunk.to_wire(&run, &origin);
            assert_eq!(digest, chunk.digest(&origin), "{}", task.task);
            let read = TrajectoryChunk::from_wire(&message, &run, &origin, digest);
            assert_eq!(read, Ok(chunk), "{}", task.task);
        }
    }
}

#[test]
fn a_truncated_episode_has_its_final_state_and_resets_the_recurrent_state() {
    let chunks = roll(&task(), &fresh_work());
    let ends: Vec<(u32, u32)> =
        chunks.iter().flat_map(|c| &c.finals).map(|last| (last.step, last.environment)).collect();
    assert_eq!(ends, [(14, 0), (39, 0), (39, 1)]);
    let row = 14 * ENVIRONMENTS;
    assert!(chunks[0].truncated[row] && !chunks[0].terminated[row]);
    assert_eq!(chunks[0].truncated.iter().filter(|&&t| t).count(), 1);
    let final_state = &chunks[0].finals[0].state;
    assert_ne!(final_state[..], chunks[0].state[(row + ENVIRONMENTS) * 17..][..17]);
    // Stored before step 10 (running) and step 20 (five steps into the new episode).
    let before_reset = &chunks[0].agents[0].hidden[ENVIRONMENTS * HIDDEN..][..HIDDEN];
    assert!(before_reset.iter().any(|&h| h != 0.0));
    assert!(chunks[0].agents[0].hidden[..ENVIRONMENTS * HIDDEN].iter().all(|&h| h == 0.0));
}

#[test]
fn stored_hidden_states_reproduce_the_sent_log_probabilities() {
    for task in tasks() {
        let policy = policy_for(open(&task).description());
        for (own, agent) in policy.agents.iter().zip(&roll(&task, &fresh_work())[1].agents) {
            let mut hidden = agent.hidden[..ENVIRONMENTS * HIDDEN].to_vec();
            let observations = agent.observation.chunks(ENVIRONMENTS * own.observation_size());
            let mut actions = agent.action.chunks(own.action_size()).zip(&agent.log_prob);
            for observation in observations.take(HIDDEN_EVERY as usize) {
                let mut outputs = vec![0.0; ENVIRONMENTS * own.output_size()];
                let scratch = &mut Scratch::default();
                own.forward(ENVIRONMENTS, observation, &mut hidden, &mut outputs, scratch);
                for output in outputs.chunks(own.output_size()) {
                    let (action, log_prob) = actions.next().unwrap();
                    assert_eq!(own.log_prob(output, action), *log_prob, "{}", task.task);
                }
            }
        }
    }
}

#[test]
fn an_invalid_state_is_rejected_without_a_step() {
    let mut work = next_work(&roll(&task(), &fresh_work()));
    work.environments[0].start =
        Start::Continue { state: vec![7; 10], recurrent: vec![vec![0.0; HIDDEN]; 2] };
    let outcome =
        rollout::roll_out(&run(), &work, &policy(), &mut *world(), |_| {}, |_| panic!("stepped"));
    assert!(outcome.is_err());
}
