//! Observations that are copies are left out of the message, and the learner restores every bit of them.

use prost::Message;
use proto::{FeatureRole, FeatureSpec, Reason, Refusal, RunDescription, TrajectoryChunk, wire};

use crate::sample;

/// The sample run, in which both agents observe features 2 and 0 of the state, their identity and padding.
fn run() -> RunDescription {
    let mut run = sample::run();
    let roles = [
        FeatureRole::Signal,
        FeatureRole::Signal,
        FeatureRole::Identity,
        FeatureRole::Identity,
        FeatureRole::Constant,
    ];
    for agent in &mut run.environment.agents {
        agent.seen = vec![2, 0];
        agent.observation =
            roles.map(|role| FeatureSpec { name: "feature".to_owned(), role }).to_vec();
    }
    run
}

/// A chunk whose observations have the signals `scale` times as large, and these entries of the identity.
fn chunk(sequence: u32, scale: f32, [on, off]: [f32; 2]) -> TrajectoryChunk {
    let mut chunk = sample::chunk(sequence);
    let observe = |agent: usize, states: &[f32]| {
        let own = |index| if index == agent { on } else { off };
        let row = |s: &[f32]| [scale * s[2], scale * s[0], own(0), own(1), 0.0];
        states.chunks(4).flat_map(row).collect::<Vec<_>>()
    };
    for (i, agent) in chunk.agents.iter_mut().enumerate() {
        agent.observation = observe(i, &chunk.state);
    }
    for last in &mut chunk.finals {
        last.observation = vec![observe(0, &last.state), observe(1, &last.state)];
    }
    chunk
}

/// Which observations the message has: of each agent in the rows, then in the final steps.
fn sent(message: &wire::TrajectoryChunk) -> [bool; 4] {
    let rows = message.agents.iter().map(|agent| agent.observation.as_ref());
    let finals = message.finals.as_ref().unwrap().observations.iter().map(Some);
    let sent = rows.chain(finals).map(|tensor| tensor.is_some_and(|it| !it.data.is_empty()));
    sent.collect::<Vec<_>>().try_into().unwrap()
}

/// The chunk arrives as it was; returns what its message has.
fn assert_arrives(chunk: &TrajectoryChunk, run: &RunDescription) -> [bool; 4] {
    let (message, digest) = chunk.to_wire(run, &sample::origin());
    assert_eq!(digest, chunk.digest(&sample::origin()), "it covers all observations");
    let bytes = message.encode_to_vec();
    let received = wire::TrajectoryChunk::decode(bytes.as_slice()).unwrap();
    let found = TrajectoryChunk::from_wire(&received, run, &sample::origin(), digest);
    assert_eq!(found.as_ref(), Ok(chunk));
    sent(&message)
}

#[test]
fn copies_of_the_global_state_are_left_out_and_restored() {
    for sequence in [0, 1] {
        assert_eq!(assert_arrives(&chunk(sequence, 1.0, [1.0, 0.0]), &run()), [false; 4]);
    }
}

#[test]
fn of_scaled_observations_only_the_first_agents_are_sent() {
    let scaled = chunk(0, 0.7, [0.6, -0.2]);
    assert_eq!(assert_arrives(&scaled, &run()), [true, false, true, false]);
}

#[test]
fn one_bit_that_differs_keeps_the_tensor_in_the_message() {
    let mut differs = chunk(0, 1.0, [1.0, 0.0]);
    let number = &mut differs.agents[1].observation[6];
    *number = number.next_up();
    differs.finals[1].observation[0][4] = -0.0;
    // The second agent's final observations differ from the first's.
    assert_eq!(assert_arrives(&differs, &run()), [false, true, true, true]);
}

#[test]
fn a_learner_that_restores_nothing_gets_every_observation_and_one_that_restores_takes_them() {
    let (whole, restoring) = (chunk(1, 1.0, [1.0, 0.0]), run());
    let other = RunDescription { restores_observations: false, ..restoring.clone() };
    assert_eq!(assert_arrives(&whole, &other), [true; 4]);
    let (message, digest) = whole.to_wire(&other, &sample::origin());
    let found = TrajectoryChunk::from_wire(&message, &restoring, &sample::origin(), digest);
    assert_eq!(found, Ok(whole));
}

/// How a message of `chunk` is refused after a change.
fn refused(chunk: &TrajectoryChunk, change: impl FnOnce(&mut wire::TrajectoryChunk)) -> Refusal {
    let (mut message, digest) = chunk.to_wire(&run(), &sample::origin());
    change(&mut message);
    TrajectoryChunk::from_wire(&message, &run(), &sample::origin(), digest).unwrap_err()
}

#[test]
fn an_observation_that_is_no_copy_cannot_be_left_out() {
    let chunk = chunk(0, 0.7, [0.6, -0.2]);
    let refusal = refused(&chunk, |message| message.agents[0].observation = None);
    assert_eq!((refusal.reason, refusal.field.as_str()), (Reason::DigestMismatch, "digest"));
    let changes: [fn(&mut RunDescription); 3] = [
        |run| run.environment.agents[0].seen.clear(),
        |run| run.environment.agents[0].observation[4].role = FeatureRole::Signal,
        |run| run.environment.agents[0].observation.truncate(1),
    ];
    for change in changes {
        let mut run = run();
        change(&mut run);
        let (mut message, digest) = sample::chunk(0).to_wire(&sample::run(), &sample::origin());
        message.agents[0].observation = None;
        let refusal = TrajectoryChunk::from_wire(&message, &run, &sample::origin(), digest);
        let refusal = refusal.unwrap_err();
        let found = (refusal.reason, refusal.field.as_str());
        assert_eq!(found, (Reason::MissingField, "chunk.agents[0].observation"), "{refusal}");
    }
}

#[test]
fn an_observation_cannot_be_restored_from_an_invalid_tensor() {
    let (copied, scaled) = (chunk(0, 1.0, [1.0, 0.0]), chunk(0, 0.7, [0.6, -0.2]));
    let cases = [
        (refused(&copied, |it| it.state = None), Reason::MissingField, "chunk.state"),
        (
            refused(&copied, |it| it.state.as_mut().unwrap().shape.swap(0, 2)),
            Reason::BadShape,
            "chunk.state",
        ),
        (
            refused(&copied, |it| it.finals.as_mut().unwrap().state = None),
            Reason::MissingField,
            "chunk.finals.state",
        ),
        (
            refused(&copied, |it| it.finals.as_mut().unwrap().steps = vec![0; 5]),
            Reason::BadValue,
            "chunk.finals.steps",
        ),
        (
            refused(&scaled, |it| it.agents[0].observation = it.reward.clone()),
            Reason::BadShape,
            "chunk.agents[0].observation",
        ),
        (
            refused(&scaled, |it| it.finals.as_mut().unwrap().observations[0].data_type = 2),
            Reason::BadType,
            "chunk.finals.observations[0]",
        ),
    ];
    for (refusal, reason, field) in cases {
        assert_eq!((refusal.reason, refusal.field.as_str()), (reason, field), "{refusal}");
    }
}
