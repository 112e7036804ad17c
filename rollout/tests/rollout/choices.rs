//! Tests with discrete actions: chunks in the protocol, and log-probabilities.

use std::ops::ControlFlow;

use policy::{PolicySnapshot, Scratch};
use proto::{EnvironmentStart, RolloutOrigin, RolloutWork, RunDescription, Start, TrajectoryChunk};
use sim::{EnvironmentBatch, ObservationConfig, ObservationNorm, TaskConfig};

use crate::{fixture, work};

const OUT: usize = 3;

fn task() -> TaskConfig {
    let observation =
        ObservationConfig { norm: ObservationNorm::None, ..fixture::task().observation };
    TaskConfig { task: "cue-2x1".to_owned(), observation, ..fixture::task() }
}

fn world() -> Box<dyn EnvironmentBatch> {
    sim::environments(&task(), fixture::ENVIRONMENTS).unwrap()
}

fn policy() -> PolicySnapshot {
    fixture::policy_for(world().description())
}

fn run() -> RunDescription {
    RunDescription { environment: world().description().clone(), ..work::run() }
}

fn roll(world: &mut dyn EnvironmentBatch) -> Vec<TrajectoryChunk> {
    let start = |environment| EnvironmentStart {
        environment,
        start: Start::Fresh { episode: 0, limit: 30 },
    };
    let work = RolloutWork { iteration: 4, slot: 3, environments: vec![start(6), start(7)] };
    let mut chunks = Vec::new();
    let emit = |chunk| {
        chunks.push(chunk);
        ControlFlow::Continue(())
    };
    rollout::roll_out(&run(), &work, &policy(), world, |_| {}, emit).unwrap();
    chunks
}

#[test]
fn a_slot_with_choices_is_repeatable_and_survives_the_protocol() {
    let mut used = world();
    let first = roll(&mut *used);
    assert_eq!(roll(&mut *used), first);
    assert_eq!(run().validate(), Ok(()));
    let origin = RolloutOrigin { iteration: 4, slot: 3, environments: vec![6, 7] };
    for chunk in &first {
        let (message, digest) = chunk.to_wire(&run(), &origin);
        assert_eq!(&TrajectoryChunk::from_wire(&message, &run(), &origin, digest).unwrap(), chunk);
    }
    let actions: Vec<f32> = first.iter().flat_map(|chunk| chunk.agents[1].action.clone()).collect();
    for choice in [0.0, 1.0, 2.0] {
        assert!(actions.contains(&choice), "{choice} was never chosen");
    }
}

#[test]
fn stored_hidden_states_reproduce_the_log_probabilities_of_choices() {
    let (chunks, policy) = (roll(&mut *world()), policy());
    let rows = fixture::ENVIRONMENTS;
    for (own, agent) in policy.agents.iter().zip(&chunks[0].agents) {
        let mut hidden = agent.hidden[..rows * fixture::HIDDEN].to_vec();
        for step in 0..fixture::HIDDEN_EVERY as usize {
            let mut output = vec![0.0; rows * OUT];
            let observation = &agent.observation[step * rows * 9..(step + 1) * rows * 9];
            own.forward(rows, observation, &mut hidden, &mut output, &mut Scratch::default());
            for (position, output) in output.chunks_exact(OUT).enumerate() {
                let row = step * rows + position;
                assert_eq!(own.log_prob(output, &agent.action[row..=row]), agent.log_prob[row]);
            }
        }
    }
}
