//! Discrete actions: only the index of a choice is valid.

use proto::{ActionSpec, AgentChunk, Reason, Refusal, RunDescription, TrajectoryChunk};

use crate::sample;

/// The sample run with three choices for the first agent.
fn run() -> RunDescription {
    let mut run = sample::run();
    run.environment.agents[0].action =
        ActionSpec { size: 1, low: 0.0, high: 2.0, choices: Some(3) };
    run
}

fn chunk(action: [f32; 4]) -> TrajectoryChunk {
    let mut chunk = sample::chunk(0);
    let agent = AgentChunk { action: action.to_vec(), ..chunk.agents[0].clone() };
    chunk.agents[0] = agent;
    chunk
}

fn sent(action: [f32; 4]) -> Result<TrajectoryChunk, Refusal> {
    let (message, digest) = chunk(action).to_wire(&run(), &sample::origin());
    TrajectoryChunk::from_wire(&message, &run(), &sample::origin(), digest)
}

#[test]
fn indices_of_choices_survive_the_round_trip() {
    assert_eq!(run().validate(), Ok(()));
    assert_eq!(RunDescription::from_wire(Some(run().to_wire())), Ok(run()));
    assert_eq!(sent([0.0, 1.0, 2.0, 1.0]), Ok(chunk([0.0, 1.0, 2.0, 1.0])));
}

#[test]
fn an_action_that_is_no_choice_is_refused_by_name() {
    for (wrong, reason) in [
        (7.0, Reason::BadValue),
        (3.0, Reason::BadValue),
        (0.5, Reason::BadValue),
        (-1.0, Reason::BadValue),
        (f32::NAN, Reason::NotFinite),
        (f32::INFINITY, Reason::NotFinite),
    ] {
        let refusal = sent([0.0, wrong, 1.0, 2.0]).unwrap_err();
        let found = (refusal.reason, refusal.field.as_str());
        assert_eq!(found, (reason, "chunk.agents[0].action"), "{wrong}: {refusal}");
    }
}

#[test]
fn choices_of_several_numbers_and_more_than_can_be_told_apart_are_refused() {
    for (size, choices) in [(2, 3), (0, 3), (1, u32::MAX)] {
        let mut run = run();
        run.environment.agents[0].action.size = size;
        run.environment.agents[0].action.choices = Some(choices);
        let refusal = run.validate().unwrap_err();
        assert_eq!(refusal.field, "run.environment.agents[0].action.choices");
    }
}

#[test]
fn another_number_of_choices_is_another_environment() {
    let mut other = run().environment;
    other.agents[0].action.choices = Some(4);
    let difference = run().environment.first_difference(&other).unwrap();
    assert_eq!(difference.field, "agents[0].action.choices");
}
