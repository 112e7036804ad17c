//! Discrete actions: only the index of a choice is valid.

use proto::Reason::{BadValue, NotFinite};
use proto::{ActionSpec, Refusal, RunDescription, TrajectoryChunk};

use crate::{assert_refused, received, sample};

/// The sample run with three choices for the first agent.
fn run() -> RunDescription {
    let mut run = sample::run();
    run.environment.agents[0].action =
        ActionSpec { size: 1, low: 0.0, high: 2.0, choices: Some(3) };
    run
}

fn chunk(action: [f32; 4]) -> TrajectoryChunk {
    let mut chunk = sample::chunk(0);
    chunk.agents[0].action = action.to_vec();
    chunk
}

fn pushed(action: [f32; 4]) -> Result<TrajectoryChunk, Refusal> {
    let (message, digest) = chunk(action).to_wire(&run(), &sample::origin());
    received(&message, &run(), digest)
}

#[test]
fn indices_of_choices_survive_the_round_trip() {
    assert_eq!(run().validate(), Ok(()));
    assert_eq!(RunDescription::from_wire(Some(run().to_wire())), Ok(run()));
    assert_eq!(pushed([0.0, 1.0, 2.0, 1.0]), Ok(chunk([0.0, 1.0, 2.0, 1.0])));
}

#[test]
fn an_action_that_is_no_choice_is_refused_by_name() {
    for wrong in [7.0, 3.0, 0.5, -1.0] {
        assert_refused(pushed([0.0, wrong, 1.0, 2.0]), BadValue, "chunk.agents[0].action");
    }
    for wrong in [f32::NAN, f32::INFINITY] {
        assert_refused(pushed([0.0, wrong, 1.0, 2.0]), NotFinite, "chunk.agents[0].action");
    }
}

#[test]
fn choices_of_several_numbers_and_more_than_can_be_told_apart_are_refused() {
    for (size, choices) in [(2, 3), (0, 3), (1, u32::MAX)] {
        let mut run = run();
        run.environment.agents[0].action.size = size;
        run.environment.agents[0].action.choices = Some(choices);
        assert_refused(run.validate(), BadValue, "run.environment.agents[0].action.choices");
    }
}
