//! Observations that are copies are left out of the message, and the learner restores every bit of them.

use proto::Reason::{BadShape, BadType, BadValue, DigestMismatch, MissingField};
use proto::{FeatureRole, FeatureSpec, Reason, RunDescription, TrajectoryChunk, wire};

use crate::{assert_refused, honest_digest, received, sample};

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

fn scaled() -> TrajectoryChunk {
    chunk(0, 0.7, [0.6, -0.2])
}

fn finals(message: &mut wire::TrajectoryChunk) -> &mut wire::FinalSteps {
    message.finals.as_mut().unwrap()
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
    assert_eq!(received(&message, run, digest).as_ref(), Ok(chunk));
    sent(&message)
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
    assert_eq!(received(&message, &restoring, digest), Ok(whole));
}

#[test]
fn an_observation_that_is_no_copy_cannot_be_left_out() {
    let (mut message, digest) = scaled().to_wire(&run(), &sample::origin());
    message.agents[0].observation = None;
    assert_refused(received(&message, &run(), digest), DigestMismatch, "digest");
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
        let result = received(&message, &run, digest);
        assert_refused(result, MissingField, "chunk.agents[0].observation");
    }
}

#[test]
fn an_observation_cannot_be_restored_from_an_invalid_tensor() {
    type Change = fn(&mut wire::TrajectoryChunk);
    let copied = || chunk(0, 1.0, [1.0, 0.0]);
    let cases: [(TrajectoryChunk, Change, Reason, &str); 6] = [
        (copied(), |it| it.state = None, MissingField, "state"),
        (copied(), |it| it.state.as_mut().unwrap().shape.swap(0, 2), BadShape, "state"),
        (copied(), |it| finals(it).state = None, MissingField, "finals.state"),
        (copied(), |it| finals(it).steps = vec![0; 5], BadValue, "finals.steps"),
        (
            scaled(),
            |it| it.agents[0].observation = it.reward.clone(),
            BadShape,
            "agents[0].observation",
        ),
        (
            scaled(),
            |it| finals(it).observations[0].data_type = 2,
            BadType,
            "finals.observations[0]",
        ),
    ];
    for (chunk, change, reason, field) in cases {
        let (mut message, _) = chunk.to_wire(&run(), &sample::origin());
        change(&mut message);
        let digest = honest_digest(&message, &run());
        assert_refused(received(&message, &run(), digest), reason, &format!("chunk.{field}"));
    }
}
