//! Tests of `assemble` with 2 slots of 2 environments, 4 steps in chunks of 2, and one agent with 1 feature, 2 action
//! dimensions and 1 recurrent unit, stored every 2 steps.

#[expect(dead_code, reason = "the tests of messages also need chunks")]
#[path = "../../../../proto/tests/wire/sample.rs"]
mod sample;

use proto::{ActionSpec, ActorId, AgentChunk, LeaseId};

use super::*;

fn run() -> RunDescription {
    RunDescription { slot_steps: 4, chunk_steps: 2, hidden_every: 2, ..run_of_one_agent(2, 1) }
}

/// A run of one agent with one feature, an action of `action` numbers and `hidden` recurrent units.
pub(crate) fn run_of_one_agent(action: usize, hidden: u32) -> RunDescription {
    let mut run = sample::run();
    run.environment.state.truncate(1);
    run.environment.agents.truncate(1);
    run.environment.agents[0].observation.truncate(1);
    run.environment.agents[0].action = ActionSpec::continuous(action);
    let hidden_sizes = vec![hidden];
    RunDescription { slot_steps: 3, chunk_steps: 1, hidden_sizes, hidden_every: 1, ..run }
}

/// A number that encodes its position: `100 * step + environment`.
fn code(step: u32, environment: usize) -> f32 {
    (100 * step as usize + environment) as f32
}

fn chunk(slot: usize, sequence: u32) -> TrajectoryChunk {
    let first_step = 2 * sequence;
    let steps = [first_step, first_step + 1];
    let rows = || steps.iter().flat_map(|t| [2 * slot, 2 * slot + 1].map(|e| code(*t, e)));
    let last = sequence == 1;
    let agent = AgentChunk {
        observation: rows().collect(),
        action: rows().flat_map(|value| [value, -value]).collect(),
        log_prob: rows().collect(),
        hidden: vec![code(first_step, 2 * slot), code(first_step, 2 * slot + 1)],
    };
    let last_step = |environment| FinalStep {
        step: 3,
        environment,
        state: vec![code(4, 2 * slot + environment as usize)],
        observation: vec![vec![0.5]],
    };
    TrajectoryChunk {
        sequence,
        first_step,
        steps: 2,
        agents: vec![agent],
        state: rows().collect(),
        reward: rows().collect(),
        terminated: vec![false; 4],
        // In the second slot, the first environment's episode is truncated after step 1.
        truncated: vec![false, false, slot == 1 && sequence == 0, false],
        finals: match (last, slot) {
            (true, _) => vec![last_step(0), last_step(1)],
            (false, 1) => vec![FinalStep { step: 1, ..last_step(0) }],
            (false, _) => vec![],
        },
        ..TrajectoryChunk::default()
    }
}

fn rollout(slot: usize) -> SlotRollout {
    let chunks = vec![chunk(slot, 0), chunk(slot, 1)];
    let (actor, lease, digests) = (ActorId(1), LeaseId(1), Vec::new());
    SlotRollout { slot: slot as u32, actor, lease, chunks, digests }
}

#[test]
fn every_number_is_at_the_position_of_its_step_and_environment() {
    let batch = assemble(&run(), &[rollout(0), rollout(1)]);
    let rows: Vec<f32> = (0..4).flat_map(|t| (0..4).map(move |e| code(t, e))).collect();
    assert_eq!((batch.steps, batch.environments), (4, 4));
    assert_eq!(batch.reward, rows);
    assert_eq!(batch.state, rows);
    assert_eq!(batch.agents[0].observation, rows);
    assert_eq!(batch.agents[0].log_prob, rows);
    let actions: Vec<f32> = rows.iter().flat_map(|value| [*value, -value]).collect();
    assert_eq!(batch.agents[0].action, actions);
    // [T / 2, B, H]: before steps 0 and 2.
    assert_eq!(batch.agents[0].hidden, [0.0, 1.0, 2.0, 3.0, 200.0, 201.0, 202.0, 203.0]);
    let cut: Vec<usize> = (0..16).filter(|row| batch.done(*row)).collect();
    assert_eq!(cut, [4 + 2]);
}

#[test]
fn finals_are_sorted_by_step_and_environment() {
    let batch = assemble(&run(), &[rollout(0), rollout(1)]);
    let places: Vec<(usize, usize)> =
        batch.finals.iter().map(|f| (f.step, f.environment)).collect();
    assert_eq!(places, [(1, 2), (3, 0), (3, 1), (3, 2), (3, 3)]);
    assert_eq!(batch.finals[4].state, [code(4, 3)]);
}

#[test]
#[should_panic(expected = "rollouts are not all slots in order")]
fn slots_in_the_wrong_order_panic() {
    let _never = assemble(&run(), &[rollout(1), rollout(0)]);
}

#[test]
#[should_panic(expected = "slot 1: steps")]
fn a_slot_with_missing_steps_panics() {
    let mut short = rollout(1);
    short.chunks.pop();
    let _never = assemble(&run(), &[rollout(0), short]);
}

#[test]
#[should_panic(expected = "a chunk's array")]
fn an_array_of_the_wrong_length_panics() {
    let mut wrong = rollout(0);
    wrong.chunks[0].agents[0].action.pop();
    let _never = assemble(&run(), &[wrong, rollout(1)]);
}
